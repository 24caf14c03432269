"""Lines and messages of JSON-RPC as bytes; the oracles are bytes.split and the standard library's JSON."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.rpc.json_lines import LineBuffer, LineTooLong, id_of, notification, notification_start
from skygcs.rpc.replies import encode, error_reply, reply_of
from support.table import each

LIMIT = 8
TOO_LONG = b"too long"
STREAM = st.lists(st.sampled_from([b"a", b"bc", b" ", b"\n", b"\r\n", b"1234567", b"\xff"]), max_size=40)


def taken(buffer: LineBuffer) -> list[bytes]:
    """All lines of the buffer, and `TOO_LONG` for each line that is refused."""
    found: list[bytes] = []
    while True:
        try:
            line = buffer.take(LIMIT)
        except LineTooLong:
            found.append(TOO_LONG)
            continue
        if line is None:
            return found
        found.append(line)


@given(STREAM)
def test_lines_are_those_of_the_stream_in_whatever_pieces_it_comes(pieces: list[bytes]) -> None:
    *whole, rest = b"".join(pieces).split(b"\n")
    expected = [TOO_LONG if len(line) > LIMIT else line for line in whole if len(line) > LIMIT or line.strip()]
    buffer, found = LineBuffer(), []
    for piece in pieces:
        buffer.feed(piece)
        found += taken(buffer)
    assert found == expected + [TOO_LONG] * (len(rest) > LIMIT)  # one that is too long is refused before its end
    buffer.end()
    assert taken(buffer) == ([rest] if rest.strip() and len(rest) <= LIMIT else [])
    assert len(buffer) == 0


@given(STREAM)
def test_whole_lines_together_lose_nothing(pieces: list[bytes]) -> None:
    buffer, found = LineBuffer(), b""
    for piece in pieces:
        buffer.feed(piece)
        lines = buffer.take_whole()
        assert lines == b"" or lines.endswith(b"\n")
        found += lines
    stream = b"".join(pieces)
    assert found == stream[: stream.rfind(b"\n") + 1]
    assert len(buffer) == len(stream) - len(found)


@each("blank", [b"\n", b"\r\n", b" \t\n", b"\v\f\n"])
def test_a_flood_of_blank_lines_is_taken_in_one_step(blank: bytes) -> None:
    """256 KiB of newlines held the loop for 150 ms."""
    buffer, counted = LineBuffer(), Counted()
    buffer._bytes = counted
    flood = blank * (100_000 // len(blank))
    buffer.feed(flood + b"next\n" + flood)
    assert buffer.take(1 << 20) == b"next" and buffer.take(1 << 20) is None
    assert counted.searches <= 5 and not buffer


@each("limit", [1, 10, 1000])
def test_blank_lines_are_taken_within_the_limit(limit: int) -> None:
    buffer = LineBuffer()
    buffer.feed(b"\n" * 5000 + b" " * (limit + 1) + b"\n" + b"\n" * 5000 + b"x\n")
    with pytest.raises(LineTooLong):
        buffer.take(limit)
    assert buffer.take(limit) == b"x"


def test_what_is_skipped_is_not_kept() -> None:
    buffer = LineBuffer()
    buffer.feed(b"x" * (LIMIT + 1))
    assert taken(buffer) == [TOO_LONG]
    for _ in range(100):
        buffer.feed(b"x" * 1000)
        assert taken(buffer) == [] and len(buffer) == 0
    buffer.feed(b"\nnext\n")
    assert taken(buffer) == [b"next"]


class Counted(bytearray):
    """A buffer that counts the bytes in which a newline was looked for."""

    searched = searches = 0

    def find(self, sub: Any, start: Any = 0, end: Any = None) -> int:
        self.searches += 1
        self.searched += len(self) - start
        return super().find(sub, start)

    rfind = find


@each("whole", [True, False])
def test_a_long_line_in_small_pieces_is_searched_once(whole: bool) -> None:
    """A stranger may send a line byte by byte: it must cost its length, not the square of it."""
    buffer, counted = LineBuffer(), Counted()
    buffer._bytes = counted
    for _ in range(1000):
        buffer.feed(b"x")
        assert not buffer.take_whole() if whole else buffer.take(1000) is None
    assert counted.searched == 1000


@each("value", [None, 0, -1, 2**53, 1.5, "", "a", 'quote " and \u00e9'])
def test_an_id_comes_back_as_it_was_sent(value: Any) -> None:
    assert id_of({"id": value}) == value
    assert json.loads(error_reply(value, -32600, "no"))["id"] == value
    assert json.loads(reply_of(value, b"[1]")) == {"jsonrpc": "2.0", "id": value, "result": [1]}


@each("value", [True, False, [], {}, [1]])
def test_what_is_no_id_is_none(value: Any) -> None:
    assert id_of({"id": value}) is None


def test_what_is_no_request_has_no_id() -> None:
    assert [id_of(request) for request in ([], "id", None, {}, 1)] == [None] * 5


@each("value", [float("inf"), float("nan")])
def test_an_id_that_json_cannot_carry_is_answered_as_null(value: float) -> None:
    assert encode(value) == b"null"


def test_messages_are_json() -> None:
    assert json.loads(error_reply(1, -32000, "a \udcff name", {"why": {1, 2}.__class__})) == {
        "jsonrpc": "2.0",
        "id": 1,
        "error": {"code": -32000, "message": "a ? name", "data": {"why": "<class 'set'>"}},
    }
    assert "data" not in json.loads(error_reply(1, -32000, "no"))["error"]
    assert json.loads(notification("web.plan", b"[1]")) == {"jsonrpc": "2.0", "method": "web.plan", "params": [1]}
    assert json.loads(notification_start("event", "kind") + b"1}}")["params"] == {"kind": 1}


@each("limit", [0, 3])
def test_a_refusal_names_the_limit(limit: int) -> None:
    buffer = LineBuffer()
    buffer.feed(b"abcd\n")
    with pytest.raises(LineTooLong, match=f"at most {limit} bytes"):
        buffer.take(limit)
