"""The task of the monitor: it goes on after a fault, gives others their turn, and is bounded. On both event loops."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.config.models import FleetConfig
from skygcs.core.geo import EnuFrame
from skygcs.core.mission.item import MissionItem
from skygcs.core.monitor.mission_ways import MissionRun
from skygcs.core.vehicle.frames import Setpoint
from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.separation_monitor import SHARE, SeparationMonitor
from skygcs.runtime.vehicle_ways import FIELDS
from support.services import KnownLinks
from support.vehicles import flight_dialect
from support.watched_fleet import ORIGIN, VehicleOfFleet, WatchedVehicle

pytestmark = pytest.mark.looptime


class Sky:
    """A fleet that hears vehicles made of frames."""

    def __init__(self, count: int, mode: str = "acting") -> None:
        self.loop = asyncio.get_running_loop()
        self.events: list[Event] = []
        config = FleetConfig.model_validate({"monitor": {"mode": mode}})
        self.fleet = Fleet(config, flight_dialect(), self._send, self.loop, self.events.append, links=KnownLinks())
        self.sent = 0
        self.vehicles = [VehicleOfFleet(i + 1, self.fleet) for i in range(count)]

    def _send(self, *_: Any, **__: Any) -> bool:
        self.sent += 1
        return True

    @property
    def monitor(self) -> SeparationMonitor:
        return self.fleet.monitor


async def crowd(sky: Sky, seconds: float) -> None:
    """All of them at one place, in the air."""
    end = sky.loop.time() + seconds
    while sky.loop.time() < end:
        now = sky.loop.time()
        for i, vehicle in enumerate(sky.vehicles):
            vehicle.heartbeat(now)
            vehicle.position(now, (0.01 * i, 0.0, 20.0))
        await asyncio.sleep(0.5)


async def test_the_missions_of_some_fields_stay_made_while_orders_come_to_them_in_turn() -> None:
    ways = Sky(1).monitor.ways

    def place(field: int, east_deg: float = 0.0) -> Any:
        return SimpleNamespace(here=(43.78 + 0.2 * field, -79.46 + east_deg, 0.0))

    frames = [ways.frame_of(place(field)) for field in range(FIELDS)]
    for field, frame in [*enumerate(frames), *enumerate(frames)]:
        assert ways.frame_of(place(field, 0.05)) is frame
    for field in range(50):
        ways.frame_of(place(field))
    assert len(ways._fields) == FIELDS


async def test_a_full_fleet_at_one_place_is_evaluated_in_turns_and_bounded() -> None:
    sky = Sky(250)
    await crowd(sky, 0.1)
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    busy = asyncio.create_task(other())
    await sky.monitor.evaluate()
    busy.cancel()  # before time goes on: while it is never idle, virtual time stands
    assert turns > 20, "others had their turn many times during one evaluation"
    watch = asyncio.create_task(sky.monitor.run(), name="monitor")
    await crowd(sky, 1.5)
    status = sky.monitor.status()
    assert status["watched"] == 250 and len(status["conflicts"]) <= 250 * 8
    assert status["counters"]["pairs_dropped"] > 0
    assert sky.monitor.took_s / SHARE > 0
    watch.cancel()
    sky.fleet.close()


async def test_the_reports_of_a_crowd_are_published_in_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skygcs.runtime.task_set.TURN_S", 0.0)
    sky = Sky(60)
    turns, at = 0, list[int]()

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    monkeypatch.setattr(sky.monitor, "_on_event", lambda event: at.append(turns))
    end = sky.loop.time() + 4.0
    while sky.loop.time() < end and not at:
        await crowd(sky, 0.4)
        busy = asyncio.create_task(other())
        await sky.monitor.evaluate()
        busy.cancel()
    assert len(at) > 200 and at[-1] - at[0] > 100, "others had their turn between the events"
    sky.fleet.close()


async def test_a_fault_is_reported_once_and_the_watch_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    sky = Sky(2)
    await crowd(sky, 0.5)
    whole, faults = sky.monitor.monitor.evaluate, 0

    def broken(*_: Any) -> Iterator[None]:
        nonlocal faults
        faults += 1
        raise ZeroDivisionError("of ours")

    monkeypatch.setattr(sky.monitor.monitor, "evaluate", broken)
    watch = asyncio.create_task(sky.monitor.run())
    await asyncio.sleep(3.0)
    assert faults > 5
    assert [e.text for e in sky.events if e.kind == "fault"] == [
        "the monitor failed inside skygcs: ZeroDivisionError('of ours')"
    ]
    monkeypatch.setattr(sky.monitor.monitor, "evaluate", whole)
    await crowd(sky, 4.0)
    assert any(e.kind == "separation" for e in sky.events)
    watch.cancel()
    sky.fleet.close()


async def test_vehicles_that_are_forgotten_while_they_are_looked_at_leave_nothing_behind() -> None:
    sky = Sky(20)
    watch = asyncio.create_task(sky.monitor.run())
    await crowd(sky, 4.0)
    assert sky.monitor.status()["conflicts"]
    sky.fleet.forget("all", force=True)
    await asyncio.sleep(2.0)
    assert sky.monitor.monitor.pairs == {} and sky.monitor.status()["watched"] == 0
    assert not [e for e in sky.events if e.kind == "fault"]
    watch.cancel()
    sky.fleet.close()


async def mission_meets(sky: Sky, vehicle: WatchedVehicle, east_m: float, up_m: float = 50.0) -> bool:
    """True if its mission to a place so high above the ground is refused."""
    lat_deg, lon_deg, _ = vehicle.geodetic_of(east_m, 0.0, 0.0)
    alt_amsl_m = vehicle.geodetic_of(0.0, 0.0, up_m)[2]
    there = MissionItem.from_params(16, 0, (0.0, 0.0, 0.0, 0.0, lat_deg, lon_deg, alt_amsl_m), True)
    actor = sky.fleet.find(f"v{vehicle.vehicle.sysid}")
    return actor in await sky.monitor.mission_refusals({actor: MissionRun([there])})


async def seen(sky: Sky, *, mode: int, vel_enu_mps: tuple[float, float, float]) -> None:
    """The first vehicle is a plane in this mode, the second one a copter 400 m west of it; the monitor knows both."""
    plane, copter = sky.vehicles
    for _ in range(4):
        now = sky.loop.time()
        plane.heartbeat(now, kind=1, mode=mode)
        plane.position(now, (0.0, 0.0, 50.0), vel_enu_mps)
        copter.heartbeat(now)
        copter.position(now, (-400.0, 0.0, 50.0))
        await sky.monitor.evaluate()
        await asyncio.sleep(0.5)


async def test_a_mission_does_not_lead_low_over_one_that_is_parked() -> None:
    """It was compared where it lands only (random flight 1238): at 3 m it flew over others on their pads."""
    sky = Sky(2)
    flies, parked = sky.vehicles
    for up_m, refused in ((4.5, True), (5.5, False)):
        now = sky.loop.time()
        for vehicle, east_m in ((flies, 0.0), (parked, 50.0)):
            vehicle.heartbeat(now, armed=vehicle is flies)
            vehicle.position(now, (east_m, 0.0, up_m if vehicle is flies else 0.0))
        await sky.monitor.evaluate()
        assert await mission_meets(sky, flies, 100.0, up_m) is refused, up_m
    sky.fleet.close()


async def test_a_mission_that_is_begun_counts_for_its_own_order_only() -> None:
    """It counted again during each later order to that vehicle, as no other one had been checked meanwhile."""
    sky = Sky(2)
    one, other = sky.vehicles
    now = sky.loop.time()
    for vehicle, north_m in ((one, 0.0), (other, 30.0)):
        vehicle.heartbeat(now)
        vehicle.position(now, (0.0, north_m, 50.0))
    await sky.monitor.evaluate()
    place, asked = EnuFrame(ORIGIN).to_geodetic(60.0, -30.0, 50.0), sky.fleet.find("v2").vehicle
    ledger = sky.fleet.find("v1").runner.ledger

    def crosses() -> bool:
        return sky.monitor.goto_refusal(asked, place, frozenset()) is not None

    assert not await mission_meets(sky, one, 100.0)
    assert crosses(), "it is about to begin"
    number = ledger.begins("mission", 1, ends_flight=False)
    assert crosses(), "it begins"
    ledger.ended(number, None)
    ledger.begins("hold", 2, ends_flight=False)
    assert not crosses(), "it was ordered something else"
    sky.fleet.close()


async def test_a_mission_keeps_two_radii_from_a_plane_that_circles_about_an_unknown_place() -> None:
    """As goto and take-off: it may be on any side of the middle of its circle."""
    sky = Sky(2)
    _, copter = sky.vehicles
    await seen(sky, mode=12, vel_enu_mps=(12.0, 0.0, 0.0))
    assert [await mission_meets(sky, copter, away_m) for away_m in (-60.0, -130.0, -170.0)] == [True, True, False]
    sky.fleet.close()


async def test_a_plane_that_circles_where_it_was_sent_counts_there_alone() -> None:
    """A copter's goto 55 m outside of its circle was refused half of the time, for the doubled circle about it."""
    sky = Sky(2)
    plane, copter = sky.vehicles
    frame = EnuFrame(ORIGIN)
    await seen(sky, mode=15, vel_enu_mps=(0.0, 12.0, 0.0))
    actor = sky.fleet.vehicles[plane.vehicle.key]
    circle_m = actor.vehicle.hold_reach_m(sky.loop.time())
    sky.monitor.ways.arriving(
        actor, sky.monitor.ways.sent_to(actor, frame.to_geodetic(circle_m - 5.0, 0.0, 50.0)), ok=True
    )
    place = frame.to_geodetic(-70.0, 0.0, 50.0)
    assert sky.monitor.goto_refusal(sky.fleet.vehicles[copter.vehicle.key].vehicle, place, frozenset()) is None
    sky.fleet.close()


