"""Lines of the socket: no number that a request brings is infinite, and every line that leaves is JSON."""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import dataclass
from datetime import date
from pathlib import Path, PosixPath
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

import skygcs.rpc
from skygcs.core.trajectory.piecewise import MAX_DEGREE
from skygcs.rpc import replies
from skygcs.rpc.dispatch import MAX_MEMBERS, Dispatcher, Method
from skygcs.rpc.error_codes import INTERNAL_ERROR, LIMIT_EXCEEDED
from skygcs.rpc.json_lines import MAX_LINE_BYTES, id_of
from skygcs.rpc.models import MethodParams, NoParams
from skygcs.rpc.replies import (
    NotJsonError,
    TooManyValuesError,
    encode,
    error_reply,
    parse,
    parse_request,
    reply_of,
    unread,
)
from skygcs.runtime.trajectories import MAX_PIECES
from support.asked import asked
from support.loops import on_every_loop
from support.table import each

ANY = st.recursive(
    st.one_of(st.none(), st.booleans(), st.floats(), st.integers(-(2**80), 2**80), st.text(st.characters())),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(st.characters()), inner, max_size=4)),
    max_leaves=12,
)


class Named(MethodParams):
    name: str


def strict(data: bytes) -> Any:
    """What a strict reader, as a browser's, makes of it."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(data.decode("utf-8"), parse_constant=refuse)


@given(ANY)
def test_whatever_the_daemon_holds_leaves_as_json(value: object) -> None:
    strict(encode({"value": value}))


@each(
    ("value", "line"),
    [
        ({"radius_m": math.nan, "height_m": -math.inf}, b'{"radius_m":null,"height_m":null}'),
        ({"file": "logs/\udcff.tlog", "size": math.nan}, b'{"file":"logs/?.tlog","size":null}'),
        ("Ü", '"Ü"'.encode()),
    ],
)
def test_what_json_lacks_has_a_form(value: object, line: bytes) -> None:
    assert encode(value) == line


@dataclass
class Log:
    name: str


CIRCLE: list[Any] = []
CIRCLE.append(CIRCLE)
DEEP: list[Any] = []
for _ in range(3000):
    DEEP = [DEEP]


@each(
    ("value", "line"),
    [
        ({"a\udcff": 1}, b'{"a?":1}'),
        ({"a": b"\xff\xc3\xbc"}, '{"a":"?ü"}'.encode()),
        ({b"\xff": [1.5, math.inf, None]}, b'{"?":[1.5,null,null]}'),
        ([10**5000, "\udcff"], b"[1" + b"0" * 5000 + b',"?"]'),
        ({"x": (Log("\udcff"), {"\udcff"}, Path("/\udcff"))}, b'{"x":[{"name":"?"},["?"],"/?"]}'),
        ({"at": date(2026, 1, 2), "\udcff": PosixPath("a")}, b'{"at":"2026-01-02","?":"a"}'),
    ],
)
def test_what_is_no_unicode_has_a_form_wherever_it_stands(value: object, line: bytes) -> None:
    assert encode(value) == line


class Raises:
    @property
    def __dict__(self) -> Any:  # type: ignore[override]
        raise RuntimeError("no")

    def __str__(self) -> str:
        raise RuntimeError("no")

    __repr__ = __str__


@each("value", [CIRCLE, DEEP, object(), Raises(), {"\udcff": object()}])
def test_what_has_no_form_is_one_declared_error_and_a_reply_all_the_same(value: object) -> None:
    with pytest.raises(NotJsonError):
        encode(value)
    assert strict(error_reply(7, -32000, "a \udcff name", value))["error"]["message"] == "a ? name"
    assert strict(error_reply(value, -32000, "no"))["id"] is None
    assert strict(reply_of(value, b"1")) == {"jsonrpc": "2.0", "id": None, "result": 1}


@each(
    ("result", "answered"),
    [({"\udcff": 1}, {"?": 1}), ({"a": b"\xff"}, {"a": "?"}), (CIRCLE, None), (DEEP, None), (object(), None)],
)
@each("request_id", [1, 10**20, "a"])
def test_a_request_is_answered_whatever_its_method_returns(result: object, answered: object, request_id: Any) -> None:
    dispatcher = Dispatcher({"x.y": Method("x.y", NoParams, lambda context, _: result)})
    with capture_logs():  # rich would draw what is nested so deeply for minutes
        reply = dispatcher.start(None, {"jsonrpc": "2.0", "id": request_id, "method": "x.y"})
    assert isinstance(reply, bytes) and (answer := strict(reply))["id"] == request_id
    assert answer["result"] == answered if answered is not None else answer["error"]["code"] == INTERNAL_ERROR


@each("given", [[10**5000], CIRCLE, {(1, 2): 3}])
def test_parameters_that_cannot_be_shown_are_refused_in_words(given: object) -> None:
    dispatcher = Dispatcher({"x.y": Method("x.y", Named, lambda context, _: 1)})
    reply = dispatcher.start(None, {"jsonrpc": "2.0", "id": 1, "method": "x.y", "params": {"name": given}})
    assert isinstance(reply, bytes) and "name: should be a valid string" in strict(reply)["error"]["message"]


@each("number", ["1e999", "-1E+400", "1.5e309", "9" * 400 + ".5", "9" * 300 + "e99", "0." + "9" * 250 + "e310"])
def test_a_number_that_no_float_holds_is_refused(number: str) -> None:
    assert math.isinf(float(number))
    with pytest.raises(ValueError, match=r"too large|number"):
        parse(b'{"id":1,"params":[[%s]]}' % number.encode())


@each("text", ["1e308", "1e-999", "9" * 200, "9" * 400, '"1e999"', '"9e999 \\u00e9"', "0e0000400"])
def test_a_number_or_text_that_only_looks_like_it_is_read(text: str) -> None:
    assert parse(text.encode()) == json.loads(text)


@each("depth", [1, 100, 200])
def test_a_text_with_the_word_beside_a_number_is_told_from_the_number(depth: int) -> None:
    open_, close = b"[" * depth, b"]" * depth
    text = open_ + b'"Infinity",-1e5,"-Infinity 1e999",{"Infinity":' + b"9" * 400 + b"}" + close
    if depth < 200:
        assert parse(text) == json.loads(text)
    with pytest.raises(ValueError):
        parse(text.replace(b"-1e5", b"-1e400"))


def test_a_line_of_text_or_of_numbers_is_not_read_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line of 1 MiB held the loop for 60 ms and more; the second look is made where a number may be too large."""
    looked = list[object]()
    monkeypatch.setattr(replies, "_has_infinity", lambda value: looked.append(value) or False)
    for line in (b'"%b"' % (b"a" * 1000), b"[%b1.5]" % (b"1.5," * 1000), b"[%b]" % (b"9" * 308)):
        parse(line)
    assert looked == []
    for line in (b'"%b"' % (b"9" * 309), b"1e5", b"1E5"):
        parse(line)
    assert len(looked) == 3


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_comes_back(value: float) -> None:
    assert parse(json.dumps(value).encode()) == value


