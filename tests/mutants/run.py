"""Plugin of pytest: runs the collected tests once, then again for each mutant, in forks of this process.

The first run notes which test executes which line and what it costs. A mutant then needs only the tests that execute
its line, the cheap ones first, up to the first failure; a fork replaces the code of the changed function, so nothing is
imported or collected again. That makes a mutant cost as little as the test that finds it.

A mutant counts as killed only where a test failed, or did not end. A change that reaches no function, and tests that
fail in a fork with the code as it is, are errors: what measures wrongly must not look like good tests.
"""

from __future__ import annotations

import ast
import gc
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest

from mutants.changes import Mutant, changed_tree

AT_ONCE = 2
CPU_ALLOWANCE_S = 5.0
"""CPU time of a mutant beyond `CPU_MULTIPLE` times that of its tests: it loops, and counts as found."""

CPU_MULTIPLE = 10.0
WALL_LIMIT_S = 240.0
"""A mutant that waits for ever without CPU. One that wants CPU on a busy machine is given as long again."""

FOUND, MISSED, UNREACHED, LOOPS = "killed", "survived", "not reached", "killed: does not end"
Code = list[tuple[FunctionType, CodeType]]
"""Functions, each with the code that it is to have."""


@dataclass(frozen=True, slots=True)
class Task:
    """One mutant of one file; None: the file as it is, with which all its tests must pass."""

    path: Path
    mutant: Mutant | None

    def __str__(self) -> str:
        return f"{self.path.name}: {'as it is' if self.mutant is None else self.mutant.key}"


class MutantRun:
    """Measures the collected tests with mutants: `results` says what became of each, `errors` what was not measured."""

    def __init__(self, tasks: list[Task]) -> None:
        self._tasks = tasks
        self._files = {str(task.path): task.path.read_text() for task in tasks}
        self._lines: dict[int, set[tuple[str, int]]] = {}
        self._cpu_s: dict[int, float] = {}
        self._functions: dict[str, list[FunctionType]] = {}
        self.results: dict[int, str] = {}
        self.errors: list[str] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            return True
        self._observe(session)
        if not session.testsfailed:
            self._find_functions()
            self._run(session)
        return True

    def _observe(self, session: pytest.Session) -> None:
        for number, item in enumerate(session.items):
            lines = self._lines[number] = set()
            begun = time.process_time()
            with _traced(self._files.keys(), lines):
                following = session.items[number + 1] if number + 1 < len(session.items) else None
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            self._cpu_s[number] = time.process_time() - begun

    def _find_functions(self) -> None:
        gc.unfreeze()  # get_objects leaves out what is frozen, and conftest freezes all modules
        for thing in gc.get_objects():
            if type(thing) is FunctionType and thing.__code__.co_filename in self._files:
                self._functions.setdefault(thing.__code__.co_filename, []).append(thing)
        gc.freeze()

    def _run(self, session: pytest.Session) -> None:
        running: dict[int, tuple[int, float]] = {}  # process -> number of its task, end of its wall time
        waiting = list(range(len(self._tasks)))
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCHLD])
        try:
            self._measure(session, waiting, running)
        finally:
            for pid in running:
                os.kill(pid, signal.SIGKILL)

    def _measure(self, session: pytest.Session, waiting: list[int], running: dict[int, tuple[int, float]]) -> None:
        while waiting or running:
            while waiting and len(running) < AT_ONCE:
                number = waiting.pop(0)
                task = self._tasks[number]
                if not (tests := self._tests_of(task)):
                    self.results[number] = UNREACHED
                elif changes := self._changes(task):
                    running[self._fork(session, changes, tests)] = (number, time.monotonic() + WALL_LIMIT_S)
                else:
                    self.errors.append(f"{task}: no function gets other code")
            self._collect(running)

    def _collect(self, running: dict[int, tuple[int, float]]) -> None:
        if not running:
            return
        signal.sigtimedwait([signal.SIGCHLD], 1.0)
        for pid, (number, end) in list(running.items()):
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                del running[pid]
                self.results[number] = _verdict(status)
                if self._tasks[number].mutant is None and self.results[number] != MISSED:
                    self.errors.append(f"{self._tasks[number]}: tests fail when they run again")
            elif time.monotonic() > end and _wants_cpu(pid):
                running[pid] = (number, time.monotonic() + WALL_LIMIT_S)
            elif time.monotonic() > end:
                os.kill(pid, signal.SIGKILL)

    def _tests_of(self, task: Task) -> list[int]:
        name, mutant = str(task.path), task.mutant
        if mutant is None:
            reaching = (n for n, lines in self._lines.items() if any(path == name for path, _ in lines))
        else:
            reaching = (n for n, lines in self._lines.items() if (name, mutant.line) in lines)
        return sorted(reaching, key=self._cpu_s.__getitem__)

    def _fork(self, session: pytest.Session, changes: Code, tests: list[int]) -> int:
        sys.stdout.flush()
        pid = os.fork()
        if pid:
            return pid
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])
            null = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(null, stream)
            limit_s = int(CPU_ALLOWANCE_S + CPU_MULTIPLE * sum(self._cpu_s[test] for test in tests))
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
            for function, code in changes:
                function.__code__ = code
            for position, test in enumerate(tests):
                following = session.items[tests[position + 1]] if position + 1 < len(tests) else None
                item = session.items[test]
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if session.testsfailed:
                    os._exit(1)
            os._exit(0)
        except BaseException:
            os._exit(1)

    def _changes(self, task: Task) -> Code:
        """What this mutant gives other code; in a file as it is, every function."""
        name, source = str(task.path), self._files[str(task.path)]
        tree = ast.parse(source) if task.mutant is None else changed_tree(source, task.mutant)
        codes = {(code.co_qualname, code.co_firstlineno): code for code in _codes(compile(tree, name, "exec"))}
        changes = []
        for function in self._functions.get(name, []):
            old = function.__code__
            new = codes.get((old.co_qualname, old.co_firstlineno))
            # a live closure keeps its variables: where the mutant has fewer, only closures made from now on change
            if new is None or len(new.co_freevars) != len(old.co_freevars):
                continue
            if task.mutant is None or new != old:
                changes.append((function, new))
        return changes


def _verdict(status: int) -> str:
    if os.WIFSIGNALED(status):
        return LOOPS
    return FOUND if os.WEXITSTATUS(status) else MISSED


def _wants_cpu(pid: int) -> bool:
    """True if this process runs, or would if it were its turn; its limit of CPU time ends it."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "R"


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


class _traced:
    """Notes the lines of some files that run inside, in all threads that begin inside."""

    def __init__(self, files: Any, lines: set[tuple[str, int]]) -> None:
        self._files = files
        self._lines = lines

    def __enter__(self) -> None:
        threading.settrace(self._enter_frame)
        sys.settrace(self._enter_frame)

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]

    def _enter_frame(self, frame: FrameType, event: str, argument: object) -> Any:
        return self._line if frame.f_code.co_filename in self._files else None

    def _line(self, frame: FrameType, event: str, argument: object) -> Any:
        if event == "line":
            self._lines.add((frame.f_code.co_filename, frame.f_lineno))
        return self._line
