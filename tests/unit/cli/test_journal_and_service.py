"""Records as the journal's fields; the units and files of `skygcs service`."""

from __future__ import annotations

import os
import pwd
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import structlog

from skygcs.cli import process, service
from skygcs.cli.journal import JournalLogger, datagram, goes_to_journal
from skygcs.cli.service import Installation, unit_text
from skygcs.errors import SkygcsError


def fields(data: bytes) -> dict[str, str]:
    """As journald reads a datagram."""
    found = {}
    while data:
        line, _, rest = data.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if not equals:
            size = int.from_bytes(rest[:8], "little")
            value, rest = rest[8 : 8 + size], rest[9 + size :]
        found[name.decode()] = value.decode()
        data = rest
    return found


def test_a_record_has_message_priority_and_its_own_fields() -> None:
    got = fields(datagram({"event": "link is up", "level": "info", "kind": "link_up", "sysid": 7, "odd key": 1}))
    assert got == {
        "MESSAGE": "link is up",
        "PRIORITY": "6",
        "SYSLOG_IDENTIFIER": "skygcs",
        "SKYGCS_KIND": "link_up",
        "SKYGCS_SYSID": "7",
        "SKYGCS_ODD_KEY": "1",
    }


def test_a_text_of_a_vehicle_makes_no_fields_of_its_own() -> None:
    got = fields(datagram({"event": "hello\nPRIORITY=0\n_UID=0", "level": "warning", "vehicle": "a\nb"}))
    assert got["MESSAGE"] == "hello\nPRIORITY=0\n_UID=0" and got["PRIORITY"] == "4" and "_UID" not in got


def test_it_is_used_only_where_stderr_is_the_journal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    assert not goes_to_journal()
    for wrong in ("1:2", "x", "1:2:3"):
        monkeypatch.setenv("JOURNAL_STREAM", wrong)
        assert not goes_to_journal()
    with (tmp_path / "stream").open("w") as stream:
        status = os.fstat(stream.fileno())
        monkeypatch.setattr(sys, "stderr", stream)
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        assert goes_to_journal()


def test_the_daemon_s_log_goes_there_with_its_fields(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = str(tmp_path / "journal")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(path)
        monkeypatch.setattr(process, "goes_to_journal", lambda: True)
        logger = JournalLogger(path)
        monkeypatch.setattr(process, "JournalLogger", lambda: logger)
        before = structlog.get_config()
        try:
            process.configure_logging()
            log = structlog.get_logger("skygcs")
            log.debug("not shown")
            log.warning("is lost", kind="vehicle_lost", vehicle="alpha")
        finally:
            structlog.configure(**before)
        got = fields(journal.recv(65536))
    assert (got["MESSAGE"], got["SKYGCS_KIND"], got["SKYGCS_VEHICLE"]) == ("is lost", "vehicle_lost", "alpha")
    logger.msg(event="nobody listens")  # and nothing is raised
    logger.close()


def test_a_unit_names_its_files_whatever_they_are_called() -> None:
    text = unit_text(Installation(Path("/a b/50%.toml"), Path("/a b/logs"), Path("/opt/x/skygcs"), "pilot"))
    assert 'ExecStart=/opt/x/skygcs run "/a b/50%%.toml" --socket /run/skygcs/skygcs.sock' in text
    assert "User=pilot" in text and 'ReadWritePaths="/a b/logs"' in text and "Type=notify" in text
    own = unit_text(Installation(Path("/f.toml"), Path("/l"), Path("/s"), None))
    assert "User=" not in own and "Nice=" not in own and "WantedBy=default.target" in own


@pytest.fixture
def home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(service, "_systemctl", lambda *words: None)
    (tmp_path / "fleet.toml").write_text("[links.x]\ntype = 'udp_server'\nport = 14550\n")
    return tmp_path


def test_install_writes_once_and_uninstall_removes_it(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unit = home / "config" / "systemd" / "user" / "skygcs.service"
    assert service.install(home / "fleet.toml", user=True, force=False) == 0
    assert str(home / "fleet.toml") in unit.read_text() and (home / "logs").is_dir()
    assert "systemctl --user start skygcs" in capsys.readouterr().out
    unit.write_text("changed by hand")
    with pytest.raises(SkygcsError, match="--force"):
        service.install(home / "fleet.toml", user=True, force=False)
    assert service.uninstall(user=True) == 0 and not unit.exists()
    with pytest.raises(SkygcsError, match="no service is installed"):
        service.uninstall(user=True)


def test_a_fleet_file_with_mistakes_is_not_installed(home: Path) -> None:
    (home / "fleet.toml").write_text("[links.x]\ntype = 'telepathy'\n")
    with pytest.raises(SkygcsError, match="telepathy"):
        service.install(home / "fleet.toml", user=True, force=False)
    assert not (home / "config").exists()


def test_installing_as_root_gives_nothing_away(home: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A log folder that is made belongs to the user; one that is there keeps its owner, and must be the user's."""
    given: list[Path] = []
    monkeypatch.setattr(os, "chown", lambda path, *_, **__: given.append(Path(path)))
    monkeypatch.setattr(os, "getuid", lambda: 0)
    nobody = pwd.getpwnam("nobody")
    service._make_log_dir(tmp_path / "made" / "logs", "nobody")
    assert sorted(given) == [tmp_path / "made", tmp_path / "made" / "logs"]
    given.clear()
    assert tmp_path.stat().st_uid != nobody.pw_uid
    with pytest.raises(OSError, match="belongs to another user"):
        service._make_log_dir(tmp_path, "nobody")
    assert given == []


def test_files_of_a_running_program_are_not_for_others(tmp_path: Path) -> None:
    program = f"""
import asyncio, os
from pathlib import Path
from skygcs.cli.process import run_loop
async def main():
    Path({str(tmp_path)!r}, "f").write_text("")
    return 0
os.umask(0)
run_loop(main())
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    assert (tmp_path / "f").stat().st_mode & 0o007 == 0
