"""The radio at the ground's port of an emulated network, as a whole: what it passes on, and its command line.

The network (`sim.tdm`) models the air, `AtRadio` the radio's settings. This module combines them: on its
command line it passes nothing on, and with other settings than a vehicle's radio it does not reach that vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence

from skygcs.sim.at_modem import BAUD, REGISTERS, AtRadio, Kind
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.tdm import TdmConfig

_CODES = {baud: code for code, baud in BAUD.items()}


class GroundRadio:
    """An RFD900x with multipoint firmware, node 1; the radio at vehicle i (from 0) is node i + 2.

    Settings change who reaches whom, and the rate of the port; how long a round lasts stays as it was made. Raises
    ValueError for a port's rate that no such radio has.
    """

    def __init__(self, air: RadioFleet) -> None:
        config = air.network.config
        if config.baud not in _CODES:
            raise ValueError(f"a radio's serial port has no rate of {config.baud} baud")
        self._air = air
        self.radio = _made(config, 1)
        self.radio.remotes = [_made(config, node) for node in range(2, config.nodes + 1)]

    @property
    def baud(self) -> int:
        return self.radio.baud

    def hear(self, data: bytes, now: float, baud: int) -> bytes:
        """Return what was written to its port at a rate; what of it goes on air."""
        self.radio.hear(data, now, baud)
        return self.radio.take_traffic()

    def step(self, came: Sequence[bytes], now: float, baud: int) -> bytes:
        """Return what comes out of its port for somebody who listens at a rate. ``came``: from the air, and its
        reports."""
        self._air.cut_off = frozenset(
            node for node, remote in enumerate(self.radio.remotes, 1) if not self.radio.hears(remote)
        )
        self.radio.advance(now)
        for raw in came:
            self.radio.pass_on(raw)
        return self.radio.take_output(baud)


def _made(config: TdmConfig, node: int) -> AtRadio:
    kind = Kind.RFD_MULTIPOINT
    settings = {
        "SERIAL_SPEED": _CODES[config.baud],
        "AIR_SPEED": round(config.air_kbps),
        "RTSCTS": int(config.rtscts),
        "NODEID": node,
    }
    saved = {number: settings[name] for number, (name, _) in REGISTERS[kind].items() if name in settings}
    return AtRadio(kind, saved=saved, node_table={0: (0, config.nodes)}, unique_id=f"0x{node:016X}")
