"""The chunked transfer coding: any pieces, bounds, and what is none."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import LinkError
from skygcs.ext.corrections.chunked import MAX_CHUNK_BYTES, MAX_SIZE_LINE_BYTES, ChunkedDecoder
from support.table import each


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
