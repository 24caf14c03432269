"""Corrections for one radio: whole messages in fragment order, the newest of each kind, one base, within the budget."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.radio_link.corrections import (
    BURST_BYTES,
    MAX_AGE_S,
    MAX_WAITING,
    PATIENCE_S,
    SOURCE_SILENT_S,
    STREAM_AGE_S,
    STREAM_S,
    Corrections,
)
from skygcs.core.radio_link.rtcm import RtcmDeframer, content_of
from support.rtcm import STANDARD_1005, rtcm_frame, rtcm_payloads

PLENTY = 1e6
OVERHEAD = 12
BASE, OTHER_BASE = 0xFFBE, 0xFEBE


@dataclass(frozen=True)
class Fragment:
    """What stands for a frame: where it belongs, and the RTCM bytes in it."""

    message: int
    number: int
    last: bool
    data: bytes


def fragments(message: bytes, number: int) -> list[tuple[bytes, Fragment]]:
    payloads = list(rtcm_payloads(message, number))
    return [
        (p, Fragment(number, n, n == len(payloads) - 1, p[2:].ljust(p[1] if len(p) > 1 else 0, b"\0")))
        for n, p in enumerate(payloads)
    ]


def offer(
    corrections: Corrections[Fragment], message: bytes, number: int, now: float = 0.0, source: int = BASE
) -> list[bool]:
    return [corrections.offer(source, p, f, len(p) + OVERHEAD, now) for p, f in fragments(message, number)]


def popped(corrections: Corrections[Fragment], now: float) -> list[int]:
    """Numbers of the messages that go now, as far as the budget lets them; each is checked to be whole."""
    out = []
    while (entry := corrections.pop(now)) is not None:
        if entry[0].number == 0:
            out.append(entry[0].message)
    return out


def drained(corrections: Corrections[Fragment], now: float) -> list[Fragment]:
    """All that goes from ``now`` on, each at its time."""
    out = []
    while (at := corrections.next_send_time(now)) is not None:
        now = max(now, at)
        if (entry := corrections.pop(now)) is not None:  # or what waited is too old by then
            out.append(entry[0])
    return out


def messages(sent: list[Fragment]) -> list[int]:
    return [f.message for f in sent if f.last]


def test_a_message_goes_when_all_of_it_has_come_in_the_order_of_its_fragments() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    parts = fragments(rtcm_frame(1077, body_bytes=500), 7)
    assert [f.number for _, f in parts] == [0, 1, 2]
    for payload, fragment in (parts[2], parts[0]):
        assert corrections.offer(BASE, payload, fragment, len(payload) + OVERHEAD, 0.0)
        assert corrections.next_send_time(0.0) is None
        assert corrections.pop(0.0) is None
    payload, fragment = parts[1]
    assert corrections.offer(BASE, payload, fragment, len(payload) + OVERHEAD, 0.0)
    assert [(f.message, f.number) for f in drained(corrections, 0.0)] == [(7, 0), (7, 1), (7, 2)]
    assert corrections.status()["messages"] == 1
    assert corrections.status()["types"] == {"1077": 1}


@pytest.mark.parametrize("body_bytes, count", [(174, 1), (175, 2), (354, 3), (534, 4), (714, 4)])
def test_the_last_fragment_is_a_short_one_or_the_fourth(body_bytes: int, count: int) -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    message = rtcm_frame(1077, body_bytes=body_bytes)
    assert all(offer(corrections, message, 1))
    sent = drained(corrections, 0.0)
    assert len(sent) == count
    assert b"".join(f.data for f in sent) == message


def test_full_fragments_without_the_empty_one_are_a_message_if_they_are_an_rtcm_frame() -> None:
    """QGroundControl leaves the empty one out."""
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    for payload, fragment in fragments(rtcm_frame(1077, body_bytes=354), 1)[:2]:
        corrections.offer(BASE, payload, fragment, 194, 0.0)
    for payload, fragment in fragments(rtcm_frame(1087, body_bytes=200), 2):
        corrections.offer(BASE, payload, fragment, 194, 0.1)
    assert [f.message for f in drained(corrections, 0.1)] == [1, 1, 2, 2]


def test_the_rest_of_a_message_that_lost_a_fragment_is_dropped() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    for number in range(10):
        for payload, fragment in fragments(rtcm_frame(1077, epoch=number, body_bytes=500), number)[1:]:
            corrections.offer(BASE, payload, fragment, 194, float(number))
    assert drained(corrections, 10.0) == []
    assert corrections.status()["incomplete"] >= 5


def test_a_fragment_that_comes_twice_goes_once_and_another_message_of_its_sequence_starts_anew() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    old, new = (fragments(rtcm_frame(1077, epoch=e, body_bytes=300), n) for e, n in ((1, 1), (2, 33)))
    for (payload, fragment), taken in ((old[0], True), (old[0], False), (new[0], True), (new[1], True)):
        assert corrections.offer(BASE, payload, fragment, 194, 0.0) is taken
    assert [(f.message, f.number) for f in drained(corrections, 0.0)] == [(33, 0), (33, 1)]
    assert corrections.status()["repeated"] == 1
    assert corrections.status()["incomplete"] == 1


def test_a_stray_fragment_of_an_older_message_is_no_part_of_a_shorter_one_of_its_sequence() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    old, new = (fragments(rtcm_frame(1077, epoch=e, body_bytes=b), e) for e, b in ((1, 500), (33, 300)))
    for payload, fragment in (old[2], new[0], new[1]):
        assert corrections.offer(BASE, payload, fragment, 194, 0.0)
    sent = drained(corrections, 0.0)
    assert [(f.message, f.number) for f in sent] == [(33, 0), (33, 1)]


@pytest.mark.parametrize("payload", [b"", b"\x08", b"\x01\x00", b"\x08\xb5" + b"x" * 180, b"\x08\xff" + b"x" * 180])
def test_what_is_no_fragment_is_refused(payload: bytes) -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    assert not corrections.offer(BASE, payload, Fragment(0, 0, True, b""), 20, 0.0)
    assert corrections.status()["malformed"] == 1
    assert corrections.next_send_time(0.0) is None


def test_a_newer_message_of_a_kind_takes_the_place_of_one_that_waits() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    offer(corrections, rtcm_frame(1077, epoch=1), 1)
    offer(corrections, rtcm_frame(1087, epoch=1), 2)
    offer(corrections, rtcm_frame(1077, epoch=2), 3, 1.0)
    assert messages(drained(corrections, 1.0)) == [3, 2]
    assert corrections.status()["replaced"] == 1


def test_parts_of_one_epoch_other_stations_and_other_satellites_are_no_newer_ones() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    for number, frame in enumerate(
        (
            rtcm_frame(1077, epoch=1, fill=1),
            rtcm_frame(1077, epoch=1, fill=2),
            rtcm_frame(1019, station=4 << 6),
            rtcm_frame(1019, station=5 << 6),
            rtcm_frame(4072, station=0),
            rtcm_frame(4072, station=1),
        )
    ):
        offer(corrections, frame, number)
    assert messages(drained(corrections, 0.0)) == [0, 1, 2, 3, 4, 5]


def test_several_messages_under_one_sequence_give_way_only_to_all_of_their_kinds() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    offer(corrections, rtcm_frame(1005) + rtcm_frame(1077, epoch=1), 1)
    offer(corrections, rtcm_frame(1077, epoch=2), 2, 1.0)
    assert len(corrections) == 2
    offer(corrections, rtcm_frame(1077, epoch=3) + rtcm_frame(1005), 3, 2.0)
    assert messages(drained(corrections, 2.0)) == [3]


def test_the_newest_burst_goes_first_in_its_order() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    offer(corrections, rtcm_frame(1005), 1, 0.0)
    offer(corrections, rtcm_frame(1230), 2, 0.05)
    offer(corrections, rtcm_frame(1077, epoch=1), 3, 1.0)
    offer(corrections, rtcm_frame(1087, epoch=1), 4, 1.1)
    assert messages(drained(corrections, 1.1)) == [3, 4, 1, 2]


def test_a_message_that_has_begun_is_finished_before_a_newer_one() -> None:
    corrections: Corrections[Fragment] = Corrections(200.0, 0.0)
    offer(corrections, rtcm_frame(1077, epoch=1, body_bytes=300), 1)
    assert popped(corrections, 0.0) == [1]
    offer(corrections, rtcm_frame(1077, epoch=2, body_bytes=300), 2, 0.1)
    assert [(f.message, f.number) for f in drained(corrections, 0.1)] == [(1, 1), (2, 0), (2, 1)]


def test_under_lasting_shortage_every_kind_goes_as_new_as_it_can_be() -> None:
    """A base of 1.2 kB/s, the position once in 10 s, on 165 B/s."""
    corrections: Corrections[Fragment] = Corrections(165.0, 0.0)
    kinds = [1077, 1087, 1097, 1127]
    offered: dict[int, tuple[int, float]] = {}
    sent: list[tuple[int, float]] = []
    last_of: dict[int, int] = {}
    number = 0
    for step in range(600):
        now = step / 10
        if step % 10 == 0:
            burst = [1005] * (step % 100 == 0) + kinds
            for type_ in burst:
                number += 1
                offered[number] = (type_, now)
                offer(corrections, rtcm_frame(type_, epoch=step, body_bytes=19 if type_ == 1005 else 290), number, now)
        while (entry := corrections.pop(now)) is not None:
            fragment = entry[0]
            type_, at = offered[fragment.message]
            if fragment.number == 0:
                newest = max(n for n, (t, _) in offered.items() if t == type_)
                assert fragment.message == newest
                assert fragment.message > last_of.get(type_, 0)
                last_of[type_] = fragment.message
            if fragment.last:
                sent.append((type_, now - at))
    counts = {t: sum(1 for kind, _ in sent if kind == t) for t in [1005, *kinds]}
    assert counts[1005] >= 5
    assert all(counts[t] >= 5 for t in kinds)
    assert max(age for t, age in sent if t != 1005) < 3.0


def test_pieces_of_a_stream_go_as_they_came_and_so_does_all_of_its_source() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    stream = rtcm_frame(1005) + rtcm_frame(1077, epoch=1, body_bytes=600) + rtcm_frame(1087, epoch=1)
    pieces = [stream[:36], stream[36:136], stream[136:316], stream[316:]]
    for number, piece in enumerate(pieces):
        offer(corrections, piece, number, number * 0.5)
    offer(corrections, rtcm_frame(1005), 4, 2.0)
    sent = drained(corrections, 2.0)
    assert messages(sent) == [0, 1, 2, 3, 4]
    assert RtcmDeframer().feed(b"".join(f.data for f in sent)) == [
        rtcm_frame(1005),
        rtcm_frame(1077, epoch=1, body_bytes=600),
        rtcm_frame(1087, epoch=1),
        rtcm_frame(1005),
    ]


def test_pieces_of_a_stream_do_not_wait_for_long() -> None:
    corrections: Corrections[Fragment] = Corrections(20.0, 0.0)
    for number in range(20):
        offer(corrections, b"\x01" * 150, number, number * 0.5)
    assert popped(corrections, 19 * 0.5) == [19 - int(STREAM_AGE_S / 0.5)]
    assert corrections.status()["expired"] > 0


def test_whole_messages_are_told_apart_again_when_the_pieces_have_ended() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    offer(corrections, b"piece", 0)
    drained(corrections, 0.0)
    for number in (1, 2):
        offer(corrections, rtcm_frame(1077, epoch=number), number, STREAM_S + number)
    assert messages(drained(corrections, STREAM_S + 2)) == [2]


def test_one_base_at_a_time() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    assert all(offer(corrections, rtcm_frame(1005), 1, 0.0, BASE))
    assert offer(corrections, rtcm_frame(1005), 2, 0.5, OTHER_BASE) == [False]
    assert all(offer(corrections, rtcm_frame(1077), 3, 5.0, BASE))
    assert offer(corrections, rtcm_frame(1005), 4, SOURCE_SILENT_S + 4.9, OTHER_BASE) == [False]
    assert corrections.status()["other_source"] == 2
    assert all(offer(corrections, rtcm_frame(1087), 5, SOURCE_SILENT_S + 5.0, OTHER_BASE))
    assert corrections.source == OTHER_BASE
    assert messages(drained(corrections, SOURCE_SILENT_S + 5.0)) == [5]  # and nothing more of the first


def test_what_waits_too_long_is_not_sent() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    offer(corrections, STANDARD_1005, 1)
    assert corrections.next_send_time(MAX_AGE_S) == MAX_AGE_S
    assert corrections.next_send_time(MAX_AGE_S + 0.1) is None
    assert corrections.pop(MAX_AGE_S + 0.1) is None
    assert corrections.status()["expired"] == 1


def test_a_kind_that_waited_long_goes_before_newer_messages() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    for number in range(4):
        offer(corrections, rtcm_frame(1005), number, number * 2.0)
    now = PATIENCE_S + 1.0
    offer(corrections, rtcm_frame(1077), 9, now)
    assert messages(drained(corrections, now)) == [3, 9]


def test_nothing_goes_without_a_rate() -> None:
    corrections: Corrections[Fragment] = Corrections(PLENTY, 0.0)
    offer(corrections, STANDARD_1005, 1)
    corrections.set_rate(0.0, 0.0)
    assert corrections.next_send_time(0.0) is None
    assert corrections.pop(0.0) is None
    assert offer(corrections, STANDARD_1005, 2) == [False]
    assert corrections.status()["no_budget"] == 1
    corrections.set_rate(PLENTY, 1.0)
    assert messages(drained(corrections, 1.0)) == [1]


def test_clear_forgets_what_waits_what_has_begun_and_what_is_in_the_making() -> None:
    corrections: Corrections[Fragment] = Corrections(200.0, 0.0)
    offer(corrections, rtcm_frame(1077, body_bytes=300), 1)
    assert popped(corrections, 0.0) == [1]
    offer(corrections, rtcm_frame(1087, body_bytes=300), 2)
    half = fragments(rtcm_frame(1097, body_bytes=300), 3)
    corrections.offer(BASE, half[0][0], half[0][1], 194, 0.0)
    assert corrections.clear() == 3
    corrections.offer(BASE, half[1][0], half[1][1], 194, 0.0)
    assert drained(corrections, 5.0) == []
    assert corrections.status()["dropped"] == 2


EVENT = st.tuples(
    st.sampled_from([1005, 1077, 1087, 1097, 1230, 0]),
    st.integers(min_value=7, max_value=714),
    st.floats(min_value=0.0, max_value=3.0),
    st.booleans(),
)


@given(st.lists(EVENT, max_size=60), st.floats(min_value=50.0, max_value=5000.0))
def test_what_goes_is_whole_fresh_within_the_budget_and_bounded(
    events: list[tuple[int, int, float, bool]], bytes_per_s: float
) -> None:
    corrections: Corrections[Fragment] = Corrections(bytes_per_s, 0.0)
    now = 0.0
    sizes: list[tuple[float, int]] = []
    sent: list[Fragment] = []
    kind_of: dict[int, int] = {}
    whole: dict[int, bytes] = {}

    def send_until(until: float, now: float) -> None:
        while (at := corrections.next_send_time(now)) is not None and at <= until:
            now = max(now, at)
            if (entry := corrections.pop(now)) is None:
                continue  # too old by now
            sizes.append((now, entry[1]))
            if entry[0].number == 0 and kind_of[entry[0].message]:
                known = kind_of[entry[0].message]
                assert entry[0].message == max(n for n, k in kind_of.items() if k == known and n in whole)
            sent.append(entry[0])

    for number, (type_, body_bytes, pause_s, lost) in enumerate(events):
        send_until(now + pause_s, now)
        now += pause_s
        message = rtcm_frame(type_, epoch=number, body_bytes=body_bytes) if type_ else b"\x02" * body_bytes
        parts = fragments(message, number)
        kind_of[number] = type_ and content_of(message).kind
        for payload, fragment in parts[: -1 if lost and len(parts) > 1 else None]:
            corrections.offer(BASE, payload, fragment, len(payload) + OVERHEAD, now)
            assert len(corrections) <= 4 * (MAX_WAITING + 1)
        if not (lost and len(parts) > 1):
            whole[number] = message
        if not type_ or 0 in kind_of.values():
            kind_of = dict.fromkeys(kind_of, 0)  # pieces of a stream: what is fresh is another matter
    send_until(now + 1e4, now)

    rest = list(sent)
    while rest:  # one whole message after the other
        number = rest[0].message
        count = next(n for n, f in enumerate(rest) if f.last) + 1
        assert [(f.message, f.number) for f in rest[:count]] == [(number, n) for n in range(count)]
        assert b"".join(f.data for f in rest[:count]) == whole[number]
        del rest[:count]
    for first in range(len(sizes)):
        total = 0
        for at, size in sizes[first:]:
            total += size
            assert total <= bytes_per_s * (at - sizes[first][0]) + BURST_BYTES + 0.01
