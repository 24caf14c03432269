"""Checks before a plan is flown: nothing moves, parameters are read."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from skygcs.core.geo import EnuFrame
from skygcs.core.mavlink.vehicle_class import cannot_hover
from skygcs.core.monitor.order_check import FORGET
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.plan.margins import DEFAULT, MarginRule
from skygcs.core.preflight.report import ReturnSetting
from skygcs.core.radio_link.capacity import FRAME_BYTES
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle import offboard_entry
from skygcs.core.vehicle.flight_lock import FlightLock
from skygcs.core.vehicle.flight_note import FlightRecord, lost_place
from skygcs.core.vehicle.mission_orders import mission_settings
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight import remedies
from skygcs.ext.plans.flight.flight_findings import (
    DEFAULT_FLIGHT_TIME_S,
    DEFAULT_RESERVE_PERCENT,
    Finding,
    FlightTime,
    Level,
    battery_finding,
    refused,
)
from skygcs.ext.plans.flight.flight_situation import Prepared
from skygcs.ext.plans.flight.flight_steps import FlightStep
from skygcs.ext.plans.flight.guidance import Choice, Guidance, by_goto
from skygcs.ext.plans.flight.plan_in_fence import CHECK, Reach, fence_finding, sampled
from skygcs.ext.plans.flight.plan_rehearsal import SLOWER, Stopped
from skygcs.ext.plans.plan_flight import HOLD_MODES, measured_place
from skygcs.runtime import fleet_margins
from skygcs.runtime.fence_orders import VehicleFence
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.preflight_run import Preflight, examine_all
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import VehicleLinks

PLAN_POSITION_S = 3.0
"""Oldest position that a plan is measured with: it is held against the margins between vehicles, which an order
to one of them is not: there an older one serves (`orders.ORDER_POSITION_S`)."""

GPS_FIX_3D = 3

PREFLIGHT_READERS = 3
"""Vehicles whose parameters are read at the same time."""

ORDERS_BYTES = 90
"""To arm and to take off: two COMMAND_LONG of 45 bytes."""

ORDERS_S = 4.0
"""A PX4 disarms 10 s after it was armed if it has not taken off (COM_DISARM_PRFLT). With answers, repeats and the climb
until it is seen, 14 vehicles behind a radio of 64 kbit/s took 18 s for what takes 5 s of its uplink."""

MOVING_MPS = 0.7
"""Faster than a vehicle drifts that holds."""

ENGAGED_FROM = HOLD_MODES | {"AUTO.TAKEOFF", "OFFBOARD", "POSCTL", "LOITER", "POSHOLD"}
"""Modes in the air from which a plan takes a vehicle under control: it stands, unless its pilot moves it. Not RTL, LAND
or a mission, which fly their own way while the others take off."""

STREAMED = "SET_POSITION_TARGET_LOCAL_NED"

SLOWEST_CLIMB_MPS = 1.0
"""The slowest take-off, for the charge that it needs: PX4 climbs with 1.5 m/s (MPC_TKO_SPEED), ArduCopter with 2.5."""

Places = dict[str, Vector]

WhyLeaving = Callable[[VehicleActor], str | None]
"""Why a vehicle that stands does not stay there; None: nobody has sent it anywhere."""

Loaded = Mapping[str, LoadedTrajectory]
"""The trajectories of one step, by vehicle."""


class Measured(NamedTuple):
    """Where the vehicles of the plan and all others are, in the frame of the plan."""

    places: Places
    grounded: frozenset[str]
    others: Places
    findings: list[Finding]


def measure(
    actors: Sequence[VehicleActor],
    everybody: Iterable[VehicleActor],
    frame: EnuFrame,
    now: float,
    why_leaving: WhyLeaving = lambda actor: None,
) -> Measured:
    """The places; findings name what cannot be measured. ``why_leaving``: see `VehicleWays.why_leaving`."""
    places: Places = {}
    names = [actor.name for actor in actors]
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
            remedy = remedies.leave_out(actor.name, names)
            findings.append(refused(actor.name, "position", f"{why}: wait for its GPS, or", remedy))
    taking_part = {actor.vehicle.key for actor in actors}
    others: Places = {}
    for actor in everybody:
        if actor.vehicle.key not in taking_part and not actor.vehicle.replayed:
            findings += _other(actor, frame, now, others, why_leaving(actor))
    return Measured(places, frozenset(grounded), others, findings)


def _why_unplaced(vehicle: Vehicle, place: Vector | None, age_s: float) -> str | None:
    if place is None:
        return "its position is not known"
    if age_s > PLAN_POSITION_S:
        return f"its position is {age_s:.0f} s old"
    gps = vehicle.telemetry("gps")
    if gps is not None and gps["fix_type"] < GPS_FIX_3D:
        return f"its GPS has no fix ({gps['fix_type']})"
    return None


def _other(actor: VehicleActor, frame: EnuFrame, now: float, others: Places, leaving: str | None) -> list[Finding]:
    """A vehicle that takes no part: an obstacle where it was measured. ``leaving``: why it does not stay there."""
    check = "others"
    place, age_s, speed_mps = measured_place(actor.vehicle, frame, now)
    flies = is_flying(actor.vehicle, now)
    if place is None:
        if not flies:
            return []
        text = "it flies, takes no part, and its position is not known"
        return [refused(actor.name, check, text, remedies.land(actor.name), insist=True)]
    others[actor.name] = place
    where = ", ".join(f"{v:.1f}" for v in place)
    if not flies and leaving is None:
        return [Finding(actor.name, check, Level.OK, f"it takes no part and is an obstacle at ({where})")]
    if age_s > PLAN_POSITION_S and not actor.vehicle.connected:
        text = f"{lost_place(actor.vehicle, now)}, and may be anywhere about there{FORGET.format(name=actor.name)}"
        return [refused(actor.name, check, text, remedies.forget(actor.name), insist=True)]
    moves = f"flies with {speed_mps:.1f} m/s" if speed_mps > MOVING_MPS else None
    why = "is silent" if age_s > PLAN_POSITION_S else leaving or moves
    if why is not None:
        text = f"it takes no part and {why}: it is no obstacle that stays at ({where})"
        return [refused(actor.name, check, text, remedies.hold(actor.name), insist=True)]
    text = f"it flies, takes no part, and is taken to stay at ({where})"
    return [Finding(actor.name, check, Level.WARNING, text, "the monitor watches it")]


def margin_rule(
    actors: Iterable[VehicleActor], others: Iterable[VehicleActor], margin_m: float | None, by: Guidance
) -> tuple[MarginRule, dict[str, dict[str, list[Any]]]]:
    """The margins of the fleet, and for people what each term is and where it is from."""
    actors = list(actors)
    taking_part = [actor.name for actor in actors]
    rule = fleet_margins.margin_rule([*actors, *others], margin_m=margin_m)
    if by.own_way:
        rule = by_goto(rule, {actor.name: actor.vehicle.family for actor in actors})
    sources = {
        name: {
            term: [round(getattr(rule.by_vehicle[name], term), 3), rule.by_vehicle[name].sources.get(term, DEFAULT)]
            for term in ("wingspan_m", "position_error_m", "tracking_error_m", "delay_s")
        }
        for name in taking_part
    }
    return rule, sources


def state_finding(actor: VehicleActor, names: list[str], now: float) -> Finding:
    """Check whether it is heard and may be ordered. ``names``: the vehicles that take part."""
    vehicle = actor.vehicle
    why = None
    if vehicle.replayed:
        why = "it is heard in a recording only"
    elif not vehicle.connected:
        why = "it is lost"
    elif vehicle.duplicate:
        why = "two vehicles have its system id"
    elif vehicle.failsafe:
        why = "its own failsafe is active"
    elif (why := cannot_hover(vehicle.family, vehicle.kind)) is None:
        try:
            offboard_entry.guided_mode(vehicle)
        except RefusedError as error:
            why = str(error)
        if why is None and is_flying(vehicle, now) and vehicle.mode not in ENGAGED_FROM:
            text = f"it flies in {vehicle.mode}, which moves it or leaves it to its pilot's sticks"
            return refused(actor.name, "state", text, remedies.hold(actor.name))
    if why is not None:
        return refused(actor.name, "state", why, remedies.leave_out(actor.name, names))
    return Finding(actor.name, "state", Level.OK, f"{vehicle.family}, {vehicle.mode}")


def made_elsewhere(actor: VehicleActor) -> bool:
    """True if another program makes its setpoints, and keeps its trajectories."""
    return not isinstance(actor.offboard, OffboardEngagement)


def not_streamed(actors: Sequence[VehicleActor], control_mode: str, links: VehicleLinks) -> dict[str, str]:
    """The vehicles whose links do not carry setpoints of this mode to all of these, and why."""
    flown = [actor.vehicle for actor in actors]
    found = {}
    for actor in actors:
        if made_elsewhere(actor):
            continue
        why = links.stream_refusal(actor.vehicle, lambda: flown)
        if (why := why or _too_slow(actor, control_mode, flown, links)) is not None:
            found[actor.name] = why
    return found


def link_findings(
    actors: Sequence[VehicleActor],
    choice: Choice,
    narrow: Mapping[str, str],
    control_mode: str,
    now: float,
    *,
    timed: bool,
) -> list[Finding]:
    """Check whether the links carry the way that was chosen, and what happens when nothing is sent any more.
    ``narrow``: as `not_streamed` has it."""
    found = []
    instead = remedies.make_phased() if timed else remedies.by_goto()
    for actor in actors:
        name = actor.name
        if not choice.by.own_way:
            level = Level.OK if offboard_entry.loss_note(actor.vehicle, now) is None else Level.WARNING
            found.append(Finding(name, "if skygcs dies", level, offboard_entry.loss_text(actor.vehicle, now)))
        if choice.by is Guidance.GOTO:
            found.append(Finding(name, "link", Level.OK, "by goto: one order for each leg"))
            text = "it flies its leg to the end, which is certified as a place to stay, and holds there"
            found.append(Finding(name, "if skygcs dies", Level.OK, text))
        elif choice.by is Guidance.MISSION:
            found.append(Finding(name, "link", Level.OK, "by its mission: nothing is sent on the way"))
        elif isinstance(actor.offboard, OffboardEngagement):
            why = narrow.get(name)
            text = f"it carries {control_mode} setpoints"
            fine = Finding(name, "link", Level.OK, text)
            found.append(fine if why is None else refused(name, "link", why, instead, insist=True))
        else:  # its setpoints are made on board
            down = actor.offboard.down_reason()
            fine = Finding(name, "link", Level.OK, "its companion flies it")
            found.append(fine if down is None else refused(name, "link", down, remedies.bring_up(name)))
    return found


async def mission_findings(actors: Sequence[VehicleActor]) -> list[Finding]:
    """Check whether the firmwares fly missions as a plan needs it; reads the parameters that decide it."""
    await asyncio.gather(*(actor.read_mission_settings() for actor in actors))
    found = []
    for actor in actors:
        for setting in mission_settings(actor.vehicle):
            name, check = actor.name, setting.check
            if setting.fits:
                found.append(Finding(name, check, Level.OK, setting.text))
            elif setting.fits is None:
                found.append(refused(name, check, setting.text, remedies.insist("look at it"), insist=True))
            else:
                remedy = remedies.set_parameter(name, setting.param, setting.value)
                found.append(refused(name, check, setting.text, remedy, insist=True))
    return found


def armed_together(actors: Sequence[VehicleActor], links: VehicleLinks) -> bool:
    """True if the links carry the orders to arm and to take off of all before the first one disarms again."""
    flown = [actor.vehicle for actor in actors]
    return all(ORDERS_S * links.setpoint_bytes_per_s(vehicle, lambda: flown) >= ORDERS_BYTES for vehicle in flown)


def _too_slow(actor: VehicleActor, control_mode: str, flown: Sequence[Vehicle], links: VehicleLinks) -> str | None:
    """Check whether its share of the radio carries the rate of the control mode."""
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


async def preflight_findings(actors: Sequence[VehicleActor], grounded: frozenset[str]) -> list[Finding]:
    """Findings of the vehicles that are to be armed. Those in the air have passed it already, or were forced."""
    standing = {actor.name: actor.part(Preflight) for actor in actors if actor.name in grounded}
    found = []
    for name, report in (await examine_all(standing)).items():
        summary = report["summary"]
        fine = Finding(name, "preflight", Level.OK, summary)
        remedy = remedies.preflight(name)
        found.append(fine if report["ok"] else refused(name, "preflight", summary, remedy, insist=True))
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


async def fence_findings(
    actors: Sequence[VehicleActor], prepared: Prepared, frame: EnuFrame, measured: Measured
) -> list[Finding]:
    """Check whether the autopilots' own fences leave room for the plan; their parameters are read."""
    slots = asyncio.Semaphore(PREFLIGHT_READERS)

    async def one(actor: VehicleActor) -> Finding:
        async with slots:
            held = await actor.part(VehicleFence).settings()
            shapes = None if isinstance(held, str) or not held.enabled else await actor.missions.fence_shapes()
        if isinstance(held, str):
            return refused(actor.name, CHECK, held, remedies.insist("check its link"), insist=True)
        return fence_finding(actor.name, held, shapes, _reach(actor, prepared, frame, measured))

    flown = {name for step in prepared.steps for name in step.trajectories}
    async with asyncio.TaskGroup() as group:
        tasks = [
            group.create_task(one(actor), name=f"fence of {actor.name}") for actor in actors if actor.name in flown
        ]
    return [task.result() for task in tasks]


