"""Messages of one vehicle as far as they are kept: bounded whatever it sends. Pure.

    `MessageCache`   the last frame of each message, message rates, and the decoded telemetry groups
    `Parameters`     values of the parameters that decide how an autopilot takes setpoints and orders

A frame is unpacked when a group is first read, and only once: a decoded group is kept as long as its frames are.

Parameters are taken from the PARAM_VALUEs that anybody requested.
"""

from __future__ import annotations

import math
import operator
import struct
from typing import Any

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.vehicle_class import declared_params
from skygcs.core.vehicle.decoding import GROUPS, Decoder, TelemetryGroup, TelemetryGroupSpec

SMOOTHING = 0.4
"""Weight of the newest second in a rate: sampled once a second, a 1 Hz message is counted 0, 1 or 2 times."""

ALTERNATIVE_LAG_S = 2.0
"""Age beyond the newest message with the same data, above which the preferred message is not used."""


_NOTHING: tuple[None, tuple[Any, ...]] = (None, ())


class Slot:
    """The newest frame of one message. ``frame`` is None only after a reboot; ``rate_hz`` is smoothed over a few
    seconds.

    ``unpacked``: the frame that was unpacked last and the values read from it (see `MessageCache.values`).
    """

    __slots__ = ("_mark", "_sampled", "at", "count", "frame", "name", "rate_hz", "unpacked")

    def __init__(self, name: str) -> None:
        self.name = name
        self.frame: Frame | None = None
        self.at = 0.0
        self.count = 0
        self.rate_hz = 0.0
        self.unpacked: tuple[Frame | None, tuple[Any, ...]] = _NOTHING
        self._mark = 0
        self._sampled = False

    def sample(self, period_s: float) -> None:
        """Call about once a second with the time since the last call."""
        measured = (self.count - self._mark) / period_s
        self._mark = self.count
        if self._sampled:
            self.rate_hz += SMOOTHING * (measured - self.rate_hz)
            if self.rate_hz < 0.01:
                self.rate_hz = 0.0
        else:
            self.rate_hz = measured
            self._sampled = True


class MessageCache:
    """Slots by msgid; bounded by the number of messages in the dialect."""

    def __init__(self, decoder: Decoder) -> None:
        self.decoder = decoder
        self.slots: dict[int, Slot] = {}
        self._cache: dict[str, tuple[list[Frame], TelemetryGroup | None]] = {}
        self._ids = {s.name: tuple(map(decoder.msgid_of, s.messages)) for s in GROUPS}

    def slot(self, message: str) -> Slot | None:
        """The last frame of a message, its time and count; None if none came since the last reboot."""
        slot = self.slots.get(self.decoder.msgid_of(message))
        return slot if slot is not None and slot.frame is not None else None

    def values(self, slot: Slot) -> tuple[Any, ...]:
        """Values of the slot's frame (`decoder.Values`), unpacked once for all groups that read it."""
        frame = slot.frame
        if frame is None:
            return ()
        if slot.unpacked[0] is not frame:
            slot.unpacked = (frame, self.decoder.values(frame.name, frame.payload))
        return slot.unpacked[1]

    def telemetry(self, name: str) -> tuple[TelemetryGroup | None, float]:
        """One telemetry group without its age, and when its newest message came. The group is shared: do not modify
        it."""
        return self._group_values(_BY_NAME[name])

    def telemetry_group(self, name: str, now: float) -> dict[str, Any] | None:
        """One telemetry group with its age; None: no message of it has come. The result belongs to the caller."""
        group_values, at = self._group_values(_BY_NAME[name])
        return None if group_values is None else {**group_values, "age_s": round(now - at, 3)}

    def rates(self, now: float) -> dict[str, dict[str, Any]]:
        return {
            slot.name: {"rate_hz": round(slot.rate_hz, 2), "age_s": round(now - slot.at, 3), "count": slot.count}
            for slot in self.slots.values()
        }

    def sample(self, period_s: float) -> None:
        """Update the rates; about once a second."""
        for slot in self.slots.values():
            slot.sample(period_s)

    def forget_before(self, now: float, keep: str) -> None:
        """Drop all frames received before ``now`` (the vehicle restarted), but for one message."""
        kept = self.decoder.msgid_of(keep)
        for msgid, slot in self.slots.items():
            if msgid != kept and slot.at < now:
                slot.frame = None

    def newest(self, messages: tuple[str, ...]) -> Slot | None:
        """The message that came last of these."""
        slots = [s for s in map(self.slot, messages) if s is not None]
        return max(slots, key=lambda s: s.at) if slots else None

    def _sources(self, group: TelemetryGroupSpec) -> list[Slot]:
        get = self.slots.get
        slots = [s for i in self._ids[group.name] if (s := get(i)) is not None and s.frame is not None]
        if group.combine or len(slots) < 2:
            return slots
        newest = max(s.at for s in slots)
        return [next(s for s in slots if s.at >= newest - ALTERNATIVE_LAG_S)]

    def _group_values(self, group: TelemetryGroupSpec) -> tuple[TelemetryGroup | None, float]:
        ids = self._ids[group.name]
        if len(ids) == 1:  # most groups come from one message, and are read more often than it comes
            only, known = self.slots.get(ids[0]), self._cache.get(group.name)
            if only is not None and known is not None and only.frame is not None and known[0][0] is only.frame:
                return known[1], only.at
        slots = self._sources(group)
        if not slots:
            return None, 0.0
        at = slots[0].at if len(slots) == 1 else max(s.at for s in slots)
        frames = [s.frame for s in slots if s.frame is not None]
        known = self._cache.get(group.name)
        if known is not None and len(known[0]) == len(frames) and all(map(operator.is_, known[0], frames)):
            return known[1], at
        values = {slot.name: v for slot in slots if (v := self.values(slot))}
        group_values = group.decode(values, self.decoder) if values else None
        self._cache[group.name] = (frames, group_values)
        return group_values, at


