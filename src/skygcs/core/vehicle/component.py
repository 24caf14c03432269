"""One component that is not an autopilot: a companion computer, a camera, a gimbal, a ground station's program.

Its messages are kept beside its system's vehicle and never change the vehicle's state, which is the autopilot's.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import AUTOPILOT_INVALID
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.message_cache import Slot
from skygcs.core.vehicle.status_texts import StatusText, StatusTextAssembler

MAX_MESSAGES = 64
"""Message types kept of one component; a companion that flies a vehicle sends some 15. Others are only counted."""

MAX_TEXTS = 8
"""Texts kept of one component, the newest."""

Texts = list[StatusText]


class Component:
    """`on_frame` for each of its frames, `tick` at 1 to 10 Hz; both return the texts that are complete now."""

    def __init__(self, sysid: int, compid: int, decoder: Decoder) -> None:
        self.sysid = sysid
        self.compid = compid
        self.slots: dict[int, Slot] = {}
        self.others = Slot("others")
        """All messages beyond `MAX_MESSAGES`, counted together."""
        self.type: int | None = None
        """MAV_TYPE; None without a heartbeat."""
        self.autopilot = AUTOPILOT_INVALID
        self.texts: deque[StatusText] = deque(maxlen=MAX_TEXTS)
        self._decoder = decoder
        self._assembler = StatusTextAssembler()
        self._heartbeat, self._status_text, self._ack = (
            decoder.msgid_of(name) if name in decoder.read else -1
            for name in ("HEARTBEAT", "STATUSTEXT", "COMMAND_ACK")
        )

    @property
    def key(self) -> int:
        return self.sysid << 8 | self.compid

    def on_frame(self, frame: Frame, now: float) -> Texts:
        """Note a frame with a verified CRC. Never raises."""
        slot = self._slot(frame)
        slot.frame = frame
        slot.at = now
        slot.count += 1
        if frame.msgid == self._heartbeat:
            self.type, self.autopilot, *_ = self._decoder.read["HEARTBEAT"](frame.payload)
        elif frame.msgid == self._status_text:
            severity, raw, text_id, chunk_seq = self._decoder.read["STATUSTEXT"](frame.payload)
            return self._kept(self._assembler.on_text(severity, raw, text_id, chunk_seq, now))
        return []

    def state_update(self, msgid: int) -> Slot | None:
        """The cache slot of a message for which `on_frame` only updates that slot (a heartbeat: only while its payload
        is that of the last one); None for other messages."""
        if msgid in (self._status_text, self._ack):
            return None
        return self.slots.get(msgid, self.others)

    def tick(self, now: float, period_s: float | None) -> Texts:
        """Return texts that stay incomplete. With ``period_s``, the time since the last such call, also update the
        rates."""
        if period_s:
            for slot in self.slots.values():
                slot.sample(period_s)
        return self._kept(self._assembler.flush(now))

    def heard_at(self) -> float:
        """When its newest frame came."""
        return max((slot.at for slot in (*self.slots.values(), self.others)), default=0.0)

    def count(self, message: str) -> int:
        """Number of messages of one name that have come."""
        slot = self.slots.get(self._decoder.msgid_of(message))
        return 0 if slot is None else slot.count

    def describe(self, now: float) -> dict[str, Any]:
        """JSON-able: its type, when it was heard, and how much it has sent."""
        dialect = self._decoder.dialect
        return describe(
            self.compid,
            dialect.enums.get("MAV_COMPONENT", {}).get(self.compid),
            None if self.type is None else dialect.enums.get("MAV_TYPE", {}).get(self.type, str(self.type)),
            autopilot=False,
            age_s=now - self.heard_at(),
            messages=sum(slot.count for slot in self.slots.values()) + self.others.count,
        )

    def _slot(self, frame: Frame) -> Slot:
        slot = self.slots.get(frame.msgid)
        if slot is None:
            if len(self.slots) >= MAX_MESSAGES or frame.info is None:
                return self.others
            slot = self.slots[frame.msgid] = Slot(frame.info.name)
        return slot

    def _kept(self, texts: Texts) -> Texts:
        whole = [text for text in texts if text.text]
        self.texts.extend(whole)
        return whole


def describe(
    compid: int, name: str | None, kind: str | None, *, autopilot: bool, age_s: float, messages: int
) -> dict[str, Any]:
    """One component of a system, JSON-able; ``name`` and ``kind`` as in MAV_COMPONENT and MAV_TYPE."""
    return {
        "compid": compid,
        "name": None if name is None else name.removeprefix("MAV_COMP_ID_"),
        "type": None if kind is None else kind.removeprefix("MAV_TYPE_"),
        "autopilot": autopilot,
        "age_s": round(age_s, 3),
        "messages": messages,
    }
