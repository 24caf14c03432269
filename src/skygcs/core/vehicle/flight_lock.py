"""The lock of a flight: what it was certified or entered with, and the changes that have to wait for its end. Pure.

A plan, a trajectory and an engagement each hold one `FlightLock` from their begin to their end. What they fly is made
from it and never from the fleet's present values, so that an order cannot change a flight under way. An order that
would change one of these values asks first:

    change                          applied while the lock is held                         refused otherwise
    ------------------------------  -----------------------------------------------------  -----------------
    `OriginChange`                  the same origin again                                  always
    `ParamWrite`                    roles that change no flight; tuning if somebody        always
                                    insists (`params.names`)
    `FenceWrite`                    each limit as wide or wider, the same action           always
    `FenceListWrite`, `RallyWrite`  never                                                  always
    `LinkLoss`                      another link carries the members as well               always
    `Renumbering`                   never                                                  always
    `HomeMove`                      by less than SAME_PLACE_M                              always
    `SensorCalibration`             never                                                  always
    `EstimatorOrigin`               never                                                  always
    `RateChange`                    messages that no flight needs                          always
    `Forgetting`                    never                                                  always
    `SigningClockReset`             never                                                  always
    `ConsoleInput`                  never                                                  always

A refusal names the flight and the command that ends it. There is no force: whoever insists ends the flight first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from skygcs.core.control.control_fence import Fence
from skygcs.core.geo import Origin, distance_m
from skygcs.core.params.names import EFFECTS, LOCKED, ParamRole, role_of
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, TrajectoryLimits
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.spelling import enumerated

SAME_PLACE_M = 1.0
"""Two reports of one home differ by less: GLOBAL_POSITION_INT and HOME_POSITION round to centimetres, and an ArduCopter
sets its home anew at each arming, from a fix that wanders by some decimetres."""

NEEDED_MESSAGES = frozenset(
    {
        *("HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE", "SYSTEM_TIME", "TIMESYNC", "COMMAND_ACK"),
        *("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE", "ATTITUDE_QUATERNION"),
    }
)
"""Messages by which a flight is judged, and without which its guard ends it."""

NAMED = 5
"""Members that a refusal names."""

GeodeticPlace = tuple[float, float, float]
"""lat_deg, lon_deg, alt_amsl_m."""


class Holder(StrEnum):
    """The kind of flight that holds a lock; the order is that in which they are ended."""

    PLAN = "plan"
    TRAJECTORY = "trajectory"
    ENGAGEMENT = "control"


@dataclass(frozen=True, slots=True)
class Member:
    """One vehicle of a flight, as it was certified or entered with."""

    name: str
    key: int
    """sysid << 8 | compid."""
    family: str
    fence: Fence
    """The control fence, on earth."""
    limits: TrajectoryLimits
    home: GeodeticPlace | None
    links: frozenset[str]
    """Names of the links that carried it."""
    mode: str
    """The mode it was in."""


@dataclass(frozen=True, slots=True)
class OriginChange:
    """The fleet's world frame gets another origin; None: it has none any more."""

    origin: Origin | None


@dataclass(frozen=True, slots=True)
class ParamWrite:
    """A parameter of a vehicle is set."""

    key: int
    name: str
    force: bool = False


@dataclass(frozen=True, slots=True)
class FenceWrite:
    """The fence of a vehicle's parameters is set; ``widens``: no limit is nearer than before, no action another one."""

    key: int
    widens: bool


@dataclass(frozen=True, slots=True)
class FenceListWrite:
    """The polygons and circles of a vehicle are replaced or deleted."""

    key: int


@dataclass(frozen=True, slots=True)
class LinkLoss:
    """A link is closed; ``alone``: the vehicles that no other link carries."""

    link: str
    alone: frozenset[int]


@dataclass(frozen=True, slots=True)
class Renumbering:
    """A vehicle gets another system id."""

    key: int


@dataclass(frozen=True, slots=True)
class HomeMove:
    """A vehicle gets another home; None: where it is."""

    key: int
    place: GeodeticPlace | None


@dataclass(frozen=True, slots=True)
class SensorCalibration:
    """A sensor of a vehicle is calibrated."""

    key: int


@dataclass(frozen=True, slots=True)
class RallyWrite:
    """The rally points of a vehicle are replaced or deleted."""

    key: int


@dataclass(frozen=True, slots=True)
class EstimatorOrigin:
    """A vehicle's estimator gets another origin."""

    key: int


@dataclass(frozen=True, slots=True)
class RateChange:
    """A message of a vehicle comes at another rate. ``message``: its name; None: a whole group of them."""

    key: int
    message: str | None


@dataclass(frozen=True, slots=True)
class Forgetting:
    """A vehicle is dropped from the fleet until it is heard again."""

    key: int


@dataclass(frozen=True, slots=True)
class SigningClockReset:
    """The clock of a signing key is set back: a vehicle that has heard a later time hears us no more."""


@dataclass(frozen=True, slots=True)
class ConsoleInput:
    """Text is typed into the console of a vehicle: it may change anything."""

    key: int


Change = (
    OriginChange
    | ParamWrite
    | FenceWrite
    | FenceListWrite
    | LinkLoss
    | Renumbering
    | HomeMove
    | SensorCalibration
    | RallyWrite
    | EstimatorOrigin
    | RateChange
    | Forgetting
    | SigningClockReset
    | ConsoleInput
)


