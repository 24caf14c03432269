"""Takes orders of other stations at the home site: the one subscriber of cmd.<site>.*.

    message             core.federation.order_gate decides; what it lets through goes to the daemon once
    answer              the outcome, if it is there within ANSWER_S; else "running": the station then asks for it
    record              before the order begins and when it has ended: in a file here, and on audit.<site>

An order goes on to its outcome when the station that gave it is gone, as the hub may be.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from typing import Protocol

import structlog

from skygcs.core.federation.audit import record
from skygcs.core.federation.order_gate import MAX_AHEAD_S, STOP_LATE_S, Begin, OrderGate, Refuse, Repeated
from skygcs.core.federation.order_messages import (
    ENDS_FLIGHT,
    OUTCOME_SUBJECT,
    STOP,
    OrderReply,
    OrderRequest,
    decode_question,
    decode_request,
    vehicle_of_token,
)
from skygcs.federation.audit_file import AuditFile
from skygcs.federation.daemon_orders import Carried

ANSWER_S = 0.1
"""An order that has not ended by then is answered with "running": the station waits 0.8 s in all for a first answer."""

MAX_QUESTION_WAIT_S = 0.8
"""A question waits so long for the order's end; the station takes the site for away after 3 s without an answer."""

MAX_MESSAGES = 1024
"""Messages that are answered at a time: a stop for every vehicle of a full site, and as many questions."""

_log = structlog.get_logger(__name__)


class Daemon(Protocol):
    """`federation.daemon_orders.DaemonOrders`."""

    async def order(self, vehicle: str, method: str, params: dict[str, object], deadline: float) -> Carried: ...


class OrdersTaken:
    """`answer` for each message of cmd.<site>.*; `close` at the end.

    ``clock``: the home site's clock, which never goes back. ``publish``: sends a payload to a subject, or drops and
    counts it. ``not_held``: why this site does not command a vehicle; None if it does.
    """

    def __init__(
        self,
        site: str,
        daemon: Daemon,
        file: AuditFile,
        publish: Callable[[str, bytes], None],
        not_held: Callable[[str], str | None],
        clock: Callable[[], float],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self._site = site
        self._daemon = daemon
        self._file = file
        self._publish = publish
        self._not_held = not_held
        self._clock = clock
        self._loop = loop
        self._running: dict[str, asyncio.Task[OrderReply]] = {}
        self.gate = self._restored()

    async def answer(self, subject: str, payload: bytes, sender: str = "") -> bytes:
        """The answer to one message of the station with this key, within MAX_QUESTION_WAIT_S. Never raises for what is
        in it."""
        token = subject.rpartition(".")[2]
        if token == OUTCOME_SUBJECT:
            return (await self._answer_question(payload)).encoded()
        return (await self._answer_order(token, payload, sender)).encoded()

    async def close(self) -> None:
        """Wait no longer for orders that run: what becomes of them is not known here."""
        tasks = list(self._running.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._file.close()

    def status(self) -> dict[str, object]:
        """JSON-able, for federation.status and metrics."""
        return {
            "running": len(self._running),
            "kept": len(self.gate),
            "decided": dict(self.gate.counters),
            "messages": dict(self.counters),
            "file": {"path": str(self._file.path), **self._file.counters},
        }

    # -- the inside

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
            return self._malformed("this is no order; nothing was carried out")
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
        """Start to carry it out. The record comes first: without it a copy that comes after a restart would be carried
        out again, so that an order that does not end a flight is then refused."""
        running = OrderReply(request.key, "running", "")
        problem = self._note(request, running, now_s)
        if problem is not None and request.method not in ENDS_FLIGHT:
            text = f"{self._site} cannot record orders ({problem}); it is not carried out"
            work = self._refused(request, OrderReply(request.key, "refused", text))
        else:
            left_s = request.deadline_s - now_s + (STOP_LATE_S if request.method == STOP else 0.0)
            work = self._carry_out(request, self._loop.time() + left_s)
        task = self._loop.create_task(work, name=f"{request.method} {request.vehicle}")
        self._running[request.key] = task

    async def _refused(self, request: OrderRequest, reply: OrderReply) -> OrderReply:
        self._running.pop(reply.key, None)
        self.gate.ended(reply, self._clock())
        self._note(request, reply, self._clock())
        return reply

    async def _carry_out(self, request: OrderRequest, deadline: float) -> OrderReply:
        """Give the order to the daemon, once, and note what became of it."""
        try:
            carried = await self._daemon.order(request.vehicle, request.method, request.params, deadline)
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
        now_s = self._clock()
        self.gate.ended(reply, now_s)
        self._note(request, reply, now_s)
        return reply

    async def _after(self, key: str, wait_s: float) -> OrderReply:
        """What is known of an order that runs, at its end or after this time."""
        task = self._running.get(key)
        if task is not None:
            done, _ = await asyncio.wait({task}, timeout=wait_s)
            if done:
                return task.result()
        return self.gate.known(key) or OrderReply(key, "running", "still being carried out")

    def _note(self, request: OrderRequest, reply: OrderReply, now_s: float) -> str | None:
        """The record of an order, here and on the bus; why it could not be written here."""
        entry = record(request, reply, now_s)
        problem = self._file.append(entry)
        if problem is not None and self._file.counters["failed"] == 1:
            _log.warning("orders of other stations cannot be recorded", reason=problem)
        self._publish(f"audit.{self._site}", entry.encoded())
        return problem