def _reach(actor: VehicleActor, prepared: Prepared, frame: EnuFrame, measured: Measured) -> Reach:
    """The places that the plan leads a vehicle to, and the homes that its fence may be about."""
    home, name = actor.vehicle.telemetry("home"), actor.name
    homes = []
    if home is not None and home["lat_deg"] is not None:
        homes.append((home["lat_deg"], home["lon_deg"], home["alt_amsl_m"]))
    if name in measured.grounded or not homes:  # both firmwares set home anew where they arm
        homes.append(frame.to_geodetic(*measured.places[name]))
    tube_m = 0.0 if prepared.tubes is None else prepared.tubes.free_m[name]
    ways = [step.trajectories[name] for step in prepared.steps if name in step.trajectories]
    return Reach(tuple(homes), tuple(frame.to_geodetic(*place) for place in sampled(ways)), tube_m)


async def return_heights(actors: Sequence[VehicleActor]) -> dict[str, ReturnSetting | None]:
    """In which height each returns, read from its parameters."""
    slots = asyncio.Semaphore(PREFLIGHT_READERS)

    async def one(actor: VehicleActor) -> ReturnSetting | None:
        async with slots:
            for name, per_metre in itertools.chain(*actor.vehicle.abilities.return_heights):  # a copter has one
                outcome = await actor.params.get(name)
                if outcome.ok and outcome.param is not None and outcome.number is not None:
                    return ReturnSetting(outcome.param.name, per_metre, float(outcome.number) / per_metre)
        return None

    async with asyncio.TaskGroup() as group:
        tasks = {actor.name: group.create_task(one(actor), name=f"return height of {actor.name}") for actor in actors}
    return {name: task.result() for name, task in tasks.items()}


