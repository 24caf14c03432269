"""Stamps of a vehicle's clock in the clock of this computer.

A message says when it was measured in time since boot. The difference of the clocks is taken from the messages
themselves: the smallest of arrival minus boot time is that of the message that was delayed least. It may grow only as
clocks drift, so a vehicle's crystal is followed, and a slow radio is not.

    the vehicle's time went back, or is off by more than a second      a reboot, or a step of either clock: begin anew
    a time since 1970 (some firmwares with GPS)                       is taken as it is
"""

from __future__ import annotations

from typing import Any

DRIFT = 2e-4
"""Growth of the difference per time: two crystals of 100 ppm each."""

STEP_NS = 1_000_000_000

EPOCH_US = 1_000_000_000_000_000
"""2001 in microseconds since 1970; as time since boot it would be 31 years."""


class VehicleClock:
    """`stamp_ns` of each message of one vehicle, in the order of arrival."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None
        self._at_ns = 0
        self._boot_ns = 0

    def stamp_ns(self, boot_us: int, arrival_ns: int) -> int:
        """When it was measured, in nanoseconds since 1970; never after its arrival. ``boot_us``: the message's own
        time; ``arrival_ns``: when it came, since 1970."""
        if boot_us >= EPOCH_US:
            return min(boot_us * 1000, arrival_ns)
        boot_ns = boot_us * 1000
        offset_ns = arrival_ns - boot_ns
        if self._offset_ns is None or abs(offset_ns - self._offset_ns) > STEP_NS or self._boot_ns - boot_ns > STEP_NS:
            self._offset_ns = offset_ns
        else:
            grown_ns = self._offset_ns + round(DRIFT * max(arrival_ns - self._at_ns, 0))
            self._offset_ns = min(grown_ns, offset_ns)
        self._at_ns, self._boot_ns = arrival_ns, boot_ns
        return min(boot_ns + self._offset_ns, arrival_ns)

    def boot_us(self, unix_ns: int) -> int:
        """The vehicle's time since boot at a time of this computer, in microseconds: the inverse of `stamp_ns`; 0
        before its first message."""
        return 0 if self._offset_ns is None else max((unix_ns - self._offset_ns) // 1000, 0)


def time_fields(unix_ns: int) -> dict[str, Any]:
    """Fields of builtin_interfaces' Time."""
    return {"sec": unix_ns // 1_000_000_000, "nanosec": unix_ns % 1_000_000_000}


def header(unix_ns: int, frame_id: str = "") -> dict[str, Any]:
    """Fields of std_msgs' Header."""
    return {"stamp": time_fields(unix_ns), "frame_id": frame_id}
