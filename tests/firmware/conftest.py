"""Flights with real autopilot firmware: one firmware a run, vehicles and daemon for all of its scenarios.

Files are flown in the order of their names. Every scenario begins with `field` (as the one before left it), `ground`
(all landed and disarmed) or `air` (all in the air at `HEIGHT_M`), and writes what it measured into `figures`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.firmware_field import FLOWN, OTHERS, Field, available
from support.firmware_report import Report, Row
from support.process import ROOT

OUTPUT = ROOT / "build" / "firmware"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--firmware", choices=FLOWN, help="which firmware is flown")
    parser.addoption("--full", action="store_true", help="also the scenarios that take minutes")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    firmware = config.getoption("--firmware")
    for item in items:
        only = item.get_closest_marker("only")
        if only is None and firmware in OTHERS:
            item.add_marker(pytest.mark.skip(reason="for copters"))
        if only is not None and firmware not in only.args:
            item.add_marker(pytest.mark.skip(reason=f"for {', '.join(only.args)}"))
        if item.get_closest_marker("minutes") and not config.getoption("--full"):
            item.add_marker(pytest.mark.skip(reason="takes minutes: make test-firmware FULL=1"))


@pytest.fixture(scope="session")
def report(request: pytest.FixtureRequest) -> Report:
    form = "full" if request.config.getoption("--full") else "short"
    found = Report(OUTPUT, request.config.getoption("--firmware"), form)
    request.config.stash[REPORT] = found
    return found


REPORT: pytest.StashKey[Report] = pytest.StashKey()
ROW: pytest.StashKey[Row] = pytest.StashKey()
FIELD: pytest.StashKey[Field] = pytest.StashKey()


@pytest.fixture(scope="session")
def flown_field(request: pytest.FixtureRequest, report: Report) -> Iterator[Field]:
    firmware = request.config.getoption("--firmware")
    if firmware not in available():
        pytest.skip(f"no binary of {firmware} is named; `make test-firmware` says what to set")
    folder = OUTPUT / "runs" / report.run
    folder.mkdir(parents=True)
    field = Field(firmware, folder)
    began = time.monotonic()
    try:
        field.start()
        row = Row("start", "passed", time.monotonic() - began)
        field.wait(lambda: field.state(field.one)["firmware"], 20, "the firmware's version is known")
        state = field.state(field.one)
        report.version = str(state["firmware"] or "unknown").replace(" ", "_").replace("/", "-")
        report.add(row)
        yield field
    finally:
        field.stop()


@pytest.fixture
def field(flown_field: Field) -> Field:
    return flown_field


@pytest.fixture
def ground(field: Field) -> Field:
    """All landed and disarmed, in a mode that arms."""
    field.ready_on_ground()
    return field


@pytest.fixture
def console(ground: Field) -> Iterator[Field]:
    """Vehicles on the ground, and a daemon with [shell]."""
    ground.restart_daemon(ground.toml() + "\n[shell]\n")
    yield ground
    ground.restart_daemon(ground.toml())


@pytest.fixture
def air(field: Field) -> Iterator[Field]:
    """All at `HEIGHT_M` above their places, holding."""
    field.relay.clear()
    field.takeoff()
    yield field
    field.relay.clear()


@pytest.fixture
def figures(request: pytest.FixtureRequest, field: Field, report: Report) -> Iterator[dict[str, Any]]:
    """What the scenario measured, for the report."""
    row = Row(request.node.nodeid.rpartition("/")[2])
    began = time.monotonic()
    request.node.stash[ROW] = row
    yield row.figures
    row.seconds = time.monotonic() - began
    if field.relaunched:
        row.figures["vehicles started again"] = field.relaunched[-3:]
    row.modes = {name: field.truth(name).modes_since(began) for name in field.names}
    report.add(row)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    outcome: Any = yield
    result = outcome.get_result()
    row = item.stash.get(ROW, None)
    report = item.config.stash.get(REPORT, None)
    if row is None and report is not None and not result.passed and call.when == "setup" and call.excinfo is not None:
        # it never came to its own part: not for this firmware or form, or the vehicles were not ready for it
        name = "not flown" if result.skipped else "failed"
        reason = str(call.excinfo.value).split("\n")[0][:400]
        report.add(Row(item.nodeid.rpartition("/")[2], name, call.duration, reason=reason))
    if row is not None and call.when == "call":
        row.outcome = result.outcome
        if result.failed and call.excinfo is not None:
            row.reason = str(call.excinfo.value).split("\n")[0][:400]
        elif result.skipped and call.excinfo is not None:
            row.reason = str(call.excinfo.value)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    report = config.stash.get(REPORT, None)
    if report is not None and report.rows:
        terminalreporter.write_line("")
        terminalreporter.write(report.table())
        terminalreporter.write_line(f"report: {os.path.relpath(report.file('json'), Path.cwd())}")
