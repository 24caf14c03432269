"""Orders about a mission on board: start, resume, set the current item; and how the autopilots' missions differ.

Items have the numbers of their plan, from 1. To pause is to hold (`orders.hold`): both autopilots go on with the
current item when its mission mode is set again.

    PX4 1.16 (failsafe.cpp)        ArduCopter 4.6 (events.cpp, failsafe_gcs_on_event)   without a ground station
    ----------------------------   --------------------------------------------------   ------------------------
    NAV_DLL_ACT 0                  FS_GCS_ENABLE 0                                      flown to the end
    COM_DLL_EXCEPT with bits 0, 1  FS_OPTIONS with bit 1                                flown to the end
    anything else                  anything else                                        broken off

At the end it holds: a PX4 changes to AUTO.LOITER for that. One that hears no transmitter either may return from there
(NAV_RCL_ACT, unless COM_RCL_EXCEPT has bit 1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Literal, NamedTuple

from skygcs.core.geo import distance_m
from skygcs.core.mavlink import mav_cmd, modes
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.vehicle_class import ReturnEnd, VehicleClass
from skygcs.core.mission.firmware_items import Converted, Family, for_firmware
from skygcs.core.mission.item import FIRST_ITEM, GLOBAL, MissionItem, MissionType, item_of_seq, seq_of_item
from skygcs.core.mission.plan import (
    ENDS_ON_GROUND,
    CheckLimits,
    Finding,
    MissionPlan,
    PlannedHome,
    check_plan,
    errors,
    from_wire,
    to_wire,
)
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle import autopilot
from skygcs.core.vehicle.flight_evidence import Landed, contradiction
from skygcs.core.vehicle.offboard_entry import ask_parameter
from skygcs.core.vehicle.order_plan import Plan, Step
from skygcs.core.vehicle.orders import FORCE_HINT, require_connected
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import RefusedError
from skygcs.spelling import listed

CURRENT_S = 6.0
"""MISSION_CURRENT comes at 0.2 to 1 Hz by default."""

MAX_FINDINGS = 5
"""Findings named in a refusal; `mission check` lists all."""

MISSION_MODES = frozenset({"AUTO.MISSION", "AUTO"})


@dataclass(frozen=True, slots=True)
class CurrentItemIs:
    """MISSION_CURRENT has this sequence number."""

    seq: int

    def met(self, vehicle: Vehicle, now: float) -> bool:
        mission = vehicle.telemetry("mission")
        return mission is not None and mission["seq"] == self.seq

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        mission = vehicle.telemetry("mission")
        if mission is None or mission["seq"] is None:
            return "it does not report its current item"
        return f"the current item is still {number_of(vehicle, mission['seq'])}"


def number_of(vehicle: Vehicle, seq: int) -> int:
    """An item's number in the plan; an ArduPilot's home is 0."""
    return item_of_seq(seq, home_first=keeps_home(vehicle))


def keeps_home(vehicle: Vehicle) -> bool:
    """True if item 0 of its mission is its home."""
    return vehicle.family == "ardupilot"


def keeps_old(vehicle: Vehicle, kind: MissionType) -> bool:
    """True if it keeps its old list until the new one is complete, instead of overwriting item by item."""
    return vehicle.family == "px4" or (vehicle.family == "ardupilot" and kind is MissionType.FENCE)


def on_wire(vehicle: Vehicle, plan: MissionPlan, kind: MissionType, dialect: Dialect) -> tuple[MissionItem, ...]:
    """One list of a plan in the form this vehicle takes; () for an empty list, which is to be cleared instead."""
    if kind is not MissionType.MISSION:
        return plan.items(kind)
    items = converted(vehicle, plan, dialect).items
    if not items:
        return ()
    if not keeps_home(vehicle):
        return to_wire(items, None)
    return to_wire(items, MissionItem(mav_cmd.NAV_WAYPOINT, GLOBAL) if plan.home is None else plan.home.item())


def converted(vehicle: Vehicle, plan: MissionPlan, dialect: Dialect) -> Converted:
    """The plan's mission in the form this vehicle's firmware takes, and the changes made for that."""
    return for_firmware(plan.mission, firmware_family(vehicle), dialect.enums.get("MAV_CMD", {}))


def firmware_family(vehicle: Vehicle) -> Family | None:
    """Whose tables in `core.mission.firmware_items` are its own; None: neither firmware's."""
    return None if vehicle.family == "generic" else vehicle.family


