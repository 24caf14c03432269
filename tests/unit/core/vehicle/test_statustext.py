from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.vehicle.status_texts import (
    CHUNK_BYTES,
    CHUNK_TIMEOUT_S,
    MAX_CHUNKS,
    MAX_OPEN,
    StatusText,
    StatusTextAssembler,
)
from support.table import each

alphabet = st.characters(min_codepoint=0x21, max_codepoint=0x7E)
words = st.text(alphabet, min_size=1, max_size=CHUNK_BYTES * 6 - 1)
printable = st.text(alphabet, min_size=1, max_size=30)


def chunks(text: str, size: int = CHUNK_BYTES) -> list[bytes]:
    """As a sender cuts it: full chunks, the last one padded with NUL (an empty one if it came out even)."""
    raw = text.encode()
    parts = [raw[n : n + size] for n in range(0, len(raw), size)]
    if len(raw) % size == 0:
        parts.append(b"")
    return [part.ljust(size, b"\0") for part in parts]


def texts(done: list[StatusText]) -> list[str]:
    return [t.text for t in done]


def test_a_text_without_id_is_whole() -> None:
    assembler = StatusTextAssembler()
    done = assembler.on_text(2, b"Arm: Need Position Estimate".ljust(50, b"\0"), 0, 0, 1.0)
    assert done == [StatusText(2, "Arm: Need Position Estimate", 1.0)]


def test_px4s_trailing_tab_and_control_characters_do_not_reach_a_terminal() -> None:
    assembler = StatusTextAssembler()
    assert texts(assembler.on_text(6, b"Landing detected\t\0", 0, 0, 1.0)) == ["Landing detected"]
    assert texts(assembler.on_text(6, b"a\x1b[31mb\nc\0", 0, 0, 1.0)) == ["a [31mb c"]
    assert texts(assembler.on_text(6, b"\xff\xfe\0", 0, 0, 1.0)) == ["��"]


@given(words, st.integers(1, 65535), st.randoms(use_true_random=False))
def test_chunks_in_any_order_with_repeats_make_the_text_once(text: str, text_id: int, rng: random.Random) -> None:
    assembler = StatusTextAssembler()
    order = list(enumerate(chunks(text)))
    missing = rng.choice(order)
    early = [c for c in order if c is not missing]
    early += rng.choices(early, k=3) if early else []
    rng.shuffle(early)
    done = [t for seq, raw in early for t in assembler.on_text(4, raw, text_id, seq, 1.0)]
    assert done == []
    assert assembler.on_text(4, missing[1], text_id, missing[0], 1.2) == [StatusText(4, text, 1.2)]
    assert assembler.flush(100.0) == []


@given(printable.map(lambda w: (w * 300)[: CHUNK_BYTES * 2 + 7 * len(w)]), st.data())
def test_a_lost_chunk_leaves_a_mark_and_the_rest(text: str, data: st.DataObject) -> None:
    assembler = StatusTextAssembler()
    parts = chunks(text)
    lost = data.draw(st.integers(0, len(parts) - 2))
    for seq, raw in enumerate(parts):
        if seq != lost:
            assert assembler.on_text(4, raw, 9, seq, 1.0) == []
    assert assembler.flush(1.0 + CHUNK_TIMEOUT_S - 0.01) == []
    (whole,) = assembler.flush(1.0 + CHUNK_TIMEOUT_S)
    assert whole.text == text[: lost * CHUNK_BYTES] + "…" + text[(lost + 1) * CHUNK_BYTES :]


def test_a_text_whose_last_chunk_is_lost_is_given_out_as_far_as_it_came() -> None:
    assembler = StatusTextAssembler()
    assembler.on_text(4, b"x" * 50, 9, 0, 1.0)
    assert texts(assembler.flush(4.0)) == ["x" * 50]


def test_an_id_used_again_gives_out_the_old_text_first() -> None:
    assembler = StatusTextAssembler()
    assembler.on_text(4, b"a" * 50, 1, 0, 1.0)
    assert texts(assembler.on_text(4, b"b" * 50, 1, 0, 1.1)) == ["a" * 50]
    assert texts(assembler.on_text(4, b"end".ljust(50, b"\0"), 1, 1, 1.2)) == ["b" * 50 + "end"]


@given(st.lists(st.tuples(st.binary(min_size=50, max_size=50), st.integers(0, 65535), st.integers(0, 255))))
def test_nothing_makes_it_raise_or_grow(story: list[tuple[bytes, int, int]]) -> None:
    assembler = StatusTextAssembler()
    longest = 0
    for n, (raw, text_id, seq) in enumerate(story):
        done = assembler.on_text(6, raw, text_id, seq, float(n) / 100)
        longest = max([longest, *(len(t.text) for t in done)])
        assert len(assembler._open) <= MAX_OPEN
    assert longest <= MAX_CHUNKS * CHUNK_BYTES
    assembler.flush(1e6)
    assert not assembler._open


@each("seq", [MAX_CHUNKS, 255])
def test_a_chunk_far_out_is_ignored(seq: int) -> None:
    assembler = StatusTextAssembler()
    assert assembler.on_text(6, b"x" * 50, 5, seq, 0.0) == []
    assert assembler.flush(10.0) == []
