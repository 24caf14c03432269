"""A process that runs skygcs: its event loop, signals, log, exit codes and service manager."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import gc
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator
from types import ModuleType
from typing import TYPE_CHECKING, Any, TextIO, cast

from skygcs.cli.journal import JournalLogger, goes_to_journal
from skygcs.cli.log_limit import LibraryLog, LogLimit, bounded, readable
from skygcs.cli.log_stream import LogStream
from skygcs.descriptors import hold_standard, raise_limit
from skygcs.errors import SkygcsError

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.daemon import Daemon

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_INTERRUPTED = 130
"""The exit code of a program that Ctrl-C ended, as shells report it."""


async def serve_until_signal(
    daemon: Daemon,
    on_ready: Callable[[], None] | None = None,
    *,
    load: Callable[[], FleetConfig] | None = None,
    endings: Iterable[signal.Signals] = (signal.SIGINT, signal.SIGTERM),
) -> None:
    """Run the daemon until one of ``endings``; notify a service manager (sd_notify) of start, reload and stop.

    ``load`` reads the fleet file anew on SIGHUP.
    """
    structlog = import_structlog()
    # signals
    log = structlog.get_logger("skygcs")
    loop = asyncio.get_running_loop()
    reloader = _Reloader(daemon, load)
    handled = dict.fromkeys(endings, daemon.stop)
    if load is not None:
        handled[signal.SIGHUP] = reloader.request
    for number, handler in handled.items():
        loop.add_signal_handler(number, handler)

    async def announce() -> None:
        await daemon.ready.wait()
        # 60,000 objects stay until the end: a full collection would visit them for 35 ms, during control
        gc.collect()
        gc.freeze()
        _notify_service_manager("READY=1")
        log.info(
            "skygcs is up",
            socket=str(daemon.socket_path),
            links=", ".join(daemon.links.open_names()) or "none",
            sysid=daemon.config.daemon.sysid,
            compid=daemon.config.daemon.compid,
            **daemon.extensions.announcements(),
        )
        if on_ready is not None:
            on_ready()

    # tasks beside the daemon, which end with it
    tasks = [
        asyncio.create_task(announce(), name="announce"),
        asyncio.create_task(_feed_watchdog(), name="watchdog"),
        asyncio.create_task(reloader.run(), name="reload"),
    ]
    try:
        await daemon.run()
    finally:
        for task in tasks:
            task.cancel()
        _notify_service_manager("STOPPING=1")
        for number in handled:
            loop.remove_signal_handler(number)
    log.info("skygcs has stopped")


class _Reloader:
    """Applies the fleet file on SIGHUP, one reload at a time; a file with mistakes changes nothing."""

    def __init__(self, daemon: Daemon, load: Callable[[], FleetConfig] | None) -> None:
        self._daemon = daemon
        self._load = load
        self._requested = asyncio.Event()

    def request(self) -> None:
        self._requested.set()

    async def run(self) -> None:
        """Reload the fleet file at each request, until cancelled."""
        log = import_structlog().get_logger("skygcs")
        await self._daemon.ready.wait()
        while self._load is not None:
            await self._requested.wait()
            self._requested.clear()
            _notify_service_manager(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")
            try:
                config = await asyncio.to_thread(self._load)
                for line in await self._daemon.reload(config):
                    log.info(line, kind="reload")
            except SkygcsError as error:
                log.error(f"the fleet file is not applied: {error}", kind="reload")
            _notify_service_manager("READY=1")


async def _feed_watchdog() -> None:
    """Notify the watchdog of systemd that the loop runs, at half of WatchdogSec; nothing if no watchdog is set."""
    try:
        period_s = int(os.environ["WATCHDOG_USEC"]) / 2e6
    except (KeyError, ValueError):
        return
    while period_s > 0:
        _notify_service_manager("WATCHDOG=1")
        await asyncio.sleep(period_s)


def _notify_service_manager(state: str) -> None:
    """The sd_notify(3) protocol of systemd; does nothing without $NOTIFY_SOCKET."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
        notify.sendto(state.encode(), address)


NOT_FOR_OTHERS = 0o027
"""The umask of a running daemon; a stricter one stays. Its group may read the logs (`config.files.LOG_MODE`)."""


def run_loop(main_coroutine: Coroutine[Any, Any, int]) -> int:
    """Run on uvloop if it is installed. Raises the first SkygcsError of a task group, not the group.

    Files that it and its children write are not for others: logs show where vehicles are and who flies them.
    """
    os.umask(os.umask(0o077) | NOT_FOR_OTHERS)
    raise_limit()
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
    """Import structlog without rich, which it would import for a traceback format that is not used here, without
    greenlet, for which it looks, and without colorama, which it needs on Windows only.

    Saves 40 ms and 6 MB, 1 MB, and 0.8 MB. A later import of these works as usual.
    """
    hidden = [name for name in ("colorama", "greenlet", "rich") if name not in sys.modules]
    for name in hidden:
        sys.modules[name] = None  # type: ignore[assignment]  # for importlib: not installed
    try:
        import structlog
        import structlog.dev
    finally:
        for name in hidden:
            del sys.modules[name]
    return structlog


@contextlib.contextmanager
def without_collections() -> Iterator[None]:
    """No garbage collection in the body: imports create objects that stay, and visiting them again costs 50 ms."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def configure_logging(*, verbose: bool = False, quiet: bool = False) -> None:
    """Log one line per change of state to stderr: coloured on a terminal, else key=value. From now on `sys.stderr` is a
    `LogStream`: nothing that this process prints there waits for its reader or raises what is wrong with it."""
    hold_standard()
    structlog = import_structlog()
    level = logging.DEBUG if verbose else logging.WARNING if quiet else logging.INFO
    tty = sys.stderr is not None and sys.stderr.isatty()
    stream = LogStream(sys.stderr)
    sys.stderr = cast("TextIO", stream)  # a TextIO in all but its class
    atexit.register(stream.drain)
    limit = LogLimit()
    within = [bounded(limit, structlog.DropEvent), readable]
    logging.basicConfig(level=logging.WARNING, handlers=[LibraryLog(limit, stream)], force=True)
    # plain: a traceback with the values of local variables could print a signing key or a token
    if goes_to_journal():
        journal = JournalLogger()
        structlog.configure(
            processors=[*within, structlog.processors.add_log_level, structlog.processors.format_exc_info, _as_fields],
            wrapper_class=structlog.make_filtering_bound_logger(level),
            logger_factory=lambda *_: journal,
            cache_logger_on_first_use=False,
        )
        return
    plain = structlog.dev.plain_traceback
    renderer: Any = structlog.dev.ConsoleRenderer(colors=tty, pad_event_to=0, exception_formatter=plain)
    structlog.configure(
        processors=[
            *within,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S" if tty else "iso", utc=not tty),
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.WriteLoggerFactory(file=stream),
        cache_logger_on_first_use=False,
    )


def _as_fields(logger: Any, method: str, record: Any) -> tuple[tuple[()], dict[str, Any]]:
    """structlog calls the logger with what the last processor returns: no text, all fields."""
    return (), dict(record)
