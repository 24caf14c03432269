"""The parser on what others recorded, on the noise case, and on everything Hypothesis can mix together."""

from __future__ import annotations

import json
import random
import re
from collections import Counter
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.frame import MAX_FRAME_BYTES, Frame, encode
from skygcs.core.mavlink.parser import MAX_VERIFIED_SOURCES, VAIN_CHECKS_IN_DATAGRAM, FrameParser
from skygcs.tlog.reading import LogReader
from support.examples import examples, thinned
from support.frames import (
    UNKNOWN_ID,
    UNKNOWN_ID_V1,
    dialect,
    frame,
    heartbeat,
    noise,
    offline,
    random_values,
    unknown_frame,
    with_bit_errors,
)
from support.public_data import CAPTURE, capture, captures, public_file, public_folder
from support.table import each


def in_pieces(data: bytes, rng: random.Random, largest: int = 700) -> list[bytes]:
    pieces, at = [], 0
    while at < len(data):
        size = rng.randint(1, largest)
        pieces.append(data[at : at + size])
        at += size
    return pieces


def parsed(data: bytes, *, table: Any = None) -> tuple[list[Frame], FrameParser]:
    parser = FrameParser(table or dialect())
    frames = parser.feed(data) + parser.finish()
    return frames, parser


# -- captures


@each("name", captures("raw"))
def test_raw_capture_gives_at_least_the_expected_frames(name: str) -> None:
    data, expected = capture(name)
    rng = random.Random(1)
    parser = FrameParser(offline())
    frames = [f for piece in in_pieces(data, rng) for f in parser.feed(piece)] + parser.finish()
    assert parser.stats.good >= expected["status"]["ok"]
    sources = Counter(f"{f.sysid}/{f.compid}" for f in frames if f.info is not None)
    assert sources == expected["sources"]
    assert parser.stats.skipped_bytes + sum(len(f.raw) for f in frames) == len(data)


@each("name", thinned(captures("tlog"), 3, turn=9))
def test_every_good_frame_of_a_tlog_is_found_as_a_stream_with_its_times_as_noise(name: str) -> None:
    data, expected = capture(name)
    frames, parser = parsed(data, table=offline())
    records = [r.frame.raw for r in LogReader(data, offline()) if r.verdict == "ok" and r.frame is not None]
    found = [f.raw for f in frames if f.info is not None]
    if expected["status"].get("unknown"):  # the writer's parser invented frames around good ones: those come out too
        rest = iter(found)
        assert all(raw in rest for raw in records)
    else:
        assert found == records
    assert parser.stats.good == len(found) >= expected["status"]["ok"]


def test_own_capture_decodes_whole() -> None:
    data = CAPTURE.read_bytes()
    _, parser = parsed(data)
    assert (parser.stats.good, parser.stats.unknown, parser.stats.bad_crc) == (8144, 0, 0)


def pymavlink_frame(message: Any, *, seq: int, v1: bool = False, key: bytes | None = None) -> bytes:
    from pymavlink.dialects.v20 import all as mavlink

    encoder = mavlink.MAVLink(None, 1, 2)
    encoder.seq = seq
    if key is not None:
        encoder.signing.secret_key, encoder.signing.link_id = key, 3
        encoder.signing.timestamp, encoder.signing.sign_outgoing = (1 << 48) - 2, True
    return bytes(message.pack(encoder, force_mavlink1=v1))


