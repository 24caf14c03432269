"""Plugin of pytest: what a run has passed stands in a file, and the deep run of the same commit leaves that out.

The deep run contains `make test`. In CI both run on one machine and one commit: only what differs is run again, and
that is what searches (Hypothesis, seeds and tables whose length `support.examples` decides) or runs on another loop.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

import pytest


class PassedBefore:
    """Write the node ids of tests that passed into a file, one a line, when the run has ended without a failure."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._passed: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and report.passed:
            self._passed.append(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        if exitstatus == 0 and not hasattr(session.config, "workerinput"):
            self._path.write_text("".join(f"{nodeid}\n" for nodeid in self._passed))


def left_to_run(items: Iterable[pytest.Item], passed: Collection[str], on_another_loop: Path) -> list[pytest.Item]:
    """The tests of a deep run that have not passed before as they would run now: those with another node id, those
    of files that ask `support.examples` how much to run, those of Hypothesis, and those of a folder that runs on
    another event loop now."""
    searching: dict[Path, bool] = {}
    left = []
    for item in items:
        if item.path not in searching:
            text = item.path.read_text()
            searching[item.path] = "support.examples" in text or "hypothesis" in text
        if item.nodeid not in passed or searching[item.path] or item.path.is_relative_to(on_another_loop):
            left.append(item)
    return left