@dataclass(frozen=True, slots=True)
class FlightLock:
    """Everything that one flight holds. ``title``: the plan's or trajectory's name, empty for an engagement."""

    holder: Holder
    title: str
    origin: Origin
    members: tuple[Member, ...]

    def member(self, name: str) -> Member:
        """Raises KeyError."""
        return next(member for member in self.members if member.name == name)

    def holds(self, key: int) -> bool:
        """True if a vehicle is a member."""
        return any(member.key == key for member in self.members)

    def of(self, names: frozenset[str]) -> FlightLock:
        """The lock of only some of its members."""
        return replace(self, members=tuple(member for member in self.members if member.name in names))

    def in_modes(self, modes: Mapping[str, str]) -> FlightLock:
        """The lock with the modes in which its members are by now."""
        members = tuple(replace(member, mode=modes.get(member.name, member.mode)) for member in self.members)
        return replace(self, members=members)

    def path_refusal(self, name: str, loaded: LoadedTrajectory, speed_factor: float) -> str | None:
        """Why a member may not be sent along this trajectory at all, wherever it is now; None if it may."""
        member = self.member(name)
        return loaded.why_not(member.limits, speed_factor) or loaded.outside(self.origin, member.fence)

    @property
    def flight(self) -> str:
        """The flight in words, for a refusal."""
        names = enumerated(member.name for member in self.members)
        match self.holder:
            case Holder.PLAN:
                return f"plan {self.title} is flown by {names}"
            case Holder.TRAJECTORY:
                return f"{names} fl{'ies' if len(self.members) == 1 else 'y'} {self.title}"
        return f"{names} is under control"

    @property
    def end_command(self) -> str:
        """The command that ends the flight."""
        if self.holder is Holder.PLAN:
            return "skygcs-cli plan abort"
        return f"skygcs-cli hold {','.join(member.name for member in self.members[:NAMED])}"

    def refusal(self, change: Change) -> str | None:
        """Why a change has to wait for the end of the flight; None if it may be made now."""
        what = self._touched(change)
        return None if what is None else f"{what}, and {self.flight}: `{self.end_command}` first"

    def _touched(self, change: Change) -> str | None:
        """The part of the flight that a change would touch; None if it touches none."""
        # changes that concern the whole fleet or a link
        match change:
            case OriginChange(origin):
                return None if origin == self.origin else "all places of a flight count from the origin"
            case LinkLoss(link, alone):
                names = [member.name for member in self.members if member.key in alone]
                return f"{link} is the only link to {enumerated(names)}" if names else None
            case SigningClockReset():
                return "a vehicle that has heard a later time would not hear us any more"
        # changes of one vehicle
        if not self.holds(change.key):
            return None
        match change:
            case ParamWrite():
                return self._parameter_touched(change)
            case FenceWrite(widens=widens):
                return None if widens else "the flight was checked within the present fence"
            case HomeMove():
                return self._home_touched(change)
            case FenceListWrite():
                return "the flight was checked within the present fence"
            case Renumbering():
                return "its orders are addressed to the present system id"
            case SensorCalibration():
                return "its position is estimated with the present calibration"
            case RallyWrite():
                return "its return leads to the present rally points"
            case EstimatorOrigin():
                return "its position counts from the present origin of its estimator"
            case RateChange(message=message):
                needed = message is None or message in NEEDED_MESSAGES
                return f"its control needs {message or 'the messages of that group'}" if needed else None
            case ConsoleInput():
                return "a command of the console may change what it was checked with"
            case Forgetting():
                return "nobody would fly it until it is heard again"

    def _parameter_touched(self, write: ParamWrite) -> str | None:
        family = next(member.family for member in self.members if member.key == write.key)
        role = role_of(family, write.name)
        if role is ParamRole.HARMLESS or (write.force and role not in LOCKED):
            return None
        insist = "" if role in LOCKED else " (force sets it all the same)"
        return f"{write.name}: {EFFECTS[role]}{insist}"

    def _home_touched(self, move: HomeMove) -> str | None:
        home = next(member.home for member in self.members if member.key == move.key)
        if home is not None and move.place is not None:
            away_m = distance_m(home[0], home[1], move.place[0], move.place[1])
            if away_m < SAME_PLACE_M and abs(home[2] - move.place[2]) < SAME_PLACE_M:
                return None
        return "its heights and its return count from the present home"


def member_of(vehicle: Vehicle, fence: Fence, limits: TrajectoryLimits, links: frozenset[str]) -> Member:
    """A vehicle as it is now."""
    home = vehicle.telemetry("home")
    place = None
    if home is not None and home["lat_deg"] is not None:
        place = (home["lat_deg"], home["lon_deg"], home["alt_amsl_m"])
    return Member(vehicle.name, vehicle.key, vehicle.family, fence, limits, place, links, vehicle.mode)


def widens(before: Mapping[str, float], wanted: Mapping[str, float]) -> bool:
    """True if these fence parameters leave a vehicle all the room it had, with the same action; sizes of PX4 are
    unlimited at 0, an ArduCopter's kinds of fence are bits. To switch the fence on or off is another action."""
    after = {**before, **wanted}
    for name, value in after.items():
        was = before.get(name)
        if was is None or was == value:
            continue
        match name:
            case "GF_MAX_HOR_DIST" | "GF_MAX_VER_DIST":
                if value != 0.0 and (was == 0.0 or value < was):
                    return False
            case "FENCE_RADIUS" | "FENCE_ALT_MAX":
                if value < was:
                    return False
            case "FENCE_TYPE":
                if int(value) & ~int(was):
                    return False
            case _:
                return False
    return True