@each("v1", [True, False])
@each("seq", [0, 0xEF, 0xFD, 0xFE, 0xFF])
def test_frames_that_pymavlink_packs(seq: int, v1: bool) -> None:
    """Trimmed ones, strings, extensions, sequence numbers that look like a magic byte, with and without signature."""
    from pymavlink.dialects.v20 import all as mavlink

    messages: list[tuple[Any, dict[str, Any]]] = [
        (mavlink.MAVLink_heartbeat_message(2, 3, 89, 5, 3, 3), {"custom_mode": 5, "base_mode": 89, "autopilot": 3}),
        (
            mavlink.MAVLink_command_long_message(0, 0, 511, 0, 115.0, 5000.0, 0, 0, 0, 0, 0),
            {"command": 511, "param1": 115.0, "param2": 5000.0},
        ),
        (
            mavlink.MAVLink_param_value_message(b"BAT1_R_INTERNAL", -1.0, 9, 1013, 4),
            {"param_id": "BAT1_R_INTERNAL", "param_value": -1.0, "param_count": 1013, "param_index": 4},
        ),
        (mavlink.MAVLink_statustext_message(6, b"hello"), {"severity": 6, "text": "hello"}),
        (mavlink.MAVLink_attitude_message(7, 0.5, 0.0, -0.25, 0, 0, 0), {"time_boot_ms": 7, "roll": 0.5, "yaw": -0.25}),
    ]
    for key in (None, bytes(range(32))) if not v1 else (None,):
        for message, wanted in messages:
            raw = pymavlink_frame(message, seq=seq, v1=v1, key=key)
            frames, _ = parsed(noise(20, seq) + raw + raw)
            assert [f.raw for f in frames] == [raw, raw]
            frame = frames[0]
            assert (frame.name, frame.sysid, frame.compid, frame.seq) == (message.get_type(), 1, 2, seq)
            assert frame.signed == (key is not None)
            fields = frame.fields()
            assert {name: fields[name] for name in wanted} == wanted


def test_what_stands_inside_a_damaged_frame_comes_out() -> None:
    inner = heartbeat(1, seq=0xFD)
    outer = bytes.fromhex("fd150000010101000000") + inner + b"\0\0"
    assert [f.raw for f in parsed(outer)[0]] == [inner]
    flags = bytearray(heartbeat(1))
    flags[2] = 0x02  # an incompatibility flag that nobody knows
    assert parsed(bytes(flags))[0] == []


def test_a_frame_without_its_first_bytes_is_none() -> None:
    raw = frame("ATTITUDE", {"roll": 0.3, "pitch": 0.1, "yaw": 1.2}, seq=0xFD)
    assert parsed(raw[2:])[0] == []


def test_wire_vectors_of_other_implementations() -> None:
    vectors = json.loads(public_file("vectors/wire_vectors.json").read_text())
    for vector in vectors["frames"]:
        data = bytes.fromhex(vector["frame"])
        frames, _ = parsed(data)
        if not vector["expect"].startswith("accept"):
            # "embedding a valid frame": what stands inside a damaged frame comes out; see the resume rule
            assert [f.raw for f in frames] == ([heartbeat_of(data)] if "embedding" in vector["name"] else []), vector
            continue
        assert [f.raw for f in frames] == [data], vector["name"]
        decoded = vector.get("decode", {})
        for key in ("msgid", "sysid", "compid", "seq"):
            if key in decoded:
                assert getattr(frames[0], key) == decoded[key], vector["name"]
        fields = frames[0].fields()
        assert {k: fields[k] for k in decoded.get("fields", {})} == decoded.get("fields", {}), vector["name"]


def heartbeat_of(data: bytes) -> bytes:
    at = data.index(b"\xfd", 1)
    return data[at : at + 21]


def test_resync_vector_gives_no_frame() -> None:
    vectors = json.loads(public_file("vectors/wire_vectors.json").read_text())
    for vector in vectors["resync"]:
        frames, _ = parsed(bytes.fromhex(vector["bytes"]))
        assert frames == [], vector["expect"]


def test_signed_frames_are_taken_with_their_signature() -> None:
    vectors = json.loads(public_file("vectors/signed_real.json").read_text())["frames"]
    for vector in vectors:
        data = bytes.fromhex(vector["frame"])
        frames, _ = parsed(noise(50, 3) + data + data)
        assert [f.raw for f in frames] == [data, data]
        assert frames[0].signed
        assert (frames[0].sysid, frames[0].compid, frames[0].seq) == (vector["sysid"], vector["compid"], vector["seq"])
        assert frames[0].fields()["text"] == vector["text"]


