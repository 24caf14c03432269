"""Asyncio client of a running skygcs daemon.

    from skygcs.rpc.client import connect

    async with connect() as gcs:                          # the default socket, or a path, or tcp://127.0.0.1:PORT
        outcomes = await gcs.arm("all")                   # {"alpha": {"ok": true, "result": "accepted", ...}, ...}
        await gcs.takeoff("alpha", 5)
        async for state in gcs.telemetry("alpha", rate_hz=5):
            print(state["position"]["alt_rel_m"])
        async for vehicle, outcome in gcs.outcomes("vehicles.stop", targets="all"):  # each as it comes
            print(vehicle, outcome["message"])

Every method of docs/reference/rpc.md can be called by name: ``await gcs.call("vehicles.arm", targets="all")``.
An error answer is raised as RpcError (``code``, ``message``, ``data``), a daemon that is not there or goes away as
DaemonUnreachable; the caller decides whether to connect again. A cancelled call is no longer waited for, but the order
may have been sent; closing the connection cancels what the daemon still does for it, except land, rtl, hold and disarm,
which are carried out to their end. One client belongs to one loop.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any, Literal, Self

from skygcs.errors import DaemonUnreachable
from skygcs.rpc.address import client_address
from skygcs.rpc.client_connection import ClientConnection, ClientTls, OnReport, Subscription, open_connection
from skygcs.rpc.client_inbox import Encoded, Latest, Newest, Queue
from skygcs.rpc.json_lines import BEGUN

Targets = str | int | Sequence[str | int]
Outcomes = dict[str, dict[str, Any]]
"""By vehicle name: ok, result, message, attempts, elapsed_s, status_texts. Orders never raise for a vehicle's "no"."""

TrajectoryOrder = Literal["start", "pause", "resume", "speed", "abort", "unload"]


UPLOAD_ABOVE_CHARS = 900_000
"""Length of a plan's text above which it is uploaded in parts: a line of the socket has 1 MiB, with the rest of the
request."""

PART_CHARS = 400_000
"""Length of one part in plan.upload."""

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
    "corrections",
    "companion",
    "ground_lost",
    "federation",
    "unattended",
    "takeoff",
    "alarm",
    "uplink_lost",
    "uplink_back",
    "warning",
    "fault",
)
"""Kinds of events, for `Client.events` and events.recent."""


def connect(address: str | os.PathLike[str] | None = None, *, token: str | None = None) -> Client:
    """A client for ``async with``. Default address: $SKYGCS_SOCKET, else the user's own socket.

    ``address`` is a path or ``tcp://HOST:PORT``; TCP needs the daemon's ``token``. Entering raises DaemonUnreachable.
    """
    return Client(client_address(address), token)


