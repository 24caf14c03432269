"""What a vehicle is asked for without an order: who it is, where its home is, and the messages the picture needs.

Nothing of it is urgent: it goes out behind orders, a few times, and again after a reboot.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.radio_link.requested_streams import STREAM_GROUPS, StreamRequests
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.autopilot import REQUEST_MESSAGE
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.plan_runner import Attempt
from skygcs.runtime.task_set import fault

IDENTIFY_AT_S = (1.0, 4.0, 10.0, 30.0, 60.0)
"""When, after it was met or rebooted, a vehicle is asked for what nobody streams: its version and its home."""

SLOWER = 1.5
"""A message that is streamed with up to this much of the wanted interval is not asked for: as of a radio's plan."""

IDENTIFY_WITH = ("AUTOPILOT_VERSION", "HOME_POSITION")


class StreamRequester:
    """`tick` once to ten times a second; ``attempt`` carries out a plan, ``on_fault`` is told of a fault of ours."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandClient,
        dialect: Dialect,
        rates_hz: Mapping[str, float],
        attempt: Attempt,
        on_fault: Callable[[str], None],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._vehicle = vehicle
        self._commands = commands
        self._dialect = dialect
        self._attempt = attempt
        self._on_fault = on_fault
        self._loop = loop
        self._keeper = StreamRequests({n: r for n, r in rates_hz.items() if n in dialect.by_name})
        self._asking: asyncio.Task[None] | None = None
        self._identified = 0
        self._identify_from: float | None = None
        self.planned = False
        """Whether a radio's plan sees to its streams."""
        self.busy = False
        """Whether that plan still has something to ask for, before which the rest can wait."""

    def tick(self, now: float) -> None:
        if not self._vehicle.connected or self._vehicle.replayed:
            return
        if self._identified < len(IDENTIFY_AT_S) and not self.busy:
            self._identify(now)
        if self._asking is None and not self.planned:
            self._keep_streams(now)

    def restart(self, now: float) -> None:
        """The vehicle rebooted: what it was asked for is forgotten there."""
        self._identified = 0
        self._identify_from = now
        self._keeper.restart()

    def leave(self, message: str) -> None:
        """A person took the rate of this message in hand."""
        self._keeper.refuse(message)

    def is_left(self, message: str) -> bool:
        """Whether this message's rate is not asked for: a person has it in hand, or the vehicle refused."""
        return self._keeper.is_refused(message)

    def close(self) -> None:
        if self._asking is not None:
            self._asking.cancel()

    def _identify(self, now: float) -> None:
        """Fire and forget, and never beside an order of that kind: its ack could pass for the order's."""
        if self._identify_from is None:
            self._identify_from = now
        if now - self._identify_from < IDENTIFY_AT_S[self._identified]:
            return
        self._identified += 1
        if self._commands.in_flight(REQUEST_MESSAGE) or "COMMAND_LONG" not in self._dialect.by_name:
            return
        for message in IDENTIFY_WITH:
            info = self._dialect.by_name.get(message)
            if info is not None and self._vehicle.slot(message) is None:
                values = {"command": REQUEST_MESSAGE, "param1": float(info.msgid)}
                self._commands.transmit("COMMAND_LONG", values, Priority.PROTOCOL)

    def _keep_streams(self, now: float) -> None:
        """Ask for the next wanted message that does not come, in a task of its own: the answer takes a while."""
        due = self._keeper.due(now, self._last_at, ardupilot=self._vehicle.family == "ardupilot")
        if due is not None:
            name = f"asking {self._vehicle.name} for {due[0]}"
            self._asking = self._loop.create_task(self._ask_for(*due), name=name)
            self._asking.add_done_callback(self._asked)

    def _asked(self, task: asyncio.Task[None]) -> None:
        self._asking = None
        if (text := fault(task)) is not None:
            self._on_fault(text)

    async def _ask_for(self, message: str, rate_hz: float) -> None:
        if self._vehicle.family != "ardupilot" and await self._will_come(message, rate_hz):
            return
        outcome = await self._attempt(
            lambda now: orders.message_interval(self._vehicle, now, self._dialect, message, rate_hz)
        )
        if outcome.result not in ("unsupported", "denied", "failed"):
            return
        self._keeper.refuse(message)
        group = STREAM_GROUPS.get(message)
        if outcome.result == "unsupported" and group is not None and self._vehicle.family == "ardupilot":
            whole_hz = max(1.0, rate_hz)  # REQUEST_DATA_STREAM knows no fractions
            await self._attempt(lambda now: orders.request_stream(self._vehicle, now, self._dialect, group, whole_hz))

    async def _will_come(self, message: str, rate_hz: float) -> bool:
        """Whether the vehicle streams it already and only has nothing to send yet.

        A PX4 without a position sends none, at any rate. To ask it for 2 Hz then leaves it at 2 Hz when it has one,
        instead of its own 5, for every program on the link.
        """
        if "MESSAGE_INTERVAL" not in self._dialect.by_name:
            return False
        before = self._vehicle.count("MESSAGE_INTERVAL")
        outcome = await self._attempt(lambda now: orders.read_interval(self._vehicle, now, self._dialect, message))
        slot = self._vehicle.slot("MESSAGE_INTERVAL")
        if not outcome.ok or slot is None or slot.frame is None or slot.count == before:
            return False  # it cannot say
        answer = slot.frame.fields()
        known = answer.get("message_id") == self._dialect.by_name[message].msgid
        return known and 0 < answer.get("interval_us", -1) <= SLOWER * 1e6 / rate_hz

    def _last_at(self, message: str) -> float | None:
        slot = self._vehicle.slot(message)
        return None if slot is None else slot.at