def test_an_id_is_text_or_a_number() -> None:
    assert [id_of({"id": given}) for given in ("a", 0, 1.5, sys.maxsize)] == ["a", 0, 1.5, sys.maxsize]
    assert not any(id_of({"id": given}) for given in (None, True, [1], {"a": 1}))


def test_there_is_one_encoder_of_what_leaves_the_daemon() -> None:
    own = {"replies.py", "json_lines.py", "client.py", "client_connection.py", "client_inbox.py"}
    found = [
        path.name
        for path in Path(skygcs.rpc.__file__).parent.glob("*.py")
        if path.name not in own
        and re.search(r"\bto_json\(|json\.dumps\((?!value, default=str)", path.read_text("utf-8"))
    ]
    assert not found, found


@on_every_loop
async def test_an_outcome_with_nan_is_reported_as_json(tmp_path: Path) -> None:
    async with asked(tmp_path) as gcs:
        gcs._session.notify("order.outcome", {"outcome": {"radius_m": math.nan}})
        assert gcs.notices[-1]["params"] == {"outcome": {"radius_m": None}}


SERIOUS = {
    "the longest trajectory": [
        {"duration_s": 1.5} | {axis: [1] * (MAX_DEGREE + 1) for axis in ("x", "y", "up", "yaw")}
        for _ in range(MAX_PIECES)
    ],
    "a file in a text": {"text": '[{"\\"a\\\\": [1, 2, 3]}]' * 30_000},
    "written paths of 100 vehicles": {
        "paths": {f"v{vehicle}": {"points": [[n, vehicle, 10.5] for n in range(400)]} for vehicle in range(100)}
    },
    "a report of 100 vehicles in ROS": {
        "vehicles": [
            {"name": f"v{n}", "root": f"/v{n}", "setpoints": "none"}
            | dict.fromkeys(("setpoints_sent", "setpoints_refused", "commands_rejected"), n)
            for n in range(100)
        ],
        "topics": [
            {"name": f"/v{n // 80}/out/{n % 80}", "readers": 1, "rate_hz": 10.0, "count": 12345, "refused": 0}
            for n in range(8000)
        ],
    },
    "all parameters": {f"P{n}": n for n in range(MAX_MEMBERS)},
}


@pytest.mark.parametrize("params", SERIOUS.values(), ids=SERIOUS)
def test_what_is_meant_seriously_is_read(params: object) -> None:
    line = json.dumps(params, separators=(",", ":")).encode()
    assert len(line) <= MAX_LINE_BYTES and parse_request(line) == params


@pytest.mark.parametrize(
    ("line", "named"),
    [
        (b"[" * 150 + b"]" * 150, "lists and objects"),
        (b"{},", "lists and objects"),
        (b"[[0,0],[1,1]],", "lists and objects"),
        (b"0,", "values"),
        (b'"x":1 ,', "keys"),
        (b'"\\\\":"\\"" ,', "keys"),
    ],
)
def test_a_request_of_too_many_values_is_refused_unread(
    line: bytes, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A megabyte of them held the loop, and with it the ticks of vehicles that were flown, for 30 to 200 ms."""
    monkeypatch.setattr(replies, "from_json", lambda *_, **__: pytest.fail("it was parsed"))
    with pytest.raises(TooManyValuesError, match=named) as raised:
        parse_request(line * (MAX_LINE_BYTES // len(line)))
    assert unread(raised.value)[0] == LIMIT_EXCEEDED


@given(ANY)
def test_marks_in_texts_count_for_nothing(value: object) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(replies, "MOST", {"values": (b",[{:", 100)})
        line = json.dumps(value).encode()
        text = json.dumps(line.decode() * 30).encode()
        assert parse_request(text) == line.decode() * 30
