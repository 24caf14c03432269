"""Asyncio client of a running skygcs daemon.

    from skygcs.rpc.client import connect

    async with connect() as gcs:                          # the default socket, or a path, or tcp://127.0.0.1:PORT
        outcomes = await gcs.arm("all")                   # {"alpha": {"ok": true, "result": "accepted", ...}, ...}
        await gcs.takeoff("alpha", 5)
        async for state in gcs.telemetry("alpha", rate_hz=5):
            print(state["position"]["alt_rel_m"])

Every method of docs/reference/rpc.md can be called by name: ``await gcs.call("vehicles.arm", targets="all")``.
An error answer is raised as RpcError (``code``, ``message``, ``data``), a daemon that is not there or goes away as
DaemonUnreachable; the caller decides whether to connect again. A cancelled call is no longer waited for, but the order
may have been sent; closing the connection cancels what the daemon still does for it, except land, rtl, hold and disarm,
which are carried out to their end. One client belongs to one loop.
"""

from __future__ import annotations

import asyncio
import errno
import json
import math
import os
import pwd
import re
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Self, cast

from skygcs.errors import DaemonForbidden, DaemonUnreachable, RpcError
from skygcs.rpc.address import client_address, tcp_address
from skygcs.rpc.error_codes import INVALID_PARAMS

if TYPE_CHECKING:  # a client of the Unix socket needs no TLS
    from skygcs.rpc.tls import Identity, PinnedTls

_OnAnswer = Callable[[Any, "RpcError | None"], None]
Targets = str | int | Sequence[str | int]
Outcomes = dict[str, dict[str, Any]]
"""By vehicle name: ok, result, message, attempts, elapsed_s, status_texts. Orders never raise for a vehicle's "no"."""

TrajectoryOrder = Literal["start", "pause", "resume", "speed", "abort", "unload"]


CONNECT_WITHIN_S = 10.0
CONNECT_AGAIN_S = 0.01
"""A daemon takes connections every few milliseconds, 100 at a time."""

INBOX = 1000
"""Events or messages waiting for a slow ``async for``; older ones are then dropped and counted."""

CLOSE_S = 1.0
"""For the last words of TLS."""

MAX_REPLY_BYTES = 32 << 20
"""Longest line that is taken. The daemon sends 8 MiB at most; a plan of 32 MiB goes to it, not from it."""

MAX_REQUEST_BYTES = 1 << 20
"""Longest line that the daemon takes (`sessions.MAX_LINE_BYTES`). Its refusal of a longer one names no request, which
would wait for its answer for ever."""

MAX_NUMBER_CHARS = 20
"""Of a subscription's number."""

_RESULT = re.compile(rb'\{"jsonrpc":"2\.0","id":(\d{1,20}),"result":')
_TELEMETRY = b'{"jsonrpc":"2.0","method":"telemetry","params":{"state":'
_STATE_NAME = re.compile(rb'\{"name":("(?:[^"\\]|\\.)*")')

UPLOAD_ABOVE_CHARS = 900_000
"""Of a plan's text: a line of the socket has 1 MiB, with the rest of the request."""

PART_CHARS = 400_000
"""Of plan.upload."""

PROGRESS = "plan.progress"
"""The notification that belongs to no subscription."""

EVENT_KINDS = (
    "vehicle_discovered",
    "vehicle_lost",
    "vehicle_back",
    "vehicle_forgotten",
    "armed",
    "disarmed",
    "mode",
    "landed",
    "system_status",
    "statustext",
    "reboot",
    "failsafe",
    "command",
    "control",
    "mission",
    "fence",
    "origin",
    "conflict",
    "duplicate",
    "link_up",
    "link_down",
    "link_degraded",
    "link_recovered",
    "route",
    "signing",
    "recorder",
    "params",
    "third_party",
    "undo",
    "separation",
    "authority",
    "mocap",
    "companion",
    "ground_lost",
    "federation",
    "uplink_lost",
    "uplink_back",
    "warning",
    "fault",
)
"""What an event may be about, for `Client.events` and events.recent."""


