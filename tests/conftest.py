"""What holds for every test."""

from __future__ import annotations

import asyncio
import functools
import os
import signal
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer.main
import uvloop
from hypothesis import HealthCheck, settings

import skygcs.rpc.sessions  # noqa: F401 - as below
from skygcs.rpc.methods import METHODS
from support.virtual_uvloop import VirtualUvloop

settings.register_profile("suite", max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("long", settings.get_profile("suite"), max_examples=2000)
settings.load_profile("suite")
"""No time limits: a busy machine is no mistake of ours. `--hypothesis-profile long` looks longer where a test does not
say itself how many examples it needs."""

NOOP_CYCLES = 2
"""Turns of the event loop with nothing to do before virtual time moves on. looptime's own 42 were half of what the
suite costs. Whatever is ready to run, is read from a socket or waits for a thread runs first all the same: these turns
only serve what needs an idle loop to get going."""


tuple(METHODS.values())
"""Imports them all: a daemon imports its methods in a thread, which virtual time would not wait for."""

typer.main.get_command = functools.cache(typer.main.get_command)
"""Typer's test runner makes all commands anew for every line that is typed: a quarter of a second each time. They hold
nothing of one line that another could see."""

ON_BOTH_LOOPS = Path(__file__).parent / "unit" / "runtime"
"""What runs timers, exchanges and orders: its tests run on uvloop, which the daemon uses, as well."""

_cache = pytest.StashKey[tempfile.TemporaryDirectory[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--both-loops", action="store_true", help="run every async test on asyncio's loop and on uvloop")


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Tests in virtual time are in virtual time on uvloop as well."""
    loops: dict[str, Callable[[], asyncio.AbstractEventLoop]] = {"asyncio": asyncio.SelectorEventLoop}
    if config.getoption("--both-loops") or item.path.is_relative_to(ON_BOTH_LOOPS):
        virtual = item.get_closest_marker("looptime") is not None
        loops["uvloop"] = VirtualUvloop if virtual else uvloop.new_event_loop
    return loops


def pytest_configure(config: pytest.Config) -> None:
    """Signals as at a terminal: a shell starts a background job with SIGINT ignored, every process that a test starts
    would inherit that, and Ctrl-C would not be what is tested.

    One cache for all of this run, its workers and the daemons they start, and not that of whoever runs it: dialects
    are read once, and parameters of simulated vehicles do not stay behind."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if not hasattr(config, "workerinput"):
        config.stash[_cache] = tempfile.TemporaryDirectory(prefix="skygcs-tests-")
        os.environ["XDG_CACHE_HOME"] = config.stash[_cache].name


def pytest_unconfigure(config: pytest.Config) -> None:
    if _cache in config.stash:
        config.stash[_cache].cleanup()


def pytest_sessionstart() -> None:
    """No implicit event loop: looptime's plugin asks for the current loop before every test, which on Python 3.11
    makes one that nobody closes, and its warning then fails whatever test happens to run next."""
    asyncio.set_event_loop(None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A marker of its own wins over this one."""
    for item in items:
        if item.get_closest_marker("looptime") is not None:
            item.add_marker(pytest.mark.looptime(noop_cycles=NOOP_CYCLES), append=False)


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: Any) -> None:
    """One line: what was skipped, and why."""
    reasons = Counter(_reason(report) for report in terminalreporter.stats.get("skipped", []))
    if reasons:
        listed = "; ".join(f"{count} × {reason}" for reason, count in reasons.most_common())
        terminalreporter.write_line(f"skipped: {sum(reasons.values())} ({listed})")
    else:
        terminalreporter.write_line("skipped: nothing")


def _reason(report: Any) -> str:
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return str(text).removeprefix("Skipped: ")