@pytest.mark.parametrize(("sent", "refused"), [(False, False), (True, True)])
async def test_what_hovers_and_was_sent_nowhere_does_not_speed_up_by_its_noise(sent: bool, refused: bool) -> None:
    """With 0.3 m/s of noise and 5 m apart a goto was refused in 19 of 100 cases, and a single return waited in 10."""
    sky = Sky(2)
    place = EnuFrame(ORIGIN).to_geodetic(0.0, 40.0, 20.0)
    for east_mps in (-0.4, 0.4):
        now = sky.loop.time()
        for vehicle, x in zip(sky.vehicles, (0.0, 4.5), strict=True):
            vehicle.heartbeat(now)
            vehicle.position(now, (x, 0.0, 20.0), (east_mps if x == 0.0 else 0.0, 0.0, 0.0))
        await sky.monitor.evaluate()
        await asyncio.sleep(0.2)
    actor = next(iter(sky.fleet.vehicles.values()))
    if sent:
        sky.monitor.ways.arriving(
            actor, sky.monitor.ways.sent_to(actor, EnuFrame(ORIGIN).to_geodetic(30.0, 0.0, 20.0)), ok=True
        )
    assert (sky.monitor.goto_refusal(actor.vehicle, place, frozenset()) is not None) is refused
    sky.fleet.close()


