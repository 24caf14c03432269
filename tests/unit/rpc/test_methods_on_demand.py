"""Methods of extensions without a table: looked for, imported and added when one of them is first called."""

from __future__ import annotations

import asyncio
import json
import sys
import types
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from skygcs.errors import RefusedError
from skygcs.rpc import methods_on_demand
from skygcs.rpc.dispatch import DeclaredMethods, Dispatcher, Later, Method, MethodTable, Reply
from skygcs.rpc.methods_on_demand import MethodsOnDemand
from skygcs.rpc.models import NoParams
from skygcs.rpc.replies import error_reply
from support.table import each


def add_one(calls: list[str], _: NoParams) -> int:
    calls.append("add")
    return len(calls)


HERE: Method[list[str]] = Method("daemon.here", NoParams, lambda calls, _: len(calls))
ADDED: tuple[Method[list[str]], ...] = (
    Method("kite.add", NoParams, add_one, always=True),
    Method("kite.land", NoParams, lambda calls, _: list(calls), outlives_client=True),
)


class Installed:
    """One installed extension without a table, ``kite``, and what was done to find it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[str] = []
        self.beside_calls = self.looked = 0
        self.broken = False
        self.beside = asyncio.Event()
        self.beside.set()
        monkeypatch.setattr(methods_on_demand, "on_demand", self._look)
        monkeypatch.setattr(methods_on_demand, "find_on_demand", self._find)
        monkeypatch.setattr(methods_on_demand, "installed", lambda: {"glider": "an entry point with a table"})
        self.table: MethodTable[list[str]] = MethodTable((HERE,))
        loop = asyncio.get_running_loop()
        self.dispatcher = Dispatcher(self.table, MethodsOnDemand(self.table, self, self._call, loop))

    def _look(self) -> dict[str, str]:
        self.looked += 1
        return {"kite": "an entry point"}

    def _find(self, word: str) -> None:
        self.done.append(f"import {word}")
        if self.broken:
            raise ImportError("half installed")

    def require_well(self, word: str) -> None: ...

    def failed(self, word: str, error: Exception) -> Exception:
        return RefusedError(f"{word}: {error}")

    def demand(self, word: str, accept: Callable[[Any], None]) -> tuple[Method[Any], ...]:
        accept(ADDED)
        self.done.append(f"make {word}")
        return ADDED

    async def _call(self, function: Callable[[], object]) -> None:
        self.beside_calls += 1
        await self.beside.wait()
        function()

    def start(self, calls: list[str], method: str, number: int = 1) -> Reply:
        return self.dispatcher.start(calls, {"jsonrpc": "2.0", "id": number, "method": method})


async def answered(reply: Reply) -> Any:
    raw = await reply if isinstance(reply, Coroutine) else reply
    assert raw
    return json.loads(raw)


async def test_calls_before_the_import_are_carried_out_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Installed(monkeypatch)
    found.beside.clear()
    calls: list[str] = []
    orders = [asyncio.ensure_future(answered(found.start(calls, "kite.add", n))) for n in (1, 2, 3)]
    shown = asyncio.ensure_future(answered(found.start(calls, "kite.land", 4)))
    await asyncio.sleep(0)
    assert calls == [] and found.done == []
    assert not found.dispatcher.outlives_client({"method": "kite.land"})
    found.beside.set()
    assert [(await order)["result"] for order in orders] == [1, 2, 3]
    assert (await shown)["result"] == ["add", "add", "add"]
    assert found.done == ["import kite", "make kite"]
    assert isinstance(found.start(calls, "kite.add"), bytes)  # at once from now on
    assert found.dispatcher.always == {"kite.add"}  # also where all places are taken
    assert found.dispatcher.outlives_client({"method": "kite.land"})


async def test_what_no_extension_has_is_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Installed(monkeypatch)
    first = found.start([], "dragon.add")
    assert isinstance(first, Coroutine)
    assert (await answered(first))["error"]["code"] == -32601
    later = found.start([], "dragon.land")
    assert isinstance(later, bytes) and json.loads(later)["error"]["code"] == -32601
    assert found.done == []
    before = found.beside_calls
    looked = found.looked
    for name in ("dragon.add", "wyvern.add", "dragon"):
        assert isinstance(found.start([], name), bytes)
    assert (found.looked, found.beside_calls) == (looked, before)
    assert isinstance(found.start([], "daemon.here"), bytes)


async def test_a_failure_to_look_is_remembered_and_answered_in_the_cores_words(monkeypatch: pytest.MonkeyPatch) -> None:
    found, looked = Installed(monkeypatch), list[bool]()

    def fails() -> Any:
        looked.append(True)
        raise TypeError("metadata of a package")

    monkeypatch.setattr(methods_on_demand, "on_demand", fails)
    replies = [await answered(found.start([], f"dragon.{name}")) for name in ("add", "land", "add")]
    assert [reply["error"]["code"] for reply in replies] == [-32601] * 3
    assert len(looked) == 1


@each("notification", [False, True])
async def test_a_call_that_waited_for_the_import_is_admitted_again_before_it_is_carried_out(
    monkeypatch: pytest.MonkeyPatch, notification: bool
) -> None:
    found, calls, late = Installed(monkeypatch), list[str](), list[str]()
    found.beside.clear()
    request: dict[str, Any] = {"jsonrpc": "2.0", "method": "kite.add"} | ({} if notification else {"id": 1})
    refused = lambda request: error_reply(request.get("id"), -32000, "late") if late else None  # noqa: E731
    reply = found.dispatcher.start(calls, request, admit=refused)
    assert isinstance(reply, Coroutine)
    waiting = asyncio.ensure_future(reply)
    await asyncio.sleep(0)
    late.append("its deadline has passed")
    found.beside.set()
    answer = await waiting
    assert calls == [] and (answer == b"" if notification else json.loads(answer)["error"]["message"] == "late")


async def test_a_method_that_the_extension_does_not_have_is_refused_at_once_after_its_import(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = Installed(monkeypatch)
    assert (await answered(found.start([], "kite.dive")))["error"]["code"] == -32601
    assert isinstance(found.start([], "kite.dive"), bytes)
    assert found.done == ["import kite", "make kite"]


@each(
    ("name", "said"),
    [
        ("glider.status", "it needs the table [glider] in the fleet file"),
        ("falcon.status", "rpc.discover lists the methods"),
        ("demon.here", "did you mean daemon.here?"),
    ],
)
async def test_a_refusal_names_only_a_table_that_an_installed_extension_has(
    monkeypatch: pytest.MonkeyPatch, name: str, said: str
) -> None:
    found = Installed(monkeypatch)
    for _ in range(2):  # the first one looks for the extensions
        assert (await answered(found.start([], name)))["error"]["message"] == f"no method {name}; {said}"


async def test_a_broken_extension_is_an_error_of_the_call_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Installed(monkeypatch)
    found.broken = True
    assert (await answered(found.start([], "kite.add")))["error"]["message"] == "kite: half installed"
    assert (await answered(found.start([], "daemon.here")))["result"] == 0
    found.broken = False  # it was repaired
    assert (await answered(found.start([], "kite.add")))["result"] == 1


async def test_every_method_is_made_beside_the_loop_and_one_that_cannot_be_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = Installed(monkeypatch)
    found.broken = True
    assert [method.name for method in await found.dispatcher.every_method()] == ["daemon.here"]
    found.broken = False
    found.beside.clear()
    asked = asyncio.ensure_future(found.dispatcher.every_method())
    await asyncio.sleep(0)
    assert not asked.done() and found.done == ["import kite"]  # the loop goes on; this is of the first attempt
    found.beside.set()
    assert [method.name for method in await asked] == ["daemon.here", "kite.add", "kite.land"]
    assert found.done == ["import kite", "import kite", "make kite"]


async def test_an_extension_with_a_first_word_of_the_core_is_refused_at_its_first_call_and_at_its_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = Installed(monkeypatch)
    module = types.ModuleType("later_kites")
    module.METHODS = (Method("kite.core", NoParams, lambda calls, _: "core"),)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "later_kites", module)
    table: MethodTable[list[str]] = MethodTable((HERE,), {"kite": Later("kite", "later_kites")})

    def demand(word: str, accept: Callable[[Any], None]) -> tuple[Method[Any], ...]:
        try:
            accept(ADDED)
        except ValueError as error:
            raise RefusedError(str(error)) from error
        return ADDED

    monkeypatch.setattr(found, "demand", demand)
    loop = asyncio.get_running_loop()
    dispatcher = Dispatcher(table, MethodsOnDemand(table, found, found._call, loop))
    for number in (1, 2, 3):
        request = {"jsonrpc": "2.0", "id": number, "method": "kite.add"}
        error = (await answered(dispatcher.start([], request)))["error"]
        assert error["message"] == "kite.add, kite.land: methods that begin with kite are the core's own"
    core = {"jsonrpc": "2.0", "id": 4, "method": "kite.core"}
    assert (await answered(dispatcher.start([], core)))["result"] == "core"


async def test_a_table_of_one_server_leaves_the_common_one_as_it_is() -> None:
    common = DeclaredMethods((HERE,))
    own = common.table()
    own.add(ADDED)
    assert (list(common), list(own)) == (["daemon.here"], ["daemon.here", "kite.add", "kite.land"])
    with pytest.raises(ValueError, match="two methods are called kite"):
        own.add(ADDED)
