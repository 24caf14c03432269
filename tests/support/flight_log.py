"""Recorded flights made up: any number of vehicles in circles of their own, at different heights, for any time."""

from __future__ import annotations

import math
from collections.abc import Iterator

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.frame import encode
from skygcs.tlog.format import encode_record
from support.frames import dialect

T0_US = 1_780_000_000_000_000
ORIGIN = Origin(43.7806, -79.4653, 180.0)

GUIDED, LAND, STABILIZE = 4, 9, 0
ARMED, DISARMED = 0x81, 0x01


class FlightLog:
    """Frames of ``vehicles`` ArduCopters (sysids from 1) and of one ground station, ``rate_hz`` of each message."""

    def __init__(self, vehicles: int, rate_hz: float = 5.0, *, radius_m: float = 15.0) -> None:
        self.vehicles = vehicles
        self.rate_hz = rate_hz
        self.radius_m = radius_m
        self._seq: dict[int, int] = {}
        self._frame = EnuFrame(ORIGIN)

    def place(self, sysid: int, t_s: float) -> tuple[float, float, float]:
        """Where the vehicle is: on a circle that it takes a minute for, after ten seconds on the ground."""
        angle = 2 * math.pi * max(t_s - 10.0, 0.0) / 60 + sysid
        column, row = (sysid - 1) % 3, (sysid - 1) // 3
        x = 40.0 * column + self.radius_m * math.cos(angle)
        y = 40.0 * row + self.radius_m * math.sin(angle)
        return x, y, min(max(t_s - 10.0, 0.0), 5.0 + 2 * sysid)

    def records(self, duration_s: float, *, lose: float = 0.0) -> Iterator[bytes]:
        """Records in order of time. Of vehicle n, ``lose`` · n of the frames are missing, every so many-th."""
        self._seq.clear()
        for _, t_s, sysid, name, values in self._messages(duration_s):
            seq = self._seq[sysid] = self._seq.get(sysid, 255) + 1 & 0xFF
            if sysid != 255 and lose and seq % max(round(1 / (lose * sysid)), 2) == 1:
                continue
            raw = encode(dialect().find(name), values, sysid=sysid, compid=190 if sysid == 255 else 1, seq=seq)
            yield encode_record(T0_US + round(t_s * 1e6), raw)

    def content(self, duration_s: float, *, lose: float = 0.0) -> bytes:
        return b"".join(self.records(duration_s, lose=lose))

    def _messages(self, duration_s: float) -> Iterator[tuple[int, float, int, str, dict[str, object]]]:
        for step in range(math.ceil(duration_s * self.rate_hz)):
            t_s = step / self.rate_hz
            second = step % max(round(self.rate_hz), 1) == 0
            if second:
                yield step, t_s, 255, "HEARTBEAT", {"type": 6, "autopilot": 8, "mavlink_version": 3}
            for sysid in range(1, self.vehicles + 1):
                for name, values in self._of(sysid, t_s, duration_s, second):
                    yield step, t_s + sysid * 1e-3, sysid, name, values

    def _of(self, sysid: int, t_s: float, end_s: float, second: bool) -> Iterator[tuple[str, dict[str, object]]]:
        flying = 8.0 <= t_s < end_s - 5.0
        mode = STABILIZE if t_s < 5.0 + sysid else LAND if t_s > 0.8 * end_s + sysid else GUIDED
        if second:
            base = {"base_mode": ARMED if flying else DISARMED, "custom_mode": mode}
            yield "HEARTBEAT", {"type": 2, "autopilot": 3, "mavlink_version": 3, **base}
            left = max(100 - int(60 * t_s / end_s) - sysid, 0)
            volts = round(16800 - 30 * (100 - left))
            yield "SYS_STATUS", {"battery_remaining": left, "voltage_battery": volts, "current_battery": 900 + sysid}
        boot_ms = round(1000 * (t_s + 20.0))
        x, y, up = self.place(sysid, t_s)
        lat, lon, alt = self._frame.to_geodetic(x, y, up)
        yield (
            "GLOBAL_POSITION_INT",
            {
                **{"time_boot_ms": boot_ms, "lat": round(lat * 1e7), "lon": round(lon * 1e7)},
                **{"alt": round(alt * 1000), "relative_alt": round(up * 1000)},
                **{"vx": 100 + sysid, "vy": -50, "vz": -20, "hdg": 9000},
            },
        )
        yield "ATTITUDE", {"time_boot_ms": boot_ms, "roll": 0.1 * sysid, "pitch": -0.05, "yaw": 1.5}
