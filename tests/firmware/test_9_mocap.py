"""A PX4 and an ArduCopter without GPS and compass fly by motion capture: cameras see the truth of their simulators."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator
from typing import Any

import pytest

from support.firmware_cameras import CapturedField
from support.firmware_field import available
from support.firmware_report import Report, Row
from support.process import ROOT

OUTPUT = ROOT / "build" / "firmware"

UP_M = 3.0
GOAL_ENU_M = (3.0, 1.0, UP_M)
NEAR_M = {"px4": 1.0, "ardupilot": 0.5}
"""Where it is truly, against where it was ordered to be. A PX4 wanders by half a metre in position
hold, with GPS too."""

HEADING_DEG, NEAR_DEG = 120.0, 5.0
"""Where it is ordered to look at the goal: not where it looked at its start."""

DROPOUT_S = 0.5

STAMP_S = 0.05
"""Between how late a pose is by its stamp and how far PX4's estimate of our clock lags: what the pose took. The clock
of its simulator runs unevenly, and the estimate has a time constant of half a minute."""

NEEDED = {
    "px4": {"EKF2_EV_CTRL": 11, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0},
    "ardupilot": {
        "VISO_TYPE": 1,
        "EK3_SRC1_POSXY": 6,
        "EK3_SRC1_VELXY": 0,
        "EK3_SRC1_POSZ": 6,
        "EK3_SRC1_VELZ": 0,
        "EK3_SRC1_YAW": 6,
        "GPS1_TYPE": 0,
    },
}
"""What preflight sets, as docs/howto/motion-capture.md has it."""


@pytest.fixture(scope="module")
def filmed(request: pytest.FixtureRequest, report: Report) -> Iterator[CapturedField]:
    firmware = request.config.getoption("--firmware")
    if firmware not in available():
        pytest.skip(f"no binary of {firmware} is named; `make test-firmware` says what to set")
    folder = OUTPUT / "runs" / f"{report.run}-mocap"
    folder.mkdir(parents=True)
    field = CapturedField(firmware, folder)
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
    if filmed.truth(filmed.one).armed:
        filmed.order("vehicles.land", filmed.one)
        filmed.wait(lambda: not filmed.truth(filmed.one).armed, 120, "it has landed")
    made.modes = {filmed.one: filmed.truth(filmed.one).modes_since(began)}
    if "finished" in made.figures:
        made.outcome = "passed"
    report.add(made)


def stands_at(filmed: CapturedField, enu_m: tuple[float, float, float], seconds: float) -> float:
    """Waits until it stands there; the farthest it truly is from there during the next seconds."""
    cameras = filmed.cameras
    filmed.wait(lambda: math.dist(cameras.enu_m, enu_m) < NEAR_M[filmed.firmware] / 2, 30, f"it is at {enu_m}")
    time.sleep(2.0)
    began = time.monotonic()
    time.sleep(seconds)
    return max(math.dist(place, enu_m) for place in cameras.since(began))


def off_m(filmed: CapturedField) -> float:
    """Between where the daemon has it and where it truly is; it stands."""
    return math.dist(filmed.state(filmed.one)["position"]["enu_m"], filmed.cameras.enu_m)


def turned_deg(a_deg: float, b_deg: float) -> float:
    """Between two headings."""
    return abs((a_deg - b_deg + 180) % 360 - 180)


def preflight(filmed: CapturedField, row: dict[str, Any], *, fix: bool = False) -> dict[str, Any]:
    """Its report; what of it did not pass is noted."""
    report: dict[str, Any] = filmed.daemon.call("preflight.run", targets=filmed.one, fix=fix)["vehicles"][filmed.one]
    wrong = [finding for finding in report["findings"] if finding["verdict"] not in ("pass", "skipped")]
    row["not passed"] = {finding["check"]: finding["text"] for finding in wrong}
    return report


def verdicts(report: dict[str, Any]) -> dict[str, str]:
    return {finding["check"]: finding["verdict"] for finding in report["findings"]}


def set_up(filmed: CapturedField, row: dict[str, Any]) -> None:
    """Its parameters are those for poses; preflight sets them where they are not."""
    report = preflight(filmed, row)
    if verdicts(report)["external vision"] != "pass":
        preflight(filmed, row, fix=True)
        filmed.power_cut()


def prepared(filmed: CapturedField, row: dict[str, Any]) -> None:
    """Poses come, it has an origin, and its own checks and ours pass."""
    set_up(filmed, row)
    filmed.order("vehicles.mode", filmed.one, mode="AUTO.LOITER" if filmed.px4 else "GUIDED")  # one that arms
    row["poses s"] = filmed.wait(lambda: filmed.poses()["problem"] is None, 20, "poses go to it")
    row["ready s"] = filmed.wait(lambda: filmed.said("all are ready"), 120, "its estimator and its arming checks agree")
    report: dict[str, Any] = {}

    def passed() -> bool:
        report.update(preflight(filmed, row))
        return bool(report["ok"])

    row["preflight s"] = filmed.wait(passed, 30, "preflight passes")
    row["preflight"] = {check: verdicts(report)[check] for check in ("poses", "external vision", "ekf origin")}
    assert set(row["preflight"].values()) == {"pass"}, report


def flown(filmed: CapturedField, row: dict[str, Any]) -> None:
    """Up, 5 s of hover, and to a goal where it looks elsewhere."""
    name, cameras = filmed.one, filmed.cameras
    row["reported off at start m"] = off_m(filmed)
    east, north, up = cameras.enu_m  # of its centre
    filmed.order("vehicles.takeoff", name, height_m=UP_M, wait_s=60)
    row["hover off m"] = stands_at(filmed, (east, north, up + UP_M), 5.0)
    row["hover off enu m"] = [at - wanted for at, wanted in zip(cameras.enu_m, (east, north, up + UP_M), strict=True)]
    filmed.order("vehicles.goto", name, enu_m=list(GOAL_ENU_M), yaw_deg=HEADING_DEG)
    row["goal off m"] = stands_at(filmed, GOAL_ENU_M, 5.0)
    row["heading off deg"] = turned_deg(cameras.heading_deg, HEADING_DEG)
    row["reported off m"] = off_m(filmed)
    row["status"] = filmed.poses()
    near_m = NEAR_M[filmed.firmware]
    offsets = ("reported off at start m", "hover off m", "goal off m", "reported off m")
    assert all(row[what] < near_m for what in offsets), row
    assert row["heading off deg"] < NEAR_DEG, row
    assert row["status"]["sent_hz"] > 20


def landed(filmed: CapturedField, row: dict[str, Any]) -> None:
    place = filmed.cameras.enu_m
    filmed.order("vehicles.land", filmed.one)
    row["land s"] = filmed.wait(lambda: not filmed.truth(filmed.one).armed, 60, "it has landed and disarmed")
    row["landed off m"] = math.dist(filmed.cameras.enu_m[:2], place[:2])
    assert row["landed off m"] < NEAR_M[filmed.firmware], row


def shown(text: str, field: str) -> float:
    """A field's number in what PX4's listener prints."""
    found = re.search(rf"\b{field}: (-?\d+)", text)
    assert found is not None, text
    return float(found[1])


def stamped(filmed: CapturedField) -> dict[str, float]:
    """How late the last pose was by its stamp for a PX4's estimator, and how far its idea of our clock was from the
    last answer's."""
    pose, sync = filmed.listened("vehicle_visual_odometry"), filmed.listened("timesync_status")
    return {
        "late s": (shown(pose, "timestamp") - shown(pose, "timestamp_sample")) / 1e6,
        "clock off s": (shown(sync, "observed_offset") - shown(sync, "estimated_offset")) / 1e6,
        "round trip s": shown(sync, "round_trip_time") / 1e6,
        "offset s": shown(sync, "observed_offset") / 1e6,
    }