def test_fuzz_inputs_of_another_parser_neither_raise_nor_depend_on_the_split() -> None:
    for path in public_folder("vectors/gomavlib-fuzz"):
        text = path.read_text()
        literal = re.search(r'\[\]byte\("(.*)"\)', text)
        assert literal is not None
        data = literal[1].encode().decode("unicode_escape").encode("latin1")
        whole, _ = parsed(data)
        single = FrameParser(dialect())
        frames = [f for i in range(len(data)) for f in single.feed(data[i : i + 1])] + single.finish()
        assert [f.raw for f in frames] == [f.raw for f in whole]


def test_at_least_what_pymavlink_finds_in_its_own_captures() -> None:
    from pymavlink.dialects.v20 import all as mavlink

    for name in ("pymavlink/capture.mavlink", "node-mavlink/data.mavlink", "node-mavlink/GH-5.bin"):
        data = public_file(f"vectors/{name}").read_bytes()
        other = mavlink.MAVLink(None)
        other.robust_parsing = True
        theirs = Counter(
            m.get_type()
            for m in other.parse_buffer(data) or []
            if m.get_type() != "BAD_DATA" and "UNK" not in m.get_type()
        )
        frames, _ = parsed(data, table=offline())
        ours = Counter(f.name for f in frames if f.info is not None)
        assert theirs or name == "pymavlink/capture.mavlink"  # of frames from before CRC_EXTRA
        assert ours >= theirs, name


def test_network_captures_hold_the_message_they_are_named_after() -> None:
    for path in public_folder("vectors/pymavlink"):
        if path.suffix == ".pcapng":
            frames, _ = parsed(path.read_bytes(), table=offline())
            names = {f.name for f in frames}
            assert path.stem.removesuffix("_over_tcp").upper() in names, path.name


# -- streams and datagrams


def test_frames_come_out_as_the_bytes_that_went_in() -> None:
    good = [heartbeat(s, seq=s, version=1 + s % 2) for s in range(1, 20)]
    frames, parser = parsed(b"".join(good))
    assert [f.raw for f in frames] == good
    assert (parser.stats.good, parser.stats.skipped_bytes) == (len(good), 0)


def test_after_a_false_start_the_search_goes_on_at_the_next_byte() -> None:
    good = [heartbeat(1), frame("ATTITUDE", {"roll": 1.0}), heartbeat(2), frame("SYS_STATUS", {"load": 5})]
    frames, _ = parsed(b"\xfd\x20\x00\x00" + b"".join(good))
    assert [f.raw for f in frames] == good


def test_a_damaged_length_costs_only_its_own_frame() -> None:
    damaged = bytearray(frame("ATTITUDE", {"roll": 1.0, "yawspeed": 2.0}))
    for length in range(256):
        if length == damaged[1]:
            continue
        damaged[1], kept = length, damaged[1]
        good = [heartbeat(s) for s in range(1, 15)]
        frames, _ = parsed(bytes(damaged) + b"".join(good))
        assert [f.raw for f in frames] == good, length
        damaged[1] = kept


def test_an_incomplete_datagram_never_meets_the_next_one() -> None:
    parser = FrameParser(dialect())
    whole = heartbeat(7)
    assert parser.feed_datagram(whole[:12]) == []
    assert parser.feed_datagram(whole[12:]) == []
    assert not parser.pending
    assert [f.sysid for f in parser.feed_datagram(whole + heartbeat(8) + whole[:5])] == [7, 8]
    assert parser.stats.skipped_bytes == len(whole) + 5


