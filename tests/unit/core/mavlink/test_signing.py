"""Message signing, held against pymavlink's own, against frames that Mission Planner signed, and against tampering."""

from __future__ import annotations

import itertools
import json
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.mavlink.signing import (
    MAX_AHEAD_S,
    MAX_STREAMS,
    MAX_TIMESTAMP,
    NEW_STREAM_TICKS,
    TICKS_PER_S,
    Gate,
    SignatureStreams,
    SignatureVerdict,
    SigningClock,
    is_signed_with,
    key_from_passphrase,
    key_id,
    link_id_of,
    sign,
    timestamp_at,
    timestamp_of,
    unix_time_of,
)
from support.examples import examples
from support.frames import dialect, heartbeat, offline, random_values
from support.public_data import public_file
from support.pymav import Outbox
from support.table import each

KEY = bytes(range(1, 33))
NOW_UNIX_S = 1_795_000_000.0
NOW = timestamp_at(NOW_UNIX_S)


def pymav(key: bytes = KEY, *, timestamp: int = NOW, link_id: int = 3, sysid: int = 7) -> Any:
    """A pymavlink endpoint that signs, and checks what it parses."""
    end = mav.MAVLink(Outbox(), srcSystem=sysid, srcComponent=1)
    end.robust_parsing = True
    end.signing.secret_key = key
    end.signing.timestamp = timestamp
    end.signing.link_id = link_id
    end.signing.sign_outgoing = True
    return end


def packed(end: Any, message: Any) -> bytes:
    end.file.data = b""
    end.send(message)
    return bytes(end.file.data)


def one(raw: bytes) -> Frame:
    [frame] = FrameParser(offline()).feed_datagram(raw)
    assert frame.raw == raw
    return frame


def ours(timestamp: int, *, key: bytes = KEY, link_id: int = 0, sysid: int = 7, seq: int = 0) -> Frame:
    info = dialect().find("HEARTBEAT")
    return one(sign(heartbeat(sysid, seq=seq), info.crc_extra_byte, key, link_id, timestamp))


def gate(*, clock: SigningClock | None = None, allowed: frozenset[int] | None = frozenset()) -> Gate:
    clock = clock or SigningClock()
    return Gate(KEY, clock, SignatureStreams(clock), allowed)


# -- what others signed


@each("key", [bytes(32), KEY])
@each("stamp", [0, 28309687961616, MAX_TIMESTAMP - 1])
def test_a_frame_that_pymavlink_signed_is_its_own(key: bytes, stamp: int) -> None:
    """Mission Planner signs with an all-zero key when none is set."""
    encoder = mav.MAVLink(None, 255, 190)
    encoder.seq = 32
    encoder.signing.secret_key, encoder.signing.link_id = key, 56
    encoder.signing.timestamp, encoder.signing.sign_outgoing = stamp, True
    raw = bytes(mav.MAVLink_statustext_message(6, b"Mission Planner 1.3.80").pack(encoder))
    frame = one(raw)
    assert frame.signed and frame.info is not None
    assert (frame.sysid, frame.name, link_id_of(raw), timestamp_of(raw)) == (255, "STATUSTEXT", 56, stamp)
    assert is_signed_with(raw, key) and not is_signed_with(raw, bytes(31) + b"1")
    unsigned = encode(frame.info, frame.fields(), sysid=255, compid=190, seq=32)
    assert sign(unsigned, frame.info.crc_extra_byte, key, 56, stamp) == raw


def test_a_frame_that_mission_planner_signed_is_its_own() -> None:
    vectors = json.loads(public_file("vectors/signed_real.json").read_text())["frames"]
    assert len(vectors) == 7
    for vector in vectors:
        frame = one(bytes.fromhex(vector["frame"]))
        assert frame.signed and frame.info is not None
        assert (frame.sysid, frame.name, link_id_of(frame.raw)) == (vector["sysid"], vector["msg"], vector["link_id"])
        assert timestamp_of(frame.raw) == vector["timestamp"]
        assert is_signed_with(frame.raw, bytes.fromhex(vector["valid_with_key"]))
        assert not is_signed_with(frame.raw, KEY)
        # the same bytes come out when it is signed here
        unsigned = encode(frame.info, frame.fields(), sysid=frame.sysid, compid=frame.compid, seq=frame.seq)
        crc_extra = frame.info.crc_extra_byte
        assert sign(unsigned, crc_extra, bytes(32), vector["link_id"], vector["timestamp"]) == frame.raw


