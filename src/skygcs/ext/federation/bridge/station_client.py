"""One client of the station socket: which of its requests the daemon answers, which this process, and which both.

    a request                                                  is answered by
    ---------------------------------------------------------  --------------------------------------------------------
    federation.*                                               this process (`station_methods`)
    vehicles.list, vehicles.get, subscribe telemetry|events    both: the daemon for own vehicles, this process for those
      with targets south/…, */all or "all sites"               of other sites; one answer, one subscription
    an order with such targets                                 both: the home site of each vehicle carries out its part
    any request with targets own-site/…                        the daemon, which gets the plain targets
    another method with targets of other sites                 an error
    rpc.discover                                               both
    everything else                                            the daemon, which gets the line unchanged

A batch (a JSON array) goes to the daemon unchanged, or is refused if it names other sites.

    the daemon                 its clients here
    -------------------------  -----------------------------------------------------------------------------------------
    answers                    as above
    is away when a client      get the answers of this process: other sites, an empty list of own vehicles; orders to
    connects                   own vehicles are refused
    ends while a client is     are closed, like the daemon's own clients, and connect again
    connected

A client that does not read is not read from; it gets fewer states, and is closed beyond MAX_OUTPUT_BYTES.
"""

from __future__ import annotations

import asyncio
import pwd
from collections import Counter
from collections.abc import Awaitable, Coroutine, Mapping, Sequence
from typing import Any, Protocol

import structlog
from pydantic import ValidationError

from skygcs.errors import RefusedError, RpcError, SkygcsError, TargetError
from skygcs.ext.federation.bridge.relayed_daemon import RelayedDaemon
from skygcs.ext.federation.bridge.remote_feed import RemoteSubscription
from skygcs.ext.federation.bridge.station_services import StationServices
from skygcs.ext.federation.protocol.order_messages import ENDS_FLIGHT, STOP
from skygcs.ext.federation.protocol.site_names import SiteTargets, split_by_site
from skygcs.rpc import dispatch, error_codes
from skygcs.rpc.address import tcp_address
from skygcs.rpc.client_peer import ClientPeer
from skygcs.rpc.dispatch import Dispatcher, Method, document, failure_reply, result_reply
from skygcs.rpc.json_lines import MAX_LINE_BYTES, OrderReports, id_of, wants_reports
from skygcs.rpc.replies import encode, error_reply, parse, parse_request, unread

MAX_IN_FLIGHT = 64
"""Requests of one client in progress, as at the daemon."""

MAX_HELD_BYTES = 4 * MAX_LINE_BYTES
"""Lines that wait until the daemon is reached; beyond, the client is not read."""

MAX_LASTING = 256
"""Orders that end a flight and outlive their client, as at the daemon; further ones are cancelled with it."""

RESERVE_S = 2.0
"""How long a client beyond the places stays connected."""

ONLY_OTHERS = ("site", "age_s", "lease")
"""Keys of states of other sites that a daemon's state does not have."""

OWN_NUMBERS = 1_000_000
"""First number of subscriptions without a part at the daemon, whose own numbers begin with 1."""

MAX_SUBSCRIPTIONS = 32
"""Subscriptions of one client with vehicles of other sites."""

LIST = "vehicles.list"

_MARKS = (b"/", b"*", b"federation.", b"all sites", b"rpc.discover", b"\\")
"""A line without any of these cannot concern another site: it is passed to the daemon without parsing."""

_TOO_MANY = f"{MAX_IN_FLIGHT} requests of this client are not finished yet"

_log = structlog.get_logger(__name__)


class Station(Protocol):
    """The part of `StationSocket` that its clients use."""

    services: StationServices
    counters: Counter[str]
    clients: dict[StationClient, None]
    methods: dict[str, Method[StationClient]]
    """The methods federation.*."""
    dispatcher: Dispatcher[StationClient]
    lasting: set[asyncio.Task[Any]]
    """Orders that end a flight; they outlive their client."""
    full_text: str

    def admit(self, client: StationClient) -> bool:
        """True if a new client has a place; if not, it has been sent an error."""
        ...