class Client:
    """A connection; made by `connect`. Usable from many tasks of one loop."""

    def __init__(self, address: str, token: str | None = None, tls: ClientTls | None = None) -> None:
        self.address = address
        self._token = token
        self._tls = tls
        self._connection: ClientConnection | None = None

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Connect. Raises DaemonUnreachable, and RpcError for a wrong token."""
        self._connection = await open_connection(self.address, self._tls)
        if self._token is not None and self.address.startswith("tcp://"):
            await self.call("auth", token=self._token)

    @property
    def connected(self) -> bool:
        """True if the connection is open, as far as is known here: a call then is really sent."""
        return self._connection is not None and self._connection.is_open

    async def close(self) -> None:
        """Close; calls and iterations still waiting end with DaemonUnreachable. Idempotent."""
        connection, self._connection = self._connection, None
        if connection is not None:
            await connection.close()

    def unanswered(self) -> list[tuple[str, Mapping[str, Any]]]:
        """Method and parameters of the requests that were sent and have no answer yet, also if nothing waits for it any
        more: for a program that was interrupted, and says what it leaves."""
        return [] if self._connection is None else self._connection.unanswered()

    async def call(self, method: str, /, **params: Any) -> Any:
        """The result of one method. Raises RpcError, DaemonUnreachable, and ValueError for what JSON cannot carry."""
        return await self._connected().request(method, params)

    async def call_by(self, deadline_s: float | None, method: str, /, **params: Any) -> Any:
        """`call`; a daemon that reads it after ``deadline_s`` of its own clock (now_s of daemon.info) refuses it."""
        return await self._connected().request(method, params, _until(deadline_s))

    async def order(
        self,
        method: str,
        /,
        *,
        on_outcome: Callable[[str, dict[str, Any]], None],
        on_vehicles: Callable[[list[str]], None] = lambda vehicles: None,
        **params: Any,
    ) -> Outcomes:
        """An order by its method ("vehicles.stop"): ``on_outcome(vehicle, outcome)`` is called for each vehicle as its
        outcome comes, and before that ``on_vehicles`` with the names of all; at a station once for ours and once for
        those of other sites. Returns all outcomes. Raises as
        `call`."""
        ended: set[str] = set()

        def on_report(kind: str, report: dict[str, Any]) -> None:
            if kind == BEGUN:
                on_vehicles(report["vehicles"])
            else:
                ended.add(report["vehicle"])
                on_outcome(report["vehicle"], report["outcome"])

        outcomes: Outcomes = (await self._connected().request(method, params, on_report=on_report))["outcomes"]
        for vehicle, outcome in outcomes.items():
            if vehicle not in ended:  # a daemon of an earlier version, or a report that was left out
                on_outcome(vehicle, outcome)
        return outcomes

    async def outcomes(self, method: str, /, **params: Any) -> AsyncIterator[tuple[str, dict[str, Any]]]:
        """An order by its method, for ``async for vehicle, outcome in gcs.outcomes("vehicles.stop", targets="all")``:
        each vehicle's outcome as it comes. Raises as `call`. Ended early, the order is as a cancelled call."""
        queue: asyncio.Queue[tuple[str, dict[str, Any]] | None] = asyncio.Queue()  # one entry for each vehicle

        def on_outcome(vehicle: str, outcome: dict[str, Any]) -> None:
            queue.put_nowait((vehicle, outcome))

        order = asyncio.create_task(self.order(method, on_outcome=on_outcome, **params), name=method)
        order.add_done_callback(lambda _: queue.put_nowait(None))
        try:
            while (item := await queue.get()) is not None:
                yield item
            order.result()
        finally:
            order.cancel()

    async def relay(
        self,
        method: str,
        params: dict[str, Any],
        deadline_s: float | None = None,
        on_report: OnReport | None = None,
    ) -> bytes:
        """The result as the daemon encoded it, for a program that passes it on: a list of parameters has megabytes.

        A daemon that reads the request after ``deadline_s`` of its own clock (now_s of daemon.info) refuses it.
        ``on_report`` gets the method and parameters of each report of an order, too.
        """
        result = await self._connected().request(method, params, _until(deadline_s), encoded=True, on_report=on_report)
        return result if isinstance(result, bytes) else json.dumps(result).encode()

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

    async def hold(self, targets: Targets, *, instead_of: int | None = None) -> Outcomes:
        """Stop, and stay there. ``instead_of``: the order_number of an order that this ends; refused if a newer one
        moves the vehicle, or may."""
        return await self._order("hold", targets, **({} if instead_of is None else {"instead_of": instead_of}))

    async def mode(self, targets: Targets, mode: str, *, force: bool = False) -> Outcomes:
        """By the autopilot's own name: "AUTO.LOITER" (PX4), "GUIDED" (ArduCopter)."""
        return await self._order("mode", targets, mode=mode, force=force)

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
        connection = self._connected()
        connection.on_progress = on_progress
        try:
            answer: dict[str, Any] = await self.call(method, progress=on_progress is not None, **params)
        finally:
            connection.on_progress = None
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
        return Subscription(self._connected(), {"topic": "telemetry", **params}, Latest())

    def encoded_telemetry(
        self, targets: Targets = "all", *, rate_hz: float = 2.0, groups: Sequence[str] | None = None
    ) -> Subscription:
        """Iterate like `telemetry`, for a program that passes states on: what came together, as the daemon encoded it.
        Each item has ``states`` (JSON by name) and ``complete``: True if no more of this round is on its way."""
        params = {"targets": _plain(targets), "rate_hz": rate_hz, "names": _listed(groups)}
        return Subscription(self._connected(), {"topic": "telemetry", **params}, Encoded())

    def events(self, targets: Targets = "all", *, kinds: Sequence[str] | None = None) -> Subscription:
        """Events from now on; ``event["dropped"]`` is there if so many before it were lost to slowness."""
        params = {"topic": "events", "targets": _plain(targets), "names": _listed(kinds)}
        return Subscription(self._connected(), params, Queue("event"))

    def plan(self, *, rate_hz: float = 2.0) -> Subscription:
        """The status of the plan (`plan.status`), after each change and at this rate while it is flown."""
        return Subscription(self._connected(), {"topic": "plan", "rate_hz": rate_hz}, Newest("plan"))

    def messages(self, *names: str | int, targets: Targets = "all", rate_hz: float | None = None) -> Subscription:
        """Decoded messages of these names (none: all): vehicle, sysid, compid, name, fields, age_s.

        ``rate_hz``: at most so many of each name and source. ``message["dropped"]`` as for events.
        """
        params = {"topic": "messages", "targets": _plain(targets), "rate_hz": rate_hz, "names": _listed(names)}
        return Subscription(self._connected(), params, Queue("message"))

    # -- private

    async def _order(self, order: str, targets: Targets, **params: Any) -> Outcomes:
        answer = await self.call(f"vehicles.{order}", targets=_plain(targets), **params)
        outcomes: Outcomes = answer["outcomes"]
        return outcomes

    def _connected(self) -> ClientConnection:
        if self._connection is None:
            raise DaemonUnreachable(self.address, "not connected")
        return self._connection


def _until(deadline_s: float | None) -> dict[str, float]:
    """Members of a request that the daemon carries out by this time of its clock; None: whenever it is read."""
    return {} if deadline_s is None else {"deadline_s": deadline_s}


def _plain(targets: Targets) -> str | int | list[str | int]:
    return targets if isinstance(targets, str | int) else list(targets)


def _listed(names: Sequence[str | int] | None) -> list[str | int] | None:
    return list(names) if names else None
