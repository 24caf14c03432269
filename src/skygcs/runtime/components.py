"""All components that are not autopilots: their messages, their texts as events, and the few orders they take.

A vehicle is a system with an autopilot. The autopilot has an actor (`vehicle_actor`) with a state of its own; the other
components of its system are here, and also those of systems without an autopilot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import Ack, CommandSpec, Outcome
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.component import Component
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.gate import clear_command
from skygcs.core.vehicle.order_plan import Plan, Step
from skygcs.core.vehicle.snapshot import reading_of
from skygcs.core.vehicle.state import SEVERITY, name_of
from skygcs.core.vehicle.status_texts import StatusText
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.links.base import StateUpdate
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.vehicle_services import VehicleServices

MAX_OF_SYSTEM = 32
"""Components kept of one system; a vehicle with gimbal, cameras, companion, ADS-B and winch has some ten."""

MAX_COMPONENTS = 1024
"""Components kept of all systems; 64 messages of some 600 bytes each are 40 MB at the very most."""

GIVES_WAY_S = 60.0
"""In a full table a component that was silent for this time is replaced by a new one."""

COMPONENT_SILENT_S = 5.0
"""After this silence no orders are sent to it, as to a vehicle without heartbeats."""

ONBOARD_COMPUTER = 18
"""MAV_TYPE_ONBOARD_CONTROLLER."""

RATE_PERIOD_S = 1.0

ANSWER_S = 2.0
"""Time for a requested message after the command was accepted."""


class Components:
    """Keyed sysid << 8 | compid. ``vehicle_of(sysid)``: the name of the vehicle to which a system belongs, or None;
    ``vehicles_of(sysid)``: its autopilots."""

    def __init__(
        self,
        services: VehicleServices,
        decoder: Decoder,
        vehicle_of: Callable[[int], str | None],
        vehicles_of: Callable[[int], list[Vehicle]],
    ) -> None:
        self.not_kept = 0
        """Frames of components that found no place in the table."""
        self._services = services
        self._decoder = decoder
        self._on_event = services.on_event
        self._vehicle_of = vehicle_of
        self.vehicles_of = vehicles_of
        self._by_key: dict[int, ComponentActor] = {}
        self._systems: dict[int, dict[int, ComponentActor]] = {}
        self._sampled_at: float | None = None

    def __contains__(self, key: int) -> bool:
        return key in self._by_key

    def on_frame(self, key: int, frame: Frame, now: float) -> None:
        """One frame of a component that is not an autopilot. Never raises."""
        actor = self._by_key.get(key) or self._meet(key, frame, now)
        if actor is None:
            self.not_kept += 1
            return
        texts = actor.component.on_frame(frame, now)
        if texts:
            self._publish(actor, texts)
        actor.after(frame, now)

    def state_update(self, key: int, frame: Frame) -> StateUpdate | None:
        """The state update for frames like this one (see `Fleet.state_update_only`)."""
        actor = self._by_key.get(key)
        if actor is None:
            return None  # each frame is counted, or takes a place that has become free
        slot = actor.component.state_update(frame.msgid)
        return None if slot is None else StateUpdate(slot, actor.watches)

    def tick(self, now: float) -> None:
        """Call once to ten times a second."""
        period_s = None
        if self._sampled_at is None:
            self._sampled_at = now
        elif now - self._sampled_at >= RATE_PERIOD_S:
            period_s, self._sampled_at = now - self._sampled_at, now
        for actor in self._by_key.values():
            texts = actor.component.tick(now, period_s)
            if texts:
                self._publish(actor, texts)

    def forget(self, key: int, why: str = "the component was forgotten") -> None:
        """Remove a component that turned out to be an autopilot or part of a recording. Unknown keys are ignored."""
        actor = self._by_key.pop(key, None)
        if actor is not None:
            siblings = self._systems[actor.sysid]
            del siblings[actor.compid]
            if not siblings:
                del self._systems[actor.sysid]
            actor.close(why)
            self._services.links.forget_flows()

    def forget_system(self, sysid: int) -> None:
        """Drop all components of one system."""
        for compid in list(self._systems.get(sysid, ())):
            self.forget(sysid << 8 | compid)

    def of_system(self, sysid: int) -> list[ComponentActor]:
        """The components of one system, by component id."""
        siblings = self._systems.get(sysid, {})
        return [siblings[compid] for compid in sorted(siblings)]

    def onboard_computer_heard_at(self, sysid: int) -> float | None:
        """When the newest message of an onboard computer of this system came; None: it has none."""
        actors = self._systems.get(sysid, {}).values()
        heard = (a.component.heard_at() for a in actors if a.component.type == ONBOARD_COMPUTER)
        return max(heard, default=None)

    def all(self) -> list[ComponentActor]:
        """All components, by system and then by component id."""
        return [self._by_key[key] for key in sorted(self._by_key)]

    def get(self, sysid: int, compid: int) -> ComponentActor | None:
        """The component, if it was heard."""
        return self._by_key.get(sysid << 8 | compid)

    def close(self) -> None:
        """End all orders: the daemon ends."""
        for actor in self._by_key.values():
            actor.close("skygcs is shutting down")

    def name_of(self, sysid: int, compid: int) -> str:
        """The name of a component: "alpha/191"; "7/191" of a system without a vehicle."""
        return f"{self._vehicle_of(sysid) or sysid}/{compid}"

    def _meet(self, key: int, frame: Frame, now: float) -> ComponentActor | None:
        if frame.info is None or frame.sysid == 0 or not self._make_room(frame.sysid, now):
            return None
        component = Component(frame.sysid, frame.compid, self._decoder)
        actor = ComponentActor(component, self, self._services, self._decoder)
        self._by_key[key] = actor
        self._systems.setdefault(frame.sysid, {})[frame.compid] = actor
        return actor

    def _make_room(self, sysid: int, now: float) -> bool:
        siblings = self._systems.get(sysid, {})
        if len(siblings) >= MAX_OF_SYSTEM:
            crowd = list(siblings.values())
        elif len(self._by_key) >= MAX_COMPONENTS:
            crowd = list(self._by_key.values())
        else:
            return True
        oldest = min(crowd, key=lambda actor: actor.component.heard_at())
        if now - oldest.component.heard_at() < GIVES_WAY_S:
            return False
        self.forget(oldest.component.key)
        return True

    def _publish(self, actor: ComponentActor, texts: list[StatusText]) -> None:
        for text in texts:
            data = {
                "severity": name_of(SEVERITY, text.severity),
                "level": text.severity,
                "text": text.text,
                "compid": actor.compid,
            }
            vehicle = self._vehicle_of(actor.sysid)
            self._on_event(Event("statustext", vehicle, actor.sysid, f"{actor.name}: {text.text}", data))

    def new_command_client(self, sysid: int, compid: int) -> CommandClient:
        """Make the commands of a component for its first order: from now on its acknowledgements are read."""
        self._services.links.forget_flows()
        services = self._services
        return CommandClient((sysid, compid), services.own, services.dialect, services.send, services.loop)

    def report(self, actor: ComponentActor, order: str, outcome: Outcome) -> Outcome:
        """Report the outcome of an order to a component."""
        data = {"order": order, "compid": actor.compid, **outcome.as_dict()}
        text = f"{actor.name}: {order}: {outcome.message}"
        self._on_event(Event("command", self._vehicle_of(actor.sysid), actor.sysid, text, data))
        return outcome


class ComponentActor:
    """One component and its orders, the coroutines, which do not raise for refusals by it or by skygcs."""

    def __init__(
        self,
        component: Component,
        table: Components,
        services: VehicleServices,
        decoder: Decoder,
    ) -> None:
        self.component = component
        self._table = table
        self._dialect = services.dialect
        self._decoder = decoder
        self._loop = services.loop
        self._ack_id = decoder.msgid_of("COMMAND_ACK") if "COMMAND_ACK" in decoder.read else -1
        self._commands: CommandClient | None = None

    @property
    def name(self) -> str:
        """The component's name, "alpha/191"."""
        return self._table.name_of(self.sysid, self.compid)

    @property
    def sysid(self) -> int:
        return self.component.sysid

    @property
    def compid(self) -> int:
        return self.component.compid

    @property
    def groups(self) -> tuple[str, ...]:
        """Components belong to no group."""
        return ()

    @property
    def commands(self) -> CommandClient:
        """The component's commands, created for the first order."""
        if self._commands is None:
            self._commands = self._table.new_command_client(self.sysid, self.compid)
        return self._commands

    @property
    def watches(self) -> list[Any] | None:
        """See `StateUpdate.watches`."""
        return None if self._commands is None else self._commands.watches

    def after(self, frame: Frame, now: float) -> None:
        """Pass a frame that was noted just now to the orders that wait for it."""
        commands = self._commands
        if commands is None:
            return
        if frame.msgid == self._ack_id:
            commands.on_ack(Ack(*self._decoder.read["COMMAND_ACK"](frame.payload)), now)
        if commands.busy:
            commands.wake()

    def latest(self, message: str | int) -> dict[str, Any] | None:
        """The last message of one type of this component; see `VehicleActor.latest`."""
        msgid, _ = orders.find_message(self._dialect, message)
        slot = self.component.slots.get(msgid)
        return None if slot is None else reading_of(slot, self._loop.time(), self.sysid, self.compid)

    def close(self, reason: str) -> None:
        if self._commands is not None:
            self._commands.close(reason)

    # -- orders

    def refuse(self, order: str, reason: str) -> Outcome:
        """Report an order that the fleet refuses."""
        return self._table.report(self, order, Outcome.refused(reason))

    async def command(
        self, command: str | int, params: Sequence[float | None] = (), *, force: bool = False, **more: Any
    ) -> Outcome:
        """Any command; see `gate.clear_command` and `orders.command_plan`."""

        def plan() -> Plan:
            return replace(orders.command_plan(self._dialect, command, params, **more), force=force)

        return await self._run("command", plan)

    async def set_message_interval(self, message: str | int, rate_hz: float | None) -> Outcome:
        """Set a message rate; 0 turns it off, None restores the component's own rate."""
        return await self._run("interval", lambda: orders.interval_plan(self._dialect, message, rate_hz))

    async def request_stream(self, stream: int | str, rate_hz: float) -> Outcome:
        """REQUEST_DATA_STREAM, which has no acknowledgement."""
        return await self._run("stream", lambda: orders.stream_plan(self._dialect, stream, rate_hz))

    async def request_message(self, message: str | int) -> Outcome:
        """Request one message; the outcome is ok once it has come (read it with `latest`)."""
        try:
            msgid, name = orders.find_message(self._dialect, message)
        except RefusedError as error:
            return self._table.report(self, "request", Outcome.refused(str(error)))
        before = self.component.count(name)
        step = Step("request", CommandSpec(mav_cmd.REQUEST_MESSAGE, (float(msgid),)))
        outcome = await self._given(Plan("request", (step,), f"{name} came"))  # harmless: the gate lets it pass
        if outcome.ok and not await self.commands.until(lambda: self.component.count(name) != before, ANSWER_S):
            outcome = Outcome(False, "timeout", f"timeout: accepted, but no {name} came", outcome.attempts)
        return self._table.report(self, "request", outcome)

    async def _run(self, order: str, plan: Callable[[], Plan]) -> Outcome:
        try:
            outcome = await self._given(plan())
        except RefusedError as error:
            outcome = Outcome.refused(str(error))
        return self._table.report(self, order, outcome)

    async def _given(self, plan: Plan) -> Outcome:
        """Carry out a plan of one step. Raises RefusedError for one that the outgoing gate does not let pass."""
        silent_s = self._loop.time() - self.component.heard_at()
        if silent_s > COMPONENT_SILENT_S:
            return Outcome.refused(f"nothing was heard from it for {silent_s:.0f} s")
        (step,) = plan.steps
        now = self._loop.time()
        models = [model_of(vehicle, now) for vehicle in self._table.vehicles_of(self.sysid)]
        clearance = clear_command(models, plan)
        if step.message is not None:
            if not self.commands.transmit(*step.message, clearance=clearance):
                return Outcome(False, "lost", "could not be sent: no link leads to it")
            return Outcome(True, "accepted", plan.done, 1)
        assert step.command is not None
        outcome = await self.commands.run(step.command, clearance=clearance)
        return Outcome(True, "accepted", plan.done, outcome.attempts, outcome.elapsed_s) if outcome.ok else outcome
