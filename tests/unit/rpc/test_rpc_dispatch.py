"""JSON-RPC 2.0 itself, without sockets."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Coroutine
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, ValidationError

from skygcs.errors import ConfigError, LinkError, RefusedError, TargetError
from skygcs.rpc.dispatch import Dispatcher, InvalidParams, LimitExceeded, Method, Reply, deadline_refusal
from skygcs.rpc.models import MAX_TEXT_CHARS, MethodParams, NoParams
from skygcs.rpc.replies import key_twice, parse
from support.table import each


class PairParams(MethodParams):
    first: int
    second: float = Field(2.0, gt=0)


class Calls:
    def __init__(self) -> None:
        self.made: list[PairParams] = []


def pair(calls: Calls, params: PairParams) -> list[float]:
    calls.made.append(params)
    return [params.first, params.second]


async def slow_pair(calls: Calls, params: PairParams) -> list[float]:
    await asyncio.sleep(0)
    return pair(calls, params)


def raising(error: Exception) -> Method[Calls]:
    def fail(calls: Calls, params: NoParams) -> None:
        raise error

    return Method("fail", NoParams, fail)


DISPATCHER = Dispatcher[Calls](
    {"pair": Method("pair", PairParams, pair), "slow": Method("slow", PairParams, slow_pair)}
)


def finished(reply: Reply) -> bytes | None:
    """A reply at its end."""
    return reply if reply is None or isinstance(reply, bytes) else asyncio.run(_awaited(reply))


async def _awaited(reply: Coroutine[Any, Any, bytes]) -> bytes:
    return await reply


def ask(request: object, dispatcher: Dispatcher[Calls] = DISPATCHER) -> Any:
    """The decoded answer, None for none."""
    reply = finished(dispatcher.start(Calls(), request))
    assert b"\n" not in (reply or b"")
    return json.loads(reply) if reply else None


def request(method: str = "pair", params: Any = None, request_id: Any = 1) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}


@each("method", ["pair", "slow"])
def test_result_comes_with_the_requests_id(method: str) -> None:
    for request_id in (1, "x", 2.5, None, 10**40, "\x00\u2028é"):
        wanted = {"jsonrpc": "2.0", "id": request_id, "result": [3, 2.0]}
        assert ask(request(method, {"first": 3}, request_id)) == wanted


@each("method", ["pair", "slow"])
def test_parameters_may_be_given_by_position(method: str) -> None:
    assert ask(request(method, [3, 4]))["result"] == [3, 4.0]


@each("method", ["pair", "slow", "nonsense"])
def test_notification_is_carried_out_and_never_answered(method: str) -> None:
    calls = Calls()
    for params in ({"first": 3}, {"wrong": 1}, 7):
        reply = DISPATCHER.start(calls, {"jsonrpc": "2.0", "method": method, "params": params})
        assert not finished(reply)
    assert len(calls.made) == (method != "nonsense")


@each(
    "bad",
    [
        1,
        "x",
        None,
        [],
        {},
        {"jsonrpc": "2.0"},
        {"jsonrpc": "2.0", "method": 1, "id": 1},
        {"jsonrpc": "1.0", "method": "pair", "id": 1},
        {"method": "pair", "id": 1},
        {"jsonrpc": "2.0", "method": "pair", "id": True},
        {"jsonrpc": "2.0", "method": "pair", "id": [1]},
        {"jsonrpc": "2.0", "method": "pair", "id": {}},
    ],
)
def test_what_is_no_request_is_an_invalid_request(bad: object) -> None:
    answer = ask(bad)
    assert answer["error"]["code"] == -32600
    assert answer["id"] == (
        bad.get("id") if isinstance(bad, dict) and bad.get("id") is not True and bad.get("id") == 1 else None
    )


def test_unknown_method_is_named_with_what_is_close() -> None:
    answer = ask(request("pear"))
    assert answer["error"]["code"] == -32601
    assert "pear" in answer["error"]["message"] and "did you mean pair" in answer["error"]["message"]
    assert len(ask(request("x" * 100_000))["error"]["message"]) < 300


def test_every_wrong_parameter_is_told_in_words() -> None:
    answer = ask(request(params={"frist": 1, "second": -3}))
    assert answer["error"]["code"] == -32602
    problems = {p["param"]: p["problem"] for p in answer["error"]["data"]["problems"]}
    assert problems == {
        "first": "is missing",
        "frist": "no such parameter; did you mean first?",
        "second": "should be greater than 0 (got -3)",
    }
    assert all(param in answer["error"]["message"] for param in problems)
    assert "pydantic" not in json.dumps(answer)


@each(
    "params", [{f"k{n}": 0 for n in range(5000)}, {"first": {f"k{n}": 0 for n in range(5000)}, "second": 1}, [0] * 5000]
)
def test_what_is_wrong_with_a_megabyte_is_told_in_a_few_words(params: Any) -> None:
    assert len(json.dumps(ask(request(params=params)))) < 1000


def test_the_members_of_a_parameter_are_counted_before_each_is_checked() -> None:
    answer = ask(request(params={"first": {f"k{n}": 0 for n in range(5000)}, "second": 1}))
    assert answer["error"]["message"] == "pair: first: has 5000 members; at most 4096"


def test_thousands_of_wrong_values_are_counted() -> None:
    class ManyParams(MethodParams):
        pairs: list[PairParams]

    dispatcher = Dispatcher[Calls]({"many": Method("many", ManyParams, lambda calls, params: None)})
    answer = ask(request("many", {"pairs": [{"first": "x", "third": 1}] * 5000}), dispatcher)
    assert answer["error"]["code"] == -32602 and "10000 values are wrong" in answer["error"]["message"]
    assert len(json.dumps(answer)) < 1000


def test_a_long_text_is_refused_before_an_order_repeats_it_for_each_vehicle() -> None:
    class ModeParams(MethodParams):
        mode: str

    assert ModeParams(mode="x" * MAX_TEXT_CHARS)
    with pytest.raises(ValidationError, match=f"at most {MAX_TEXT_CHARS}"):
        ModeParams(mode="x" * (MAX_TEXT_CHARS + 1))


@each("params", [7, "x", True, [1, 2, 3], {"first": "1"}, {"first": True}, {"first": 1.5}])
def test_parameters_of_the_wrong_shape_or_type_are_refused(params: Any) -> None:
    assert ask(request(params=params))["error"]["code"] == -32602


@each(
    ("error", "code"),
    [
        (TargetError("no vehicle 7"), -32001),
        (RefusedError("too far"), -32002),
        (LinkError("no link x"), -32003),
        (LimitExceeded("too many"), -32005),
        (InvalidParams(("name", "unknown")), -32602),
        (ConfigError("links.x", ["links.x.port: is missing"]), -32602),
    ],
)
def test_errors_raised_on_purpose_keep_their_text(error: Exception, code: int) -> None:
    answer = ask(request("fail"), Dispatcher({"fail": raising(error)}))
    assert answer["error"]["code"] == code
    assert str(error).splitlines()[-1].strip() in answer["error"]["message"]


def test_a_bug_is_answered_without_its_text_or_traceback() -> None:
    answer = ask(request("fail"), Dispatcher({"fail": raising(ZeroDivisionError("secret"))}))
    assert answer["error"]["code"] == -32603
    assert "secret" not in json.dumps(answer) and "Traceback" not in json.dumps(answer)


async def test_a_request_whose_work_is_cancelled_while_its_client_is_there_gets_an_error() -> None:
    """As that of params.list, whose vehicle is renumbered; its client's end still ends it."""

    async def list_all(context: Any, params: NoParams) -> Any:
        await asyncio.shield(work)

    dispatcher = Dispatcher({"params.list": Method("params.list", NoParams, list_all)})
    for client_ends in (False, True):
        work = asyncio.get_running_loop().create_future()
        reply = dispatcher.start(None, request("params.list"))
        assert isinstance(reply, Coroutine)
        task = asyncio.create_task(reply)
        await asyncio.sleep(0)
        (task if client_ends else work).cancel()
        await asyncio.wait({task})
        assert task.cancelled() is client_ends
        if not client_ends:
            assert "params.list was cancelled" in json.loads(task.result())["error"]["message"]


