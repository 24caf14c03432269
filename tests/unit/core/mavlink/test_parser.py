"""The parser on what others recorded, on the noise case, and on everything Hypothesis can mix together."""

from __future__ import annotations

import json
import random
import re
from collections import Counter
from typing import Any

from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.dialect import MessageInfo
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


def parsed(data: bytes, *, table: Any = None, **more: Any) -> tuple[list[Frame], FrameParser]:
    parser = FrameParser(table or dialect(), **more)
    return parser.feed(data) + parser.finish(), parser


def parsed_in_pieces(data: bytes, rng: random.Random, *, table: Any = None) -> tuple[list[Frame], FrameParser]:
    parser, frames, at = FrameParser(table or dialect()), [], 0
    while at < len(data):
        size = rng.randint(1, 700)
        frames += parser.feed(data[at : at + size])
        at += size
    return frames + parser.finish(), parser


def raws(frames: list[Frame]) -> list[bytes]:
    return [f.raw for f in frames]


# -- captures


@each("name", captures("raw"))
def test_raw_capture_gives_at_least_the_expected_frames(name: str) -> None:
    data, expected = capture(name)
    frames, parser = parsed_in_pieces(data, random.Random(1), table=offline())
    assert parser.stats.good >= expected["status"]["ok"]
    assert Counter(f"{f.sysid}/{f.compid}" for f in frames if f.info is not None) == expected["sources"]
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

    command = mavlink.MAVLink_command_long_message(0, 0, 511, 0, 115.0, 5000.0, 0, 0, 0, 0, 0)
    value = mavlink.MAVLink_param_value_message(b"BAT1_R_INTERNAL", -1.0, 9, 1013, 4)
    attitude = mavlink.MAVLink_attitude_message(7, 0.5, 0.0, -0.25, 0, 0, 0)
    for message, wanted in (
        (mavlink.MAVLink_heartbeat_message(2, 3, 89, 5, 3, 3), {"custom_mode": 5, "base_mode": 89, "autopilot": 3}),
        (command, {"command": 511, "param1": 115.0, "param2": 5000.0}),
        (value, {"param_id": "BAT1_R_INTERNAL", "param_value": -1.0, "param_count": 1013, "param_index": 4}),
        (mavlink.MAVLink_statustext_message(6, b"hello"), {"severity": 6, "text": "hello"}),
        (attitude, {"time_boot_ms": 7, "roll": 0.5, "yaw": -0.25}),
    ):
        for key in (None, bytes(range(32))) if not v1 else (None,):
            raw = pymavlink_frame(message, seq=seq, v1=v1, key=key)
            frames, _ = parsed(noise(20, seq) + raw + raw)
            assert raws(frames) == [raw, raw]
            frame = frames[0]
            assert (frame.name, frame.sysid, frame.compid, frame.seq) == (message.get_type(), 1, 2, seq)
            assert frame.signed == (key is not None)
            assert wanted.items() <= frame.fields().items()


def test_what_stands_inside_a_damaged_frame_comes_out() -> None:
    inner = heartbeat(1, seq=0xFD)
    assert raws(parsed(bytes.fromhex("fd150000010101000000") + inner + b"\0\0")[0]) == [inner]
    flagged = heartbeat(1)[:2] + b"\2" + heartbeat(1)[3:]  # an incompatibility flag that nobody knows
    headless = frame("ATTITUDE", {"roll": 0.3, "pitch": 0.1, "yaw": 1.2}, seq=0xFD)[2:]
    assert parsed(flagged)[0] == parsed(headless)[0] == []


def test_wire_vectors_of_other_implementations() -> None:
    vectors = json.loads(public_file("vectors/wire_vectors.json").read_text())
    for vector in vectors["frames"]:
        data = bytes.fromhex(vector["frame"])
        frames, _ = parsed(data)
        if not vector["expect"].startswith("accept"):
            # "embedding a valid frame": what stands inside a damaged frame comes out; see the resume rule
            at = data.find(b"\xfd", 1)
            assert raws(frames) == ([data[at : at + 21]] if "embedding" in vector["name"] else []), vector
            continue
        assert raws(frames) == [data], vector["name"]
        decoded = vector.get("decode", {})
        for key in ("msgid", "sysid", "compid", "seq"):
            assert getattr(frames[0], key) == decoded.get(key, getattr(frames[0], key)), vector["name"]
        assert decoded.get("fields", {}).items() <= frames[0].fields().items(), vector["name"]
    for vector in vectors["resync"]:
        assert parsed(bytes.fromhex(vector["bytes"]))[0] == [], vector["expect"]