def test_largest_datagram_with_as_many_frames_as_fit() -> None:
    one = heartbeat(3)
    count = 65535 // len(one)
    parser = FrameParser(dialect())
    assert len(parser.feed_datagram(one * count)) == count


# -- strict frames


@each("version", [1, 2])
@each("crc_extra", [77, None])
def test_unknown_id_is_taken_only_from_a_verified_source(version: int, crc_extra: int | None) -> None:
    unknown = unknown_frame(version=version, crc_extra=crc_extra)
    frames, parser = parsed(unknown + heartbeat(1) + unknown + heartbeat(2, 9) + unknown_frame(sysid=2, compid=1))
    taken = [f for f in frames if f.info is None]
    assert [f.raw for f in taken] == [unknown]
    assert taken[0].msgid == (UNKNOWN_ID_V1 if version == 1 else UNKNOWN_ID)
    assert taken[0].name == f"UNKNOWN_{taken[0].msgid}"
    assert taken[0].target() == (0, 0) and taken[0].fields() == {}
    assert parser.stats.unknown == 1
    assert parser.stats.unverified >= 2


@each(("incompat", "compat"), [(2, 0), (0, 1), (0x80, 0), (3, 0)])
def test_unknown_id_with_flags_nobody_defined_is_refused(incompat: int, compat: int) -> None:
    frames, _ = parsed(heartbeat(1) + unknown_frame(incompat=incompat, compat=compat) + heartbeat(1))
    assert [f.info is not None for f in frames] == [True, True]


def test_unknown_id_signed_is_taken_with_its_signature() -> None:
    signed = unknown_frame(incompat=1) + bytes(range(13))
    frames, _ = parsed(heartbeat(1) + signed + heartbeat(1))
    assert [f.raw for f in frames if f.info is None] == [signed]


def test_unknown_id_of_a_verified_source_is_found_behind_garbage() -> None:
    unknown = unknown_frame(sysid=5, compid=7, version=1)
    frames, parser = parsed(heartbeat(5, 7) + b"\x00" + unknown + heartbeat(5, 7))
    assert [f.raw for f in frames] == [heartbeat(5, 7), unknown, heartbeat(5, 7)]
    assert (parser.stats.unknown, parser.stats.unverified, parser.stats.skipped_bytes) == (1, 0, 1)


def test_a_frame_that_is_rescued_is_counted_once() -> None:
    parser = FrameParser(dialect())
    assert len(parser.feed(heartbeat(1) + unknown_frame())) == 1 and parser.pending
    assert [f.raw for f in parser.rescue()] == [unknown_frame()]
    assert (parser.stats.good, parser.stats.unknown) == (1, 1)


def test_the_beginning_of_a_datagram_is_counted_and_verified_and_damage_at_first_is_harmless() -> None:
    parser = FrameParser(dialect())
    damaged = bytearray(heartbeat(1))
    damaged[-1] ^= 0x10
    assert parser.feed_datagram(bytes(damaged), search=False) == []
    assert [f.raw for f in parser.feed_datagram(heartbeat(1) + b"xx", search=False)] == [heartbeat(1)]
    assert (parser.stats.good, parser.stats.bad_crc, parser.stats.skipped_bytes) == (1, 1, len(damaged) + 2)
    assert parser.verified == {1 << 8 | 1}


def test_verification_belongs_to_one_parser() -> None:
    """A link, or one UDP peer: what another one verified does not count here."""
    assert parsed(heartbeat(1))[1].verified == {1 << 8 | 1}
    frames, _ = parsed(unknown_frame() + unknown_frame())
    assert frames == []


def test_unknown_id_waits_for_the_byte_behind_it_and_is_given_out_after_a_silence() -> None:
    parser = FrameParser(dialect())
    unknown = unknown_frame(crc_extra=None)
    assert len(parser.feed(heartbeat(1) + unknown)) == 1
    assert parser.pending
    assert [f.raw for f in parser.rescue()] == [unknown]
    assert not parser.pending
    parser.feed(unknown)
    assert [f.raw for f in parser.feed(b"\xfd")] == [unknown]
    parser = FrameParser(dialect())
    parser.feed(heartbeat(1) + unknown)
    assert parser.feed(b"\x00") == []


