"""The ground's connection to one companion: JSON-RPC over mutual TLS, opened again whenever it ends.

connecting ──► up ──lost, silent for ANSWERS_SILENT_S──► down ──back-off, connected──► up
     └────────could not connect─────────────────► down ──back-off, could not connect──► down

Nothing is queued for a companion that is down: an order that comes late is worse than one that is refused now.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, Literal, Protocol

from skygcs.back_off import BackOff
from skygcs.core.clock_offset import ClockComparison, ClockOffset
from skygcs.errors import DaemonUnreachable, LinkError, RpcError, SkygcsError
from skygcs.events import Event
from skygcs.links.base import FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S, STABLE_AFTER_S
from skygcs.runtime.loop_clock import PAUSED, exact_clock

JsonObject = dict[str, Any]
LinkState = Literal["connecting", "up", "down"]

CONNECT_S = 5.0
"""Time for TCP, TLS and the first answer: two round trips of a link with 0.8 s of delay, and a lost packet."""

CLOCK_PERIOD_S = 2.0
"""Between two readings of the companion's clock, which also show that it is there."""

ANSWERS_SILENT_S = 5.0
"""Without any answer for this time the connection is given up: TCP itself would notice after minutes."""

UNREPLIED_S = 15.0
"""Without the answer to any call for this time it is given up although the companion reports states: a companion that
reads nothing takes no order, and what is sent to it would wait here and grow."""

CALL_S = 5.0
"""Default time for an answer."""

MAX_CALLS = 48
"""Calls that wait for an answer at the same time; the companion answers 64 of one client, a few of which are ours."""

STATE_RATE_HZ = 5.0
STATE_GROUPS = ("control",)
"""Telemetry groups of the companion's vehicle that observers of its state get: all else comes as MAVLink."""


class _NoAnswer(LinkError):
    """The answer did not come in time; the connection may still be there."""


class CompanionClient(Protocol):
    """An open connection; `skygcs.rpc.client.Client` is one."""

    async def call(self, method: str, /, **params: Any) -> Any: ...
    def events(self) -> AsyncIterator[JsonObject]: ...
    def telemetry(self, *, rate_hz: float, groups: tuple[str, ...]) -> AsyncIterator[JsonObject]: ...
    async def close(self) -> None: ...


Dial = Callable[[], Awaitable[CompanionClient]]
"""Connects and authenticates, both ways. Raises SkygcsError with what to do."""

Observer = Callable[[JsonObject], None]


