"""Plugin of pytest: CPU and wall time of each test file, its imports included, and the reasons of those that cost much.

CPU time is what counts: it hardly depends on what else the machine does. It is that of the process and of the processes
it started and waited for. Each worker of xdist measures its own tests and hands its sums over at its end.
"""

from __future__ import annotations

import re
import resource
import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

LIMIT_CPU_S = 5.0
"""A file that costs more has its reason in one line, ``COSTS = "…"`` at its top, or its long tests are marked
``deep``."""

STALE_CPU_S = 1.5
"""A file that costs less needs no reason: it has become cheap, and its reason goes."""

KEPT_AS = "skygcs/test-costs"
"""Key of the last costs measured for each file in pytest's cache; ``make quick`` chooses by them."""


@dataclass(slots=True)
class Cost:
    """Sums over one test file."""

    cpu_s: float = 0.0
    wall_s: float = 0.0
    tests: int = 0

    def add(self, cpu_s: float, wall_s: float, tests: int) -> None:
        self.cpu_s += cpu_s
        self.wall_s += wall_s
        self.tests += tests


class FileCosts:
    """Measure a run; print the table of the files if it was asked for, and end in an error if a file lacks a reason."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._shown = bool(config.getoption("--costs"))
        self._files: dict[str, Cost] = {}
        self._workers = 0

    def _now(self) -> tuple[float, float]:
        own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
        return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime, time.perf_counter()

    def _count(self, path: Path, begun: tuple[float, float], tests: int) -> None:
        cpu_s, wall_s = self._now()
        name = path.relative_to(self._config.rootpath).as_posix()
        self._files.setdefault(name, Cost()).add(cpu_s - begun[0], wall_s - begun[1], tests)

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: pytest.Collector) -> Generator[None, Any, Any]:
        begun = self._now()
        report = yield
        if isinstance(collector, pytest.Module):
            self._count(collector.path, begun, 0)
        return report

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        begun = self._now()
        done = yield
        self._count(item.path, begun, 1)
        return done

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(self._config, "workeroutput"):
            sums = {name: (cost.cpu_s, cost.wall_s, cost.tests) for name, cost in self._files.items()}
            self._config.workeroutput["test_costs"] = sums
            return
        self._keep()
        if self._shown and self._faults() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self._workers += 1
        for name, sums in getattr(node, "workeroutput", {}).get("test_costs", {}).items():
            self._files.setdefault(name, Cost()).add(*sums)

    def _keep(self) -> None:
        cache: pytest.Cache | None = getattr(self._config, "cache", None)
        if cache is None or self._config.option.collectonly:
            return
        kept = cache.get(KEPT_AS, {})
        kept |= {name: round(cost.cpu_s, 2) for name, cost in self._files.items() if cost.tests}
        cache.set(KEPT_AS, kept)

    def _faults(self) -> list[str]:
        return faults({name: cost.cpu_s for name, cost in self._files.items()}, self._config.rootpath)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if not self._shown or hasattr(self._config, "workerinput"):
            return
        terminalreporter.section("costs of test files")
        for line in table(self._files, self._config.rootpath):
            terminalreporter.write_line(line)
        if self._workers > 1:
            terminalreporter.write_line(f"Imports count once for each of {self._workers} workers.")
        for fault in self._faults():
            terminalreporter.write_line(fault)


def table(files: Mapping[str, Cost], root: Path) -> list[str]:
    """Lines of the table, the dearest file first, with the reason of each that has one; then the folders, and all."""
    lines = [f"{'CPU s':>8} {'wall s':>8} {'tests':>6}  file"]
    for name, cost in sorted(files.items(), key=lambda item: (-item[1].cpu_s, item[0])):
        reason = stated_reason(root / name)
        row = f"{cost.cpu_s:8.2f} {cost.wall_s:8.2f} {cost.tests:6}  {name}"
        lines.append(f"{row}: {reason}" if reason else row)
    folders, whole = dict[str, Cost](), Cost()
    for name, cost in files.items():
        folder = "/".join(Path(name).parts[:3][: len(Path(name).parts) - 1])
        for total in (folders.setdefault(folder, Cost()), whole):
            total.add(cost.cpu_s, cost.wall_s, cost.tests)
    for name, cost in sorted(folders.items(), key=lambda item: (-item[1].cpu_s, item[0])):
        lines.append(f"{cost.cpu_s:8.2f} {cost.wall_s:8.2f} {cost.tests:6}  {name}/")
    return [*lines, f"{whole.cpu_s:8.2f} {whole.wall_s:8.2f} {whole.tests:6}  all {len(files)} files"]


def faults(cpu_s: Mapping[str, float], root: Path) -> list[str]:
    """One line for each file that is dear without a reason, or has a reason that it no longer needs."""
    found = []
    for name, cost_s in sorted(cpu_s.items()):
        reason = stated_reason(root / name)
        if cost_s > LIMIT_CPU_S and reason is None:
            found.append(f"{name} costs {cost_s:.1f} s of CPU: mark long tests deep, or say why in COSTS at its top")
        elif cost_s < STALE_CPU_S and reason is not None:
            found.append(f"{name} costs {cost_s:.1f} s of CPU: it needs no COSTS any more")
    return found


def stated_reason(path: Path) -> str | None:
    """Reason in a file's ``COSTS = "…"``, on one line at its top level; None if it has none."""
    match = re.search(r'^COSTS = "(.*)"$', path.read_text(), re.M)
    return match[1] if match else None
