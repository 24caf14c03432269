"""On the ground: control of a vehicle that is flown by its companion. Relays orders, and mirrors what becomes of them.

    VehicleActor ── engage, fly_to, … ──> CompanionControl ──companion.order──> GroundOrders ──> OffboardEngagement
                                                 ^                                    (in the companion's daemon)
                                                 └──companion.contact, twice a second── report

It stands in the place of an `OffboardEngagement`, with the same methods. The ground sends no setpoint to the vehicle:
orders go to the companion by `relayed_order`, what is shown is `mirrored_control`.
A contact is the ground's sign of life at the companion and its answer the report, so one of them shows the other.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import secrets
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from skygcs.config.models import VehicleConfig
from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import TrajectoryClock
from skygcs.core.trajectory.trajectory_clock import ClockOrder, ReplicatedClock
from skygcs.core.vehicle import offboard_entry
from skygcs.core.vehicle.flight_lock import FlightLock, Holder
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.core.vehicle.raw_setpoint import RawSetpoint
from skygcs.core.vehicle.stick_modes import hands, taken_since
from skygcs.core.vehicle.trajectory_flight import (
    LoadedTrajectory,
    StartTube,
    TrajectoryFlight,
    distance_refusal,
)
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import LinkError, RpcError
from skygcs.events import Event
from skygcs.ext.companions import wire
from skygcs.ext.companions.mirrored_control import REPORTS_SILENT_S, MirroredClock, MirroredControl, MirroredTracking
from skygcs.ext.companions.relayed_order import RelayedOrder, unknown
from skygcs.runtime.control_tuning import law_json, offboard_config
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_services import VehicleServices

CONTACT_S = 0.5
"""Between two contacts: of the shortest ground_lost_s (2 s) three may be lost."""

MAX_CONTACTS = 8
"""That wait for their answers: 4 s of round trip."""

CONTACT_TIMEOUT_S = 4.0

START_BY_S = 3.0
"""An order that reaches the companion later is not carried out: the person who gave it has looked again by then."""

ANSWER_S = 4.0
"""To wait for the answer of an order that is carried out at once, after its deadline."""

ENGAGE_S = 22.0
"""An engagement takes up to 5 s of measuring and 7 s of switching, twice with a change of the position's rate."""

RELEASE_S = 20.0
"""An end of control is repeated for so long; it is harmless at any time, as what follows has a higher number."""

LEAST_LEAD_S, MOST_LEAD_S = 0.3, 4.0
"""An order to the clock takes effect so much later. Two ways and a repeat fit into it up to a round trip of 1.5 s."""

SETPOINT_WAYS = 24
"""Setpoints under way: one second at 20 Hz, or the way at 0.8 s each at 10 Hz. Beyond that the newest one waits."""

REFUSAL_S = 1.0
"""The refusal of a setpoint counts for the next ones for so long."""

MAX_PREPARED = 64

RUN = secrets.token_hex(4)
"""Names this run of the ground's daemon to its companions: another one begins with new numbers."""

NUMBERS = itertools.count(1)
"""Numbers of all orders and setpoints of this run. A vehicle that is forgotten and found again goes on with them: its
companion takes a smaller number for a repeat of what it has done."""

Json = dict[str, Any]


class ClockDifference(Protocol):
    """`core.clock_offset.ClockOffset`: add ``offset_s`` to a time of our clock to get the companion's."""

    @property
    def offset_s(self) -> float: ...


class CompanionCalls(Protocol):
    """The connection to one companion (`CompanionLink`)."""

    name: str

    @property
    def is_up(self) -> bool: ...
    def summary(self) -> dict[str, Any]: ...
    def clock(self) -> ClockDifference | None: ...
    async def call(self, method: str, params: dict[str, Any] | None = None, timeout_s: float = 5.0) -> Any: ...


