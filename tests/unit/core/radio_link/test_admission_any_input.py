"""Whatever others send: no exception, bounded memory, no more than the rates, and emergencies always pass."""

from __future__ import annotations

import struct
from collections import Counter, defaultdict

from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.admission import MAX_SOURCES, RATE_BURST, ThirdPartyRules, ThirdPartyTraffic
from skygcs.core.radio_link.admission_frames import MAX_HZ, Kind, ThirdPartyFrame
from skygcs.core.radio_link.transmit_queue import Priority, TxQueue
from skygcs.core.radio_link.turn_gate import MAX_WAITING
from support.examples import examples
from support.frames import dialect

IDS = [0, 2, 4, 11, 20, 21, 23, 40, 43, 47, 66, 70, 73, 75, 76, 84, 109, 110, 111, 117, 233, 244, 65000]


def built(msgid: int, source: int, payload: bytes, version: int) -> Frame:
    """A frame around any payload; its CRC does not matter here, the parser has looked at it."""
    sysid, compid = source >> 8, source & 0xFF
    if version == 1:
        msgid &= 0xFF
        raw = bytes((0xFE, len(payload), 0, sysid, compid, msgid)) + payload + b"\0\0"
    else:
        head = (0xFD, len(payload), 0, 0, 0, sysid, compid, msgid & 0xFF, msgid >> 8 & 0xFF, msgid >> 16)
        raw = bytes(head) + payload + b"\0\0"
    return Frame(raw, 0, sysid, compid, msgid, dialect().messages.get(msgid))


COMMANDS = st.builds(
    lambda p1, p2, command, target: struct.pack("<7fHBBB", p1, p2, 0, 0, 0, 0, 0, command, target, 1, 0),
    st.sampled_from([0.0, 1.0, float("nan")]),
    st.sampled_from([0.0, 21196.0, float("inf")]),
    st.sampled_from([22, 185, 400, 511, 512]),
    st.integers(0, 4),
)
FRAMES = st.builds(
    built,
    st.sampled_from(IDS),
    st.sampled_from([255 << 8 | 190, 1 << 8 | 240, 250 << 8]) | st.integers(0, 0xFFFF),
    COMMANDS | st.binary(max_size=255) | st.binary(max_size=8),
    st.sampled_from([1, 2]),
)
OFFERS = st.lists(st.tuples(st.floats(0, 3), FRAMES), max_size=80)
VALUES = st.lists(st.tuples(*[st.integers(0, 255)] * 2, *[st.integers(0, 0xFFFF)] * 2), max_size=20)
RULES = st.builds(
    ThirdPartyRules,
    st.sampled_from(["one", "deny", "allow"]),
    st.sampled_from(["one", "deny", "allow"]),
    st.sampled_from(["deny", "allow"]),
    st.sampled_from(["deny", "allow"]),
    st.dictionaries(st.sampled_from(IDS), st.sampled_from([0.0, 0.001, 0.5, 100.0]), max_size=4),
    st.sampled_from([None, 1.0, 300.0]),
)


@given(st.lists(FRAMES, max_size=60), RULES, VALUES)
def test_no_bytes_are_wrong_enough_to_raise(frames, rules, values) -> None:
    traffic = ThirdPartyTraffic(rules, 500.0, 0.0)
    queue: TxQueue[bytes] = TxQueue()
    for number, frame in enumerate(frames):
        traffic.judge(frame, number / 10, queue.holds)
        for value in values:
            traffic.on_param_value(*value, number / 10)
            traffic.on_file_part(value[0], number / 10)
        traffic.poll(number / 10)
        traffic.next_poll(number / 10)
        traffic.status(number / 10)