def test_preflight_sets_what_it_needs(filmed: CapturedField, row: dict[str, Any]) -> None:
    found = next(f for f in preflight(filmed, row)["findings"] if f["check"] == "external vision")
    row["found"] = found["text"]
    assert found["verdict"] == "fail" and not filmed.truth(filmed.one).armed
    report = preflight(filmed, row, fix=True)
    row["fixed"], row["unfixed"] = report["fixed"], report["unfixed"]
    filmed.power_cut()
    # after the start, from the vehicle
    answers = filmed.daemon.call("params.get", targets=filmed.one, names=list(NEEDED[filmed.firmware]))
    row["after a power cut"] = {name: answer.get("value") for name, answer in answers["outcomes"][filmed.one].items()}
    assert row["after a power cut"] == NEEDED[filmed.firmware], row
    row["finished"] = True


def test_it_flies_and_lands_by_poses(filmed: CapturedField, row: dict[str, Any]) -> None:
    prepared(filmed, row)
    name = filmed.one
    events = [event["text"] for event in filmed.watcher.events_since(0.0, vehicle=name)]
    row["origin events"] = [text for text in events if "origin" in text]
    flown(filmed, row)

    began = time.monotonic()
    filmed.cameras.hidden = True
    time.sleep(DROPOUT_S)
    filmed.cameras.hidden = False
    time.sleep(5.0)
    row["drop-out off m"] = max(math.dist(place, GOAL_ENU_M) for place in filmed.cameras.since(began))
    row["after drop-out"] = filmed.poses()
    events = [event["data"]["change"] for event in filmed.watcher.events_since(began, "mocap", vehicle=name)]
    assert events[:2] == ["lost", "back"], events  # a busy computer's cameras may be late once more
    assert filmed.truth(name).mode == ("LOITER" if filmed.px4 else "GUIDED")
    status = row["after drop-out"]
    before = row["status"]
    found = status["dropouts"] - before["dropouts"], status["reset_counter"] - before["reset_counter"]
    assert found == (1, 1), status
    assert row["drop-out off m"] < NEAR_M[filmed.firmware], row

    landed(filmed, row)
    row["finished"] = True


