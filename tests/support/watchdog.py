"""A limit to the processor time of what may loop for ever in compiled code, where no handler of Python's ever runs."""

from __future__ import annotations

import faulthandler
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def processor_limit(seconds: float) -> Iterator[None]:
    """End the process, with a trace, once it has used so many seconds: a busy machine makes nothing late."""
    faulthandler.register(signal.SIGPROF, file=sys.__stderr__, chain=True)  # then as the signal does by itself: it ends
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.unregister(signal.SIGPROF)
