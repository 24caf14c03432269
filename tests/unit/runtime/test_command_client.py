"""Many commands over a link that loses and delays: every one ends once, and none with another's answer."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Mapping
from typing import Any

import pytest

from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.protocols.command import RETRY_TIMERS_S, SETTLE_S, Ack, CommandSpec, Outcome
from skygcs.runtime.command_client import ECHO_ACK_S, LATE_ACK_S, CommandClient, Moves
from support.vehicles import flight_dialect

pytestmark = pytest.mark.looptime


class BadRadio:
    """A vehicle that accepts commands with an even first parameter, behind a link with ``loss`` each way."""

    def __init__(self, seed: int, loss: float, delay_s: float, duplicate: float) -> None:
        self.random = random.Random(seed)
        self.loss, self.delay_s, self.duplicate = loss, delay_s, duplicate
        self.loop = asyncio.get_running_loop()
        self.commands = CommandClient((1, 1), (255, 25), flight_dialect(), self._send, self.loop)
        self.accepted: set[float] = set()
        self.sent = 0

    def _send(self, info: MessageInfo, values: Mapping[str, Any], *_: Any, **__: Any) -> bool:
        self.sent += 1
        self._through(self._vehicle, dict(values))
        return True

    def _through(self, arrive: Any, what: Any) -> None:
        for _ in range(2 if self.random.random() < self.duplicate else 1):
            if self.random.random() >= self.loss:
                self.loop.call_later(self.random.uniform(0, self.delay_s), arrive, what)

    def _vehicle(self, values: dict[str, Any]) -> None:
        even = values["param1"] % 2 == 0
        if even:
            self.accepted.add(values["param1"])
        self._through(self._ack, Ack(values["command"], 0 if even else 2, 0, 255, 25))

    def _ack(self, ack: Ack) -> None:
        self.commands.on_ack(ack, self.loop.time())


@pytest.mark.parametrize("seed", range(6))
async def test_over_a_lossy_slow_link_every_command_ends_once_with_its_own_answer(seed: int) -> None:
    radio = BadRadio(seed, loss=0.3, delay_s=0.6, duplicate=0.0)
    commands = radio.commands
    outcomes: dict[float, Outcome] = {}
    for n in range(40):
        outcomes[n] = await commands.run(CommandSpec(511, (float(n),)))
    for n, outcome in outcomes.items():
        assert outcome.result in ("accepted", "denied", "timeout")
        if outcome.result == "accepted":
            assert n % 2 == 0 and n in radio.accepted
        elif outcome.result == "denied":
            assert n % 2 == 1
        assert outcome.elapsed_s <= sum(RETRY_TIMERS_S) + SETTLE_S
    assert sum(o.result != "timeout" for o in outcomes.values()) >= 30
    assert not commands._running
    commands.close("the test ends")


@pytest.mark.parametrize("seed", range(3))
async def test_commands_of_many_ids_go_on_side_by_side_and_leave_nothing_behind(seed: int) -> None:
    radio = BadRadio(seed, loss=0.4, delay_s=0.5, duplicate=0.3)
    rng = random.Random(seed)
    tasks = []
    for n in range(120):
        tasks.append(asyncio.create_task(radio.commands.run(CommandSpec(500 + n % 30, (float(n),)))))
        if rng.random() < 0.2:
            tasks[rng.randrange(len(tasks))].cancel()
        await asyncio.sleep(rng.uniform(0, 0.2))
    results = await asyncio.gather(*tasks, return_exceptions=True)
    assert all(isinstance(r, Outcome | asyncio.CancelledError) for r in results)
    assert sum(isinstance(r, Outcome) and r.ok for r in results) > 20
    await asyncio.sleep(LATE_ACK_S)
    assert not radio.commands._running
    assert not radio.commands.busy
    assert radio.commands._timer.due is None


async def test_ids_that_are_not_used_any_more_take_no_memory() -> None:
    radio = BadRadio(1, loss=0.0, delay_s=0.0, duplicate=0.0)
    for n in range(300):
        await asyncio.sleep(ECHO_ACK_S)
        assert (await radio.commands.run(CommandSpec(1000 + n, (2.0,)))).ok
    radio.commands.expect_stray_ack(500, radio.loop.time())
    assert (await radio.commands.run(CommandSpec(999, (2.0,)))).ok
    assert set(radio.commands._lines) == {1299, 500, 999}  # whose acks may still come
    await asyncio.sleep(LATE_ACK_S)
    assert (await radio.commands.run(CommandSpec(998, (2.0,)))).ok
    assert set(radio.commands._lines) == {998}


async def test_a_quiet_time_ends_as_soon_as_the_late_acks_have_come() -> None:
    radio = BadRadio(1, loss=0.0, delay_s=0.0, duplicate=0.0)
    loop, commands = radio.loop, radio.commands
    radio.loss = 1.0
    first = asyncio.create_task(commands.run(CommandSpec(511, (2.0,))))
    await asyncio.sleep(1.2)  # sent twice by now
    commands.on_ack(Ack(511, 0, 0, 255, 25), loop.time())
    assert (await first).ok
    radio.loss = 0.0
    before = loop.time()
    second = asyncio.create_task(commands.run(CommandSpec(511, (4.0,))))
    await asyncio.sleep(0.3)
    assert 4.0 not in radio.accepted
    commands.on_ack(Ack(511, 2, 0, 255, 25), loop.time())  # late, of the first: a denial that must not count
    assert (await second).ok
    assert loop.time() - before < 0.5


async def test_what_another_order_has_done_when_its_turn_comes_is_not_sent() -> None:
    radio = BadRadio(1, loss=0.0, delay_s=0.1, duplicate=0.0)
    first = asyncio.create_task(radio.commands.run(CommandSpec(400, (2.0,))))
    await asyncio.sleep(0)
    moves = Moves(lambda: True, done=lambda: first.done())
    second = await radio.commands.run(CommandSpec(400, (2.0,)), moves=moves)
    assert (second.ok, second.attempts, radio.sent) == (True, 0, 1) and first.result().ok


@pytest.mark.parametrize(("result", "accepted"), [(0, 1), (2, 0)])
async def test_a_late_acceptance_is_told_to_the_order_that_a_newer_one_has_replaced(result: int, accepted: int) -> None:
    radio, told = BadRadio(1, loss=1.0, delay_s=0.0, duplicate=0.0), list[float]()
    moves = Moves(lambda: True, accepted=lambda: told.append(radio.loop.time()))
    replaced = asyncio.create_task(radio.commands.run(CommandSpec(176, (2.0,)), moves=moves))
    await asyncio.sleep(0.3)
    radio.commands.supersede([], ends_flight=False)
    assert (await replaced).result == "cancelled" and not told
    newer = asyncio.create_task(radio.commands.run(CommandSpec(176, (4.0,))))
    await asyncio.sleep(0)
    radio.commands.on_ack(Ack(176, result, 0, 255, 25), radio.loop.time())
    assert len(told) == accepted
    radio.loss = 0.0
    assert (await newer).ok and len(told) == accepted


async def test_the_second_ack_of_px4s_set_mode_does_not_pass_for_the_next_ones() -> None:
    radio = BadRadio(1, loss=1.0, delay_s=0.0, duplicate=0.0)
    loop, commands = radio.loop, radio.commands
    first = asyncio.create_task(commands.run(CommandSpec(176, (2.0,))))
    await asyncio.sleep(0.1)
    for echo_s in (0.0, 0.015):
        loop.call_later(echo_s, commands.on_ack, Ack(176, 0, 0, 255, 25), loop.time())
    assert (await first).ok
    second = asyncio.create_task(commands.run(CommandSpec(176, (3.0,))))
    await asyncio.sleep(0.2)
    assert not second.done()
    commands.on_ack(Ack(176, 2, 0, 255, 25), loop.time())
    assert (await second).result == "denied"


async def test_an_emergency_does_not_wait_for_late_acks_or_its_turn() -> None:
    radio = BadRadio(1, loss=1.0, delay_s=0.0, duplicate=0.0)
    commands = radio.commands
    arming = asyncio.create_task(commands.run(CommandSpec(400, (1.0,))))
    waiting = asyncio.create_task(commands.run(CommandSpec(400, (1.0,))))
    await asyncio.sleep(0.1)
    sent = radio.sent
    stop = asyncio.create_task(commands.run(CommandSpec(400, (0.0, 21196.0)), emergency=True))
    await asyncio.sleep(0)
    assert radio.sent == sent + 1
    assert (await arming).result == "cancelled"
    assert (await waiting).result == "refused"
    assert (await stop).result == "timeout"


async def test_closing_ends_everything_as_cancelled() -> None:
    radio = BadRadio(1, loss=1.0, delay_s=0.0, duplicate=0.0)
    task = asyncio.create_task(radio.commands.run(CommandSpec(400, (1.0,))))
    await asyncio.sleep(0.1)
    radio.commands.close("the test ends")
    assert (await task).result == "cancelled"


async def test_what_waits_for_its_turn_when_it_closes_is_never_sent() -> None:
    radio = BadRadio(1, loss=1.0, delay_s=0.0, duplicate=0.0)
    first, second, third = (asyncio.create_task(radio.commands.run(CommandSpec(511, (n,)))) for n in (2.0, 4.0, 6.0))
    await asyncio.sleep(0.1)
    assert radio.sent == 1
    radio.commands.close("skygcs stood still for 10 s")
    assert not radio.commands.transmit("COMMAND_LONG", {"command": 511})
    assert not radio.commands.transmit("TIMESYNC", {"tc1": 0, "ts1": 1})
    for task in (first, second, third):
        outcome = await task
        assert (outcome.result, outcome.message.endswith("stood still for 10 s")) == ("cancelled", True), outcome
    assert (await radio.commands.run(CommandSpec(400, (2.0,)), emergency=True)).result == "cancelled"
    assert radio.sent == 1


async def test_a_dialect_without_commands_refuses_them() -> None:
    from skygcs.core.mavlink.dialect import Dialect

    tiny = Dialect("tiny", [flight_dialect().by_name["HEARTBEAT"]], {})
    commands = CommandClient((1, 1), (255, 25), tiny, lambda *_: True, asyncio.get_running_loop())
    outcome = await commands.run(CommandSpec(400, (1.0,)))
    assert (outcome.result, "no COMMAND_LONG" in outcome.message) == ("refused", True)