def test_unknown_id_in_a_datagram_is_given_out_at_once() -> None:
    parser = FrameParser(dialect())
    assert [f.msgid for f in parser.feed_datagram(heartbeat(1) + unknown_frame())] == [0, UNKNOWN_ID]


def test_false_start_of_unknown_id_swallows_no_good_frame() -> None:
    """A damaged header can claim exactly as many bytes as stand before some later frame."""
    inner = heartbeat(1, seq=5)
    swallowing = unknown_frame(inner + b"\0\0", crc_extra=None)
    frames, _ = parsed(heartbeat(1) + swallowing + heartbeat(1))
    assert [f.seq for f in frames if f.info is not None] == [0, 5, 0]
    assert all(f.info is not None for f in frames)


def test_intact_unknown_frame_may_carry_a_frame() -> None:
    tunnel = unknown_frame(heartbeat(9) + b"\x01", crc_extra=200)
    frames, _ = parsed(heartbeat(1) + tunnel + heartbeat(1))
    assert [f.raw for f in frames][1] == tunnel
    assert {f.sysid for f in frames} == {1}


def test_known_id_in_mavlink_1_must_have_a_length_its_fields_allow() -> None:
    """Else chance finds a "good" frame in 10 MB of noise, and false starts wait for 255 bytes."""
    info = dialect().find("ATTITUDE")
    full = encode(info, {"roll": 1.0}, sysid=1, compid=1, seq=0, version=1)
    for length in range(256):
        body = bytes((0xFE, length)) + full[2:6] + bytes(length)
        from fastcrc.crc16 import mcrf4xx

        data = body + mcrf4xx(body[1:] + info.crc_extra_byte).to_bytes(2, "little")
        parser = FrameParser(dialect())
        frames = parser.feed(data)
        assert (len(frames) == 1) == (length == info.length), length
        assert length == info.length or not [f for f in frames if f.raw == data]


def test_mavlink_1_with_extensions_is_taken_as_pymavlink_sends_it() -> None:
    from pymavlink.dialects.v20 import all as mavlink

    message = mavlink.MAVLink_attitude_quaternion_message(1, 1, 0, 0, 0, 0, 0, 0, [1, 0, 0, 0])
    data = bytes(message.pack(mavlink.MAVLink(None, 4, 5), force_mavlink1=True))
    assert len(data) > dialect().find("ATTITUDE_QUATERNION").min_length + 8
    frames, _ = parsed(data)
    assert [f.raw for f in frames] == [data]


def test_mavlink_2_payload_longer_than_we_know_is_taken() -> None:
    """A newer sender has more extension fields; its CRC is right all the same."""
    from fastcrc.crc16 import mcrf4xx

    info = dialect().find("HEARTBEAT")
    body = bytes((0xFD, info.length + 3, 0, 0, 0, 1, 1, 0, 0, 0)) + bytes(range(1, info.length + 4))
    data = body + mcrf4xx(body[1:] + info.crc_extra_byte).to_bytes(2, "little")
    frames, _ = parsed(data)
    assert [f.raw for f in frames] == [data]


def test_known_id_with_a_bad_crc_is_dropped_and_counted_or_passed_on_request() -> None:
    damaged = bytearray(frame("ATTITUDE", {"roll": 1.0}))
    damaged[-1] ^= 0x10
    data = heartbeat(1) + bytes(damaged) + heartbeat(1)
    frames, parser = parsed(data)
    assert len(frames) == 2
    assert parser.stats.bad_crc == 1
    passing = FrameParser(dialect(), pass_bad_crc=True)
    frames = passing.feed(data)
    assert [f.raw for f in frames] == [heartbeat(1), bytes(damaged), heartbeat(1)]
    assert frames[1].info is None and (passing.stats.bad_crc, passing.stats.unknown) == (1, 0)
    stranger = FrameParser(dialect(), pass_bad_crc=True)
    assert len(stranger.feed(bytes(damaged) + heartbeat(1))) == 1