class CompanionLink:
    """``name`` of the companion, ``vehicle`` it is on. `run` is the task that keeps it connected; the rest is for the
    loop's thread at any time."""

    def __init__(
        self,
        name: str,
        vehicle: str,
        dial: Dial,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        asleep: Callable[[], bool] = lambda: False,
    ) -> None:
        """``asleep``: `SleepWatch.check`."""
        self.name = name
        self.vehicle = vehicle
        # status
        self.state: LinkState = "connecting"
        self.since = loop.time()
        self.last_error: str | None = None
        """The latest reason, also after recovery."""
        self.failures = 0
        """Attempts since it was up last."""
        self.connected = 0
        """Connections so far."""
        self.version: str | None = None
        """The skygcs that answers there."""
        # connection and clock
        self._dial = dial
        self._loop = loop
        self._on_event = on_event
        self._client: CompanionClient | None = None
        self._asleep = asleep
        self._woken: asyncio.Future[str] = loop.create_future()
        """Done, with the reason, once what this connection still brings may be of before a sleep or a standstill."""
        self._calls = 0
        self._answered_at = self._replied_at = float("-inf")
        """When anything came, and when the answer to a call did."""
        self._now = exact_clock(loop)
        self._clock = ClockComparison()
        # observers
        self._event_observers: list[Observer] = []
        self._state_observers: list[Observer] = []
        self._up_observers: list[Callable[[bool], None]] = []
        self._reported_down = False

    # -- what the rest of the daemon uses

    @property
    def is_up(self) -> bool:
        """True if orders can be sent now."""
        return self._client is not None and self.state == "up"

    def clock(self) -> ClockOffset | None:
        """The companion's monotonic clock (that of its `clock.read`) against the loop's; None while unknown."""
        return self._clock.best(self._now())

    async def call(self, method: str, params: JsonObject | None = None, timeout_s: float = CALL_S) -> Any:
        """The result of one method of the companion.

        Raises LinkError if it is not connected, if too many calls wait, and if the answer does not come in time or the
        connection ends before it (the order may have been carried out); RpcError if it refuses.
        """
        client = self._client
        if client is None or self.state != "up":
            raise LinkError(f"companion {self.name} is not connected ({self.last_error or 'not yet'})")
        if self._calls >= MAX_CALLS:
            raise LinkError(f"companion {self.name}: {MAX_CALLS} calls wait for an answer already")
        return await self._call(client, method, params or {}, timeout_s)

    def on_events(self, observer: Observer) -> Callable[[], None]:
        """Have each event of the companion (as in the notification ``event``) handed to ``observer``; returns how to
        stop it. Events during a gap of the connection are lost."""
        return _added(self._event_observers, observer)

    def on_states(self, observer: Observer) -> Callable[[], None]:
        """Have the control state of the companion's vehicle handed to ``observer``, at most `STATE_RATE_HZ` times a
        second; returns how to stop it."""
        return _added(self._state_observers, observer)

    def on_up(self, observer: Callable[[bool], None]) -> Callable[[], None]:
        """Have ``observer(True)`` called when the connection is up, ``observer(False)`` when it ended; returns how to
        stop it."""
        return _added(self._up_observers, observer)

    def summary(self) -> JsonObject:
        """Its part of a vehicle's state (`VehicleState.companion`)."""
        return {
            "link": self.state,
            "since_s": round(self._loop.time() - self.since, 1),
            "error": None if self.state == "up" else self.last_error,
            "version": self.version,
        }

    def status(self) -> JsonObject:
        """JSON-able, for companions.status."""
        clock = self.clock()
        return {
            "name": self.name,
            "vehicle": self.vehicle,
            "state": self.state,
            "since_s": round(self._loop.time() - self.since, 1),
            "last_error": self.last_error,
            "failures": self.failures,
            "connected": self.connected,
            "version": self.version,
            "clock": None
            if clock is None
            else {
                "wall_offset_s": round(clock.wall_offset_s, 4),
                "offset_s": round(clock.offset_s, 4),
                "error_s": round(clock.error_s, 4),
                "round_trip_s": round(clock.round_trip_s, 4),
                "age_s": round(clock.age_s, 1),
            },
        }

    def woke(self, why: str) -> None:
        """After a sleep or a standstill: what has waited in the connection does not count, and it is made anew."""
        if self._client is not None and not self._woken.done():
            self._woken.set_result(why)

    # -- keeping it connected

    async def run(self) -> None:
        """Until cancelled. Nothing that a companion does ends it."""
        # one that comes back into the Wi-Fi is connected within five seconds
        back_off = BackOff(FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S, STABLE_AFTER_S)
        while True:
            reason = await self._one_connection()
            up_s = self._loop.time() - self.since if self.state == "up" else 0.0
            self._went_down(reason)
            await asyncio.sleep(back_off.after(up_s))

    async def _one_connection(self) -> str:
        """Connect, and wait for the end; its reason."""
        client: CompanionClient | None = None
        try:
            async with asyncio.timeout(CONNECT_S):
                client = await self._dial()
                await client.call("operator.relay")  # what we ask by ourselves is no person's input there
                info = await client.call("daemon.info")
            self._came_up(client, info)
            await self._attend(client)
        except TimeoutError:
            return f"no answer within {CONNECT_S:g} s"
        except DaemonUnreachable as error:
            return error.reason
        except SkygcsError as error:
            return str(error)
        except Exception as error:  # an answer that skygcs does not give fails this connection only
            return f"unexpected {type(error).__name__}: {error}"
        finally:
            self._client = None
            if client is not None:
                await client.close()
        return "closed"

    async def _attend(self, client: CompanionClient) -> None:
        """Pass on what the companion reports, and read its clock, until one of them fails."""
        tasks = [
            self._loop.create_task(work, name=f"companion {self.name} {what}")
            for what, work in (
                ("events", self._pass_on(client.events(), self._event_observers)),
                (
                    "state",
                    self._pass_on(client.telemetry(rate_hz=STATE_RATE_HZ, groups=STATE_GROUPS), self._state_observers),
                ),
                ("clock", self._read_clock(client)),
                ("watch", self._until_woken()),
            )
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                await task
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _pass_on(self, source: AsyncIterator[JsonObject], observers: list[Observer]) -> None:
        async for item in source:
            self._require_awake()
            self._answered_at = self._loop.time()
            for observer in tuple(observers):
                observer(item)

    async def _until_woken(self) -> None:
        await asyncio.shield(self._woken)
        self._require_awake()

    def _require_awake(self) -> None:
        """Raises LinkError if what has come may be of before a sleep or a standstill."""
        if self._asleep():
            self.woke(PAUSED)
        if self._woken.done():
            raise LinkError(f"{self._woken.result()}: what has waited does not count, it is connected anew")

    async def _read_clock(self, client: CompanionClient) -> None:
        while True:
            sent = self._now()
            try:
                answer = await self._call(client, "clock.read", {}, ANSWERS_SILENT_S)
            except _NoAnswer:
                now = self._loop.time()
                if now - self._answered_at >= ANSWERS_SILENT_S or now - self._replied_at >= UNREPLIED_S:
                    raise
                continue
            received = self._now()
            self._clock.add(
                sent,
                received,
                float(answer["monotonic_s"]),
                wall_received=time.time(),
                remote_wall=float(answer["unix_s"]),
            )
            await asyncio.sleep(CLOCK_PERIOD_S)

    async def _call(self, client: CompanionClient, method: str, params: JsonObject, timeout_s: float) -> Any:
        self._calls += 1
        try:
            async with asyncio.timeout(timeout_s):
                result = await client.call(method, **params)
        except TimeoutError:
            raise _NoAnswer(f"companion {self.name}: no answer to {method} within {timeout_s:g} s") from None
        except DaemonUnreachable as error:
            raise LinkError(f"companion {self.name}: the connection ended during {method} ({error.reason})") from None
        except RpcError:
            self._answered_at = self._replied_at = self._loop.time()
            raise
        finally:
            self._calls -= 1
        self._require_awake()
        self._answered_at = self._replied_at = self._loop.time()
        return result

    # -- its state

    def _came_up(self, client: CompanionClient, info: JsonObject) -> None:
        self._client = client
        self._woken = self._loop.create_future()
        self._clock = ClockComparison()
        self._answered_at = self._replied_at = self._loop.time()
        self.version = str(info.get("version"))[:32]
        self.connected += 1
        self.failures = 0
        self._enter("up")
        self._report("up", f"companion {self.name} is connected" + (" again" if self.connected > 1 else ""))
        self._reported_down = False
        for observer in tuple(self._up_observers):
            observer(True)

    def _went_down(self, reason: str) -> None:
        was_up = self.state == "up"
        self._enter("down")
        self.last_error = reason
        self.failures += 1
        if not self._reported_down:
            self._reported_down = True
            self._report("down", f"companion {self.name} is not connected: {reason}", reason=reason)
        if was_up:
            for observer in tuple(self._up_observers):
                observer(False)

    def _enter(self, state: LinkState) -> None:
        if state != self.state:
            self.state = state
            self.since = self._loop.time()

    def _report(self, change: str, text: str, **data: Any) -> None:
        event = Event("companion", self.vehicle, None, text, {"companion": self.name, "change": change, **data})
        self._on_event(event)


def _added(observers: list[Any], observer: Any) -> Callable[[], None]:
    observers.append(observer)

    def remove() -> None:
        if observer in observers:
            observers.remove(observer)

    return remove
