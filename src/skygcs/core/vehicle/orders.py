"""Orders and the checks of skygcs before each; the differences between autopilots are in `autopilot`.

Every function returns the plan or raises RefusedError, whose text gives the reason and, if possible, how to insist.

`arm --wait` repeats the command while the estimator converges, but not while the mode or a switch forbids arming:
reasons for a refusal that do not pass with time have a text on what the operator does about each. They are those of the
firmwares: ArduPilot `AP_Arming.cpp` and `ArduCopter/AP_Arming.cpp` (4.7-dev), PX4 `CommandClient.cpp` and
`HealthAndArmingChecks` (1.16). A reason that is not listed may pass with time.

The emergency stop: hold, land or kill, repeated until the vehicle's state shows its effect.

    hold    the mode that stops and holds (AUTO.LOITER, BRAKE), in which no setpoints move the vehicle
    land    the order land; of a class that has no landing the same as hold
    kill    forced disarming: the motors stop, and a flying vehicle falls; needs a confirmation

Unlike plain orders it is also sent to a vehicle that is lost or shares its id with another, with the highest priority
and over every link. It is repeated until the heartbeat shows its effect, the vehicle refuses it, or `PERSIST_S` is
over. A newer order replaces hold and land, but not kill.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypedDict, Unpack

from skygcs.core.geo import REACH_M, distance_m, geodetic_from_enu, is_on_earth, swapped_hint
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.modes import PX4_NOT_ARMABLE
from skygcs.core.mavlink.vehicle_class import TakeOff
from skygcs.core.protocols.command import CommandSpec, Location
from skygcs.core.radio_link.stream_rates import MAX_RATE_HZ, rate_problem
from skygcs.core.vehicle import autopilot
from skygcs.core.vehicle.autopilot import Destination
from skygcs.core.vehicle.fence_params import require_below_fence
from skygcs.core.vehicle.flight_evidence import contradiction, why_maybe_in_air, why_not_idle
from skygcs.core.vehicle.order_plan import CLIMBED_M, MessageAfter, Plan, Step
from skygcs.core.vehicle.order_plan import FORCE_HINT as FORCE_HINT  # beside the orders that are refused with it
from skygcs.core.vehicle.stick_modes import PX4_STICK_MODES
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.spelling import enumerated, near_names, rounded

MAX_TAKEOFF_M = 500.0

ORDER_POSITION_S = 10.0
"""Oldest position by which an order is checked: distances and altitudes of something that may have flown on meanwhile,
which needs no centimetres. The slowest stream profile sends 0.5 Hz, so that four may be lost in a row."""

LOWEST_M = 1.0
"""A goto below this height above home flies into the ground; a height of 0 most likely was never filled in."""

MAX_ENU_M = 100_000.0
"""At this distance the flat frame is 800 m above the ground; such an order is a mistake."""

MAX_HEIGHT_M = 20_000.0

COMMON_WORDS = frozenset({"NAV", "SET", "GET", "MAV", "CMD"})
"""Parts of so many command names that they are no basis for a suggestion."""

INT32 = 1 << 31


def arm(vehicle: Vehicle, now: float, *, force: bool = False, estimate_msgid: int | None = None) -> Plan:
    """``estimate_msgid``, of EKF_STATUS_REPORT: an ArduCopter is not armed before its estimator has a position.

    Raises RefusedError in a mode in which arming may set it off: a PX4 stays in AUTO.MISSION when it disarms after a
    mission, and flies the mission again as soon as it is armed."""
    require_connected(vehicle, now)
    able = vehicle.abilities
    if not force and vehicle.mode in able.moves_off and not vehicle.armed:
        moves = "take off" if able.flies else "drive on"
        starts = "mission start" + (", takeoff" if able.takeoff is not TakeOff.NONE else "")
        raise RefusedError(
            f"it is in {vehicle.mode} and may {moves} at once; set another mode first ({able.stop_mode}), or start "
            f"what it is to do ({starts}); {FORCE_HINT}"
        )
    plan = autopilot.arm(force=force)
    if estimate_msgid is not None and not force:
        plan = autopilot.arm_to_fly(vehicle, now, estimate_msgid)
    last = replace(plan.steps[-1], refused=todo_in_mode(vehicle.family, vehicle.mode, vehicle.name) or "")
    return replace(plan, steps=(*plan.steps[:-1], last))


def disarm(vehicle: Vehicle, now: float, *, force: bool = False) -> Plan:
    """A forced disarming is an emergency order: it is sent also to a lost or flying vehicle."""
    require_live(vehicle)
    if not force:
        require_connected(vehicle, now)
        if vehicle.in_air(now):
            raise RefusedError(f"it is in the air ({vehicle.landed(now)}) and would fall; {FORCE_HINT}")
        if (why := contradiction(vehicle, now)) is not None:
            raise RefusedError(f"{why}, and it would fall; {FORCE_HINT}")
    return autopilot.disarm(force=force)


def set_mode(vehicle: Vehicle, now: float, name: str, *, force: bool = False) -> Plan:
    """The outgoing gate judges the mode; ``force`` insists there."""
    require_connected(vehicle, now)
    return replace(autopilot.set_mode(vehicle, name), force=force)


def takeoff(vehicle: Vehicle, now: float, height_m: float, *, arm: bool = True, force: bool = False) -> Plan:
    """Take off to a height above the ground it stands on. ``force``: also above its own fence."""
    require_connected(vehicle, now)
    if not (math.isfinite(height_m) and 0 < height_m <= MAX_TAKEOFF_M):
        raise RefusedError(f"a takeoff height of {rounded(height_m)} m is not above 0 and at most {MAX_TAKEOFF_M:g} m")
    if vehicle.in_air(now):
        raise RefusedError("it is in the air already; use goto with a height")
    if not vehicle.armed and not arm:
        raise RefusedError("it is not armed, and the takeoff was ordered without arming")
    if not force:  # its home is where it takes off: both autopilots set it as they arm
        require_below_fence(vehicle, height_m)
    position = fresh_position(vehicle, now)
    return autopilot.takeoff(vehicle, height_m, None if position is None else position[2])


def land(vehicle: Vehicle, now: float) -> Plan:
    require_connected(vehicle, now)
    down = _down_already("land", vehicle, now) if vehicle.abilities.lands else None
    return down or autopilot.land(vehicle, now)


def rtl(vehicle: Vehicle, now: float) -> Plan:
    require_connected(vehicle, now)
    down = _down_already("rtl", vehicle, now) if vehicle.abilities.returns else None
    return down or autopilot.rtl(vehicle, now)


def _down_already(order: str, vehicle: Vehicle, now: float) -> Plan | None:
    """Nothing to do for what is certainly disarmed, and on the ground if it flies: it would not move, and stay in a
    mode of its landing or return, in which neither firmware arms. None: it may be under way."""
    state, at = vehicle.landed_state()
    stands = not vehicle.abilities.flies or (state == "on_ground" and now - at <= ORDER_POSITION_S)
    if not stands or why_not_idle(vehicle, now) is not None:
        return None
    done = "it is on the ground and disarmed already; nothing was sent"
    if not vehicle.abilities.flies:
        done = "it is disarmed and stays where it is; nothing was sent: arm it first"
    return Plan(order, (), done, despite_duplicate=True)


def hold(vehicle: Vehicle, now: float) -> Plan:
    require_connected(vehicle, now)
    return autopilot.hold(vehicle, now)


def brake(vehicle: Vehicle, now: float) -> Plan:
    """A hold in a mode that ignores setpoints, for a vehicle to which somebody else may still send some."""
    require_connected(vehicle, now)
    return autopilot.brake(vehicle, now)


class Where(TypedDict, total=False):
    """Arguments of a goto; see `destination`."""

    lat_deg: float | None
    lon_deg: float | None
    height_m: float | None
    enu_m: Sequence[float] | None
    yaw_deg: float | None
    force: bool


def goto(vehicle: Vehicle, now: float, *, limit_m: float, **where: Unpack[Where]) -> Plan:
    """Go to a `destination`. The outcome states the position as it was given: metres of the fleet's frame, or
    degrees."""
    plan = autopilot.goto(vehicle, destination(vehicle, now, limit_m=limit_m, **where))
    enu_m = where.get("enu_m")
    if enu_m is None:
        return plan
    return replace(plan, done="going to x {:.1f}, y {:.1f}, up {:.1f} m".format(*enu_m))


def destination(vehicle: Vehicle, now: float, *, limit_m: float, **where: Unpack[Where]) -> Destination:
    """A geodetic position (``height_m`` above this vehicle's home, None: its present height) or a point of the fleet's
    frame (``enu_m``). ``force`` overrides the distance limit, its own fence's height and the ground check, never an
    impossible coordinate."""
    hovers = vehicle.family == "ardupilot" and vehicle.hovers(now)
    if hovers and not autopilot.stays_on_rotors(vehicle, now) and not where.get("force"):
        raise RefusedError(
            "it hovers, and in GUIDED it would fly on as a plane and circle there unless its Q_GUIDED_MODE is 1; it is "
            f"not known to be; {FORCE_HINT}"
        )
    if where.get("yaw_deg") is not None and not vehicle.abilities_now(now).turns:
        raise RefusedError(f"a {vehicle.kind} of {autopilot.firmware_name(vehicle)} takes no heading; leave it out")
    here, home_amsl_m = require_going(vehicle, now)
    lat_deg, lon_deg, height_m = where.get("lat_deg"), where.get("lon_deg"), where.get("height_m")
    enu_m, yaw_deg = where.get("enu_m"), where.get("yaw_deg")
    ground = not vehicle.abilities.flies
    if enu_m is not None:
        if lat_deg is not None or lon_deg is not None or height_m is not None:
            raise RefusedError("give either enu_m or lat_deg, lon_deg and height_m")
        to = _from_enu(vehicle, enu_m, home_amsl_m)
    else:
        to = _from_geodetic(lat_deg, lon_deg, height_m, here, home_amsl_m)
    if yaw_deg is not None:
        _require_within("a yaw", yaw_deg, 360.0)
        to = replace(to, yaw_deg=yaw_deg)
    _check_reach(here, to, limit_m, ground=ground, force=bool(where.get("force")))
    if not where.get("force") and to.alt_amsl_m > here[2]:  # down is the way back below it
        require_below_fence(vehicle, to.height_m)
    return to


def reboot(vehicle: Vehicle, now: float, *, force: bool = False) -> Plan:
    require_connected(vehicle, now)
    if not force and (why := why_not_idle(vehicle, now)) is not None:
        raise RefusedError(f"{why}; {FORCE_HINT}")
    return autopilot.reboot(vehicle, force=force)


def set_home(
    vehicle: Vehicle,
    now: float,
    *,
    lat_deg: float | None = None,
    lon_deg: float | None = None,
    alt_amsl_m: float | None = None,
    limit_m: float = math.inf,
    force: bool = False,
) -> Plan:
    """Set its home; without arguments at its present position. The altitude defaults to that of the old home.

    In the air all its heights are relative to its home, so a change in the air needs ``force``; so does a home farther
    away than ``limit_m``, to which a return would fly.
    """
    require_connected(vehicle, now)
    # not in the air
    if (why := why_maybe_in_air(vehicle, now)) is not None and not force:
        raise RefusedError(f"{why}, and its heights are counted from its home: land first, or {FORCE_HINT}")
    if lat_deg is None and lon_deg is None and alt_amsl_m is None:
        return autopilot.set_home(None)
    if lat_deg is None or lon_deg is None:
        raise RefusedError("a home needs both latitude and longitude")
    # a plausible place, not too far away
    check_coordinate(lat_deg, lon_deg)
    here = fresh_position(vehicle, now)
    if here is not None:
        _check_distance(here, (lat_deg, lon_deg), limit_m, ", and it would return there", force=force)
    # its altitude
    alt = vehicle.home_alt_amsl_m() if alt_amsl_m is None else alt_amsl_m
    if alt is None:
        raise RefusedError("its home altitude is not known; give one")
    _require_within("an altitude", alt, MAX_HEIGHT_M)
    return autopilot.set_home(Destination(lat_deg, lon_deg, alt, 0.0))


def message_interval(vehicle: Vehicle, now: float, dialect: Dialect, message: str | int, rate_hz: float | None) -> Plan:
    require_connected(vehicle, now)
    return interval_plan(dialect, message, rate_hz, autopilot.firmware_name(vehicle))


def interval_plan(dialect: Dialect, message: str | int, rate_hz: float | None, whose: str = "it") -> Plan:
    """SET_MESSAGE_INTERVAL to any component, which ``whose`` names in a refusal."""
    problem = None if rate_hz is None else rate_problem(rate_hz)
    if problem is not None:
        raise RefusedError(f"its rate {problem}")
    msgid, name = find_message(dialect, message)
    return autopilot.message_interval(msgid, rate_hz, refused=f"{whose} does not stream {name}")


def request_message(vehicle: Vehicle, now: float, dialect: Dialect, message: str | int) -> Plan:
    require_connected(vehicle, now)
    msgid, name = find_message(dialect, message)
    expect = MessageAfter(name, vehicle.count(name))
    refused = f"{autopilot.firmware_name(vehicle)} does not send {name} on request"
    step = Step("request", CommandSpec(mav_cmd.REQUEST_MESSAGE, (float(msgid),)), expect=expect, refused=refused)
    return Plan("request", (step,), f"{name} came")


def request_stream(vehicle: Vehicle, now: float, dialect: Dialect, stream: int | str, rate_hz: float) -> Plan:
    """See `stream_plan`."""
    require_connected(vehicle, now)
    return stream_plan(dialect, stream, rate_hz)


def stream_plan(dialect: Dialect, stream: int | str, rate_hz: float) -> Plan:
    """REQUEST_DATA_STREAM to any component. Rates are whole numbers; 0 stops the stream."""
    if rate_hz != 0 and not 1 <= rate_hz <= MAX_RATE_HZ:
        raise RefusedError(f"a stream's rate must be 0 (off) or 1 to {MAX_RATE_HZ:g} Hz, not {rate_hz:g}")
    values = {
        "req_stream_id": stream_number(dialect, stream),
        "req_message_rate": round(rate_hz),
        "start_stop": int(rate_hz > 0),
    }
    step = Step("stream", message=("REQUEST_DATA_STREAM", values), expect_s=0)
    return Plan("stream", (step,), "sent; a stream request has no acknowledgement: check the message rates")


def stream_number(dialect: Dialect, stream: int | str) -> int:
    """MAV_DATA_STREAM by name (``POSITION``, ``ALL``) or number."""
    if isinstance(stream, int) or stream.isdigit():
        if 0 <= int(stream) <= 255:
            return int(stream)
        raise RefusedError(f"stream {stream} is not between 0 and 255")
    streams = {v.removeprefix("MAV_DATA_STREAM_"): k for k, v in dialect.enums.get("MAV_DATA_STREAM", {}).items()}
    number = streams.get(stream.upper().removeprefix("MAV_DATA_STREAM_"))
    if number is None:
        raise RefusedError(f"no stream {stream!r}; there are {', '.join(n for n in streams if n != 'ENUM_END')}")
    return number


def command_plan(
    dialect: Dialect,
    command: str | int,
    params: Sequence[float | None],
    *,
    int_frame: int | str | None = None,
    x: int | None = None,
    y: int | None = None,
    z: float | None = None,
) -> Plan:
    """Any MAV_CMD to any component. None among the params is NaN ("not given"). With ``int_frame`` (MAV_FRAME) it is
    sent as COMMAND_INT, x and y as on the wire: degrees * 1e7 in a global frame, metres * 1e4 in a local one."""
    number, name = find_command(dialect, command)
    values = tuple(math.nan if p is None else float(p) for p in params)
    most = 7 if int_frame is None else 4
    if len(values) > most:
        raise RefusedError(f"{name} was given {len(values)} parameters; there are {most}")
    if int_frame is None:
        if x is not None or y is not None or z is not None:
            raise RefusedError("x, y and z belong to COMMAND_INT: give int_frame, or params 5 to 7")
        spec = CommandSpec(number, values)
    else:
        frame = _frame_number(dialect, int_frame)
        spec = CommandSpec(number, values, Location(frame, _int32("x", x), _int32("y", y), z or 0.0))
    return Plan("command", (Step(name, spec),), f"{name} accepted")


def find_message(dialect: Dialect, message: str | int) -> tuple[int, str]:
    """(msgid, name) of a message of the dialect; a number may also be a msgid it does not have."""
    try:
        info = dialect.find(message)
    except KeyError as error:
        if isinstance(message, int) and 0 <= message < 1 << 24:
            return message, f"message {message}"
        raise RefusedError(str(error.args[0])) from None
    return info.msgid, info.name


def find_command(dialect: Dialect, command: str | int) -> tuple[int, str]:
    """(number, name) of a MAV_CMD, by name with or without MAV_CMD_, or by number (which needs no name)."""
    names = dialect.enums.get("MAV_CMD", {})
    if isinstance(command, int) or command.isdigit():
        number = int(command)
        if not 0 <= number <= 0xFFFF:
            raise RefusedError(f"command {number} is not between 0 and 65535")
        return number, names.get(number, f"MAV_CMD {number}").removeprefix("MAV_CMD_")
    wanted = command.upper().removeprefix("MAV_CMD_")
    for number, name in names.items():
        if name.removeprefix("MAV_CMD_") == wanted:
            return number, wanted

    near = _near_commands(wanted, [n.removeprefix("MAV_CMD_") for n in names.values()])
    hint = f"did you mean {', '.join(near)}?" if near else "give a name of MAV_CMD, as NAV_LAND, or a number"
    raise RefusedError(f"no command {command!r}; {hint}")


def _near_commands(wanted: str, names: Sequence[str]) -> list[str]:
    """At most five similar names: close spellings first, then names that share a word."""
    near = near_names(wanted, names, n=3)
    words = {word for word in wanted.split("_") if len(word) > 2 and word not in COMMON_WORDS}
    sharing = [n for n in names if words.intersection(n.split("_")) and n not in near]
    return [*near, *near_names(wanted, sharing, n=5 - len(near), cutoff=0.0)]


def require_live(vehicle: Vehicle) -> None:
    """Raises RefusedError for a vehicle of a recording."""
    if vehicle.replayed:
        raise RefusedError("it is heard only in a recording and cannot take orders")


def require_connected(vehicle: Vehicle, now: float) -> None:
    require_live(vehicle)
    if vehicle.dropped:
        raise RefusedError(vehicle.dropped)
    if not vehicle.connected:
        age = vehicle.silence_s(now)
        raise RefusedError("it is lost: " + ("no heartbeat yet" if age is None else f"no heartbeat for {age:.0f} s"))


def require_going(vehicle: Vehicle, now: float) -> tuple[tuple[float, float, float], float]:
    """(lat_deg, lon_deg, alt_amsl_m) and the altitude of its home, for a vehicle that can fly a goto now.

    Raises RefusedError if it is lost, disarmed, on the ground, or its position is not known.
    """
    require_connected(vehicle, now)
    if not vehicle.armed:
        raise RefusedError("it is disarmed; " + ("take off first" if vehicle.abilities.flies else "arm it first"))
    if vehicle.abilities.flies and _on_ground(vehicle, now):
        raise RefusedError("it is on the ground; take off first")
    here = fresh_position(vehicle, now)
    home_amsl_m = vehicle.home_alt_amsl_m()
    if here is None or home_amsl_m is None:
        raise RefusedError("its position is not known (or older than 10 s), so the distance cannot be checked")
    return here, home_amsl_m


def _frame_number(dialect: Dialect, frame: int | str) -> int:
    names = dialect.enums.get("MAV_FRAME", {})
    if isinstance(frame, int) or frame.isdigit():
        if 0 <= int(frame) <= 255:
            return int(frame)
        raise RefusedError(f"frame {frame} is not between 0 and 255")
    wanted = frame.upper().removeprefix("MAV_FRAME_")
    for number, name in names.items():
        if name.removeprefix("MAV_FRAME_") == wanted:
            return number
    raise RefusedError(
        f"no frame {frame!r}; there are {', '.join(n.removeprefix('MAV_FRAME_') for n in names.values())}"
    )


def _int32(name: str, value: int | None) -> int:
    value = 0 if value is None else value
    if not -INT32 <= value < INT32:
        raise RefusedError(f"{name} {value} does not fit in 32 bits")
    return value


def _on_ground(vehicle: Vehicle, now: float) -> bool:
    """True by its landed state, unless it has climbed since that came: it comes every two seconds."""
    if vehicle.in_air(now) is not False:
        return False
    position, at = vehicle.telemetry("position"), vehicle.telemetry_at("position")
    height_m = None if position is None or at is None or now - at > ORDER_POSITION_S else position["alt_rel_m"]
    return height_m is None or height_m < CLIMBED_M


def fresh_position(vehicle: Vehicle, now: float) -> tuple[float, float, float] | None:
    """Latitude and longitude (degrees) and height above sea level (m) of a vehicle; None: not known, older than
    `ORDER_POSITION_S`, or not on earth."""
    position, at = vehicle.telemetry("position"), vehicle.telemetry_at("position")
    if position is None or at is None or position["lat_deg"] is None or now - at > ORDER_POSITION_S:
        return None
    here = position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]
    return here if is_on_earth(*here) else None


def _from_enu(vehicle: Vehicle, enu_m: Sequence[float], home_amsl_m: float) -> Destination:
    if len(enu_m) != 3:
        raise RefusedError(f"enu_m is x, y, up (east, north, up): three numbers, not {len(enu_m)}")
    for value, most in zip(enu_m, (MAX_ENU_M, MAX_ENU_M, MAX_HEIGHT_M), strict=True):
        _require_within("an ENU coordinate", value, most)
    if vehicle.origin is None:
        raise RefusedError("the fleet has no origin yet, so ENU means nothing; set one, or use lat and lon")
    lat, lon, alt = geodetic_from_enu(enu_m[0], enu_m[1], enu_m[2], vehicle.origin)
    check_coordinate(lat, lon)
    return Destination(lat, lon, alt, alt - home_amsl_m)


def _from_geodetic(
    lat_deg: float | None,
    lon_deg: float | None,
    height_m: float | None,
    here: tuple[float, float, float],
    home_amsl_m: float,
) -> Destination:
    if lat_deg is None and lon_deg is None:
        if height_m is None:
            raise RefusedError("give a place: lat_deg and lon_deg, a height_m, or enu_m")
        lat_deg, lon_deg = here[:2]
    if lat_deg is None or lon_deg is None:
        raise RefusedError("a place needs both latitude and longitude")
    check_coordinate(lat_deg, lon_deg)
    if height_m is None:
        return Destination(lat_deg, lon_deg, here[2], here[2] - home_amsl_m)
    _require_within("a height", height_m, MAX_HEIGHT_M)
    return Destination(lat_deg, lon_deg, home_amsl_m + height_m, height_m)


def is_place(lat_deg: float, lon_deg: float) -> bool:
    """True for a plausible position: a coordinate of exactly 0 was most likely never filled in."""
    return 0 < abs(lat_deg) <= 90 and 0 < abs(lon_deg) <= 180


def check_coordinate(lat_deg: float, lon_deg: float) -> None:
    """Raises RefusedError. A coordinate of exactly 0 is refused: an unset variable would send a vehicle to 0, 0."""
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180):  # also false for NaN
        raise RefusedError(
            f"{lat_deg:g}, {lon_deg:g} is not a position on earth (latitude -90..90, longitude -180..180)"
            + swapped_hint(lat_deg, lon_deg, None, 0.0)
        )
    if lat_deg == 0 or lon_deg == 0:
        raise RefusedError(f"{lat_deg:g}, {lon_deg:g} has a zero coordinate: most likely a value was never filled in")


def _check_reach(
    here: tuple[float, float, float], to: Destination, limit_m: float, *, ground: bool, force: bool
) -> None:
    _check_distance(here, (to.lat_deg, to.lon_deg), limit_m, "", force=force, up_m=to.alt_amsl_m - here[2])
    if force:
        return
    if to.height_m < LOWEST_M and not ground:
        where = "below" if to.height_m < 0 else "above"
        raise RefusedError(
            f"that is {abs(to.height_m):.1f} m {where} its home, on the ground: use land, or {FORCE_HINT}"
        )


def _check_distance(
    here: tuple[float, float, float],
    to: tuple[float, float],
    limit_m: float,
    why: str,
    *,
    force: bool,
    up_m: float = 0.0,
) -> None:
    """Refuse a place that is farther away than the limit, unless ``force``, and one beyond any vehicle's reach."""
    away_m = math.hypot(distance_m(here[0], here[1], *to), up_m)
    hint = swapped_hint(*to, here[:2], limit_m)
    if away_m > REACH_M:
        raise RefusedError(f"that is {away_m / 1000.0:.0f} km away{why}: beyond what any vehicle can reach{hint}")
    if away_m > limit_m and not force:
        raise RefusedError(f"that is {away_m:.0f} m away{why}; the limit is {limit_m:g} m{hint}; {FORCE_HINT}")


def _require_within(what: str, value: float, most: float) -> None:
    if not abs(value) <= most:  # also false for NaN
        raise RefusedError(f"{what} of {value:g} is not between {-most:g} and {most:g}")


# --- reasons for a refusal --------------------------------------------------------------------------------------------

LASTING_REASONS: tuple[tuple[str, str], ...] = (
    (r"mode not armable", "set another mode first: skygcs-cli mode {name} {arms_in}"),
    (r"switch to manual mode first", "set another mode first: skygcs-cli mode {name} AUTO.LOITER"),
    (r"hardware safety switch|press safety", "press the safety switch on the vehicle"),
    (r"motors emergency stopped|kill switch engaged", "release the kill switch of its transmitter"),
    (r"disarm switch on", "release the disarm switch of its transmitter"),
    (r"RTL switch engaged", "release the return switch of its transmitter"),
    (r"calibration needed|(?<!gyros )not calibrated|uncalibrated", "calibrate it in QGroundControl or Mission Planner"),
    (r"requires reboot", "reboot it: skygcs-cli reboot {name}"),
    (
        r"radio failsafe on|RC calibrating|not neutral|throttle above center|denied: high throttle",
        "check its transmitter",
    ),
    (r"below minimum arming voltage|low battery", "charge or change its battery"),
    (r"no SD card|missing FMU SD card", "put an SD card into its autopilot"),
    (r"sensor \d+ missing|compass sensor \d+ missing", "check its sensors; preflight lists them"),
    (r"duplicate aux switch|RC\d*_OPTION conflict", "correct its parameters; preflight lists them"),
    (
        r"leaning|attitude failure|high angle|vehicle is not level",
        "it does not stand upright: set it up; a simulated vehicle is set up by a restart: skygcs-cli reboot {name}",
    ),
    (r"check frame_class", "set its frame: skygcs-cli param set {name} FRAME_CLASS 1 (1: quadrotor), then reboot it"),
)
"""Regular expression of the vehicle's text (any case), and what to do; ``{name}`` is the vehicle, ``{arms_in}`` a
mode in which its class arms."""

_PATTERNS = tuple((re.compile(pattern, re.IGNORECASE), todo) for pattern, todo in LASTING_REASONS)


def todo_for(texts: Iterable[str], name: str, stop_mode: str = "") -> str | None:
    """Return what the operator has to do before ``name`` arms; None if the reasons in ``texts`` may pass with time.
    ``stop_mode``: that of its class (`Abilities`); a copter does not arm in its own, BRAKE."""
    arms_in = "HOLD" if stop_mode == "HOLD" else "GUIDED"
    for text in texts:
        for pattern, todo in _PATTERNS:
            if pattern.search(text):
                return todo.format(name=name, arms_in=arms_in)
    return None


def todo_in_mode(family: str, mode: str, name: str) -> str | None:
    """Return why ``name`` may not arm in ``mode``, and what to do, where its firmware's text does not name the mode: a
    PX4 1.16 says "Resolve system health failures first" in all of these (modeCheck.cpp). None: it arms, as far as the
    mode is concerned. It disarms into OFFBOARD if that was the last mode before its landing (UserModeIntention.cpp)."""
    if family != "px4":
        return None
    if mode in PX4_NOT_ARMABLE:
        why = f"it does not arm in {mode}"
    elif mode == "OFFBOARD":
        why = "in OFFBOARD it arms only while setpoints come"
    elif mode in PX4_STICK_MODES:
        why = f"in {mode} it arms only with sticks"
    else:
        return None
    return f"{why}; set another mode first: skygcs-cli mode {name} AUTO.LOITER"


# --- the emergency stop -----------------------------------------------------------------------------------------------

Action = Literal["hold", "land", "kill"]

PERSIST_S = 30.0
"""Some fifty transmissions. If none of them arrives, the vehicle's own failsafe for a lost station acts."""

MAX_NAMES = 10
"""Vehicles listed in a refusal; of further ones the number is stated."""


def stop(vehicle: Vehicle, now: float, action: Action) -> Plan:
    """Raises RefusedError for a vehicle of a recording, and for a hold if it has no mode that holds."""
    require_live(vehicle)
    if action == "hold" or (action == "land" and not autopilot.can_land(vehicle)):
        plan = autopilot.brake(vehicle, now)
        hint = f"{autopilot.firmware_name(vehicle)} did not say why; stop it with land"
        plan = replace(plan, steps=tuple(replace(step, refused=hint) for step in plan.steps))
    elif action == "land":
        known = vehicle.abilities.lands
        plan = autopilot.land(vehicle, now) if known else autopilot.land_by_command(vehicle)
    else:
        plan = replace(autopilot.disarm(force=True), done="motors stopped")
    return replace(plan, order="stop", emergency=True, persist_s=PERSIST_S)


def require_confirmed(action: str, vehicles: Mapping[str, str | None], confirm: str | None) -> None:
    """Raises RefusedError for a kill, or for the action "disarm" with a duplicate system id, without the right word of
    confirmation. The error names the vehicles and the word.

    ``vehicles``: vehicle name -> where a second vehicle sends with its ids (`SharedIds.where`). The word
    contains the number of vehicles that would get the order, duplicates included: a script written for one vehicle
    does not kill them all, and the word can be typed quickly.
    """
    twice = sum(where is not None for where in vehicles.values())
    if action not in ("kill", "disarm") or (action == "disarm" and not twice):
        return
    word = f"{action}-{len(vehicles) + twice}"
    if confirm == word:
        return
    # duplicates first: they are the reason for the word
    names = sorted(vehicles, key=lambda name: vehicles[name] is None)
    named = [name if (where := vehicles[name]) is None else f"{name} (two vehicles: {where})" for name in names]
    wrong = "" if confirm is None else f", not {confirm[:40]!r}"
    text = f"{action} stops the motors of {enumerated(named, MAX_NAMES)}, which will fall if flying"
    raise RefusedError(f"{text}; confirm with {word!r}{wrong}")