def test_verified_sources_are_bounded() -> None:
    parser = FrameParser(dialect())
    for key in range(MAX_VERIFIED_SOURCES + 100):
        parser.feed_datagram(heartbeat(key >> 8, key & 0xFF))
    assert len(parser.verified) == MAX_VERIFIED_SOURCES
    assert parser.stats.good == MAX_VERIFIED_SOURCES + 100


# -- silence


@each("good", [[heartbeat(1)], [heartbeat(1), heartbeat(2)]])
def test_false_start_at_the_end_is_rescued_after_a_silence(good: list[bytes]) -> None:
    parser = FrameParser(dialect())
    start = frame("FILE_TRANSFER_PROTOCOL", {"payload": [9] * 251})[:10]
    assert parser.feed(start + b"".join(good)) == []
    assert parser.pending
    assert [f.raw for f in parser.rescue()] == good
    assert not parser.pending
    assert parser.stats.skipped_bytes == 10


def test_two_false_starts_in_a_row_are_rescued_by_one_call() -> None:
    parser = FrameParser(dialect())
    start = frame("FILE_TRANSFER_PROTOCOL", {"payload": [9] * 251})[:10]
    data = start + heartbeat(1) + start + heartbeat(2) + heartbeat(3)[:9]
    assert parser.feed(data) == []
    assert [f.sysid for f in parser.rescue()] == [1, 2]
    assert [f.sysid for f in parser.feed(heartbeat(3)[9:])] == [3]


def test_rescue_leaves_a_slow_frame_alone() -> None:
    whole = frame("STATUSTEXT", {"text": "slow"})
    for cut in range(1, len(whole)):
        parser = FrameParser(dialect())
        assert parser.feed(whole[:cut]) == []
        assert parser.rescue() == []
        assert [f.raw for f in parser.feed(whole[cut:])] == [whole]


# -- the noise case of the router study


def test_megabytes_of_noise_invent_no_system() -> None:
    known = b"".join(heartbeat(s) for s in range(1, 6))
    for seed in range(7, 11):
        parser = FrameParser(dialect())
        assert len(parser.feed(known)) == 5
        rng = random.Random(seed)
        assert [f for _ in range(1000) for f in parser.feed(rng.randbytes(1000))] == []


def some_good_frames(count: int, seed: int) -> list[bytes]:
    rng = random.Random(seed)
    names = ("HEARTBEAT", "ATTITUDE", "GLOBAL_POSITION_INT", "SYS_STATUS", "GPS_RAW_INT", "PARAM_VALUE", "STATUSTEXT")
    infos = [dialect().find(name) for name in names]
    return [
        encode(
            info := rng.choice(infos),
            random_values(info, rng),
            sysid=1 + i % 5,
            compid=1,
            seq=i & 0xFF,
            version=rng.choice((1, 2)),
        )
        for i in range(count)
    ]


def test_every_good_frame_between_noise_comes_out() -> None:
    rng = random.Random(7)
    good = some_good_frames(1500, 7)
    data = b"".join((rng.randbytes(rng.randint(1, 40)) if rng.random() < 0.3 else b"") + g for g in good)
    parser = FrameParser(dialect())
    frames = [f for piece in in_pieces(data, rng) for f in parser.feed(piece)] + parser.finish()
    assert [f.raw for f in frames if f.info is not None] == good
    assert parser.stats.unknown == 0


