"""A process of skygcs from outside: its loop, its signals, its log, its exit code, its service manager."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import os
import signal
import socket
import sys
from collections.abc import Callable, Coroutine, Iterator
from types import ModuleType
from typing import TYPE_CHECKING, Any

from skygcs.errors import SkygcsError

if TYPE_CHECKING:
    from skygcs.daemon import Daemon

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_INTERRUPTED = 130
"""As a shell reports a program ended by Ctrl-C."""


async def serve_until_signal(daemon: Daemon, on_ready: Callable[[], None] | None = None) -> None:
    """Run the daemon until SIGINT or SIGTERM; tells a service manager (sd_notify) when it is up and when it stops."""
    structlog = import_structlog()
    log = structlog.get_logger("skygcs")
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, daemon.stop)

    async def announce() -> None:
        await daemon.ready.wait()
        # What is there now stays: 60 000 objects that a full collection would look at again for 35 ms, amid control.
        gc.collect()
        gc.freeze()
        _notify_service_manager("READY=1")
        log.info(
            "skygcs is up",
            socket=str(daemon.socket_path),
            links=", ".join(daemon.open_links()) or "none",
            sysid=daemon.config.daemon.sysid,
            compid=daemon.config.daemon.compid,
        )
        if on_ready is not None:
            on_ready()

    tasks = [
        asyncio.create_task(announce(), name="announce"),
        asyncio.create_task(_feed_watchdog(), name="watchdog"),
    ]
    try:
        await daemon.run()
    finally:
        for task in tasks:
            task.cancel()
        _notify_service_manager("STOPPING=1")
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)
    log.info("skygcs has stopped")


async def _feed_watchdog() -> None:
    """Tell systemd that the loop still turns, at half of WatchdogSec; nothing where no watchdog is set."""
    try:
        period_s = int(os.environ["WATCHDOG_USEC"]) / 2e6
    except (KeyError, ValueError):
        return
    while period_s > 0:
        _notify_service_manager("WATCHDOG=1")
        await asyncio.sleep(period_s)


def _notify_service_manager(state: str) -> None:
    """systemd's sd_notify(3) protocol; nothing happens where there is no $NOTIFY_SOCKET."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
        notify.sendto(state.encode(), address)


def run_loop(main_coroutine: Coroutine[Any, Any, int]) -> int:
    """Run on uvloop where it is installed. The first SkygcsError of a task group is raised as itself."""
    try:
        import uvloop

        factory: Callable[[], asyncio.AbstractEventLoop] | None = uvloop.new_event_loop
    except ImportError:
        factory = None
    try:
        with asyncio.Runner(loop_factory=factory) as runner:
            return runner.run(main_coroutine)
    except BaseExceptionGroup as group:
        first: BaseException | None = group.subgroup(SkygcsError)
        while isinstance(first, BaseExceptionGroup):
            first = first.exceptions[0]
        if first is None:
            raise
        raise first from None


def import_structlog() -> ModuleType:
    """structlog without rich, which it imports if it finds it, for a traceback format that is not used here.

    40 ms and 6 MB; whoever imports rich later gets it as ever.
    """
    hidden = [name for name in ("rich",) if name not in sys.modules]
    for name in hidden:
        sys.modules[name] = None  # type: ignore[assignment]  # importlib: "not there"
    try:
        import structlog
        import structlog.dev
    finally:
        for name in hidden:
            del sys.modules[name]
    return structlog


@contextlib.contextmanager
def without_collections() -> Iterator[None]:
    """No garbage collection in the body: what an import makes stays, and looking at it again and again is 50 ms."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def configure_logging(*, verbose: bool = False, quiet: bool = False) -> None:
    """One line per change of state on stderr: coloured on a terminal, key=value elsewhere."""
    structlog = import_structlog()
    level = logging.DEBUG if verbose else logging.WARNING if quiet else logging.INFO
    tty = sys.stderr.isatty()
    # plain: a traceback with the values of local variables could print a signing key or a token
    plain = structlog.dev.plain_traceback
    renderer: Any = structlog.dev.ConsoleRenderer(colors=tty, pad_event_to=0, exception_formatter=plain)
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S" if tty else "iso", utc=not tty),
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(file=sys.stderr),
        cache_logger_on_first_use=False,
    )