def test_a_result_that_json_cannot_carry_is_an_internal_error() -> None:
    method = Method[Calls]("odd", NoParams, lambda calls, params: object())
    assert ask(request("odd"), Dispatcher({"odd": method}))["error"]["code"] == -32603


def test_nan_and_infinity_are_null_in_results() -> None:
    method = Method[Calls]("odd", NoParams, lambda calls, params: [math.nan, math.inf, -math.inf, 1.5])
    assert ask(request("odd"), Dispatcher({"odd": method}))["result"] == [None, None, None, 1.5]


@each(
    "line", [b"", b"{", b'{"a":NaN}', b"[" * 100_000, b"9" * 5000, b"\xff\xfe", b'"\\ud800"', b"[1,]", b"nul", b"{}{}"]
)
def test_what_is_not_json_is_a_value_error_with_a_text(line: bytes) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        parse(line)


@each(
    ("line", "key"),
    [
        (b'{"a":1,"b":{"a":2},"c":[{"a":3},{"a":4}]}', None),
        (b'{"a":1,"a":1}', "a"),
        (b'{"a":1,"a" :1}', "a"),
        (b'{"a":":","b":{"c":"\\"c","c":",\\""}}', "c"),
        (b'{"a":"x","b":":y","c":"a:"}', None),
        (b'[{"x":{"b":1,"c":2,"\\u0062":3}}]', "b"),
        (b'{"n":' + b"9" * 4000 + b',"n":1}', "n"),
        (b"7", None),
    ],
)
def test_a_key_that_is_there_twice_is_found_in_any_object(line: bytes, key: str | None) -> None:
    parse(line)
    assert key_twice(line) == key