def test_every_intact_frame_at_a_bit_error_rate_of_one_in_a_thousand_comes_out() -> None:
    rng = random.Random(7)
    good = some_good_frames(1500, 8)
    sent = [with_bit_errors(g, 1e-3, rng) for g in good]
    intact = [g for g, s in zip(good, sent, strict=True) if g == s]
    assert 400 < len(intact) < 1450
    parser = FrameParser(dialect())
    frames = [f for piece in in_pieces(b"".join(sent), rng) for f in parser.feed(piece)] + parser.finish()
    assert [f.raw for f in frames if f.info is not None] == intact
    assert {f.sysid for f in frames} <= set(range(1, 6))


# -- anything

KNOWN = st.sampled_from(some_good_frames(60, 1))
UNKNOWN = st.builds(
    unknown_frame,
    st.binary(max_size=40),
    sysid=st.integers(1, 6),
    crc_extra=st.sampled_from([0, 77, None]),
    version=st.sampled_from([1, 2]),
)
CUT = st.builds(lambda data, at: data[: at % len(data)], KNOWN, st.integers(0, 300))
FLIPPED = st.builds(
    lambda data, at, bit: (
        data[: at % len(data)] + bytes([data[at % len(data)] ^ 1 << bit]) + data[at % len(data) + 1 :]
    ),
    KNOWN,
    st.integers(0, 300),
    st.integers(0, 7),
)
HEAD = st.binary(max_size=9).map(lambda tail: b"\xfd" + tail) | st.binary(max_size=6).map(lambda tail: b"\xfe" + tail)
STREAM = st.lists(KNOWN | UNKNOWN | CUT | FLIPPED | HEAD | st.binary(max_size=60), max_size=14).map(b"".join)


@settings(max_examples=examples(200), deadline=None)
@given(STREAM, st.lists(st.integers(1, 400), max_size=30), st.booleans())
def test_how_a_stream_is_split_changes_nothing(data: bytes, sizes: list[int], pass_bad_crc: bool) -> None:
    whole = FrameParser(dialect(), pass_bad_crc=pass_bad_crc)
    frames = whole.feed(data) + whole.finish()
    split = FrameParser(dialect(), pass_bad_crc=pass_bad_crc)
    again, rest = [], data
    for size in sizes:
        again += split.feed(rest[:size])
        rest = rest[size:]
    for at in range(len(rest)):
        again += split.feed(rest[at : at + 1])
    again += split.finish()
    assert [f.raw for f in again] == [f.raw for f in frames]
    assert split.stats == whole.stats
    assert split.verified == whole.verified
    assert whole.stats.skipped_bytes + sum(len(f.raw) for f in frames) == len(data)


@settings(max_examples=examples(160), deadline=None)
@given(st.lists(st.binary(max_size=400) | STREAM, max_size=12), st.data())
def test_nothing_raises_and_at_most_one_frame_is_kept(pieces: list[bytes], data: st.DataObject) -> None:
    parser = FrameParser(dialect(), pass_bad_crc=data.draw(st.booleans()))
    for piece in pieces:
        match data.draw(st.sampled_from(["feed", "datagram", "rescue"])):
            case "feed":
                parser.feed(piece)
            case "datagram":
                parser.feed_datagram(piece)
            case _:
                parser.rescue()
        assert len(parser._buffer) <= MAX_FRAME_BYTES


@settings(max_examples=examples(120), deadline=None)
@given(st.lists(st.tuples(KNOWN, st.binary(max_size=30)), min_size=1, max_size=12), st.integers(1, 300))
def test_every_known_frame_between_noise_comes_out_and_nothing_else_of_a_known_id(
    mixture: list[tuple[bytes, bytes]], size: int
) -> None:
    data = b"".join(before + good for good, before in mixture)
    parser = FrameParser(dialect())
    frames = [f for at in range(0, len(data), size) for f in parser.feed(data[at : at + size])]
    frames += parser.rescue()
    frames += parser.finish()
    assert [f.raw for f in frames if f.info is not None] == [good for good, _ in mixture]


