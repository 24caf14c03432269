"""Plans and returns flown by two PX4s and two ArduCopters in one fleet, from the ground to the landing. Before the
other files, which have one firmware each."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.plan.straight_flight import straight_trajectories
from skygcs.core.separation import DOWNWASH_RATIO, separation_m
from skygcs.core.trajectory import MotionLimits
from skygcs.ext.plans.certificates.certificate import Certificate
from skygcs.ext.plans.certificates.certify import certify
from skygcs.ext.plans.certificates.layered_flight import layered
from support.firmware_field import HOME, SPACING_M, TRACKING_ERROR_M, MixedField, available
from support.firmware_report import Report, Row
from support.planned import content

pytestmark = [pytest.mark.only("px4"), pytest.mark.minutes]

UP_M = 10.0
LIMITS = MotionLimits(speed_mps=2.0, acceleration_mps2=1.0, climb_mps=1.5, descent_mps=1.0)
KNOWN_M = 2 * (0.35 + 0.9)
"""Of a pair: half of each wingspan, and the errors of both positions. So far apart are vehicles by their own positions
that stay within their tubes."""

Vector = tuple[float, float, float]


@pytest.fixture(scope="module")
def fleet(report: Report, tmp_path_factory: pytest.TempPathFactory) -> Iterator[MixedField]:
    if not {"px4", "ardupilot"} <= set(available()):
        pytest.skip("both firmwares have to be named; `make test-firmware` says what to set")
    folder = tmp_path_factory.mktemp("mixed")
    field = MixedField(folder)
    try:
        field.start()
        yield field
    finally:
        field.stop()


@pytest.fixture
def row(request: pytest.FixtureRequest, fleet: MixedField, report: Report) -> Iterator[dict[str, Any]]:
    """What the scenario measured."""
    made = Row(request.node.nodeid.rpartition("/")[2], "failed")
    began = time.monotonic()
    yield made.figures
    made.seconds = time.monotonic() - began
    made.modes = {name: fleet.truth(name).modes_since(began) for name in fleet.names}
    if "finished" in made.figures:
        made.outcome = "passed"
    report.add(made)
    if any(fleet.truth(name).armed for name in fleet.names):
        fleet.daemon.call("vehicles.land", targets="all")
        fleet.wait(lambda: not any(fleet.truth(n).armed for n in fleet.names), 120, "all have landed")
    fleet.wait_idle()


def rule_of(fleet: MixedField) -> MarginRule:
    """As the fleet file has it."""
    errors = TRACKING_ERROR_M
    px4, copter = Uncertainty(tracking_error_m=errors["px4"]), Uncertainty(tracking_error_m=errors["ardupilot"])
    return MarginRule(by_vehicle={name: px4 if name.startswith("px") else copter for name in fleet.names})


def stands(fleet: MixedField) -> dict[str, Vector]:
    return {name: (i * SPACING_M, 0.0, UP_M) for i, name in enumerate(fleet.names)}


def crossing(fleet: MixedField) -> TimedPlan:
    """From a line to the east to a line to the north: the ways of each two neighbours cross, at different times."""
    starts = stands(fleet)
    goals = [(1.5 * SPACING_M, 10.0 * i + 3.0, UP_M) for i in range(len(starts))]
    ways = straight_trajectories(list(starts.values()), goals, LIMITS)
    return TimedPlan(dict(zip(starts, ways, strict=True)))


def swap(fleet: MixedField) -> Plan:
    """Every vehicle to the place of the one opposite, in layers: each PX4 with an ArduCopter."""
    places = list(stands(fleet).values())
    return _in_layers(fleet, places, places[::-1])


def swap_back(fleet: MixedField) -> Plan:
    """After `swap`, all to their own places again."""
    places = list(stands(fleet).values())
    return _in_layers(fleet, places[::-1], places)


def _in_layers(fleet: MixedField, starts: list[Vector], goals: list[Vector]) -> Plan:
    rule = rule_of(fleet)
    half = [rule.half_m(name) for name in fleet.names]
    space = FlightSpace(ceiling_m=55.0)
    found = layered(list(fleet.names), starts, goals, half, rule.downwash_ratio, space, 0.0)
    assert not isinstance(found, str), found
    return found[0]


def test_a_mixed_fleet_swaps_by_goto_and_back(fleet: MixedField, row: dict[str, Any]) -> None:
    """Each leg is one order; the autopilots fly their own paths between the places."""
    for make in (swap, swap_back):
        row[make.__name__] = {}
        _fly(fleet, row[make.__name__], make, 1.0, by="goto")
    _land(fleet)
    row["finished"] = True


GOES_ON = {
    "px4": {"NAV_DLL_ACT": 2, "COM_DLL_EXCEPT": 3},
    "ardupilot": {"FS_GCS_ENABLE": 1, "FS_OPTIONS": 18},
}
"""Return when no ground station is heard, but not on a mission."""


def abreast(fleet: MixedField) -> PhasedPlan:
    """All to the north, up and on, each on its own line: nobody needs to wait for anybody."""
    starts = stands(fleet)
    north = {name: (x, y + 15.0, up) for name, (x, y, up) in starts.items()}
    up = {name: (x, y, UP_M + 4.0) for name, (x, y, _) in north.items()}
    on = {name: (x, y + 12.0, z) for name, (x, y, z) in up.items()}
    return PhasedPlan(starts, (Phase("north", north), Phase("up", up), Phase("on", on)))


def test_a_mixed_fleet_flies_missions_and_losing_the_ground_loses_nothing(
    fleet: MixedField, row: dict[str, Any]
) -> None:
    """The daemon is killed on the way: all come to their goals in its absence, each leg rested at its end."""
    plan, began = abreast(fleet), time.monotonic()
    before = {name: _param_values(fleet, name) for name in fleet.names}
    for name in fleet.names:
        _set_params(fleet, name, GOES_ON[_family(name)])
    fleet.daemon.call("plan.load", plan=content(plan), name="abreast")
    answer = fleet.daemon.call("plan.run", by="onboard", set_return_heights=True, force=True)
    assert answer["started"], [f for f in answer["report"]["findings"] if f["severity"] == "refused"]
    assert answer["report"]["by"] == "mission"
    certificate = answer["report"]["certificate"]
    fleet.wait(lambda: fleet.daemon.call("plan.status")["state"] in ("flying", "stopped"), 200, "they fly")
    fleet.wait(lambda: all(_now(fleet, name)[1] > 5.0 for name in fleet.names), 60, "all are on their ways")
    killed = time.monotonic()
    fleet.daemon.kill()
    goals = plan.legs()[-1][1]

    def there() -> bool:
        return all(_apart_m(_now(fleet, name), goals[name][1]) < 2.0 for name in fleet.names)

    row["there after s"] = fleet.wait(there, 120, "all are at their goals")
    time.sleep(20.0)  # twice COM_DL_LOSS_T; FS_GCS_TIMEOUT is 5 s
    row["modes without the ground"] = {name: sorted(set(fleet.truth(name).modes_since(killed))) for name in fleet.names}
    assert there(), row
    least = _least(fleet, killed)
    row["measured_least_m"] = round(min(least.values()), 2)
    row["certified_least_m"] = round(certificate["closest"]["flown_at_least_m"], 2)
    row["references_least_m"] = round(certificate["closest"]["distance_m"], 2)
    row["seconds"] = [round(killed - began, 1), round(time.monotonic() - began, 1)]
    assert row["measured_least_m"] >= row["certified_least_m"] > 0.0, row
    fleet.daemon.start()
    fleet.wait(fleet.connected, 30, "all are heard again")
    fleet.order("vehicles.land", "all")
    fleet.wait(lambda: not any(fleet.truth(n).armed for n in fleet.names), 120, "all have landed")
    for name, values in before.items():
        _set_params(fleet, name, values)
    row["finished"] = True


def test_a_mixed_fleet_flies_a_plan_from_the_ground_and_one_from_the_air(
    fleet: MixedField, row: dict[str, Any]
) -> None:
    for make, speed in ((crossing, 1.0), (swap, 0.5)):
        row[make.__name__] = {}
        _fly(fleet, row[make.__name__], make, speed, by="setpoints")
    _land(fleet)
    row["finished"] = True


def test_a_mixed_fleet_flies_as_a_formation(fleet: MixedField, row: dict[str, Any]) -> None:
    """About a point, which moves while the formation turns and grows; then behind one of them."""
    fleet.daemon.call("vehicles.takeoff", targets="all", height_m=UP_M)
    fleet.wait(lambda: all(fleet.truth(n).track[-1][3] > UP_M - 1.5 for n in fleet.names), 60, "all have taken off")
    time.sleep(5.0)
    began = time.monotonic()
    fleet.daemon.call("formation.start", targets="all", shape="v", spacing_m=11.0)
    _settled(fleet)
    moves = began, time.monotonic()
    for method, params in (
        ("formation.move", {"to_enu_m": [25.0, 25.0, 20.0]}),
        ("formation.turn", {"heading_deg": 90.0}),
        ("formation.scale", {"factor": 1.2}),
    ):
        fleet.daemon.call(method, **params)
    row["rms_m"] = _settled(fleet)
    fleet.daemon.call("formation.stop")
    fleet.wait(lambda: fleet.daemon.call("formation.status")["state"] == "stopped", 20, "the formation stands")
    leader, *followers = fleet.names[::-1]
    fleet.daemon.call(
        "formation.start", targets=followers, shape="line", spacing_m=11.0, heading_deg=90.0, leader=leader
    )
    _settled(fleet)
    fleet.daemon.call("vehicles.goto", targets=leader, enu_m=[10.0, 45.0, 15.0])
    time.sleep(3.0)
    row["rms_behind_m"] = _settled(fleet)
    row["seconds"] = [round(at - began, 1) for at in (*moves, time.monotonic())]
    least = _least(fleet, began)
    nearest = min(least, key=lambda pair: least[pair])
    row["measured_least_m"], row["measured_pair"] = round(least[nearest], 2), list(nearest)
    row["least_by_pair_m"] = {" ".join(pair): round(least_m, 2) for pair, least_m in least.items()}
    assert least[nearest] >= KNOWN_M, row
    row["finished"] = True


def test_a_mixed_fleet_returns_by_an_order_for_each(fleet: MixedField, row: dict[str, Any]) -> None:
    """Two of each firmware have changed places, and each is ordered alone, a second after the one before."""
    _change_places(fleet)
    began = time.monotonic()
    row["answers"] = {}
    for name in fleet.names:
        row["answers"][name] = fleet.order("vehicles.rtl", name)[name]["message"]
        time.sleep(1.0)
    assert any("returns then" in text for text in row["answers"].values()), row
    _come_home(fleet, row, began, *fleet.names)
    climbed = {text.split()[0] for text in row["said"] if "it climbs" in text}
    assert not any(climbed.issuperset(pair) for pair in (fleet.names[:2], fleet.names[2:])), "one above the other"
    row["finished"] = True


def test_one_returns_past_what_hovers_and_what_is_parked(fleet: MixedField, row: dict[str, Any]) -> None:
    """The one whose home is taken waits until the other has gone; one that stands beside its home keeps nobody up."""
    for returns, hovers in (fleet.names[:2], fleet.names[:1:-1]):
        (home, _, _), (stand, _, _) = stands(fleet)[returns], stands(fleet)[hovers]
        _takes_off(fleet, (returns, hovers))
        _goes(fleet, returns, (home, 15.0, UP_M))
        _goes(fleet, hovers, (home, 0.0, UP_M))
        began = time.monotonic()
        waits = fleet.order("vehicles.rtl", returns)[returns]["message"]
        assert hovers in waits and "ordered again" in waits, waits
        time.sleep(10.0)
        assert _now(fleet, returns)[2] > UP_M / 2, "it waits in the air"
        _goes(fleet, hovers, (home + (stand - home) / 2, 0.0, UP_M))
        fleet.order("vehicles.land", hovers)
        row[returns] = [waits]
        _come_home(fleet, row, began, returns)
        # beside one that stands 5 m from its home
        _takes_off(fleet, (returns,))
        _goes(fleet, returns, (home, 15.0, UP_M))
        began = time.monotonic()
        row[returns].append(fleet.order("vehicles.rtl", returns)[returns]["message"])
        assert row[returns][-1] == "returning to launch", row
        _come_home(fleet, row, began, returns)
        # back to where the next scenario begins
        _takes_off(fleet, (hovers,))
        _goes(fleet, hovers, (stand, 0.0, UP_M))
        _lands(fleet, hovers)
    row["finished"] = True


def _takes_off(fleet: MixedField, names: Sequence[str]) -> None:
    fleet.wait_idle(*names)
    fleet.order("vehicles.takeoff", names, height_m=UP_M, wait_s=60)
    fleet.wait(lambda: all(fleet._is_up(name, UP_M) for name in names), 90, f"{names} are up")


def _goes(fleet: MixedField, name: str, place: Vector) -> None:
    fleet.order("vehicles.goto", name, enu_m=list(place), force=True)
    fleet.wait(lambda: math.dist(_now(fleet, name), place) < 1.5, 60, f"{name} is at {place}")


def _lands(fleet: MixedField, name: str) -> None:
    fleet.order("vehicles.land", name)
    fleet.wait(lambda: not fleet.truth(name).armed, 60, f"{name} has landed")


def _change_places(fleet: MixedField) -> None:
    """Each above the home of the other of its firmware."""
    places = stands(fleet)
    _takes_off(fleet, fleet.names)
    for one, other in (fleet.names[:2], fleet.names[2:]):
        _goes(fleet, other, (places[other][0], 8.0, UP_M))
        _goes(fleet, other, (places[one][0], 8.0, UP_M))
        _goes(fleet, one, places[other])
        _goes(fleet, other, places[one])


def _come_home(fleet: MixedField, row: dict[str, Any], since: float, *names: str) -> None:
    """Until all are down: ``names`` at their homes, and none was too near another."""
    fleet.wait(lambda: not any(fleet.truth(n).armed for n in fleet.names), 400, "all are down")
    row.setdefault("home s", []).append(round(time.monotonic() - since, 1))
    row.setdefault("least m", []).append(round(min(_least(fleet, since).values()), 2))
    said = fleet.watcher.events_since(since, "command")
    row["said"] = row.get("said", []) + [f"{e['vehicle']} {e['text'][:70]}" for e in said if "rtl: it " in e["text"]]
    homes = {name: fleet.state(name)["home"] for name in names}
    away = {name: fleet.truth(name).metres_from(home["lat_deg"], home["lon_deg"]) for name, home in homes.items()}
    assert row["least m"][-1] > KNOWN_M and max(away.values()) < 4.0, (row, away)


def _family(name: str) -> str:
    return "px4" if name.startswith("px") else "ardupilot"


def _param_values(fleet: MixedField, name: str) -> dict[str, float]:
    found = fleet.daemon.call("params.get", targets=name, names=list(GOES_ON[_family(name)]))
    return {param: value["value"] for param, value in found["outcomes"][name].items()}


def _set_params(fleet: MixedField, name: str, values: Mapping[str, float]) -> None:
    fleet.daemon.call("params.set", targets=name, params=dict(values), force=True)


def _now(fleet: MixedField, name: str) -> Vector:
    return _place(fleet.truth(name).track[-1])


def _settled(fleet: MixedField) -> float:
    """Until all are at their places; the largest RMS of their distances from them on the way."""
    most_m = 0.0

    def settled() -> bool:
        nonlocal most_m
        status = fleet.daemon.call("formation.status")
        assert status["state"] == "flying", status["reason"]
        if math.hypot(*status["vel_enu_mps"]) > 0.5:
            most_m = max(most_m, status["rms_m"] or 0.0)
        return bool(status["settled"])

    fleet.wait(settled, 120, "the formation is settled")
    return most_m


def _land(fleet: MixedField) -> None:
    fleet.daemon.call("plan.land")
    fleet.wait(lambda: not any(fleet.truth(n).armed for n in fleet.names), 200, "all have landed")
    fleet.wait(lambda: fleet.daemon.call("plan.status")["state"] == "landed", 20, "the plan has landed")


def _fly(fleet: MixedField, row: dict[str, Any], make: Any, speed: float, by: str) -> None:
    plan = make(fleet)
    certificate = certify(plan, rule_of(fleet), FlightSpace())
    assert certificate.certified and certificate.closest is not None, certificate.reasons()
    fleet.daemon.call("plan.load", plan=content(plan), name=make.__name__)
    began = time.monotonic()
    answer = fleet.daemon.call("plan.run", mode="position", by=by, speed=speed, set_return_heights=True, force=True)
    report = answer["report"]
    assert answer["started"], [f for f in report["findings"] if f["severity"] == "refused"]
    row["return_heights_m"] = {name: now[0] for name, now in report["return_heights"].items()}
    over = ("finished", "stopped", "aborted", "landed")
    errors: dict[str, float] = dict.fromkeys(fleet.names, 0.0)
    seen: list[str] = []

    def ended() -> bool:
        status = fleet.daemon.call("plan.status")
        if not seen or seen[-1] != status["state"]:
            seen.append(status["state"])
        if status["state"] == "flying":
            for vehicle in status["vehicles"]:
                errors[vehicle["vehicle"]] = max(errors[vehicle["vehicle"]], vehicle["error_m"] or 0.0)
        return status["state"] in over

    fleet.wait(ended, 400, "the plan ends")
    status = fleet.daemon.call("plan.status")
    row |= {"states": seen, "seconds": round(time.monotonic() - began, 1), "reason": status["reason"]}
    row["most_off_m"] = {name: round(error, 2) for name, error in errors.items()}
    if "flying" in seen:
        _compare(fleet, row, certificate, began)
    assert status["state"] == "finished", status["reason"]


def _compare(fleet: MixedField, row: dict[str, Any], certificate: Certificate, since: float) -> None:
    """What was measured with what was certified: how far apart two vehicles stay, by their own positions, that stay
    within their tubes about references that come as near as this (`Approach.flown_at_least_m`)."""
    closest = certificate.closest
    assert closest is not None and closest.flown_at_least_m is not None
    least = {pair: least_m for pair, least_m in _least(fleet, since).items()}
    nearest = min(least, key=lambda pair: least[pair])
    row["references_least_m"] = round(closest.distance_m, 2)
    row["certified_least_m"] = round(closest.flown_at_least_m, 2)
    row["certified_margin_m"] = round(closest.margin_m, 2)
    row["certified_pair"] = list(closest.vehicles)
    row["measured_least_m"] = round(least[nearest], 2)
    row["measured_pair"] = list(nearest)
    row["least_by_pair_m"] = {" ".join(pair): round(least_m, 2) for pair, least_m in least.items()}
    assert least[nearest] >= closest.flown_at_least_m >= KNOWN_M, row


def _least(fleet: MixedField, since: float) -> Mapping[tuple[str, str], float]:
    """The least distance of each pair by their own positions, carried together in time, in the downwash metric."""
    tracks = {name: [p for p in fleet.truth(name).track if p[0] >= since] for name in fleet.names}
    found: dict[tuple[str, str], float] = {}
    for i, a in enumerate(fleet.names):
        for b in fleet.names[i + 1 :]:
            found[a, b] = min(_apart_m(_place(one), _at(tracks[b], one[0])) for one in tracks[a])
    return found


def _apart_m(a: Vector, b: Vector) -> float:
    return separation_m(a[0] - b[0], a[1] - b[1], a[2] - b[2], DOWNWASH_RATIO)


def _at(track: list[tuple[float, float, float, float]], at: float) -> Vector:
    """Between the two positions around this time."""
    later = next((n for n, point in enumerate(track) if point[0] >= at), len(track) - 1)
    before, after = track[max(0, later - 1)], track[later]
    share = 0.0 if after[0] <= before[0] else min(1.0, max(0.0, (at - before[0]) / (after[0] - before[0])))
    p, q = _place(before), _place(after)
    return p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2])


def _place(point: tuple[float, float, float, float]) -> Vector:
    _, lat_deg, lon_deg, height_m = point
    east_m = (lon_deg - HOME[1]) * math.cos(math.radians(HOME[0])) * 111_319.5
    return east_m, (lat_deg - HOME[0]) * 111_132.0, height_m
