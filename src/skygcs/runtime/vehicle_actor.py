"""One vehicle at run time: passes each frame to its protocols, and runs its orders.

Every order returns one Outcome; refusals by the vehicle or by skygcs are outcomes, not exceptions. Orders are safe to
cancel. A newer order that moves the vehicle replaces an older one in progress: a takeoff that waits for its arming ends
when a landing is ordered.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar, Unpack, cast

from skygcs.config.control import GROUND
from skygcs.config.models import VehicleConfig
from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import Origin, yaw_enu_from_heading_deg
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import COMMAND_ACK, HEARTBEAT, TIMESYNC
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import mission_orders, orders
from skygcs.core.vehicle.autopilot import Destination
from skygcs.core.vehicle.component import describe
from skygcs.core.vehicle.fence_params import FenceWatch
from skygcs.core.vehicle.flight_lock import RateChange
from skygcs.core.vehicle.frames import GeodeticPosition, setpoint_from_world, shown
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.core.vehicle.offboard_entry import ask_loss_parameters
from skygcs.core.vehicle.order_ledger import ClientIdentity, StreamOwner, may_have_effect
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.orders import Action
from skygcs.core.vehicle.raw_setpoint import raw_from_world
from skygcs.core.vehicle.snapshot import latest_message, take_snapshot
from skygcs.core.vehicle.stick_modes import needs_sticks
from skygcs.core.vehicle.uplink_watch import UplinkWatch
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import Sticks, model_of
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.links.base import StateUpdate
from skygcs.runtime.command_client import CommandClient, StateEvidence
from skygcs.runtime.flight_elsewhere import FlightElsewhere
from skygcs.runtime.mission_transfers import MESSAGES as MISSION_MESSAGES
from skygcs.runtime.mission_transfers import Missions
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.order_precedence import StreamGate
from skygcs.runtime.order_runner import OrderOutcomes, OrderRunner
from skygcs.runtime.param_transfers import VehicleParams
from skygcs.runtime.stream_requester import StreamRequester, UplinkProbes
from skygcs.runtime.takeoffs import Takeoffs
from skygcs.runtime.task_set import numbered
from skygcs.runtime.unattended_holds import UnattendedHolds
from skygcs.runtime.vehicle_services import SetpointProgram, VehicleLinks, VehiclePart, VehicleServices

P = TypeVar("P", bound=VehiclePart)

SHUTDOWN = "skygcs is shutting down"

ENTRY_ENDED = "no order reaches it by this entry any more; if it is heard again, order it anew"


class VehicleActor:
    """One vehicle of the fleet. `on_frame` and `tick` are called by the fleet; the coroutines are its orders; further
    ones are in `runtime.onboard_orders` and `runtime.home_orders`.

    Its parts are reached directly: ``commands``, ``runner`` (of orders), ``offboard`` (flight by setpoints),
    ``params``, ``missions``, ``fence_watch``, ``streams`` (the rates of its messages), ``uplink``.
    `part` has those of extensions.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        config: VehicleConfig,
        services: VehicleServices,
        *,
        configured: bool | None = None,
        flown_before: str | None = None,
    ) -> None:
        """``configured``: True if the fleet file names it; None: the file names no vehicle. ``flown_before``: see
        `UnattendedWatch`."""
        self.vehicle = vehicle
        self.config = config
        self.configured = configured
        self.preflight_refusal = self.never_passed
        """Returns why its last preflight does not permit arming; None: it does."""
        self.channel = ""
        """Label of the channel that carried its last heartbeat."""
        self._closed = ""
        """Why it was closed."""
        self.program: SetpointProgram | None = None
        """Whose setpoint it followed last; None: a client's, or it was ordered somewhere since."""
        self._loop = services.loop
        self._dialect = services.dialect
        # orders: the commands on the wire, what runs them, flight by setpoints
        ids = (vehicle.sysid, vehicle.compid)
        own, dialect = services.own, services.dialect
        self.commands = CommandClient(
            ids, own, dialect, services.send, services.loop, self._state_evidence(services.links)
        )
        services = self.services = replace(services, send=self.commands.send)
        self.streams = StreamRequester(
            vehicle, self.commands, services.dialect, config.streams, partial(services.links.counts_on, vehicle.key)
        )
        self.authority_refusal: Callable[[], str | None] = partial(services.links.authority_refusal, vehicle.sysid)
        """Why nothing may be sent to it now, as another site may command it; None: it may."""
        self.outcomes = OrderOutcomes(self.vehicle, services.loop, services.on_event)
        self.runner = self._new_runner(services)
        self.offboard = self._new_offboard(services)
        owner, offboard = StreamOwner(self.runner.ledger), self.offboard
        self.stream = StreamGate(owner, vehicle, services.loop, services.on_event, lambda: offboard.flying)
        self.unattended = self._new_unattended(flown_before)
        after_takeoff = config.control.engage_after_takeoff or "off"
        self.takeoffs = Takeoffs(vehicle, after_takeoff, self.runner, self._engage, services.loop, services.on_event)
        # MAVLink protocols, and what is built on them
        self.params = VehicleParams(vehicle, services)
        self.missions = Missions(
            vehicle, self.commands, services.dialect, services.loop, self.outcomes.report_progress, services.on_event
        )
        self.fence_watch = FenceWatch()
        self.uplink = UplinkWatch(time.time_ns() >> 10)
        self._probes = UplinkProbes(self.uplink, vehicle, self.commands, services)
        self._parts: dict[Callable[[VehicleActor], VehiclePart], VehiclePart] = {}
        """Those of extensions, by their classes."""
        self._read = self._readers()
        """Messages of which every frame is read, with their readers."""

    def _new_unattended(self, flown_before: str | None) -> UnattendedHolds:
        """The watch over who flies it."""
        services, offboard = self.services, self.offboard
        holds = UnattendedHolds(
            self.vehicle,
            offboard,
            self.runner,
            self._plan_hold,
            services.loop,
            services.on_event,
            flown_before=flown_before,
        )
        if isinstance(offboard, OffboardEngagement):
            offboard.on_hold, offboard.on_begin = holds.on_hold, holds.on_begin
        return holds

    def _readers(self) -> dict[int, Callable[[Frame, float], None]]:
        return {
            COMMAND_ACK: self._on_ack,
            TIMESYNC: self._on_timesync,
            **dict.fromkeys(MISSION_MESSAGES, self.missions.on_frame),
            **dict.fromkeys(self.params.messages, self.params.on_frame),
        }

    def _order_refusal(self, plan: Plan) -> str | None:
        """Why a plan is not executed: another site may command the vehicle, or an extension objects. The emergency stop
        always is, but on an actor that is closed."""
        if self._closed:
            return f"{self._closed}: {ENTRY_ENDED}"
        if plan.order == "stop":
            return None
        return self.authority_refusal() or self.services.order_refusal(self.vehicle, plan, self._loop.time())

    def _state_evidence(self, links: VehicleLinks) -> StateEvidence:
        vehicle = self.vehicle
        return StateEvidence(
            why_silent=lambda: links.why_silent(vehicle),
            heard_at=lambda: -math.inf if (slot := vehicle.slots.get(HEARTBEAT)) is None else slot.at,
            round_trip_s=lambda: self.uplink.trip_s or 0.0,
            channels=lambda: links.channels_to(vehicle),
        )

    @property
    def name(self) -> str:
        return self.vehicle.name

    @property
    def sysid(self) -> int:
        return self.vehicle.sysid

    @property
    def compid(self) -> int:
        return self.vehicle.compid

    @property
    def groups(self) -> tuple[str, ...]:
        return self.vehicle.groups

    @property
    def order_number(self) -> int:
        """Counts the orders that moved it, from the time (ms) at which this actor began: the numbers of a daemon that
        ran before name no order of this one."""
        return self.runner.ledger.number

    @property
    def closed(self) -> bool:
        """True once nothing goes to the vehicle by this actor any more: it was forgotten, or the daemon ends."""
        return bool(self._closed)

    def part(self, kind: Callable[[VehicleActor], P]) -> P:
        """The part of this class that an extension keeps for this vehicle, made when it is first asked for."""
        part = self._parts.get(kind)
        if part is None:
            part = self._parts[kind] = kind(self)
            self._read.update(dict.fromkeys(part.messages, part.on_frame))
            self.services.links.forget_flows()  # it wants each frame of these
        return cast(P, part)

    def part_made(self, kind: Callable[[VehicleActor], P]) -> P | None:
        """The part of this class; None: nobody has asked for it."""
        return cast("P | None", self._parts.get(kind))

    def _new_runner(self, services: VehicleServices) -> OrderRunner:
        dialect, loop, began_ms = services.dialect, services.loop, time.time_ns() // 1_000_000
        return OrderRunner(self.vehicle, self.commands, dialect, loop, self.outcomes, self._order_refusal, began_ms)

    def _new_offboard(self, services: VehicleServices) -> OffboardEngagement | FlightElsewhere:
        """Make its flight by setpoints: by this daemon, or by what an extension relays its orders to."""
        at = self.config.control.at or GROUND
        if at != GROUND and not self.vehicle.replayed:
            flight = services.flights_elsewhere[at](self.vehicle, self.config, services)
            self.runner.flown_by = flight
            return flight
        return OffboardEngagement(self.vehicle, self.config, self.commands, self.runner, self.streams, services)

    # -- state

    def state(self, now: float, names: frozenset[str] | None = None) -> dict[str, Any]:
        """Snapshot for people and programs (`core.vehicle.state`): all keys, or those in ``names``."""
        state = dict(take_snapshot(self.vehicle, now, time.time(), names))
        if "control" in state and (
            self.offboard.controller.state is not OffboardState.OFF or not isinstance(self.offboard, OffboardEngagement)
        ):
            state["control"] = self.control_state(now)
        if "messages" in state:
            self.streams.add_to(state)
        if "uplink" in state and (uplink := self._probes.state(now)) is not None:
            state["uplink"] = uplink
        return state

    def control_state(self, now: float) -> dict[str, Any]:
        """Control by setpoints, in the fleet's world frame."""
        offboard = self.offboard
        stream = self.stream.owner.status(now)
        if not isinstance(offboard, OffboardEngagement):
            return offboard.status(now) | stream
        state = shown(offboard.status(now), offboard.controller.frame, self.vehicle.origin)
        successor = [] if offboard.successor is None else [f"another order takes over: {offboard.successor}"]
        return state | stream | {"successor": offboard.successor, "reasons": [*successor, *state["reasons"]]}

    def describe(self, now: float) -> dict[str, Any]:
        """Its autopilot as one component of its system; see `component.describe`."""
        enums, slots = self._dialect.enums, self.vehicle.slots.values()
        return describe(
            self.compid,
            enums.get("MAV_COMPONENT", {}).get(self.compid),
            enums.get("MAV_TYPE", {}).get(self.vehicle.type, str(self.vehicle.type)),
            autopilot=True,
            age_s=now - max((slot.at for slot in slots), default=now),
            messages=sum(slot.count for slot in slots),
        )

    def latest(self, message: str | int) -> dict[str, Any] | None:
        """The last message of one type: its fields, age, rate and count; None if none has come.

        Raises RefusedError for a name the dialect lacks.
        """
        msgid, _ = orders.find_message(self._dialect, message)
        return latest_message(self.vehicle, msgid, self._loop.time())

    # -- frames and time

    def on_frame(self, frame: Frame, channel: str, now: float) -> None:
        """One frame of this vehicle. Hot; never raises."""
        events = self.vehicle.on_frame(frame, now)
        commands = self.commands
        if events:
            self._publish(events, now)
        if frame.msgid == HEARTBEAT:
            self.channel = channel
        elif (read := self._read.get(frame.msgid)) is not None:
            read(frame, now)
        if commands.busy:
            commands.wake()

    def state_update_only(self, frame: Frame, channel: str) -> StateUpdate | None:
        """The state update for frames like this one; None if each has to be given to `on_frame`."""
        if frame.msgid in self._read:
            return None
        if frame.msgid == HEARTBEAT:
            payload = frame.payload
            if not self.vehicle.is_last_heartbeat(payload):
                return None  # from another sender: each has to be read

            def again(now: float) -> None:
                events = self.vehicle.on_heartbeat(payload, now)
                if events:
                    self._publish(events, now)
                self.channel = channel

            return StateUpdate(self.vehicle.slots.get(HEARTBEAT), self.commands.watches, again)
        slot = self.vehicle.state_update_only(frame.msgid)
        return None if slot is None else StateUpdate(slot, self.commands.watches)

    def tick(self, now: float) -> None:
        """Called one to ten times a second."""
        events = self.vehicle.tick(now)
        if events:
            self._publish(events, now)
        self.streams.tick(now)
        for part in self._parts.values():
            part.tick(now)
        self.offboard.watch(now)
        if self.vehicle.replayed:
            return
        self.unattended.tick(now, self.authority_refusal())
        if (event := self.fence_watch.look(self.vehicle, now)) is not None:
            self.services.on_event(event)
        self._probes.tick(now)

    def set_duplicate(self, where: str | None) -> None:
        """Note where another vehicle sends with its ids; None: it has stopped. State and control, which use one
        channel, go on."""
        if where is not None:
            self._stop_transfers("refused", f"two vehicles with system id {self.sysid} are on the air: {where}")

    def set_origin(self, origin: Origin | None, generation: int) -> None:
        """Set the fleet's world frame and its number; see `WorldFrame`."""
        self.vehicle.origin = origin
        self.vehicle.origin_generation = generation
        self.offboard.origin_changed()

    def link_changed(self, channel_id: int, now: float) -> None:
        """Note that its state, orders and setpoints take another channel from now on."""
        self.streams.link_changed(channel_id, now)
        self.offboard.link_changed()
        self.uplink.moved()

    def authority_lost(self, text: str) -> None:
        """Nothing may be sent to it from now on: end control and everything in progress but vehicles.stop, without
        sending anything."""
        self.takeoffs.cancel()
        self.offboard.release(text)
        self.commands.stop_unauthorised(text)
        self._stop_transfers("refused", text)

    def restarted(self, text: str, now: float) -> None:
        """Drop its state: it has restarted, or another vehicle has replaced it."""
        self._publish(self.vehicle.restart(now, text), now)

    async def wind_down(self) -> None:
        """The daemon ends: begin nothing that needs an undo, and undo what has begun; wait until that is done."""
        self.takeoffs.cancel()
        if not self.offboard.controller.active:
            self.offboard.release(SHUTDOWN)  # an engagement that is still in its checks ends
        self.missions.stop("cancelled", SHUTDOWN)
        self.params.stop_list()
        self.runner.wind_down()
        parts = [part.wind_down() for part in self._parts.values()]
        await asyncio.gather(*parts, self.runner.settled(), self.offboard.settled())

    def close(self, reason: str = SHUTDOWN) -> None:
        """End what is under way, for this reason. Nothing begins again, and the vehicle counts as lost from now on: an
        order may still be on its way to one that was dropped."""
        self._closed = reason
        self.takeoffs.cancel()
        self.unattended.close()
        self.offboard.close(reason)
        self.missions.close(reason)
        self.params.close(reason)
        for part in self._parts.values():
            part.close(reason)
        self.commands.close(reason)
        self.vehicle.disconnect(reason)  # nobody ticks it any more

    async def ended(self) -> None:
        """After `close`: wait for the end of what the parts of extensions still note."""
        await asyncio.gather(*(part.ended() for part in self._parts.values()))

    # -- orders

    async def arm(self, *, force: bool = False, wait_s: float = 0.0) -> Outcome:
        """Arm. With ``wait_s`` it is repeated every second until the vehicle accepts, it is armed otherwise, a pilot
        switches it to a mode of his sticks, or the time is over; and sent only when an ArduCopter has a position: in
        STABILIZE it would arm without one, and then refuse to take off.

        ``force``: without the autopilot's checks, and without a preflight required by the fleet file.
        """

        def planner(now: float) -> Plan:
            self.require_preflight(force=force)
            return orders.arm(self.vehicle, now, force=force, estimate_msgid=estimate)

        info = self._dialect.by_name.get("EKF_STATUS_REPORT") if wait_s > 0 else None
        estimate = None if info is None else info.msgid
        return await self.runner.retry("arm", planner, wait_s)

    async def disarm(self, *, force: bool = False) -> Outcome:
        """Disarm. ``force`` stops the motors also in the air, and also of a lost vehicle, with emergency priority."""
        return await self.runner.run("disarm", lambda now: orders.disarm(self.vehicle, now, force=force))

    async def set_mode(self, name: str, *, force: bool = False) -> Outcome:
        """``force``: also into a mode flown by sticks, in the air and without any, where that can be sane."""
        model = model_of(self.vehicle, self._loop.time())
        if model.may_fly and model.sticks is Sticks.SEEN and needs_sticks(model, self.vehicle, name):
            asked = self.runner.precedence.asked()
            await self.request("RC_CHANNELS")  # the gate has to know where its throttle is
            if (why := self.runner.precedence.taken_by_pilot(asked)) is not None:
                return self.refuse("mode", why)
        return await self.runner.run("mode", lambda now: orders.set_mode(self.vehicle, now, name, force=force))

    async def takeoff(
        self,
        height_m: float | None = None,
        *,
        arm: bool = True,
        wait_s: float = 0.0,
        force: bool = False,
        engage: bool = True,
    ) -> Outcome:
        """Take off to a height above the ground; None: the fleet file's takeoff_height_m. ``arm``: arms first.

        ``wait_s`` as for `arm`: an ArduCopter accepts GUIDED only with a position. ``force``: without a preflight
        required by the fleet file, and although another vehicle is in the way; the autopilot's own checks stay.
        ``engage``: begin control afterwards, if the fleet file says so.
        """
        height = self.config.takeoff_height_m if height_m is None else height_m

        def planner(now: float) -> Plan:
            self.require_preflight(force=force)
            plan = orders.takeoff(self.vehicle, now, height, arm=arm, force=force)
            if not force and (why := self.services.order_checks.takeoff_refusal(self.vehicle, height)) is not None:
                raise RefusedError(why)
            return plan

        ledger, before = self.runner.ledger, self.runner.ledger.effective
        try:
            outcome = await self.runner.retry("takeoff", planner, wait_s)
        except asyncio.CancelledError:
            if ledger.effective > before and ledger.effective_order == "takeoff" and not self._closed:
                sent = Outcome(True, "cancelled", "", order_number=ledger.effective)
                self.takeoffs.begin(sent, self.vehicle.takeoff.alt_amsl_m, height, engage=False)  # it may climb
            raise
        self.takeoffs.begin(outcome, self.vehicle.takeoff.alt_amsl_m, height, engage=engage)
        return outcome

    async def land(self) -> Outcome:
        return await self.runner.run("land", lambda now: orders.land(self.vehicle, now))

    async def rtl(self) -> Outcome:
        return await self.runner.run("rtl", lambda now: orders.rtl(self.vehicle, now))

    async def hold(self, *, instead_of: int | None = None, spares: frozenset[str] = frozenset()) -> Outcome:
        """``instead_of``: the number of the order that it ends; refused if a newer one moves the vehicle. ``spares``:
        see `Plan`."""
        if instead_of is not None and self.offboard.controller.active:  # of an order under control there is no number
            return self.outcomes.finish("hold", Outcome.refused("it is flown by setpoints since that order"))
        if instead_of is not None:
            return await self.runner.unless_newer(instead_of, "hold", self._plan_hold)
        return await self.runner.run("hold", lambda now: replace(self._plan_hold(now), spares=spares))

    async def stop(self, action: Action) -> Outcome:
        """Emergency stop; see `core.vehicle.orders`. The caller checks the confirmation of a kill
        (`FleetOrders.command_all`)."""
        return await self.runner.run("stop", lambda now: orders.stop(self.vehicle, now, action))

    async def goto(self, **where: Unpack[orders.Where]) -> Outcome:
        """Fly to a position; see `orders.destination`. Under control by setpoints the reference moves there."""
        limit_m = self.config.goto_limit_m
        if not self.offboard.flying:
            return await self.runner.run("goto", lambda now: orders.goto(self.vehicle, now, limit_m=limit_m, **where))
        try:
            to = self.destination(**where)
        except RefusedError as error:
            return self.outcomes.finish("goto", Outcome.refused(str(error)))
        if (why := await self.runner.precedence.late()) is not None:
            return self.refuse("goto", why)
        yaw = None if to.yaw_deg is None else math.radians(yaw_enu_from_heading_deg(to.yaw_deg))
        program, refused = self.program, False
        goes_on = self.stream.ended(
            "a goto was ordered"
        )  # a setpoint would overtake the goto on its way to a companion
        try:
            outcome = await self.offboard.fly_to(GeodeticPosition(to.lat_deg, to.lon_deg, to.alt_amsl_m), yaw)
            refused = outcome.result == "refused"
        finally:
            if refused:
                goes_on()
            elif self.program is program:
                self.program = None
        if outcome.ok:
            self.runner.precedence.note_effect()
        return self.outcomes.finish("goto", outcome)

    def destination(self, **where: Unpack[orders.Where]) -> Destination:
        """Where a `goto` would lead it now. Raises RefusedError where that would be refused."""
        to = orders.destination(self.vehicle, self._loop.time(), limit_m=self.config.goto_limit_m, **where)
        place = GeodeticPosition(to.lat_deg, to.lon_deg, to.alt_amsl_m)
        if self.offboard.flying and (why := self.offboard.why_not_to(place)) is not None:
            raise RefusedError(why)
        return to

    async def reboot(self, *, force: bool = False) -> Outcome:
        return await self.runner.run("reboot", lambda now: orders.reboot(self.vehicle, now, force=force))

    async def set_message_interval(self, message: str | int, rate_hz: float | None) -> Outcome:
        """Set a message rate; 0 turns it off, None restores the vehicle's own rate. skygcs then requests no other
        rate."""
        outcome: Outcome | None = None
        try:
            _, name = orders.find_message(self._dialect, message)
        except RefusedError as error:
            return self.refuse("interval", str(error))
        if (why := self.services.locks.refusal(RateChange(self.vehicle.key, name))) is not None:
            return self.refuse("interval", why)
        try:
            outcome = await self.runner.run(
                "interval", lambda now: orders.message_interval(self.vehicle, now, self._dialect, message, rate_hz)
            )
        finally:
            if may_have_effect(outcome):
                self.streams.leave(name)
                self.offboard.rate_set(name)
        return outcome

    async def request_message(self, message: str | int) -> Outcome:
        """Request one message; the outcome is ok once it has come (read it with `latest`)."""
        return await self.runner.run(
            "request", lambda now: orders.request_message(self.vehicle, now, self._dialect, message)
        )

    async def request_stream(self, stream: int | str, rate_hz: float) -> Outcome:
        """REQUEST_DATA_STREAM, the older message, which has no acknowledgement."""
        if (why := self.services.locks.refusal(RateChange(self.vehicle.key, None))) is not None:
            return self.refuse("stream", why)
        return await self.runner.run(
            "stream", lambda now: orders.request_stream(self.vehicle, now, self._dialect, stream, rate_hz)
        )

    async def command(
        self,
        command: str | int,
        params: Sequence[float | None] = (),
        *,
        int_frame: int | str | None = None,
        x: int | None = None,
        y: int | None = None,
        z: float | None = None,
        force: bool = False,
    ) -> Outcome:
        """Any command; see `orders.command_plan`. A command that bypasses an order's checks needs ``force``."""

        def planner(now: float) -> Plan:
            orders.require_connected(self.vehicle, now)
            plan = orders.command_plan(self._dialect, command, params, int_frame=int_frame, x=x, y=y, z=z)
            return replace(plan, force=force)

        return await self.runner.run("command", planner)

    async def control(self, mode: str, *, force: bool = False) -> Outcome:
        """Control it by setpoints: "position", "velocity", "attitude" or "raw"; "off": end control and hold."""
        self.takeoffs.cancel()
        if mode != "off":
            return await self._engage(mode, force=force)
        if not self.offboard.controller.active:
            self.offboard.release("switched off")
            return self.outcomes.finish("control", Outcome(True, "accepted", "control is off"))
        with self.outcomes.tracked("control") as ended:
            return ended(await self._switched_off())

    async def _engage(self, mode: str, *, force: bool = False) -> Outcome:
        if self._closed:
            return self.outcomes.finish("control", Outcome.refused(f"{self._closed}: nothing flies it any more"))
        with numbered():
            flown = self.offboard.flying
            with self.outcomes.tracked("control") as ended:
                outcome = ended(await self.offboard.engage(ControlMode(mode), force=force))
            if outcome.ok:
                self.stream.owner.engaged(self._loop.time(), anew=not flown)
                self.runner.precedence.note_effect()
            return outcome

    async def change_gains(self, *, changes: Mapping[str, Any], force: bool = False) -> Outcome:
        """See `OffboardEngagement.change_gains`."""
        with self.outcomes.tracked("gains") as ended:
            return ended(await self.offboard.change_gains(changes, force=force))

    def setpoint(
        self,
        client: ClientIdentity,
        *,
        take_over: bool = False,
        valid_s: float = 0.5,
        program: SetpointProgram | None = None,
        **wanted: Any,
    ) -> Outcome:
        """One setpoint of this client's stream in the fleet's world frame; fast enough for 50 calls a second.
        ``wanted``: see `_checked`. ``program``: which flies it, with others; None: a client does."""

        def follow() -> Outcome:
            checked = self._checked(valid_s, program, **wanted)
            if isinstance(checked, Outcome):
                return checked
            if take_over:
                self.offboard.insist()
            return checked()

        outcome = self.stream.follow(client, valid_s, follow, take_over=take_over)
        if outcome.ok:
            self.program = program
        return outcome

    def _checked(
        self,
        valid_s: float,
        program: SetpointProgram | None,
        *,
        pos_enu_m: Sequence[float | None] | None = None,
        vel_enu_mps: Sequence[float | None] | None = None,
        acc_enu_mps2: Sequence[float] | None = None,
        yaw_deg: float | None = None,
        yaw_rate_dps: float | None = None,
        force: bool = False,
        **raw: Any,
    ) -> Outcome | Callable[[], Outcome]:
        """A function that follows a setpoint, or its refusal. ``raw``: see `raw_setpoint.raw_from_world`; also an
        acceleration alone. ``force``: although it leads too close to another vehicle."""
        # a raw setpoint of the user's own controller, or a reference
        origin = self.vehicle.origin
        if origin is None:
            return Outcome.refused("the fleet has no origin yet, so ENU means nothing")
        try:
            no_place = pos_enu_m is None and vel_enu_mps is None
            if no_place and (acc_enu_mps2 is not None or any(value is not None for value in raw.values())):
                own = raw_from_world(origin, acc_enu_mps2=acc_enu_mps2, yaw_deg=yaw_deg, **raw)
                return partial(self.offboard.follow_raw, own, valid_s)
            wanted = setpoint_from_world(origin, pos_enu_m, vel_enu_mps, acc_enu_mps2, yaw_deg, yaw_rate_dps)
        except RefusedError as error:
            return Outcome.refused(str(error))
        # the order checks may refuse it
        together = frozenset[int]() if program is None else program.keys
        checks = self.services.order_checks
        if not force and (why := checks.setpoint_refusal(self.vehicle, wanted, together)) is not None:
            return Outcome.refused(why)
        return partial(self.offboard.follow, wanted, valid_s)

    def plan(self, planner: Callable[[Vehicle, float], Plan]) -> Plan | None:
        """The plan of `orders.land` or `orders.rtl` now; None if it is refused."""
        if self.vehicle.duplicate:
            return None
        try:
            return planner(self.vehicle, self._loop.time())
        except RefusedError:
            return None

    def refuse(self, order: str, reason: str) -> Outcome:
        """Report an order that the fleet refuses."""
        return self.outcomes.finish(order, Outcome.refused(reason))

    @property
    def preflight_hint(self) -> str:
        return f"run skygcs-cli preflight {self.name}, or {orders.FORCE_HINT}"

    def never_passed(self) -> str | None:
        """The `preflight_refusal` until preflight has examined it."""
        return f"it has not passed preflight since it started; {self.preflight_hint}"

    def arming_refusal(self, *, force: bool) -> str | None:
        """Why it must not be armed now, as the fleet file requires a preflight; None if it may."""
        if force or not self.config.require_preflight or self.vehicle.armed:
            return None
        return self.preflight_refusal()

    def require_preflight(self, *, force: bool) -> None:
        """Raises RefusedError if it must not be armed now."""
        if (reason := self.arming_refusal(force=force)) is not None:
            raise RefusedError(reason)

    def _plan_hold(self, now: float) -> Plan:
        """An ArduCopter holds in GUIDED, in which it obeys a setpoint that its companion sends before it knows of the
        hold: then it stays in BRAKE."""
        hold = orders.brake if self.offboard.may_send else orders.hold
        return hold(self.vehicle, now)

    async def _switched_off(self) -> Outcome:
        outcome = await self.runner.attempt(self._plan_hold, reason="switched off")
        if outcome.result == "refused":
            self.offboard.release("switched off")  # nothing was sent, and nothing would end it later
        ended = "control goes on" if self.offboard.flying else "control is off"
        return replace(outcome, message=f"{ended}; {outcome.message}")

    async def read_loss(self) -> None:
        """Read the parameters that decide what it does when this station dies, those that nobody has read yet."""
        await self._read_params(ask_loss_parameters(self.vehicle, self._loop.time()))

    async def read_mission_settings(self) -> None:
        """Read the parameters of `mission_orders.mission_settings` that nobody has read yet."""
        await self._read_params(mission_orders.ask_mission_settings(self.vehicle, self._loop.time()))

    async def _read_params(self, plan: Plan) -> None:
        if plan.steps and self.vehicle.connected and not self.vehicle.replayed:
            await self.runner.attempt_in_control(lambda now: plan)

    async def request(self, message: str) -> Outcome:
        """Request one message, without a report."""
        return await self.runner.attempt(lambda now: orders.request_message(self.vehicle, now, self._dialect, message))

    # -- reactions to frames and time

    def _on_ack(self, frame: Frame, now: float) -> None:
        if self.vehicle.last_ack is not None:
            if self.vehicle.last_ack.is_for(*self.commands.own):
                self._probes.on_ack(now)
            self.commands.on_ack(self.vehicle.last_ack, now)
            self.streams.on_ack(self.vehicle.last_ack, now)

    def _on_timesync(self, frame: Frame, now: float) -> None:
        """An answer to a probe or a ping of ours; others are ignored."""
        if not self._probes.is_answer(frame, now):
            self.offboard.on_timesync(frame, now)

    def _publish(self, events: tuple[Event, ...], now: float) -> None:
        """React to events of the vehicle, then publish them."""
        for event in events:
            if event.kind == "statustext":
                others = self.fence_watch, self.params, self.offboard
                for reader in (self.commands, self.missions, *others, *self._parts.values()):
                    reader.on_text(event.text)
            elif event.kind == "armed":
                for part in self._parts.values():
                    part.on_armed()
            elif event.kind == "vehicle_lost":
                self.uplink.forget()
                self._stop_protocols(f"the vehicle was lost: {event.text}")
            elif event.kind == "vehicle_back":
                self.offboard.heard_again()
            elif event.kind == "reboot":
                self.commands.stop(mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN, "accepted", "rebooted")
                self._stop_protocols("the vehicle rebooted")
                self.uplink.forget()
                self.offboard.release("the vehicle rebooted")
                self.missions.run_begins()
                self.streams.restart(now)
                for part in self._parts.values():
                    part.on_reboot()
            self.services.on_event(event)

    def _stop_protocols(self, text: str) -> None:
        """End everything that waits for an answer that will not come."""
        self.commands.stop_all("lost", text)
        self._stop_transfers("lost", text)

    def _stop_transfers(self, result: str, text: str) -> None:
        """End every exchange with it that is not an order."""
        self.missions.stop(result, text)
        self.params.stop_all(result, text)
        for part in self._parts.values():
            part.stop(result, text)
