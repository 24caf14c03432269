"""An emulated radio that answers in a thread, on a pty, while a test talks to it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skygcs.ext.radio_tools.port import EmulatedPort
from skygcs.sim.at_modem import AtRadio


@contextmanager
def on_a_pty(path: Path, radio: AtRadio) -> Iterator[AtRadio]:
    port = EmulatedPort(path, radio)
    server = threading.Thread(target=port.serve, name="emulated radio", daemon=True)
    server.start()
    try:
        yield radio
    finally:
        port.stop()
        server.join(timeout=60)
        port.close()
