"""All parameters of a vehicle: complete and exact over bad networks, bounded, and still so when the list changes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from skygcs.core.mavlink.param_encoding import HASH_NAME, Param, ParamType, ParamValue
from skygcs.core.protocols.base import Send
from skygcs.core.protocols.parameter import LATE_VALUE_S
from skygcs.core.protocols.parameter_list import MAX_RESTARTS, MAX_TRIES, SILENCE_S, VALUE_BYTES, WINDOW, ParamList
from support.examples import examples
from support.param_vehicle import Network, ParamVehicle, Wire, big_set
from support.table import each

BAD = Network(loss=0.2, duplicate=0.2, delay_s=(0.0, 2.0))


def started(**options: Any) -> ParamList:
    exchange = ParamList(**options)
    exchange.start(0.0)
    return exchange


def test_all_of_them_in_the_vehicles_order() -> None:
    params = big_set(50)
    outcome = Wire(ParamVehicle.of(params), Network()).run(ParamList())
    assert (outcome.ok, outcome.params, outcome.sent) == (True, tuple(params), 50)


def test_a_lost_burst_request_costs_nothing_but_time() -> None:
    exchange = started(burst=True)
    assert exchange.deadline is not None
    (send,) = exchange.on_timer(exchange.deadline)
    assert isinstance(send, Send) and send.values["param_index"] == 0


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 1 << 30), st.integers(1, 60), st.booleans())
def test_complete_and_exact_over_a_bad_network(seed: int, count: int, burst: bool) -> None:
    params = big_set(count)
    wire = Wire(ParamVehicle.of(params), BAD, seed)
    outcome = wire.run(ParamList(burst=burst))
    assert outcome.ok and outcome.params == tuple(params)
    assert outcome.sent == len(wire.sent) <= 1 + MAX_TRIES * count


def test_a_burst_is_one_request_and_gaps_are_filled() -> None:
    params = big_set(200)
    sent = []
    for seed in range(4):
        wire = Wire(ParamVehicle.of(params), Network(loss=0.05), seed)
        outcome = wire.run(ParamList(burst=True))
        assert outcome.params == tuple(params) and wire.sent[0].message == "PARAM_REQUEST_LIST"
        sent.append(outcome.sent)
    assert min(sent) < 40, "of four requests of a burst one comes, in all but one of 160,000 runs"


def test_no_more_under_way_than_the_window_and_no_faster_than_told() -> None:
    exchange, now, times = ParamList(bytes_per_s=1000.0), 0.0, []
    times += [now for _ in exchange.start(now)]
    exchange.on_value(ParamValue(Param("P0", 1), 100, 0), now)
    while len(times) < WINDOW + 1 and exchange.deadline is not None and now < 0.9:
        now = exchange.deadline
        times += [now for _ in exchange.on_timer(now)]
    assert len([t for t in times if t < 0.9]) == WINDOW + 1  # index 0 has been answered
    gaps = [b - a for a, b in pairwise(times)]
    assert min(gaps) >= VALUE_BYTES / 1000.0 - 1e-9


def test_progress_tells_the_rest() -> None:
    exchange = started()
    assert exchange.progress(0.0).count is None
    for i in range(10):
        exchange.on_value(ParamValue(Param(f"P{i}", i), 40, i), 1.0 + i * 0.1)
    progress = exchange.progress(2.0)
    assert (progress.received, progress.count, progress.remaining_s) == (10, 40, pytest.approx(6.0))


def test_a_vehicle_that_says_nothing_is_given_up() -> None:
    wire = Wire(ParamVehicle.of(big_set(3)), Network(loss=1.0))
    outcome = wire.run(ParamList())
    assert (outcome.result, outcome.params) == ("timeout", ())
    assert outcome.elapsed_s == pytest.approx(SILENCE_S)
    assert outcome.sent <= MAX_TRIES


def test_an_index_it_never_answers_is_named() -> None:
    params = big_set(20)
    outcome = Wire(ParamVehicle.of(params, deaf_to={7}), Network()).run(ParamList())
    assert (outcome.ok, outcome.result, len(outcome.params)) == (False, "incomplete", 19)
    assert outcome.message.endswith("1 of 20 are missing (index 7)") and outcome.sent <= 19 + MAX_TRIES


def test_values_without_an_index_do_not_count_but_are_newer() -> None:
    params = big_set(3)
    newer = replace(params[0], value=9.5)
    exchange = started()
    for param, index in (
        *((params[0], 0), (params[1], 1), (newer, None)),
        *((Param(HASH_NAME, 1, ParamType.UINT32), None), (params[2], 2)),
    ):
        exchange.on_value(ParamValue(param, 3, index), 0.1)
    assert exchange.outcome is not None and exchange.outcome.params == (newer, *params[1:])


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 1 << 30), st.sampled_from(["more", "fewer"]), st.floats(0.5, 8.0))
def test_a_list_that_changes_under_way_is_read_anew(seed: int, change: str, when_s: float) -> None:
    """What comes out is one state of the vehicle, never a mixture of two. Of a list that lost its tail while only that
    was missing nobody answers any more: that is told as incomplete."""
    before = big_set(40)
    vehicle = ParamVehicle.of(before)
    wire = Wire(vehicle, Network(loss=0.1, duplicate=0.1, delay_s=(0.1, 0.8)), seed)
    extra = [Param(f"A_NEW_{i}", i, ParamType.INT8) for i in range(3)]
    after = {"more": extra + before, "fewer": before[5:]}[change]
    wire.at(when_s, lambda: setattr(vehicle, "params", {p.name: p for p in after}))
    outcome = wire.run(ParamList(bytes_per_s=None))
    assert outcome.ok or (change, outcome.result) == ("fewer", "incomplete"), outcome
    assert not outcome.ok or outcome.params in (tuple(before), tuple(after))


def test_a_list_that_always_changes_is_given_up() -> None:
    vehicle = ParamVehicle.of(big_set(60))
    wire = Wire(vehicle, Network(delay_s=(0.2, 0.2)))

    def grow(n: int = 0) -> None:
        vehicle.params = {p.name: p for p in big_set(60 + n)}
        wire.at(1.0, lambda: grow(n + 1))

    grow()
    outcome = wire.run(ParamList(bytes_per_s=400.0))
    assert outcome.result == "changing"
    assert outcome.sent <= (MAX_RESTARTS + 1) * MAX_TRIES * 90


def test_a_count_out_of_all_reason_is_ignored() -> None:
    exchange = started()
    for count in (0, 60_000):
        exchange.on_value(ParamValue(Param("X", 1), count, 0), 0.1)
    assert exchange.count is None and not exchange.done


@each(
    ("options", "messages", "said"),
    [
        ({}, [], ""),
        ({"burst": True, "stops_burst": True}, ["PARAM_SET"], ""),  # PX4
        ({"burst": True}, [], "goes on sending"),  # ArduPilot
    ],
)
def test_stopping_keeps_what_came_and_ends_a_burst_or_says_that_it_goes_on(options, messages, said: str) -> None:
    exchange = started(**options)
    exchange.on_value(ParamValue(Param("X", 1), 5, 0), 0.1)
    effects = exchange.stop(0.2, "cancelled", "cancelled")
    assert exchange.on_timer(99.0) == () == exchange.on_value(ParamValue(Param("Y", 1), 5, 1), 0.3)
    assert [e.message for e in effects if isinstance(e, Send)] == messages
    outcome = exchange.outcome
    assert outcome is not None and (outcome.result, len(outcome.params)) == ("cancelled", 1)
    assert said in outcome.message


class ListMachine(RuleBasedStateMachine):
    """Hypothesis is the network, and turns a feature of the vehicle on and off; in the end the network is good."""

    @initialize(count=st.integers(1, 12), burst=st.booleans())
    def begin(self, count: int, burst: bool) -> None:
        self.now = 0.0
        self.params = big_set(count)
        self.states = [sorted(p.name for p in self.params)]
        self.vehicle = ParamVehicle.of(self.params)
        self.exchange = ParamList(burst=burst, window=4)
        self.up: list[Send] = []
        self.down: list[tuple[float, ParamValue]] = []
        self.sends = 0
        self._take(self.exchange.start(self.now))

    def _take(self, effects: tuple[Any, ...]) -> None:
        sends = [effect for effect in effects if isinstance(effect, Send)]
        self.sends += len(sends)
        self.up += sends

    def _arrive(self, at: int, keep: bool) -> None:
        send = self.up[at] if keep else self.up.pop(at)
        self.down += [(self.now, value) for value in self.vehicle.hear(send.message, send.values)]

    @precondition(lambda self: self.up)
    @rule(data=st.data(), keep=st.booleans())
    def request_arrives(self, data: Any, keep: bool) -> None:
        self._arrive(data.draw(st.integers(0, len(self.up) - 1)), keep)

    @precondition(lambda self: self.down)
    @rule(data=st.data(), keep=st.booleans())
    def answer_arrives(self, data: Any, keep: bool) -> None:
        at = data.draw(st.integers(0, len(self.down) - 1))
        _, value = self.down[at] if keep else self.down.pop(at)
        self._take(self.exchange.on_value(value, self.now))

    @rule(data=st.data())
    def lost(self, data: Any) -> None:
        queue: list[Any] = data.draw(st.sampled_from([self.up, self.down]))
        if queue:
            queue.pop(data.draw(st.integers(0, len(queue) - 1)))

    @rule(dt=st.floats(0.01, 2.0))
    def time_passes(self, dt: float) -> None:
        self.now += dt
        self.down = [(t, v) for t, v in self.down if self.now - t < LATE_VALUE_S]  # none comes later than that
        self._take(self.exchange.on_timer(self.now))

    @rule()
    def a_feature_is_switched(self) -> None:
        extra = [Param("A_FEATURE", 1), Param("A_FEATURE_TOO", 2)]
        self.params = self.params[2:] if self.params[0] == extra[0] else [*extra, *self.params]
        self.vehicle.params = {p.name: p for p in self.params}
        self.states.append(sorted(p.name for p in self.params))

    @invariant()
    def bounded_and_consistent(self) -> None:
        exchange = self.exchange
        assert exchange.sent == self.sends <= 1 + (MAX_RESTARTS + 1) * MAX_TRIES * 14
        assert exchange.done == (exchange.outcome is not None) == (exchange.deadline is None)
        if exchange.outcome is not None and exchange.outcome.ok:
            names = [p.name for p in exchange.outcome.params]
            assert len(set(names)) == len(names) == exchange.outcome.count

    def teardown(self) -> None:
        if not hasattr(self, "exchange"):
            return
        for _ in range(2000):
            while self.up:
                self._arrive(0, keep=False)
            while self.down:
                self._take(self.exchange.on_value(self.down.pop(0)[1], self.now))
            if self.exchange.done:
                break
            self.time_passes(0.1)
        outcome = self.exchange.outcome
        assert outcome is not None
        if outcome.ok:  # one state it was in, if not its last: its last answer may have been under way at the switch
            assert sorted(p.name for p in outcome.params) in self.states
        assert outcome.result in ("accepted", "changing", "timeout", "incomplete")


TestListMachine = ListMachine.TestCase
TestListMachine.settings = settings(max_examples=examples(60), deadline=None, suppress_health_check=list(HealthCheck))
