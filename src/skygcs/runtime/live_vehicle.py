"""One vehicle as it is heard: its state, and everything that goes on beside it, told of frames, events and time.

What a person may order is in `vehicle_actor`.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from skygcs.config.models import VehicleConfig
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import COMMAND_ACK, HEARTBEAT, TIMESYNC
from skygcs.core.preflight.facts import LinkFacts
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.autopilot import PREFLIGHT_REBOOT_SHUTDOWN
from skygcs.core.vehicle.component import describe
from skygcs.core.vehicle.frames import shown
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.core.vehicle.snapshot import latest_message, take_snapshot
from skygcs.core.vehicle.uplink_watch import FEWEST, Change, UplinkWatch
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.links.base import StateUpdate
from skygcs.runtime.command_client import CommandClient, SendFn
from skygcs.runtime.fence_orders import VehicleFence
from skygcs.runtime.flight_control import FlightControl
from skygcs.runtime.mission_transfers import MESSAGES as MISSION_MESSAGES
from skygcs.runtime.mission_transfers import Missions
from skygcs.runtime.order_runner import OrderRunner
from skygcs.runtime.param_cache import ParamCache
from skygcs.runtime.param_transfers import VehicleParams
from skygcs.runtime.preflight_run import Preflight
from skygcs.runtime.stream_requester import StreamRequester
from skygcs.runtime.undo_journal import UndoJournal

ENDING = "skygcs is shutting down"

OnEvent = Callable[[Event], None]


class LiveVehicle:
    """One vehicle of the fleet, with all that is its own: commander, flight control, parameters, missions, fence,
    preflight, upkeep. `on_frame` and `tick` are the fleet's."""

    def __init__(
        self,
        vehicle: Vehicle,
        config: VehicleConfig,
        own: tuple[int, int],
        dialect: Dialect,
        send: SendFn,
        loop: asyncio.AbstractEventLoop,
        on_event: OnEvent,
        *,
        log_dir: Path = Path("logs"),
        uplink_bytes_per_s: Callable[[], float] = lambda: math.inf,
        stream_refusal: Callable[[bool], str | None] = lambda px4: None,
        param_cache: ParamCache | None = None,
        configured: bool | None = None,
        preflight_valid_s: float = math.inf,
        heard: Callable[[], Mapping[str, LinkFacts]] = dict,
        journal: UndoJournal | None = None,
        probes: bool = False,
    ) -> None:
        """``log_dir``: where traces of its control go; ``uplink_bytes_per_s``: what its link leaves to setpoints;
        ``stream_refusal`` (whether it is a PX4): why it bears no stream of them.

        ``param_cache``: where its parameters are kept; None: nowhere. ``configured``, ``preflight_valid_s``, ``heard``
        (how, by link): see `Preflight`. ``journal``: of what is to be undone; None: one of its own, in ``log_dir``.
        ``probes``: whether it is asked now and then if it hears us.
        """
        self.vehicle = vehicle
        self.config = config
        self.commands = CommandClient((vehicle.sysid, vehicle.compid), own, dialect, send, loop)
        self.channel = ""
        """Label of the channel its last heartbeat came over."""
        self._dialect = dialect
        self._loop = loop
        self._on_event = on_event
        self.streams = StreamRequester(vehicle, self.commands, dialect, config.streams)
        self._orders = OrderRunner(
            vehicle, self.commands, dialect, loop, on_event, release=lambda reason: self.flight.release(reason)
        )
        self.flight = FlightControl(
            vehicle,
            config.control,
            self.commands,
            dialect,
            loop,
            execute=self._orders.plans.execute,
            attempt=self._orders.attempt_kept,
            position_hz=config.streams.get("GLOBAL_POSITION_INT"),
            plan_position=self.streams.want_position,
            on_event=on_event,
            log_dir=log_dir,
            uplink_bytes_per_s=uplink_bytes_per_s,
            stream_refusal=stream_refusal,
        )
        self.params = VehicleParams(
            vehicle,
            dialect,
            send,
            loop,
            on_event,
            param_cache or ParamCache(None),
            own=own,
            link_bytes_per_s=uplink_bytes_per_s,
        )
        self.missions = Missions(vehicle, self.commands, dialect, loop, self._orders.report, on_event)

        async def ask(message: str) -> Outcome:
            return await self._orders.attempt(lambda now: orders.request_message(vehicle, now, dialect, message))

        journal = journal or UndoJournal(log_dir / "undo")
        self.fence = VehicleFence(vehicle, self.params, dialect, loop, on_event, ask, log_dir=log_dir, journal=journal)
        self.preflight = Preflight(
            vehicle,
            config,
            self.params,
            dialect,
            lambda message: self._orders.attempt(lambda now: orders.request_message(vehicle, now, dialect, message)),
            loop,
            gcs_sysid=own[0],
            configured=configured,
            valid_s=preflight_valid_s,
            links=heard,
        )
        self.uplink = UplinkWatch(time.time_ns() >> 10)
        self._probes = probes and "TIMESYNC" in dialect.by_name
        self._thin: Callable[[], bool] = lambda: math.isfinite(uplink_bytes_per_s())
        self._read: dict[int, Callable[[Frame, float], None]] = {
            COMMAND_ACK: self._on_ack,
            TIMESYNC: self._on_timesync,
            **dict.fromkeys(MISSION_MESSAGES, self.missions.on_frame),
            **dict.fromkeys(self.params.messages, self.params.on_frame),
        }
        """Messages of which every one counts, and who reads them."""

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

    def state(self, now: float) -> dict[str, Any]:
        """Snapshot for people and programs (`core.vehicle.state`)."""
        state = dict(take_snapshot(self.vehicle, now, time.time()))
        if self.flight.pilot.state is not OffboardState.OFF:
            state["control"] = self.control_state(now)
        self.streams.add_to(state)
        if self._probes and self.uplink.answered_at is not None:
            trip_s = self.uplink.trip_s
            state["uplink"] = {
                "heard": not self.uplink.lost,
                "unanswered": self.uplink.unanswered,
                "rtt_s": None if trip_s is None else round(trip_s, 3),
                "age_s": round(now - self.uplink.answered_at, 2),
            }
        return state

    def describe(self, now: float) -> dict[str, Any]:
        """It as one component of its system; see `component.describe`."""
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
        """The last one of a message, whole: its fields, age, rate and count; None if none has come.

        Raises RefusedError for a name the dialect lacks.
        """
        msgid, _ = orders.find_message(self._dialect, message)
        return latest_message(self.vehicle, msgid, self._loop.time())

    @property
    def duplicate(self) -> bool:
        """Whether two vehicles speak under this system id: nobody can say which of them an order would reach."""
        return self.vehicle.duplicate

    def set_duplicate(self, where: str | None) -> None:
        """Where another vehicle sends with its ids, and where this one does; None: nowhere (any more). Its state and
        its flight by setpoints, which have one channel, go on."""
        self.vehicle.duplicate_elsewhere = where
        if where is not None:
            self.params.stop_all("refused", f"two vehicles with system id {self.sysid} are on the air: {where}")

    def restarted(self, text: str, now: float) -> None:
        """What was known of it is of another life."""
        self._publish(self.vehicle.restart(now, text), now)

    def set_origin(self, origin: Origin | None, generation: int) -> None:
        """The fleet's world frame from now on, and its number; see `World`."""
        self.vehicle.origin = origin
        self.vehicle.origin_generation = generation
        self.flight.origin_changed()

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

    def _on_ack(self, frame: Frame, now: float) -> None:
        if self.vehicle.last_ack is not None:
            if self.vehicle.last_ack.is_for(*self.commands.own) and self.uplink.answered_at is not None:
                self._on_uplink(self.uplink.heard(now))
            self.commands.on_ack(self.vehicle.last_ack, now)
            self.streams.on_ack(self.vehicle.last_ack, now)

    def state_update_only(self, frame: Frame, channel: str) -> StateUpdate | None:
        """The state update for frames like this one; None: each must be given to `on_frame`."""
        if frame.msgid in self._read:
            return None
        if frame.msgid == HEARTBEAT:
            payload = frame.payload
            if not self.vehicle.is_last_heartbeat(payload):
                return None  # from another sender: each must be checked

            def again(now: float) -> None:
                events = self.vehicle.on_heartbeat(payload, now)
                if events:
                    self._publish(events, now)
                self.channel = channel

            return StateUpdate(self.vehicle.slots.get(HEARTBEAT), self.commands.watches, again)
        slot = self.vehicle.state_update_only(frame.msgid)
        return None if slot is None else StateUpdate(slot, self.commands.watches)

    def tick(self, now: float) -> None:
        """Once to ten times a second."""
        events = self.vehicle.tick(now)
        if events:
            self._publish(events, now)
        self.streams.tick(now)
        if self.flight.pilot.active:
            self.flight.refresh_budget()
        if self._probes and self.vehicle.connected and not self.vehicle.replayed:
            self._probe(now)

    def _probe(self, now: float) -> None:
        """Ask it whether it hears us, if that is due, and report what the answers say."""
        uplink = self.uplink
        if uplink.unanswered >= FEWEST:
            last_frame_at = max((slot.at for slot in self.vehicle.slots.values()), default=-math.inf)
            if uplink.verdict(now, last_frame_at) is not None:
                self._on_uplink("lost")
        if uplink.due(now, armed=self.vehicle.armed, thin=self._thin()):
            token = uplink.token()
            if self.commands.transmit("TIMESYNC", {"tc1": 0, "ts1": token}):
                uplink.sent(token, now)

    def _on_timesync(self, frame: Frame, now: float) -> None:
        """An answer to a probe or a ping of ours, or somebody else's business."""
        fields = frame.fields()
        if fields["tc1"] != 0:
            ours, change = self.uplink.answered(int(fields["ts1"]), now)
            self._on_uplink(change)
            if ours:
                return
        self.flight.on_timesync(frame, now)

    def _on_uplink(self, change: Change | None) -> None:
        if change is None:
            return
        if change == "lost":
            text = (
                f"it does not hear us: no answer to {self.uplink.unanswered} questions, while its telemetry comes; "
                "orders do not reach it, and its failsafe for a lost ground station will act"
            )
        else:
            text = "it hears us again"
        self._on_event(Event(f"uplink_{change}", self.name, self.sysid, text, {}))

    async def wind_down(self) -> None:
        """The daemon ends: begin nothing more that has to be undone, and end what has; until all of it is undone."""
        if not self.flight.pilot.active:
            self.flight.release(ENDING)  # whoever is about to take it over goes no further
        self.missions.stop("cancelled", ENDING)
        self.params.stop_list()
        self._orders.plans.wind_down()
        await asyncio.gather(self.fence.wind_down(), self._orders.plans.settled(), self.flight.settled())

    def close(self) -> None:
        self.flight.close()
        self.missions.close()
        self.params.close()
        self.commands.close()

    def control_state(self, now: float) -> dict[str, Any]:
        """How it is flown, in the fleet's world frame."""
        return shown(self.flight.status(now), self.flight.pilot.frame, self.vehicle.origin)

    def _publish(self, events: tuple[Event, ...], now: float) -> None:
        for event in events:
            if event.kind == "statustext":
                self.commands.on_text(event.text)
                self.missions.on_text(event.text)
                self.fence.on_text(event.text)
                self.params.on_text(event.text)
                self.flight.on_text(event.text)
            elif event.kind == "vehicle_lost":
                self.uplink.forget()
                self.commands.stop_all("lost", f"the vehicle was lost: {event.text}")
                self.missions.stop("lost", f"the vehicle was lost: {event.text}")
                self.params.stop_all("lost", f"the vehicle was lost: {event.text}")
            elif event.kind == "reboot":
                self.commands.stop(PREFLIGHT_REBOOT_SHUTDOWN, "accepted", "rebooted")
                self.commands.stop_all("lost", "the vehicle rebooted")
                self.missions.stop("lost", "the vehicle rebooted")
                self.params.stop_all("lost", "the vehicle rebooted")
                self.uplink.forget()
                self.flight.release("the vehicle rebooted")
                self.preflight.forget()
                self.streams.restart(now)
            self._on_event(event)