def with_downloaded(
    vehicle: Vehicle, plan: MissionPlan, kind: MissionType, items: tuple[MissionItem, ...]
) -> MissionPlan:
    """The plan with a downloaded list; the inverse of `on_wire`. Raises ValueError for an impossible fence."""
    if kind is not MissionType.MISSION:
        return plan.with_items(kind, items)
    first_is_home = keeps_home(vehicle) and bool(items)
    place = items[0].position if first_is_home else None
    if place is not None:
        plan = replace(plan, home=PlannedHome(*place, items[0].z or 0.0))
    return plan.with_items(kind, from_wire(items, first_is_home=first_is_home))


def findings(vehicle: Vehicle, plan: MissionPlan, dialect: Dialect, limit_m: float) -> tuple[Finding, ...]:
    """Problems of a plan for this vehicle at its present position."""
    position = vehicle.telemetry("position")
    place = None
    if position is not None and position["lat_deg"] is not None:
        place = (position["lat_deg"], position["lon_deg"])
    return check_plan(
        plan, dialect, CheckLimits(max_distance_m=limit_m), family=firmware_family(vehicle), vehicle=place
    )


def require_uploadable(
    vehicle: Vehicle,
    now: float,
    plan: MissionPlan,
    kinds: tuple[MissionType, ...],
    dialect: Dialect,
    *,
    limit_m: float,
    force: bool,
) -> None:
    """Raises RefusedError for a plan with errors, and while the vehicle flies its mission; ``force`` insists."""
    require_connected(vehicle, now)
    if not kinds:
        raise RefusedError(
            "the plan is empty: there is nothing to upload; to clear the vehicle's lists use mission clear"
        )
    if force:
        return
    armed = vehicle.armed or contradiction(vehicle, now) is not None
    if MissionType.MISSION in kinds and armed and vehicle.mode in MISSION_MODES:
        raise RefusedError(f"it is flying its mission ({vehicle.mode}); pause it first, or {FORCE_HINT}")
    if MissionType.FENCE in kinds and model_of(vehicle, now).may_fly:
        stops = "land first" if vehicle.abilities.flies else "disarm it first"
        raise RefusedError(f"it may be under way, and outside of the new fence at once; {stops}, or {FORCE_HINT}")
    wrong = [f for f in errors(findings(vehicle, plan, dialect, limit_m)) if f.kind in kinds]
    if wrong:
        raise RefusedError(f"{listed(list(map(str, wrong)), MAX_FINDINGS)}; {FORCE_HINT}")


def require_clearable(vehicle: Vehicle, now: float, kinds: tuple[MissionType, ...], *, force: bool) -> None:
    """Raises RefusedError while the vehicle flies its mission, or has a fence around it under way."""
    require_connected(vehicle, now)
    evidence = contradiction(vehicle, now)
    if force or not (vehicle.armed or evidence is not None):
        return
    if MissionType.MISSION in kinds and vehicle.mode in MISSION_MODES:
        raise RefusedError(f"it is flying its mission ({vehicle.mode}); pause it first, or {FORCE_HINT}")
    if MissionType.FENCE in kinds and model_of(vehicle, now).may_fly:
        raise RefusedError(f"it may be under way and would be without its fence; {FORCE_HINT}")


def set_current(vehicle: Vehicle, now: float, item: int) -> Plan:
    require_connected(vehicle, now)
    return Plan("mission item", (_current_step(vehicle, item),), f"the current item is {item}")


def start(vehicle: Vehicle, now: float, *, first: int = 1, arm: bool = True) -> Plan:
    """Start with item ``first``; on the ground it arms first if ``arm``."""
    require_connected(vehicle, now)
    if not vehicle.armed and not arm:
        raise RefusedError("it is not armed, and the start was ordered without arming")
    current = _current_step(vehicle, first)
    return Plan("mission", (current, *_go(vehicle)), f"flying its mission from item {first}")


def resume(vehicle: Vehicle, now: float) -> Plan:
    """Go on with the current item."""
    require_connected(vehicle, now)
    if not vehicle.armed:
        raise RefusedError("it is not armed; start the mission")
    return Plan("mission", (autopilot.mode_step(vehicle, _mission_mode(vehicle)),), "flying its mission again")


def current_item(vehicle: Vehicle) -> int:
    """The item with which it would go on; 1 if it reports none."""
    mission = vehicle.telemetry("mission")
    seq = None if mission is None else mission["seq"]
    return FIRST_ITEM if seq is None else max(FIRST_ITEM, number_of(vehicle, seq))


