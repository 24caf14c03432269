"""One parameter: every way in which reading or setting it ends, on good networks and on bad ones."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from skygcs.core.mavlink.param_encoding import Encoding, Param, ParamType, ParamValue
from skygcs.core.protocols.base import Send
from skygcs.core.protocols.parameter import LATE_VALUE_S, ParameterProtocol
from support.examples import examples
from support.param_vehicle import Network, ParamVehicle, Wire, big_set
from support.table import each

THR = Param("MPC_THR_HOVER", 0.5, ParamType.REAL32)
ACT = Param("NAV_RCL_ACT", 2, ParamType.INT32)
MOST_SENDS = 8
"""Four requests and four PARAM_SETs; probes come with repeated requests."""


def vehicle(**more: Any) -> ParamVehicle:
    return ParamVehicle.of([Param("AAA", 1, ParamType.INT32), THR, ACT], **more)


def act(value: int) -> Param:
    return Param("NAV_RCL_ACT", value, ParamType.INT32)


def exchange_of(value: float | None = None, name: str = "NAV_RCL_ACT", **more: Any) -> ParameterProtocol:
    return ParameterProtocol(name, Encoding.BYTEWISE, value, **more)


def started(value: float | None = None, name: str = "NAV_RCL_ACT", **more: Any) -> ParameterProtocol:
    exchange = exchange_of(value, name, **more)
    exchange.start(0.0)
    return exchange


def test_reads_one_and_sets_one_and_reads_it_back() -> None:
    v = vehicle()
    outcome = Wire(v, Network()).run(exchange_of())
    assert (outcome.ok, outcome.param, outcome.attempts) == (True, ACT, 1)
    outcome = Wire(v, Network()).run(exchange_of(0))
    assert (outcome.ok, outcome.param, outcome.before, outcome.message) == (True, act(0), ACT, "2 -> 0")
    assert v.params["NAV_RCL_ACT"].value == 0
    wire = Wire(vehicle(), Network())
    assert wire.run(exchange_of(0, known=ACT)).ok
    assert [s.message for s in wire.sent] == ["PARAM_SET"], "what is known saves the question"


CLAMPS = {"limits": {"MPC_THR_HOVER": (0.1, 0.8)}}


@each(
    ("more", "name", "value", "result", "message"),
    [
        ({}, "MPC_THR_HOVER", 0.3, "accepted", "0.5 -> 0.3"),  # as its nearest 32-bit float
        ({"read_only": {"NAV_RCL_ACT"}}, "NAV_RCL_ACT", 0, "denied", "denied: it keeps 2 instead of 0"),
        (CLAMPS, "MPC_THR_HOVER", 0.95, "changed", "it took 0.8 instead of 0.95 (it was 0.5)"),
    ],
)
def test_what_became_of_a_value_is_told(more, name: str, value: float, result: str, message: str) -> None:
    outcome = Wire(vehicle(**more), Network()).run(exchange_of(value, name))
    assert (outcome.ok, outcome.result, outcome.message) == (result == "accepted", result, message)


@each(("value", "why"), [(1.5, "not whole"), (1 << 31, "not within")])
def test_a_value_the_type_cannot_hold_is_refused_unsent(value: float, why: str) -> None:
    wire = Wire(vehicle(), Network())
    outcome = wire.run(exchange_of(value))
    assert outcome.result == "refused" and why in outcome.message
    assert [s.message for s in wire.sent] == ["PARAM_REQUEST_READ"]


def test_a_name_that_only_silence_answers_is_unknown_and_silence_all_around_is_a_timeout() -> None:
    outcome = Wire(vehicle(), Network()).run(exchange_of(name="NO_SUCH"))
    assert (outcome.result, outcome.param) == ("unknown", None)
    outcome = Wire(vehicle(), Network(loss=1.0)).run(exchange_of())
    assert outcome.result == "timeout" and outcome.elapsed_s == pytest.approx(7.0)


def test_what_the_vehicle_says_ends_it_at_once() -> None:
    exchange = started(1, "NO_SUCH")
    exchange.on_error("OTHER", 1, 0.1)
    assert not exchange.done
    exchange.on_error("NO_SUCH", 1, 0.2)
    assert exchange.outcome is not None and exchange.outcome.result == "unknown"
    unknown, denied = started(1, known=ACT), started(1, known=ACT)
    unknown.on_text("[pm] unknown param: NAV_RCL_ACT", 0.1)
    assert unknown.outcome is not None and unknown.outcome.result == "unknown"
    denied.on_text("Param write denied (NAV_RCL_ACT)", 0.1)
    denied.on_value(ParamValue(ACT, 3, None), 0.1)
    assert denied.outcome is not None and denied.outcome.result == "denied"
    assert denied.outcome.message.endswith("Param write denied (NAV_RCL_ACT)")


def test_an_old_answer_is_not_taken_for_a_denial() -> None:
    exchange = started(0)
    for now in (0.5, 0.6, 0.7):
        exchange.on_value(ParamValue(ACT, 3, 2), now)
    assert not exchange.done
    exchange.on_value(ParamValue(act(0), 3, 2), 1.2)
    assert exchange.outcome is not None and exchange.outcome.ok


def test_stopped_while_setting_it_says_that_it_may_be_set() -> None:
    exchange = started(0, known=ACT)
    exchange.stop(0.1, "cancelled", "cancelled")
    assert exchange.outcome is not None and exchange.outcome.message == "cancelled; it may or may not be set"
    assert exchange.deadline is None and exchange.on_timer(9.0) == ()


@settings(max_examples=examples(150), deadline=None)
@given(st.integers(0, 1 << 30), st.sampled_from([0, 1, 5]), st.booleans())
def test_what_it_says_is_so_on_a_bad_network(seed: int, value: int, clamps: bool) -> None:
    """Delays of up to 2 s, 20 % lost each way, doubled, overtaking: it ends in time, and never says what is not so."""
    v = vehicle(limits={"NAV_RCL_ACT": (0, 3)} if clamps else {})
    wire = Wire(v, Network(loss=0.2, duplicate=0.3, delay_s=(0.0, 1.0)), seed)
    outcome = wire.run(ParameterProtocol("NAV_RCL_ACT", Encoding.BYTEWISE, value))
    held = v.params["NAV_RCL_ACT"].value
    if outcome.ok:
        assert held == value == outcome.param.value
    elif outcome.result == "changed":
        assert held == outcome.param.value != value
    else:
        assert outcome.result in ("timeout", "unknown", "denied")
        assert outcome.result != "denied" or held == outcome.param.value
    assert sum(s.values["param_id"] != "" for s in wire.sent) == outcome.attempts <= MOST_SENDS
    assert outcome.elapsed_s <= 14.0


class ParamMachine(RuleBasedStateMachine):
    """Hypothesis is the network: it loses, repeats and reorders at will what both sides say, and lets time pass."""

    @initialize(value=st.integers(-5, 5), named=st.booleans())
    def begin(self, value: int, named: bool) -> None:
        self.now = 0.0
        self.vehicle = vehicle(limits={"NAV_RCL_ACT": (0, 3)}, index_for_named=named)
        self.exchange = ParameterProtocol("NAV_RCL_ACT", Encoding.BYTEWISE, value)
        self.value = value
        self.up: list[Send] = []
        self.down: list[ParamValue] = []
        self.sends = 0
        self._take(self.exchange.start(self.now))

    def _take(self, effects: tuple[Any, ...]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                self.sends += 1
                self.up.append(effect)

    @precondition(lambda self: self.up)
    @rule(data=st.data(), keep=st.booleans())
    def request_arrives(self, data: Any, keep: bool) -> None:
        at = data.draw(st.integers(0, len(self.up) - 1))
        send = self.up[at] if keep else self.up.pop(at)
        self.down += self.vehicle.hear(send.message, send.values)

    @precondition(lambda self: self.down)
    @rule(data=st.data(), keep=st.booleans())
    def answer_arrives(self, data: Any, keep: bool) -> None:
        at = data.draw(st.integers(0, len(self.down) - 1))
        value = self.down[at] if keep else self.down.pop(at)
        self._take(self.exchange.on_value(value, self.now))

    @rule(data=st.data())
    def lost(self, data: Any) -> None:
        queue = data.draw(st.sampled_from([self.up, self.down]))
        if queue:
            queue.pop(data.draw(st.integers(0, len(queue) - 1)))

    @rule(dt=st.floats(0.01, 3.0))
    def time_passes(self, dt: float) -> None:
        self.now += dt
        self._take(self.exchange.on_timer(self.now))

    @invariant()
    def bounded_and_consistent(self) -> None:
        exchange = self.exchange
        assert exchange.attempts <= MOST_SENDS and self.sends <= 2 * MOST_SENDS
        assert exchange.done == (exchange.outcome is not None) == (exchange.deadline is None)
        outcome = exchange.outcome
        if outcome is not None and outcome.ok:
            # the first thing the vehicle ever took of us is what it took: there is one value only in this exchange
            assert ("NAV_RCL_ACT", self.value) in self.vehicle.history or self.value == ACT.value
        if outcome is not None and outcome.result == "changed":
            assert ("NAV_RCL_ACT", outcome.param.value) in self.vehicle.history  # type: ignore[union-attr]
            assert not 0 <= self.value <= 3

    def teardown(self) -> None:
        if not hasattr(self, "exchange"):
            return
        for _ in range(40):
            if not self.exchange.done:
                self.time_passes(2.5)
        assert self.exchange.done


TestParamMachine = ParamMachine.TestCase
TestParamMachine.settings = settings(max_examples=examples(60), deadline=None, suppress_health_check=list(HealthCheck))


def test_answers_may_still_come_for_a_while_after_a_timeout() -> None:
    exchange = ParameterProtocol("NAV_RCL_ACT", Encoding.BYTEWISE)
    exchange.start(1.0)
    assert exchange.quiet_until == 1.0 + LATE_VALUE_S
    exchange.on_value(ParamValue(ACT, 3, 2), 1.1)
    assert exchange.quiet_until == -math.inf


def test_a_long_name_is_like_any_other() -> None:
    params = big_set(12)
    name = max((p.name for p in params), key=len)
    assert len(name) == 16
    assert Wire(ParamVehicle.of(params), Network()).run(ParameterProtocol(name, Encoding.BYTEWISE)).ok