def stopped_text(stopped: Stopped) -> str:
    """Say where and why the guard would stop a plan."""
    who = "" if stopped.vehicle is None else f"{stopped.vehicle}: "
    return f"the guard would stop it in {stopped.step}: {who}{stopped.text}"


def rehearsal_findings(stopped: tuple[Stopped, float | None] | None, *, timed: bool) -> list[Finding]:
    """Return what stopped the rehearsal, as a refusal, with the speed factor at which nothing does (None: at none)."""
    if stopped is None:
        return []
    why, factor = stopped
    otherwise = remedies.make_phased() if timed else remedies.by_goto()
    remedy = otherwise if factor is None else remedies.slower(factor)
    return [refused(why.vehicle, "rehearsal", stopped_text(why), remedy)]


def certificate_findings(prepared: Prepared) -> list[Finding]:
    """Return why the plan is not certified, or the pair that comes closest."""
    if prepared.problems:
        remedy = remedies.make_again("change its places where they are named, or the vehicles'")
        return [
            refused(vehicle, "certificate", line, remedy)
            for line, vehicle in zip(prepared.problems, prepared.vehicles, strict=True)
        ]
    closest = None if prepared.certificate is None else prepared.certificate.closest
    text = "certified" if closest is None else f"certified; closest: {closest.text()}"
    return [Finding(None, "certificate", Level.OK, text)]


