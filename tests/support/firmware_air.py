"""The emulated multipoint radio in front of real vehicles: a pseudo-terminal with the ground's radio, and the frames of
each vehicle through a radio of its own. Stepped by the thread of `udp_relay.UdpRelay`."""

from __future__ import annotations

import contextlib
import os
import pty
import time
import tty

from skygcs.cli.serial_ports import port_rate, set_port_rate
from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.ground_radio import GroundRadio
from skygcs.sim.radio_fleet import UART_BYTES
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import GROUND, TdmConfig, TdmNetwork

READ_BYTES = 4096


class EmulatedAir:
    """``device`` is the ground radio's serial port. Vehicle i of ``sysids`` is at node i + 1."""

    def __init__(self, sysids: list[int], *, air_kbps: float, baud: int, loss: float, seed: int = 1) -> None:
        dialect = load_dialect("ardupilotmega")
        self._began = time.monotonic()
        config = TdmConfig(len(sysids) + 1, air_kbps, baud, loss, 0.0, 1.0, rtscts=False, distances_m=())
        self.network = TdmNetwork(config, dialect, Rng(seed), 0.0)
        self.cut_off: frozenset[int] = frozenset()
        self._ground = GroundRadio(self)  # type: ignore[arg-type]  # it looks at these two attributes only
        self._nodes = {sysid: node for node, sysid in enumerate(sysids, 1)}
        self._sysids = dict(enumerate(sysids, 1))
        self._parser = FrameParser(dialect)
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        set_port_rate(self._slave, baud)
        self.device = os.ttyname(self._slave)
        self.not_sent = 0

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)

    def from_vehicle(self, sysid: int, raw: bytes) -> None:
        """One frame at a vehicle's radio; what finds no room in its port is not sent, as by a real autopilot."""
        now = time.monotonic() - self._began
        node = self._nodes[sysid]
        if self.network.backlog_bytes(node, now) + len(raw) > UART_BYTES or not self.network.has_room(node, len(raw)):
            self.not_sent += 1
            return
        self.network.write(node, raw, now)

    def step(self) -> list[tuple[int, bytes]]:
        """Live on until now; frames for the vehicles, by system id."""
        now = time.monotonic() - self._began
        try:
            data = os.read(self._master, READ_BYTES)
        except OSError:
            data = b""
        if data:
            for frame in self._parser.feed(self._ground.hear(data, now, port_rate(self._master))):
                self.network.write(GROUND, frame.raw, now)
        came, heard = [], []
        for node, raw in self.network.step(now):
            if node == GROUND:
                came.append(raw)
            elif node in self._sysids and node not in self.cut_off:
                heard.append((self._sysids[node], raw))
        output = self._ground.step(came, now, port_rate(self._master))
        if output:
            with contextlib.suppress(BlockingIOError):  # nobody reads: what was not fetched is lost, as of a UART
                os.write(self._master, output)
        return heard