class CompanionControl:
    """Control of one vehicle with control.at = "companion" in the fleet file."""

    silent_after_s = REPORTS_SILENT_S
    sends_setpoints = False
    """The ground sends it none: they take nothing of its links."""

    def __init__(
        self,
        vehicle: Vehicle,
        config: VehicleConfig,
        services: VehicleServices,
        companions: Mapping[str, CompanionCalls],
        heard_at: Callable[[int], float | None],
    ) -> None:
        """``companions``: the connections by vehicle; ``heard_at``: when an onboard computer of a system was heard
        last by MAVLink."""
        self.controller = MirroredControl(offboard_config(config.control, None))
        # collaborators
        self._vehicle = vehicle
        self._settings = config.control
        self._companions = companions
        self._companion_heard_at = heard_at
        self._locks = services.locks
        self.lock: FlightLock | None = None
        """The lock that the present control was entered with; None: it is not under control."""
        self._loop = services.loop
        self._on_event = services.on_event
        self._tasks = TaskSet(services.loop, services.on_event, vehicle.name, vehicle.sysid)
        # orders to the companion
        self._ground = RUN
        self._own = services.own
        self._numbers = NUMBERS
        self._prepared: OrderedDict[LoadedTrajectory, str] = OrderedDict()
        """Trajectories that the companion has, and their keys there."""
        self._relayed: Counter[str] = Counter()
        """Orders whose outcome is awaited, by name."""
        self._handed_over: tuple[int, str] | None = None
        """Number of the hand-over and the order that takes over, until the companion knows how that ended."""
        # contact with the companion
        self._round_trip_s: float | None = None
        self._refused: str | None = None
        """Why the companion does not take this ground's contacts."""
        self._unreported = ""
        """Why its newest contact had no report, as of a companion whose skygcs is older."""
        self._origin_there: Json | None = None
        # setpoints on their way
        self._waiting: Json | None = None
        """The newest setpoint that has no place on the way yet."""
        self._setpoints = 0
        self._insists = False
        """True if the next setpoint is to take over from clients of the companion's own."""
        self._setpoint_refusal: tuple[str, float] = ("", -math.inf)
        self._contact = self._tasks.start(self._keep_contact(), "contact with its companion")

    @property
    def clock(self) -> MirroredClock:
        """Figures of the companion's control clock."""
        return self.controller.clock

    @property
    def tracking(self) -> MirroredTracking:
        """Measurements of its tracking by the companion."""
        return self.controller.tracking

    @property
    def flying(self) -> bool:
        """True while the companion flies it, as far as is known, and no order takes over."""
        return self.controller.state is OffboardState.FLYING and self.successor is None

    @property
    def successor(self) -> str | None:
        """See `OffboardEngagement.successor`; the companion's."""
        return self.controller.successor

    @property
    def may_send(self) -> bool:
        """True if setpoints of the companion may still come to the vehicle, as far as is known."""
        return self.controller.active or self.controller.unconfirmed

    @property
    def lead_s(self) -> float:
        """How long before its time an order to a clock must be given."""
        trip_s = self._round_trip_s
        return MOST_LEAD_S if trip_s is None else min(max(2.0 * trip_s + 0.2, LEAST_LEAD_S), MOST_LEAD_S)

    def down_reason(self) -> str | None:
        """Why no order reaches the companion; None if it does."""
        companion = self._companions.get(self._vehicle.name)
        if companion is None:
            return (
                f'control.at is "companion", and no [companions.…] of the fleet file is on {self._vehicle.name}; '
                'give one, or set control.at = "ground"'
            )
        if not companion.is_up:
            return f"its companion {companion.name} is not connected"
        if self._refused is not None:
            return f"its companion {companion.name}: {self._refused}"
        if self.controller.session is None:
            return f"its companion {companion.name} has not reported its control yet{self._unreported}"
        if (silent_s := self.controller.silent_s(self._loop.time())) is not None:
            return f"its companion {companion.name} has not answered for {silent_s:.0f} s{self._unreported}"
        return None if companion.clock() is not None else f"the clock of {companion.name} is not measured yet"

    # -- orders

    async def engage(self, control_mode: ControlMode, *, force: bool = False) -> Outcome:
        """Have the companion begin control, or change its mode."""
        if (why := self.down_reason()) is not None:
            return Outcome.refused(why)
        if self._handed_over is not None:  # a companion that waited for its end would know of no later order
            return Outcome.refused(f"another order takes over: {self._handed_over[1]}; it has had no outcome yet")
        self.lock = self.lock if self._flies() else None
        if (lock := self._locked()) is None:
            return Outcome.refused("the fleet has no origin yet: set [origin], or `skygcs-cli origin from`")
        given = {"mode": control_mode.value, "force": force, "origin": wire.origin_json(lock.origin)}
        return await self._relay("engage", given, answer_s=ENGAGE_S)

    def release(self, reason: str) -> None:
        """Have the companion send nothing from now on. Idempotent. The vehicle itself is ordered over its own links
        beside this: its companion yields to the mode that it shows then."""
        self._end("release", reason)

    def hand_over(self, reason: str) -> None:
        """A newer order takes over: the companion holds until it sees the order's mode or hears how the order ended."""
        self._end("hand_over", reason)

    def flown_by(self, now: float) -> str | None:
        """The companion, while it flies the vehicle and is in contact: it answers, or its heartbeats are heard. None:
        it does not, or is silent."""
        if not self.controller.active and self._handed_over is None:
            return None
        heartbeat_at = self._companion_heard_at(self._vehicle.sysid)
        heard_at = max(self.controller.reported_at, -math.inf if heartbeat_at is None else heartbeat_at)
        return f"its companion {self._name}" if now - heard_at <= REPORTS_SILENT_S else None

    @property
    def reported(self) -> bool:
        """True if the companion has said what it does, since this daemon began."""
        return self.controller.session is not None

    def taken_over(self) -> None:
        """Report it to the companion, which sees it by itself only where the order's mode does not follow setpoints."""
        if self._handed_over is not None:
            self._end("taken_over", self._handed_over[1])

    def keep(self, why: str) -> None:
        """Report it to the companion, whose next report shows what it does then."""
        if self._handed_over is not None:
            self._tasks.start(self._keep(self._handed_over, next(self._numbers), why), "keep")

    def why_not_to(self, _place: GeodeticPosition) -> str | None:
        """Why the reference may not be moved there, as far as the ground knows; the companion has its own fence."""
        return self._not_flying()

    async def fly_to(self, place: GeodeticPosition, yaw_enu_rad: float | None) -> Outcome:
        """Move the companion's reference."""
        if (why := self._not_flying()) is not None:
            return Outcome.refused(why)
        given = wire.setpoint_json(Setpoint(place, yaw_enu_rad=yaw_enu_rad))
        return await self._relay("goto", given)

    def follow(self, setpoint: Setpoint, valid_s: float) -> Outcome:
        """One setpoint of a client's stream. The outcome is that of the relay: a refusal of the companion is that of
        one of the next setpoints."""
        return self._stream(wire.setpoint_json(setpoint), valid_s)

    def follow_raw(self, setpoint: RawSetpoint, valid_s: float) -> Outcome:
        """One setpoint of the user's own controller; as `follow`."""
        return self._stream({"raw": wire.setpoint_json(setpoint)}, valid_s)

    def insist(self) -> None:
        """The next setpoint takes the vehicle over from clients of the companion's own."""
        self._insists = True

    async def change_gains(self, changes: Mapping[str, Any], *, force: bool = False) -> Outcome:
        """See `OffboardEngagement.change_gains`; the companion's gains are meant."""
        if (why := self.down_reason()) is not None:
            return Outcome.refused(why)
        return await self._relay("gains", {"changes": dict(changes), "force": force})

    def gains(self) -> dict[str, Any]:
        """The companion's; before it was heard those of the ground's fleet file."""
        if self.controller.gains is not None:
            return self.controller.gains
        return law_json(self.controller.config.law)

    async def record(self, on: bool) -> str | None:
        """Have the companion trace its ticks. The path there."""
        if self.down_reason() is not None:
            return None
        outcome = await self._relay("record", {"on": on})
        return f"{self._name}: {outcome.message}" if outcome.ok and outcome.message else None

    # -- trajectories

    async def prepare(self, loaded: LoadedTrajectory) -> str | None:
        """Have the companion keep this trajectory for a start; why that cannot be, None if it does."""
        if (why := self.down_reason()) is not None:
            return why
        if loaded in self._prepared:
            return None
        key, parts = secrets.token_hex(4), wire.pieces_json(loaded.trajectory)
        for part, pieces in enumerate(parts):
            given = {"key": key, "name": loaded.name, "part": part, "parts": len(parts), "pieces": pieces}
            outcome = await self._relay("pieces", given, start_s=ENGAGE_S, answer_s=ENGAGE_S)
            if not outcome.ok:
                return f"its companion does not have {loaded.name}: {outcome.message}"
        self._prepared[loaded] = key
        while len(self._prepared) > MAX_PREPARED:
            self._prepared.popitem(last=False)
        return None

    def trajectory_refusal(
        self, loaded: LoadedTrajectory, speed_factor: float, lock: FlightLock, tube: StartTube | None = None
    ) -> str | None:
        """See `OffboardEngagement.trajectory_refusal`; the companion looks once more."""
        if (why := self._not_flying()) is not None:
            return why
        if self._relayed["goto"]:
            return "a goto is on its way to its companion"
        self.controller.end_flight(self._loop.time())
        if self.controller.flight is not None:
            return f"it follows {self.controller.flight.loaded.name} already: abort that first"
        if loaded not in self._prepared:
            return "its companion does not have this trajectory yet"
        position, place = self._vehicle.telemetry("position"), None
        if position is not None and position["lat_deg"] is not None:
            here = (position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])
            place = EnuFrame(lock.origin).from_geodetic(*here)
        limits = lock.member(self._vehicle.name).limits
        away = distance_refusal(place, loaded.trajectory.start_enu_m, limits, tube)
        return away or lock.path_refusal(self._vehicle.name, loaded, speed_factor)

    def follow_trajectory(self, loaded: LoadedTrajectory, clock: TrajectoryClock, lock: FlightLock) -> TrajectoryFlight:
        """Have the companion follow a trajectory that was prepared and that `trajectory_refusal` accepted, on a replica
        of this clock; if it does not, the flight ends here."""
        assert isinstance(clock, ReplicatedClock)
        origin = lock.origin
        frame, number = EnuFrame(origin), next(self._numbers)
        flight = TrajectoryFlight(loaded, clock, origin, frame)
        self.controller.follow(flight, frame, number)
        unanswered: dict[int, ClockOrder] = {}

        def on_order(order: ClockOrder) -> None:
            # a stop goes to what may still fly it, too; the companion compares the flight
            if self.controller.flight is not flight and not order.stops:
                return
            if not order.has_room(len(unanswered)):
                if self.controller.flight is flight:
                    why = f"{len(unanswered)} orders to its clock were not answered: what it flies is not known"
                    self.controller.drop_flight(why)
                    self._publish(why)
                if not order.stops:
                    return
                unanswered.clear()
            order_number = next(self._numbers)
            unanswered[order_number] = order
            self._tasks.start(self._order_clock(flight, number, order_number, unanswered), f"clock {order.kind}")

        clock.observers.append(on_order)
        self._tasks.start(self._start(flight, clock, number, origin), "start of a trajectory")
        return flight

    # -- as frames and time come

    def on_timesync(self, frame: Frame, now: float) -> None:
        """The companion measures its own round trip."""

    def on_text(self, text: str) -> None:
        """The companion hears its autopilot itself."""

    def link_changed(self) -> None:
        """Another link leads to the vehicle; the companion, which controls it, has its own."""

    def heard_again(self) -> None:
        """The companion asks for the rates that it needs, and gives them back."""

    def rate_set(self, name: str) -> None:
        """The companion keeps the rates of its own control; see `heard_again`."""

    def origin_changed(self) -> None:
        """The companion's origin follows the ground's."""
        self._relay_origin()

    def watch(self, now: float) -> None:
        """Some times a second: what silence of the companion means."""
        if not self._flies():
            self.lock = None
        elif self.controller.active:
            self._locked()  # control may be older than this run of the ground
        follows = offboard_entry.is_following(self._vehicle)
        for text in self.controller.watch(now, follows=follows, mode=self._vehicle.mode):
            self._publish(text)

    def status(self, now: float) -> dict[str, Any]:
        """The ``control`` part of the vehicle's state, in the frame of the fleet: the companion's, with its age."""
        controller = self.controller
        heard = math.isfinite(controller.reported_at)
        agree = self._origin_there == wire.origin_json(self._vehicle.origin)
        shown = {**EMPTY_STATUS, **controller.section}
        if not agree:
            shown |= {"reference": None, "error_enu_m": None}
        why = self.down_reason()
        return shown | {
            "state": controller.state.value,
            "control_mode": None if controller.control_mode is None else controller.control_mode.value,
            "mode": None if controller.state is OffboardState.OFF else controller.wanted.value,
            "reasons": list(controller.reasons),
            "successor": controller.successor,
            "companion": {
                "name": self._name,
                "up": why is None,
                "why_not": why,
                "age_s": round(now - controller.reported_at, 2) if heard else None,
                "round_trip_s": None if self._round_trip_s is None else round(self._round_trip_s, 3),
                "origins_agree": agree,
            },
        }

    async def settled(self) -> None:
        """Do nothing: nothing has to be undone here."""

    def close(self, reason: str) -> None:
        """The ground's daemon ends: the companion goes on, until it finds the ground lost."""
        self._tasks.close()

    # -- the inside

    @property
    def _name(self) -> str:
        companion = self._companions.get(self._vehicle.name)
        return "none" if companion is None else companion.name

    def _locked(self) -> FlightLock | None:
        """The lock of the present or of a beginning control; None without an origin of the fleet."""
        origin = self._vehicle.origin
        if self.lock is None and origin is not None:
            lock = self._locks.make(Holder.ENGAGEMENT, "", origin, [(self._vehicle, self._settings)])
            self.lock = self._locks.take(lock, lambda: self.lock is lock and self._flies())
        return self.lock

    def _end(self, order: str, reason: str) -> None:
        """Relay an order by which control ends, if it is flown by it, and show it as ended at once."""
        before = self._handed_over
        if before is None and self.controller.state is OffboardState.OFF and not self._relayed["engage"]:
            return
        number = next(self._numbers)
        self._handed_over = (number, reason) if order == "hand_over" else None
        self.controller.release(number, reason)
        if before is None:
            self._publish(f"control ended: {reason}")
        self._tasks.start(self._relay(order, {"reason": reason}, number, start_s=RELEASE_S), order)

    async def _keep(self, handed_over: tuple[int, str], number: int, why: str) -> None:
        await self._relay("keep", {"reason": why}, number, start_s=RELEASE_S)
        if self._handed_over is handed_over:  # else a newer order has it handed over
            self._handed_over = None

    def _flies(self) -> bool:
        """True if its companion flies it, or is being asked to."""
        return self.controller.active or self._relayed["engage"] > 0

    def _not_flying(self) -> str | None:
        if (why := self.down_reason()) is not None:
            return why
        if self.flying:
            return None
        if self.successor is not None:
            return f"another order takes over: {self.successor}"
        why = "; ".join(self.controller.reasons)
        held = self.controller.state is OffboardState.HELD
        what = f"it is held: {why}" if held else "control is off"
        return f"{what}; `skygcs-cli control set {self._vehicle.name} position` first"

    async def _keep_contact(self) -> None:
        """Call the companion twice a second, whether or not the last call was answered."""
        under_way: set[asyncio.Task[None]] = set()
        while True:
            companion = self._companions.get(self._vehicle.name)
            if companion is not None and companion.is_up and len(under_way) < MAX_CONTACTS:
                task = self._tasks.start(self._one_contact(companion), "one contact")
                under_way.add(task)
                task.add_done_callback(under_way.discard)
            await asyncio.sleep(CONTACT_S)

    async def _one_contact(self, companion: CompanionCalls) -> None:
        sent = self._loop.time()
        given = {"ground": self._ground, "sysid": self._own[0], "compid": self._own[1]}
        try:
            report = await companion.call("companion.contact", given, CONTACT_TIMEOUT_S)
        except RpcError as error:
            self._unreported = f": it refuses this ground's contact, {str(error)[:200]}; is its skygcs another version?"
            return
        except LinkError:
            return
        self._unreported = ""
        now = self._loop.time()
        trip_s = now - sent
        # rises at once, falls within some answers: what is planned with it must hold for the slower ones
        known = self._round_trip_s
        self._round_trip_s = trip_s if known is None or trip_s > known else 0.9 * known + 0.1 * trip_s
        if isinstance(report, dict):
            refused = report.get("refused")
            self._refused = None if refused is None else str(refused)[:200]
            self._take(report, now)

    def _take(self, report: Json, now: float) -> None:
        session = self.controller.session
        for text in self.controller.take(report, now):
            self._publish(text)
        if self.controller.session != session:
            self._prepared.clear()
        there = report.get("origin")
        self._origin_there = there if isinstance(there, dict) else None

    def _relay_origin(self) -> None:
        origin = self._vehicle.origin
        if origin is not None and self.down_reason() is None:
            self._tasks.start(self._relay("origin", {"origin": wire.origin_json(origin)}), "origin")

    async def _start(self, flight: TrajectoryFlight, clock: ReplicatedClock, number: int, origin: Origin) -> None:
        begins = clock.begins_at_s
        given = {
            "key": self._prepared.get(flight.loaded),
            "placed": True,
            "origin": wire.origin_json(origin),
            "at_s": self._there(begins),
            "duration_s": clock.duration_s,
            "rate_limit_per_s": clock.rate_limit_per_s,
            "speed_factor": clock.speed_factor,
            "rests_at_start": clock.rests_at_start,
            "rests_at_end": clock.rests_at_end,
        }
        start_s = max(0.1, begins - self._loop.time())
        outcome = await self._relay("start", given, number, start_s=start_s)
        if not outcome.ok and self.controller.flight is flight:
            self.controller.drop_flight(outcome.message)
            self._publish(f"it does not follow {flight.loaded.name}: {outcome.message}")

    async def _order_clock(
        self, flown: TrajectoryFlight, flight: int, number: int, unanswered: dict[int, ClockOrder]
    ) -> None:
        """One order, each time with all that are not answered: it may come before the repeats of earlier ones, and a
        pause must not stand without the resume that followed. A stop is repeated as long as an end of control."""

        def given() -> Json:
            known = unanswered.items()
            orders = [{"number": n, **wire.clock_order_json(o), "at_s": self._there(o.at_s)} for n, o in known]
            return {"flight": flight, "orders": orders}

        order = unanswered[number]
        start_s = RELEASE_S if order.stops else START_BY_S
        outcome = await self._relay("clock", given, number, start_s=start_s)
        if number not in unanswered:
            return  # a newer one, which carried it, was answered
        if outcome.ok:
            for known in [n for n in unanswered if n <= number]:
                del unanswered[known]
        if (not outcome.ok and self.controller.flight is flown) or "too late" in outcome.message:
            self._publish(f"its trajectory, ordered to {order.kind}: {outcome.message}")

    def _there(self, at: float) -> float:
        """A time of our clock on the companion's."""
        companion = self._companions.get(self._vehicle.name)
        clock = None if companion is None else companion.clock()
        return at if clock is None else at + clock.offset_s

    async def _relay(
        self,
        order: str,
        given: Json | Callable[[], Json],
        number: int | None = None,
        *,
        start_s: float = START_BY_S,
        answer_s: float = ANSWER_S,
    ) -> Outcome:
        """One order to its outcome. ``start_s``: it is carried out only if it arrives within so long. ``given``: if it
        is a function, what it returns at each repeat."""
        began = self._loop.time()
        number = next(self._numbers) if number is None else number
        relayed = RelayedOrder(number, self.controller.session or "", began + start_s, began + start_s + answer_s)
        params = {
            "ground": self._ground,
            "session": relayed.session,
            "number": number,
            "until_s": self._there(relayed.start_by),
            "order": order,
        }
        self._relayed[order] += 1
        try:
            return await self._asked(relayed, params, given, began)
        finally:
            self._relayed[order] -= 1

    async def _asked(
        self, relayed: RelayedOrder, params: Json, given: Json | Callable[[], Json], began: float
    ) -> Outcome:
        """Ask with the same number until there is an answer, or patience is over. Once a pilot has the vehicle, only
        whether control has begun is asked: the companion does not begin it any more, as its deadline is over."""
        why, taken = "no answer came", None
        were_in = hands(self._vehicle, began)
        while True:
            now = self._loop.time()
            if params["order"] == "engage" and (taken := taken or taken_since(self._vehicle, now, were_in)) is not None:
                params = {**params, "until_s": self._there(began)}
            wait_s = relayed.wait_s(now, self._round_trip_s)
            if wait_s is None:
                return unknown(why, now - began)
            if self.controller.session != relayed.session:
                return unknown("the companion's skygcs has restarted meanwhile", now - began)
            companion = self._companions.get(self._vehicle.name)
            if companion is None:
                return unknown("the companion is gone from the fleet file", now - began)
            if params["order"] == "engage":
                wait_s = max(wait_s, 1.0)  # it takes seconds: to ask more often learns nothing
            try:
                asked = {**params, "given": given() if callable(given) else given}
                answer = await companion.call("companion.order", asked, wait_s)
            except LinkError as error:
                why = str(error)
                left_s = wait_s - (self._loop.time() - now)
                await asyncio.sleep(min(max(left_s, 0.05), wait_s))
                continue
            except RpcError as error:
                return Outcome.refused(f"its companion: {error}")
            self._take(answer.get("report") or {}, self._loop.time())
            outcome = _outcome(answer.get("outcome"), self._loop.time() - began)
            return Outcome.refused(taken) if taken is not None and outcome.result == "refused" else outcome

    # -- a stream of setpoints

    def _stream(self, given: Json, valid_s: float) -> Outcome:
        if (why := self._not_flying()) is not None:
            return Outcome.refused(why)
        refusal, until = self._setpoint_refusal
        now = self._loop.time()
        params = {
            "ground": self._ground,
            "session": self.controller.session or "",
            "number": next(self._numbers),  # of now: an order that is given while it waits is newer
            "at_s": self._there(now),
            "valid_s": valid_s,
            "setpoint": given,
        }
        if self._setpoints < SETPOINT_WAYS:
            self._tasks.start(self._send_setpoint(params), "setpoint")
        else:
            self._waiting = params  # the newest one takes its place
        if now < until:
            return Outcome.refused(refusal)
        return Outcome(True, "accepted", f"relayed to {self._name}")

    async def _send_setpoint(self, params: Json) -> None:
        companion = self._companions.get(self._vehicle.name)
        if companion is None:
            return
        self._setpoints += 1
        if self._insists:
            self._insists, params = False, {**params, "setpoint": {**params["setpoint"], "take_over": True}}
        try:
            answer = await companion.call("companion.setpoint", params, MAX_SETPOINT_WAIT_S)
        except (LinkError, RpcError):
            return
        finally:
            self._setpoints -= 1
            waiting, self._waiting = self._waiting, None
            if waiting is not None and self.flying:
                self._tasks.start(self._send_setpoint(waiting), "setpoint")
        self._take(answer.get("report") or {}, self._loop.time())
        outcome = _outcome(answer.get("outcome"), 0.0)
        if not outcome.ok:
            why = outcome.message.removeprefix("refused: ")
            self._setpoint_refusal = why, self._loop.time() + REFUSAL_S

    def _publish(self, text: str) -> None:
        controller = self.controller
        data = {
            "state": controller.state.value,
            "control_mode": None if controller.control_mode is None else controller.control_mode.value,
            "reasons": list(controller.reasons),
            "at": "companion",
        }
        self._on_event(Event("control", self._vehicle.name, self._vehicle.sysid, text, data))