@pytest.mark.parametrize("sent", [False, True])
async def test_a_stream_does_not_lead_to_where_another_will_stand(sent: bool) -> None:
    """It flew on past there for the check, until it stood 1.7 m in front of the other (random flight 2010)."""
    sky = Sky(2)
    now, frame, (one, other) = sky.loop.time(), EnuFrame(ORIGIN), sky.vehicles
    for vehicle, at, velocity in ((one, (0.0, 0.0, 20.0), (0.0,) * 3), (other, (4.5, 4.0, 20.0), (0.0, -8.0, 0.0))):
        vehicle.heartbeat(now)
        vehicle.position(now, at, velocity)
    await sky.monitor.evaluate()
    actor, beside = sky.fleet.vehicles[one.vehicle.key], sky.fleet.vehicles[other.vehicle.key]
    if sent:
        to = frame.to_geodetic(4.5, 0.0, 20.0)
        sky.monitor.ways.arriving(beside, sky.monitor.ways.sent_to(beside, to), ok=True)
    wanted = Setpoint(vel_enu_mps=(1.3, 0.0, 0.0))
    assert (sky.monitor.setpoint_refusal(actor.vehicle, wanted, frozenset()) is not None) is sent
    sky.fleet.close()


@pytest.mark.parametrize(("east_mps", "refused"), [(3.0, False), (5.0, True)])
async def test_a_goto_that_is_given_again_counts_no_turn_beyond_where_it_stops_anyway(
    east_mps: float, refused: bool
) -> None:
    """1.5 m before its place, 3 m before another vehicle: with 3 m/s it brakes, with 5 m/s it cannot have begun to."""
    sky = Sky(2)
    frame, place = EnuFrame(ORIGIN), (1.6, 0.0, 20.0)
    now, (one, other) = sky.loop.time(), sky.vehicles
    for vehicle, at, velocity in ((one, (0.0, 0.0, 20.0), (east_mps, 0.0, 0.0)), (other, (4.6, 0.0, 20.0), (0.0,) * 3)):
        vehicle.heartbeat(now)
        vehicle.position(now, at, velocity)
    await sky.monitor.evaluate()
    actor, to = sky.fleet.vehicles[one.vehicle.key], frame.to_geodetic(*place)
    assert sky.monitor.goto_refusal(actor.vehicle, to, frozenset()) is not None, "nobody knows where it flies"
    sky.monitor.ways.arriving(actor, sky.monitor.ways.sent_to(actor, to), ok=True)
    assert (sky.monitor.goto_refusal(actor.vehicle, to, frozenset()) is not None) is refused
    sky.fleet.close()


