"""What is looked at before a plan is flown: nothing moves, parameters are read."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from skygcs.core.geo import EnuFrame
from skygcs.core.mavlink.modes import is_copter
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.plan.flight_findings import (
    DEFAULT_FLIGHT_TIME_S,
    DEFAULT_RESERVE_PERCENT,
    Finding,
    FlightTime,
    Level,
    ReturnHeight,
    battery_finding,
)
from skygcs.core.plan.flight_record import FlightRecord
from skygcs.core.plan.margins import DEFAULT, MarginRule
from skygcs.core.radio_link.capacity import FRAME_BYTES
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle import offboard_entry
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.runtime import fleet_margins
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.plan_flight import measured_place
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import VehicleLinks

POSITION_FRESH_S = 3.0
"""A vehicle whose position is older is not measured."""

GPS_FIX_3D = 3

PREFLIGHT_READERS = 3
"""Vehicles whose parameters are read at the same time."""

MOVING_MPS = 0.7
"""Faster than a vehicle drifts that holds."""

STREAMED = "SET_POSITION_TARGET_LOCAL_NED"

Places = dict[str, Vector]


class Measured(NamedTuple):
    """Where the vehicles of the plan and all others are, in the frame of the plan."""

    places: Places
    grounded: frozenset[str]
    others: Places
    findings: list[Finding]


def measure(actors: Sequence[VehicleActor], everybody: Iterable[VehicleActor], frame: EnuFrame, now: float) -> Measured:
    """The places; findings name what cannot be measured."""
    places: Places = {}
    grounded: set[str] = set()
    findings: list[Finding] = []
    for actor in actors:
        place, age_s, _ = measured_place(actor.vehicle, frame, now)
        why = _why_unplaced(actor.vehicle, place, age_s)
        if why is None and place is not None:
            places[actor.name] = place
            findings.append(Finding(actor.name, "position", Level.OK, f"known, {age_s:.1f} s old"))
            if not is_flying(actor.vehicle, now):
                grounded.add(actor.name)
        else:
            findings.append(Finding(actor.name, "position", Level.REFUSED, why or "", "wait for GPS, check its link"))
    taking_part = {actor.vehicle.key for actor in actors}
    others: Places = {}
    for actor in everybody:
        if actor.vehicle.key not in taking_part and not actor.vehicle.replayed:
            findings += _other(actor, frame, now, others)
    return Measured(places, frozenset(grounded), others, findings)


def _why_unplaced(vehicle: Vehicle, place: Vector | None, age_s: float) -> str | None:
    if place is None:
        return "its position is not known"
    if age_s > POSITION_FRESH_S:
        return f"its position is {age_s:.0f} s old"
    gps = vehicle.telemetry("gps")
    if gps is not None and gps["fix_type"] < GPS_FIX_3D:
        return f"its GPS has no fix ({gps['fix_type']})"
    return None


def _other(actor: VehicleActor, frame: EnuFrame, now: float, others: Places) -> list[Finding]:
    """A vehicle that takes no part: an obstacle where it was measured."""
    check = "others"
    place, age_s, speed_mps = measured_place(actor.vehicle, frame, now)
    flies = is_flying(actor.vehicle, now)
    if place is None:
        if not flies:
            return []
        text, todo = "it flies, takes no part, and its position is not known", "wait until it is heard, or land it"
        return [Finding(actor.name, check, Level.REFUSED, text, todo, insist=True)]
    others[actor.name] = place
    where = ", ".join(f"{v:.1f}" for v in place)
    if not flies:
        return [Finding(actor.name, check, Level.OK, f"it takes no part and is an obstacle at ({where})")]
    if age_s > POSITION_FRESH_S or speed_mps > MOVING_MPS:
        text = (
            f"it takes no part and {'is silent' if age_s > POSITION_FRESH_S else f'flies with {speed_mps:.1f} m/s'}: "
        )
        text += f"it is no obstacle that stays at ({where})"
        return [
            Finding(actor.name, check, Level.REFUSED, text, "have it hold or land, or insist with force", insist=True)
        ]
    text = f"it flies, takes no part, and is taken to stay at ({where})"
    return [Finding(actor.name, check, Level.WARNING, text, "the monitor watches it")]


def margin_rule(
    actors: Iterable[VehicleActor], others: Iterable[VehicleActor], margin_m: float | None
) -> tuple[MarginRule, dict[str, dict[str, list[Any]]]]:
    """The margins of the fleet, and for people what each term is and where it is from."""
    taking_part = [actor.name for actor in actors]
    rule = fleet_margins.margin_rule([*actors, *others], margin_m=margin_m)
    sources = {
        name: {
            term: [round(getattr(rule.by_vehicle[name], term), 3), rule.by_vehicle[name].sources.get(term, DEFAULT)]
            for term in ("wingspan_m", "position_error_m", "tracking_error_m", "delay_s")
        }
        for name in taking_part
    }
    return rule, sources


def state_findings(
    actor: VehicleActor, control_mode: str, flown: Sequence[Vehicle], links: VehicleLinks
) -> list[Finding]:
    """Whether it is heard, may be controlled, and its link carries the control mode."""
    vehicle, found = actor.vehicle, []
    why = None
    if vehicle.replayed:
        why = "it is heard in a recording only"
    elif not vehicle.connected:
        why = "it is lost"
    elif vehicle.duplicate:
        why = "two vehicles have its system id"
    elif vehicle.failsafe:
        why = "its own failsafe is active"
    elif not is_copter(vehicle.type):
        why = "it is no multirotor or helicopter"
    else:
        try:
            offboard_entry.guided_mode(vehicle)
        except RefusedError as error:
            why = str(error)
    if why is not None:
        return [Finding(actor.name, "state", Level.REFUSED, why, "it cannot fly the plan: leave it out")]
    found.append(Finding(actor.name, "state", Level.OK, f"{vehicle.family}, {vehicle.mode}"))
    if not isinstance(actor.offboard, OffboardEngagement):  # its setpoints are made on board
        down = actor.offboard.down_reason()
        text = "its companion flies it" if down is None else down
        return [*found, Finding(actor.name, "link", Level.OK if down is None else Level.REFUSED, text)]
    if (why := links.stream_refusal(vehicle, lambda: flown)) is None:
        why = _too_slow(actor, control_mode, flown, links)
    if why is not None:
        found.append(Finding(actor.name, "link", Level.REFUSED, why, "fly fewer vehicles, or by position", insist=True))
    else:
        found.append(Finding(actor.name, "link", Level.OK, f"it carries {control_mode} setpoints"))
    return found


def _too_slow(actor: VehicleActor, control_mode: str, flown: Sequence[Vehicle], links: VehicleLinks) -> str | None:
    """Whether its share of the radio carries the rate of the control mode."""
    bytes_per_s = links.setpoint_bytes_per_s(actor.vehicle, lambda: flown)
    config = actor.offboard.controller.config
    rate_hz, message = {
        "attitude": (config.rate_min_hz, "SET_ATTITUDE_TARGET"),
        "velocity": (config.velocity_hz, STREAMED),
    }.get(control_mode, (config.position_hz, STREAMED))
    needed = rate_hz * FRAME_BYTES[message]
    if bytes_per_s >= needed or math.isinf(bytes_per_s):
        return None
    return (
        f"with {len(flown)} vehicles its radio leaves it {bytes_per_s:.0f} B/s for setpoints; {control_mode} at "
        f"{rate_hz:g} Hz takes {needed:.0f}"
    )


async def preflight_findings(
    actors: Sequence[VehicleActor],
    grounded: frozenset[str],
    preflight: Callable[[list[str]], Awaitable[Mapping[str, Any]]],
) -> list[Finding]:
    """Of the vehicles that are to be armed. Those in the air have passed it already, or were forced."""
    standing = [actor.name for actor in actors if actor.name in grounded]
    if not standing:
        return []
    reports = await preflight(standing)
    found = []
    for name in standing:
        report = reports[name]
        level = Level.OK if report["ok"] else Level.REFUSED
        todo = "" if report["ok"] else f"see `skygcs-cli preflight {name}`, or insist with force"
        found.append(Finding(name, "preflight", level, report["summary"], todo, insist=True))
    return found


def battery_findings(
    actors: Sequence[VehicleActor], duration_s: float, record: Callable[[VehicleActor], FlightRecord]
) -> list[Finding]:
    """The charge for the plan's duration, with the reserve."""
    found = []
    for actor in actors:
        battery = actor.vehicle.telemetry("battery")
        percent = None if battery is None else battery["percent"]
        measured_s, minutes = record(actor).flight_time_s, actor.config.flight_time_min
        if measured_s is not None:
            flight_time = FlightTime(measured_s, "measured in flight")
        elif minutes is not None:
            flight_time = FlightTime(60.0 * minutes, "flight_time_min of the fleet file")
        else:
            flight_time = FlightTime(DEFAULT_FLIGHT_TIME_S, "default, as nothing is measured or configured")
        reserve = actor.config.battery_reserve_percent
        reserve = DEFAULT_RESERVE_PERCENT if reserve is None else reserve
        found.append(battery_finding(actor.name, percent, flight_time, duration_s, reserve))
    return found


async def return_heights(actors: Sequence[VehicleActor]) -> dict[str, ReturnHeight | None]:
    """In which height each returns, read from its parameters."""
    slots = asyncio.Semaphore(PREFLIGHT_READERS)

    async def one(actor: VehicleActor) -> ReturnHeight | None:
        names = (
            (("RTL_RETURN_ALT", 1.0),) if actor.vehicle.family == "px4" else (("RTL_ALT", 100.0), ("RTL_ALT_M", 1.0))
        )
        async with slots:
            for name, per_metre in names:
                outcome = await actor.params.get(name)
                if outcome.ok and outcome.param is not None:
                    return ReturnHeight(outcome.param.name, per_metre, float(outcome.param.value) / per_metre)
        return None

    async with asyncio.TaskGroup() as group:
        tasks = {actor.name: group.create_task(one(actor), name=f"return height of {actor.name}") for actor in actors}
    return {name: task.result() for name, task in tasks.items()}
