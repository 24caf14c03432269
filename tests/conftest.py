"""What holds for every test."""

from __future__ import annotations

import asyncio
import functools
import gc
import os
import signal
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import typer.main
import uvloop
from hypothesis import HealthCheck, Phase, settings
from hypothesis.internal.conjecture import providers

sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
"""Compiled once for all workers, all processes that tests start and all later runs, in containers too, which often say
otherwise: to compile the suite anew took each worker 28 s of CPU, and each started daemon 1 s."""

from skygcs.config import dialects  # noqa: E402

_load_dialect = dialects.load_dialect


@functools.cache
def _dialect_of_names(*names: str) -> dialects.Dialect:
    return _load_dialect(names)


def _dialect_once(
    name_or_path: str | Sequence[str], *, base_dir: Path | None = None, cache_dir: Path | None = None
) -> dialects.Dialect:
    names = (name_or_path,) if isinstance(name_or_path, str) else tuple(name_or_path)
    if cache_dir is None and not any("/" in name or name.endswith(".xml") for name in names):
        return _dialect_of_names(*names)
    return _load_dialect(name_or_path, base_dir=base_dir, cache_dir=cache_dir)


dialects.load_dialect = _dialect_once
"""Dialects of the package are read once, not for each of a thousand daemons: 10 ms and two dialects each."""

import skygcs.rpc.methods  # noqa: E402
import skygcs.rpc.sessions  # noqa: E402, F401 - as below
from skygcs.config.extension_tables import on_demand  # noqa: E402
from support.examples import each_value, examples, flown_cases, is_deep, searches, shift_seeds  # noqa: E402
from support.file_costs import FileCosts  # noqa: E402
from support.passed_before import PassedBefore, left_to_run  # noqa: E402
from support.virtual_asyncio import VirtualAsyncio, count_work  # noqa: E402
from support.virtual_uvloop import VirtualUvloop  # noqa: E402

shift_seeds()
count_work()

settings.register_profile(
    "suite",
    max_examples=examples(50),
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=not searches(),
)
settings.register_profile(
    "mutants",
    settings.get_profile("suite"),
    database=None,
    derandomize=True,
    phases=(Phase.explicit, Phase.generate),
)
settings.load_profile("suite")
"""No time limits: a busy machine is no mistake of ours. The same examples each time, so that a change is judged by what
it changed; new ones are looked for by night (`support.examples.SEARCH`). For mutants none is made small."""

if not is_deep():
    providers._get_local_constants = lambda: providers._local_constants
"""In `make test` Hypothesis does not read all of `src` for constants that it mixes into its examples: another constant
in any file would change the examples of every test, and each worker spends time on it. The deep run takes them."""

gc.disable()
"""Until all is collected (`pytest_collection_finish`): what a module makes stays, so each pass over it is in vain."""

GARBAGE_THRESHOLDS = 20_000, 5, 5
"""Thresholds of the garbage collector while tests run, instead of 700, 10, 10: it took 4 % of a flight's CPU time."""

COLLECTION_SHIFT_S = 7.0
"""Between the clocks by which two workers collect: above the second in which a gzip header is stamped, too little for a
certificate or a lease that a module makes for its tests."""

for _word, _point in on_demand().items():
    if _word != "plan":  # with it comes what makes plans; a test of it imports it
        _point.load()
# all imported here: a daemon imports its methods in a thread, which virtual time would not wait for

typer.main.get_command = functools.cache(typer.main.get_command)
"""Typer's test runner makes all commands anew for every line that is typed: a quarter of a second each time. They hold
nothing of one line that another could see."""

ON_UVLOOP = Path(__file__).parent / "unit" / "runtime"
"""Tests of timers, exchanges and orders run on uvloop, which the daemon uses, and in the deep run on asyncio's loop."""

WHOLE_DAEMONS = Path(__file__).parent / "integration"
"""They live in virtual time, marked or not. Of a parametrised flight, `make test` flies `support.examples.CASES`, the
deep run each value of each parameter."""

_cache = pytest.StashKey[tempfile.TemporaryDirectory[str]]()