_BY_NAME = {group.name: group for group in GROUPS}


WATCHED = declared_params() | frozenset(
    {
        "ATC_ANGLE_BOOST",
        "COM_DLL_EXCEPT",
        "COM_OBL_RC_ACT",
        "COM_OF_LOSS_T",
        "COM_RC_IN_MODE",
        "FENCE_ACTION",
        "FENCE_ALT_MAX",
        "FENCE_ENABLE",
        "FENCE_RADIUS",
        "FENCE_TYPE",
        "FS_GCS_ENABLE",
        "FS_OPTIONS",
        "GF_ACTION",
        "GF_MAX_HOR_DIST",
        "GF_MAX_VER_DIST",
        "GUID_OPTIONS",
        "GUID_TIMEOUT",
        "MIS_RESTART",
        "MOT_THST_EXPO",
        "MOT_THST_HOVER",
        "MPC_THR_HOVER",
        "NAV_DLL_ACT",
        "THR_MDL_FAC",
    }
)
"""Those of setpoints, of the fence's cylinder, and what `vehicle_class` declares. Others are not kept: a vehicle has a
thousand parameters."""

INTEGER_FORMAT = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}
"""struct codes of the integer types among MAV_PARAM_TYPE."""


class Parameters:
    """Values of `WATCHED` by name, each with the time of its report. A reboot drops them all."""

    __slots__ = ("_values",)

    def __init__(self) -> None:
        self._values: dict[str, tuple[float, float]] = {}

    def note(self, raw_name: bytes, wire_value: float, param_type: int, now: float, *, bytewise: bool) -> None:
        """Note a PARAM_VALUE. ``bytewise``: the float field holds an integer's bytes, as PX4 sends it
        (PARAM_ENCODE_BYTEWISE); else integers are cast to float, as ArduPilot does (PARAM_ENCODE_C_CAST)."""
        name = raw_name.rstrip(b"\0").decode("ascii", "replace")
        if name not in WATCHED:
            return
        code = INTEGER_FORMAT.get(param_type)
        value = wire_value
        if code is not None and bytewise:
            value = float(struct.unpack_from("<" + code, struct.pack("<f", wire_value))[0])
        if math.isfinite(value):
            self._values[name] = (value, now)

    def value(self, name: str) -> float | None:
        """The value; None if it was not reported since the vehicle started."""
        known = self._values.get(name)
        return None if known is None else known[0]

    def reported_at(self, name: str) -> float | None:
        known = self._values.get(name)
        return None if known is None else known[1]

    def forget(self) -> None:
        self._values.clear()
