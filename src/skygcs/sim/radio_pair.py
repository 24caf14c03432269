"""Two radios on a bench, both with a serial port at this computer: their command lines, and the air between them.

`AtRadio` is each one's settings, `sim.tdm` the air; a radio on its command line, or with settings that the other does
not hear, passes nothing on. Only whole MAVLink frames are carried.
"""

from __future__ import annotations

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.at_modem import BAUD, REGISTERS, AtRadio, Kind
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import TdmConfig, TdmNetwork


class RadioPair:
    """`hear` what an end's port gets, `step` often, `take_output` of each end. Ends are 0, the master, and 1."""

    def __init__(self, config: TdmConfig, dialect: Dialect, rng: Rng, now: float) -> None:
        self.radios = (_made(config, 1), _made(config, 2))
        self._air = TdmNetwork(config, dialect, rng, now)
        self._parsers = (FrameParser(dialect), FrameParser(dialect))

    def hear(self, end: int, data: bytes, now: float, baud: int) -> None:
        """Bytes at an end's port, sent at ``baud``."""
        radio = self.radios[end]
        radio.hear(data, now, baud)
        traffic = radio.take_traffic()
        if baud == radio.baud:
            for frame in self._parsers[end].feed(traffic):
                self._air.write(end, frame.raw, now)

    def step(self, now: float) -> None:
        """Let time pass."""
        a, b = self.radios
        for radio in self.radios:
            radio.advance(now)
        for end, raw in self._air.step(now):
            if end < 2 and a.hears(b) and b.hears(a):
                self.radios[end].pass_on(raw)

    def take_output(self, end: int, baud: int) -> bytes:
        """Return what came out of an end since the last call, as a listener at ``baud`` receives it."""
        return self.radios[end].take_output(baud)


def _made(config: TdmConfig, node: int) -> AtRadio:
    kind = Kind.RFD_MULTIPOINT
    codes = {baud: code for code, baud in BAUD.items()}
    settings = {"SERIAL_SPEED": codes[config.baud], "AIR_SPEED": round(config.air_kbps), "NODEID": node}
    saved = {number: settings[name] for number, (name, _) in REGISTERS[kind].items() if name in settings}
    return AtRadio(kind, saved=saved, node_table={0: (0, config.nodes)}, unique_id=f"0x{node:016X}")
