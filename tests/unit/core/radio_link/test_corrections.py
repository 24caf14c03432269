"""Corrections for one radio: whole messages, the newest of each kind, one base, within the budget."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.radio_link.corrections import (
    BURST_BYTES,
    MAX_AGE_S,
    MAX_KINDS,
    MAX_PARTS,
    SOURCE_SILENT_S,
    Corrections,
    RtcmDeframer,
    content_of,
)
from support.rtcm import STANDARD_1005, rtcm_frame, rtcm_payloads
from support.table import each

PLENTY = 1e6
OVERHEAD = 14
BASE, OTHER_BASE = 0xFFBE, 0xFEBE


def offer(corrections: Corrections, message: bytes, now: float = 0.0, source: int = BASE, sequence: int = 0) -> bool:
    """As a ground station sends it."""
    return all([corrections.offer(source, payload, now) for payload in rtcm_payloads(message, sequence)])


class Receiver:
    """Puts the fragments together again, as ArduPilot does: the last one is short, or the fourth."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []
        self.sizes: list[tuple[float, int]] = []
        self._parts: list[bytes] = []
        self._sequence = -1

    def take(self, corrections: Corrections, now: float) -> bool:
        """One fragment, if one goes now."""
        fragment = corrections.pop(now)
        if fragment is None:
            return False
        flags, length, data = fragment.values["flags"], fragment.values["len"], fragment.values["data"]
        assert isinstance(flags, int) and isinstance(length, int) and isinstance(data, bytes)
        corrections.charge(length + OVERHEAD, now)
        self.sizes.append((now, length + OVERHEAD))
        if not flags & 1:
            assert not self._parts
            self.messages.append(data[:length])
            return True
        assert flags >> 1 & 3 == len(self._parts)
        assert not self._parts or flags >> 3 == self._sequence
        self._sequence = flags >> 3
        self._parts.append(data[:length])
        if length < 180 or len(self._parts) == 4:
            self.messages.append(b"".join(self._parts))
            self._parts = []
        return True

    def drain(self, corrections: Corrections, now: float, until: float = 1e4) -> list[bytes]:
        """All messages that go from ``now`` on, each fragment at its time."""
        before = len(self.messages)
        while (at := corrections.next_send_time(now)) is not None and at <= until:
            now = max(now, at)
            self.take(corrections, now)
        return self.messages[before:]


@each("body_bytes, fragments", [(174, 1), (175, 2), (354, 3), (500, 3), (534, 4), (714, 4)])
def test_a_message_goes_whole_when_all_of_it_has_come(body_bytes: int, fragments: int) -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    message = rtcm_frame(1077, body_bytes=body_bytes)
    come = 0
    for payload in rtcm_payloads(message, 7):
        assert (corrections.next_send_time(0.0) is None) == (come < len(message))
        assert corrections.offer(BASE, payload, 0.0)
        come += payload[1] if len(payload) > 1 else 0  # an empty last one is trimmed
    assert len(corrections) == fragments
    assert receiver.drain(corrections, 0.0) == [message]
    assert len(receiver.sizes) == fragments
    status = corrections.status()
    assert (status["messages"], status["fragments"], status["types"]) == (1, fragments, {"1077": 1})
    assert status["bytes"] == len(message) + fragments * OVERHEAD


def offer_stream(corrections: Corrections, stream: bytes, piece: int) -> None:
    """Cut anywhere, in fragments that are none of one message."""
    for at in range(0, len(stream), piece):
        data = stream[at : at + piece]
        assert corrections.offer(BASE, bytes([0, len(data)]) + data, 0.0)


@each("piece", [1, 50, 100, 180])
def test_however_the_sender_cut_its_stream_whole_messages_go(piece: int) -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    sent = [rtcm_frame(1005), rtcm_frame(1077, epoch=1, body_bytes=600), rtcm_frame(1087, epoch=1)]
    offer_stream(corrections, b"".join(sent), piece)
    assert receiver.drain(corrections, 0.0) == sent


def test_full_fragments_without_the_empty_one_are_a_message() -> None:
    """QGroundControl leaves the empty one out."""
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    messages = [rtcm_frame(1077, body_bytes=354), rtcm_frame(1087, body_bytes=200)]
    for payload in [*list(rtcm_payloads(messages[0], 1))[:2], *rtcm_payloads(messages[1], 2)]:
        corrections.offer(BASE, payload, 0.0)
    assert receiver.drain(corrections, 0.0) == messages


