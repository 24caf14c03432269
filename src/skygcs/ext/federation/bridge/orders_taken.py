"""Takes the orders of other stations at the home site: the only subscriber of cmd.<site>.* and stop.<site>.*.

    message             ext.federation.protocol.order_gate decides; an admitted order is passed to the daemon once
    answer              the outcome, if it is known within ANSWER_S; else "running": the station then asks for it
    record              before the order begins and when it has ended: in a file here, and on audit.<site>
    disk is stuck       an order that ends a flight begins after FLIGHT_END_WAIT_S; others are refused after DISK_WAIT_S

An order is carried out to its outcome even if the station that gave it, or the hub, is lost meanwhile.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import structlog

from skygcs.disk_writer import DiskWriter
from skygcs.ext.federation.bridge.audit_file import AuditFile
from skygcs.ext.federation.bridge.daemon_orders import Carried
from skygcs.ext.federation.bridge.hub_config import STOPS
from skygcs.ext.federation.protocol.audit import AuditRecord, record
from skygcs.ext.federation.protocol.order_gate import MAX_AHEAD_S, STOP_LATE_S, Begin, OrderGate, Refuse, Repeated
from skygcs.ext.federation.protocol.order_messages import (
    ENDS_FLIGHT,
    OUTCOME_SUBJECT,
    STOP,
    OrderReply,
    OrderRequest,
    decode_question,
    decode_request,
    vehicle_of_token,
)

ANSWER_S = 0.1
"""An order that has not ended by then is answered with "running"; the station waits 0.8 s for the first answer."""

MAX_QUESTION_WAIT_S = 0.8
"""Longest time that the answer to a question waits for the order's end; the station gives up after 3 s."""

MAX_MESSAGES = 1024
"""Messages answered at the same time: a stop for every vehicle of a full site, and as many questions, with room."""

MAX_STOP_MESSAGES = 1024
"""Further ones that name an emergency stop: no flood of other orders and questions keeps a stop out."""

RECORD = "the record of orders"
"""Names the file in reports about the disk."""

DISK_WAIT_S = 1.0
"""An order waits so long for its record; a disk takes one in less than a millisecond, a card that throttles in 1 s."""

FLIGHT_END_WAIT_S = 0.05
"""The same of an order that ends a flight, which is carried out without its record as well."""

_log = structlog.get_logger(__name__)


def names_stop(payload: bytes) -> bool:
    """True for every message that may be an emergency stop of a skygcs, before it is decoded."""
    return STOP.encode() in payload


class Daemon(Protocol):
    """The part of `DaemonOrders` that is used here."""

    async def order(self, vehicle: str, method: str, params: dict[str, object], deadline: float) -> Carried: ...