class StationClient(ClientPeer):
    """One client of the station, with its connection to the daemon. The context of the station's own methods."""

    def __init__(self, station: Station) -> None:
        super().__init__(station.counters, "client of the station")
        self.station = station
        self.services = station.services
        self.restricted = False
        """True if it connected when all places were taken."""
        self.used_at = asyncio.get_running_loop().time()
        """Time of the last line in either direction."""
        self.daemon = RelayedDaemon(self, station.services.daemon_address, station.services.daemon_token)
        self._reached = False
        """True when it is known whether the daemon answers; lines wait until then."""
        self._eof_passed_on = False
        self._tasks: set[asyncio.Task[None]] = set()
        self._lasting: set[asyncio.Task[None]] = set()
        """The tasks of `Station.lasting` that belong to this client."""
        self._subscriptions: dict[int, RemoteSubscription] = {}
        self._next_number = OWN_NUMBERS

    # -- asyncio.Protocol and ClientPeer

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if not self.station.admit(self):
            self.end()
            return
        if self.restricted:
            asyncio.get_running_loop().call_later(RESERVE_S, self._end_reserve)
        self._run(self._reach_daemon(), "reach daemon")

    def received(self) -> None:
        if self._reached:
            self._read_lines()
            self._close_if_done()
        self._pace()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._reached or not self._lines:
            self.end()
        else:  # its lines are still read: an order that outlives its client is carried out, as at the daemon
            self._eof = True

    def pause_writing(self) -> None:
        self.writable = False
        self.daemon.pause_answers()
        self._pace()

    def resume_writing(self) -> None:
        self.writable = True
        self.daemon.resume_answers()
        for subscription in self._subscriptions.values():
            self.services.feed.resume(subscription)
        if self._reached:
            self._read_lines()
        self._pace()

    def _pace(self) -> None:
        self.pace_reading(wait=self.daemon.full or len(self._lines) > MAX_HELD_BYTES)

    @property
    def busy(self) -> bool:
        """True while a request with other sites has no answer yet."""
        return bool(self._tasks or self._lasting)

    def _end_reserve(self) -> None:
        if self._transport is not None and not self.busy:
            self._hang_up()

    # -- for methods and subscriptions

    @property
    def user(self) -> str:
        """The name of the user that runs the client, "unknown" if the kernel does not report it."""
        found = self.credentials
        try:
            return "unknown" if found is None else pwd.getpwuid(found.uid).pw_name
        except KeyError:
            return "unknown"

    def write(self, data: bytes) -> None:
        self.used_at = asyncio.get_running_loop().time()
        super().write(data)

    # -- the daemon

    async def _reach_daemon(self) -> None:
        if not await self.daemon.reach():
            self.station.counters["without_daemon"] += 1
        if self._transport is None:
            self.daemon.close()
            return
        self._reached = True
        self._read_lines()
        if self._transport is not None and self._transport.is_closing():
            self.end()
        self._pace()
        self._close_if_done()

    def on_daemon_lines(self, lines: bytes) -> None:
        if lines:
            self.write(lines)

    def on_daemon_full(self, full: bool) -> None:
        if not full and self._reached:
            self._read_lines()
        self._pace()

    def on_daemon_lost(self) -> None:
        if self._reached:
            asyncio.get_running_loop().call_soon(self._hang_up)  # after the answers

    # -- lines

    def _read_lines(self) -> None:
        while self._transport is not None and self.writable and not self.daemon.full:
            if (line := self.next_line(MAX_LINE_BYTES)) is None:
                return
            self._on_line(line)

    def _on_line(self, line: bytes) -> None:
        self.station.counters["lines"] += 1
        self.used_at = asyncio.get_running_loop().time()
        concerns = (
            self.restricted or any(mark in line for mark in _MARKS) or (self._subscriptions and b"unsubscribe" in line)
        )
        if not concerns and self.daemon.write(line):
            return
        try:
            request = parse_request(line)
        except ValueError as error:
            self._to_daemon(line, error_reply(None, *unread(error)))
            return
        try:
            self._on_request(request, line)
        except (SkygcsError, ValidationError) as error:
            if isinstance(request, dict) and "id" in request:
                self.reply(failure_reply(id_of(request), str(request.get("method")), error))

    def _to_daemon(self, line: bytes, otherwise: bytes) -> None:
        if not self.daemon.write(line):
            self.reply(otherwise)

    def _on_request(self, request: Any, line: bytes) -> None:
        """Handle one request. Raises SkygcsError and ValidationError, which the caller answers."""
        if isinstance(request, list):
            if self.restricted or any(self._concerns_others(one) for one in request):
                text = "a batch cannot name other sites; send these requests one by one"
                self.reply(error_reply(None, error_codes.INVALID_REQUEST, text))
                return
            self._to_daemon(line, error_reply(None, error_codes.NO_DAEMON, self.daemon.absent))
            return
        method = request.get("method") if isinstance(request, dict) else None
        params = request.get("params") if isinstance(request, dict) else None
        if self.restricted and method != LIST and method not in ENDS_FLIGHT:
            answered = ", ".join(sorted({*ENDS_FLIGHT, LIST}))
            text = f"{self.station.full_text}; only {answered} are answered all the same"
            self.reply(error_reply(id_of(request), error_codes.LIMIT_EXCEEDED, text))
        elif not isinstance(method, str):
            self._to_daemon(line, error_reply(None, error_codes.INVALID_REQUEST, "a request is a JSON object"))
        elif method.startswith("federation."):
            self._answer_here(request)
        elif method == "unsubscribe" and isinstance(params, dict) and params.get("subscription") in self._subscriptions:
            self._unsubscribe(request, line, params["subscription"])
        elif method == "rpc.discover":
            self._answer(request, self._discover(), "discover")
        else:
            self._by_targets(request, line, method, params)

    def _by_targets(self, request: dict[str, Any], line: bytes, method: str, params: Any) -> None:
        key = next((k for k in ("targets", "target") if isinstance(params, dict) and k in params), None)
        targets = None if key is None else self._split(params[key])
        if targets is None or not targets.changed:
            self._own(request, line, method)
        elif not targets.others and not targets.every:
            own: Any = list(targets.own) if key == "targets" else ",".join(targets.own)
            self._own({**request, "params": {**params, key: own}}, None, method)
        elif method == LIST:
            self._answer(request, self._list(targets), "list")
        elif method == "vehicles.get":
            self._answer(request, self._get(targets), "get")
        elif method == "subscribe" and params.get("topic") in ("telemetry", "events"):
            self._subscribe(request, targets)
        elif self.services.orders is not None and method in self.services.orders.methods:
            rest = {name: value for name, value in params.items() if name != key}
            members = {"deadline_s": request["deadline_s"]} if "deadline_s" in request else {}
            asked = wants_reports(request)
            reports = None if asked is None else OrderReports(self, asked)
            work = self._order(method, rest, targets, members, reports)
            self._answer(request, work, "order", lasting=method in ENDS_FLIGHT)
        else:
            raise RefusedError(f"{method} does not go to other sites; give vehicles of this one")

    def _split(self, expression: Any) -> SiteTargets | None:
        if isinstance(expression, bool) or not isinstance(expression, str | int | list):
            return None
        if isinstance(expression, list) and not all(isinstance(part, str | int) for part in expression):
            return None
        try:
            return split_by_site(expression, self.services.site, self.services.site_names())
        except TargetError as error:
            if "/" not in str(expression) and "*" not in str(expression):
                return None  # the daemon reports the error itself
            problem = self.services.hub_problem()
            raise TargetError(str(error) if problem is None else f"{error}; {problem}") from None

    def _concerns_others(self, request: Any) -> bool:
        if not isinstance(request, dict) or not isinstance(request.get("params"), dict):
            return False
        method, params = str(request.get("method")), request["params"]
        if method == "unsubscribe":
            return params.get("subscription") in self._subscriptions
        targets = self._split(params.get("targets", params.get("target")))
        return method.startswith("federation.") or (targets is not None and targets.changed)

    # -- answers

    def _own(self, request: dict[str, Any], line: bytes | None, method: str) -> None:
        """Pass a request to the daemon, or answer it here while the daemon is away. ``line``: the request as received;
        None: it was changed."""
        if self.daemon.write(encode(request) if line is None else line):
            return
        result = self._result_without_daemon(method, request.get("params"))
        if "id" not in request:
            return
        if result is None:
            self.reply(error_reply(id_of(request), error_codes.NO_DAEMON, self.daemon.absent))
        else:
            self.reply(result_reply(id_of(request), method, result))

    def _result_without_daemon(self, method: str, params: Any) -> Any:
        """The result of a request that a page or `skygcs-cli status` sends to any daemon; None for other requests."""
        match method:
            case "daemon.info":
                return self.services.info()
            case "operator.relay" | "operator.active":
                return {"ok": True}
            case "events.recent":
                return self.services.recent_events()
            case "vehicles.list" | "components.list" | "links.list":
                everything = not isinstance(params, dict) or params.get("targets", "all") in ("all", ["all"])
                return [] if everything else None
            case "subscribe":
                return {"subscription": self._new_number()}
            case "unsubscribe":
                return params if isinstance(params, dict) else None
        return None

    def _answer_here(self, request: dict[str, Any]) -> None:
        """Answer one of the methods federation.*."""
        if len(self._tasks) >= MAX_IN_FLIGHT:
            self.reply(error_reply(id_of(request), error_codes.LIMIT_EXCEEDED, _TOO_MANY))
            return
        reply = self.station.dispatcher.start(self, request)
        if isinstance(reply, bytes):
            self.reply(reply)
        elif isinstance(reply, Coroutine):

            async def answer() -> None:
                self.reply(await reply)

            self._run(answer(), "own method", reply)

    def _answer(
        self, request: dict[str, Any], work: Coroutine[Any, Any, Any], what: str, *, lasting: bool = False
    ) -> None:
        """Reply with the result of ``work``, an `Encoded` or JSON-able, when it ends. ``lasting``: it outlives the
        client."""
        request_id, method = id_of(request), str(request.get("method"))
        if len(self._tasks) + len(self._lasting) >= MAX_IN_FLIGHT:
            work.close()
            self.reply(error_reply(request_id, error_codes.LIMIT_EXCEEDED, _TOO_MANY))
            return

        async def answer() -> None:
            try:
                reply = result_reply(request_id, method, await work)
            except Exception as error:
                reply = failure_reply(request_id, method, error)
            if "id" in request:
                self.reply(reply)

        self._run(answer(), what, work, lasting=lasting)

    def _run(
        self,
        work: Coroutine[Any, Any, None],
        what: str,
        inner: Coroutine[Any, Any, Any] | None = None,
        *,
        lasting: bool = False,
    ) -> None:
        """Run ``work`` in a task of this client. ``inner``: a coroutine that ``work`` awaits, closed if the task never
        begins."""
        task = asyncio.get_running_loop().create_task(work, name=f"station {what}")
        if lasting and len(self.station.lasting) < MAX_LASTING:
            self.station.lasting.add(task)
            self._lasting.add(task)
        else:
            self._tasks.add(task)

        def done(task: asyncio.Task[None]) -> None:
            for owner in (self._tasks, self._lasting, self.station.lasting):
                owner.discard(task)
            if self._transport is None and not self._lasting:
                self.daemon.close()
            if inner is not None:
                inner.close()  # of a task that was cancelled before it began
            if not task.cancelled() and (error := task.exception()) is not None:
                _log.error("request of a client of the station failed", exc_info=error)
            self._close_if_done()

        task.add_done_callback(done)

    async def _discover(self) -> dict[str, Any]:
        own = document(self.station.methods.values())
        if not self.daemon.connected:
            return own
        whole: dict[str, Any] = parse(await self.daemon.ask("rpc.discover", {}))
        whole["methods"] += own["methods"]
        whole["components"]["schemas"].update(own["components"]["schemas"])
        return whole

    async def _list(self, targets: SiteTargets) -> dispatch.Encoded:
        others = self.services.states(targets.others)
        parts = [encode(others)[1:-1]]
        if targets.own and self.daemon.connected:
            parts.insert(0, (await self.daemon.ask("vehicles.list", {"targets": _plain(targets.own)}))[1:-1])
        return dispatch.Encoded(b"[" + b",".join(part for part in parts if part) + b"]")

    async def _get(self, targets: SiteTargets) -> dict[str, Any]:
        if targets.own or len(targets.others) != 1 or len(next(iter(targets.others.values()))) != 1:
            raise TargetError("vehicles.get has one vehicle; give one")
        ((site, (target,)),) = targets.others.items()
        return await self.services.full_state(site, target)

    async def _order(
        self,
        method: str,
        params: Mapping[str, Any],
        targets: SiteTargets,
        members: Mapping[str, Any],
        reports: OrderReports | None,
    ) -> dict[str, Any]:
        """Carry out both parts and return their outcomes. An error of one part becomes the outcome of its targets,
        since the other part has been carried out."""
        orders = self.services.orders
        assert orders is not None
        self._check_deadline(members)
        own: Sequence[str] = targets.own if self.daemon.connected else ()
        if targets.own and not own and not targets.every:
            raise RpcError(error_codes.NO_DAEMON, self.daemon.absent)
        own_params = params
        if own and targets.others:
            if method == STOP and params.get("action") == "kill":  # one word for the vehicles of all sites
                own = [state["name"] for state in parse(await self.daemon.ask("vehicles.list", {"targets": own}))]
                own_params = {**params, "confirm": f"kill-{len(own)}"}
            orders.check(method, params, targets.others, own)
        parts: dict[str, Awaitable[dict[str, Any]]] = {}
        if targets.others:
            name = ", ".join(f"{site}/{part}" for site, found in targets.others.items() for part in found)
            parts[name] = orders.give(method, params, targets.others, self.user, len(own), reports)
        if own:
            parts[", ".join(targets.own)] = self._order_own(method, own_params, own, members, reports)
        elif targets.own and self.services.daemon_address is not None:  # our daemon is away: an error as its outcome
            parts[", ".join(targets.own)] = self._order_own(method, own_params, targets.own, members, reports)
        answers = await asyncio.gather(*parts.values(), return_exceptions=True)
        if errors := [answer for answer in answers if isinstance(answer, BaseException)]:
            for error in errors:
                if len(errors) == len(parts) or not isinstance(error, SkygcsError):
                    raise error
        outcomes: dict[str, Any] = {}
        for name, answer in zip(parts, answers, strict=True):
            outcomes |= {name: _failed(answer)} if isinstance(answer, BaseException) else answer
        return {"outcomes": outcomes}

    def _check_deadline(self, members: Mapping[str, Any]) -> None:
        """Raises RefusedError for a request that was read after its deadline. A deadline refers to the daemon's clock,
        which is that of this process only on the same computer: with a daemon over TCP it is not checked here."""
        deadline_s = members.get("deadline_s")
        if deadline_s is None or tcp_address(self.services.daemon_address or "") is not None:
            return
        late_s = asyncio.get_running_loop().time() - deadline_s if isinstance(deadline_s, int | float) else 0.0
        if late_s > 0.0:
            raise RefusedError(f"read {late_s:.1f} s after its deadline; it was not carried out")

    async def _order_own(
        self,
        method: str,
        params: Mapping[str, Any],
        own: Sequence[str],
        members: Mapping[str, Any],
        reports: OrderReports | None,
    ) -> dict[str, Any]:
        asked = None if reports is None else reports.request_id
        answer = parse(await self.daemon.ask(method, {**params, "targets": _plain(own)}, report_as=asked, **members))
        outcomes: dict[str, Any] = answer["outcomes"]
        return outcomes

    # -- subscriptions

    def _new_number(self) -> int:
        self._next_number += 1
        return self._next_number

    def _subscribe(self, request: dict[str, Any], targets: SiteTargets) -> None:
        """Subscribe at the daemon, at the other sites, or both; the answer is sent before the first notification.
        Raises SkygcsError and ValidationError."""
        if len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
            raise dispatch.LimitExceeded(f"at most {MAX_SUBSCRIPTIONS} subscriptions per client; unsubscribe some")
        params = request["params"]
        subscription = self.services.feed.checked(self, params, targets)

        def begin(result: bytes | RpcError) -> bytes:
            if isinstance(result, RpcError):
                return failure_reply(id_of(request), "subscribe", result) + b"\n"
            number = subscription.number = int(parse(result)["subscription"])
            self._subscriptions[number] = subscription
            asyncio.get_running_loop().call_soon(self._begin_feed, subscription)
            reply = result_reply(id_of(request), "subscribe", {"subscription": number})
            return reply + b"\n" if "id" in request else b""

        if targets.own and self.daemon.connected:
            own = {**params, "targets": _plain(targets.own)}
            if params["topic"] == "telemetry" and isinstance(names := params.get("names"), list):
                own["names"] = [name for name in names if name not in ONLY_OTHERS] or ["connected"]
            self.daemon.start_asking("subscribe", own, {}, begin)
        else:
            self.write(begin(encode({"subscription": self._new_number()})))

    def _begin_feed(self, subscription: RemoteSubscription) -> None:
        if self._subscriptions.get(subscription.number) is subscription:
            self.services.feed.add(subscription)

    def _unsubscribe(self, request: dict[str, Any], line: bytes, number: int) -> None:
        self.services.feed.remove(self._subscriptions.pop(number))
        if number < OWN_NUMBERS and self.daemon.write(line):
            return
        if "id" in request:
            self.reply(result_reply(id_of(request), "unsubscribe", {"subscription": number}))

    # -- the end

    def _close_if_done(self) -> None:
        """After the client's end of file: pass it to the daemon, which closes when it has answered everything."""
        if not self._eof or self.busy or self._transport is None or self._lines or not self._reached:
            return
        if self.daemon.connected:
            if not self._eof_passed_on:
                self._eof_passed_on = True
                self.daemon.write_eof()
        elif not self._subscriptions:
            self._hang_up()

    def _hang_up(self) -> None:
        """Close after everything written has been sent."""
        transport = self._transport
        if transport is not None:
            transport.close()
        self.end()

    def end(self) -> None:
        """End this client: close its connections and cancel its requests, except orders that end a flight.
        Idempotent."""
        transport, self._transport = self._transport, None
        self.station.clients.pop(self, None)
        if not self._lasting:  # their part for own vehicles uses that connection
            self.daemon.close()
        for subscription in self._subscriptions.values():
            self.services.feed.remove(subscription)
        self._subscriptions.clear()
        for task in list(self._tasks):
            task.cancel()
        self._lines.clear()
        if transport is not None:
            transport.close()


def _plain(parts: Sequence[str]) -> str | list[str]:
    return parts[0] if len(parts) == 1 else list(parts)


def _failed(error: BaseException) -> dict[str, Any]:
    """The outcome of targets for which an order ended with this error."""
    return {
        "ok": False,
        "result": "refused",
        "message": str(error),
        "attempts": 0,
        "elapsed_s": 0.0,
        "status_texts": [],
    }
