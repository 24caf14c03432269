"""The command line in the test's process, and a stand-in of a daemon that it speaks to, served by a thread."""

from __future__ import annotations

import asyncio
import json
import os
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, Generic, Self, TypeVar
from unittest import mock

from typer.testing import CliRunner, Result

from skygcs.cli.main import app
from skygcs.rpc.server import RpcServer

D = TypeVar("D")


def ran(*words: object, code: int = 0, typed: str | None = None) -> Result:
    """The result of a command that must exit with ``code`` and show no traceback."""
    result = CliRunner().invoke(app, [str(word) for word in words], input=typed)
    assert result.exit_code == code, result.output + repr(result.exception)
    assert "Traceback" not in result.output
    return result


def said(*words: object, code: int = 0, typed: str | None = None) -> str:
    """stdout and stderr of a command that must exit with ``code``."""
    return ran(*words, code=code, typed=typed).output


class Served(Generic[D]):
    """A stand-in of a daemon on a loop of its own thread, and the command line in this one. What ``--socket`` leaves in
    the environment is gone after it."""

    def __init__(self, folder: Path, daemon: D, **server: Any) -> None:
        self.socket = folder / "s.sock"
        self.daemon = daemon
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever)
        self._thread.start()
        self._environ = mock.patch.dict(os.environ, {"SKYGCS_SOCKET": "overridden by --socket"})
        self._environ.start()
        self.server = RpcServer(daemon, self.socket, **server)  # type: ignore[arg-type]  # a stand-in
        self.do(self.server.start())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.do(self.server.close())
        self._environ.stop()
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()

    def do(self, work: Coroutine[Any, Any, Any]) -> None:
        """On the daemon's loop, to its end."""
        asyncio.run_coroutine_threadsafe(work, self.loop).result(10)

    def later(self, delay_s: float, action: Callable[[], None]) -> None:
        """On the daemon's loop."""
        self.loop.call_soon_threadsafe(self.loop.call_later, delay_s, action)

    def run(self, *words: object, code: int = 0, typed: str | None = None) -> str:
        """stdout and stderr of a command that must exit with ``code``."""
        return said("--socket", self.socket, *words, code=code, typed=typed)

    def json(self, *words: object, code: int = 0) -> Any:
        return json.loads(ran("--socket", self.socket, *words, "--json", code=code).stdout)
