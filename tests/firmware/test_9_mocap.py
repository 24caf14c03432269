"""An ArduCopter without GPS and compass flies by motion capture: cameras see the truth of its simulator."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import pytest

from support.firmware_cameras import CapturedField
from support.firmware_field import available
from support.firmware_report import Report, Row

pytestmark = pytest.mark.only("ardupilot")

UP_M = 3.0
GOAL_ENU_M = (3.0, 1.0, UP_M)
NEAR_M = 0.5
"""Where it is truly, against where it was ordered to be."""

DROPOUT_S = 0.5


@pytest.fixture(scope="module")
def filmed(report: Report, tmp_path_factory: pytest.TempPathFactory) -> Iterator[CapturedField]:
    if "ardupilot" not in available():
        pytest.skip("no binary of ardupilot is named; `make test-firmware` says what to set")
    field = CapturedField(tmp_path_factory.mktemp("mocap"))
    try:
        field.start()
        yield field
    finally:
        field.stop()


@pytest.fixture
def row(request: pytest.FixtureRequest, filmed: CapturedField, report: Report) -> Iterator[dict[str, Any]]:
    """What the scenario measured."""
    made = Row(request.node.nodeid.rpartition("/")[2], "failed")
    began = time.monotonic()
    yield made.figures
    filmed.cameras.hidden = False
    made.seconds = time.monotonic() - began
    made.modes = {filmed.one: filmed.truth(filmed.one).modes_since(began)}
    if "finished" in made.figures:
        made.outcome = "passed"
    report.add(made)


def stands_at(filmed: CapturedField, enu_m: tuple[float, float, float], seconds: float) -> float:
    """Waits until it stands there; the farthest it truly is from there during the next seconds."""
    cameras = filmed.cameras
    filmed.wait(lambda: math.dist(cameras.enu_m, enu_m) < NEAR_M / 2, 30, f"it is at {enu_m}")
    time.sleep(2.0)
    began = time.monotonic()
    time.sleep(seconds)
    return max(math.dist(place, enu_m) for place in cameras.since(began))


def off_m(filmed: CapturedField) -> float:
    """Between where the daemon has it and where it truly is; it stands."""
    return math.dist(filmed.state(filmed.one)["position"]["enu_m"], filmed.cameras.enu_m)


def prepared(filmed: CapturedField, row: dict[str, Any]) -> None:
    """Poses come, it has an origin, and its own checks and ours pass."""
    filmed.order("vehicles.mode", filmed.one, mode="GUIDED")  # preflight wants a mode that arms

    def sent() -> bool:
        row["poses"] = filmed.daemon.call("mocap.status")
        return row["poses"]["vehicles"][0]["problem"] is None

    row["poses s"] = filmed.wait(sent, 20, "poses go to it")
    row["ready s"] = filmed.wait(lambda: filmed.said("all are ready"), 120, "its estimator and its arming checks agree")
    report: dict[str, Any] = {}

    def passed() -> bool:
        report.update(filmed.daemon.call("preflight.run", targets=filmed.one)["vehicles"][filmed.one])
        wrong = [finding for finding in report["findings"] if finding["verdict"] not in ("pass", "skipped")]
        row["not passed"] = {finding["check"]: finding["text"] for finding in wrong}
        return bool(report["ok"])

    row["preflight s"] = filmed.wait(passed, 20, "preflight passes")
    found = {finding["check"]: finding["verdict"] for finding in report["findings"]}
    row["preflight"] = {check: found[check] for check in ("poses", "external vision", "ekf origin")}
    assert set(row["preflight"].values()) == {"pass"}, report


def test_it_flies_and_lands_by_poses(filmed: CapturedField, row: dict[str, Any]) -> None:
    prepared(filmed, row)
    name = filmed.one
    events = [event["text"] for event in filmed.watcher.events_since(0.0, vehicle=name)]
    row["origin events"] = [text for text in events if "origin" in text]
    row["reported off at start m"] = off_m(filmed)
    east, north, up = filmed.cameras.enu_m  # of its centre
    filmed.order("vehicles.takeoff", name, height_m=UP_M, wait_s=60)
    row["hover off m"] = stands_at(filmed, (east, north, up + UP_M), 5.0)
    filmed.order("vehicles.goto", name, enu_m=list(GOAL_ENU_M))
    row["goal off m"] = stands_at(filmed, GOAL_ENU_M, 5.0)
    row["reported off m"] = off_m(filmed)
    row["status"] = filmed.poses()

    began = time.monotonic()
    filmed.cameras.hidden = True
    time.sleep(DROPOUT_S)
    filmed.cameras.hidden = False
    time.sleep(5.0)
    row["drop-out off m"] = max(math.dist(place, GOAL_ENU_M) for place in filmed.cameras.since(began))
    row["after drop-out"] = filmed.poses()
    events = [event["data"]["change"] for event in filmed.watcher.events_since(began, "mocap", vehicle=name)]
    assert events == ["lost", "back"]
    assert filmed.truth(name).mode == "GUIDED"
    status = row["after drop-out"]
    assert (status["dropouts"], status["reset_counter"]) == (row["status"]["dropouts"] + 1, 1), status
    assert DROPOUT_S <= status["longest_dropout_s"] < DROPOUT_S + 0.5

    filmed.order("vehicles.land", name)
    row["land s"] = filmed.wait(lambda: not filmed.truth(name).armed, 60, "it has landed and disarmed")
    row["landed off m"] = math.dist(filmed.cameras.enu_m[:2], GOAL_ENU_M[:2])
    offsets = (
        "hover off m",
        "goal off m",
        "drop-out off m",
        "landed off m",
        "reported off m",
        "reported off at start m",
    )
    assert all(row[what] < NEAR_M for what in offsets), row
    assert row["status"]["sent_hz"] > 20
    row["finished"] = True
