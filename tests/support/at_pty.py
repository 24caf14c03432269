"""An emulated radio that answers in a thread, on a pty, while a test talks to it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skygcs.ext.radio_tools.port import EmulatedPair, EmulatedPort
from skygcs.sim.at_modem import AtRadio
from skygcs.sim.radio_pair import RadioPair
from support.hanging import HANG_S


@contextmanager
def on_a_pty(path: Path, radio: AtRadio) -> Iterator[AtRadio]:
    port = EmulatedPort(path, radio)
    server = threading.Thread(target=port.serve, name="emulated radio", daemon=True)
    server.start()
    try:
        yield radio
    finally:
        port.stop()
        server.join(timeout=HANG_S)
        port.close()


@contextmanager
def a_pair_on_ptys(paths: tuple[Path, Path], pair: RadioPair) -> Iterator[RadioPair]:
    ports = EmulatedPair(paths, pair)
    server = threading.Thread(target=ports.serve, name="emulated radios", daemon=True)
    server.start()
    try:
        yield pair
    finally:
        ports.stop()
        server.join(timeout=HANG_S)
        ports.close()
