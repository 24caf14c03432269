"""Gives orders to vehicles of other sites: one request for each vehicle, sent once, and one outcome for each.

    an order is    event                                                                  status that is shown
    ------------   --------------------------------------------------------------------   ------------------------------
    not sent       no connection to the hub, or the site does not answer a ping           refused
    sent           an answer within FIRST_ANSWER_S of the beginning                       the one of the answer
                   no answer, or the hub finds no subscriber                              unknown
    running        the site is asked for the outcome until the order has ended            the outcome
                   no answer for ANSWER_SILENT_S                                                 unknown

The deadline of an order is the moment at which this station stops waiting for the first answer, converted to the
site's clock: an order that is shown as unknown is not begun after that, except an emergency stop, which the site
accepts 5 s longer. The clocks that are compared run while a computer sleeps, so that no comparison is wrong afterwards.
No order is sent twice. `outcome` asks for the outcome of an order whose answer was lost; the site refuses an order that
arrives after that question.

Each order begins with a ping, which compares the clocks. If the hub finds no subscriber for the order itself, the
status is unknown and not refused, because a copy may still be delivered when the site is back.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pydantic_core import from_json, to_json

from skygcs.core.clock_offset import ClockComparison, ClockOffset
from skygcs.core.vehicle.orders import require_confirmed
from skygcs.errors import BusError, NobodyThere, RefusedError, ReplyLost, TargetError
from skygcs.ext.federation.bridge.hub_config import ORDERS, STOPS
from skygcs.ext.federation.protocol.order_gate import ORDERING_ROLES
from skygcs.ext.federation.protocol.order_messages import (
    METHODS,
    OUTCOME_SUBJECT,
    STOP,
    OrderReply,
    OrderRequest,
    OutcomeQuestion,
    Status,
    decode_reply,
    is_key,
    vehicle_token,
)
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from skygcs.ext.federation.protocol.site_names import SITE_NAME, qualified, select_at
from skygcs.rpc.json_lines import OrderReports
from skygcs.spelling import is_number

FIRST_ANSWER_S = 0.8
"""Time limit of the first answer, from the beginning of the order, the comparison of the clocks included: the loss of
a site or of the hub shows within 1 s."""

EACH_FURTHER_S = 0.005
"""Added to that limit for each further vehicle of an order: time of both bridges for a request on a busy computer."""

CLOCKS_S = 0.4
"""Part of that limit for the comparison of the clocks."""

CLOCK_AGE_S = 1.0
"""The site is pinged again when its last answer is older."""

MAX_CLOCK_ERROR_S = 0.17
"""Largest error of the comparison, half the round trip: with a longer one too little is left of FIRST_ANSWER_S."""

ASK_WAIT_S = 0.8
"""How long the site may delay the answer to a question until the order has ended."""

ASK_TIMEOUT_S = 1.3
"""Time limit of that answer."""

ASK_PAUSE_S = 0.2
"""Pause after a question without an answer."""

ASKS_PER_S = 200.0
"""Largest rate of questions of this station, for an order to many vehicles."""

ANSWER_SILENT_S = 3.0
"""Time without an answer after which a running order is unknown. A hub that is restarted is back within 2 s."""

LONGEST_S = 150.0
"""Longest time for which a running order is followed: a command that reports its progress may take 120 s."""

MAX_SENT = 1024
"""Orders that are kept for `outcome`; beyond, the oldest is dropped."""

MAX_AT_ONCE = 1000
"""Vehicles of one order."""

MAX_SITES = 64
"""Sites whose clocks are kept; beyond, the oldest is dropped."""

Json = dict[str, Any]

UNCERTAIN = (ReplyLost, NobodyThere)
"""Errors after which an order may have been carried out, or may still be."""


class Requests(Protocol):
    """The part of `Bus` that is used here."""

    async def request(self, subject: str, data: bytes, timeout_s: float) -> bytes:
        """Send a request and return the answer. Raises BusError."""
        ...


@dataclass(frozen=True, slots=True)
class RemoteVehicle:
    """A vehicle of another site: the site's name, and the vehicle's name there."""

    site: str
    name: str

    def __str__(self) -> str:
        return qualified(self.site, self.name)


@dataclass(slots=True)
class _Sent:
    """An order that was sent, with its present reply."""

    request: OrderRequest
    site: str
    reply: OrderReply


class OrdersSent:
    """The orders of one station to vehicles of other sites. ``station`` and ``role``: its name and role, for the record
    of the home site. ``sites``: the other sites with their vehicles."""

    methods = METHODS
    """Methods that may be sent to other sites."""

    def __init__(
        self,
        station: str,
        role: str,
        bus: Requests,
        sites: RemoteSites,
        loop: asyncio.AbstractEventLoop,
        *,
        clock: Callable[[], float],
        new_key: Callable[[], str] = lambda: secrets.token_hex(16),
    ) -> None:
        """``clock``: seconds that never go back and go on while the computer sleeps, unlike those of the loop."""
        self.counters: Counter[str] = Counter()
        """Number of orders by status."""
        self._station = station
        self._role = role
        self._bus = bus
        self._sites = sites
        self._loop = loop
        self._clock = clock
        self._new_key = new_key
        self._run = new_key()[:8]
        self._following = 0
        """Number of running orders whose outcome is asked for."""
        self._seq = 0
        self._clocks: OrderedDict[str, _SiteClock] = OrderedDict()
        self._sent: OrderedDict[str, _Sent] = OrderedDict()

    async def run(self) -> None:
        """Wait until it is cancelled: each order runs in the task of its caller."""
        await asyncio.Event().wait()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {"sent": len(self._sent), **self.counters}

    def check(
        self, method: str, params: Mapping[str, Any], targets: Mapping[str, Sequence[str]], own: Sequence[str] = ()
    ) -> None:
        """Check an order without sending it. Raises SkygcsError for an order that may not be sent to other sites, or
        whose word of confirmation is missing or wrong. ``targets``: by site. ``own``: vehicles of this station that get
        the same order."""
        vehicles, _ = self._vehicles(targets)
        self._check(method, params, [*own, *map(str, vehicles)])

    async def give(
        self,
        method: str,
        params: Mapping[str, Any],
        targets: Mapping[str, Sequence[str]],
        by: str,
        own: int = 0,
        reports: OrderReports | None = None,
    ) -> dict[str, Json]:
        """Give one order to vehicles of other sites and return the outcomes by "site/name". ``by``: the user. ``own``:
        number of vehicles of this station that get it, too; then `check` must have been called with them. ``reports``
        gets each outcome when it comes. Raises SkygcsError before anything is sent."""
        vehicles, empty = self._vehicles(targets)
        if not own:
            self._check(method, params, [str(vehicle) for vehicle in vehicles])
        if reports is not None:
            reports.begun([*map(str, vehicles), *empty])
            for name, outcome in empty.items():
                reports.ended_with(name, outcome)
        several = len(vehicles) + own > 1
        return empty | await self._order(method, params, vehicles, by, several=several, reports=reports)

    async def order(
        self, method: str, params: Mapping[str, Any], vehicles: Sequence[RemoteVehicle], user: str
    ) -> dict[str, Json]:
        """Like `give`, for vehicles that need not be known here. Raises RefusedError."""
        self._check(method, params, [str(vehicle) for vehicle in vehicles])
        return await self._order(method, params, vehicles, user, several=len(vehicles) > 1)

    async def answer_outcome(self, params: Json) -> Json:
        """Return what became of an order to a vehicle of another site, by the id that its outcome showed.

        An order that has not come to the site by then is refused from then on.
        """
        return await self.outcome(str(params["id"]))

    async def outcome(self, text: str) -> Json:
        """The status of the order ``text``: "site/id" as its outcome showed, or "id" for an order of this station. The
        site is asked. Raises TargetError for a text that names no order."""
        site, _, key = text.rpartition("/")
        sent = self._sent.get(key)
        if not is_key(key) or not (sent if not site else SITE_NAME.fullmatch(site)):
            raise TargetError(
                f"{text[:100]!r} is not an order of this station; give its id as it was shown: site/32 digits"
            )
        site = site or (sent.site if sent is not None else "")
        try:
            reply = await self._ask(site, key, 0.0, sent)
            heard = True
        except BusError as error:
            heard = False
            why = f"{site} does not answer: {error.reason}"
            reply = OrderReply(key, "unknown", why) if sent is None or sent.reply.status == "unknown" else sent.reply
        if sent is not None and heard:
            sent.reply = reply
        return {
            "id": f"{site}/{key}",
            "vehicle": None if sent is None else f"{site}/{sent.request.vehicle}",
            "method": None if sent is None else sent.request.method,
            "status": reply.status,
            "text": reply.text,
            "outcome": reply.outcome,
            "answered": heard,
        }

    # -- private

    def _vehicles(self, targets: Mapping[str, Sequence[str]]) -> tuple[list[RemoteVehicle], dict[str, Json]]:
        """The vehicles that the targets name, and an outcome for each site that shares none. Raises TargetError."""
        vehicles: list[RemoteVehicle] = []
        empty: dict[str, Json] = {}
        for site, parts in targets.items():
            found = select_at(site, parts, self._sites.rows(site))
            vehicles += [RemoteVehicle(site, row.name) for row in found]
            if not found:
                empty[qualified(site, "all")] = _plain_outcome(False, "refused", f"refused: {site} shows no vehicle")
        return vehicles, empty

    async def _order(
        self,
        method: str,
        params: Mapping[str, Any],
        vehicles: Sequence[RemoteVehicle],
        user: str,
        *,
        several: bool,
        reports: OrderReports | None = None,
    ) -> dict[str, Json]:
        given = dict(params)
        given.pop("targets", None)
        if several and method == STOP and given.get("action") == "kill":
            given["confirm"] = "kill-1"  # the word for all vehicles was right; each request is for one vehicle
        began = self._loop.time()
        self._seq += 1
        seq = self._seq
        by = f"{user}@{self._station}"
        sites = list(dict.fromkeys(vehicle.site for vehicle in vehicles))
        offsets = dict(zip(sites, await asyncio.gather(*(self._offset(site) for site in sites)), strict=True))
        until = began + FIRST_ANSWER_S + EACH_FURTHER_S * (len(vehicles) - 1)

        async def one(vehicle: RemoteVehicle) -> Json:
            reply = await self._given(vehicle, method, given, by, seq, until, offsets[vehicle.site])
            outcome = self._outcome(vehicle, reply, self._loop.time() - began)
            if reports is not None:
                reports.ended_with(str(vehicle), outcome)
            return outcome

        return dict(zip(map(str, vehicles), await asyncio.gather(*map(one, vehicles)), strict=True))

    def _check(self, method: str, params: Mapping[str, Any], names: Sequence[str]) -> None:
        """Raises RefusedError for an order that may not be sent to other sites, or lacks its word of confirmation."""
        if self._role not in ORDERING_ROLES:
            raise RefusedError(f"this station is an {self._role}: it gives no orders to other sites")
        if method not in METHODS:
            raise RefusedError(f"{method} does not travel to other sites; give it there")
        if len(names) > MAX_AT_ONCE:
            raise RefusedError(f"{len(names)} vehicles in one order; at most {MAX_AT_ONCE}")
        if params.get("wait_s"):
            raise RefusedError("--wait is for vehicles of this site: a remote order is carried out at once or not")
        if params.get("together") is not None:
            raise RefusedError("together: is for vehicles of this site; the others are kept apart by their own sites")
        if method == "vehicles.goto":
            if params.get("enu_m") is not None:
                raise RefusedError("--enu is in metres from this site's origin; give LAT LON [HEIGHT] for another site")
            if len(names) > 1:
                raise RefusedError(
                    "a formation is kept by its own site: give each vehicle of another site its own goto"
                )
        if method == STOP:
            confirm = params.get("confirm")
            if len(names) > 1 or confirm is None:  # the word for a single vehicle is checked by its site
                require_confirmed(str(params.get("action")), dict.fromkeys(names), confirm)

    async def _given(
        self,
        vehicle: RemoteVehicle,
        method: str,
        params: Json,
        by: str,
        seq: int,
        until: float,
        offset: ClockOffset | str,
    ) -> OrderReply:
        """Give one order to one vehicle and return the reply at its end. ``until``: deadline by this loop's clock.
        ``offset``: of the site's clock, or why it is not known."""
        key = self._new_key()
        left_s = until - self._loop.time()
        if isinstance(offset, str):
            if method != STOP:
                self.counters["not sent"] += 1
                return OrderReply(key, "refused", f"{offset}; nothing was sent")
            # a stop is sent all the same: an older comparison, or the two wall clocks, may be right
            best = self._clocks[vehicle.site].best() if vehicle.site in self._clocks else None
            deadline_s = left_s + (time.time() if best is None else self._clock() + best.offset_s)
        else:
            deadline_s = left_s + self._clock() + offset.offset_s - offset.error_s
        request = OrderRequest(key, vehicle.name, method, params, deadline_s, by, self._role, self._run, seq)
        sent = _Sent(request, vehicle.site, OrderReply(key, "unknown", "it has been sent"))
        self._remember(sent)
        sent.reply = await self._first_answer(sent, until)
        if sent.reply.status == "running":
            self._following += 1
            try:
                sent.reply = await self._followed(sent)
            finally:
                self._following -= 1
        if sent.reply.status == "late":
            self._clocks.pop(vehicle.site, None)
        self.counters[sent.reply.status] += 1
        return sent.reply

    async def _first_answer(self, sent: _Sent, until: float) -> OrderReply:
        request, site = sent.request, sent.site
        kind = STOPS if request.method == STOP else ORDERS
        subject = f"{kind}{site}.{vehicle_token(request.vehicle)}"
        try:
            payload = await self._bus.request(subject, request.encoded(), max(until - self._loop.time(), 0.0))
        except UNCERTAIN as error:
            return OrderReply(request.key, "unknown", f"{site} has not answered: {error.reason}")
        except BusError as error:
            return OrderReply(request.key, "refused", f"{site} cannot be reached: {error.reason}; nothing was sent")
        return _read(site, request.key, payload)

    async def _followed(self, sent: _Sent) -> OrderReply:
        """Ask for the outcome of a running order until it has ended."""
        key, began = sent.request.key, self._loop.time()
        failing_since: float | None = None
        while True:
            why = ""
            try:
                reply = await self._ask(sent.site, key, ASK_WAIT_S, sent)
            except BusError as error:
                why = error.reason
                failing_since = self._loop.time() if failing_since is None else failing_since
                await asyncio.sleep(ASK_PAUSE_S)
            else:
                failing_since = None
                if reply.status == "never came":  # it came: the answer was "running"
                    return OrderReply(key, "unknown", f"{sent.site} does not remember it")
                if reply.status != "running":
                    return reply
                await asyncio.sleep(max(0.0, self._following / ASKS_PER_S - ASK_WAIT_S))
            now = self._loop.time()
            if failing_since is not None and now - failing_since > ANSWER_SILENT_S - ASK_TIMEOUT_S:
                return OrderReply(key, "unknown", f"{sent.site} carries it out, and then was not heard: {why}")
            if now - began > LONGEST_S:
                return OrderReply(key, "unknown", f"{sent.site} still carries it out after {LONGEST_S:.0f} s")

    async def _ask(self, site: str, key: str, wait_s: float, sent: _Sent | None) -> OrderReply:
        """Ask the site once for the outcome of an order. Raises BusError."""
        question = OutcomeQuestion(key, wait_s, None if sent is None else sent.request.deadline_s)
        payload = await self._bus.request(f"cmd.{site}.{OUTCOME_SUBJECT}", question.encoded(), ASK_TIMEOUT_S)
        return _read(site, key, payload)

    async def _offset(self, site: str) -> ClockOffset | str:
        """The offset of the site's clock from ours, or why it is not known."""
        clock = self._clocks.get(site)
        if clock is None:
            clock = self._clocks[site] = _SiteClock(site, self._bus, self._loop, self._clock)
            if len(self._clocks) > MAX_SITES:
                self._clocks.popitem(last=False)
        return await clock.offset()

    def _remember(self, sent: _Sent) -> None:
        self._sent[sent.request.key] = sent
        if len(self._sent) > MAX_SENT:
            self._sent.popitem(last=False)

    def _outcome(self, vehicle: RemoteVehicle, reply: OrderReply, took_s: float) -> Json:
        """The outcome in the form of the daemon's outcomes, with the order's id."""
        ident = f"{vehicle.site}/{reply.key}"
        if reply.outcome is not None and reply.status in ("done", "failed", "refused"):
            return {**reply.outcome, "id": ident}
        results: dict[Status, str] = {"done": "accepted", "failed": "failed", "unknown": "unknown"}
        message = reply.text
        if reply.status == "unknown":
            message = f"outcome unknown: {reply.text}; ask: skygcs-cli federation outcome {ident}"
        elif reply.status != "done":
            message = f"{'refused' if reply.status != 'failed' else 'failed'}: {reply.text}"
        result = results.get(reply.status, "refused")
        return {**_plain_outcome(reply.status == "done", result, message, took_s), "id": ident}


