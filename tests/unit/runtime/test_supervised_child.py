"""The processes beside a daemon: they are started again, and end with it."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
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
    assert [event.data for event in events] == [{"change": "thing_ended", "reason": "exit code 3"}]
    assert "the process of the thing has ended (exit code 3); it is started again" in events[0].text


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
    await until(lambda: found, "it is started all the same")
    pid = found[0].pid
    _, status = await asyncio.wait_for(loop.run_in_executor(None, os.waitpid, pid, 0), 10)
    assert os.WTERMSIG(status) == signal.SIGTERM
    assert child.status()["pid"] is None
    assert found[0].stdin is not None and found[0].stdin.closed
