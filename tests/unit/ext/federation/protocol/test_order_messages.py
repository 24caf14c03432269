"""Messages of orders between sites: what is written is read, and what is anything else is left out."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.federation.protocol import audit
from skygcs.ext.federation.protocol.order_messages import (
    MAX_BYTES,
    OrderReply,
    OrderRequest,
    OutcomeQuestion,
    decode_question,
    decode_reply,
    decode_request,
    vehicle_of_token,
    vehicle_token,
)
from support.table import each

KEY = "0123456789abcdef" * 2
OUTCOME = {"ok": True, "result": "accepted", "message": "m", "attempts": 1, "elapsed_s": 0.5, "status_texts": ["a"]}

json_values = st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=False) | st.integers() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=10), inner, max_size=3),
    max_leaves=8,
)
KEYS = ("v", "id", "method", "params", "deadline_s", "by", "role", "run", "seq", "status", "text", "outcome", "wait_s")


@given(name=st.text(min_size=1, max_size=64))
def test_every_name_is_one_token_and_no_reserved_one(name: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError:
        return
    token = vehicle_token(name)
    assert token != "outcome" and not set(token) & set(" .*>\t\r\n")
    assert vehicle_of_token(token) == name


@given(token=st.text(max_size=40))
def test_a_token_that_is_read_is_the_one_that_is_written(token: str) -> None:
    name = vehicle_of_token(token)
    assert name is None or vehicle_token(name) == token


def test_what_is_written_is_read() -> None:
    request = OrderRequest(KEY, "alpha", "vehicles.goto", {"lat_deg": 1.5}, 12.25, "mia@south", "operator", "r1", 7)
    assert decode_request("alpha", request.encoded()) == request
    reply = OrderReply(KEY, "done", "landing", OUTCOME)
    assert decode_reply(KEY, reply.encoded()) == reply
    assert decode_reply("f" * 32, reply.encoded()) is None
    question = OutcomeQuestion(KEY, 0.5, 3.0)
    assert decode_question(question.encoded()) == question


@given(
    payload=st.binary(max_size=200)
    | st.dictionaries(st.sampled_from(KEYS), json_values).map(json.dumps).map(str.encode)
)
def test_anything_else_is_left_out(payload: bytes) -> None:
    """Nothing raises, also with the right keys and any values."""
    request, question, reply = decode_request("alpha", payload), decode_question(payload), decode_reply(KEY, payload)
    for read in (request, question, reply):
        if read is not None:
            assert json.loads(payload)["id"] == read.key


@each(
    "change",
    [
        {"id": "short"},
        {"deadline_s": "5"},
        {"deadline_s": 10**400},
        {"deadline_s": True},
        {"seq": -1},
        {"params": []},
        {"by": None},
        {"params": {"x": "a" * MAX_BYTES}},
    ],
)
def test_an_order_that_is_not_one(change: dict[str, object]) -> None:
    whole = {"id": KEY, "method": "vehicles.land", "params": {}, "deadline_s": 1.0, "by": "mia@south", "role": "site"}
    assert decode_request("alpha", json.dumps(whole).encode()) is not None
    assert decode_request("alpha", json.dumps(whole | change).encode()) is None


@given(by=st.text(max_size=300), text=st.text(max_size=3000), params=st.dictionaries(st.text(max_size=5), json_values))
def test_a_record_is_one_line_and_is_remembered(by: str, text: str, params: dict[str, object]) -> None:
    try:
        (by + text + json.dumps(params, ensure_ascii=False)).encode()
    except UnicodeEncodeError:
        return
    request = OrderRequest(KEY, "alpha", "vehicles.goto", params, 12.0, by, "operator", "r", 3)
    outcome = {**OUTCOME, "message": text, "status_texts": [text] * 20}
    line = audit.record(request, OrderReply(KEY, "failed", text, outcome), 10.5).encoded()
    assert b"\n" not in line and len(line) <= audit.MAX_LINE_BYTES
    (read,) = audit.remembered([line])
    assert read is not None
    wanted = ("failed", 12.0, 10.5, "alpha", 3)
    assert (read.reply.status, read.deadline_s, read.noted_s, read.vehicle, read.seq) == wanted
    assert list(audit.remembered([line[:-1], b"", b"[]", b"\xff"])) == [None] * 4


@each("number", ["1e999", "1" + 400 * "0"])
def test_an_order_with_a_number_that_nothing_can_hold_is_none(number: str) -> None:
    """Left out or rounded it would be another order."""
    order = OrderRequest(KEY, "alpha", "vehicles.goto", {"alt_m": 17.25}, 5.5, "a@b", "site")
    payload = order.encoded().decode()
    for known in ("17.25", "5.5"):
        assert payload.count(known) == 1
        assert decode_request("alpha", payload.replace(known, number).encode()) is None


def test_the_outcome_of_another_site_can_be_shown() -> None:
    outcome = {**OUTCOME, "message": "a\x1b", "status_texts": ["\u202e"], "fence": {"k\n": "\x9b"}, "n": 10**400}
    payload = json.dumps({"id": KEY, "status": "done", "text": "t\n", "outcome": outcome}).encode()
    reply = decode_reply(KEY, payload)
    assert reply is not None and reply.text == "t?"
    shown = {**OUTCOME, "message": "a?", "status_texts": ["?"], "fence": {"k?": "?"}, "n": None}
    assert reply.outcome == shown
