"""The processes beside a daemon: they are started again, and end with it."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from skygcs.events import Event
from skygcs.runtime import supervised_child
from skygcs.runtime.supervised_child import SupervisedChild
from support.hub import until


async def test_a_child_that_ends_again_and_again_is_reported_once_and_ends_with_its_parent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for pause in ("FIRST_PAUSE_S", "LOOK_S"):
        monkeypatch.setattr(supervised_child, pause, 0.01)
    events: list[Event] = []
    command = [sys.executable, "-c", "raise SystemExit(3)"]
    child = SupervisedChild("the thing", "thing", [], asyncio.get_running_loop(), events.append, command=command)
    task = asyncio.create_task(child.run())
    await until(lambda: child.restarts >= 2, "it is started again")
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    await child.ended()
    assert [event.data for event in events] == [{"change": "thing_ended", "reason": "exit code 3"}]
    assert "the process of the thing has ended (exit code 3); it is started again" in events[0].text


async def test_after_a_fault_of_ours_it_runs_again_and_after_close_it_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervised_child, "LOOK_S", 0.01)
    to_thread, faults = asyncio.to_thread, [RuntimeError("can't start new thread")]

    async def failing_once(work: Any, *args: Any) -> Any:
        if faults:
            raise faults.pop()
        return await to_thread(work, *args)

    monkeypatch.setattr(asyncio, "to_thread", failing_once)
    command = [sys.executable, "-c", "import time; time.sleep(60)"]
    child = SupervisedChild("the thing", "thing", [], asyncio.get_running_loop(), [].append, command=command)
    with pytest.raises(RuntimeError):
        await child.run()
    pids = []
    for _ in range(2):  # the second time it begins while the first process ends
        task = asyncio.create_task(child.run())
        await until(lambda: child.status()["running"], "it runs")
        pids.append(child.status()["pid"])
        assert os.getsid(pids[-1]) == pids[-1], "a terminal's signal is for the daemon, not for it"
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert len({*pids}) == 2 and child.restarts == 0
    child.close()
    task = asyncio.create_task(child.run())
    await until(lambda: child.restarts or task.done(), "it was started and ended at once")
    assert child.status()["pid"] is None
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    await child.ended()


async def test_a_process_that_is_there_after_the_end_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon ends while a thread starts the process: found as a process that nobody owned."""
    asked, go_on = threading.Event(), threading.Event()
    found: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def slow(*args: Any, **kwargs: Any) -> subprocess.Popen[bytes]:
        asked.set()
        go_on.wait()
        found.append(popen(*args, **kwargs))
        return found[0]

    monkeypatch.setattr(subprocess, "Popen", slow)
    loop = asyncio.get_running_loop()
    command = [sys.executable, "-c", "import time; time.sleep(60)"]
    child = SupervisedChild("the thing", "thing", [], loop, [].append, command=command)
    task = asyncio.create_task(child.run())
    await until(asked.is_set, "it is being started")
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    go_on.set()
    await child.ended()
    assert found[0].returncode == -signal.SIGTERM
    assert child.status()["pid"] is None
    assert found[0].stdin is not None and found[0].stdin.closed


async def test_the_parent_ends_after_the_process_and_kills_one_that_does_not_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found in CI: the web page of the demo wrote its cookies into the folder that the demo removed."""
    polite = "signal.signal(signal.SIGTERM, lambda *_: (time.sleep(0.3), last.touch(), sys.exit()))"
    deaf = "signal.signal(signal.SIGTERM, signal.SIG_IGN)"
    for name, on_term, end_s in (("polite", polite, 60.0), ("deaf", deaf, 0.1)):
        monkeypatch.setattr(supervised_child, "END_S", end_s)
        first, last = tmp_path / f"{name} first", tmp_path / f"{name} last"
        program = (
            "import pathlib, signal, sys, time\n"
            f"last = pathlib.Path({str(last)!r})\n"
            f"{on_term}\n"
            f"pathlib.Path({str(first)!r}).touch()\n"
            "while True: time.sleep(60)"
        )
        command = [sys.executable, "-c", program]
        child = SupervisedChild("the thing", "thing", [], asyncio.get_running_loop(), [].append, command=command)
        task = asyncio.create_task(child.run())
        await until(first.exists, "it runs")
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        child.close()
        await child.ended()
        assert last.exists() == (name == "polite")
        assert child.status()["pid"] is None
        await child.ended()  # again: nothing is left