def test_signed_frames_are_taken_with_their_signature() -> None:
    for vector in json.loads(public_file("vectors/signed_real.json").read_text())["frames"]:
        data = bytes.fromhex(vector["frame"])
        frames, _ = parsed(noise(50, 3) + data + data)
        assert raws(frames) == [data, data] and frames[0].signed
        assert (frames[0].sysid, frames[0].compid, frames[0].seq) == (vector["sysid"], vector["compid"], vector["seq"])
        assert frames[0].fields()["text"] == vector["text"]


def test_fuzz_inputs_of_another_parser_neither_raise_nor_depend_on_the_split() -> None:
    for path in public_folder("vectors/gomavlib-fuzz"):
        literal = re.search(r'\[\]byte\("(.*)"\)', path.read_text())
        assert literal is not None
        data = literal[1].encode().decode("unicode_escape").encode("latin1")
        single = FrameParser(dialect())
        frames = [f for i in range(len(data)) for f in single.feed(data[i : i + 1])] + single.finish()
        assert raws(frames) == raws(parsed(data)[0])


def test_at_least_what_pymavlink_finds_in_its_own_captures() -> None:
    from pymavlink.dialects.v20 import all as mavlink

    for name in ("pymavlink/capture.mavlink", "node-mavlink/data.mavlink", "node-mavlink/GH-5.bin"):
        data = public_file(f"vectors/{name}").read_bytes()
        other = mavlink.MAVLink(None)
        other.robust_parsing = True
        found = [m.get_type() for m in other.parse_buffer(data) or []]
        theirs = Counter(kind for kind in found if kind != "BAD_DATA" and "UNK" not in kind)
        frames, _ = parsed(data, table=offline())
        assert theirs or name == "pymavlink/capture.mavlink"  # of frames from before CRC_EXTRA
        assert Counter(f.name for f in frames if f.info is not None) >= theirs, name


def test_network_captures_hold_the_message_they_are_named_after() -> None:
    for path in public_folder("vectors/pymavlink"):
        if path.suffix == ".pcapng":
            frames, _ = parsed(path.read_bytes(), table=offline())
            names = {f.name for f in frames}
            assert path.stem.removesuffix("_over_tcp").upper() in names, path.name


# -- streams and datagrams


def test_a_damaged_length_costs_only_its_own_frame() -> None:
    whole = frame("ATTITUDE", {"roll": 1.0, "yawspeed": 2.0})
    good = [heartbeat(s) for s in range(1, 15)]
    for length in {*range(256)} - {whole[1]}:
        frames, _ = parsed(whole[:1] + bytes((length,)) + whole[2:] + b"".join(good))
        assert raws(frames) == good, length


def test_an_incomplete_datagram_never_meets_the_next_one() -> None:
    parser = FrameParser(dialect())
    whole = heartbeat(7)
    assert parser.feed_datagram(whole[:12]) == parser.feed_datagram(whole[12:]) == []
    assert not parser.pending
    assert [f.sysid for f in parser.feed_datagram(whole + heartbeat(8) + whole[:5])] == [7, 8]
    assert parser.stats.skipped_bytes == len(whole) + 5
    count = 65535 // len(whole)
    assert len(parser.feed_datagram(whole * count)) == count, "the largest datagram"


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


def test_unknown_id_of_a_verified_source_is_taken_with_its_signature_unless_a_flag_is_not_defined() -> None:
    for incompat, compat in ((2, 0), (0, 1), (0x80, 0), (3, 0)):
        frames, _ = parsed(heartbeat(1) + unknown_frame(incompat=incompat, compat=compat) + heartbeat(1))
        assert [f.info is not None for f in frames] == [True, True]
    signed = unknown_frame(incompat=1) + bytes(range(13))
    assert raws(parsed(heartbeat(1) + signed + heartbeat(1))[0]) == [heartbeat(1), signed, heartbeat(1)]
    behind = [heartbeat(5, 7), unknown_frame(sysid=5, compid=7, version=1), heartbeat(5, 7)]
    frames, parser = parsed(behind[0] + b"\x00" + behind[1] + behind[2])
    assert raws(frames) == behind, "behind garbage"
    assert (parser.stats.unknown, parser.stats.unverified, parser.stats.skipped_bytes) == (1, 0, 1)


