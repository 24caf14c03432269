"""What a service manager and a shell see of a skygcs process."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import socket
from pathlib import Path

import pytest

from skygcs.cli.process import run_loop, serve_until_signal
from skygcs.errors import LinkError
from support.daemons import made_daemon
from support.table import each


@each(
    ("error", "raised"),
    [(LinkError("the port is taken"), LinkError), (ZeroDivisionError(), BaseExceptionGroup)],
)
def test_an_error_of_ours_comes_out_of_a_task_group_as_itself_and_a_bug_does_not(
    error: Exception, raised: type[BaseException]
) -> None:
    async def fails() -> int:
        async with asyncio.TaskGroup() as group:
            group.create_task(_raise(error))
        return 0

    with pytest.raises(raised, match="the port is taken" if isinstance(error, LinkError) else None):
        run_loop(fails())


async def _raise(error: Exception) -> None:
    raise error


async def test_the_service_manager_hears_when_it_is_up_fed_and_stopping(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.setblocking(False)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "40000")
    daemon = made_daemon(tmp_path)
    serving = asyncio.create_task(serve_until_signal(daemon, endings=[signal.SIGHUP]))
    loop = asyncio.get_running_loop()
    said: list[bytes] = []
    while b"READY=1" not in said or said.count(b"WATCHDOG=1") < 3:
        said.append(await asyncio.wait_for(loop.sock_recv(manager, 64), 10))
    os.kill(os.getpid(), signal.SIGHUP)
    await serving
    while said[-1] != b"STOPPING=1":
        said.append(await asyncio.wait_for(loop.sock_recv(manager, 64), 10))
    manager.close()


async def test_what_is_there_when_it_is_up_is_not_looked_at_by_the_collector_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frozen: list[bool] = []
    daemon = made_daemon(tmp_path)
    monkeypatch.setattr(gc, "freeze", lambda: frozen.append(daemon.ready.is_set()))
    await serve_until_signal(daemon, on_ready=daemon.stop)
    assert frozen == [True]
