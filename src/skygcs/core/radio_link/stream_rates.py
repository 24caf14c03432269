"""Which message at which rate from each vehicle behind one radio, so that all of them together fit.

Pure. `fit` divides what the radio carries down among the vehicles; `Downlink` says how much that is now, from losses
and the radio's own state. `rate_controller` has one vehicle follow its part.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from skygcs.core.radio_link.capacity import FRAME_BYTES, PROFILES

DEFAULT_RATES_HZ: Mapping[str, float] = {
    "GLOBAL_POSITION_INT": 2.0,
    "ATTITUDE": 1.0,
    "SYS_STATUS": 0.5,
    "GPS_RAW_INT": 0.5,
    "EXTENDED_SYS_STATE": 0.5,
    "SYSTEM_TIME": 0.2,
    "EKF_STATUS_REPORT": 0.2,
    "MISSION_CURRENT": 0.5,
}
"""The nav profile of field-notes 10.2 (200 B/s per vehicle: fourteen on half of 57600 baud), the landed state and the
clock (11 B/s more), and of ArduPilot the estimator (7 B/s more) and the current item of its mission (9 B/s more)."""

ARDUPILOT_ONLY = frozenset({"EKF_STATUS_REPORT", "MISSION_CURRENT"})
"""PX4 reports its estimator by ESTIMATOR_STATUS, and streams that and MISSION_CURRENT by itself."""

ARDUPILOT_GROUPS: Mapping[int, tuple[str, ...]] = {
    1: ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2"),
    2: (
        "SYS_STATUS",
        "POWER_STATUS",
        "MEMINFO",
        "MISSION_CURRENT",
        "GPS_RAW_INT",
        "NAV_CONTROLLER_OUTPUT",
        "FENCE_STATUS",
    ),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS", "RC_CHANNELS_RAW"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE", "AHRS2", "SIMSTATE", "PID_TUNING"),
    11: ("VFR_HUD",),
    12: ("AHRS", "SYSTEM_TIME", "BATTERY_STATUS", "EKF_STATUS_REPORT", "VIBRATION", "WIND", "TERRAIN_REPORT"),
}
"""MAV_DATA_STREAM on ArduPilot and messages of each (the stream tables of GCS_MAVLink_Copter.cpp)."""

STREAM_GROUPS: Mapping[str, int] = {name: group for group, names in ARDUPILOT_GROUPS.items() for name in names}

LEAST_RATE_HZ = 0.001
"""One in 17 minutes. A positive rate below it has a period that is longer than any flight, or no number at all."""

MAX_RATE_HZ = 1000.0
"""Faster than any autopilot streams."""

POSITION = "GLOBAL_POSITION_INT"
"""Message by which a fleet is watched: it is slowed down last."""

POSITION_FLOOR_HZ = 0.2
"""However little room there is: a position every five seconds."""

OTHERS_FLOOR = 0.2
"""Part of their wanted rates that the other messages keep before the position is slowed down, too."""

GRID_HZ = (
    0.05,
    0.1,
    0.2,
    0.25,
    0.33,
    0.5,
    0.66,
    1.0,
    1.33,
    2.0,
    2.5,
    3.0,
    4.0,
    5.0,
    6.0,
    8.0,
    10.0,
    15.0,
    20.0,
    25.0,
    50.0,
)
"""Rates that are asked for. Steps of a quarter and more: a vehicle more or less does not change everybody's."""

NORMAL, SELECTED, CONTROLLED = 1.0, 2.0, 4.0
"""Weights: of one byte for a vehicle nobody looks at, an operator's vehicle gets two, one flown by setpoints four."""


def rate_problem(rate_hz: float) -> str | None:
    """Return what is wrong with a rate, in words; None: it is 0 (off) or one that a message may have."""
    if rate_hz == 0 or LEAST_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
        return None
    return f"must be 0 (off) or {LEAST_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz, not {rate_hz:g}"


def profile_rates(name: str) -> dict[str, float]:
    """Hz of each message of a profile, without the heartbeat, which nobody asks for. KeyError for an unknown name."""
    return {message: hz for message, hz in PROFILES[name].items() if message != "HEARTBEAT"}


@dataclass(frozen=True, slots=True)
class RateDemand:
    """Rates that one vehicle would send if there were room."""

    rates_hz: Mapping[str, float]
    weight: float = NORMAL