def test_unknown_id_waits_for_the_byte_behind_it_and_is_given_out_after_a_silence() -> None:
    unknown = unknown_frame(crc_extra=None)
    parser = FrameParser(dialect())
    assert len(parser.feed(heartbeat(1) + unknown)) == 1 and parser.pending
    assert raws(parser.rescue()) == [unknown] and not parser.pending
    assert (parser.stats.good, parser.stats.unknown) == (1, 1), "counted once"
    parser.feed(unknown)
    assert raws(parser.feed(b"\xfd")) == [unknown]
    parser.feed(unknown)
    assert parser.feed(b"\x00") == []
    datagrams = FrameParser(dialect())
    assert [f.msgid for f in datagrams.feed_datagram(heartbeat(1) + unknown)] == [0, UNKNOWN_ID], "at once"


def test_without_search_only_the_frames_at_the_begin_are_taken_counted_and_verified() -> None:
    parser = FrameParser(dialect())
    assert parser.feed_datagram(damaged(heartbeat(1)), search=False) == []
    assert raws(parser.feed_datagram(heartbeat(1) + b"xx", search=False)) == [heartbeat(1)]
    assert (parser.stats.good, parser.stats.bad_crc, parser.stats.skipped_bytes) == (1, 1, len(heartbeat(1)) + 2)
    assert parser.verified == {1 << 8 | 1}
    data = GOOD[0] + GOOD[1] + b"\xfd" * 5000 + GOOD[0]
    parser = FrameParser(dialect())
    assert raws(parser.feed_datagram(data, search=False)) == GOOD
    assert parser.stats.skipped_bytes == 5000 + len(GOOD[0])
    assert parser.feed_datagram(b"\x00" + GOOD[0], search=False) == []
    assert parsed(unknown_frame(sysid=7) * 2)[0] == [], "what another parser verified does not count here"


def test_false_start_of_unknown_id_swallows_no_good_frame_but_an_intact_one_may_carry_one() -> None:
    """A damaged header can claim exactly as many bytes as stand before some later frame."""
    swallowing = unknown_frame(heartbeat(1, seq=5) + b"\0\0", crc_extra=None)
    frames, _ = parsed(heartbeat(1) + swallowing + heartbeat(1))
    assert [f.seq for f in frames if f.info is not None] == [0, 5, 0] and len(frames) == 3
    tunnel = unknown_frame(heartbeat(9) + b"\x01", crc_extra=200)
    assert raws(parsed(heartbeat(1) + tunnel + heartbeat(1))[0]) == [heartbeat(1), tunnel, heartbeat(1)]


def test_known_id_in_mavlink_1_must_have_a_length_its_fields_allow() -> None:
    """Else chance finds a "good" frame in 10 MB of noise, and false starts wait for 255 bytes."""
    info = dialect().find("ATTITUDE")
    full = encode(info, {"roll": 1.0}, sysid=1, compid=1, seq=0, version=1)
    for length in range(256):
        data = with_crc(bytes((0xFE, length)) + full[2:6] + bytes(length), info)
        frames = FrameParser(dialect()).feed(data)
        assert (len(frames) == 1) == (length == info.length), length
        assert length == info.length or data not in raws(frames)


def test_extensions_are_taken_in_mavlink_1_as_pymavlink_sends_them_and_more_of_them_than_we_know() -> None:
    """A newer sender has more extension fields; its CRC is right all the same."""
    from pymavlink.dialects.v20 import all as mavlink

    message = mavlink.MAVLink_attitude_quaternion_message(1, 1, 0, 0, 0, 0, 0, 0, [1, 0, 0, 0])
    data = bytes(message.pack(mavlink.MAVLink(None, 4, 5), force_mavlink1=True))
    assert len(data) > dialect().find("ATTITUDE_QUATERNION").min_length + 8
    assert raws(parsed(data)[0]) == [data]
    info = dialect().find("HEARTBEAT")
    head = bytes((0xFD, info.length + 3, 0, 0, 0, 1, 1, 0, 0, 0))
    data = with_crc(head + bytes(range(1, info.length + 4)), info)
    assert raws(parsed(data)[0]) == [data]


