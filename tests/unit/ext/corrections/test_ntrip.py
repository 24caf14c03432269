"""NTRIP without a connection: the request, every kind of answer, in any pieces."""

from __future__ import annotations

import base64
from email.parser import BytesParser
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pynmeagps import NMEAReader

from skygcs.errors import LinkError
from skygcs.ext.corrections import ntrip
from skygcs.ext.corrections.chunked import MAX_CHUNK_BYTES, MAX_SIZE_LINE_BYTES, ChunkedDecoder
from skygcs.ext.corrections.gga import GgaPosition, chosen_place, gga_sentence
from skygcs.ext.corrections.ntrip import (
    MAX_COMPARED,
    MAX_HEAD_BYTES,
    MAX_LINE_BYTES,
    MAX_MOUNTPOINTS,
    MAX_STATUS_BYTES,
    MAX_TABLE_BYTES,
    Mountpoint,
    NtripAnswer,
    RefusedByCaster,
    SourceTable,
    request,
)
from support.caster import HTTP, ICY, TABLE, chunked
from support.rtcm import STANDARD_1005, rtcm_frame
from support.table import each

MOUNT = Mountpoint("caster.example", 2101, "MOUNT", user="ada")
STREAM = STANDARD_1005 + rtcm_frame(1077, body_bytes=300)
CHUNKED = HTTP + b"Transfer-Encoding: chunked\r\n\r\n"


def read(*pieces: bytes, mountpoint: Mountpoint = MOUNT, with_password: bool = True) -> tuple[bytes, NtripAnswer]:
    answer = NtripAnswer(mountpoint, with_password=with_password)
    return b"".join(answer.feed(piece) for piece in pieces), answer


# -- the request


def test_the_request_of_revision_2_is_what_the_standard_library_reads() -> None:
    raw = request(MOUNT, "pass:wörd", revision=2, gga=b"$GPGGA,1*00\r\n")
    line, _, rest = raw.partition(b"\r\n")
    assert line == b"GET /MOUNT HTTP/1.1"
    head = BytesParser().parsebytes(rest)
    assert head["Host"] == "caster.example:2101"
    assert head["Ntrip-Version"] == "Ntrip/2.0"
    assert head["User-Agent"].startswith("NTRIP ")
    assert head["Ntrip-GGA"] == "$GPGGA,1*00"
    kind, token = head["Authorization"].split()
    assert (kind, base64.b64decode(token).decode()) == ("Basic", "ada:pass:wörd")
    assert rest.endswith(b"\r\n\r\n") and head.get_payload() == ""


def test_the_request_of_revision_1_has_no_more_than_that_knows() -> None:
    raw = request(Mountpoint("::1", 2101, "M"), "", revision=1, gga=b"$GPGGA,1*00\r\n")
    assert raw == b"GET /M HTTP/1.0\r\nUser-Agent: NTRIP skygcs\r\n\r\n"
    assert b"Host: [::1]:2101\r\n" in request(Mountpoint("::1", 2101, "M"), "", revision=2)


# -- streams


@each(
    ("begin", "revision"),
    [
        (ICY, 1),
        (b"ICY 200 OK\r\n", 1),
        (b"icy 200 ok\n", 1),
        (b"ICY 200 OK\r\nServer: NTRIP Caster/1.0\r\nDate: today\r\n\r\n", 1),
        (HTTP + b"\r\n", 2),
        (b"HTTP/1.0 200 OK\n\n", 2),
        (b"HTTP/1.1 200 OK\r\ncontent-type: GNSS/DATA\r\nbroken line\r\n\r\n", 2),
    ],
)
def test_a_stream_begins_after_the_answer_wherever_it_is_cut(begin: bytes, revision: int) -> None:
    whole = begin + STREAM
    for size in (1, 2, 3, 7, len(begin) - 1, len(begin), len(begin) + 1, len(whole)):
        content, answer = read(*(whole[at : at + size] for at in range(0, len(whole), size)))
        assert content == STREAM, size
        assert (answer.state, answer.revision) == ("stream", revision)