# --- garbage ----------------------------------------------------------------------------------------------------------


class ByteByByte(FrameParser):
    """Looks at each byte that is a start, without ruling any out by what follows it."""

    __slots__ = ()

    def _next_start(self, buffer: bytes, at: int, end: int) -> int:
        return next((place for place in range(at, end) if buffer[place] in (0xFD, 0xFE)), end)


GOOD = [
    encode(dialect().find("HEARTBEAT"), {"type": 2, "autopilot": 3}, sysid=7, compid=1, seq=seq, version=version)
    for seq, version in ((1, 1), (2, 2))
]
PIECES = st.sampled_from(
    [
        *(*GOOD, GOOD[0][:9], GOOD[1][3:], bytes(3), b"\xfe" * 9, b"\xfd" * 11, b"\xfd", b"\xfe", b"\xfd\x00\x00"),
        *(b"\xfd\xff\x01\x00\x00\x07\x01", b"\xfe\x14", b"\xfe\x09\x00\x07\x01\x00", b"\xfe\x09\x00\x07\x01\xc8"),
        b"\xfd\x09\x02",
    ]
)


@given(st.lists(st.one_of(PIECES, st.binary(max_size=12)), max_size=40), st.lists(st.integers(1, 60), max_size=20))
def test_what_is_passed_over_quickly_is_what_would_be_refused_one_by_one(pieces: list[bytes], cuts: list[int]) -> None:
    data = b"".join(pieces)
    quick, slow = FrameParser(dialect()), ByteByByte(dialect())
    for parser in (quick, slow):
        parser.feed_datagram(GOOD[0])
    found: list[list[bytes]] = [[], []]
    rest = data
    for size in (*cuts, len(data)):
        for parser, frames in zip((quick, slow), found, strict=True):
            frames += [frame.raw for frame in parser.feed(rest[:size])]
        rest = rest[size:]
    for parser, frames in zip((quick, slow), found, strict=True):
        frames += [frame.raw for frame in parser.finish()]
    assert found[0] == found[1]
    assert quick.stats == slow.stats
    assert [f.raw for f in quick.feed_datagram(data)] == [f.raw for f in slow.feed_datagram(data)]


@each("kind", [FrameParser, ByteByByte])
def test_an_unknown_id_of_nobody_that_is_passed_over_quickly_is_counted(kind: type[FrameParser]) -> None:
    parser = kind(dialect())
    assert parser.feed_datagram(b"\0" + b"\xfe\x09\x00\x07\x01\x03" + bytes(20)) == []
    assert parser.stats.unverified == 1


@each("pattern", [b"\xfe\x14", b"\xfd\xff\x00\x00\x00", b"\xfe\x09\x00\x07\x01\xc8"])
def test_bytes_that_are_made_to_cost_are_searched_for_so_long_and_no_longer(pattern: bytes) -> None:
    parser = FrameParser(dialect())
    parser.feed_datagram(GOOD[0])  # its source may send what nobody can check
    data = (pattern * 12_288)[:12_288]
    assert parser.feed_datagram(data) == [] or pattern[-1] == 0xC8
    assert parser.stats.bad_crc == (0 if pattern[-1] == 0xC8 else VAIN_CHECKS_IN_DATAGRAM + 1)
    assert parser._vain_checks <= 60
    assert [frame.raw for frame in parser.feed_datagram(GOOD[1])] == [GOOD[1]]


def test_without_search_only_the_frames_at_the_begin_are_taken() -> None:
    parser = FrameParser(dialect())
    data = GOOD[0] + GOOD[1] + b"\xfd" * 5000 + GOOD[0]
    assert [frame.raw for frame in parser.feed_datagram(data, search=False)] == GOOD
    assert parser.stats.skipped_bytes == 5000 + len(GOOD[0])
    assert parser.feed_datagram(b"\x00" + GOOD[0], search=False) == []
