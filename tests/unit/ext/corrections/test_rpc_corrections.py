"""corrections.send takes base64 and nothing else."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from skygcs.ext.corrections.methods import MAX_DATA_CHARS, CorrectionsParams, corrections_send
from skygcs.rpc.dispatch import InvalidParams
from support.fake_daemon import FakeDaemon
from support.table import each


class Session:
    def __init__(self) -> None:
        self.services = FakeDaemon()


def ask(session: Any, **params: Any) -> Any:
    return corrections_send(session, CorrectionsParams.model_validate(params))


def test_the_bytes_and_whose_they_are_reach_the_daemon() -> None:
    session = Session()
    session.services.corrections.answer = {"messages": 1}
    assert ask(session, data="0wAT", source="roof") == {"messages": 1}
    assert ask(session, data="", end=True) == {"messages": 1}
    assert session.services.corrections == [("roof", b"\xd3\x00\x13", False), ("rpc", b"", True)]


@each("data", ["0wA", "0w A", "d3 00 13", "0wAT\n", "Ó"])
def test_what_is_not_base64_is_refused(data: str) -> None:
    session = Session()
    with pytest.raises(InvalidParams, match="data: is not base64"):
        ask(session, data=data)
    assert session.services.corrections == []


@each("params", [{"data": "A" * (MAX_DATA_CHARS + 4)}, {"data": "", "source": ""}, {}])
def test_what_does_not_fit_its_schema_is_refused(params: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ask(Session(), **params)
