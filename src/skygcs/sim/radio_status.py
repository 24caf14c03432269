"""The ground-side telemetry radio: adds its RADIO_STATUS to the stream, as SiK and RFD900x do (51/68)."""

from __future__ import annotations

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.sim.rng import Rng

RADIO_SYSID = 51
RADIO_COMPID = 68
"""'3' and 'D': SiK's fixed source."""

REPORT_EVERY_S = 1.0
HEARTBEAT_TIMEOUT_S = 5.0
"""Without a HEARTBEAT through its serial port a radio reports nothing; for how long it goes on is our choice."""


class SimRadio:
    """Reports at 1 Hz while heartbeats of a ground station go through."""

    def __init__(self, dialect: Dialect, rng: Rng) -> None:
        self._info = dialect.by_name["RADIO_STATUS"]
        self._rng = rng
        self._heard_at = -1e9
        self._next_at = 0.0
        self._seq = 0

    def on_frame(self, frame: Frame, now: float) -> None:
        """A frame on the uplink."""
        if frame.name == "HEARTBEAT":
            if now - self._heard_at > HEARTBEAT_TIMEOUT_S:
                self._next_at = now
            self._heard_at = now

    def step(self, now: float) -> list[bytes]:
        if now - self._heard_at > HEARTBEAT_TIMEOUT_S or now < self._next_at:
            return []
        self._next_at = max(self._next_at + REPORT_EVERY_S, now)
        fields = {
            "rssi": 190 + round(self._rng.spread(6)),
            "remrssi": 186 + round(self._rng.spread(6)),
            "txbuf": 100,
            "noise": 60 + round(self._rng.spread(4)),
            "remnoise": 58 + round(self._rng.spread(4)),
        }
        raw = encode(self._info, fields, sysid=RADIO_SYSID, compid=RADIO_COMPID, seq=self._seq)
        self._seq = (self._seq + 1) & 0xFF
        return [raw]