def bounds_findings(
    steps: Sequence[FlightStep], loaded: Sequence[Loaded], lock: FlightLock, speed_factor: float
) -> list[Finding]:
    """Return what exceeds the limits of motion or the control fence of each vehicle, at this multiple of the planned
    speed: the first step in which it does."""
    found: dict[str, Finding] = {}
    for step, trajectories in zip(steps, loaded, strict=False):
        for name, one in trajectories.items():
            why = None if name in found else lock.path_refusal(name, one, speed_factor)
            if why is not None:
                remedy = _within_bounds(lock, name, one, speed_factor)
                found[name] = refused(name, "bounds", f"{step.name}: {why}", remedy)
    return list(found.values())


def _within_bounds(lock: FlightLock, name: str, one: LoadedTrajectory, speed_factor: float) -> remedies.Remedy:
    """A speed at which a trajectory keeps its limits; where it is the fence, another plan within it."""
    for factor in (speed_factor * slower for slower in SLOWER):
        if lock.path_refusal(name, one, factor) is None:
            return remedies.slower(factor)
    return remedies.make_again("move its places into the control fence, or set control.fence in the fleet file")


def reach_findings(steps: Sequence[FlightStep], actors: Sequence[VehicleActor]) -> list[Finding]:
    """Return the legs, flown by autopilots, that are longer than a goto may be: one of each vehicle."""
    found: dict[str, Finding] = {}
    for step in steps:
        for actor in actors:
            way = step.trajectories[actor.name]
            places = step.corners.get(actor.name) or (way.start_enu_m, way.end_enu_m)
            leg_m = max(math.dist(a, b) for a, b in itertools.pairwise(places))
            if leg_m > actor.config.goto_limit_m and actor.name not in found:
                text = f"{step.name}: a leg of {leg_m:.0f} m; a goto may be {actor.config.goto_limit_m:g} m long"
                remedy = remedies.again(f"set vehicles.{actor.name}.goto_limit_m in the fleet file")
                found[actor.name] = refused(actor.name, "bounds", text, remedy)
    return list(found.values())


def climb_s(prepared: Prepared, measured: Measured) -> float:
    """Time that the lowest vehicle takes to the height of the highest start."""
    if not prepared.steps:
        return 0.0
    highest_m = max((start_m[2] for start_m in prepared.steps[0].starts().values()), default=0.0)
    lowest_m = min(place_m[2] for place_m in measured.places.values())
    return max(0.0, highest_m - lowest_m) / SLOWEST_CLIMB_MPS


def grounds(actors: Sequence[VehicleActor], measured: Measured, frame: EnuFrame) -> dict[str, float]:
    """How high the ground is under each: where it stands, else at its home."""
    found = {name: measured.places[name][2] for name in measured.grounded}
    for actor in actors:
        if actor.name not in found and (home := home_of(actor)) is not None:
            found[actor.name] = frame.from_geodetic(*home)[2]
    return found


def home_of(actor: VehicleActor) -> tuple[float, float, float] | None:
    """Return latitude and longitude in degrees and altitude (AMSL) in metres of its home; None: not known."""
    home = actor.vehicle.telemetry("home")
    if home is None or home["lat_deg"] is None:
        return None
    return home["lat_deg"], home["lon_deg"], home["alt_amsl_m"]