class OrdersTaken:
    """The orders that this site takes. Call `answer` for each message of cmd.<site>.* and stop.<site>.*, at the end
    `close`.

    ``clock``: returns the home site's clock in seconds, which never goes back. ``publish``: sends a payload to a
    subject, or drops and counts it. ``disk``: writes ``file`` beside the loop. ``not_held``: returns why this site does
    not command a vehicle; None if it does.
    """

    def __init__(
        self,
        site: str,
        daemon: Daemon,
        file: AuditFile,
        disk: DiskWriter,
        publish: Callable[[str, bytes], None],
        not_held: Callable[[str], str | None],
        clock: Callable[[], float],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self._site = site
        self._daemon = daemon
        self._file = file
        self._disk = disk
        self._warned = False
        """True if it was logged that orders cannot be recorded."""
        self._publish = publish
        self._not_held = not_held
        self._clock = clock
        self._loop = loop
        self._running: dict[str, asyncio.Task[OrderReply]] = {}
        self.gate = self._restored()

    async def answer(self, subject: str, payload: bytes, sender: str = "") -> bytes:
        """The answer to one message of the station with the key ``sender``, within MAX_QUESTION_WAIT_S. Never raises,
        whatever the message contains."""
        token = subject.rpartition(".")[2]
        if subject.startswith(STOPS) and not names_stop(payload):
            return self._malformed("this subject is for emergency stops; nothing was carried out").encoded()
        if token == OUTCOME_SUBJECT:
            return (await self._answer_question(payload)).encoded()
        return (await self._answer_order(token, payload, sender)).encoded()

    async def close(self) -> None:
        """Stop waiting for running orders: their outcome stays unknown."""
        tasks = list(self._running.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._disk.offer(RECORD, self._file.close)
        await self._disk.settled()

    def status(self) -> dict[str, object]:
        """JSON-able, for federation.status and metrics."""
        return {
            "running": len(self._running),
            "kept": len(self.gate),
            "decided": dict(self.gate.counters),
            "messages": dict(self.counters),
            "file": {"path": str(self._file.path), **self._file.counters},
        }

    # -- private

    def _restored(self) -> OrderGate:
        now_s = self._clock()
        try:
            records, complete = self._file.remembered()
        except OSError as error:
            until_s = now_s + MAX_AHEAD_S
            text = f"{self._file.path}: {error.strerror or error}"
            _log.warning("orders before this start are not known; none but stops are taken for 10 s", reason=text)
            return OrderGate(self._site, now_s, no_order_before_s=until_s)
        gate = OrderGate(self._site, now_s)
        gate.restore(records, complete=complete)
        return gate

    async def _answer_order(self, token: str, payload: bytes, sender: str) -> OrderReply:
        vehicle = vehicle_of_token(token)
        request = None if vehicle is None else decode_request(vehicle, payload, sender)
        if request is None:
            return self._malformed("this is not an order; nothing was carried out")
        now_s = self._clock()
        match self.gate.admit(request, now_s, not_held=self._not_held(request.vehicle)):
            case Begin():
                self._begin(request, now_s)
                return await self._after(request.key, ANSWER_S)
            case Repeated(reply):
                return reply if reply.status != "running" else await self._after(request.key, ANSWER_S)
            case Refuse(reply):
                self._note(request, reply, now_s)
                return reply

    async def _answer_question(self, payload: bytes) -> OrderReply:
        question = decode_question(payload)
        if question is None:
            return self._malformed("this is no question for an outcome")
        reply = self.gate.asked(question, self._clock())
        if reply.status != "running":
            return reply
        return await self._after(question.key, min(max(question.wait_s, 0.0), MAX_QUESTION_WAIT_S))

    def _malformed(self, text: str) -> OrderReply:
        self.counters["malformed"] += 1
        return OrderReply("", "refused", text)

    def _begin(self, request: OrderRequest, now_s: float) -> None:
        """Start to carry an order out, until its deadline."""
        left_s = request.deadline_s - now_s + (STOP_LATE_S if request.method == STOP else 0.0)
        work = self._carry_out(request, now_s, self._loop.time() + left_s)
        task = self._loop.create_task(work, name=f"{request.method} {request.vehicle}")
        self._running[request.key] = task

    async def _carry_out(self, request: OrderRequest, now_s: float, deadline: float) -> OrderReply:
        """Record an order, pass it to the daemon, once, and record its outcome. The record comes first: without it a
        copy that arrives after a restart would be carried out again. If it cannot be written, only orders that end a
        flight are carried out."""
        ends_flight = request.method in ENDS_FLIGHT
        try:
            problem = await self._recorded(request, now_s, FLIGHT_END_WAIT_S if ends_flight else DISK_WAIT_S)
            if problem is None or ends_flight:
                carried = await self._daemon.order(request.vehicle, request.method, request.params, deadline)
            else:
                carried = Carried("refused", f"{self._site} cannot record orders ({problem}); it is not carried out")
        except asyncio.CancelledError:
            carried = Carried(
                "unknown", f"the bridge of {self._site} ended while it was carried out; look at the vehicle"
            )
        except Exception as error:
            _log.error("order failed inside the bridge", method=request.method, exc_info=error)
            carried = Carried("unknown", f"failed inside the bridge of {self._site}: {error!r}; look at the vehicle")
        finally:
            self._running.pop(request.key, None)
        reply = OrderReply(request.key, carried.status, carried.text, carried.outcome)
        ended_s = self._clock()
        self.gate.ended(reply, ended_s)
        self._note(request, reply, ended_s)
        return reply

    async def _after(self, key: str, wait_s: float) -> OrderReply:
        """The reply about a running order, at its end or after ``wait_s``."""
        task = self._running.get(key)
        if task is not None:
            done, _ = await asyncio.wait({task}, timeout=wait_s)
            if done:
                return task.result()
        return self.gate.known(key) or OrderReply(key, "running", "still being carried out")

    async def _recorded(self, request: OrderRequest, now_s: float, within_s: float) -> str | None:
        """Record that an order begins. Returns why that is not known to be written, None if it is."""
        entry = self._entry(request, OrderReply(request.key, "running", ""), now_s)
        try:
            problem: str | None = await self._disk.run(RECORD, partial(self._file.append, entry), within_s=within_s)
        except OSError as error:
            problem = f"{self._file.path}: {error.strerror or error}"
        self._warn(problem)
        return problem

    def _note(self, request: OrderRequest, reply: OrderReply, now_s: float) -> None:
        """Record what became of an order; nothing waits for the file."""
        entry = self._entry(request, reply, now_s)
        written = self._disk.offer(RECORD, partial(self._file.append, entry))
        if written is None:
            self.counters["unrecorded"] += 1
        else:
            written.add_done_callback(self._on_written)

    def _entry(self, request: OrderRequest, reply: OrderReply, now_s: float) -> AuditRecord:
        """The record, which is sent to the hub as well."""
        entry = record(request, reply, now_s)
        self._publish(f"audit.{self._site}", entry.encoded())
        return entry

    def _on_written(self, written: asyncio.Future[Any]) -> None:
        if not written.cancelled():
            self._warn(written.result())

    def _warn(self, problem: str | None) -> None:
        if problem is not None and not self._warned:
            _log.warning("orders of other stations cannot be recorded", reason=problem)
            self._warned = True
