"""What stands between a bound link and the router: the vehicles of one program, perhaps under another system id.

A link bound to vehicles has an `Endpoint`. It turns what the program says into what is meant before the router sees it,
and shows the program a vehicle under the id it expects; who gets what is decided in `core.routing`, in real ids.

    from the program    a target field of 0 (pymavlink before its first heartbeat), if there is one vehicle: that one
    both ways           if the vehicle is shown under another id, the two ids change places: in the header and in the
                        target field. So it is the same for every id, and what is turned twice is as it was
    renumbered          an id that the dialect does not have stays out, as nobody knows where its target stands

A frame that is changed keeps its sequence number, gets a new CRC and loses its signature: nobody here could renew it.
Ids in other fields (GIMBAL_MANAGER_STATUS.primary_control_sysid, parameters of commands) are left as they are.
"""

from __future__ import annotations

from collections.abc import Collection

from fastcrc.crc16 import mcrf4xx

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.header import decode_header, encode_header


class Endpoint:
    """The edge of one bound channel. ``vehicles`` are real system ids; ``shown_as`` counts with exactly one of them."""

    __slots__ = ("_only", "_shown", "kept_out", "renumbers", "retargeted", "unsigned", "vehicles")

    def __init__(self, vehicles: Collection[int], shown_as: int | None = None) -> None:
        """Raises ValueError for no vehicle, or for ``shown_as`` and several."""
        self.vehicles = frozenset(vehicles)
        if not self.vehicles or (shown_as is not None and len(self.vehicles) > 1):
            raise ValueError("an endpoint has vehicles, and exactly one if that is shown under another id")
        self._only = next(iter(self.vehicles)) if len(self.vehicles) == 1 else 0
        self._shown = self._only if shown_as is None else shown_as
        self.renumbers = self._shown != self._only
        self.retargeted = 0
        """Frames from the program for all (0) that were turned into ones for its vehicle."""
        self.unsigned = 0
        """Signatures taken off frames that were changed."""
        self.kept_out = 0
        """Frames of unknown id, of either way, on a renumbered endpoint."""

    def turned(self, system: int) -> int:
        """The id that stands for ``system`` on the other side; its own inverse."""
        if system == self._only:
            return self._shown
        return self._only if system == self._shown else system

    def inward(self, frames: list[Frame]) -> list[Frame]:
        """What the program means by what it sent, in real ids; without what cannot be turned."""
        return [meant for frame in frames if (meant := self._meant(frame)) is not None]

    def outward(self, frame: Frame) -> bytes | None:
        """A frame as the program is to see it; None if it cannot be turned."""
        if not self.renumbers:
            return frame.raw
        if frame.info is None:
            self.kept_out += 1
            return None
        return self._changed(frame, self.turned(frame.target()[0])).raw

    def counters(self) -> dict[str, int]:
        """JSON-able."""
        return {"retargeted": self.retargeted, "signatures_removed": self.unsigned, "unknown_kept_out": self.kept_out}

    def _meant(self, frame: Frame) -> Frame | None:
        info = frame.info
        if info is None:
            self.kept_out += self.renumbers
            return None if self.renumbers else frame
        target = self.turned(frame.target()[0])
        if not target and self._only and _can_be_targeted(frame):
            self.retargeted += 1
            target = self._only
        return self._changed(frame, target)

    def _changed(self, frame: Frame, target: int) -> Frame:
        changed = readdressed(frame, self.turned(frame.sysid), target)
        self.unsigned += changed is not frame and frame.signed
        return changed


def readdressed(frame: Frame, sysid: int, target: int) -> Frame:
    """The same message with this source system and, where it has the field, this target system (0: left as it is).

    The frame itself if that changes nothing; else one without a signature. ``frame`` is of a known message.
    """
    info = frame.info
    assert info is not None
    at = info.target_system_offset
    moved = at >= 0 and target not in (0, frame.target()[0])
    if sysid == frame.sysid and not moved:
        return frame
    payload = bytearray(frame.payload)
    if moved:
        payload += bytes(max(at + 1 - len(payload), 0))  # it was trimmed away while it was 0
        payload[at] = target
    header = decode_header(frame.raw)
    assert header is not None
    _, _, compat, seq, _, compid, msgid, _ = header
    body = encode_header(frame.version, len(payload), seq, sysid, compid, msgid, compat) + bytes(payload)
    crc = mcrf4xx(body[1:] + info.crc_extra_byte)
    return Frame(body + crc.to_bytes(2, "little"), frame.seq, sysid, frame.compid, frame.msgid, info)


def _can_be_targeted(frame: Frame) -> bool:
    """Whether there is a target field, and room for it: MAVLink 1 carries no extensions, as COMMAND_ACK's target is."""
    info = frame.info
    if info is None or info.target_system_offset < 0:
        return False
    return frame.version == 2 or info.target_system_offset < info.min_length
