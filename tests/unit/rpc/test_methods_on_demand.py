"""Methods of extensions without a table: looked for, imported and added when one of them is first called."""

from __future__ import annotations

import asyncio
import functools
import gc
import json
import sys
import warnings
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from skygcs.config.extension_tables import demanded_word
from skygcs.errors import RefusedError
from skygcs.rpc import methods_on_demand
from skygcs.rpc.dispatch import Dispatcher, Method, MethodTable, Reply, first_word
from skygcs.rpc.methods import METHODS
from skygcs.rpc.methods_on_demand import MethodsOnDemand
from skygcs.rpc.models import NoParams
from skygcs.rpc.replies import error_reply
from skygcs.runtime.task_set import ask
from support.extension_parts import ON_DEMAND, PLAIN_METHODS
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


async def test_the_order_of_a_call_that_waits_was_asked_for_when_the_call_came(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first missions.start, which waited for its import, took the place of a hold that was ordered meanwhile."""
    found, serials = Installed(monkeypatch), list[int]()
    fly: Method[list[int]] = Method("kite.fly", NoParams, lambda serials, _: serials.extend((ask(), ask())))
    monkeypatch.setattr(found, "demand", lambda word, accept: (fly,))
    found.beside.clear()
    before = ask()
    waits = asyncio.ensure_future(answered(found.start(serials, "kite.fly")))  # type: ignore[arg-type]
    hold = ask()
    found.beside.set()
    await waits
    assert before < serials[0] < hold < serials[1]  # only its first order
    assert hold < ask()


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


async def test_a_first_call_that_is_closed_before_it_began_leaves_nothing_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Python would print "never awaited" to stderr, on the thread of the loop."""
    found = Installed(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reply = found.start([], "kite.add")
        assert isinstance(reply, Coroutine)
        with pytest.MonkeyPatch.context() as patch:
            unraisable = list[object]()
            patch.setattr(sys, "unraisablehook", unraisable.append)
            reply.close()
            del reply
            gc.collect()
    assert unraisable == []
    assert (await answered(found.start([], "kite.add")))["result"] == 1


@each("cancelled", [False, True])
async def test_a_later_request_does_not_overtake_one_that_waits(
    monkeypatch: pytest.MonkeyPatch, cancelled: bool
) -> None:
    """The methods are in the table before the calls that waited for them go on."""
    found, done = Installed(monkeypatch), list[int]()
    found.beside.clear()
    waiting: list[asyncio.Task[Any]] = []

    def ask(number: int) -> None:
        async def order() -> None:
            await answered(reply)
            done.append(number)

        reply = found.start([], "kite.add", number)
        if isinstance(reply, Coroutine):
            waiting.append(asyncio.create_task(order()))
        else:
            done.append(number)

    for number in range(3):
        ask(number)
        await asyncio.sleep(0)
    if cancelled:
        waiting[1].cancel()
    found.beside.set()
    for number in range(3, 12):  # one in each turn of the loop, before, while and after the first goes on
        ask(number)
        await asyncio.sleep(0)
    await asyncio.gather(*waiting, return_exceptions=True)
    assert done == [number for number in range(12) if not (cancelled and number == 1)]
    assert isinstance(found.start([], "kite.add"), bytes)


async def test_all_are_described_once_for_all_that_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the loop, as that takes long."""
    found = Installed(monkeypatch)
    await found.dispatcher.every_method()
    found.beside.clear()
    made: list[int] = []
    describe = functools.cache(lambda methods: made.append(len(methods)) or len(made))
    both = [asyncio.ensure_future(found.dispatcher.described(describe)) for _ in range(2)]
    for _ in range(5):
        await asyncio.sleep(0)
    assert made == []
    found.beside.set()
    assert (await asyncio.gather(*both), made) == ([1, 1], [3])


def test_ours_begin_with_their_words_and_none_is_for_an_emergency() -> None:
    """One that comes with its first call is not carried on without its client, nor while the daemon shuts down."""
    for name in PLAIN_METHODS.keys() - METHODS.keys():
        method = PLAIN_METHODS[name]
        assert demanded_word(name, ON_DEMAND) in ON_DEMAND, name
        never_first = first_word(name) == "plan"  # what ends its flight comes after what began it
        assert never_first or not (method.always or method.while_stopping or method.outlives_client), name