def flown_from(vehicle: Vehicle, now: float, order: str, arguments: Mapping[str, Any]) -> int | None:
    """The item from which an order makes the vehicle fly its mission; None: it flies no mission by it.

    ``order``, ``arguments``: the method of `VehicleActor` and what it is given.
    """
    model = model_of(vehicle, now)
    match order:
        case "start_mission":
            return int(arguments.get("first", 1))
        case "resume_mission":
            return current_item(vehicle)
        case "set_mode" if model.may_fly and str(arguments.get("name", "")).upper() in MISSION_MODES:
            return current_item(vehicle)
        case "set_mission_item" if model.may_fly and vehicle.mode in MISSION_MODES:
            return int(arguments["item"])
    return None


def _current_step(vehicle: Vehicle, item: int) -> Step:
    seq = seq_of_item(item, home_first=keeps_home(vehicle))
    if item < FIRST_ITEM or seq > 0xFFFF:
        raise RefusedError(f"there is no item {item}; the first one is {FIRST_ITEM}")
    expect = CurrentItemIs(seq)
    name = f"set the current item to {item}"
    message = Step(name, message=("MISSION_SET_CURRENT", {"seq": seq}), expect=expect, expect_s=CURRENT_S)
    command = CommandSpec(mav_cmd.DO_SET_MISSION_CURRENT, (float(seq), 0.0))
    return Step(name, command, expect=expect, expect_s=0, instead=(message,))


def _go(vehicle: Vehicle) -> tuple[Step, ...]:
    """Enter the mission mode, from the ground or in the air.

    What is armed in its mission's mode moves off (PX4, ArduPlane, Rover): the mode comes first, and is undone if the
    arming fails (`autopilot.with_undo`). An ArduCopter arms in GUIDED and waits for MISSION_START.
    """
    number = _mission_mode(vehicle)
    mode = autopilot.mode_step(vehicle, number)
    arm = replace(autopilot.arm().steps[0], skip_if_met=True)
    if vehicle.armed:
        return (mode,)
    if vehicle.family == "ardupilot" and vehicle.kind is VehicleClass.COPTER:
        guided = autopilot.mode_step(vehicle, modes.copter_mode_number("GUIDED"), skip_if_met=True)
        begin = Step("start", CommandSpec(mav_cmd.MISSION_START, (0.0, 0.0)), expect=mode.expect, instead=(mode,))
        return (guided, arm, begin)
    return (autopilot.with_undo(vehicle, mode), arm)


def _mission_mode(vehicle: Vehicle) -> int:
    name = "AUTO.MISSION" if vehicle.family == "px4" else "AUTO"
    try:
        return modes.mode_number(vehicle.autopilot, vehicle.mode_type, name)
    except KeyError:
        raise RefusedError("skygcs knows the mission mode of PX4 and ArduPilot only; set its mode yourself") from None


# --- missions by which a vehicle flies its way of a plan by itself ----------------------------------------------------

HOLD_S = 1.0
"""Both firmwares cut a corner where they do not have to stop. They stop at a waypoint with a time to hold: PX4 leaves
out the next setpoint for it (mission.cpp, brake_for_hold, 1.16), ArduCopter the next destination (mode_auto.cpp,
set_next_wp, 4.6). ArduCopter counts whole seconds."""

WITHIN_M = 0.5
"""A PX4 begins to hold within it; by default 2 m from the corner and more (NAV_ACC_RAD), and the hold would be over
before it is there. ArduCopter takes no notice: it holds where its own path has ended."""


def mission_along(places: Sequence[tuple[float, float, float]]) -> MissionPlan:
    """A mission along straight ways through these places, that rests at each corner. Latitude and longitude in degrees,
    height above mean sea level in metres. The vehicle stands at the first place, which is no item unless it is the
    only one."""
    items = tuple(
        MissionItem.from_params(
            mav_cmd.NAV_WAYPOINT, GLOBAL, (HOLD_S, WITHIN_M, 0.0, None, lat_deg, lon_deg, alt_amsl_m), True
        )
        for lat_deg, lon_deg, alt_amsl_m in (places[1:] or places)
    )
    return MissionPlan(items)


# --- settings of the firmware -----------------------------------------------------------------------------------------

LOSS_PARAMETERS = {
    "px4": ("NAV_DLL_ACT", "COM_DLL_EXCEPT"),
    "ardupilot": ("FS_GCS_ENABLE", "FS_OPTIONS"),
}
"""By firmware: what it does without a ground station at all, and where it takes no notice of that."""