def _plain_outcome(ok: bool, result: str, message: str, took_s: float = 0.0) -> Json:
    """An outcome in the daemon's form for an order that no daemon has answered."""
    return {
        "ok": ok,
        "result": result,
        "message": message,
        "attempts": 0,
        "elapsed_s": round(took_s, 3),
        "status_texts": [],
    }


class _SiteClock:
    """The clock of one site, compared with ours when an order needs it; simultaneous orders share one ping."""

    def __init__(self, site: str, bus: Requests, loop: asyncio.AbstractEventLoop, clock: Callable[[], float]) -> None:
        self._site = site
        self._bus = bus
        self._loop = loop
        self._clock = clock
        self._comparison = ClockComparison()
        self._compared_at = -math.inf
        self._run: object = None
        self._asking: asyncio.Task[str | None] | None = None

    async def offset(self) -> ClockOffset | str:
        """The offset of the site's clock from ours, or why it is not known."""
        if self._clock() - self._compared_at > CLOCK_AGE_S:
            if self._asking is None:
                self._asking = self._loop.create_task(self._ask(), name=f"clock of {self._site}")
                self._asking.add_done_callback(self._asked)
            problem = await asyncio.shield(self._asking)
            if problem is not None:
                return problem
        best = self.best()
        if best is None:
            return f"the clock of {self._site} is not known"
        if best.error_s > MAX_CLOCK_ERROR_S:
            return f"the way to {self._site} and back takes {best.round_trip_s:.1f} s, too long for orders"
        return best

    def best(self) -> ClockOffset | None:
        """The best comparison of the last minute; None without one."""
        return self._comparison.best(self._clock())

    def _asked(self, _: object) -> None:
        self._asking = None

    async def _ask(self) -> str | None:
        """Compare the clocks once. Returns why it failed, None if it did not."""
        sent = self._clock()
        try:
            payload = await self._bus.request(f"here.{self._site}", to_json({"t0_s": sent}), CLOCKS_S)
        except BusError as error:
            return f"{self._site} cannot be reached: {error.reason}"
        received = self._clock()
        try:
            answer = from_json(payload, allow_inf_nan=False)
            remote_s, run = answer["site_s"], answer.get("run")
            if not is_number(remote_s):
                raise TypeError
        except (ValueError, TypeError, KeyError, AttributeError):
            return f"{self._site} answers with something else than its clock"
        if run != self._run:
            self._run, self._comparison = run, ClockComparison()
        if not self._comparison.add(sent, received, remote_s, wall_received=received, remote_wall=remote_s):
            return f"{self._site} answers with something else than its clock"
        self._compared_at = received
        return None


def _read(site: str, key: str, payload: bytes) -> OrderReply:
    reply = decode_reply(key, payload)
    return reply if reply is not None else OrderReply(key, "unknown", f"the answer of {site} cannot be read")