def test_a_message_that_lost_a_fragment_is_left_out_and_costs_none_that_follow() -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    offer(corrections, rtcm_frame(1005))
    for payload in list(rtcm_payloads(rtcm_frame(1077, epoch=1, body_bytes=500), 1))[1:]:
        corrections.offer(BASE, payload, 0.0)
    for payload in list(rtcm_payloads(rtcm_frame(1077, epoch=2, body_bytes=500), 2))[:-1]:
        corrections.offer(BASE, payload, 0.0)
    rest = [rtcm_frame(type_, epoch=3, body_bytes=300) for type_ in (1087, 1097)]
    for message in rest:
        offer(corrections, message)
    assert receiver.drain(corrections, 0.0) == [rtcm_frame(1005), *rest]
    assert corrections.status()["skipped_bytes"] > 500


@each(("payload", "malformed"), [(b"\x08\xb5" + b"x" * 180, 1), (b"\x08\xff" + b"x" * 180, 1), (b"", 0), (b"\x08", 0)])
def test_what_cannot_be_a_fragment_is_refused_and_what_holds_no_message_brings_nothing(payload, malformed) -> None:
    corrections = Corrections(PLENTY, 0.0)
    assert not malformed or not corrections.offer(BASE, payload, 0.0)
    for noise in (b"\x01\x00", b"\x00\x05noise", *([] if malformed else [payload])):
        corrections.offer(BASE, noise, 0.0)
    assert corrections.next_send_time(0.0) is None
    assert malformed == 0 or corrections.status()["malformed"] == 1


def test_a_message_that_fits_into_no_four_fragments_is_left_out_and_counted() -> None:
    corrections = Corrections(PLENTY, 0.0)
    offer_stream(corrections, rtcm_frame(1077, body_bytes=715), 180)
    assert corrections.next_send_time(0.0) is None
    assert corrections.status()["too_long"] == 1


def test_a_newer_message_takes_the_place_of_one_of_its_kind() -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    for now, (type_, epoch) in enumerate([(1077, 1), (1087, 1), (1077, 2)]):
        offer(corrections, rtcm_frame(type_, epoch=epoch), float(now))
    assert receiver.drain(corrections, 2.0) == [rtcm_frame(1077, epoch=2), rtcm_frame(1087, epoch=1)]
    assert corrections.status()["replaced"] == 1


def test_parts_of_one_epoch_other_stations_and_other_satellites_are_no_newer_ones() -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    messages = [rtcm_frame(1077, epoch=1, fill=fill) for fill in (1, 2)]
    messages += [rtcm_frame(1019, station=station << 6) for station in (4, 5)]
    messages += [rtcm_frame(4072, station=station) for station in (0, 1)]
    for message in messages:
        offer(corrections, message)
    assert receiver.drain(corrections, 0.0) == messages


def test_a_message_that_has_begun_is_finished_before_a_newer_one() -> None:
    corrections, receiver = Corrections(200.0, 0.0), Receiver()
    old, new = (rtcm_frame(1077, epoch=epoch, body_bytes=300) for epoch in (1, 2))
    offer(corrections, old)
    assert receiver.take(corrections, 0.0) and not receiver.take(corrections, 0.0)
    offer(corrections, new, 0.1)
    assert receiver.drain(corrections, 0.1) == [old, new]


def test_under_lasting_shortage_every_kind_goes_as_new_as_it_can_be() -> None:
    """A base of 1.2 kB/s, the position once in 10 s, on 165 B/s."""
    corrections, receiver = Corrections(165.0, 0.0), Receiver()
    kinds, ages = [1077, 1087, 1097, 1127], {}
    counts = dict.fromkeys([1005, *kinds], 0)
    for second in range(60):
        now = float(second)
        for type_ in [1005] * (second % 10 == 0) + kinds:
            offer(corrections, rtcm_frame(type_, epoch=second, body_bytes=19 if type_ == 1005 else 290), now)
        before = len(receiver.sizes)
        for message in receiver.drain(corrections, now, now + 0.999):
            content = content_of(message)
            counts[content.type] += 1
            if content.epoch is not None:
                ages[second, content.type] = receiver.sizes[-1][0] - content.epoch
        assert len(receiver.sizes) >= before
    assert counts[1005] >= 5
    assert all(counts[t] >= 5 for t in kinds)
    assert max(ages.values()) < 4.0


