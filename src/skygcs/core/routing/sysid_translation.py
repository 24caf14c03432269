"""Translate system ids between a bound link and the router: a program may see its vehicle under another id.

A link bound to vehicles has a `SysidTranslator`. It puts the program's frames into real ids before the router sees
them, and shows the program a vehicle under the id that it expects; `core.routing.router` decides in real ids.

    from the program    a target field of 0 (pymavlink before its first heartbeat) becomes the vehicle's id, if there is
                        exactly one vehicle
    both directions     if the vehicle is shown under another id, the two ids are exchanged in the header and in the
                        target field; this is its own inverse
    renumbered          a message that the dialect does not have is dropped, as the place of its target is not known

A changed frame keeps its sequence number, gets a new CRC and loses its signature, which cannot be renewed here. Ids in
other fields (GIMBAL_MANAGER_STATUS.primary_control_sysid, parameters of commands) are not changed.
"""

from __future__ import annotations

from collections.abc import Collection

from skygcs.core.mavlink.frame import Frame, decode_header, encode_header, mcrf4xx


class SysidTranslator:
    """The translation of one bound channel. ``vehicles``: real system ids; ``shown_as`` needs exactly one of them."""

    __slots__ = ("_only", "_shown", "kept_out", "renumbers", "retargeted", "unsigned", "vehicles")

    def __init__(self, vehicles: Collection[int], shown_as: int | None = None) -> None:
        """Raises ValueError for no vehicle, or for ``shown_as`` and several."""
        self.vehicles = frozenset(vehicles)
        if not self.vehicles or (shown_as is not None and len(self.vehicles) > 1):
            raise ValueError("a bound link needs vehicles, and exactly one if that is shown under another id")
        self._only = next(iter(self.vehicles)) if len(self.vehicles) == 1 else 0
        self._shown = self._only if shown_as is None else shown_as
        self.renumbers = self._shown != self._only
        self.retargeted = 0
        """Frames from the program for all (0) that were addressed to its vehicle instead."""
        self.unsigned = 0
        """Signatures removed from changed frames."""
        self.kept_out = 0
        """Frames with an unknown id, in both directions, on a link that renumbers."""

    def translated(self, system: int) -> int:
        """The id of ``system`` on the other side; the function is its own inverse."""
        if system == self._only:
            return self._shown
        return self._only if system == self._shown else system

    def inward(self, frames: list[Frame]) -> list[Frame]:
        """The program's frames in real ids, without those that cannot be translated."""
        return [meant for frame in frames if (meant := self._meant(frame)) is not None]

    def outward(self, frame: Frame) -> bytes | None:
        """A frame as the program sees it; None if it cannot be translated."""
        if not self.renumbers:
            return frame.raw
        if frame.info is None:
            self.kept_out += 1
            return None
        return self._changed(frame, self.translated(frame.target()[0])).raw

    def counters(self) -> dict[str, int]:
        """JSON-able."""
        return {"retargeted": self.retargeted, "signatures_removed": self.unsigned, "unknown_kept_out": self.kept_out}

    def _meant(self, frame: Frame) -> Frame | None:
        info = frame.info
        if info is None:
            self.kept_out += self.renumbers
            return None if self.renumbers else frame
        target = self.translated(frame.target()[0])
        if not target and self._only and _can_be_targeted(frame):
            self.retargeted += 1
            target = self._only
        return self._changed(frame, target)

    def _changed(self, frame: Frame, target: int) -> Frame:
        changed = readdressed(frame, self.translated(frame.sysid), target)
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
        payload += bytes(max(at + 1 - len(payload), 0))  # a target of 0 was trimmed
        payload[at] = target
    header = decode_header(frame.raw)
    assert header is not None
    _, _, compat, seq, _, compid, msgid, _ = header
    body = encode_header(frame.version, len(payload), seq, sysid, compid, msgid, compat) + bytes(payload)
    crc = mcrf4xx(body[1:] + info.crc_extra_byte)
    return Frame(body + crc.to_bytes(2, "little"), frame.seq, sysid, frame.compid, frame.msgid, info)


def _can_be_targeted(frame: Frame) -> bool:
    """True if the message has a target field and carries it: MAVLink 1 has no extensions, as COMMAND_ACK's target."""
    info = frame.info
    if info is None or info.target_system_offset < 0:
        return False
    return frame.version == 2 or info.target_system_offset < info.min_length
