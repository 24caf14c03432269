"""`build_page.py` where npm's registry cannot be reached: the demo goes on without a page, a release does not."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.table import each

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """build_page.py with the page's sources, and a Node in bin/ whose npm writes down its words and fails."""
    shutil.copy(ROOT / "build_page.py", tmp_path)
    page = tmp_path / "src/skygcs/web/page"
    page.mkdir(parents=True)
    (page / "package-lock.json").write_text("{}")
    (tmp_path / "bin").mkdir()
    for name, script in (
        ("node", "echo v22.1.0"),
        (
            "npm",
            f'echo "$@" >> "{tmp_path}/npm.txt"; echo "npm error network request to the registry failed" >&2; exit 1',
        ),
    ):
        program = tmp_path / "bin" / name
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
    return tmp_path


def build(checkout: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, checkout / "build_page.py", *options],
        env={"PATH": f"{checkout / 'bin'}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=60,
    )


@each(("options", "code"), [(("--or-warn",), 0), ((), 1), (("--check",), 1)])
def test_without_the_registry_a_demo_is_warned_and_a_release_fails(
    checkout: Path, options: tuple[str, ...], code: int
) -> None:
    done = build(checkout, *options)
    assert done.returncode == code
    assert "the web page was not built" in done.stderr and "registry failed" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (checkout / "src/skygcs/web/static").exists()


def test_packages_come_by_the_lock_file_and_none_of_their_scripts_is_run(checkout: Path) -> None:
    build(checkout)
    words = (checkout / "npm.txt").read_text().split()
    assert words[0] == "ci" and "--ignore-scripts" in words


def test_checks_that_passed_are_not_repeated_before_a_source_changes(checkout: Path) -> None:
    page, said = checkout / "src/skygcs/web/page", checkout / "npm.txt"
    (checkout / "bin/npm").write_text(
        f'#!/bin/sh\necho "$@" >> "{said}"\ncd {page} && mkdir -p node_modules build ../static\n'
        "touch node_modules/.package-lock.json build/tests.js ../static/index.html\n"
    )

    def ran(step: str, *options: str) -> bool:
        before = said.read_text().count(f" {step}\n") if said.exists() else 0
        assert build(checkout, *options).returncode == 0
        return said.read_text().count(f" {step}\n") > before

    assert ran("build") and not ran("build")
    assert [ran("check", "--check"), ran("check", "--check")] == [True, False]
    source = page / "src/one.ts"
    source.parent.mkdir()
    for change in (lambda: os.utime(page / "package-lock.json"), source.touch, source.unlink):
        change()
        assert [ran("check", "--check"), ran("check", "--check")] == [True, False]
    npm = checkout / "bin/npm"
    npm.write_text(f"{npm.read_text()}touch {source}\n")
    source.touch()
    assert ran("build") and ran("build"), "a source that changed while it was built"