def test_with_room_for_all_messages_go_in_the_order_of_their_base() -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    for second in range(5):
        epoch = [rtcm_frame(type_, epoch=second) for type_ in (1077, 1087, 1097, 1005)]
        for message in epoch:
            offer(corrections, message, float(second))
        assert receiver.drain(corrections, float(second)) == epoch


def test_one_base_at_a_time() -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    assert offer(corrections, rtcm_frame(1005), 0.0, BASE)
    assert not offer(corrections, rtcm_frame(1005), 0.5, OTHER_BASE)
    assert offer(corrections, rtcm_frame(1077)[:20], 5.0, BASE)
    assert not offer(corrections, rtcm_frame(1005), SOURCE_SILENT_S + 4.9, OTHER_BASE)
    assert corrections.status()["other_source"] == 2
    assert offer(corrections, rtcm_frame(1087), SOURCE_SILENT_S + 5.0, OTHER_BASE)
    assert corrections.source == OTHER_BASE
    assert receiver.drain(corrections, SOURCE_SILENT_S + 5.0) == [rtcm_frame(1087)], "and nothing more of the first"


def test_what_waits_too_long_is_not_sent() -> None:
    corrections = Corrections(PLENTY, 0.0)
    offer(corrections, STANDARD_1005)
    assert corrections.next_send_time(MAX_AGE_S) == MAX_AGE_S
    assert corrections.next_send_time(MAX_AGE_S + 0.1) is None
    assert corrections.pop(MAX_AGE_S + 0.1) is None
    assert corrections.status()["expired"] == 1


def test_nothing_goes_without_a_rate() -> None:
    corrections, receiver = Corrections(PLENTY, 0.0), Receiver()
    offer(corrections, STANDARD_1005)
    corrections.set_rate(0.0, 0.0)
    assert corrections.next_send_time(0.0) is None and corrections.pop(0.0) is None
    assert not offer(corrections, STANDARD_1005)
    assert corrections.status()["no_budget"] == 1
    corrections.set_rate(PLENTY, 1.0)
    assert receiver.drain(corrections, 1.0) == [STANDARD_1005]


def test_clear_forgets_what_waits_what_has_begun_and_what_has_come_in_part() -> None:
    corrections, receiver = Corrections(200.0, 0.0), Receiver()
    offer(corrections, rtcm_frame(1077, body_bytes=300))
    assert receiver.take(corrections, 0.0)
    offer(corrections, rtcm_frame(1087, body_bytes=300))
    half = list(rtcm_payloads(rtcm_frame(1097, body_bytes=300), 3))
    corrections.offer(BASE, half[0], 0.0)
    assert corrections.clear() == 3
    assert corrections.status()["dropped"] == 2
    corrections.offer(BASE, half[1], 0.0)
    assert corrections.next_send_time(5.0) is None


EVENT = st.tuples(
    st.sampled_from([1005, 1077, 1087, 1097, 1230, 4072, 0]),
    st.integers(min_value=7, max_value=714),
    st.integers(0, 63),
    st.floats(min_value=0.0, max_value=3.0),
    st.booleans(),
)


@given(st.lists(EVENT, max_size=60), st.floats(min_value=50.0, max_value=5000.0))
def test_what_goes_is_whole_new_within_the_budget_and_bounded(events, bytes_per_s) -> None:
    corrections, receiver = Corrections(bytes_per_s, 0.0), Receiver()
    now, offered = 0.0, set()
    for number, (type_, body_bytes, station, pause_s, lost) in enumerate(events):
        receiver.drain(corrections, now, now + pause_s)
        now += pause_s
        message = rtcm_frame(type_, station=station, epoch=number, body_bytes=body_bytes) if type_ else b"\x02" * 30
        parts = list(rtcm_payloads(message, number))
        for payload in parts[: -1 if lost and len(parts) > 1 else None]:
            corrections.offer(BASE, payload, now)
        offered.add(message)
        assert len(corrections) <= 4 * (MAX_KINDS * MAX_PARTS + 1)
    receiver.drain(corrections, now)
    assert set(receiver.messages) <= offered
    assert len(set(receiver.messages)) == len(receiver.messages)
    assert RtcmDeframer().feed(b"".join(receiver.messages)) == receiver.messages
    for first, (since, _) in enumerate(receiver.sizes):
        total = 0
        for at, size in receiver.sizes[first:]:
            total += size
            assert total <= bytes_per_s * (at - since) + BURST_BYTES + 0.01