def test_known_id_with_a_bad_crc_is_dropped_and_counted_or_passed_on_request() -> None:
    bad = damaged(frame("ATTITUDE", {"roll": 1.0}))
    data = heartbeat(1) + bad + heartbeat(1)
    frames, parser = parsed(data)
    assert (len(frames), parser.stats.bad_crc) == (2, 1)
    frames, passing = parsed(data, pass_bad_crc=True)
    assert raws(frames) == [heartbeat(1), bad, heartbeat(1)]
    assert frames[1].info is None and (passing.stats.bad_crc, passing.stats.unknown) == (1, 0)
    assert len(parsed(bad + heartbeat(1), pass_bad_crc=True)[0]) == 1, "a stranger's"
    waiting = FrameParser(dialect(), pass_bad_crc=True)
    assert len(waiting.feed(heartbeat(1) + bad)) == 1 and waiting.stats.bad_crc == 0, "for the byte behind it"
    assert raws(waiting.rescue()) == [bad] and waiting.stats.bad_crc == 1


def test_verified_sources_are_bounded() -> None:
    parser = FrameParser(dialect())
    for key in range(MAX_VERIFIED_SOURCES + 100):
        parser.feed_datagram(heartbeat(key >> 8, key & 0xFF))
    assert (len(parser.verified), parser.stats.good) == (MAX_VERIFIED_SOURCES, MAX_VERIFIED_SOURCES + 100)


# -- silence


FALSE_START = frame("FILE_TRANSFER_PROTOCOL", {"payload": [9] * 251})[:10]


@each("sysids", [[1], [1, 2]])
@each("starts", [1, 2])
def test_false_starts_are_rescued_after_a_silence_by_one_call(sysids: list[int], starts: int) -> None:
    parser = FrameParser(dialect())
    good = b"".join(map(heartbeat, sysids))
    assert parser.feed((FALSE_START + good) * starts + heartbeat(3)[:9]) == []
    assert parser.pending
    assert [f.sysid for f in parser.rescue()] == sysids * starts
    assert parser.stats.skipped_bytes == 10 * starts
    assert [f.sysid for f in parser.feed(heartbeat(3)[9:])] == [3] and not parser.pending


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
    frames = []
    for i in range(count):
        info = dialect().find(rng.choice(names))
        ids = {"sysid": 1 + i % 5, "compid": 1, "seq": i & 0xFF}
        frames.append(encode(info, random_values(info, rng), **ids, version=rng.choice((1, 2))))
    return frames


def damaged(data: bytes) -> bytes:
    return data[:-1] + bytes((data[-1] ^ 0x10,))


def with_crc(body: bytes, info: MessageInfo) -> bytes:
    return body + mcrf4xx(body[1:] + info.crc_extra_byte).to_bytes(2, "little")


def test_every_intact_frame_at_a_bit_error_rate_of_one_in_a_thousand_comes_out() -> None:
    rng = random.Random(7)
    good = some_good_frames(1500, 8)
    sent = [with_bit_errors(g, 1e-3, rng) for g in good]
    intact = [g for g, s in zip(good, sent, strict=True) if g == s]
    assert 400 < len(intact) < 1450
    frames, _ = parsed_in_pieces(b"".join(sent), rng)
    assert [f.raw for f in frames if f.info is not None] == intact
    assert {f.sysid for f in frames} <= set(range(1, 6))


# -- anything


def flipped(data: bytes, at: int, bit: int) -> bytes:
    at %= len(data)
    return data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]


KNOWN = st.sampled_from(some_good_frames(60, 1))
IDS = {"sysid": st.integers(1, 6), "crc_extra": st.sampled_from([0, 77, None]), "version": st.sampled_from([1, 2])}
UNKNOWN = st.builds(unknown_frame, st.binary(max_size=40), **IDS)
CUT = st.builds(lambda data, at: data[: at % len(data)], KNOWN, st.integers(0, 300))
FLIPPED = st.builds(flipped, KNOWN, st.integers(0, 300), st.integers(0, 7))
HEAD = st.binary(max_size=9).map(lambda tail: b"\xfd" + tail) | st.binary(max_size=6).map(lambda tail: b"\xfe" + tail)
STREAM = st.lists(KNOWN | UNKNOWN | CUT | FLIPPED | HEAD | st.binary(max_size=60), max_size=14).map(b"".join)