@pytest.fixture(scope="session")
def _empty_folders(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The last one of `_working_folder`."""
    return [tempfile.mkdtemp(dir=tmp_path_factory.getbasetemp(), prefix="in-")]


@pytest.fixture(autouse=True)
def _working_folder(_empty_folders: list[str]) -> Iterator[None]:
    """An empty working folder for each test: what a daemon keeps in a relative path (`log_dir` is "logs" unless a fleet
    file names one) is never read by the daemon of another test. Most leave it empty, and the next one takes it."""
    before = os.getcwd()
    if os.listdir(_empty_folders[0]):
        _empty_folders[0] = tempfile.mkdtemp(dir=os.path.dirname(_empty_folders[0]), prefix="in-")
    os.chdir(_empty_folders[0])
    yield
    os.chdir(before)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--deep", action="store_true", help="run what make test leaves out, too, and runtime on asyncio's loop"
    )
    parser.addoption("--passed-to", type=Path, help="write the node ids of what passed into this file")
    parser.addoption("--passed-before", type=Path, help="with --deep: leave out what such a file says has passed")
    parser.addoption("--share", help="2/3: the third of three shares of the tests, by their names; counted from 0")
    parser.addoption("--costs", action="store_true", help="print the CPU and wall time of each test file")


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Whole daemons live in virtual time, and what is marked ``looptime``, on either loop."""
    virtual = item.path.is_relative_to(WHOLE_DAEMONS) or item.get_closest_marker("looptime") is not None
    if not item.path.is_relative_to(ON_UVLOOP) or config.getoption("--deep"):
        return {"asyncio": VirtualAsyncio if virtual else asyncio.SelectorEventLoop}
    return {"uvloop": VirtualUvloop if virtual else uvloop.new_event_loop}


def pytest_configure(config: pytest.Config) -> None:
    """Signals as at a terminal: a shell starts a background job with SIGINT ignored, and nohup with SIGHUP. Every
    process that a test starts would inherit that, and neither Ctrl-C nor a hang-up would be what is tested.

    One cache for all of this run, its workers and the daemons they start, and not that of whoever runs it: dialects
    are read once, and parameters of simulated vehicles do not stay behind."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if not hasattr(config, "workerinput"):
        config.stash[_cache] = tempfile.TemporaryDirectory(prefix="skygcs-tests-")
        os.environ["XDG_CACHE_HOME"] = config.stash[_cache].name
    config.pluginmanager.register(FileCosts(config))
    if (passed_to := config.getoption("--passed-to")) is not None:
        config.pluginmanager.register(PassedBefore(passed_to))


def pytest_unconfigure(config: pytest.Config) -> None:
    if _cache in config.stash:
        config.stash[_cache].cleanup()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Each worker collects by a wall clock of its own, a few seconds from the others': a case whose name holds the time
    (a gzip header does) ends every run, not only the one whose workers reach it in different seconds."""
    true_time, shift_s = time.time, COLLECTION_SHIFT_S * int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    time.time = lambda: true_time() + shift_s
    try:
        return (yield)
    finally:
        time.time, shift_s = true_time, 0.0  # and no shift for a module that keeps the function


def pytest_collection_finish() -> None:
    """Modules and tests are no part of later collections of garbage, of which one would take a second."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GARBAGE_THRESHOLDS)
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Report sockets, loops and processes that a test left open in its own file, not in a later one: 2 % of the CPU
    time of `make test`."""
    if nextitem is None or nextitem.path != item.path:
        gc.collect()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests marked ``deep``, and most cases of flights, are left to the deep run."""
    deep = config.getoption("--deep")
    if not (deep and searches()):
        left_out = _cases_left_out(items, deep)
        if not deep:
            left_out |= {id(item) for item in items if item.get_closest_marker("deep")}
        _keep(config, items, [item for item in items if id(item) not in left_out])
    if deep and (passed_before := config.getoption("--passed-before")) is not None:
        _keep(config, items, left_to_run(items, set(passed_before.read_text().splitlines()), ON_UVLOOP))
    if share := config.getoption("--share"):
        number, shares = (int(word) for word in share.split("/"))
        _keep(config, items, [item for item in items if zlib.crc32(item.nodeid.encode()) % shares == number])


def _keep(config: pytest.Config, items: list[pytest.Item], kept: list[pytest.Item]) -> None:
    there = {id(item) for item in kept}
    config.hook.pytest_deselected(items=[item for item in items if id(item) not in there])
    items[:] = kept


def _cases_left_out(items: Sequence[pytest.Item], deep: bool) -> set[int]:
    """The cases of parametrised flights that this run leaves out: those of one flight go one code path with other
    numbers, and cost as much as the first. The deep run flies every value of every parameter. Which ones are flown
    depends on the name of the flight and its parameters alone."""
    flights: dict[tuple[Path, str], list[pytest.Function]] = {}
    for item in items:
        if isinstance(item, pytest.Function) and item.path.is_relative_to(WHOLE_DAEMONS):
            flights.setdefault((item.path, item.originalname), []).append(item)
    flown: set[int] = set()
    for (_, name), cases in flights.items():
        chosen: Sequence[pytest.Function] = flown_cases(cases, zlib.crc32(name.encode()))
        if deep and len(cases) > 1:  # each has a callspec, of the loop it runs on, also without parameters
            chosen = [cases[number] for number in each_value([case.callspec._idlist for case in cases])]
        flown |= {id(item) for item in chosen}
    return {id(item) for cases in flights.values() for item in cases} - flown


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