@given(OFFERS, RULES)
def test_emergencies_always_pass_and_nothing_else_goes_as_one(offers, rules) -> None:
    traffic = ThirdPartyTraffic(rules, 500.0, 0.0)
    queue: TxQueue[bytes] = TxQueue()
    now = 0.0
    for pause_s, frame in offers:
        now += pause_s
        admission = traffic.judge(frame, now, queue.holds)
        if ThirdPartyFrame.of(frame).kind is Kind.EMERGENCY:
            assert admission.outcome == "send"
            assert admission.priority in (Priority.EMERGENCY, Priority.COMMAND, Priority.FORWARDED)
        else:
            assert admission.priority is not Priority.EMERGENCY
        if admission.outcome == "send":
            size = len(frame.raw)
            assert queue.offer(frame.raw, admission.priority, now, admission.key, size=size, flow=admission.flow)


@given(OFFERS)
@settings(max_examples=examples(50))
def test_no_source_sends_more_of_a_message_than_its_rate(offers: list[tuple[float, Frame]]) -> None:
    traffic = ThirdPartyTraffic(ThirdPartyRules(rates_hz={109: 0.7}), 500.0, 0.0)
    went: defaultdict[tuple[int, int, int], list[float]] = defaultdict(list)
    now = 0.0
    for pause_s, frame in offers:
        now += pause_s
        if traffic.judge(frame, now, lambda *_: False).outcome == "send":
            went[frame.sysid, frame.compid, frame.msgid].append(now)
    for (_, _, msgid), times in went.items():
        hz = {**MAX_HZ, 109: 0.7}.get(msgid)
        for first, since in enumerate(times if hz is not None else []):
            for last in range(first, len(times)):
                assert last - first + 1 <= RATE_BURST + hz * (times[last] - since) + 1e-3


@given(OFFERS, st.floats(20, 2000))
@settings(max_examples=examples(50))
def test_all_third_party_traffic_with_its_answers_keeps_to_its_share(offers, rate) -> None:
    """But for orders and emergencies, which may be ahead of it by their bursts."""
    traffic = ThirdPartyTraffic(ThirdPartyRules(streams="allow", logs="allow"), rate, 0.0)
    queue: TxQueue[tuple[int, int]] = TxQueue()
    queue.forwarded = traffic.budget
    sent: list[tuple[float, int]] = []
    now = 0.0
    for pause_s, frame in [*offers, (5.0, None)]:
        end = now + pause_s
        while (at := queue.next_send_time(now)) is not None and at <= end:
            now = max(now, at)
            popped = queue.pop(now)
            assert popped is not None
            if popped[1] is Priority.FORWARDED:
                sent.append((now, popped[0][0] + popped[0][1]))
        now = end
        if frame is None:
            continue
        admission = traffic.judge(frame, now, queue.holds)
        if admission.outcome == "send":
            size, answer = len(frame.raw), admission.answer_bytes
            entry = size, answer
            queue.offer(
                entry, admission.priority, now, admission.key, size=size, flow=admission.flow, answer_bytes=answer
            )
    for first, (since, _) in enumerate(sent):
        total = 0
        for at, size in sent[first:]:
            total += size
            assert (
                total
                <= max(traffic.budget.burst, size)
                + size * (size > traffic.budget.burst)
                + rate * 0.5 * (at - since)
                + 1
            )


@given(st.lists(st.tuples(st.floats(0, 2), st.integers(0, 0xFFFF), st.binary(max_size=40)), max_size=400))
@settings(max_examples=examples(20))
def test_memory_is_bounded_whatever_comes_from_whomever(offers: list[tuple[float, int, bytes]]) -> None:
    traffic = ThirdPartyTraffic(ThirdPartyRules(), 500.0, 0.0)
    now = 0.0
    for pause_s, source, payload in offers:
        now += pause_s
        for msgid in (20, 21, 76, 110, 111):
            traffic.judge(built(msgid, source, payload, 2), now, lambda *_: False)
    told = traffic.status(now)
    assert len(told["sources"]) <= MAX_SOURCES + 1
    assert traffic.waiting <= MAX_WAITING
    assert Counter(s["source"] for s in told["sources"])["others"] <= 1