GOES_ON_BITS = {"px4": 3, "ardupilot": 2}
"""Bits of the second of them: not on a mission. A PX4 changes to AUTO.LOITER at its end (Commander.cpp,
checkForMissionUpdate), which has a bit of its own."""

RESTART = "MIS_RESTART"
"""ArduPilot's: 0 goes on with the current item, 1 begins anew whenever AUTO is entered (AP_Mission,
start_or_resume)."""

ALONE, RESUMED = "if skygcs dies", "mission"
"""Checks of `mission_settings`."""


class MissionSetting(NamedTuple):
    """``fits``: None: not known. ``param``, ``value``: the setting that does."""

    check: str
    fits: bool | None
    text: str
    param: str = ""
    value: float = 0.0


def ask_mission_settings(vehicle: Vehicle, now: float) -> Plan:
    """Read the parameters of `mission_settings` that are not known."""
    names = LOSS_PARAMETERS.get(vehicle.family, ()) + ((RESTART,) if vehicle.family == "ardupilot" else ())
    wanted = [name for name in names if vehicle.param(name) is None]
    return Plan(
        "parameters", tuple(ask_parameter(name, after=now, optional=True) for name in wanted), "parameters read"
    )


def mission_settings(vehicle: Vehicle) -> list[MissionSetting]:
    """Judge whether its mission is flown to the end without the ground, and goes on after a stop where it was."""
    found = [_alone(vehicle)]
    if vehicle.family == "ardupilot":
        found.append(_resumed(vehicle.param(RESTART)))
    return found


def _alone(vehicle: Vehicle) -> MissionSetting:
    if vehicle.family not in LOSS_PARAMETERS:
        return MissionSetting(ALONE, None, "what its firmware does without a ground station is not known")
    action_name, except_name = LOSS_PARAMETERS[vehicle.family]
    action, exceptions = vehicle.param(action_name), vehicle.param(except_name)
    if action == 0:
        back = ", or returns from there if it hears no transmitter either" if vehicle.family == "px4" else ""
        text = f"it flies its mission to the end and holds there{back} ({action_name} 0)"
        return MissionSetting(ALONE, True, text)
    bits = GOES_ON_BITS[vehicle.family]
    if exceptions is not None and int(exceptions) & bits == bits:
        text = f"it flies its mission to the end and holds there ({except_name} {exceptions:g})"
        return MissionSetting(ALONE, True, text)
    if action is None or exceptions is None:
        unknown = action_name if action is None else except_name
        text = f"its {unknown} is not known, which decides what it does without a ground station"
        return MissionSetting(ALONE, None, text)
    values = f"{action_name} {action:g}, {except_name} {exceptions:g}"
    text = f"without a ground station it breaks its mission off, or does not hold at its end ({values})"
    return MissionSetting(ALONE, False, text, except_name, float(int(exceptions) | bits))


def _resumed(restart: float | None) -> MissionSetting:
    if restart is None:
        return MissionSetting(RESUMED, None, f"its {RESTART} is not known: 1 begins anew after a stop")
    if restart != 0:
        text = f"its {RESTART} is {restart:g}: after a stop its mission begins anew, and not on its way"
        return MissionSetting(RESUMED, False, text, RESTART, 0.0)
    return MissionSetting(RESUMED, True, f"it goes on after a stop ({RESTART} 0)")


# --- missions one after another ---------------------------------------------------------------------------------------


@dataclass(slots=True)
class Progress:
    """Reports of one run of a mission, which begins with a start, a resume or another current item. Numbers from 1.

    A PX4 repeats its last MISSION_ITEM_REACHED ten times (mavlink_mission.cpp, 1.16): one that comes before the run's
    first item is current belongs to the run before.
    """

    first: int | None = None
    """The item with which it begins, until that is reported as current; None: it has begun."""
    reached: int | None = None
    furthest: int = 0
    """The highest item that was current."""
    reached_before: int | None = None
    """The last item that was reported as reached before the run's first item was current."""

    def on_current(self, item: int) -> None:
        if self.first is not None and item != self.first:
            return
        self.first = None
        self.furthest = max(self.furthest, item)

    def on_reached(self, item: int) -> bool:
        """False: it belongs to the run before, or is known."""
        if self.first is not None:
            self.reached_before = item
            return False
        if item == self.reached:
            return False
        self.reached = item
        return True

    def go_on_after(self, refused: Progress) -> int | None:
        """Take what was reported to the run that was to follow and was refused; an ArduPilot reports it once. Returns
        an item that was reached and not reported yet; None: there is none."""
        self.furthest = max(self.furthest, refused.furthest)
        if refused.reached is not None:
            self.on_reached(refused.reached)
            return None
        item = refused.reached_before
        return item if item is not None and self.on_reached(item) else None

    def complete(self, last: int | None) -> bool:
        """True if item ``last`` was current and then reached in this run."""
        return bool(last) and self.reached == last and self.furthest >= (last or 0)


