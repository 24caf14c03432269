"""The gates before bytes are sent: what passes while a vehicle is open, while it is closed, and while a gate fails."""

from __future__ import annotations

import pytest

from skygcs.core.routing.send_gates import NO_TARGET, GateChange, SendGates, target_of
from support.routed import DIALECT
from support.send_gate import TimedGate
from support.table import each

ALPHA, BRAVO, OWN = 1, 8, 9
AIR = 1
"""The channel on which all of them are heard."""


class Gated:
    """Gates of ALPHA and BRAVO, which are heard on AIR."""

    def __init__(self) -> None:
        self.gate = TimedGate(ALPHA, BRAVO)
        self.faults: list[Exception] = []
        self.gates = SendGates({"lease": self.gate}, self.faults.append)
        for sysid in (ALPHA, BRAVO):
            assert self.gates.hear(AIR, sysid)
            assert not self.gates.hear(AIR, sysid)
            assert self.gates.gates(sysid)
        assert not self.gates.gates(OWN)


def test_a_vehicle_is_closed_until_its_gate_opens_and_again_when_the_time_is_over() -> None:
    g = Gated()
    assert not g.gates.passes(AIR, ALPHA, (), 10.0)
    g.gate.until[ALPHA] = 12.5
    for target, now, passes in ((ALPHA, 12.499, True), (ALPHA, 12.5, False), (BRAVO, 11.0, False), (OWN, 11.0, True)):
        assert g.gates.passes(AIR, target, (), now) is passes, (target, now)
    assert [g.gates.blocked(sysid) for sysid in (ALPHA, BRAVO, OWN)] == [2, 1, 0]


@each(
    ("held", "target", "others", "passes"),
    [
        ((), 0, (OWN,), False),
        ((ALPHA,), 0, (OWN,), False),
        ((ALPHA, BRAVO), 0, (OWN,), True),
        ((), NO_TARGET, (), False),
        ((), NO_TARGET, (ALPHA, BRAVO), False),
        ((), NO_TARGET, (ALPHA, BRAVO, OWN), True),
        ((ALPHA,), NO_TARGET, (ALPHA, BRAVO), True),
    ],
)
def test_frames_for_everybody_follow_who_else_is_heard(held, target, others, passes) -> None:
    g = Gated()
    g.gate.until |= dict.fromkeys(held, 12.0)
    assert g.gates.passes(AIR, target, others, 11.0) is passes
    assert g.gates.passes(AIR + 1, target, others, 11.0), "no gated vehicle is heard there"


def test_a_silent_vehicle_still_counts_until_its_channel_is_closed() -> None:
    g = Gated()
    assert g.gates.leads_to_gated(AIR)
    assert not g.gates.passes(AIR, NO_TARGET, (), 1e6)
    g.gates.forget_channel(AIR)
    assert g.gates.passes(AIR, NO_TARGET, (), 1e6)
    assert not g.gates.passes(AIR, ALPHA, (), 1e6), "its own frames are closed wherever they go"


@each("target", [ALPHA, 0, NO_TARGET])
def test_a_gate_that_fails_is_closed(target: int) -> None:
    g = Gated()
    g.gate.until |= dict.fromkeys((ALPHA, BRAVO), 100.0)
    assert g.gates.passes(AIR, target, (), 10.0)
    g.gate.fault = ValueError("broken")
    assert not g.gates.passes(AIR, target, (), 10.0)
    assert g.gates.is_closed(ALPHA, 10.0)
    assert "[lease] could not be asked" in str(g.gates.refusal(ALPHA, 10.0))
    assert g.gates.refusal(OWN, 10.0) is None
    assert set(map(str, g.faults)) == {"broken"}


def test_of_two_gates_of_one_vehicle_both_have_to_be_open() -> None:
    first, second = TimedGate(ALPHA), TimedGate(ALPHA)
    gates = SendGates({"lease": first, "beacon": second}, pytest.fail)  # type: ignore[arg-type]
    first.until[ALPHA] = 12.0
    assert gates.is_closed(ALPHA, 10.0)
    second.until[ALPHA] = 11.0
    assert [gates.is_closed(ALPHA, now) for now in (10.0, 11.5)] == [False, True]
    assert gates.tables_of(ALPHA) == ["lease", "beacon"] and gates.tables_of(OWN) == []
    assert not SendGates({"lease": TimedGate()}, pytest.fail), "gates of no vehicle are none"  # type: ignore[arg-type]


def test_each_change_is_told_once_and_a_fault_is_one() -> None:
    g = Gated()
    opened, closed = GateChange(ALPHA, None), GateChange(ALPHA, "1 is not ours now")
    for until, now, changes in (
        *((None, 10.0, []), (12.0, 10.1, [opened]), (13.0, 11.0, [])),
        *((None, 14.0, [closed]), (None, 14.1, []), (20.0, 14.2, [opened])),
    ):
        g.gate.until |= {} if until is None else {ALPHA: until}
        assert g.gates.changes(now) == changes, now
    g.gate.fault = ValueError("broken")
    (change,) = g.gates.changes(14.3)
    assert change.sysid == ALPHA and "[lease]" in str(change.refusal)


@each(
    ("name", "fields", "target"),
    [
        ("COMMAND_LONG", {"target_system": 7}, 7),
        ("PARAM_REQUEST_LIST", {"target_system": 7}, 7),  # its first byte
        ("SET_MODE", {"target_system": 0}, 0),
        ("MANUAL_CONTROL", {"target": 7}, 7),
        ("HEARTBEAT", {}, NO_TARGET),
        ("GPS_RTCM_DATA", {}, NO_TARGET),
    ],
)
def test_the_target_of_a_message(name: str, fields: dict[str, int], target: int) -> None:
    info = DIALECT.find(name)
    assert target_of(info, info.pack(fields)) == target
    trimmed = info.pack(fields)[: max(info.target_system_offset, 0)]
    assert target_of(info, trimmed) == min(target, 0)
    assert target_of(None, b"\7") == 0, "a message that is not known may be for anybody"
