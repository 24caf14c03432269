"""What a bring-up is made of: bundle, host keys, probe, services and the session itself."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import asyncssh
import pytest

from skygcs.errors import CompanionError, ConfigError, SkygcsError
from skygcs.ext.companions.bring_up import bundle, service_control, ssh_session
from skygcs.ext.companions.bring_up.bundle import NoWheel, Sources, collect, requirements
from skygcs.ext.companions.bring_up.content import content_of, own_content
from skygcs.ext.companions.bring_up.host_keys import HostKeys, fingerprint, refusal
from skygcs.ext.companions.bring_up.probe import SCRIPT, CompanionFacts, parsed, probe, require_room
from skygcs.ext.companions.bring_up.ssh_session import Ran, printable, quoted
from support.fake_companion import ARMED, FakeSession
from support.table import each

# -- A bundle for which wheels are missing: every one is named, and where to get it.


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


# -- Host keys: the fleet's file before the user's, changes named, only what was agreed to is stored.


HOST, PORT = "10.0.0.7", 2222


def new_key() -> asyncssh.SSHKey:
    return asyncssh.generate_private_key("ssh-ed25519").convert_to_public()


def line(key: asyncssh.SSHKey, pattern: str = f"[{HOST}]:{PORT}") -> str:
    return f"{pattern} {key.export_public_key('openssh').decode().strip()}\n"


def host_keys(folder: Path) -> HostKeys:
    return HostKeys(folder, folder / "users")


def test_a_host_that_no_file_names_is_not_known(tmp_path: Path) -> None:
    known = host_keys(tmp_path).known(HOST, HOST, PORT)
    assert (known.keys, known.source) == ((), None)
    error = refusal(known, key := new_key(), "alpha", "10.0.0.7:2222")
    assert "is not known" in str(error) and fingerprint(key) in str(error) and "companions trust alpha" in error.todo


def test_the_fleets_file_counts_before_the_users(tmp_path: Path) -> None:
    old, new = new_key(), new_key()
    (tmp_path / "users").write_text(line(old))
    keys = host_keys(tmp_path)
    assert keys.known(HOST, HOST, PORT).keys == (old,)
    keys.trust(HOST, PORT, new)
    assert keys.known(HOST, HOST, PORT).keys == (new,)
    assert host_keys(tmp_path).known(HOST, "", PORT).keys == (new,)
    assert (tmp_path / "users").read_text() == line(old)


def test_a_changed_key_is_named_with_both_fingerprints(tmp_path: Path) -> None:
    old, new = new_key(), new_key()
    keys = host_keys(tmp_path)
    keys.trust(HOST, PORT, old)
    text = str(refusal(keys.known(HOST, HOST, PORT), new, "alpha", "place"))
    assert text.count("SHA256:") == 2
    assert text.index(fingerprint(old)) < text.index("now " + fingerprint(new))


def test_storing_replaces_this_host_and_keeps_the_others_and_the_comments(tmp_path: Path) -> None:
    first, second, other = new_key(), new_key(), new_key()
    (tmp_path / "known_hosts").write_text("# ours\n" + line(other, "bravo,10.0.0.8") + line(first))
    keys = host_keys(tmp_path)
    keys.trust(HOST, PORT, second)
    text = (tmp_path / "known_hosts").read_text()
    assert text.startswith("# ours\n") and keys.known("bravo", "", 22).keys == (other,)
    assert keys.known(HOST, HOST, PORT).keys == (second,)
    assert len(list(tmp_path.iterdir())) == 1


def test_a_revoked_key_stays_revoked(tmp_path: Path) -> None:
    key = new_key()
    (tmp_path / "known_hosts").write_text("@revoked " + line(key))
    keys = host_keys(tmp_path)
    keys.trust(HOST, PORT, key)
    known = keys.known(HOST, HOST, PORT)
    assert known.revoked == (key,)
    assert "revoked" in str(refusal(known, key, "alpha", "place"))


@each("data", [b"nonsense\n", b"@what host ssh-ed25519 AAAA\n", b"\xff\xfe", b"x" * (5 << 20)])
def test_a_file_that_is_none_is_refused_by_name(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "known_hosts").write_bytes(data)
    with pytest.raises(ConfigError, match="known_hosts"):
        host_keys(tmp_path)


# -- What the shell of a companion prints, read: complete, incomplete, hostile.


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


# -- Services of companions: an armed vehicle's is never stopped unless insisted on.


async def running(session: FakeSession, **facts: str) -> CompanionFacts:
    session.facts |= {"state": "active", **facts}
    return await probe(session)


UNKNOWN = '[{"name": "alpha"}]'
FLYING = '[{"name": "alpha", "armed": false, "landed": "in_air"}]'


@each("there", [ARMED, UNKNOWN, FLYING])
async def test_the_service_of_an_active_vehicle_is_not_stopped(there: str) -> None:
    session = FakeSession()
    session.answer("status", 0, there)
    facts = await running(session)
    for action in (service_control.stop, service_control.restart):
        with pytest.raises(CompanionError, match="armed or in the air"):
            await action(session, facts, force=False)
    assert not session.ran("systemctl")
    await service_control.stop(session, facts, force=True)
    assert session.ran("systemctl --user stop skygcs")


@each("answer", [(3, "", "no daemon"), (0, "not JSON", ""), (0, "{}", "")])
async def test_a_vehicle_whose_state_is_not_known_counts_as_active(answer: tuple[int, str, str]) -> None:
    session = FakeSession()
    session.answer("status", *answer)
    with pytest.raises(CompanionError, match="--force insists"):
        await service_control.stop(session, await running(session), force=False)
    assert not session.ran("systemctl")


async def test_a_vehicle_at_rest_may_lose_its_service() -> None:
    session = FakeSession()
    assert await service_control.stop(session, await running(session), force=False) == "stopped"
    assert await service_control.restart(session, await running(session), force=False) == "restarted"


async def test_a_vehicle_that_is_heard_over_the_ground_alone_is_not_its_own() -> None:
    session = FakeSession()
    session.answer("status", 0, '[{"name": "v2", "armed": true, "links": {"ground": {}}}]')
    facts = await running(session)
    assert await service_control.stop(session, facts, force=False) == "stopped"
    session.answer("status", 0, '[{"name": "v2", "armed": true, "links": {"ground": {}, "autopilot": {}}}]')
    with pytest.raises(CompanionError, match="v2 is armed"):
        await service_control.stop(session, facts, force=False)


async def test_the_machine_s_service_is_reached_by_root_alone() -> None:
    session = FakeSession()
    session.answer("sudo -n systemctl", 1, stderr="sudo: a password is required\n")
    with pytest.raises(CompanionError, match="needs root; allow"):
        await service_control.start(session, await running(session, unit="system", state="inactive"))
    root = FakeSession()
    await service_control.start(root, await running(root, unit="system", state="inactive", uid="0"))
    assert root.ran("; systemctl start skygcs")


# -- What comes from a companion is bounded and cannot move the cursor of the terminal that shows it.


class Pipe:
    """A reader that gives these pieces."""

    def __init__(self, *pieces: bytes) -> None:
        self.pieces = list(pieces)

    async def read(self, _: int) -> bytes:
        return self.pieces.pop(0) if self.pieces else b""


async def lines(*pieces: bytes) -> list[str]:
    return [line async for line in ssh_session._lines_of(Pipe(*pieces))]  # type: ignore[arg-type]


async def test_lines_are_put_together_cut_and_cleaned() -> None:
    assert await lines(b"on", b"e\r\ntwo\n", b"\xff\x1b[2Jthree") == ["one", "two", "�·[2Jthree"]
    (long,) = await lines(*[b"x" * 65536] * 100, b"\n")
    assert len(long) == ssh_session.MAX_LINE_CHARS


async def test_an_output_without_end_is_kept_up_to_a_bound() -> None:
    kept = await ssh_session._kept(Pipe(*[b"x" * 65536] * 100))  # type: ignore[arg-type]
    assert len(kept) == ssh_session.MAX_OUTPUT_BYTES


def test_the_reason_of_a_command_is_its_last_line() -> None:
    assert Ran(1, "", "first\nlast\n\n").why == "last"
    assert (Ran(2, "", "").why, Ran(None, "", "").why) == ("exit code 2", "was ended by a signal")


def test_words_reach_the_shell_as_they_are() -> None:
    assert quoted("a b", "$HOME", "x") == "'a b' '$HOME' x"
    assert printable("a\tb\x07\u202e") == "a\tb··"
