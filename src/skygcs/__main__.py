"""The entry points of the programs: `skygcs`, also as `python -m skygcs`, and `skygcs-cli`."""

import contextlib
import signal
import sys
from collections.abc import Iterator

from skygcs.descriptors import hold_standard


def main() -> None:
    """Entry point of `skygcs`: the daemon's libraries are imported lean, before anything imports them whole."""
    hold_standard()
    with _imports():
        if sys.argv[1:2] == ["run"]:
            from skygcs.cli.lean_imports import needs_tls, prepare_daemon

            prepare_daemon(tls=needs_tls(sys.argv[2:]))
        from skygcs.cli.serve import main as serve

    serve()


def cli() -> None:
    """Entry point of `skygcs-cli`."""
    hold_standard()
    with _imports():
        from skygcs.cli.main import main as run

    run()


@contextlib.contextmanager
def _imports() -> Iterator[None]:
    """Meanwhile Ctrl-C ends the process at once, without a traceback: nothing is there yet that would have to be ended.
    A process that a shell started with Ctrl-C ignored goes on ignoring it."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGINT, signal.default_int_handler)


if __name__ == "__main__":
    main()
