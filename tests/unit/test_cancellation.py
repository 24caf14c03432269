"""A cancellation is never lost, whatever else happens in the same turn of the loop."""

from __future__ import annotations

import ast
import asyncio
import contextlib
import re

import pytest

from skygcs.cancellation import carried_through, end_if_cancelled, ended, together
from support.process import ROOT
from support.table import each

SWALLOWS = {
    (
        "ext/plans/planning/planning_queue.py",
        "run",
    ): "a planning request that an operator cancelled is refused to its client",
    (
        "ext/federation/bridge/orders_taken.py",
        "_carry_out",
    ): "ends its task: the record says that the outcome is unknown",
    ("cli/missions.py", "sent"): "Ctrl-C: shows what the vehicles hold, and ends",
    ("cli/missions.py", "cleared"): "Ctrl-C: shows what the vehicles hold, and ends",
    ("ext/plans/commands/plan_run.py", "_follow"): "the first Ctrl-C asks what to do, the second ends it",
    ("cli/radio_port.py", "run"): "raised as KeyboardInterrupt",
    ("web/daemon_connection.py", "run"): "its owner sets `stopping` before it cancels, and that is asked after",
    ("runtime/fleet_orders.py", "_carry_on"): "ends its task: whoever gave the order gets its outcomes",
    ("runtime/renumbering.py", "run"): "the end of the daemon ends the change: whoever asked for it gets its outcome",
    ("rpc/dispatch.py", "_finish"): "ends its task: the client gets an error",
}
"""Functions in which a CancelledError ends otherwise than by being raised again, and why it may."""


async def failing(after: asyncio.Event) -> None:
    await after.wait()
    raise ValueError("lost")


async def for_ever() -> None:
    await asyncio.Event().wait()


@each("turns", range(5))
@each("cancelled_first", [False, True])
async def test_a_failure_does_not_swallow_the_cancellation_of_its_owner(turns: int, cancelled_first: bool) -> None:
    """Deterministic in every order of the two, some turns of the loop apart."""
    fail, rounds = asyncio.Event(), 0

    async def owner() -> None:
        nonlocal rounds
        while True:
            rounds += 1
            with contextlib.suppress(ValueError):
                await together(one=failing(fail), other=for_ever())
            await asyncio.sleep(3600)

    task = asyncio.create_task(owner())
    for _ in range(3):
        await asyncio.sleep(0)
    first, second = (task.cancel, fail.set) if cancelled_first else (fail.set, task.cancel)
    first()
    for _ in range(turns):
        await asyncio.sleep(0)
    second()
    done, _ = await asyncio.wait({task}, timeout=5)
    assert done and task.cancelled() and rounds == 1


async def test_without_a_cancellation_the_first_failure_is_raised_and_its_owner_goes_on() -> None:
    fail, others = asyncio.Event(), asyncio.Event()
    fail.set()

    async def other() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            others.set()

    with pytest.raises(ValueError, match="lost"):
        await together(one=failing(fail), other=other())
    assert others.is_set()
    end_if_cancelled()
    await together(one=asyncio.sleep(0), other=asyncio.sleep(0))


async def test_the_end_of_a_cancelled_task_is_waited_for_and_the_callers_own_cancellation_is_raised() -> None:
    let_go = asyncio.Event()

    async def slow() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await let_go.wait()

    task = asyncio.create_task(slow())
    await asyncio.sleep(0)
    waiting = asyncio.create_task(ended(task))
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.wait({waiting})
    assert waiting.cancelled() and not task.done()
    let_go.set()
    await ended(task)
    assert task.cancelled()
    end_if_cancelled()  # nobody has cancelled this one


def test_nothing_in_the_source_may_lose_a_cancellation() -> None:
    found = []
    for path in sorted((ROOT / "src/skygcs").rglob("*.py")):
        name = str(path.relative_to(ROOT / "src/skygcs"))
        text = path.read_text(encoding="utf-8")
        if name == "cancellation.py" or not re.search(r"Cancelled|except\*|wait_for", text):
            continue
        functions: dict[int, str] = {}
        tree = ast.parse(text)
        for function in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)):
            functions |= {id(node): function.name for node in ast.walk(function)}
        found += [
            f"{name}:{node.lineno} {why}"
            for node in ast.walk(tree)
            if (why := _loses(node)) is not None and (name, functions.get(id(node), "")) not in SWALLOWS
        ]
    assert not found, "use skygcs.cancellation instead"


def _loses(node: ast.AST) -> str | None:
    """Why this may swallow a cancellation."""
    match node:
        case ast.TryStar():
            return "except*"
        case ast.Call(func=ast.Attribute(value=ast.Name("asyncio"), attr="wait_for")):
            return "wait_for"
        case ast.Call(func=ast.Attribute(attr="suppress"), args=kinds) if "Cancelled" in "".join(map(ast.dump, kinds)):
            return "suppress(CancelledError)"
        case ast.ExceptHandler(type=kind) if kind is not None and "Cancelled" in ast.dump(kind):
            last = node.body[-1]
            return None if isinstance(last, ast.Raise) and last.exc is None else "except CancelledError without raise"
    return None


async def test_work_that_is_carried_through_ends_however_often_its_caller_is_cancelled() -> None:
    done: list[str] = []

    async def work() -> str:
        await asyncio.sleep(0.2)
        done.append("work")
        return "its result"

    async def caller() -> None:
        try:
            await asyncio.sleep(100.0)
        finally:
            await carried_through(work())

    assert await carried_through(work()) == "its result"
    task = asyncio.create_task(caller())
    for _ in range(3):
        await asyncio.sleep(0.02)
        task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert done == ["work", "work"]


async def test_a_failure_of_work_that_is_carried_through_is_raised() -> None:
    async def fails() -> None:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        await carried_through(fails())