def test_times_and_keys_are_those_of_other_ground_stations() -> None:
    assert unix_time_of(28309687961616) == pytest.approx(1703167279.61616)
    assert timestamp_at(1703167279.61616) == pytest.approx(28309687961616, abs=1)
    assert (timestamp_at(0.0), timestamp_at(1e12)) == (0, MAX_TIMESTAMP)
    # sha256("test"), as QGroundControl's and MAVProxy's tests have it
    assert key_from_passphrase("test").hex() == "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
    assert key_id(KEY) != key_id(bytes(32)), "a key id tells keys apart and is no part of them"
    assert key_id(KEY) not in KEY.hex() and len(key_id(KEY)) == 8


# -- pymavlink both ways


@given(st.integers(0, 2**32 - 1), st.integers(0, 255), st.integers(1, 2**48 - 2), st.binary(min_size=32, max_size=32))
@settings(max_examples=examples(60))
def test_pymavlink_takes_what_is_signed_here(seed: int, link_id: int, timestamp: int, key: bytes) -> None:
    rng = random.Random(seed)
    info = dialect().messages[rng.choice(sorted(set(dialect().messages) & set(mav.mavlink_map)))]
    values = random_values(info, rng)
    raw = sign(encode(info, values, sysid=9, compid=4, seq=seed & 0xFF), info.crc_extra_byte, key, link_id, timestamp)
    end = pymav(key, timestamp=0)
    [message] = end.parse_buffer(raw)
    assert message.get_msgId() == info.msgid, message
    assert message.get_signed() and end.signing.goodsig_count == 1
    assert end.signing.timestamp == timestamp


def test_what_pymavlink_signs_is_taken_here_in_order_and_refused_with_another_key() -> None:
    end, check = pymav(), gate().check
    for n in range(20):
        frame = one(packed(end, mav.MAVLink_attitude_message(n, 0.1, 0.2, 0.3, 0, 0, 0)))
        assert [check(frame, NOW) for _ in range(2)] == [SignatureVerdict.SIGNED, SignatureVerdict.REPLAYED]
    stranger = pymav(bytes(31) + b"\1")
    assert check(one(packed(stranger, mav.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))), NOW) is SignatureVerdict.FORGED
    [message] = stranger.parse_buffer(ours(NOW + 5).raw)
    assert message.get_type() == "BAD_DATA"


# -- tampering


