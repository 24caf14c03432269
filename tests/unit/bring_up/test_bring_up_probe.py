"""What the shell of a companion prints, read: complete, incomplete, hostile."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from skygcs.bring_up.probe import SCRIPT, parsed, require_room
from skygcs.errors import CompanionError

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


@pytest.mark.parametrize("text", ["", "home=\n", "home=relative\n", "\x00=\n=\n"])
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
