"""A bundle for which wheels are missing: every one is named, and where to get it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from skygcs.errors import SkygcsError
from skygcs.ext.companions.bring_up import bundle
from skygcs.ext.companions.bring_up.bundle import NoWheel, Sources, collect, requirements


def test_what_skygcs_needs_is_known_without_an_index() -> None:
    needed = requirements("skygcs", {"companions"})
    names = {name.partition(">")[0].partition("<")[0].partition("=")[0] for name in needed}
    assert {"pydantic", "pydantic-core", "asyncssh", "cffi", "zeroconf"} <= names, "directly, and by others"
    assert not {"skygcs", "pytest", "playwright"} & names
    assert "asyncssh" not in " ".join(requirements("skygcs"))


def test_all_wheels_that_are_missing_are_named_not_only_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pip(words: Sequence[str], purpose: str, **environment: str) -> None:
        if words[0] != "download":
            return
        wanted = words[-2]
        missing = next((name for name in ("numpy", "cffi") if wanted.startswith((name, "skygcs"))), None)
        if missing is not None:
            raise NoWheel(purpose, missing)

    monkeypatch.setattr(bundle, "_pip", pip)
    monkeypatch.setattr(bundle, "_built_wheel", lambda folder: None)
    with pytest.raises(SkygcsError) as failed:
        collect(tmp_path / "b.tar", "armv7l", "3.11", Sources())
    text = str(failed.value)
    assert text.startswith("bundle for armv7l, Python 3.11: there are no wheels of 2 of ")
    assert "'cffi" in text and "'numpy" in text and "'pydantic" not in text
    assert "https://www.piwheels.org/simple" in text and "--wheels FOLDER" in text
    assert not (tmp_path / "b.tar").exists()


def test_a_fault_of_another_kind_is_told_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def pip(words: Sequence[str], purpose: str, **environment: str) -> None:
        raise SkygcsError(f"bundle for {purpose}: pip: no route to the index")

    monkeypatch.setattr(bundle, "_pip", pip)
    monkeypatch.setattr(bundle, "_built_wheel", lambda folder: None)
    with pytest.raises(SkygcsError, match="no route to the index"):
        collect(tmp_path / "b.tar", "armv7l", "3.11", Sources())