Next = Literal["wait", "start", "end"]


MISSION_RETURN_MODES = frozenset({"AUTO.RTL", "RTL", "AUTO_RTL", "QRTL"})
"""Modes to which a mission's own NAV_RETURN_TO_LAUNCH changes (PX4, ArduPlane, Rover); ArduCopter stays in AUTO."""

MISSION_OVER_MODES = frozenset({"AUTO.LOITER"})
"""Modes to which a PX4 changes when its mission has ended (Commander.cpp, checkForMissionUpdate)."""


AT_HOME_M = 5.0
"""A rover that returns stops so near its home (Rover: WP_RADIUS is 2 m)."""

HOME_S = 5.0
"""So long it has to stay at its home before its return has ended. A PX4 that begins its return above its home stands
there before it climbs, and again, once it has come, before it sinks (rtl_direct.cpp: CLIMBING, MOVE_TO_LOITER)."""

STANDS_MPS = 0.5
"""Slower than any rover drives or copter sinks, and more than the noise of a GPS."""


class Phase(Enum):
    """A reason to wait, in words, and the longest wait in seconds."""

    EVIDENCE = "it is disarmed, and whether it has landed is not known", 60.0
    """Position and attitude come each two seconds from the slowest profile."""
    ON_GROUND = "it stands armed on the ground", 300.0
    """Before its take-off or after its landing: each firmware disarms by then, if it does so at all."""
    NEXT_ITEM = "it has come to no further item of its mission", 7200.0
    """A leg of 100 km at 14 m/s."""
    LAST_ITEM = "it has neither landed nor reached the end of its mission", 3600.0
    """Most have landed by then; one that circles for ever is found out."""


NOT_LOOKED_AT = Landed(None, "it was not looked at")


class Turn(NamedTuple):
    """The vehicle whose turn it is, now. ``complete``: it has reported the last item as reached."""

    name: str
    heard: bool
    flying: bool
    armed: bool
    complete: bool
    failsafe: bool
    ordered: bool
    """Another order was given to it since its start."""
    lands: bool
    """Its mission ends on the ground; see `ends_on_ground`."""
    mode: str = "AUTO"
    """The mode in which it was last seen armed."""
    ending: bool = False
    """The last item that moves it was its current one in this run."""
    returns: bool = False
    """That item is a return."""
    at_home: bool = False
    """It is where it holds at the end of a return that does not land."""
    home_s: float = math.inf
    """How long it has been there without a break."""
    landed: Landed = NOT_LOOKED_AT
    """The verdict on a landing (`flight_evidence.LandingWatch`)."""
    waited_s: float = 0.0
    """Since the last change of what it waits for (`Turn.phase`)."""
    furthest: int = 0
    """The highest item of this run that was current."""

    @property
    def phase(self) -> tuple[Phase, int]:
        """Reason to wait, and how far it is; if it changes, the wait begins anew."""
        if not self.armed:
            return Phase.EVIDENCE, 0
        if not self.flying:
            return Phase.ON_GROUND, 0
        return (Phase.LAST_ITEM if self.ending or self.complete else Phase.NEXT_ITEM), self.furthest

    @property
    def follows(self) -> bool:
        """True if it was last seen in its mission's mode, or in one in which its mission itself ends."""
        if self.mode in MISSION_RETURN_MODES:
            return self.complete or (self.ending and self.returns)
        if self.mode in MISSION_OVER_MODES:
            return self.complete or (self.ending and not (self.flying and self.armed))
        return self.mode in MISSION_MODES


class TurnDecision(NamedTuple):
    next: Next
    why: str


