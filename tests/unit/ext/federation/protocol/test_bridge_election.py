"""Which of several bridges of one site acts: started second, killed, cut off from each other, at the same moment."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.ext.federation.protocol.bridge_election import (
    ASK_EVERY_S,
    ASKS,
    TAKE_OVER_S,
    BridgeClaim,
    BridgeElection,
    BridgeState,
    decode_claim,
)
from support.examples import examples
from support.table import each

ACTIVE, ASKING, STANDBY = BridgeState.ACTIVE, BridgeState.ASKING, BridgeState.STANDBY


class Net:
    """Bridges on one hub or on parts of it; claims arrive at the end of the step in which they were sent."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.bridges: dict[str, BridgeElection] = {}
        self.part: dict[str, int] = {}
        """Of the network, by run; -1: without a hub."""
        self.next_s: dict[str, float] = {}

    def start(self, run: str, part: int = 0) -> BridgeElection:
        made = self.bridges[run] = BridgeElection(run, f"host-{run}", 7)
        self.part[run], self.next_s[run] = part, self.now_s
        return made

    def kill(self, run: str) -> None:
        del self.bridges[run], self.part[run], self.next_s[run]

    def go(self, seconds: float) -> None:
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s += 0.05
            for run in list(self.bridges):
                if self.next_s[run] <= self.now_s:
                    bridge = self.bridges[run]
                    if bridge.tick(self.now_s, self.now_s, connected=self.part[run] >= 0):
                        self.send(run)
                    self.next_s[run] = self.now_s + bridge.next_tick_s

    def send(self, run: str) -> None:
        claim = decode_claim(self.bridges[run].claim.encoded())
        for other, bridge in self.bridges.items():
            if self.part[other] == self.part[run] >= 0 and bridge.heard(claim, self.now_s):
                self.send(other)

    def active(self) -> list[str]:
        return [run for run, bridge in self.bridges.items() if bridge.state is ACTIVE]


def test_the_second_one_never_acts_and_knows_the_first() -> None:
    net = Net()
    net.start("b")
    net.go(1.0)
    assert net.active() == ["b"]
    second = net.start("a")
    for _ in range(600):
        net.go(0.05)
        assert net.active() == ["b"] and second.state in (ASKING, STANDBY)
    other = second.other(net.now_s)
    assert other is not None and (other.host, other.state) == ("host-b", ACTIVE)
    assert second.stood_by and not net.bridges["b"].stood_by


def test_two_that_start_at_the_same_moment_are_one() -> None:
    net = Net()
    for run in ("b", "a", "c"):
        net.start(run)
    net.go(3.0)
    assert net.active() == ["a"]


def test_a_killed_bridge_is_back_before_the_one_on_standby_acts() -> None:
    net = Net()
    net.start("first")
    net.go(1.0)
    net.start("copy")
    net.go(5.0)
    net.kill("first")
    net.go(2.0)
    assert net.active() == []
    net.start("first again")
    net.go(ASKS * ASK_EVERY_S + 0.3)
    assert net.active() == ["first again"]
    net.kill("first again")
    net.go(TAKE_OVER_S + 2.0)
    assert net.active() == ["copy"]


def test_after_a_partition_in_which_both_acted_the_first_one_goes_on() -> None:
    net = Net()
    net.start("b")
    net.go(1.0)
    net.start("a")
    net.go(1.0)
    net.part["a"] = 1
    net.go(TAKE_OVER_S + 3.0)
    assert sorted(net.active()) == ["a", "b"]
    net.part["a"] = 0
    net.go(1.1)
    assert net.active() == ["b"] and net.bridges["a"].state is STANDBY


def test_a_bridge_without_a_hub_stays_what_it_is() -> None:
    net = Net()
    first = net.start("a", part=-1)
    net.go(20.0)
    assert first.state is ASKING  # nobody has said that no other acts
    net.part["a"] = 0
    net.go(1.0)
    copy = net.start("b")
    net.go(1.0)
    net.part = {"a": -1, "b": -1}
    net.go(100.0)
    assert (first.state, copy.state) == (ACTIVE, STANDBY)
    net.part["b"] = 0  # silence counts from now on
    net.go(TAKE_OVER_S - 0.5)
    assert copy.state is STANDBY


@settings(max_examples=examples(60), deadline=None)
@given(
    steps=st.lists(
        st.tuples(st.sampled_from("abc"), st.sampled_from([-1, 0, 0, 1, 2]), st.floats(0.0, 15.0)), max_size=12
    )
)
def test_whatever_was_cut_exactly_one_goes_on_when_the_network_is_whole(steps: list[tuple[str, int, float]]) -> None:
    net = Net()
    for run in "abc":
        net.start(run)
    for run, part, seconds in steps:
        if part == 2:
            net.kill(run)
            net.start(run)
        else:
            net.part[run] = part
        net.go(seconds)
    net.part = dict.fromkeys("abc", 0)
    net.go(TAKE_OVER_S + 3.0)
    (one,) = net.active()
    net.go(5.0)
    assert net.active() == [one]


@each(
    "data",
    [
        b"",
        b"[]",
        b"{}",
        b'{"run":"a","state":"active","since":null,"host":"h","pid":1}',
        b'{"run":"a","state":"active","since":NaN,"host":"h","pid":1}',
        b'{"run":"a","state":"standby","since":5,"host":"h","pid":1}',
        b'{"run":"a","state":"king","since":null,"host":"h","pid":1}',
        b'{"run":"","state":"asking","since":null,"host":"h","pid":1}',
        b'{"run":"a","state":"asking","since":null,"host":"h","pid":true}',
        b'{"run":"' + b"a" * 70 + b'","state":"asking","since":null,"host":"h","pid":1}',
        b'{"run":"a","state":"asking","since":null,"host":"h","pid":1,"x":"' + b"y" * 2000 + b'"}',
    ],
)
def test_what_is_no_claim_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError):
        decode_claim(data)


def test_a_claim_is_read_as_it_was_written() -> None:
    for claim in (BridgeClaim("r", ACTIVE, 17.25, "h", 9), BridgeClaim("r", STANDBY, math.inf, "h", 9)):
        assert decode_claim(claim.encoded()) == claim


def test_the_texts_of_a_claim_can_be_shown() -> None:
    claim = decode_claim(BridgeClaim("\x1br", STANDBY, math.inf, "h\n", 9).encoded())
    assert (claim.run, claim.host) == ("?r", "h?")


@each("number", [b"1e999", b"-1e999", b"1" + 400 * b"0"])
def test_numbers_of_a_claim_have_bounds(number: bytes) -> None:
    data = BridgeClaim("r", ACTIVE, 17.25, "h", 9).encoded()
    for known in (b"17.25", b"9"):
        assert data.count(known) == 1
        with pytest.raises(ValueError):
            decode_claim(data.replace(known, number))
