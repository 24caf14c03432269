"""One check of a dropped file in a process of its own, so that no file costs the web process time or memory.

python -m skygcs.web.check_process NAME     parameters as JSON on standard input, the answer on standard output
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import resource
import signal
import sys
from typing import Any

from skygcs.cancellation import carried_through
from skygcs.child_process import start_process
from skygcs.errors import RefusedError, SkygcsError
from skygcs.web.sign_in import Role

CHECK_CPU_S = 30
"""The certificate of a plan for 50 vehicles takes a few seconds on a slow computer."""

CHECK_TIMEOUT_S = 120.0
"""By the clock: a check yields to everything else (`NICE`), and beside busy programs gets a quarter of a processor. A
start of 2 s of CPU time took over 30 s beside four lanes of tests. The page waits longer."""

CHECK_MEMORY_BYTES = 1 << 30
MAX_ANSWER_BYTES = 8 << 20
AT_ONCE, OF_VIEWERS = 2, 1
"""Checks at the same time, and those of browsers that may only look; further ones are refused."""

NICE = 10
"""A check that takes both processors leaves them to the daemon whenever it wants one."""


class CheckRunner:
    """Runs the checks of `file_checks` in processes."""

    def __init__(self) -> None:
        self._running: list[Role] = []

    async def run(self, name: str, params: dict[str, Any], role: Role) -> Any:
        """The answer of a check. Raises SkygcsError with a text for a person."""
        if len(self._running) >= AT_ONCE or (role == "view" and self._running.count(role) >= OF_VIEWERS):
            raise RefusedError("other files are being checked; wait a moment")
        self._running.append(role)
        try:
            return await _run(name, params)
        finally:
            self._running.remove(role)


async def _run(name: str, params: dict[str, Any]) -> Any:
    process = await start_process(
        sys.executable,
        "-m",
        "skygcs.web.check_process",
        name,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        async with asyncio.timeout(CHECK_TIMEOUT_S):
            output, _ = await process.communicate(json.dumps(params).encode())
    except TimeoutError:
        raise SkygcsError(
            f"the check took longer than {CHECK_TIMEOUT_S:g} s and was ended: this computer is too busy; try again"
        ) from None
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await carried_through(process.wait())
    if process.returncode == -signal.SIGXCPU:
        raise SkygcsError(f"the file could not be checked within {CHECK_CPU_S} s of CPU time: it is too large")
    if process.returncode != 0:
        raise SkygcsError("the file could not be checked: it is too large, or not what its name says")
    answer = json.loads(output)
    if "problem" in answer:
        raise SkygcsError(answer["problem"])
    return answer["result"]


def main() -> None:
    """The process."""
    from skygcs.web.file_checks import find_check

    os.nice(NICE)
    resource.setrlimit(resource.RLIMIT_AS, (CHECK_MEMORY_BYTES, CHECK_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (CHECK_CPU_S, CHECK_CPU_S + 1))
    params = json.load(sys.stdin)
    try:
        answer: dict[str, Any] = {"result": find_check(sys.argv[1])(params)}
    except SkygcsError as error:
        answer = {"problem": str(error)}
    text = json.dumps(answer, allow_nan=False)
    if len(text) > MAX_ANSWER_BYTES:
        sys.exit(1)  # the web process would have to read it
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
