"""Lines of the socket: no number that a request brings is infinite, and every line that leaves is JSON."""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import skygcs.rpc
from skygcs.rpc.dispatch import parse
from skygcs.rpc.json_lines import id_of
from skygcs.rpc.replies import encode
from support.asked import asked
from support.loops import on_every_loop

ANY = st.recursive(
    st.one_of(st.none(), st.booleans(), st.floats(), st.integers(-(2**80), 2**80), st.text(st.characters())),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(st.characters()), inner, max_size=4)),
    max_leaves=12,
)


def strict(data: bytes) -> Any:
    """What a strict reader, as a browser's, makes of it."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(data.decode("utf-8"), parse_constant=refuse)


@given(ANY)
def test_whatever_the_daemon_holds_leaves_as_json(value: object) -> None:
    strict(encode({"value": value}))


@pytest.mark.parametrize(
    ("value", "line"),
    [
        ({"radius_m": math.nan, "height_m": -math.inf}, b'{"radius_m":null,"height_m":null}'),
        ({"file": "logs/\udcff.tlog", "size": math.nan}, b'{"file":"logs/?.tlog","size":null}'),
        ("Ü", '"Ü"'.encode()),
    ],
)
def test_what_json_lacks_has_a_form(value: object, line: bytes) -> None:
    assert encode(value) == line


@pytest.mark.parametrize(
    "number", ["1e999", "-1E+400", "1.5e309", "9" * 400 + ".5", "9" * 300 + "e99", "0." + "9" * 250 + "e310"]
)
def test_a_number_that_no_float_holds_is_refused(number: str) -> None:
    assert math.isinf(float(number))
    with pytest.raises(ValueError, match=r"too large|number"):
        parse(b'{"id":1,"params":[[%s]]}' % number.encode())


@pytest.mark.parametrize("text", ["1e308", "1e-999", "9" * 200, "9" * 400, '"1e999"', '"9e999 \\u00e9"', "0e0000400"])
def test_a_number_or_text_that_only_looks_like_it_is_read(text: str) -> None:
    assert parse(text.encode()) == json.loads(text)


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
        if path.name not in own and re.search(r"\bto_json\(|json\.dumps\((?!item\[)", path.read_text("utf-8"))
    ]
    assert not found, found


@on_every_loop
async def test_an_outcome_with_nan_is_reported_as_json(tmp_path: Path) -> None:
    async with asked(tmp_path) as gcs:
        gcs._session.notify("order.outcome", {"outcome": {"radius_m": math.nan}})
        assert gcs.notices[-1]["params"] == {"outcome": {"radius_m": None}}
