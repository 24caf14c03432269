"""The same test on uvloop, which daemons use, and on asyncio's own event loop: they differ where descriptors fail."""

from __future__ import annotations

import asyncio
import functools
import inspect
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
import uvloop

from support.examples import is_deep

LOOPS: dict[str, Callable[[], asyncio.AbstractEventLoop]] = {
    "uvloop": uvloop.new_event_loop,
    "asyncio": asyncio.SelectorEventLoop,
}
"""`make test` takes the first, `make test-deep` both, as for the tests of tests/unit/runtime."""


def on_every_loop(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run an async test on each of `LOOPS`, each in a loop of its own. Whatever the loop's exception handler is
    told fails the test: a callback of ours has raised."""

    @functools.wraps(test)
    def run(loop_kind: str, **fixtures: Any) -> None:
        complaints: list[dict[str, Any]] = []

        async def watched() -> None:
            asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
            await test(**fixtures)

        with asyncio.Runner(loop_factory=LOOPS[loop_kind]) as runner:
            runner.run(watched())
        assert not complaints

    signature = inspect.signature(test)
    extra = inspect.Parameter("loop_kind", inspect.Parameter.KEYWORD_ONLY)
    run.__signature__ = signature.replace(parameters=[*signature.parameters.values(), extra])  # type: ignore[attr-defined]  # what pytest reads
    del run.__wrapped__  # type: ignore[attr-defined]  # or the plugin would take it for a coroutine function
    return pytest.mark.parametrize("loop_kind", list(LOOPS)[: None if is_deep() else 1])(run)
