"""`skygcs-cli signing` against a fake daemon: what it asks, prints and refuses; and that a fault prints no key."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import structlog

from skygcs.cli.process import configure_logging
from skygcs.core.protocols.command import Outcome
from skygcs.errors import KeyFileError
from skygcs.runtime.fleet_orders import Reports
from support.command_line import Served, said
from support.fake_daemon import FakeDaemon

CHANNEL = {
    "peer": "/dev/ttyUSB0",
    "signed": 2810,
    "unsigned_allowed": 31,
    "unsigned": 4,
    "bad_signature": 0,
    "replayed": 2,
    "stale": 0,
    "ahead": 0,
    "too_many_streams": 0,
    "sent_signed": 460,
}


class FakeSetup:
    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []

    async def setup(
        self, targets: str, key_file: Path, *, force: bool = False, reports: Reports | None = None
    ) -> dict[str, Outcome]:
        self.asked.append((targets, key_file, force))
        if key_file.name == "open":
            raise KeyFileError(str(key_file), "others can read or change it")
        return {"alpha": Outcome(True, "accepted", "it signs with key 2c6184d5", 1, 0.2)}

    def reset_clock(self, wanted: str, *, force: bool = False) -> str:
        self.asked.append((wanted, force))
        return f"the clock of key {wanted} is set back"

    async def off(self, targets: str, *, reports: Reports | None = None) -> dict[str, Outcome]:
        self.asked.append((targets,))
        return {"alpha": Outcome(False, "timeout", "it still signs", 3, 7.5)}


class SigningDaemon(FakeDaemon):
    def __init__(self) -> None:
        super().__init__()
        self.links_with_key = True
        self.pinned = False
        self.hub.channels = {}
        self.signing = SimpleNamespace(status=lambda channels: self.signing_status())
        self.extensions.demand("signing")
        self.signing_setup = self.extensions["signing"].setup = FakeSetup()

    def signing_status(self) -> dict[str, Any]:
        if not self.links_with_key:
            return {"keys": [], "links": []}
        key = {"key_id": "2c6184d5", "time_unix_s": 1.8e9, "ahead_s": 61.2, "pinned": self.pinned, "links": ["radio"]}
        link = {"link": "radio", "key_id": "2c6184d5", "key_file": "/k", "link_id": 3, "sign_outgoing": True}
        return {"keys": [key], "links": [{**link, "accept_unsigned": ["RADIO_STATUS", 166], "channels": [CHANNEL]}]}


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SigningDaemon]:
    monkeypatch.chdir(tmp_path)
    with Served(tmp_path, SigningDaemon()) as served:
        monkeypatch.setenv("SKYGCS_SOCKET", str(served.socket))
        yield served.daemon


signing = partial(said, "signing")


def test_setup_asks_with_the_whole_path_and_shows_the_outcome(daemon: SigningDaemon, tmp_path: Path) -> None:
    assert "ok   alpha  it signs with key 2c6184d5" in signing("setup", "alpha", "--key", "lab.key")
    signing("setup", "all", "--key", "lab.key", "--force")
    key = tmp_path / "lab.key"
    assert daemon.signing_setup.asked == [("alpha", key, False), ("all", key, True)]


def test_a_key_that_others_can_read_is_one_line_and_exit_1(daemon: SigningDaemon) -> None:
    assert "others can read or change it" in " ".join(signing("setup", "alpha", "--key", "open", code=1).split())


def test_off_fails_if_a_vehicle_still_signs(daemon: SigningDaemon) -> None:
    assert "FAIL alpha  it still signs" in signing("off", "alpha", code=1)


def test_status_shows_what_was_dropped(daemon: SigningDaemon) -> None:
    assert signing("status").splitlines() == [
        "radio: key 2c6184d5, link id 3, signs",
        "  accepted without a signature: RADIO_STATUS, 166",
        "  /dev/ttyUSB0: 2810 signed, 31 unsigned accepted, dropped: 4 unsigned, 2 replayed; sent 460",
        "clock of key 2c6184d5: 2027-01-15 08:00:00 UTC, 61 s ahead of this computer's clock",
    ]
    daemon.pinned = True
    assert signing("status").endswith("skygcs-cli signing reset-clock 2c6184d5\n")
    assert '"bad_signature": 0' in signing("status", "--json")
    daemon.links_with_key = False
    assert "no link has a key" in signing("status")


def test_a_clock_is_set_back(daemon: SigningDaemon) -> None:
    assert signing("reset-clock", "2c6184d5") == "the clock of key 2c6184d5 is set back\n"
    signing("reset-clock", "2c6184d5", "--force")
    assert daemon.signing_setup.asked == [("2c6184d5", False), ("2c6184d5", True)]


def test_a_relative_key_file_is_refused_by_the_daemon(daemon: SigningDaemon) -> None:
    refused = said("call", "signing.setup", '{"targets": "all", "key_file": "lab.key"}', code=2)
    assert "absolute path" in " ".join(refused.split())
    assert daemon.signing_setup.asked == []


def test_a_new_key_needs_no_daemon_and_is_not_printed(tmp_path: Path) -> None:
    path = tmp_path / "new.key"
    reported = signing("key", str(path))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert "keep a copy" in reported and path.read_text()[:16] not in reported
    before = path.read_text()
    assert "exists" in signing("key", str(path), code=1)
    assert path.read_text() == before


def test_a_fault_in_the_log_shows_no_values(capsys: pytest.CaptureFixture[str]) -> None:
    """Tracebacks with local variables, as structlog prints them where rich is installed, would show a key."""
    configure_logging()
    secret = "".join(chr(ord("a") + n % 26) for n in range(40))
    try:
        raise RuntimeError(f"a fault beside a secret of {len(secret)} characters")
    except RuntimeError as error:
        structlog.get_logger("skygcs").error("failed", exc_info=error)
    finally:
        structlog.reset_defaults()
    reported = capsys.readouterr().err
    assert "a fault beside" in reported and "Traceback" in reported
    assert secret not in reported