def next_turn(flown: Turn) -> TurnDecision:
    """When the next vehicle may start, of several that fly their missions one after another:

    the one that flies                                  what follows
    --------------------------------------------------  ---------------------------------------------------------------
    is on its mission, or on its way down from it       wait; end after the longest time of its `Phase`
    is disarmed, and may have landed                    wait for the evidence; end after the same
    has reached the last item, where it holds           the next one may start
    has returned, and holds, circles or stands at home  the next one may start, after `HOME_S`
    has landed and is disarmed, by its last item        the next one may start
    is in a mode that is not its mission's, came down   end: what comes next is a person's decision
    before its last item, has crashed or fallen, has
    another order, a failsafe, or is not heard
    """
    if flown.ordered:
        return TurnDecision("end", f"{flown.name} was ordered something else")
    if not flown.heard:
        return TurnDecision("end", f"{flown.name} is not heard")
    if flown.failsafe:
        return TurnDecision("end", f"{flown.name} is in failsafe")
    if flown.landed.landed is False:
        return TurnDecision("end", f"{flown.name} has not landed: {flown.landed.why}")
    if not flown.follows:
        return TurnDecision("end", f"{flown.name} was taken over ({flown.mode or 'mode unknown'})")
    if not flown.armed:
        if not flown.complete and not (flown.ending and (flown.lands or (flown.returns and flown.at_home))):
            return TurnDecision("end", f"{flown.name} is on the ground before the last item of its mission")
        if flown.landed.landed:
            return TurnDecision("start", f"{flown.name} has landed")
        return _wait(flown)
    if flown.lands:
        return _wait(flown)
    if flown.returns:  # a PX4 reports a return as reached when it begins
        if flown.at_home and flown.home_s >= HOME_S and (flown.ending or flown.complete):
            return TurnDecision("start", f"{flown.name} has returned")
        return _wait(flown)
    if flown.complete:
        return TurnDecision("start", f"{flown.name} has flown its mission")
    return _wait(flown)


def _wait(flown: Turn) -> TurnDecision:
    """Wait on, but not without end."""
    phase, _ = flown.phase
    why, longest_s = phase.value
    if flown.waited_s <= longest_s:
        return TurnDecision("wait", "")
    missing = f" ({flown.landed.why})" if phase is Phase.EVIDENCE else ""
    return TurnDecision("end", f"{flown.name}: {why}{missing}, for {longest_s:.0f} s")


def is_at_home(vehicle: Vehicle, *, flying: bool) -> bool:
    """True if it is where its returns end: within the circle about its home, or where it stays there. One that still
    sinks to the height at which it holds does not stay."""
    position, home = vehicle.telemetry("position"), vehicle.telemetry("home")
    if position is None or home is None or position["lat_deg"] is None:
        return False
    away_m = distance_m(position["lat_deg"], position["lon_deg"], home["lat_deg"], home["lon_deg"])
    velocity_mps = position["vel_enu_mps"] if flying else position["vel_enu_mps"][:2]
    stays = vehicle.abilities.circles or math.hypot(*velocity_mps) < STANDS_MPS
    return stays and away_m <= vehicle.return_reach_m + AT_HOME_M


class HomeWatch:
    """How long one vehicle has been at its home without a break. To be asked a few times a second."""

    def __init__(self) -> None:
        self._since: float | None = None

    def stays_s(self, vehicle: Vehicle, now: float, *, flying: bool) -> float:
        """Since when it `is_at_home`, s; 0: it is not."""
        if not is_at_home(vehicle, flying=flying):
            self._since = None
            return 0.0
        if self._since is None:
            self._since = now
        return now - self._since


def last_moving(items: Sequence[MissionItem]) -> int | None:
    """The number of the last item that moves the vehicle; None: none does."""
    return max((number for number, item in enumerate(items, FIRST_ITEM) if item.moves), default=None)


STAYS_ARMED = (ReturnEnd.HOLDS, ReturnEnd.CIRCLES, ReturnEnd.STANDS, ReturnEnd.STANDS_DISARMED)
"""Ends of a return after which it stays armed, or may."""


def ends_on_ground(items: Sequence[MissionItem], return_end: ReturnEnd = ReturnEnd.LANDS) -> bool:
    """True if the last item that moves the vehicle leaves it on the ground and disarmed, or may. ``return_end``: how
    its returns end; what is not known is waited for. One that stands at its home need not disarm."""
    last = last_moving(items)
    if last is None:
        return False
    if ends_with_return(items):
        return return_end not in STAYS_ARMED
    return items[last - FIRST_ITEM].command in ENDS_ON_GROUND


def ends_with_return(items: Sequence[MissionItem]) -> bool:
    """True if the last item that moves the vehicle is a return."""
    last = last_moving(items)
    return last is not None and items[last - FIRST_ITEM].command == mav_cmd.NAV_RETURN_TO_LAUNCH