@given(st.data())
@settings(max_examples=examples(300))
def test_any_flipped_bit_is_refused(data: st.DataObject) -> None:
    """Flipped behind the parser, which would see most of it by the CRC: the signature covers every bit."""
    frame = ours(NOW)
    bit = data.draw(st.integers(0, 8 * len(frame.raw) - 1))
    raw = bytearray(frame.raw)
    raw[bit // 8] ^= 1 << bit % 8
    changed = Frame(bytes(raw), frame.seq, frame.sysid, frame.compid, frame.msgid, frame.info)
    assert gate().check(changed, NOW) in (SignatureVerdict.FORGED, SignatureVerdict.UNSIGNED)


@given(st.binary(min_size=32, max_size=32))
def test_no_other_key_fits(key: bytes) -> None:
    assert is_signed_with(ours(NOW).raw, key) is (key == KEY)


def test_a_signature_cut_off_makes_it_unsigned_and_the_crc_wrong() -> None:
    raw = ours(NOW).raw
    assert FrameParser(offline()).feed_datagram(raw[:-13]) == []
    assert FrameParser(offline()).feed_datagram(raw[:2] + b"\0" + raw[3:-13]) == []


@each("raw", [heartbeat(7, version=1), ours(NOW).raw, heartbeat(7)[:-1]])
def test_what_cannot_be_signed_is_refused(raw: bytes) -> None:
    with pytest.raises(ValueError, match="unsigned MAVLink 2"):
        sign(raw, b"\x32", KEY, 0, 1)


# -- replay and clocks


@given(st.lists(st.integers(NOW - 3 * NEW_STREAM_TICKS, NOW + 3 * NEW_STREAM_TICKS), max_size=40))
def test_a_stream_only_ever_rises(times: list[int]) -> None:
    clock = SigningClock(NOW)
    check = gate(clock=clock).check
    last: int | None = None
    for at in times:
        verdict = check(ours(at), 0)
        if last is None:
            assert verdict is (SignatureVerdict.SIGNED if at + NEW_STREAM_TICKS >= NOW else SignatureVerdict.STALE)
        else:
            assert verdict is (SignatureVerdict.SIGNED if at > last else SignatureVerdict.REPLAYED)
        if verdict is SignatureVerdict.SIGNED:
            last = at
        assert clock.timestamp == max(NOW, last or 0)


def test_streams_are_told_apart_by_link_id_system_and_component() -> None:
    check = gate().check
    verdicts = [check(ours(NOW, **stream), NOW) for stream in ({}, {"link_id": 1}, {"sysid": 8}, {})]
    assert verdicts == [SignatureVerdict.SIGNED] * 3 + [SignatureVerdict.REPLAYED]


def test_our_own_clock_follows_the_furthest_and_refuses_new_streams_behind_it() -> None:
    clock = SigningClock()
    check = gate(clock=clock).check
    ahead = NOW + 3600 * TICKS_PER_S
    assert check(ours(ahead), NOW) is SignatureVerdict.SIGNED
    assert clock.stamp(NOW) == ahead + 1
    oldest = ahead + 1 - NEW_STREAM_TICKS
    verdicts = [check(ours(at, sysid=8), NOW) for at in (NOW, oldest - 1, oldest)]
    assert verdicts == [SignatureVerdict.STALE, SignatureVerdict.STALE, SignatureVerdict.SIGNED]
    assert check(ours(MAX_TIMESTAMP, key=bytes(32)), NOW) is SignatureVerdict.FORGED
    assert clock.timestamp == ahead + 1, "a wrong signature moves no clock"


@given(st.lists(st.integers(0, MAX_TIMESTAMP - 100), min_size=2, max_size=30))
def test_our_timestamps_rise_whatever_the_wall_clock_does(walls: list[int]) -> None:
    clock = SigningClock()
    stamps = [clock.stamp(wall) for wall in walls]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert all(stamp >= wall for stamp, wall in zip(stamps, walls, strict=True))


def test_unsigned_frames_pass_by_their_id_only_and_unknown_messages_are_checked_as_any_other() -> None:
    frame, known = one(heartbeat(7)), ours(NOW)
    assert gate().check(frame, NOW) is SignatureVerdict.UNSIGNED
    assert gate(allowed=frozenset({0})).check(frame, NOW) is SignatureVerdict.ALLOWED
    assert gate(allowed=None).check(frame, NOW) is SignatureVerdict.ALLOWED
    assert gate(allowed=None).check(ours(NOW, key=bytes(32)), NOW) is SignatureVerdict.FORGED
    unknown = Frame(known.raw, known.seq, known.sysid, known.compid, known.msgid, None)
    assert gate().check(unknown, NOW) is SignatureVerdict.SIGNED


def test_the_table_of_streams_is_bounded_and_loses_nothing_that_protects() -> None:
    clock = SigningClock(NOW)
    streams = SignatureStreams(clock)
    for n in range(MAX_STREAMS):
        assert streams.check(n % 256, n // 256 + 1, 1, NOW + n) is SignatureVerdict.SIGNED
    assert streams.check(0, 99, 1, NOW + MAX_STREAMS) is SignatureVerdict.CROWDED
    oldest = NOW + 5  # of those that are not forgotten
    assert streams.check(0, 1, 1, oldest + NEW_STREAM_TICKS) is SignatureVerdict.SIGNED
    assert streams.check(0, 98, 1, oldest + NEW_STREAM_TICKS) is SignatureVerdict.SIGNED
    assert streams.check(5, 1, 1, oldest) is SignatureVerdict.REPLAYED
    assert streams.check(4, 1, 1, oldest - 1) is SignatureVerdict.STALE  # forgotten, and refused all the same
    assert len(streams) == MAX_STREAMS - 4 + 1


# -- a stamp from the future

LIMIT_S = MAX_AHEAD_S


def signed_at(timestamp: int, *, link_id: int = 3, sysid: int = 7) -> Frame:
    """A heartbeat signed by pymavlink at this time."""
    end = pymav(timestamp=timestamp, link_id=link_id, sysid=sysid)
    raw = end.heartbeat_encode(2, 3, 0, 0, 4, 3).pack(end)
    (frame,) = FrameParser(dialect()).feed_datagram(bytes(raw))
    return frame


def limited(clock: SigningClock) -> Gate:
    return Gate(KEY, clock, SignatureStreams(clock), frozenset(), LIMIT_S)


@each("ahead_s", [0, 60, 14 * 3600, LIMIT_S, LIMIT_S + 1, 365 * 86400])
def test_a_stamp_far_ahead_of_the_computers_clock_is_not_believed(ahead_s: float) -> None:
    clock, believed = SigningClock(), ahead_s <= LIMIT_S
    verdict = limited(clock).check(signed_at(NOW + int(ahead_s * TICKS_PER_S)), NOW)
    assert verdict is (SignatureVerdict.SIGNED if believed else SignatureVerdict.AHEAD)
    assert clock.timestamp - NOW <= (ahead_s * TICKS_PER_S + 1 if believed else 0)


def test_a_stamp_of_the_year_2104_pins_no_clock_and_the_next_honest_frame_counts() -> None:
    clock = SigningClock()
    gate = limited(clock)
    assert gate.check(signed_at(MAX_TIMESTAMP - 1), NOW) is SignatureVerdict.AHEAD
    assert clock.timestamp == NOW
    assert gate.check(signed_at(NOW + 5), NOW) is SignatureVerdict.SIGNED
    assert gate.check(signed_at(NOW - 5, sysid=8), NOW) is SignatureVerdict.SIGNED
    assert clock.stamp(NOW) < NOW + TICKS_PER_S


def test_small_steps_walk_no_further_than_one_large_one() -> None:
    clock = SigningClock()
    gate = limited(clock)
    verdicts = [gate.check(signed_at(NOW + int(step * LIMIT_S / 2 * TICKS_PER_S)), NOW) for step in (0, 1, 3, 4)]
    assert verdicts == [SignatureVerdict.SIGNED] * 2 + [SignatureVerdict.AHEAD] * 2
    assert clock.timestamp <= NOW + LIMIT_S * TICKS_PER_S


def test_a_computer_that_starts_with_an_old_time_goes_by_what_it_showed_before() -> None:
    gate = limited(SigningClock(NOW, wall=NOW))
    old = NOW - 30 * 86400 * TICKS_PER_S
    assert gate.check(signed_at(NOW + 60 * TICKS_PER_S), old) is SignatureVerdict.SIGNED
    assert gate.check(signed_at(MAX_TIMESTAMP - 1), old) is SignatureVerdict.AHEAD


def test_a_clock_that_was_set_back_takes_the_streams_that_ran_ahead_anew_and_remembers_the_others() -> None:
    clock = SigningClock()
    streams = SignatureStreams(clock)
    gate, honest, old = Gate(KEY, clock, streams, frozenset()), NOW + 100, signed_at(NOW - 100, sysid=9)

    def verdicts(*frames: Frame) -> list[str]:
        return [gate.check(frame, NOW).name for frame in frames]

    both = signed_at(honest), signed_at(honest, sysid=8)
    assert verdicts(old, signed_at(MAX_TIMESTAMP - 9), *both) == ["SIGNED", "SIGNED", "REPLAYED", "STALE"]
    clock.reset(NOW)
    streams.reset()
    assert verdicts(old, *both, both[0]) == ["REPLAYED", "SIGNED", "SIGNED", "REPLAYED"]
