"""Checks of dropped files in processes: how many, at whose cost, and what becomes of those that end badly."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from typing import Any

import pytest

from skygcs.child_process import start_process
from skygcs.errors import RefusedError, SkygcsError
from skygcs.web import check_process
from skygcs.web.check_process import NICE, CheckRunner
from support.hanging import HANG_S
from support.table import each


async def test_onlookers_leave_a_place_to_those_who_may_order(monkeypatch: pytest.MonkeyPatch) -> None:
    held = asyncio.Event()

    async def hold(name: str, params: dict[str, Any]) -> str:
        await held.wait()
        return name

    monkeypatch.setattr(check_process, "_run", hold)
    checks = CheckRunner()
    first = asyncio.create_task(checks.run("a", {}, "view"))
    await asyncio.sleep(0)
    with pytest.raises(RefusedError, match="other files"):
        await checks.run("b", {}, "view")
    second = asyncio.create_task(checks.run("c", {}, "command"))
    await asyncio.sleep(0)
    with pytest.raises(RefusedError, match="other files"):
        await checks.run("d", {}, "command")
    held.set()
    assert [await first, await second, await checks.run("e", {}, "view")] == ["a", "c", "e"]


@each("name", ["web.no.such.check", "web.plan.check"])
async def test_a_check_that_fails_is_a_text_for_a_person(name: str) -> None:
    with pytest.raises(SkygcsError) as refused:
        await CheckRunner().run(name, {"files": []}, "command")
    assert "Traceback" not in str(refused.value)


@each("program", ["import time; time.sleep(3600)", "import os, signal; os.kill(os.getpid(), signal.SIGXCPU)"])
async def test_a_busy_computer_is_not_taken_for_a_large_file(program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def start(*line: str, **options: Any) -> asyncio.subprocess.Process:
        return await start_process(sys.executable, "-c", program, **options)

    monkeypatch.setattr(check_process, "start_process", start)
    monkeypatch.setattr(check_process, "CHECK_TIMEOUT_S", 0.0 if "sleep" in program else HANG_S)
    with pytest.raises(SkygcsError, match="this computer is too busy" if "sleep" in program else "too large"):
        await CheckRunner().run("web.mission.check", {}, "command")


def test_a_check_is_ended_by_its_cpu_time() -> None:
    program = (
        "from skygcs.web import check_process, file_checks\n"
        "def burn(_):\n"
        "    while True: pass\n"
        "check_process.CHECK_CPU_S = 1\n"
        "file_checks.CHECKS['burn'] = burn\n"
        "check_process.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program, "burn"], input="{}", capture_output=True, text=True)
    assert done.returncode == -signal.SIGXCPU


def test_a_check_gives_way_to_the_daemon_and_its_answer_is_bounded() -> None:
    program = (
        "import os, sys\n"
        "from skygcs.web import check_process, file_checks\n"
        "file_checks.CHECKS['long'] = lambda _: {'nice': os.nice(0), 'x': 'x' * int(sys.argv[2])}\n"
        "check_process.main()\n"
    )

    def run(size: int) -> subprocess.CompletedProcess[str]:
        line = [sys.executable, "-c", program, "long", str(size)]
        return subprocess.run(line, input="{}", capture_output=True, text=True, timeout=60)

    short = run(1)
    assert short.returncode == 0 and f'"nice": {min(os.nice(0) + NICE, 19)}' in short.stdout
    long = run(check_process.MAX_ANSWER_BYTES)
    assert long.returncode == 1 and long.stdout == ""