def connect(address: str | os.PathLike[str] | None = None, *, token: str | None = None) -> Client:
    """A client for ``async with``. Default address: $SKYGCS_SOCKET, else the user's own socket.

    ``address`` is a path or ``tcp://HOST:PORT``; TCP needs the daemon's ``token``. Entering raises DaemonUnreachable.
    """
    return Client(client_address(address), token)


async def connect_pinned(host: str, port: int, identity: Identity) -> Client:
    """A client of a companion, connected over TLS with pinned certificates. Raises LinkError for files that cannot be
    used, DaemonUnreachable."""
    from skygcs.rpc.tls import PinnedTls

    client = Client(f"tls://{host}:{port}", tls=PinnedTls(identity, server=False))
    await client.open()
    return client


class Client:
    """A connection; made by `connect`. Usable from many tasks of one loop."""

    def __init__(self, address: str, token: str | None = None, tls: PinnedTls | None = None) -> None:
        self.address = address
        self._token = token
        self._tls = tls
        self._wire: _Wire | None = None
        self._last_id = 0

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Connect. Raises DaemonUnreachable, and RpcError for a wrong token."""
        loop = asyncio.get_running_loop()
        try:
            tcp = None if self._tls is not None else tcp_address(self.address)
            if self._tls is not None:
                self._wire = await _connected_over_tls(self.address, self._tls)
            elif tcp is not None:
                _, self._wire = await loop.create_connection(lambda: _Wire(self.address), *tcp)
            else:
                sock = await _connected_to(self.address)
                _, self._wire = await loop.create_unix_connection(lambda: _Wire(self.address), sock=sock)
        except ValueError as error:
            raise DaemonUnreachable(self.address, str(error)) from None
        except PermissionError as error:
            owner = _owner_of(self.address)
            if owner is not None:
                raise DaemonForbidden(self.address, owner) from None
            raise DaemonUnreachable(self.address, os.strerror(error.errno or errno.EACCES)) from None
        except OSError as error:
            raise DaemonUnreachable(self.address, os.strerror(error.errno) if error.errno else str(error)) from None
        if self._token is not None and self.address.startswith("tcp://"):
            await self.call("auth", token=self._token)

    @property
    def connected(self) -> bool:
        """Whether the connection is open, as far as is known here: a call then is really sent."""
        return self._wire is not None and self._wire.is_open

    async def close(self) -> None:
        """Close; calls and iterations still waiting end with DaemonUnreachable. Idempotent."""
        wire, self._wire = self._wire, None
        if wire is None:
            return
        wire.transport.close()
        wire.lose("closed here")
        if self._tls is not None:  # the other side may not answer the end of TLS
            try:
                async with asyncio.timeout(CLOSE_S):
                    await wire.closed.wait()
            except TimeoutError:
                wire.transport.abort()

    async def call(self, method: str, /, **params: Any) -> Any:
        """The result of one method. Raises RpcError, DaemonUnreachable, and ValueError for what JSON cannot carry."""
        return await self._answer(self._connected(), self._next_id(), method, params, {})

    async def relay(self, method: str, params: dict[str, Any], deadline_s: float | None = None) -> bytes:
        """The result as the daemon encoded it, for a program that passes it on: a list of parameters has megabytes.

        A daemon that reads the request after ``deadline_s`` of its own clock (now_s of daemon.info) refuses it.
        """
        wire, number = self._connected(), self._next_id()
        wire.encoded.add(number)
        members = {} if deadline_s is None else {"deadline_s": deadline_s}
        try:
            result = await self._answer(wire, number, method, params, members)
        finally:
            wire.encoded.discard(number)
        return result if isinstance(result, bytes) else json.dumps(result).encode()

    async def _answer(
        self, wire: _Wire, number: int, method: str, params: dict[str, Any], members: Mapping[str, Any]
    ) -> Any:
        """``members``: of the request, besides those of JSON-RPC."""
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def on_answer(result: Any, error: RpcError | None) -> None:
            if future.done():
                return
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)

        wire.start(number, method, params, on_answer, members)
        return await future

    # -- vehicles

    async def vehicles(self, targets: Targets = "all") -> list[dict[str, Any]]:
        """The states of some or all vehicles."""
        states: list[dict[str, Any]] = await self.call("vehicles.list", targets=_plain(targets))
        return states

    async def vehicle(self, target: str | int) -> dict[str, Any]:
        """The state of one vehicle."""
        state: dict[str, Any] = await self.call("vehicles.get", target=target)
        return state

    async def arm(self, targets: Targets, *, force: bool = False, wait_s: float = 0.0) -> Outcomes:
        """``wait_s``: keep trying while the autopilot is not ready yet."""
        return await self._order("arm", targets, force=force, wait_s=wait_s)

    async def disarm(self, targets: Targets, *, force: bool = False, confirm: str | None = None) -> Outcomes:
        """``force``: in flight as well; the vehicle falls. ``confirm``: for a duplicate system id, "disarm-2"."""
        return await self._order("disarm", targets, force=force, confirm=confirm)

    async def takeoff(
        self,
        targets: Targets,
        height_m: float | None = None,
        *,
        arm: bool = True,
        wait_s: float = 0.0,
        force: bool = False,
    ) -> Outcomes:
        """To a height above the ground it stands on; None: the fleet file's. ``wait_s`` as for `arm`.

        ``force``: without a required preflight.
        """
        return await self._order("takeoff", targets, height_m=height_m, arm=arm, wait_s=wait_s, force=force)

    async def land(self, targets: Targets) -> Outcomes:
        """Land where each of them is."""
        return await self._order("land", targets)

    async def rtl(self, targets: Targets) -> Outcomes:
        """Return to the place of take-off and land there, as the autopilot is set."""
        return await self._order("rtl", targets)

    async def hold(self, targets: Targets) -> Outcomes:
        """Stop, and stay there."""
        return await self._order("hold", targets)

    async def mode(self, targets: Targets, mode: str) -> Outcomes:
        """By the autopilot's own name: "AUTO.LOITER" (PX4), "GUIDED" (ArduCopter)."""
        return await self._order("mode", targets, mode=mode)

    async def goto(  # noqa: PLR0913 - the parameters of vehicles.goto
        self,
        targets: Targets,
        lat_deg: float | None = None,
        lon_deg: float | None = None,
        height_m: float | None = None,
        *,
        enu_m: Sequence[float] | None = None,
        yaw_deg: float | None = None,
        force: bool = False,
        same_place: bool = False,
        together: Targets | None = None,
    ) -> Outcomes:
        """To degrees and a height above home (None: as high as it is), or to east, north, up from the origin.

        Several vehicles keep their places to each other and their middle goes there, unless ``same_place``.
        ``together``: vehicles that the caller keeps apart from these itself.
        """
        place: dict[str, Any] = {"lat_deg": lat_deg, "lon_deg": lon_deg, "height_m": height_m, "yaw_deg": yaw_deg}
        place |= {"force": force, "same_place": same_place, "together": together}
        return await self._order("goto", targets, enu_m=None if enu_m is None else list(enu_m), **place)

    async def setpoint(self, targets: Targets, **setpoint: Any) -> Outcomes:
        """One setpoint of a stream; ``setpoint``: the parameters of control.setpoint."""
        outcomes: Outcomes = (await self.call("control.setpoint", targets=_plain(targets), **setpoint))["outcomes"]
        return outcomes

    async def load_trajectory(
        self, target: str | int, pieces: Sequence[Mapping[str, Any]], *, name: str = "trajectory"
    ) -> Outcomes:
        """Keep a trajectory for a vehicle; ``pieces`` as in trajectory.load."""
        plain = [dict(piece) for piece in pieces]
        outcomes: Outcomes = (await self.call("trajectory.load", target=target, pieces=plain, name=name))["outcomes"]
        return outcomes

    async def trajectory(self, order: TrajectoryOrder, targets: Targets, **params: Any) -> Outcomes:
        """Fly what was loaded; ``params`` of start: after_s or at_s, speed, force; of speed: speed."""
        answer = await self.call(f"trajectory.{order}", targets=_plain(targets), **params)
        outcomes: Outcomes = answer["outcomes"]
        return outcomes

    async def given_plan(self, text: str) -> dict[str, Any]:
        """The parameter of plan.load and plan.certify for the text of a plan's file: the plan, or, if a request cannot
        hold it, the number under which the daemon took it in parts."""
        if len(text) <= UPLOAD_ABOVE_CHARS:
            return {"plan": json.loads(text)}
        number: int | None = None
        for at in range(0, len(text), PART_CHARS):
            number = (await self.call("plan.upload", part=text[at : at + PART_CHARS], upload=number))["upload"]
        return {"upload": number}

    async def planning(
        self,
        method: str,
        *,
        on_progress: Callable[[dict[str, Any]], None] | None = None,
        **params: Any,
    ) -> dict[str, Any]:
        """plan.make or plan.certify, which may take a minute; ``on_progress`` gets job, what, done and total. A client
        has one such request at a time. Cancelled here, it goes on in the daemon until `close` or plan.cancel."""
        wire = self._connected()
        wire.on_progress = on_progress
        try:
            answer: dict[str, Any] = await self.call(method, progress=on_progress is not None, **params)
        finally:
            wire.on_progress = None
        return answer

    async def reboot(self, targets: Targets, *, force: bool = False) -> Outcomes:
        """``force``: although it is armed."""
        return await self._order("reboot", targets, force=force)

    async def command(
        self, targets: Targets, command: str | int, params: Sequence[float | None] = (), **more: Any
    ) -> Outcomes:
        """Any MAV_CMD; None or NaN is an unset parameter. ``more``: int_frame, x, y, z for COMMAND_INT; force."""
        plain = [None if p is None or math.isnan(p) else p for p in params]
        return await self._order("command", targets, command=command, params=plain, **more)

    async def send(
        self, name: str | int, fields: Mapping[str, Any], *, target: Targets | None = None, force: bool = False
    ) -> Any:
        """One message of the dialect, to some vehicles or (without target) to everyone. None is NaN. ``force``: even
        one that does what an order does, without its checks."""
        to = None if target is None else _plain(target)
        return await self.call("messages.send", name=name, fields=dict(fields), target=to, force=force)

    # -- subscriptions

    def telemetry(
        self, targets: Targets = "all", *, rate_hz: float = 2.0, groups: Sequence[str] | None = None
    ) -> Subscription:
        """States as they come, at most ``rate_hz`` (up to 20) per vehicle; only these telemetry ``groups`` if given.

        A slow reader gets each vehicle's newest state, never old ones.
        """
        params = {"targets": _plain(targets), "rate_hz": rate_hz, "names": _listed(groups)}
        return Subscription(self._connected(), self._next_id(), {"topic": "telemetry", **params}, Latest())

    def encoded_telemetry(
        self, targets: Targets = "all", *, rate_hz: float = 2.0, groups: Sequence[str] | None = None
    ) -> Subscription:
        """As `telemetry`, for a program that passes states on: what came together, as the daemon encoded it. Each item
        has ``states`` (JSON by name) and ``complete``: True if no more of this round is on its way."""
        params = {"targets": _plain(targets), "rate_hz": rate_hz, "names": _listed(groups)}
        return Subscription(self._connected(), self._next_id(), {"topic": "telemetry", **params}, Encoded())

    def events(self, targets: Targets = "all", *, kinds: Sequence[str] | None = None) -> Subscription:
        """Events from now on; ``event["dropped"]`` is there if so many before it were lost to slowness."""
        params = {"topic": "events", "targets": _plain(targets), "names": _listed(kinds)}
        return Subscription(self._connected(), self._next_id(), params, Queue("event"))

    def plan(self, *, rate_hz: float = 2.0) -> Subscription:
        """The status of the plan (`plan.status`), after each change and at this rate while it is flown."""
        return Subscription(self._connected(), self._next_id(), {"topic": "plan", "rate_hz": rate_hz}, Newest("plan"))

    def messages(self, *names: str | int, targets: Targets = "all", rate_hz: float | None = None) -> Subscription:
        """Decoded messages of these names (none: all): vehicle, sysid, compid, name, fields, age_s.

        ``rate_hz``: at most so many of each name and source. ``message["dropped"]`` as for events.
        """
        params = {"topic": "messages", "targets": _plain(targets), "rate_hz": rate_hz, "names": _listed(names)}
        return Subscription(self._connected(), self._next_id(), params, Queue("message"))

    # -- private

    async def _order(self, order: str, targets: Targets, **params: Any) -> Outcomes:
        answer = await self.call(f"vehicles.{order}", targets=_plain(targets), **params)
        outcomes: Outcomes = answer["outcomes"]
        return outcomes

    def _connected(self) -> _Wire:
        if self._wire is None:
            raise DaemonUnreachable(self.address, "not connected")
        return self._wire

    def _next_id(self) -> int:
        self._last_id += 1
        return self._last_id


