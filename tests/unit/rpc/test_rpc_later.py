"""Methods of the core whose module is imported when one of them is first called."""

from __future__ import annotations

import asyncio
import functools
import gc
import json
import sys
import warnings
from collections.abc import Callable, Collection, Coroutine, Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.rpc import methods_on_demand
from skygcs.rpc.dispatch import DeclaredMethods, Dispatcher, Later, Method, Reply, first_word
from skygcs.rpc.methods import METHODS
from skygcs.rpc.methods_on_demand import MethodsOnDemand
from skygcs.rpc.models import NoParams
from support.table import each

PART = Later("part", "later_part")
MODULE = """
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams

def set_it(calls, _):
    calls.append("set")
    return len(calls)

async def get_it(calls, _):
    return list(calls)

METHODS = (Method("part.set", NoParams, set_it), Method("part.get", NoParams, get_it))
"""
HERE: Method[list[str]] = Method("here", NoParams, lambda calls, _: len(calls))


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The module that `PART` names, not imported yet."""
    monkeypatch.syspath_prepend(str(tmp_path))
    file = tmp_path / "later_part.py"
    file.write_text(MODULE)
    yield file
    sys.modules.pop(PART.module, None)


class NoExtensions:
    """The extensions of a daemon of which none is installed."""

    def require_well(self, word: str) -> None: ...

    def failed(self, word: str, error: Exception) -> Exception:
        return error

    def demand(self, word: str, accept: Callable[[Collection[Method[Any]]], None]) -> Collection[Method[Any]]:
        return ()


class Server:
    """A dispatcher with `HERE` and `PART`; imports wait for ``go_on``."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(methods_on_demand, "on_demand", dict)
        self.go_on = asyncio.Event()
        self.go_on.set()
        self.table = DeclaredMethods((HERE,), PART).table()
        loop = asyncio.get_running_loop()
        self.dispatcher = Dispatcher(self.table, MethodsOnDemand(self.table, NoExtensions(), self._beside, loop))

    async def _beside(self, function: Callable[[], object]) -> None:
        await self.go_on.wait()
        function()

    def start(self, calls: list[str], method: str, number: int = 1) -> Reply:
        return self.dispatcher.start(calls, {"jsonrpc": "2.0", "id": number, "method": method})


async def answered(reply: Reply) -> Any:
    raw = await reply if isinstance(reply, Coroutine) else reply
    assert raw
    return json.loads(raw)


def test_a_table_is_made_without_an_import_and_reading_the_declaration_imports_all(module: Path) -> None:
    declared = DeclaredMethods((HERE,), PART)
    table = declared.table()
    assert (list(table), list(table.later)) == (["here"], ["part"])
    assert PART.module not in sys.modules
    assert list(declared) == ["here", "part.set", "part.get"] and len(declared) == 3
    assert declared["part.set"].name == "part.set" and PART.module in sys.modules
    assert list(declared.table()) == ["here"]  # each server has its own


async def test_a_first_call_that_is_closed_before_it_began_leaves_nothing_behind(
    module: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python would print "never awaited" to stderr, on the thread of the loop."""
    server = Server(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reply = server.start([], "part.set")
        assert isinstance(reply, Coroutine)
        with pytest.MonkeyPatch.context() as patch:
            unraisable = list[object]()
            patch.setattr(sys, "unraisablehook", unraisable.append)
            reply.close()
            del reply
            gc.collect()
    assert unraisable == []
    assert (await answered(server.start([], "part.set")))["result"] == 1


@each("cancelled", [False, True])
async def test_a_later_request_does_not_overtake_one_that_waits(
    module: Path, monkeypatch: pytest.MonkeyPatch, cancelled: bool
) -> None:
    """The methods are in the table before the calls that waited for them go on."""
    server, done = Server(monkeypatch), list[int]()
    server.go_on.clear()
    waiting: list[asyncio.Task[Any]] = []

    def ask(number: int) -> None:
        async def order() -> None:
            await answered(reply)
            done.append(number)

        reply = server.start([], "part.set", number)
        if isinstance(reply, Coroutine):
            waiting.append(asyncio.create_task(order()))
        else:
            done.append(number)

    for number in range(3):
        ask(number)
        await asyncio.sleep(0)
    if cancelled:
        waiting[1].cancel()
    server.go_on.set()
    for number in range(3, 12):  # one in each turn of the loop, before, while and after the first goes on
        ask(number)
        await asyncio.sleep(0)
    await asyncio.gather(*waiting, return_exceptions=True)
    assert done == [number for number in range(12) if not (cancelled and number == 1)]
    assert isinstance(server.start([], "part.set"), bytes)


async def test_a_module_that_is_broken_is_an_error_of_the_call_alone(
    module: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await asyncio.to_thread(module.write_text, "raise ImportError('half installed')")
    server = Server(monkeypatch)
    answer = await answered(server.start([], "part.set"))
    assert answer["id"] == 1 and answer["error"]["code"] == -32603
    assert (await answered(server.start([], "here")))["result"] == 0
    await asyncio.to_thread(module.write_text, MODULE)  # it was repaired
    assert (await answered(server.start([], "part.set")))["result"] == 1


async def test_every_method_is_imported_beside_the_loop(module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = Server(monkeypatch)
    server.go_on.clear()
    asked = asyncio.ensure_future(server.dispatcher.every_method())
    for _ in range(5):
        await asyncio.sleep(0)
    assert not asked.done() and PART.module not in sys.modules
    server.go_on.set()
    assert [method.name for method in await asked] == ["here", "part.set", "part.get"]
    # and so is their description made, once for all that ask
    server.go_on.clear()
    made: list[int] = []
    describe = functools.cache(lambda methods: made.append(len(methods)) or len(made))
    both = [asyncio.ensure_future(server.dispatcher.described(describe)) for _ in range(2)]
    for _ in range(5):
        await asyncio.sleep(0)
    assert made == []
    server.go_on.set()
    assert (await asyncio.gather(*both), made) == ([1, 1], [3])


async def test_no_other_may_take_a_name_that_comes_later(module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = Server(monkeypatch).table
    mine = [Method("part.mine", NoParams, lambda calls, _: None)]
    with pytest.raises(ValueError, match=r"part\.mine: methods that begin with part are the core's own"):
        table.add(mine)
    assert "part.mine" not in table and PART.module not in sys.modules
    table.add_later("part")  # and none after that: what was called before makes no difference
    with pytest.raises(ValueError, match=r"part\.mine: methods that begin with part are the core's own"):
        table.add(mine)
    assert "part.mine" not in table


def test_every_part_of_the_daemon_is_as_it_is_declared() -> None:
    """All methods with its first word, and none that must be answered before its module is imported."""
    table = METHODS.table()
    assert not {first_word(name) for name in table} & set(table.later)
    for word, part in table.later.items():
        found = part.load()
        assert {first_word(method.name) for method in found} == {word}
        assert not any(method.always or method.while_stopping or method.outlives_client for method in found)
    assert len(METHODS) == len(
        {name for part in table.later.values() for name in [m.name for m in part.load()]} | set(table)
    )