MAX_SETPOINT_WAIT_S = 2.0
"""Time for the answer to one setpoint of a stream."""

EMPTY_STATUS: Json = {
    **dict.fromkeys(
        ("mode", "control_mode", "reference", "error_enu_m", "error_m", "state_age_s", "delay_p95_s", "rtt_s")
    ),
    **dict.fromkeys(("rate_hz", "lateness_p99_s", "trajectory", "prediction", "raw", "thrust", "roll_deg")),
    **dict.fromkeys(("pitch_deg", "recording", "successor")),
    **dict.fromkeys(("ticks", "late", "skipped"), 0),
    "state": "off",
    "reasons": [],
    "saturation": [],
    "integral_enu": [0.0, 0.0, 0.0],
}
"""Before the companion was heard."""


def _outcome(answer: object, elapsed_s: float) -> Outcome:
    """The outcome that a companion answered, whatever it holds."""
    found = answer if isinstance(answer, dict) else {}
    texts = found.get("status_texts")
    return Outcome(
        found.get("ok") is True,
        str(found.get("result", "failed"))[:40],
        str(found.get("message", "its companion's answer is not an outcome"))[:500],
        int(found["attempts"]) if isinstance(found.get("attempts"), int) else 0,
        elapsed_s,
        tuple(str(text)[:200] for text in texts[:8]) if isinstance(texts, list) else (),
    )