async def _connected_over_tls(address: str, tls: PinnedTls) -> _Wire:
    """A connection to the holder of the pinned certificate. Raises DaemonUnreachable, OSError."""
    from skygcs.rpc.tls import HANDSHAKE_S, SHUTDOWN_S, explain_tls

    host, _, port = address.removeprefix("tls://").rpartition(":")
    try:
        transport, wire = await asyncio.get_running_loop().create_connection(
            lambda: _Wire(address),
            host,
            int(port),
            ssl=tls.context,
            ssl_handshake_timeout=HANDSHAKE_S,
            ssl_shutdown_timeout=SHUTDOWN_S,
        )
    except OSError as error:
        if (reason := explain_tls(error)) is not None:
            raise DaemonUnreachable(address, reason) from None
        raise
    if not tls.is_pinned(transport):
        transport.abort()
        raise DaemonUnreachable(address, "it shows a certificate that the pinned one has issued, not that one itself")
    return wire


async def _connected_to(path: str) -> socket.socket:
    """A Unix socket connected to the daemon's. Its queue of connections may be full for a moment, which
    asyncio mistakes for a connection in progress. Raises OSError."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + CONNECT_WITHIN_S
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        sock.setblocking(False)
        while True:
            try:
                sock.connect(path)
            except BlockingIOError:
                if loop.time() > deadline:
                    raise
                await asyncio.sleep(CONNECT_AGAIN_S)
            else:
                return sock
    except BaseException:
        sock.close()
        raise


class Inbox:
    """What came and was not iterated over yet. Never holds up replies on the same connection."""

    def __init__(self) -> None:
        self._arrived = asyncio.Event()
        self._error: RpcError | None = None

    def put(self, params: dict[str, Any]) -> None:
        self._keep(params)
        self._arrived.set()

    def fail(self, error: RpcError) -> None:
        self._error = error
        self._arrived.set()

    async def get(self) -> dict[str, Any]:
        while not self:
            if self._error is not None:
                raise self._error
            self._arrived.clear()
            await self._arrived.wait()
        return self._take()

    def __bool__(self) -> bool:
        raise NotImplementedError

    def _keep(self, params: dict[str, Any]) -> None:
        raise NotImplementedError

    def _take(self) -> dict[str, Any]:
        raise NotImplementedError


class Latest(Inbox):
    """The newest state of each vehicle; the one that waits longest first."""

    def __init__(self) -> None:
        super().__init__()
        self._by_name: dict[str, dict[str, Any]] = {}

    def __bool__(self) -> bool:
        return bool(self._by_name)

    def _keep(self, params: dict[str, Any]) -> None:
        state = params["state"]
        self._by_name[state["name"]] = state

    def _take(self) -> dict[str, Any]:
        return self._by_name.pop(next(iter(self._by_name)))


class Encoded(Inbox):
    """The newest state of each vehicle as the daemon encoded it: nothing is read but the name."""

    def __init__(self) -> None:
        super().__init__()
        self._by_name: dict[str, bytes] = {}
        self._complete = False

    def __bool__(self) -> bool:
        return bool(self._by_name)

    def put_encoded(self, state: bytes, last: bool) -> None:
        """One state. ``last``: it is the last of its round."""
        begin = _STATE_NAME.match(state)
        name = json.loads(state)["name"] if begin is None else json.loads(begin[1])
        self._by_name[name] = state
        self._complete = last
        self._arrived.set()

    def _keep(self, params: dict[str, Any]) -> None:
        self.put_encoded(json.dumps(params["state"]).encode(), bool(params.get("last")))

    def _take(self) -> dict[str, Any]:
        states, self._by_name = self._by_name, {}
        return {"states": states, "complete": self._complete}


class Newest(Inbox):
    """The newest only."""

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key
        self._content: dict[str, Any] | None = None

    def __bool__(self) -> bool:
        return self._content is not None

    def _keep(self, params: dict[str, Any]) -> None:
        self._content = params[self._key]

    def _take(self) -> dict[str, Any]:
        content, self._content = self._content, None
        assert content is not None  # `get` waits for one
        return content


class Queue(Inbox):
    """In order; the oldest are dropped and counted, as those that the daemon dropped."""

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key
        self._waiting: deque[dict[str, Any]] = deque()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def _keep(self, params: dict[str, Any]) -> None:
        content = params[self._key]
        dropped = params.get("dropped", 0)
        if dropped:
            content["dropped"] = dropped
        if len(self._waiting) >= INBOX:
            lost = 1 + self._waiting.popleft().get("dropped", 0)
            self._waiting[0]["dropped"] = self._waiting[0].get("dropped", 0) + lost
        self._waiting.append(content)

    def _take(self) -> dict[str, Any]:
        return self._waiting.popleft()


class Subscription:
    """What `Client.telemetry`, `events`, `messages` and `plan` give: to be iterated over with ``async for``.

    Subscribed from the moment it is made until `close`, or until nobody holds it any more. The iteration raises
    RpcError if the daemon refused it, DaemonUnreachable if the daemon goes away.
    """

    def __init__(self, wire: _Wire, call_id: int, params: dict[str, Any], inbox: Inbox) -> None:
        self._inbox = inbox
        self._wire = wire
        self._state = state = _SubscriptionState(wire, inbox)
        wire.start(call_id, "subscribe", params, state.on_answer)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> dict[str, Any]:
        return await self._inbox.get()

    def close(self) -> None:
        """Unsubscribe. Idempotent."""
        self._state.close()

    def __del__(self) -> None:
        self._state.close()


class _SubscriptionState:
    """Apart from `Subscription`, so that the answer still due does not keep an abandoned one alive."""

    def __init__(self, wire: _Wire, inbox: Inbox) -> None:
        self._wire = wire
        self._inbox = inbox
        self._number: int | None = None
        self._closed = False

    def on_answer(self, result: Any, error: RpcError | None) -> None:
        """Called before the next line is read: the first notification may be in the same packet."""
        if error is not None:
            self._inbox.fail(error)
            return
        number: int = result["subscription"]
        if self._closed:
            self._wire.notify("unsubscribe", {"subscription": number})
        else:
            self._number = number
            self._wire.inboxes[number] = self._inbox

    def close(self) -> None:
        self._closed = True
        number, self._number = self._number, None
        if number is not None and self._wire.inboxes.pop(number, None) is not None:
            self._wire.notify("unsubscribe", {"subscription": number})


class _Wire(asyncio.Protocol):
    """Lines in and out: finds the call or the subscription that each belongs to."""

    transport: asyncio.Transport

    def __init__(self, address: str) -> None:
        self.inboxes: dict[int, Inbox] = {}
        self.on_progress: Callable[[dict[str, Any]], None] | None = None
        """For notifications plan.progress."""
        self.encoded: set[int] = set()
        """Calls whose result is not to be read."""
        self._address = address
        self._calls: dict[int, _OnAnswer] = {}
        self._partial: list[bytes] = []
        self._partial_bytes = 0
        self._heard = False
        self.closed = asyncio.Event()
        self._lost: DaemonUnreachable | None = None
        self._refused: RpcError | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast(asyncio.Transport, transport)  # uvloop's is one in all but its class
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self._heard = True
        if b"\n" not in data:
            self._partial.append(data)
            self._partial_bytes += len(data)
            if self._partial_bytes > MAX_REPLY_BYTES:
                self._give_up(f"it sent more than {MAX_REPLY_BYTES >> 20} MiB without the end of a line")
            return
        *lines, rest = b"".join([*self._partial, data]).split(b"\n")
        self._partial = [rest]
        self._partial_bytes = len(rest)
        for line in lines:
            if line and self._lost is None and not self._on_encoded(line) and not self._on_encoded_result(line):
                try:
                    self._on_answer(json.loads(line))
                except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
                    self._give_up(f"it sent what is no answer of skygcs ({type(error).__name__})")

    def _give_up(self, reason: str) -> None:
        """Close the connection because of what came."""
        self._partial.clear()
        self.lose(reason)
        self.transport.abort()

    def _on_encoded(self, line: bytes) -> bool:
        """True for a state that goes on as it is. Anything written otherwise than here expected is read as JSON."""
        if not line.startswith(_TELEMETRY):
            return False
        state, _, tail = line.rpartition(b',"subscription":')
        number, comma, last = tail.removesuffix(b"}}").partition(b",")
        inbox = self.inboxes.get(int(number)) if number.isdigit() and len(number) < MAX_NUMBER_CHARS else None
        if not isinstance(inbox, Encoded) or not state.endswith(b"}") or (comma and last != b'"last":true'):
            return False
        inbox.put_encoded(state[len(_TELEMETRY) :], bool(comma))
        return True

    def _on_encoded_result(self, line: bytes) -> bool:
        """True for a result that goes on as it is; an error, and anything written otherwise, is read as JSON."""
        begin = _RESULT.match(line) if self.encoded else None
        if begin is None or (number := int(begin[1])) not in self.encoded or not line.endswith(b"}"):
            return False
        on_answer = self._calls.pop(number, None)
        if on_answer is not None:
            on_answer(line[begin.end() : -1], None)
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        reason = "it closed the connection"
        if self._address.startswith("tls://") and not self._heard:  # asyncio's server closes without an alert
            reason += " before its first answer: has it pinned our ground.crt? (there: skygcs companion pin ground.crt)"
        self.lose(reason)
        self.closed.set()

    @property
    def is_open(self) -> bool:
        return self._lost is None

    def lose(self, reason: str) -> None:
        """End every waiting call and subscription with the reason. Idempotent."""
        if self._lost is None:
            self._lost = DaemonUnreachable(self._address, reason)
        error = self._refused or self._lost
        calls, self._calls = self._calls, {}
        for on_answer in calls.values():
            on_answer(None, error)
        for inbox in self.inboxes.values():
            inbox.fail(error)
        self.inboxes.clear()

    def start(
        self,
        number: int,
        method: str,
        params: dict[str, Any],
        on_answer: _OnAnswer,
        members: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        """Send a request with further ``members``; ``on_answer(result, error)`` is called once.

        Raises RpcError for a request that is too long for the daemon, DaemonUnreachable."""
        if self._lost is not None:
            raise self._lost
        request = {"jsonrpc": "2.0", "id": number, "method": method, "params": params, **members}
        line = json.dumps(request, allow_nan=False).encode()
        if len(line) > MAX_REQUEST_BYTES:
            text = f"{method[:40]}: {len(line)} bytes; the daemon takes {MAX_REQUEST_BYTES} in one request"
            raise RpcError(INVALID_PARAMS, text)
        self._calls[number] = on_answer
        self.transport.write(line + b"\n")

    def notify(self, method: str, params: dict[str, Any]) -> None:
        if self._lost is None:
            self.transport.write(json.dumps({"jsonrpc": "2.0", "method": method, "params": params}).encode() + b"\n")

    def _on_answer(self, answer: dict[str, Any]) -> None:
        if "method" in answer:
            params = answer["params"]
            if answer["method"] == PROGRESS:
                if self.on_progress is not None:
                    self.on_progress(params)
                return
            inbox = self.inboxes.get(params["subscription"])
            if inbox is not None:
                inbox.put(params)
            return
        error = answer.get("error")
        failure = None if error is None else RpcError(error["code"], error["message"], error.get("data"))
        number = answer.get("id")
        if number is None:
            self._refused = failure  # not about one call: "too many clients", a wrong token; the end follows
            return
        on_answer = self._calls.pop(number, None)
        if on_answer is not None:
            on_answer(answer.get("result"), failure)


def _owner_of(address: str) -> str | None:
    """The other user that a socket, or the folder that hides it, belongs to; None if it is the caller's own."""
    path = Path(address)
    for place in (path, *path.parents):
        try:
            uid = place.stat().st_uid
        except OSError:
            continue  # hidden by a folder above
        if uid == os.geteuid():
            return None
        try:
            return pwd.getpwuid(uid).pw_name
        except KeyError:
            return f"user {uid}"
    return None


def _plain(targets: Targets) -> str | int | list[str | int]:
    return targets if isinstance(targets, str | int) else list(targets)


def _listed(names: Sequence[str | int] | None) -> list[str | int] | None:
    return list(names) if names else None
