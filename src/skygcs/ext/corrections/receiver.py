"""The serial port of a u-blox base receiver: its messages to the vehicles, and its survey."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from skygcs.errors import LinkError
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.feeder import flow_of
from skygcs.ext.corrections.receiver_setup import ReceiverSetup
from skygcs.ext.corrections.receiver_stream import ReceiverStream
from skygcs.links.serial_port import discard, open_port
from skygcs.links.stream import DescriptorWatcher

if TYPE_CHECKING:
    from skygcs.ext.corrections.feeder import Feeder

TICK_S = 0.5

READ_BYTES = 4096

SILENT_S = 10.0
"""A receiver sends NAV-SVIN each second: its port, or the receiver, is gone."""


class ReceiverSource:
    """One receiver at one port."""

    kind: Literal["receiver"] = "receiver"

    def __init__(self, config: CorrectionsConfig, clock: Callable[[], float]) -> None:
        assert config.serial is not None
        self.name = config.serial
        self._config = config
        self._clock = clock
        self._setup: ReceiverSetup | None = None
        """The dialogue while the port is open."""
        self._fd = -1
        self._told = ""

    async def run(self, feeder: Feeder) -> None:
        """From the opening of the port to its end. Raises LinkError."""
        device = self.name
        port = open_port(device, self._config.baud, rtscts=False, low_latency=False)
        self._fd = port.fileno()
        life = _Life(self, feeder, self._fd, self._clock)
        watcher: DescriptorWatcher | None = None
        try:
            self._setup = life.setup = ReceiverSetup(self._config, receiver_port(self._config.port, device))
            watcher = life.watcher = DescriptorWatcher(asyncio.get_running_loop(), self._fd, life.on_ready)
            self.write(life.setup.begin(self._clock()))
            feeder.connected()
            while not life.ended.done():
                await asyncio.wait({life.ended}, timeout=TICK_S)
                life.tick()
            life.ended.result()
        finally:
            self._setup, self._fd = None, -1
            if watcher is not None:
                watcher.close()
            discard(port)

    def restart_survey(self) -> None:
        """Forget the survey and begin it anew, as after the antenna was moved. Raises LinkError."""
        if self._setup is None:
            raise LinkError(f"the receiver at {self.name} is not connected")
        self.write(self._setup.restart(self._clock()))

    def status(self, now: float) -> dict[str, Any]:
        """``survey``: how far the receiver is with its position; ``gga`` is a caster's."""
        setup = self._setup
        if setup is None:
            return {"gga": None, "survey": None}
        survey = setup.survey
        return {
            "gga": None,
            "survey": {
                "state": self.place_state(),
                "duration_s": None if survey is None else survey.duration_s,
                "minimum_s": self._config.survey_s if setup.surveys else None,
                "accuracy_m": None if survey is None else round(survey.accuracy_m, 4),
                "wanted_m": self._config.survey_accuracy_m if setup.surveys else None,
                "observations": None if survey is None else survey.observations,
            },
        }

    def place_state(self) -> str:
        """How far it is: setting_up, surveying, surveyed or fixed."""
        setup = self._setup
        if setup is None or setup.state != "running":
            return "setting_up"
        if not setup.surveys:
            return "fixed"
        return "surveyed" if setup.is_placed else "surveying"

    def write(self, data: bytes) -> None:
        """Send to the receiver. Raises LinkError."""
        if not data:
            return
        try:
            written = os.write(self._fd, data)
        except BlockingIOError:
            written = 0
        except OSError as error:
            raise LinkError(f"{(error.strerror or str(error)).lower()}; unplugged?") from None
        if written < len(data):
            raise LinkError("the port accepts no data: does another program hold it, or is the cable broken?")

    def report_place(self, feeder: Feeder) -> None:
        """Publish an event when the receiver is further with its position."""
        state = self.place_state()
        if state == self._told or state == "setting_up":
            return
        self._told = state
        survey = None if self._setup is None else self._setup.survey
        texts = {
            "surveying": f"the receiver at {self.name} surveys its position in: at least {self._config.survey_s:g} s, "
            f"until {self._config.survey_accuracy_m:g} m",
            "surveyed": f"the receiver at {self.name} knows its position"
            + ("" if survey is None else f" within {survey.accuracy_m:.2f} m after {survey.duration_s:,} s"),
            "fixed": f"the receiver at {self.name} has the position of the fleet file",
        }
        feeder.report(state, texts[state])


class _Life:
    """One opening of the port. Whatever goes wrong with what it sends ends ``ended``, never the loop."""

    setup: ReceiverSetup
    watcher: DescriptorWatcher

    def __init__(self, source: ReceiverSource, feeder: Feeder, fd: int, clock: Callable[[], float]) -> None:
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._source = source
        self._feeder = feeder
        self._clock = clock
        self._stream = ReceiverStream()
        self._heard_at = clock()
        self._flow = flow_of(self._heard_at)
        self._fd = fd

    def on_ready(self) -> None:
        """Read the port, which has bytes or has gone."""
        try:
            self._read()
        except Exception as error:
            if not self.ended.done():
                self.ended.set_exception(error)

    def tick(self) -> None:
        """Repeat what was not answered. Raises LinkError after a silence."""
        now = self._clock()
        if self.ended.done():
            return
        if now >= self._heard_at + SILENT_S:
            raise LinkError(f"the receiver was silent for {SILENT_S:g} s: its power, or baud")
        self._source.write(self.setup.tick(now))
        self._source.report_place(self._feeder)

    def _read(self) -> None:
        if self.ended.done():
            return
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            raise LinkError(f"{(error.strerror or str(error)).lower()}; unplugged, or its power went") from None
        if not data:
            raise LinkError("the port was closed; unplugged, or its power went")
        now = self._heard_at = self._clock()
        self._flow.spend(len(data), now)
        if (pause_s := self._flow.ready_at(0.0, now) - now) > 0.0:
            self.watcher.want_read(False)
            asyncio.get_running_loop().call_later(pause_s, self.watcher.want_read, True)
        for message in self._stream.feed(data):
            if isinstance(message, bytes):
                self._feeder.take(message)
            else:
                self._source.write(self.setup.on_message(message, now))


def receiver_port(port: str, device: str) -> str:
    """The receiver's port that the cable is in: u-blox's own USB appears as ttyACM, a converter is at a UART."""
    if port != "auto":
        return port
    try:
        real = Path(device).resolve().name
    except OSError:
        real = Path(device).name
    return "usb" if real.startswith("ttyACM") else "uart1"