def test_where_a_key_twice_would_lose_something_the_request_is_refused_and_elsewhere_the_last_one_counts() -> None:
    calls = Calls()
    strict = Dispatcher({"pair": Method("pair", PairParams, pair, unique_keys=True)})
    line = b'{"jsonrpc":"2.0","id":5,"method":"pair","params":{"first":1,"first":2}}'
    for dispatcher, made in ((strict, []), (DISPATCHER, [2])):
        reply = finished(dispatcher.start(calls, parse(line), lambda: key_twice(line)))
        answer = json.loads(reply or b"")
        assert answer["id"] == 5 and [params.first for params in calls.made] == made
        assert ("error" in answer) == (dispatcher is strict)
        assert "the key 'first' is there twice" in answer.get("error", {}).get("message", "") or made


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)
near_requests = st.fixed_dictionaries(
    {},
    optional={
        "jsonrpc": st.just("2.0") | json_values,
        "id": json_values,
        "method": st.sampled_from(["pair", "slow", "nonsense"]) | json_values,
        "params": st.fixed_dictionaries({"first": st.integers()}) | json_values,
    },
)


@given(json_values | near_requests)
def test_any_json_gets_a_valid_answer_or_none(value: Any) -> None:
    answer = ask(value)
    if answer is not None:
        assert answer["jsonrpc"] == "2.0" and "id" in answer
        assert ("result" in answer) != ("error" in answer)


def test_a_request_is_refused_after_its_deadline_only() -> None:
    request = {"jsonrpc": "2.0", "id": 7, "method": "pair", "deadline_s": 10.0}
    assert deadline_refusal(request, 10.0) is None
    reply = json.loads(deadline_refusal(request, 12.5) or b"")
    assert reply["id"] == 7 and reply["error"]["code"] == -32002
    assert reply["error"]["message"] == "read 2.5 s after its deadline; it was not carried out"


@each("deadline_s", [None, "10", True, [], {}, -(10**400)])
@each("request_id", [None, True, []])
def test_a_deadline_that_is_no_time_is_refused(deadline_s: object, request_id: object) -> None:
    reply = deadline_refusal({"id": request_id, "deadline_s": deadline_s}, 0.0)
    assert reply is not None
    assert json.loads(reply)["id"] is None and json.loads(reply)["error"]["code"] == -32600