@settings(max_examples=examples(200), deadline=None)
@given(STREAM, st.lists(st.integers(1, 400), max_size=30), st.booleans())
def test_how_a_stream_is_split_changes_nothing(data: bytes, sizes: list[int], pass_bad_crc: bool) -> None:
    frames, whole = parsed(data, pass_bad_crc=pass_bad_crc)
    split = FrameParser(dialect(), pass_bad_crc=pass_bad_crc)
    again, rest = [], data
    for size in (*sizes, *[1] * len(data)):
        again += split.feed(rest[:size])
        rest = rest[size:]
    again += split.finish()
    assert raws(again) == raws(frames)
    assert (split.stats, split.verified) == (whole.stats, whole.verified)
    assert whole.stats.skipped_bytes + sum(len(f.raw) for f in frames) == len(data)


@settings(max_examples=examples(160), deadline=None)
@given(
    st.booleans(),
    st.lists(st.tuples(st.sampled_from(["feed", "feed_datagram", "rescue"]), st.binary(max_size=400) | STREAM)),
)
def test_nothing_raises_and_at_most_one_frame_is_kept(pass_bad_crc: bool, steps: list[tuple[str, bytes]]) -> None:
    parser = FrameParser(dialect(), pass_bad_crc=pass_bad_crc)
    for what, piece in steps:
        getattr(parser, what)(*(() if what == "rescue" else (piece,)))
        assert len(parser._buffer) <= MAX_FRAME_BYTES


@settings(max_examples=examples(120), deadline=None)
@given(st.lists(st.tuples(KNOWN, st.binary(max_size=40)), min_size=1, max_size=20), st.integers(1, 300))
def test_every_known_frame_between_noise_comes_out_and_nothing_else_of_a_known_id(mixture, size: int) -> None:
    data = b"".join(before + good for good, before in mixture)
    parser = FrameParser(dialect())
    frames = [f for at in range(0, len(data), size) for f in parser.feed(data[at : at + size])]
    frames += parser.rescue() + parser.finish()
    assert [f.raw for f in frames if f.info is not None] == [good for good, _ in mixture]


# --- garbage ----------------------------------------------------------------------------------------------------------


class ByteByByte(FrameParser):
    """Looks at each byte that is a start, without ruling any out by what follows it."""

    __slots__ = ()

    def _next_start(self, buffer: bytes, at: int, end: int) -> int:
        return next((place for place in range(at, end) if buffer[place] in (0xFD, 0xFE)), end)


GOOD = [heartbeat(7, seq=seq, version=seq, autopilot=3, base_mode=0, mavlink_version=0) for seq in (1, 2)]
PIECES = st.sampled_from([
    *(*GOOD, GOOD[0][:9], GOOD[1][3:], bytes(3), b"\xfe" * 9, b"\xfd" * 11, b"\xfd", b"\xfe", b"\xfd\x00\x00"),
    *(b"\xfd\xff\x01\x00\x00\x07\x01", b"\xfe\x14", b"\xfe\x09\x00\x07\x01\x00", b"\xfe\x09\x00\x07\x01\xc8"),
    b"\xfd\x09\x02",
])  # fmt: skip


@given(st.lists(st.one_of(PIECES, st.binary(max_size=12)), max_size=40), st.lists(st.integers(1, 60), max_size=20))
def test_what_is_passed_over_quickly_is_what_would_be_refused_one_by_one(pieces: list[bytes], cuts: list[int]) -> None:
    data = b"".join(pieces)

    def read(parser: FrameParser) -> tuple[object, ...]:
        found, rest = parser.feed_datagram(GOOD[0]), data
        for size in (*cuts, len(data)):
            found += parser.feed(rest[:size])
            rest = rest[size:]
        found += parser.finish()
        return raws(found), parser.stats, raws(parser.feed_datagram(data))

    assert read(FrameParser(dialect())) == read(ByteByByte(dialect()))


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
