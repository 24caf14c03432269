"""Methods whose module is imported when one of them is first called."""

from __future__ import annotations

import asyncio
import importlib
import json
import sys
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.rpc.dispatch import Dispatcher, Later, Method, MethodTable, Reply
from skygcs.rpc.methods import METHODS
from skygcs.rpc.models import NoParams

PART = Later("later_part", "METHODS", ("part.set", "part.get"), always=("part.get",))
MODULE = """
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams

def set_it(calls, _):
    calls.append("set")
    return len(calls)

async def get_it(calls, _):
    return list(calls)

METHODS = (Method("part.set", NoParams, set_it), Method("part.get", NoParams, get_it, always=True))
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """What `PART` names, not imported yet."""
    monkeypatch.syspath_prepend(str(tmp_path))
    file = tmp_path / "later_part.py"
    file.write_text(MODULE)
    yield file
    sys.modules.pop(PART.module, None)


def table() -> MethodTable[list[str]]:
    here: Method[list[str]] = Method("here", NoParams, lambda calls, _: len(calls))
    return MethodTable((here,), PART)


def request(method: str, number: int = 1) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": number, "method": method}


async def answered(reply: Reply) -> Any:
    raw = await reply if isinstance(reply, Coroutine) else reply
    assert raw
    return json.loads(raw)


def test_the_table_has_names_and_flags_before_anything_is_imported(module: Path) -> None:
    methods_of = table()
    assert (list(methods_of), methods_of.always) == (["here", "part.set", "part.get"], {"part.get"})
    assert "part.set" in methods_of and "part.none" not in methods_of
    assert not Dispatcher(methods_of).outlives_client(request("part.set"))
    assert PART.module not in sys.modules
    assert methods_of["part.set"].name == "part.set"  # to read one imports it
    assert PART.module in sys.modules


async def test_calls_before_the_import_are_carried_out_in_their_order(module: Path) -> None:
    imported = asyncio.Event()

    async def import_beside(name: str) -> None:
        await imported.wait()
        importlib.import_module(name)

    calls: list[str] = []
    dispatcher = Dispatcher(table(), import_beside)
    orders = [asyncio.ensure_future(answered(dispatcher.start(calls, request("part.set", n)))) for n in (1, 2, 3)]
    shown = asyncio.ensure_future(answered(dispatcher.start(calls, request("part.get", 4))))
    await asyncio.sleep(0)
    assert calls == [] and not dispatcher.outlives_client(request("part.set"))
    imported.set()
    assert [(await order)["result"] for order in orders] == [1, 2, 3]
    assert (await shown)["result"] == ["set", "set", "set"]
    assert isinstance(dispatcher.start(calls, request("part.set")), bytes)  # at once from now on


async def test_a_module_that_is_broken_is_an_error_of_the_call_alone(module: Path) -> None:
    await asyncio.to_thread(module.write_text, "raise ImportError('half installed')")

    async def import_beside(name: str) -> None:
        importlib.import_module(name)

    dispatcher = Dispatcher(table(), import_beside)
    answer = await answered(dispatcher.start([], request("part.set")))
    assert answer["id"] == 1 and answer["error"]["code"] == -32603
    assert (await answered(dispatcher.start([], request("here"))))["result"] == 0


def test_every_part_of_the_daemon_is_as_its_table_says() -> None:
    """Names in their order, flags, and no method that must outlive the client that has it imported."""
    assert len(METHODS.later) > 5
    for part in METHODS.later:
        found = getattr(importlib.import_module(part.module), part.part)
        assert tuple(method.name for method in found) == part.names
        assert {method.name for method in found if method.always} == set(part.always)
        assert {method.name for method in found if method.while_stopping} == set(part.while_stopping)
        assert not any(method.outlives_client for method in found)
