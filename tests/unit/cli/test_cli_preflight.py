"""`skygcs-cli preflight` against a fake daemon: what it prints, asks, sets, and with what it exits."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli import preflight
from skygcs.cli.connection import Exit
from skygcs.cli.main import app
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon
from support.table import each

FIX = {"name": "RTL_ALT", "before": 8000, "value": 3000}
OUTCOME = {"ok": True, "result": "accepted", "message": "8000 -> 3000", "name": "RTL_ALT"}


def finding(check: str, verdict: str, severity: str, text: str, todo: str = "", *fixes: Any) -> dict[str, Any]:
    return {
        "check": check,
        "verdict": verdict,
        "severity": severity,
        "text": text,
        "todo": todo,
        "fixes": list(fixes),
    }


def report(*findings: dict[str, Any], fixed: dict[str, Any] | None = None) -> dict[str, Any]:
    wrong = [f for f in findings if f["verdict"] in ("fail", "unknown")]
    fixes = [fix for f in findings for fix in f["fixes"]]
    return {
        "ok": not wrong,
        "summary": "",
        "sysid": 1,
        "autopilot": "ardupilot",
        "findings": list(findings),
        "fixes": fixes,
        "fixed": fixed or {},
        "unfixed": "",
    }


GOOD = report(finding("link", "pass", "fault", "heard"), finding("radio", "skipped", "fault", "no radio reported"))
BAD = report(
    finding("clock", "fail", "note", "its clock is 9.4 s behind ours (at most 5 s)", "see which is wrong"),
    finding("loss", "unknown", "danger", "how much of it is lost is not known", "ask again"),
    finding("rtl height", "fail", "fault", "RTL_ALT is 8000", "set RTL_ALT to 3000", FIX),
    finding("thrust", "fail", "danger", "GUID_OPTIONS is 0: a climb rate", "set bit 3"),
    finding("link", "pass", "fault", "heard"),
)


class Served:
    """A served fake daemon on a loop of its own."""

    def __init__(self, folder: Path) -> None:
        self.socket = folder / "s.sock"
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        daemon = FakeDaemon()
        self.fleet = daemon.fleet
        self.fleet.preflight_told = {"alpha": BAD, "bravo": GOOD, "carol": GOOD}
        self._server = RpcServer(daemon, self.socket, tcp_port=None, token=None)
        asyncio.run_coroutine_threadsafe(self._server.start(), self._loop).result(10)

    def close(self) -> None:
        asyncio.run_coroutine_threadsafe(self._server.close(), self._loop).result(10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def run(self, *args: str, code: int = Exit.DONE, typed: str | None = None) -> str:
        result = CliRunner().invoke(app, ["--socket", str(self.socket), "preflight", *args], input=typed)
        assert result.exit_code == code, result.output + repr(result.exception)
        return result.output


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv("SKYGCS_SOCKET", "overridden by --socket, and restored after the test")
    served = Served(tmp_path)
    yield served
    served.close()


def test_the_worst_first_each_with_what_to_do(served: Served) -> None:
    assert served.run(code=Exit.FAILED).splitlines() == [
        "alpha: NOT READY, 3 failed, 1 unknown, 1 passed",
        "  DANGER  thrust: GUID_OPTIONS is 0: a climb rate",
        "          -> set bit 3",
        "  FAULT   rtl height: RTL_ALT is 8000",
        "          -> set RTL_ALT to 3000",
        "  note    its clock is 9.4 s behind ours (at most 5 s)",
        "          -> see which is wrong",
        "  unknown loss: how much of it is lost is not known",
        "          -> ask again",
        "bravo: ready, 1 checks passed",
        "carol: ready, 1 checks passed",
        "2 of 3 ready",
    ]


def test_ready_is_exit_0(served: Served) -> None:
    assert served.run("bravo,carol").endswith("2 of 2 ready\n")
    assert served.fleet.preflight_asked == [(False, None)]


def test_all_shows_what_is_well_and_what_was_not_expected(served: Served) -> None:
    reported = served.run("bravo", "--all")
    assert "  ok      link: heard" in reported and "  -       radio: no radio reported" in reported


def test_json_is_the_answer(served: Served) -> None:
    answer = json.loads(served.run("alpha,bravo", "--json", code=Exit.FAILED))
    assert answer["ok"] is False and answer["vehicles"]["bravo"]["ok"] is True


def test_a_vehicle_that_is_not_there(served: Served) -> None:
    assert "no vehicle 'zulu'" in served.run("zulu", code=Exit.FAILED)


def test_fix_sets_nothing_without_a_terminal_to_ask_at(served: Served) -> None:
    reported = served.run("alpha", "--fix", code=Exit.FAILED)
    assert "alpha  RTL_ALT           8000 -> 3000" in reported and "--yes sets it" in reported
    assert served.fleet.preflight_asked == [(False, None)]


def test_fix_with_yes_sets_what_was_reported(served: Served) -> None:
    served.run("alpha", "--fix", "--yes", code=Exit.FAILED)
    assert served.fleet.preflight_asked[1:] == [(True, {"alpha": {"RTL_ALT": 3000}})]


def test_fix_shows_what_was_set(served: Served) -> None:
    served.fleet.preflight_told["alpha"] = {**BAD, "fixed": {"RTL_ALT": OUTCOME}}
    reported = served.run("alpha", "--fix", "-y", code=Exit.FAILED)
    assert "ok   alpha  RTL_ALT           8000 -> 3000" in reported and "after a reboot" in reported


@pytest.mark.parametrize(("answer", "agreed"), [("y", True), ("n", False), ("", False)])
def test_fix_asks(monkeypatch: pytest.MonkeyPatch, answer: str, agreed: bool) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.confirm", lambda text: (text == "Set this parameter?") and answer == "y")
    assert preflight._agreed({"alpha": BAD}, yes=False, quiet=True) is agreed


def test_fix_with_nothing_to_set(served: Served) -> None:
    assert "no finding can be corrected by a parameter" in served.run("bravo", "--fix")


def test_fix_as_json_cannot_ask(served: Served) -> None:
    assert "give --yes" in served.run("alpha", "--fix", "--json", code=Exit.USAGE)


@each("columns", [40, 60, 80])
def test_a_narrow_terminal_is_not_overrun(columns: int) -> None:
    long = finding("home", "fail", "danger", "it has no home position, so it could not return at all", "set it " * 12)
    lines = list(preflight.report_lines({"alpha": report(long)}, columns, everything=True))
    assert max(len(row) for line in lines for row in line.splitlines()) <= columns


def test_a_vehicle_in_flight_is_said_to_fly_and_not_to_be_ready(served: Served) -> None:
    served.fleet.preflight_told = {"alpha": {**GOOD, "in_air": True}, "bravo": GOOD, "carol": {**GOOD, "in_air": False}}
    lines = served.run().splitlines()
    assert lines[0] == "alpha: in flight, no arming decision: 1 checks pass now"
    assert lines[1].startswith("bravo: ready") and lines[-1] == "2 of 3 ready, 1 in flight"