@pytest.mark.minutes
def test_it_flies_by_odometry(filmed: CapturedField, row: dict[str, Any]) -> None:
    filmed.wait_idle()
    filmed.send_as("odometry")
    try:
        prepared(filmed, row)
        assert filmed.status()["message"] == "odometry"
        flown(filmed, row)
        landed(filmed, row)
    finally:
        if not filmed.truth(filmed.one).armed:
            filmed.send_as("vision_position_estimate")
    row["finished"] = True


@pytest.mark.minutes
def test_it_lands_by_itself_when_poses_end(filmed: CapturedField, row: dict[str, Any]) -> None:
    filmed.wait_idle()
    prepared(filmed, row)
    name, cameras, truth = filmed.one, filmed.cameras, filmed.truth(filmed.one)
    place = cameras.enu_m
    filmed.order("vehicles.takeoff", name, height_m=UP_M, wait_s=60)
    stands_at(filmed, (place[0], place[1], place[2] + UP_M), 1.0)
    began = time.monotonic()
    mode = truth.mode
    cameras.hidden = True
    filmed.wait(lambda: truth.mode != mode, 60, "its own failsafe acts")
    row["acted after s"] = next(at for at, _ in truth.modes if at > began) - began
    row["drifted until then m"] = math.dist(cameras.enu_m, (place[0], place[1], place[2] + UP_M))
    row["landed after s"] = filmed.wait(lambda: not truth.armed, 90, "it has landed and disarmed")
    row["landed off m"] = math.dist(cameras.enu_m[:2], place[:2])
    row["texts"] = truth.texts_since(began)
    row["events"] = [
        f"{at - began:.2f} {event['kind']}: {event['text']}" for at, event in filmed.watcher.events if at > began
    ]
    row["state"] = {key: filmed.state(name)[key] for key in ("mode", "failsafe", "mocap")}
    assert filmed.poses()["sent_hz"] == 0
    assert verdicts(preflight(filmed, row))["poses"] == "fail"
    row["finished"] = True


@pytest.mark.minutes
@pytest.mark.only("px4")
def test_its_clock_follows_ours(filmed: CapturedField, row: dict[str, Any]) -> None:
    """Where PX4 asks for our time (by itself only on ports in MAVLink mode Onboard), it is answered, and takes time
    stamps by it once it is sure. The last scenario: on a busy computer its simulator's clock loses 14 ms/s, so that
    stamps are 24 ms off, and it wanders by 0.8 m in a hover."""
    filmed.wait(lambda: filmed.poses()["problem"] is None, 20, "poses go to it")
    filmed.order("vehicles.interval", filmed.one, message="TIMESYNC", rate_hz=10)
    filmed.wait(lambda: filmed.status()["timesync_answers"] > 10, 20, "its requests are answered")
    began, row["before"] = time.monotonic(), stamped(filmed)
    # 500 answers that agree, 50 s; until then it takes the time of arrival
    row["sure after s"] = filmed.wait(lambda: stamped(filmed)["late s"] != 0, 200, "it takes stamps by our clock")
    row["answers"] = filmed.status()["timesync_answers"]
    row["later"] = [stamped(filmed) for _ in range(10)]
    drifted_s = row["later"][-1]["offset s"] - row["before"]["offset s"]
    row["drift of its simulator's clock ms/s"] = 1000 * drifted_s / (time.monotonic() - began)
    assert all(abs(seen["late s"] - seen["clock off s"]) < STAMP_S for seen in row["later"]), row
    row["finished"] = True