def fit(
    demands: Mapping[int, RateDemand], total_bytes_per_s: float, each_bytes_per_s: float, frame_bytes: Mapping[str, int]
) -> dict[int, dict[str, float]]:
    """Hz of each message from each vehicle, so that all heartbeats and streams are within ``total_bytes_per_s`` and no
    vehicle's above ``each_bytes_per_s`` (its own timeslot), as far as the floors allow.

    Room is divided by the weights; a vehicle that needs less leaves the rest to the others. ``frame_bytes`` by message.
    """
    heartbeat = FRAME_BYTES["HEARTBEAT"]
    wanted = {key: _bytes(demand.rates_hz, frame_bytes) for key, demand in demands.items()}
    left = max(0.0, total_bytes_per_s - heartbeat * len(demands))
    given = dict.fromkeys(demands, 0.0)
    open_keys = {key for key in demands if wanted[key] > 0}
    while open_keys and left > 1e-6:
        per_weight = left / sum(demands[key].weight for key in open_keys)
        limits = {key: min(wanted[key], max(0.0, each_bytes_per_s - heartbeat)) for key in open_keys}
        sated = {key for key in open_keys if limits[key] - given[key] <= per_weight * demands[key].weight}
        for key in sated or open_keys:
            share = limits[key] - given[key] if sated else per_weight * demands[key].weight
            given[key] += share
            left -= share
        open_keys -= sated or open_keys
    return {key: _within(demand.rates_hz, given[key], frame_bytes) for key, demand in demands.items()}


def on_grid(rate_hz: float) -> float:
    """The next lower rate of the grid; the lowest for anything below it."""
    lower = [hz for hz in GRID_HZ if hz <= rate_hz + 1e-9]
    return lower[-1] if lower else GRID_HZ[0]


def intended_rate(measured_hz: float) -> float:
    """The requested rate behind a measured one, of which up to a tenth was lost; 0 if nothing comes."""
    if measured_hz < GRID_HZ[0]:
        return 0.0
    return next((hz for hz in GRID_HZ if hz >= 0.9 * measured_hz), measured_hz)


def plan_bytes_per_s(rates_hz: Mapping[str, float], frame_bytes: Mapping[str, int]) -> float:
    """Bytes a second of one vehicle's plan, its heartbeat included."""
    return FRAME_BYTES["HEARTBEAT"] + _bytes(rates_hz, frame_bytes)


def _bytes(rates_hz: Mapping[str, float], frame_bytes: Mapping[str, int]) -> float:
    return sum(hz * frame_bytes[name] for name, hz in rates_hz.items())


def _within(rates_hz: Mapping[str, float], room: float, frame_bytes: Mapping[str, int]) -> dict[str, float]:
    """The rates that fit: first the others are slowed down to their floor, then the position to its own."""
    wanted = {name: hz for name, hz in rates_hz.items() if hz > 0}
    if _bytes(wanted, frame_bytes) <= room + 1e-6:
        return wanted
    position = wanted.get(POSITION, 0.0) * frame_bytes.get(POSITION, 0)
    others = _bytes(wanted, frame_bytes) - position
    scale = max(OTHERS_FLOOR, (room - position) / others) if others else 1.0
    left = room - scale * others
    result = {name: on_grid(hz * min(1.0, scale)) for name, hz in wanted.items() if name != POSITION}
    if POSITION in wanted:
        held = min(wanted[POSITION], max(POSITION_FLOOR_HZ, left / frame_bytes[POSITION]))
        result = {POSITION: wanted[POSITION] if held == wanted[POSITION] else on_grid(held), **result}
    return result


LOSS_HIGH, LOSS_LOW = 0.15, 0.05
WORSE_AFTER_S, BETTER_AFTER_S = 8.0, 30.0
WORSE, BETTER, LEAST = 0.75, 1.15, 0.3
"""More is lost than the former for so long: the streams get this much of what they had. Less than the latter for
longer: they get more again, and never less than the least. Two marks and two times: it does not chatter."""

TXBUF_LOW = 0.15
"""Free part of the ground radio's buffer: the downlink fills the air so much that the uplink does not get out."""


class Downlink:
    """Share of the planned downlink the streams get; `look` once a second."""

    def __init__(self) -> None:
        self.factor = 1.0
        self._bad_since: float | None = None
        self._good_since: float | None = None

    def look(self, loss: float | None, txbuf_free: float | None, now: float) -> bool:
        """True if the factor changed. ``loss``: of all vehicles' frames lately, None if not known."""
        bad = (loss is not None and loss > LOSS_HIGH) or (txbuf_free is not None and txbuf_free < TXBUF_LOW)
        good = not bad and (loss is None or loss < LOSS_LOW)
        self._bad_since = (self._bad_since if self._bad_since is not None else now) if bad else None
        self._good_since = (self._good_since if self._good_since is not None else now) if good else None
        before = self.factor
        if self._bad_since is not None and now - self._bad_since >= WORSE_AFTER_S:
            self.factor, self._bad_since = max(LEAST, self.factor * WORSE), now
        elif self._good_since is not None and now - self._good_since >= BETTER_AFTER_S:
            self.factor, self._good_since = min(1.0, self.factor * BETTER), now
        return self.factor != before
