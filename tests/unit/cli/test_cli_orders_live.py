"""What a person sees while an order is under way: lines as they come, and what goes on after Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from skygcs.cli.interruption import AFTER, Unanswered, interrupted_lines, state_line
from support.extension_parts import PLAIN_METHODS
from support.fake_daemon import FakeOutcome
from unit.cli.test_cli_commands import Fleet

SKYGCS_CLI = (sys.executable, "-c", "from skygcs.cli.main import main; main()")
"""As a process of its own, whose pipe is read while it runs."""


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    """alpha never answers, bravo accepts, carol refuses."""
    with Fleet(tmp_path) as fleet:
        fleet.daemon.vehicle("alpha").delay_s = 3600.0
        fleet.daemon.vehicle("carol").outcome = FakeOutcome(False, "denied", "denied: requires position")
        yield fleet


def started(fleet: Fleet, *args: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "SKYGCS_SOCKET": str(fleet.socket)}
    pipe = subprocess.PIPE
    return subprocess.Popen([*SKYGCS_CLI, *args], stdout=pipe, stderr=pipe, text=True, env=environment)


def test_each_vehicle_has_its_line_when_its_outcome_comes_and_ctrl_c_says_what_goes_on(fleet: Fleet) -> None:
    """`takeoff … --wait 30`, Ctrl-C: exit 130 without a word, and 4 s later all three were at 6 m."""
    process = started(fleet, "takeoff", "all", "5", "--wait", "30")
    assert process.stdout is not None
    lines = sorted(process.stdout.readline() for _ in range(2))  # while alpha is still waited for
    assert [line.split()[:2] for line in lines] == [["FAIL", "carol"], ["ok", "bravo"]]
    assert process.poll() is None
    fleet.daemon.vehicle("bravo").armed = True
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and out == ""
    said = err.splitlines()
    assert said[0].startswith("interrupted: takeoff all was sent; ") and "goes on with it" in said[0]
    assert said[1] == "to end it: `skygcs-cli hold all`, or `land all`"
    assert said[2].startswith("now: alpha disarmed") and said[3].startswith("now: bravo armed"), err
    assert fleet.daemon.vehicle("alpha").cancelled == 1
    # as lines of JSON, and an order that the daemon carries on
    process = started(fleet, "stop", "all", "--json-lines")
    assert process.stdout is not None
    assert {json.loads(process.stdout.readline())["vehicle"] for _ in range(2)} == {"bravo", "carol"}
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "the daemon carries it on until each vehicle has answered" in err
    assert "Traceback" not in err


def test_one_object_comes_at_the_end_and_a_line_each_on_request(fleet: Fleet) -> None:
    fleet.daemon.vehicle("alpha").delay_s = 0.0
    whole = json.loads(fleet.run("land", "all", "--json", code=1))
    assert {name: o["ok"] for name, o in whole["outcomes"].items()} == {"alpha": True, "bravo": True, "carol": False}
    lines = [json.loads(line) for line in fleet.run("land", "all", "--json-lines", code=1).splitlines()]
    assert {line["vehicle"]: line["outcome"] for line in lines} == whole["outcomes"]


def test_every_order_of_the_daemon_says_what_goes_on_or_is_a_question() -> None:
    """A method that is neither here nor there would be left in silence."""
    assert set(AFTER) <= PLAIN_METHODS.keys()
    unanswered = [Unanswered(name, {"targets": ["a", "b"]}) for name in AFTER]
    lines = interrupted_lines(unanswered)
    assert len(lines) == 2 * len(AFTER) and not [line for line in lines if "{" in line]
    assert interrupted_lines([Unanswered("vehicles.list", {"targets": "all"})]) == []
    silent = {
        *("daemon.info", "rpc.discover", "subscribe", "unsubscribe", "auth"),
        *(name for name in PLAIN_METHODS if name.rpartition(".")[2] in QUESTIONS),
        *(name for name in PLAIN_METHODS if name.partition(".")[0] in OF_THE_DAEMON),
        *AT_ONCE,
        *REPORT_THEMSELVES,
    }
    assert not PLAIN_METHODS.keys() - silent - set(AFTER)


QUESTIONS = frozenset(
    {"metadata", "list", "get", "status", "latest", "recent", "read", "stats", "paths", "jobs", "check", "request"}
)
OF_THE_DAEMON = frozenset(
    {"links", "link", "corrections", "operator", "companion", "companions", "authority", "recorder", "alarms"}
)
"""They change nothing in a vehicle by themselves, or are programs' own."""

AT_ONCE = frozenset(
    {
        *("clock.read", "missions.end_turns", "control.gains", "control.record"),
        *("control.setpoint", "messages.send", "origin.set"),
        *("origin.from_vehicle", "params.cancel", "plan.cancel", "plan.certify", "plan.load", "plan.make"),
        *("plan.speed", "plan.unload", "plan.upload", "signing.reset_clock", "trajectory.abort", "trajectory.load"),
        *("trajectory.pause", "trajectory.resume", "trajectory.speed", "trajectory.unload", "undo.drop"),
        *("vehicles.forget", "vehicles.calibrate_cancel", "vehicles.calibrate_confirm"),
    }
)
"""They are answered at once, or only compute."""

REPORT_THEMSELVES = frozenset({"missions.upload", "missions.clear", "missions.download", "logs.get", "logs.list"})
"""`skygcs.cli.missions.report_held`; a log that was broken off goes on with the same command."""


def test_the_state_of_a_vehicle_is_one_short_line() -> None:
    state = {"name": "a", "connected": True, "armed": True, "mode": "AUTO.TAKEOFF", "landed": "taking_off"}
    assert state_line({**state, "position": {"alt_rel_m": 1.62}}) == "a armed, taking off, AUTO.TAKEOFF, 1.6 m"
    assert state_line({**state, "connected": False}) == "a is not heard"
    assert state_line({**state, "armed": None, "position": None, "landed": None, "mode": None}) == (
        "a armed or not is unknown"
    )