@given(cut=st.integers(1, 40), chunk=st.integers(1, 300))
def test_a_chunked_stream(cut: int, chunk: int) -> None:
    whole = CHUNKED + chunked(STREAM, chunk)
    assert read(*(whole[at : at + cut] for at in range(0, len(whole), cut)))[0] == STREAM


# -- refusals


@each(
    ("said", "why"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", r"user or password is wrong.*401.*ada"),
        (b"ERROR - Bad Password\r\n", "user or password is wrong"),
        (b"HTTP/1.1 403 Forbidden\r\n\r\n", "may not use MOUNT"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "no mountpoint MOUNT.*capitals"),
        (b"ERROR - Mount Point Taken or Invalid\r\n", "no mountpoint MOUNT"),
        (b"HTTP/1.1 302 Found\r\nLocation: http://b.example:2101/M\r\n\r\n", r'"http://b.example:2101/M" now'),
        (b"HTTP/1.1 418 I am a teapot\r\n\r\n", "teapot"),
        (b"HTTP/1.1\r\n\r\n", "it answers"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip\r\n\r\n", 'codes the stream as "gzip"'),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "not an NTRIP caster"),
        (b"\x1b[2J\r\n", "not an NTRIP caster"),
        (b"ERROR - \x1b[2J\r\n", r"\\x1b"),
        (STANDARD_1005, "without an answer"),
        (b"\x16\x03\x01\x02\x00", "without an answer"),
        (b"A" * (MAX_STATUS_BYTES + 1), "without an answer"),
        (b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * MAX_HEAD_BYTES, "more than 8192 bytes"),
    ],
)
def test_a_refusal_says_what_to_do(said: bytes, why: str) -> None:
    for pieces in ((said,), tuple(bytes([byte]) for byte in said)):
        with pytest.raises(RefusedByCaster, match=why) as refused:
            read(*pieces)
        assert refused.value.args[0].isprintable()


def test_a_missing_password_is_told_from_a_wrong_one() -> None:
    with pytest.raises(RefusedByCaster, match=r"needs a password.*password_file"):
        read(b"HTTP/1.1 401 Unauthorized\r\n\r\n", with_password=False)


@each(
    "begin",
    [
        (b"SOURCETABLE 200 OK\r\nServer: x\r\nContent-Length: 3\r\n\r\n", b""),
        (b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\n", b""),
        (b"HTTP/1.1 200 OK\r\nContent-Type: text/plain\r\nTransfer-Encoding: chunked\r\n\r\n", b"c"),
    ],
)
def test_a_table_instead_of_a_stream_names_the_mountpoints(begin: tuple[bytes, bytes]) -> None:
    head, coded = begin
    whole = head + (chunked(TABLE, 30) if coded else TABLE)
    for size in (1, 50, len(whole)):
        with pytest.raises(RefusedByCaster, match=r"no mountpoint MOUNT, .* its 2: MOUNT1, and 1 more"):
            read(*(whole[at : at + size] for at in range(0, len(whole), size)))


def test_a_table_or_a_page_that_only_ends_counts_too() -> None:
    _, answer = read(b"SOURCETABLE 200 OK\r\n", TABLE[:-20])
    assert "MOUNT1" in str(answer.ended())
    _, answer = read(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html>")
    assert "a text instead of the stream" in str(answer.ended())
    assert "without an answer" in str(read(b"HTTP/1.1 200")[1].ended())
    assert "closed the connection" in str(read(ICY, STREAM)[1].ended())


def test_a_refusal_whose_head_has_no_end_is_read_when_the_connection_ends() -> None:
    _, answer = read(b"HTTP/1.0 401 Unauthorized\r\n")  # RTKLIB 2.4.3 closes then
    assert isinstance(answer.ended(), RefusedByCaster) and "user or password is wrong" in str(answer.ended())
    assert "without an answer" in str(read(b"HTTP/1.0 200 OK\r\n")[1].ended())


def test_a_table_without_an_end_is_bounded() -> None:
    table = SourceTable()
    while not table.complete:
        table.feed(b"STR;" + b"M" * 100 + b";\n" + b"x" * 3000)
        assert len(table._line) <= MAX_LINE_BYTES
    assert len(table.mountpoints) <= MAX_MOUNTPOINTS
    assert table._bytes < MAX_TABLE_BYTES + 4000
    with pytest.raises(RefusedByCaster):
        read(b"SOURCETABLE 200 OK\r\n", *[b"x" * 4096] * 300)


@given(st.lists(st.binary(max_size=200), max_size=20), st.sampled_from([b"", ICY, b"HTTP/1.1 200 OK\r\n", CHUNKED]))
def test_nothing_that_is_sent_raises_anything_else(pieces: list[bytes], begin: bytes) -> None:
    answer = NtripAnswer(MOUNT)
    try:
        for piece in (begin, *pieces):
            answer.feed(piece)
    except LinkError:
        return
    assert len(answer._held) <= MAX_HEAD_BYTES + 200


def test_a_wrong_name_is_compared_with_a_bounded_number_of_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """4096 names of the same letters held the loop for 0.4 s."""
    compared: list[list[str]] = []
    near_names = ntrip.near_names
    monkeypatch.setattr(ntrip, "near_names", lambda name, known: compared.append(known) or near_names(name, known))
    table = b"".join(b"STR;TNUOM%d;\r\n" % n for n in range(MAX_MOUNTPOINTS - 1)) + b"STR;MOUMT;\r\n"
    with pytest.raises(RefusedByCaster, match="its 4096: MOUMT"):
        read(b"SOURCETABLE 200 OK\r\n" + table + b"ENDSOURCETABLE\r\n")
    assert [len(known) for known in compared] == [MAX_COMPARED]


# -- The chunked transfer coding: any pieces, bounds, and what is none.


def decoded(*pieces: bytes) -> bytes:
    decoder = ChunkedDecoder()
    return b"".join(decoder.feed(piece) for piece in pieces)


def test_the_example_of_the_standard() -> None:
    coded = b"4\r\nWiki\r\n7;name=value\r\npedia i\r\nB\r\nn \r\nchunks.\r\n0\r\nTrailer: x\r\n\r\n"
    assert decoded(coded) == b"Wikipedia in \r\nchunks."


@given(
    chunks=st.lists(st.binary(min_size=1, max_size=600), max_size=6),
    cuts=st.lists(st.integers(1, 40), min_size=1, max_size=20),
    upper=st.booleans(),
)
def test_any_chunks_in_any_pieces(chunks: list[bytes], cuts: list[int], upper: bool) -> None:
    template = b"%X\r\n%s\r\n" if upper else b"%x\r\n%s\r\n"
    coded = b"".join(template % (len(chunk), chunk) for chunk in chunks) + b"0\r\n\r\n"
    pieces, at = [], 0
    while at < len(coded):
        size = cuts[len(pieces) % len(cuts)]
        pieces.append(coded[at : at + size])
        at += size
    decoder = ChunkedDecoder()
    assert b"".join(decoder.feed(piece) for piece in pieces) == b"".join(chunks)
    assert decoder.state == "ended"
    assert decoder.feed(b"anything") == b""


@given(st.binary(max_size=3000))
def test_garbage_is_refused_or_read_and_never_kept(data: bytes) -> None:
    decoder = ChunkedDecoder()
    try:
        for byte in data:
            decoder.feed(bytes([byte]))
    except LinkError:
        pass
    assert len(decoder._line) <= MAX_SIZE_LINE_BYTES + 1


@each(
    ("coded", "why"),
    [
        (b"zz\r\n", "without its size"),
        (b"\r\n", "without its size"),
        (b"-4\r\nabcd", "without its size"),
        (b"0x4\r\nabcd", "without its size"),
        (b"4\r\nabcdef\r\n", "longer than it says"),
        (b"1" * (MAX_SIZE_LINE_BYTES + 1), "a line of more than"),
        (b"4;" + b"x" * 5000, "a line of more than"),
        (b"FFFFFFFFFFFFFFFF\r\n", "a chunk of 18446744073709551615 bytes"),
        (b"%x\r\n" % (MAX_CHUNK_BYTES + 1), "no caster sends more"),
    ],
)
def test_what_is_no_chunk_is_refused(coded: bytes, why: str) -> None:
    with pytest.raises(LinkError, match=why):
        decoded(coded)
    with pytest.raises(LinkError, match=why):
        decoded(*(bytes([byte]) for byte in coded))


# -- GGA sentences against pynmeagps, and the vehicle whose position they are.


@given(
    lat=st.floats(-90, 90),
    lon=st.floats(-180, 180),
    alt=st.floats(-400, 9000),
    utc_s=st.floats(0, 2**32),
    satellites=st.integers(0, 200),
)
@example(lat=-0.9999999999, lon=179.9999999999, alt=0.0, utc_s=86399.999, satellites=0)
@example(lat=59.99999999999, lon=-1e-12, alt=-0.001, utc_s=0.0, satellites=12)
def test_an_independent_parser_reads_the_place(
    lat: float, lon: float, alt: float, utc_s: float, satellites: int
) -> None:
    raw = gga_sentence(GgaPosition("a", lat, lon, alt, satellites), utc_s)
    parsed: Any = NMEAReader.parse(raw)  # it checks the checksum
    assert parsed.msgID == "GGA"
    assert (float(parsed.lat), float(parsed.lon)) == pytest.approx((lat, lon), abs=2e-8)
    assert parsed.alt == pytest.approx(alt, abs=0.006)
    assert parsed.quality == 1 and 4 <= parsed.numSV <= 99
    second = int(utc_s) % 86400
    wanted = (second // 3600, second // 60 % 60, second % 60)
    assert (parsed.time.hour, parsed.time.minute, parsed.time.second) == wanted
    assert len(raw) <= 84


def fix(fix: str | None = "3d", lat: float | None = 1.0, **more: Any) -> dict[str, Any]:
    return {"fix": fix, "lat_deg": lat, "lon_deg": 2.0, "alt_amsl_m": 3.0, "satellites": 9, **more}


def test_the_first_with_a_fix_is_taken_and_stays() -> None:
    fixes = [("alpha", fix("none")), ("bravo", fix()), ("charlie", fix("rtk_fixed"))]
    assert chosen_place(fixes) == GgaPosition("bravo", 1.0, 2.0, 3.0, 9)
    assert chosen_place(fixes, last="charlie") == GgaPosition("charlie", 1.0, 2.0, 3.0, 9)
    fixes[0] = ("alpha", fix())
    assert chosen_place(fixes, last="bravo") == GgaPosition("bravo", 1.0, 2.0, 3.0, 9)
    fixes[1] = ("bravo", fix("2d"))
    assert chosen_place(fixes, last="bravo") == GgaPosition("alpha", 1.0, 2.0, 3.0, 9)


def test_a_vehicle_that_was_chosen_is_the_only_one() -> None:
    fixes = [("alpha", fix()), ("bravo", fix("none"))]
    assert chosen_place(fixes, only="bravo") is None
    assert chosen_place(fixes, only="alpha") == GgaPosition("alpha", 1.0, 2.0, 3.0, 9)


@each("gps", [{}, fix(None), fix("2d"), fix(lat=None), fix(lat=float("nan")), fix(lat=91.0), fix(lon_deg=None)])
def test_what_is_no_position_is_not_sent(gps: dict[str, Any]) -> None:
    assert chosen_place([("alpha", gps)]) is None


def test_a_place_without_height_or_satellites() -> None:
    assert chosen_place([("a", fix(alt_amsl_m=None, satellites=None))]) == GgaPosition("a", 1.0, 2.0, 0.0, 12)
