"""Requests to one vehicle without an order: its version, its home, and its messages at the wanted rates.

Requests are not urgent: they are sent after orders and not awaited; the arriving messages verify them, and a reboot
repeats them. On a radio the air planner sets rates and times; elsewhere the configured rates apply.

An autopilot streams on each of its ports what was requested there. So a vehicle that is heard on several links has a
rate controller for each radio and one for all other links, and each counts what comes over its own channel.

`UplinkProbes` probes its uplink on the wire, and reports when it dies or recovers (`core.vehicle.uplink_watch`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import RESULT_NAMES, Ack
from skygcs.core.radio_link.rate_controller import RateController, RateRequest
from skygcs.core.radio_link.stream_rates import POSITION
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.uplink_watch import FEWEST, Change, UplinkWatch
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.vehicle_services import VehicleServices

IDENTIFY_AT_S = (1.0, 4.0, 10.0, 30.0, 60.0)
"""Times after its first frame or its reboot at which a vehicle's version and home, which it does not stream, are
requested."""

PARAMS_EVERY_S = 60.0
"""From one request to the next, after those, for a parameter that decides what an order does."""

IDENTIFY_WITH = ("AUTOPILOT_VERSION", "HOME_POSITION")

ROUND_TRIPS = 20
"""Acknowledgement times kept, of the last requests."""

ANSWER_WITHIN_S = 5.0
"""An acknowledgement that arrives later belongs to another request."""

Send = Callable[[MessageInfo, Mapping[str, Any]], bool]


class StreamRequester:
    """The requests to one vehicle. Call `tick` once to ten times a second; with a radio's plan, `ask` when it has its
    turn."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandClient,
        dialect: Dialect,
        rates_hz: Mapping[str, float],
        counts_on: Callable[[int], Mapping[int, int] | None] = lambda channel_id: None,
    ) -> None:
        """``rates_hz``: the wanted rates where no radio's plan is in force. ``counts_on``: frames of the vehicle on a
        channel by message id; None: it is heard on one channel only."""
        self.position_hz: float | None = None
        """The position rate for flight control; None: none (not controlled, or the autopilot closes the loops)."""
        # rate controllers: its own, and those of the radios
        self._own = RateController()
        self._radios: dict[int, RateController] = {}
        """By the channel of each radio on which it is heard."""
        self._counted_apart: set[int] = set()
        """Channels of radios whose controller counts the frames of its own channel."""
        self._chosen: int | None = None
        """The radio's channel that is the chosen link to the vehicle; None: the chosen link is no radio."""
        # collaborators
        self._counts_on = counts_on
        self._vehicle = vehicle
        self._commands = commands
        self._dialect = dialect
        # the rates that the fleet file asks for
        self._own_rates_hz = {n: hz for n, hz in rates_hz.items() if hz > 0 and n in dialect.by_name}
        self._own.plan(self._own_rates_hz, planned=False)
        self._bytes: Mapping[str, int] = {}
        # the request in progress, and what is known of the vehicle
        self._requested: tuple[str, float, RateController] | None = None
        """The message of the last SET_MESSAGE_INTERVAL that was not acknowledged yet, when it was sent, and the
        controller that it is for."""
        self._intervals_read = 0
        self._round_trips: deque[float] = deque(maxlen=ROUND_TRIPS)
        self._identified = 0
        self._identify_from: float | None = None
        self._asked_again_at = 0.0

    # -- a radio's plan

    @property
    def controller(self) -> RateController:
        """The rate controller of the chosen link."""
        return self._own if self._chosen is None else self._radios[self._chosen]

    @property
    def planned(self) -> bool:
        """True if a radio's plan sets the rates of the chosen link."""
        return self.controller.planned

    @property
    def settled(self) -> bool:
        """True if the plan of the chosen link's radio has nothing more to request."""
        return not self.planned or self.controller.settled

    def plan(self, channel_id: int, rates_hz: Mapping[str, float], frame_bytes: Mapping[str, int]) -> None:
        """Set the rates of the plan of this radio."""
        self._bytes = frame_bytes
        self._radios.setdefault(channel_id, RateController()).plan(rates_hz)

    def choose(self, channel_id: int | None) -> None:
        """The chosen link is this radio; None: no radio, and the configured rates apply."""
        self._chosen = channel_id if channel_id in self._radios else None

    def radios(self) -> tuple[int, ...]:
        """Channels of the radios whose plans include it."""
        return tuple(self._radios)

    def forget_radio(self, channel_id: int) -> None:
        """Forget the plan of a radio that the vehicle has left, or whose channel is closed."""
        self._radios.pop(channel_id, None)
        self._counted_apart.discard(channel_id)
        if self._chosen == channel_id:
            self._chosen = None

    def on_radio(self, channel_id: int) -> RateController | None:
        """The controller of one radio's plan; None: it has none."""
        return self._radios.get(channel_id)

    def want_position(self, rate_hz: float | None) -> bool:
        """Set the position rate for flight control (None: none). True if the plan provides it."""
        self.position_hz = rate_hz
        return self.planned

    def ask_on(self, channel_id: int, now: float, send: Send) -> bool:
        """Send the next request of this radio's plan if one is due; True if one was sent."""
        controller = self._radios.get(channel_id)
        if controller is None:
            return False
        on_channel = self._counts_on(channel_id)
        counts = self._counts()
        if on_channel is not None:
            names = self._dialect.messages
            counts = {names[msgid].name: count for msgid, count in on_channel.items() if msgid in names}
        if (on_channel is not None) != (channel_id in self._counted_apart):
            self._counted_apart ^= {channel_id}
            controller.recount(counts, now)
        return self._ask(controller, counts, now, send)

    def link_changed(self, channel_id: int, now: float) -> None:
        """This channel is the chosen link: what had arrived over it before says nothing of its rates now."""
        self.choose(channel_id)
        self._own.recount(self._counts(), now)
        self._requested = None

    def _counts(self) -> dict[str, int]:
        return {slot.name: slot.count for slot in self._vehicle.slots.values()}

    def _ask(self, controller: RateController, counts: Mapping[str, int], now: float, send: Send) -> bool:
        if not self._vehicle.connected or self._commands.in_flight(mav_cmd.SET_MESSAGE_INTERVAL):
            return False
        ardupilot = self._vehicle.family == "ardupilot"
        request = controller.due(counts, now, ardupilot=ardupilot, frame_bytes=self._bytes)
        message = None if request is None else self._message(request)
        if request is None or message is None:
            return False
        if request.message is not None:
            command = mav_cmd.GET_MESSAGE_INTERVAL if request.read else mav_cmd.SET_MESSAGE_INTERVAL
            self._commands.expect_stray_ack(command, now)
            if not request.read:
                self._requested = request.message, now, controller
        return send(*message)

    # -- any link

    def tick(self, now: float) -> None:
        if not self._vehicle.connected or self._vehicle.replayed:
            return
        if self._identified < len(IDENTIFY_AT_S) and self.settled:
            self._identify(now)
        elif self._identified == len(IDENTIFY_AT_S):
            self._ask_again(now)
        if not self.planned:
            self._read_intervals(now)
            if self._requested is None or now > self._requested[1] + ANSWER_WITHIN_S:
                self._ask(
                    self._own,
                    self._counts(),
                    now,
                    lambda info, values: self._commands.transmit(info.name, values, Priority.PROTOCOL),
                )

    def restart(self, now: float) -> None:
        """The vehicle rebooted: all requests have to be repeated."""
        self._identified = 0
        self._identify_from = now
        self._requested = None
        for controller in (self._own, *self._radios.values()):
            controller.restart()

    def leave(self, message: str) -> None:
        """An operator set the rate of this message on the chosen link."""
        self.controller.leave(message)

    def is_left(self, message: str) -> bool:
        """True if this message's rate is not requested: an operator set it, or the vehicle refused."""
        return self.controller.is_left(message)

    def on_ack(self, ack: Ack, now: float) -> None:
        """A COMMAND_ACK of this vehicle."""
        if (
            ack.command != mav_cmd.SET_MESSAGE_INTERVAL
            or not ack.is_for(*self._commands.own)
            or self._requested is None
        ):
            return
        (message, sent_at, controller), self._requested = self._requested, None
        if now - sent_at > ANSWER_WITHIN_S:
            return
        self._round_trips.append(now - sent_at)
        result = RESULT_NAMES.get(ack.result)
        if result == "unsupported":
            controller.old = True
        # without a plan one request is in flight at a time, so that a refusal is known to belong to it
        can_have_group = result == "unsupported" and self._vehicle.family == "ardupilot"
        if not controller.planned and result in ("unsupported", "denied", "failed") and not can_have_group:
            controller.leave(message)

    def round_trip_s(self) -> float | None:
        """Median of the last requests, their wait for the air included."""
        ordered = sorted(self._round_trips)
        return ordered[len(ordered) // 2] if ordered else None

    def status(self, channel_id: int) -> dict[str, dict[str, float]]:
        """Planned and measured Hz of each message that a radio's plan has or that arrives."""
        controller = self._radios.get(channel_id, self._own)
        rates = {slot.name: slot.rate_hz for slot in self._vehicle.slots.values()}
        if controller is not self.controller:
            rates = controller.measured_hz()
        planned = controller.rates_hz
        names = sorted({*planned, *(n for n, hz in rates.items() if hz > 0)}, key=lambda n: (n != POSITION, n))
        return {
            name: {"planned_hz": planned.get(name, 0.0), "measured_hz": round(rates.get(name, 0.0), 2)}
            for name in names
        }

    def add_to(self, state: dict[str, Any]) -> None:
        """Add the planned rate of each message to a vehicle's state, if a radio has a plan for it."""
        if self.planned:
            for name, message in state["messages"].items():
                message["planned_hz"] = self.controller.rates_hz.get(name, 0.0)

    # -- the inside

    def _identify(self, now: float) -> None:
        """Send a request unless an order with the same command is in flight: its ack could be taken for the order's."""
        if self._identify_from is None:
            self._identify_from = now
        if now - self._identify_from < IDENTIFY_AT_S[self._identified]:
            return
        self._identified += 1
        self._asked_again_at = now
        if self._commands.in_flight(mav_cmd.REQUEST_MESSAGE) or "COMMAND_LONG" not in self._dialect.by_name:
            return
        for message in IDENTIFY_WITH:
            info = self._dialect.by_name.get(message)
            if info is not None and self._vehicle.slot(message) is None:
                values = {"command": mav_cmd.REQUEST_MESSAGE, "param1": float(info.msgid)}
                self._commands.transmit("COMMAND_LONG", values, Priority.PROTOCOL)
        self._identify_program()

    def _identify_program(self) -> None:
        """Ask an ArduPilot which of its programs it is, and an ArduPlane whether it lifts by rotors: its MAV_TYPE shows
        neither (`mavlink.vehicle_class`). Ask what cannot stop how wide its circles are."""
        vehicle = self._vehicle
        ardupilot = vehicle.family == "ardupilot"
        if ardupilot and vehicle.program is None and not self._commands.in_flight(mav_cmd.DO_SEND_BANNER):
            self._commands.transmit("COMMAND_LONG", {"command": mav_cmd.DO_SEND_BANNER}, Priority.PROTOCOL)
        self._ask_params(vehicle.abilities.asked_params)

    def _ask_params(self, names: Iterable[str]) -> None:
        """Ask for those of these parameters that are not known."""
        if "PARAM_REQUEST_READ" not in self._dialect.by_name:
            return
        for name in names:
            if self._vehicle.param(name) is None:
                values = {"param_id": name, "param_index": -1}
                self._commands.transmit("PARAM_REQUEST_READ", values, Priority.PROTOCOL)

    def _ask_again(self, now: float) -> None:
        """Ask now and then for a parameter without which an order is refused: all requests of the beginning may have
        been lost, or its class was not known then. Q_ENABLE, which a build without QuadPlanes has not, is asked for
        only while nothing else shows that."""
        if now - self._asked_again_at < PARAMS_EVERY_S:
            return
        self._asked_again_at = now
        names = self._vehicle.abilities.asked_params
        self._ask_params(name for name in names if name != "Q_ENABLE" or not self._vehicle.rotors_known)

    def _read_intervals(self, now: float) -> None:
        """Give the controller the newest MESSAGE_INTERVAL."""
        slot = self._vehicle.slot("MESSAGE_INTERVAL")
        if slot is None or slot.frame is None or slot.count == self._intervals_read:
            return
        self._intervals_read = slot.count
        answer = slot.frame.fields()
        streamed = self._dialect.messages.get(int(answer.get("message_id", -1)))
        if streamed is not None:
            self._own.on_interval(streamed.name, float(answer.get("interval_us", -1)), now)

    def _message(self, request: RateRequest) -> tuple[MessageInfo, dict[str, Any]] | None:
        """None for a message the dialect lacks."""
        target = {"target_system": self._vehicle.sysid, "target_component": self._vehicle.compid}
        if request.stream is not None:
            info = self._dialect.by_name.get("REQUEST_DATA_STREAM")
            rate = {"req_message_rate": round(request.rate_hz), "start_stop": int(request.rate_hz > 0)}
            return None if info is None else (info, {**target, "req_stream_id": request.stream, **rate})
        info = self._dialect.by_name.get("COMMAND_LONG")
        streamed = self._dialect.by_name.get(request.message or "")
        if info is None or streamed is None:
            return None
        command: dict[str, Any] = {"command": mav_cmd.GET_MESSAGE_INTERVAL, "param1": float(streamed.msgid)}
        if not request.read:
            interval_us = round(1e6 / request.rate_hz) if request.rate_hz > 0 else -1
            command |= {"command": mav_cmd.SET_MESSAGE_INTERVAL, "param2": float(interval_us)}
        return info, {**target, **command}


PROBE = "uplink probe"
"""Key of a vehicle's probe in the queue of a slow link."""


class UplinkProbes:
    """Sends probes (TIMESYNC) when ``watch`` wants them, and gives it what answers them."""

    def __init__(
        self, watch: UplinkWatch, vehicle: Vehicle, commands: CommandClient, services: VehicleServices
    ) -> None:
        self._watch = watch
        self._vehicle = vehicle
        self._commands = commands
        self._services = services
        self._enabled = services.probes and "TIMESYNC" in services.dialect.by_name

    def state(self, now: float) -> dict[str, Any] | None:
        """The uplink's part of a vehicle's state (`VehicleState.uplink`); None: nothing is known."""
        watch = self._watch
        if not self._enabled or watch.answered_at is None:
            return None
        return {
            "heard": not watch.lost,
            "unanswered": watch.unanswered,
            "rtt_s": None if watch.trip_s is None else round(watch.trip_s, 3),
            "age_s": round(now - watch.answered_at, 2),
        }

    def tick(self, now: float) -> None:
        """Send a probe if one is due, and report the result of earlier ones."""
        if not self._enabled or not self._vehicle.connected:
            return
        watch = self._watch
        if watch.unanswered >= FEWEST and watch.verdict(now, self._last_frame_at()) is not None:
            self._report("lost")
        armed = self._vehicle.armed
        if not watch.due(now, armed=armed):  # so most ticks do not ask what the links carry
            return
        links, key = self._services.links, (PROBE, self._vehicle.key)
        share = links.setpoint_bytes_per_s(self._vehicle, self._services.flown)
        if not watch.due(now, armed=armed, share_bytes_per_s=share):
            return
        if math.isfinite(share) and links.holds(self._vehicle, Priority.COMMAND, key):
            return  # the last one has not left yet: another one behind it measures nothing
        token = watch.token()
        if self._commands.transmit("TIMESYNC", {"tc1": 0, "ts1": token}, key=key):
            watch.sent(token, now, self._last_frame_at())

    def _last_frame_at(self) -> float:
        return max((slot.at for slot in self._vehicle.slots.values()), default=-math.inf)

    def on_ack(self, now: float) -> None:
        """The vehicle has acknowledged a command of ours: it hears us."""
        if self._watch.answered_at is not None:
            self._report(self._watch.heard(now))

    def is_answer(self, frame: Frame, now: float) -> bool:
        """Take a TIMESYNC; True if it answers a probe."""
        fields = frame.fields()
        if fields["tc1"] == 0:
            return False
        ours, change = self._watch.answered(int(fields["ts1"]), now)
        self._report(change)
        return ours

    def _report(self, change: Change | None) -> None:
        if change is None:
            return
        if change == "lost":
            self._services.links.uplink_lost(self._vehicle.key)
            text = (
                f"it does not hear us: no answer to {self._watch.unanswered} probes, while its telemetry comes; "
                "orders do not reach it, and its failsafe for a lost ground station will act"
            )
        else:
            text = "it hears us again"
        self._services.on_event(Event(f"uplink_{change}", self._vehicle.name, self._vehicle.sysid, text, {}))
