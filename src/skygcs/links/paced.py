"""Channels into a radio: how large a message is and whom it is for, and a budget that follows what the radio says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from skygcs.core.airtime import ByteBudget, TxQueue
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.pacing import Pacer, RadioRates, report_of
from skygcs.links.base import Outgoing, OwnMessage

FRAME_OVERHEAD_BYTES = 12
"""Of MAVLink 2, unsigned."""

SIGNATURE_BYTES = 13

RADIO_SOURCE = (51, 68)
"""SiK's and RFD900x' own frames."""

MAGIC_V2 = 0xFD


class AirBudget:
    """The budget of one channel's queue. `refresh` about once a second, `on_radio` for every report of its radio."""

    def __init__(self, queue: TxQueue[Outgoing], rates: RadioRates, now: float) -> None:
        self.queue = queue
        self.pacer = Pacer(rates)
        queue.budget = ByteBudget(self.pacer.rate(now), self.pacer.burst_bytes(), now)

    def set_baud(self, baud: int, now: float) -> None:
        """Another rate of the serial port was found to be right."""
        self.pacer.rates = replace(self.pacer.rates, baud=baud)
        self.refresh(now)

    def set_vehicles(self, count: int, now: float) -> None:
        """So many are heard behind this radio."""
        self.pacer.vehicles = count
        self.refresh(now)

    def on_radio(self, frame: Frame, sent_bytes: int, now: float) -> None:
        """A RADIO_STATUS or RADIO that came over this channel; ``sent_bytes`` is all that was written to it."""
        if (frame.sysid, frame.compid) == RADIO_SOURCE and self.pacer.on_report(
            report_of(frame.fields(), now), sent_bytes
        ):
            self.refresh(now)

    def refresh(self, now: float) -> None:
        budget = self.queue.budget
        assert budget is not None
        budget.set_rate(self.pacer.rate(now), now)
        budget.set_burst(self.pacer.burst_bytes(), now)

    def status(self, now: float) -> dict[str, Any]:
        """What the radio bears up, what it reports, and how each class fares."""
        return {**self.pacer.status(now), "classes": self.queue.status()}


def wire_bytes(outgoing: Outgoing, *, signed: bool) -> int:
    """How long it is on the wire; of a message of ours, in MAVLink 2."""
    if type(outgoing) is bytes:
        return len(outgoing)
    assert isinstance(outgoing, OwnMessage)
    trimmed = len(outgoing.payload.rstrip(b"\0")) or 1
    return FRAME_OVERHEAD_BYTES + trimmed + SIGNATURE_BYTES * signed


def flow_of(outgoing: Outgoing, dialect: Dialect) -> int:
    """The system it is for: 0 is everybody."""
    if isinstance(outgoing, OwnMessage):
        return _target(outgoing.info, outgoing.payload)
    v2 = outgoing[0] == MAGIC_V2
    msgid = outgoing[7] | outgoing[8] << 8 | outgoing[9] << 16 if v2 else outgoing[5]
    info = dialect.messages.get(msgid)
    return 0 if info is None else _target(info, outgoing[10 if v2 else 6 :][: outgoing[1]])


def _target(info: MessageInfo, payload: bytes) -> int:
    at = info.target_system_offset
    return payload[at] if 0 <= at < len(payload) else 0
