"""The build hook compiles the fast path, hardened. Without a compiler it warns, or fails if the path is required."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from support.process import ROOT
from support.table import each

linux = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="needs Linux and a C compiler called cc"
)


class Interface:
    """What hatchling's BuildHookInterface has that the hook uses."""

    target_name = "wheel"

    def __init__(self, root: Path) -> None:
        self.root = str(root)
        self.app = self
        self.warnings: list[str] = []

    def display_warning(self, text: str) -> None:
        self.warnings.append(text)


@pytest.fixture
def hook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The hook of a copy of the project, with no variables set."""
    for name in ("CC", "CFLAGS", "LDFLAGS", "SKYGCS_PURE", "SKYGCS_REQUIRE_FASTPATH"):
        monkeypatch.delenv(name, raising=False)
    for name, interface in (
        ("hatchling.builders.hooks.plugin.interface", "BuildHookInterface"),
        ("hatchling.metadata.plugin.interface", "MetadataHookInterface"),
    ):
        for at in range(1, name.count(".") + 2):
            part = types.ModuleType(".".join(name.split(".")[:at]))
            monkeypatch.setitem(sys.modules, part.__name__, part)
        setattr(sys.modules[name], interface, Interface)
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / module.SOURCE).parent.mkdir(parents=True)
    for file in (ROOT / module.SOURCE).parent.glob("_fast_path*.[ch]"):
        shutil.copy(file, (tmp_path / module.SOURCE).parent)
    return module.FastPathHook(tmp_path)


def run(hook: Any) -> dict[str, Any]:
    data: dict[str, Any] = {"artifacts": []}
    hook.initialize("standard", data)
    return data


@linux
def test_it_is_compiled_and_hardened(hook: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "cc")
    monkeypatch.setenv("SKYGCS_REQUIRE_FASTPATH", "1")
    data = run(hook)
    assert not hook.warnings
    (built,) = data["artifacts"]
    assert data["infer_tag"] is True
    raw = (Path(hook.root) / built).read_bytes()
    assert b"__stack_chk_fail" in raw
    assert b"PyInit__fast_path" in raw


@pytest.mark.deep  # compiles
@linux
def test_a_compiler_that_does_not_know_the_flags_compiles_without_them(
    hook: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    old = tmp_path / "old-cc"
    old.write_text('#!/bin/sh\ncase "$*" in *stack-clash*) exit 1;; esac\nexec cc "$@"\n')
    old.chmod(0o755)
    monkeypatch.setenv("CC", str(old))
    assert run(hook)["artifacts"]
    assert not hook.warnings


def test_without_a_compiler_it_warns(hook: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "/nowhere/cc")
    assert run(hook) == {"artifacts": []}
    assert len(hook.warnings) == 1
    assert "/nowhere/cc" in hook.warnings[0]


@each("compiler", ["/nowhere/cc", "false"])
def test_what_is_required_and_fails_fails_the_installation(
    hook: Any, monkeypatch: pytest.MonkeyPatch, compiler: str
) -> None:
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setenv("SKYGCS_REQUIRE_FASTPATH", "1")
    with pytest.raises(RuntimeError, match="SKYGCS_REQUIRE_FASTPATH"):
        run(hook)


@pytest.mark.deep  # compiles
@linux
def test_warnings_are_errors_where_it_is_required(hook: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    source = Path(hook.root) / "src" / "skygcs" / "links" / "_fast_path.c"
    source.write_text(source.read_text() + "\nstatic int nobody_calls_this(int x) { return 1; }\n")
    monkeypatch.setenv("CC", "cc")
    assert run(hook)["artifacts"]
    monkeypatch.setenv("SKYGCS_REQUIRE_FASTPATH", "1")
    with pytest.raises(RuntimeError, match="nobody_calls_this"):
        run(hook)


def test_it_can_be_left_out_but_not_required_as_well(hook: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYGCS_PURE", "1")
    assert run(hook) == {"artifacts": []}
    monkeypatch.setenv("SKYGCS_REQUIRE_FASTPATH", "1")
    with pytest.raises(RuntimeError, match="contradict"):
        run(hook)