@pytest.mark.parametrize(
    ("one_mps", "other_mps", "refused"), [(4.8, 0.0, True), (4.8, 4.5, False), (0.6, -0.6, False), (-4.8, 0.0, False)]
)
async def test_one_goto_of_several_counts_how_those_brake_that_do_not_fly_alike(
    one_mps: float, other_mps: float, refused: bool
) -> None:
    """One at 4.8 m/s was sent elsewhere together with another 8 m before it, and flew to it first (flight 1110)."""
    sky = Sky(2)
    now = sky.loop.time()
    for vehicle, x, mps in zip(sky.vehicles, (0.0, 8.0), (one_mps, other_mps), strict=True):
        vehicle.heartbeat(now)
        vehicle.send("HOME_POSITION", now, latitude=437806000, longitude=-794653000, altitude=180000)
        vehicle.position(now, (x, 0.0, 20.0), (mps, 0.0, 0.0))
    await sky.monitor.evaluate()
    actors = list(sky.fleet.vehicles.values())
    for force in (False, True):
        where = {"lat_deg": 43.7816, "lon_deg": -79.4653, "height_m": 20.0, "force": force}
        staying = sky.fleet.orders._going(actors, where)[1]
        assert bool(staying) is (refused and not force), staying
        assert all("before it has turned" in why for why in staying.values()), staying
    sky.fleet.close()


@pytest.mark.parametrize(("beside_m", "meets"), [(60.0, True), (100.0, False)])
async def test_the_mission_of_a_quadplane_circles_though_it_stands_in_a_mode_of_its_rotors(
    beside_m: float, meets: bool
) -> None:
    """In QLOITER it hovers now; its mission is flown as a plane, with circles of 60 m by default."""
    sky = Sky(2)
    quadplane, copter = sky.vehicles
    for _ in range(4):
        now = sky.loop.time()
        quadplane.heartbeat(now, kind=1, mode=19)
        quadplane.position(now, (0.0, 0.0, 0.0))
        copter.heartbeat(now)
        copter.position(now, (400.0, beside_m, 50.0))
        await sky.monitor.evaluate()
        await asyncio.sleep(0.5)
    assert await mission_meets(sky, quadplane, 400.0) is meets
    sky.fleet.close()


async def test_off_ends_at_once_and_every_order_passes() -> None:
    sky = Sky(2, "off")
    await asyncio.wait_for(sky.monitor.run(), 1.0)
    await crowd(sky, 1.0)
    vehicle = sky.fleet.find("v1").vehicle
    assert sky.monitor.goto_refusal(vehicle, (43.78, -79.46, 200.0), frozenset()) is None
    assert sky.monitor.takeoff_refusal(vehicle, 10.0) is None
    sky.fleet.close()


async def test_of_a_fleet_that_takes_off_only_the_ways_nearby_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each take-off was compared with the ways of all: 30 ms of the loop for each of 250."""
    sky = Sky(100)
    now, frame, made = sky.loop.time(), EnuFrame(ORIGIN), list[str]()
    for n, vehicle in enumerate(sky.vehicles):
        vehicle.heartbeat(now)
        vehicle.position(now, (5.0 * (n % 10), 5.0 * (n // 10), 20.0))
    await sky.monitor.evaluate()
    for n, actor in enumerate(sky.fleet.vehicles.values()):
        sky.monitor.ways.sent_to(actor, frame.to_geodetic(5.0 * (n % 10), 5.0 * (n // 10), 40.0))
    real = sky.monitor.ways._present_way
    monkeypatch.setattr(
        sky.monitor.ways, "_present_way", lambda actor, *a, **k: made.append(actor.name) or real(actor, *a, **k)
    )
    vehicle = sky.fleet.find("v1").vehicle
    assert sky.monitor.goto_refusal(vehicle, frame.to_geodetic(0.0, 0.0, 40.0), frozenset()) is None and made == []
    assert sky.monitor.goto_refusal(vehicle, frame.to_geodetic(3.0, 0.0, 30.0), frozenset()) is not None
    assert len(made) == 1
    sky.fleet.close()
