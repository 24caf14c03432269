"""`skygcs-cli preflight` against a fake daemon: what it prints, asks, sets, and with what it exits."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.cli import preflight
from skygcs.cli.connection import Exit
from support.command_line import Served
from support.fake_daemon import FakeDaemon
from support.table import each

FIX = {"name": "RTL_ALT", "before": 8000, "value": 3000}
OUTCOME = {"ok": True, "result": "accepted", "message": "8000 -> 3000", "name": "RTL_ALT"}


def finding(check: str, verdict: str, severity: str, text: str, todo: str = "", *fixes: Any) -> dict[str, Any]:
    return {"check": check, "verdict": verdict, "severity": severity, "text": text, "todo": todo, "fixes": list(fixes)}


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


class Flight(Served[FakeDaemon]):
    def __init__(self, folder: Path) -> None:
        daemon = FakeDaemon()
        self.fleet = daemon.fleet
        self.fleet.preflight_told = {"alpha": BAD, "bravo": GOOD, "carol": GOOD}
        super().__init__(folder, daemon)

    def run(self, *words: object, code: int = Exit.DONE, typed: str | None = None) -> str:
        return super().run("preflight", *words, code=code, typed=typed)


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Flight]:
    with Flight(tmp_path) as served:
        yield served


def test_the_worst_first_each_with_what_to_do(served: Flight) -> None:
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


def test_ready_is_exit_0(served: Flight) -> None:
    assert served.run("bravo,carol").endswith("2 of 2 ready\n")
    assert served.fleet.preflight_asked == [(False, None)]


def test_all_shows_what_is_well_and_what_was_not_expected(served: Flight) -> None:
    reported = served.run("bravo", "--all")
    assert "  ok      link: heard" in reported and "  -       radio: no radio reported" in reported


def test_json_is_the_answer(served: Flight) -> None:
    answer = json.loads(served.run("alpha,bravo", "--json", code=Exit.FAILED))
    assert answer["ok"] is False and answer["vehicles"]["bravo"]["ok"] is True


def test_a_vehicle_that_is_not_there(served: Flight) -> None:
    assert "no vehicle 'zulu'" in served.run("zulu", code=Exit.FAILED)


def test_fix_sets_nothing_without_a_terminal_to_ask_at(served: Flight) -> None:
    reported = served.run("alpha", "--fix", code=Exit.FAILED)
    assert "alpha  RTL_ALT           8000 -> 3000" in reported and "--yes sets it" in reported
    assert served.fleet.preflight_asked == [(False, None)]


def test_fix_with_yes_sets_what_was_reported(served: Flight) -> None:
    served.run("alpha", "--fix", "--yes", code=Exit.FAILED)
    assert served.fleet.preflight_asked[1:] == [(True, {"alpha": {"RTL_ALT": 3000}})]


def test_fix_shows_what_was_set(served: Flight) -> None:
    served.fleet.preflight_told["alpha"] = {**BAD, "fixed": {"RTL_ALT": OUTCOME}}
    reported = served.run("alpha", "--fix", "-y", code=Exit.FAILED)
    assert "ok   alpha  RTL_ALT           8000 -> 3000" in reported and "after a reboot" in reported


@each(("answer", "agreed"), [("y", True), ("n", False), ("", False)])
def test_fix_asks(monkeypatch: pytest.MonkeyPatch, answer: str, agreed: bool) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.confirm", lambda text: (text == "Set this parameter?") and answer == "y")
    assert preflight._agreed({"alpha": BAD}, yes=False, quiet=True) is agreed


def test_fix_with_nothing_to_set(served: Flight) -> None:
    assert "no finding can be corrected by a parameter" in served.run("bravo", "--fix")


def test_fix_as_json_cannot_ask(served: Flight) -> None:
    assert "give --yes" in served.run("alpha", "--fix", "--json", code=Exit.USAGE)


@each("columns", [40, 60, 80])
def test_a_narrow_terminal_is_not_overrun(columns: int) -> None:
    long = finding("home", "fail", "danger", "it has no home position, so it could not return at all", "set it " * 12)
    lines = list(preflight.report_lines({"alpha": report(long)}, columns, everything=True))
    assert max(len(row) for line in lines for row in line.splitlines()) <= columns


def test_a_vehicle_in_flight_is_said_to_fly_and_not_to_be_ready(served: Flight) -> None:
    served.fleet.preflight_told = {"alpha": {**GOOD, "in_air": True}, "bravo": GOOD, "carol": {**GOOD, "in_air": False}}
    lines = served.run().splitlines()
    assert lines[0] == "alpha: in flight, no arming decision: 1 checks pass now"
    assert lines[1].startswith("bravo: ready") and lines[-1] == "2 of 3 ready, 1 in flight"
