"""The planning process itself: it answers, is bounded in time and memory, and ends with the task that waits for it."""

from __future__ import annotations

import asyncio
import json
import os
import random
import resource
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.plan.margins import MarginRule
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import RefusedError
from skygcs.ext.plans.planning.process import PlanningFailed, PlanningProcesses, ProcessLimits, call, compute
from skygcs.ext.plans.planning.request import make_request

pytestmark = pytest.mark.system


def crossing(count: int) -> bytes:
    """Vehicles on a grid that change places at random."""
    starts = {f"v{i}": (5.0 * (i % 10), 5.0 * (i // 10), 10.0) for i in range(count)}
    goals = list(starts.values())
    random.Random(1).shuffle(goals)
    request = make_request(
        starts, dict(zip(starts, goals, strict=True)), MarginRule(fixed_m=2.5), MotionLimits(), FlightSpace()
    )
    return json.dumps(request).encode()


def children() -> set[int]:
    text = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
    return {int(pid) for pid in text.split()}


async def test_it_answers_and_reports_progress_and_numpy_stays_with_it() -> None:
    told: list[dict[str, Any]] = []
    before = "numpy" in sys.modules
    answer = json.loads(await compute(crossing(20), told.append))
    assert answer["certificate"]["certified"] and len(answer["plan"]["starts"]) == 20
    assert {"what": "straight, timed", "done": 20, "total": 20} in told
    assert before or "numpy" not in sys.modules


async def test_it_is_killed_with_the_task_that_waits() -> None:
    before = children()
    task = asyncio.create_task(call(time.sleep, 3600.0))
    while not children() - before:  # noqa: ASYNC110 - it signals nothing
        await asyncio.sleep(0.01)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert children() == before, "it is dead, and was waited for"


@pytest.mark.parametrize(
    ("work", "limits", "why"),
    [
        ((time.sleep, 3600.0), ProcessLimits(time_s=0.5), "longer than 0.5 s"),
        ((bytearray, 1 << 30), ProcessLimits(memory_mb=512), "more than 512 MiB of memory"),
    ],
)
async def test_what_takes_too_much_is_refused(work: tuple[Any, Any], limits: ProcessLimits, why: str) -> None:
    before = children()
    with pytest.raises(RefusedError, match=why):
        await call(*work, limits=limits)
    assert children() == before


async def test_an_answer_that_is_too_long_is_refused() -> None:
    before = children()
    with pytest.raises(RefusedError, match="the most is 1,000"):
        await compute(crossing(20), None, ProcessLimits(answer_bytes=1000))
    assert children() == before


@pytest.mark.parametrize("request_", [b"", b"{", b"[]", b'{"do":"make"}', b"\xff" * 100, b"[" * 100_000])
async def test_a_broken_request_is_a_failure_in_one_line(request_: bytes) -> None:
    with pytest.raises(PlanningFailed, match="ended with code 1: ") as caught:
        await compute(request_)
    assert "\n" not in str(caught.value)


async def test_a_module_in_the_working_directory_is_not_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "numpy.py").write_text("raise SystemExit('taken over')\n")
    monkeypatch.chdir(tmp_path)
    assert json.loads(await compute(crossing(3)))["certificate"]["certified"]


async def test_nothing_to_do_without_a_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(PlanningFailed, match="cannot be started: No such file"):
        await compute(b"{}")


async def test_a_function_is_called_there_with_pickled_arguments() -> None:
    from skygcs.core.plan.plan_json import plan_from_json

    plan, _ = await call(plan_from_json, "it", json.loads(json.dumps(PLAN)))
    assert plan == plan_from_json("it", PLAN)[0]
    with pytest.raises(RefusedError, match="it: version: 2; only 1 is known"):
        await call(plan_from_json, "it", PLAN | {"version": 2})
    with pytest.raises(PlanningFailed, match="ZeroDivisionError"):
        await call(divmod, 1, 0)
    with pytest.raises(RefusedError, match="too many"):
        await call(bytes, 1_000_000, limits=ProcessLimits(answer_bytes=100_000))


async def test_one_waits_for_the_next_request_and_a_killed_one_is_replaced() -> None:
    before = children()
    processes = PlanningProcesses()
    assert json.loads(await processes.compute(crossing(3)))["certificate"]["certified"]
    (kept,) = children() - before
    assert await processes.call(divmod, 7, 2) == (3, 1)
    with pytest.raises(RefusedError, match="the most is 1,000"):
        await processes.compute(crossing(20), None, ProcessLimits(answer_bytes=1000))
    assert children() == before, "one that refused is not used again"
    both = await asyncio.gather(processes.call(divmod, 7, 2), processes.compute(crossing(3)))
    assert both[0] == (3, 1) and len(children() - before) == 1, "two at a time, and one is kept"
    (kept,) = children() - before
    os.kill(kept, signal.SIGKILL)
    idle = processes._idle
    assert idle is not None
    while idle.alive:  # noqa: ASYNC110 - until the loop knows of its end
        await asyncio.sleep(0.01)
    assert await processes.call(divmod, 9, 2) == (4, 1)
    await processes.close()
    assert children() == before


async def test_each_request_has_its_own_time_of_the_processor() -> None:
    processes = PlanningProcesses()
    before, _ = await processes.call(resource.getrlimit, resource.RLIMIT_CPU)
    while await processes.call(time.process_time) < 1.5:  # the limit is in whole seconds
        await processes.call(sum, range(5_000_000))
    after, _ = await processes.call(resource.getrlimit, resource.RLIMIT_CPU)
    assert after > before
    await processes.close()


PLAN: dict[str, Any] = {
    "format": "skygcs-plan",
    "version": 1,
    "kind": "phased",
    "starts": {"a": [0, 0, 5]},
    "phases": [{"name": "go", "goals": {"a": [20, 0, 5]}}],
}
