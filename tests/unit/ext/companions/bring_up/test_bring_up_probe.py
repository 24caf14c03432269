"""What the shell of a companion prints, read: complete, incomplete, hostile."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from skygcs.errors import CompanionError
from skygcs.ext.companions.bring_up.content import content_of, own_content
from skygcs.ext.companions.bring_up.probe import SCRIPT, parsed, require_room
from support.table import each

GOOD = """home=/home/pi
uid=1000
machine=aarch64
python=3.11
libc=glibc 2.36
free_kb=1000000
program=/home/pi/skygcs/current/bin/skygcs
version=skygcs 0.1.0
installed=versions/0.1.0-abc
unit=user
state=active
uptime=12.5
unix=1700000000.25
"""


def test_all_of_it_is_read() -> None:
    facts = parsed(GOOD)
    assert (facts.machine, facts.python, facts.version) == ("aarch64", "3.11", "0.1.0")
    assert (facts.unit, facts.state, facts.uid) == ("user", "active", 1000)
    assert (facts.free_bytes, facts.uptime_s, facts.unix_s) == (1_024_000_000, 12.5, 1700000000.25)
    assert facts.folder == "/home/pi/skygcs"


def test_what_is_missing_is_not_known() -> None:
    facts = parsed("a banner\nhome=/root\nfree_kb=\nuptime=soon\nuid=x\nunit=what\n")
    assert (facts.free_bytes, facts.uptime_s, facts.uid, facts.unit, facts.program) == (None, None, None, "none", "")
    require_room(facts)


@each("text", ["", "home=\n", "home=relative\n", "\x00=\n=\n"])
def test_a_shell_without_a_home_is_named(text: str) -> None:
    with pytest.raises(CompanionError, match="HOME"):
        parsed(text)


def test_a_full_disk_is_named_with_what_to_do() -> None:
    with pytest.raises(CompanionError, match="1 MB free in /home/pi, 67 MB needed; remove old logs"):
        require_room(parsed(GOOD.replace("free_kb=1000000", "free_kb=1000")))


def test_the_script_runs_in_a_plain_shell(tmp_path: Path) -> None:
    done = subprocess.run(
        ["sh", "-c", SCRIPT], env={"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}, capture_output=True, text=True
    )
    facts = parsed(done.stdout)
    assert (facts.home, facts.unit, facts.installed) == (str(tmp_path), "none", "")
    assert facts.free_bytes is not None and facts.uid is not None and facts.unix_s is not None


def test_the_code_that_is_installed_there_is_told_by_its_content(tmp_path: Path) -> None:
    program = tmp_path / "skygcs" / "current" / "bin" / "skygcs"
    program.parent.mkdir(parents=True)

    def content(first_line: str) -> str:
        program.write_text(f"{first_line}\nprint('skygcs 0.1.0')\n")
        program.chmod(0o755)
        environment = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
        done = subprocess.run(["sh", "-c", SCRIPT], env=environment, capture_output=True, text=True)
        return parsed(done.stdout).content

    assert content(f"#!{sys.executable}") == own_content()
    assert len(own_content()) == 12
    for unknown in ("#!/bin/sh", "#!/usr/bin/env python3", "#!/nowhere/python3"):
        assert content(unknown) == "", "no Python of its own is named"


def test_content_is_of_paths_and_bytes_of_python_files_alone(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.py").write_text("1")
    first = content_of(str(tmp_path))
    (tmp_path / "a" / "x.so").write_text("compiled")
    assert content_of(str(tmp_path)) == first
    (tmp_path / "a" / "x.py").rename(tmp_path / "x.py")
    moved = content_of(str(tmp_path))
    (tmp_path / "x.py").write_text("2")
    assert len({first, moved, content_of(str(tmp_path))}) == 3
