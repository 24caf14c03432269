"""Captures of every kind that programs write, made by pymavlink here, with what is in them counted as they are made.

They hold what other people's captures showed (mixed versions, re-trimmed frames with the sender's checksum, unknown
ids, a cut-off record, clocks that step, a flood of heartbeats, signed frames, bytes lost on a serial line): a clone
without those runs the same code. Each has one vehicle, 1/1, as those have.
"""

from __future__ import annotations

import functools
import math
import random
import struct
from collections import Counter
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

T0_US = 1_717_000_000_000_000
ARDUPILOT, PX4, INVALID = 3, 12, 8
QUADROTOR, GENERIC, GCS, ADSB, FIXED_WING, SUBMARINE = 2, 0, 6, 27, 1, 12
ARMED = 0x81
UNKNOWN_ID = 54_321
TLOG, RAW = "tlog", "raw"

AUTOPILOTS = {ARDUPILOT: "MAV_AUTOPILOT_ARDUPILOTMEGA", PX4: "MAV_AUTOPILOT_PX4", INVALID: "MAV_AUTOPILOT_INVALID"}
TYPES = {
    **{QUADROTOR: "MAV_TYPE_QUADROTOR", GENERIC: "MAV_TYPE_GENERIC", GCS: "MAV_TYPE_GCS", ADSB: "MAV_TYPE_ADSB"},
    **{FIXED_WING: "MAV_TYPE_FIXED_WING", SUBMARINE: "MAV_TYPE_SUBMARINE"},
}

_HEADER = struct.Struct("<BBBBBBBHB")


class MadeLog:
    """Frames put down one after the other; ``expected`` has the keys of the public captures' expected.json."""

    def __init__(self, kind: str = TLOG) -> None:
        self._kind = kind
        self._pieces: list[bytes] = []
        self._seq: Counter[tuple[int, int]] = Counter()
        self._status: Counter[str] = Counter()
        self._versions: Counter[str] = Counter()
        self._sources: Counter[str] = Counter()
        self._types: Counter[str] = Counter()
        self._heartbeats: Counter[tuple[int, int, int, int]] = Counter()
        self._signed = 0
        self._times_us: list[int] = []
        self.now_us = T0_US

    def put(
        self,
        message: Any,
        sysid: int = 1,
        compid: int = 1,
        *,
        v1: bool = False,
        sign: bool = False,
        retrimmed: bool = False,
    ) -> bytes:
        """``retrimmed``: as QGroundControl records a frame whose sender did not trim its zeros: trimmed, but with the
        sender's checksum, which is wrong then."""
        encoder = mavlink.MAVLink(None, sysid, compid)
        encoder.seq = self._next_seq(sysid, compid)
        if sign:
            encoder.signing.secret_key, encoder.signing.link_id = bytes(32), 7
            encoder.signing.timestamp, encoder.signing.sign_outgoing = 28_309_687_961_616 + len(self._pieces), True
        raw = bytes(message.pack(encoder, force_mavlink1=v1))
        if retrimmed:
            raw = _with_the_checksum_of_untrimmed(raw, message)
        name = message.get_type()
        self._types[name] += 1
        self._versions["v1" if v1 else "v2"] += 1
        if retrimmed:
            self._status["badcrc"] += 1
        else:
            self._status["ok"] += 1
            self._sources[f"{sysid}/{compid}"] += 1
            self._signed += sign
            if name == "HEARTBEAT":
                self._heartbeats[sysid, compid, message.autopilot, message.type] += 1
        self._put_down(raw)
        return raw

    def put_unknown(self) -> None:
        """A frame of a message that no dialect has."""
        payload = bytes(range(1, 21))
        ids = (self._next_seq(1, 1), 1, 1, UNKNOWN_ID & 0xFFFF, UNKNOWN_ID >> 16)
        self._put_down(_HEADER.pack(0xFD, len(payload), 0, 0, *ids) + payload + b"\x12\x34")
        self._types[f"UNKNOWN_{UNKNOWN_ID}"] += 1
        self._status["unknown"] += 1
        self._versions["v2"] += 1

    def put_junk(self, data: bytes) -> None:
        """Bytes of no frame; without a magic byte among them, which could begin one."""
        data = data.replace(b"\xfd", b"\0").replace(b"\xfe", b"\0")
        self._pieces.append(data)
        self._status["skipped_bytes"] += len(data)

    def lose(self, sysid: int = 1, compid: int = 1, count: int = 1) -> None:
        """So many frames were sent and never came."""
        self._seq[sysid, compid] += count

    def done(self) -> tuple[bytes, dict[str, Any]]:
        steps = [b - a for a, b in zip(self._times_us, self._times_us[1:], strict=False)]
        tlog = self._kind == TLOG
        elapsed_us = sum(step for step in steps if abs(step) < 86_400_000_000)
        return b"".join(self._pieces), {
            "kind": self._kind,
            "frames": sum(self._versions.values()),
            "versions": dict(self._versions),
            "status": {key: count for key, count in self._status.items() if count},
            "duration_s": round(elapsed_us / 1e6, 1) if tlog else None,
            "ts_backwards": sum(not 0 <= step < 86_400_000_000 for step in steps) if tlog else None,
            "signed": self._signed,
            "sources": dict(self._sources),
            "types": dict(self._types),
            "heartbeats": [
                [sysid, compid, AUTOPILOTS[autopilot], TYPES[kind], 3, count]
                for (sysid, compid, autopilot, kind), count in self._heartbeats.items()
            ],
        }

    def _put_down(self, raw: bytes) -> None:
        self._times_us.append(self.now_us)
        self._pieces.append((self.now_us.to_bytes(8, "big") if self._kind == TLOG else b"") + raw)

    def _next_seq(self, sysid: int, compid: int) -> int:
        seq = self._seq[sysid, compid]
        self._seq[sysid, compid] += 1
        return seq & 0xFF


def _with_the_checksum_of_untrimmed(raw: bytes, message: Any) -> bytes:
    full = message.unpacker.size
    payload = raw[10 : 10 + raw[1]]
    assert raw[1] < full, f"{message.get_type()} has no zeros at its end"
    sent = bytes([full]) + raw[2:10] + payload.ljust(full, b"\0") + bytes([message.crc_extra])
    return raw[:-2] + struct.pack("<H", mavlink.x25crc(sent).crc)


class Flight:
    """What one vehicle sends in a flight of half a minute, second by second."""

    def __init__(self, log: MadeLog, autopilot: int = ARDUPILOT, *, v1: bool = False) -> None:
        self.log = log
        self.autopilot = autopilot
        self.v1 = v1

    def second(self, n: int, extra: Callable[[int], None] = lambda tenth: None, steps: int = 10) -> None:
        """``extra`` is called in each step, for what else is in the log."""
        for tenth in range(steps):
            self._step(n + tenth / steps, tenth)
            extra(tenth)
            self.log.now_us += 1_000_000 // steps

    def _step(self, t_s: float, tenth: int) -> None:
        boot_ms = round(20_000 + 1000 * t_s)
        put = functools.partial(self.log.put, v1=self.v1)
        height_m = min(max(t_s - 5.0, 0.0), 12.0)
        angle = t_s / 5
        lat, lon = 437_806_000 + round(1000 * math.sin(angle)), -794_653_000 + round(1400 * math.cos(angle))
        if tenth == 0:
            put(mavlink.MAVLink_heartbeat_message(QUADROTOR, self.autopilot, *self._mode(t_s), 4, 3))
            put(mavlink.MAVLink_sys_status_message(1, 1, 1, 500, 12_600, 1200, 90 - round(t_s), 0, 0, 0, 0, 0, 0))
            put(mavlink.MAVLink_system_time_message(T0_US + boot_ms * 1000, boot_ms))
            put(mavlink.MAVLink_gps_raw_int_message(boot_ms * 1000, 3, lat, lon, 180_000, 80, 120, 30, 90, 12))
        if tenth == 5 and round(t_s) % 10 == 3:
            put(mavlink.MAVLink_statustext_message(4, b"battery low"))
            cells = [4200, 4180, 4190] + [65535] * 7
            put(mavlink.MAVLink_battery_status_message(0, 0, 0, 2500, cells, 1200, 300, -1, 80))
        if tenth % 2 == 0:
            place = lat, lon, 180_000 + round(1000 * height_m), round(1000 * height_m)
            put(mavlink.MAVLink_global_position_int_message(boot_ms, *place, 200, 100, 0, 9000))
            put(mavlink.MAVLink_attitude_message(boot_ms, 0.01, -0.02, angle % 3.0, 0.0, 0.0, 0.1))
        else:
            put(mavlink.MAVLink_vfr_hud_message(0.0, 3.0, 90, 40, 180.0 + height_m, 0.0))
            put(mavlink.MAVLink_local_position_ned_message(boot_ms, 1.0, 2.0, -height_m, 0.1, 0.2, 0.0))

    def _mode(self, t_s: float) -> tuple[int, int]:
        """base_mode and custom_mode: two modes, armed in between."""
        if self.autopilot == PX4:
            return (ARMED if t_s >= 4 else 0x01), (4 << 16 | 3 << 24 if t_s < 25 else 4 << 16 | 6 << 24)
        return (ARMED if t_s >= 4 else 0x01), (4 if t_s < 25 else 9)


def _ground_station(log: MadeLog, v1: bool = False) -> None:
    log.put(mavlink.MAVLink_heartbeat_message(GCS, INVALID, 0, 0, 4, 3), 255, 190, v1=v1)


def _flown(
    seconds: int,
    extra: Callable[[MadeLog, int], object] = lambda log, tenth: None,
    *,
    autopilot: int = ARDUPILOT,
    v1: bool = False,
    kind: str = TLOG,
) -> MadeLog:
    """The first seconds of a flight; ``extra`` is called in each tenth of each."""
    log = MadeLog(kind)
    flight = Flight(log, autopilot, v1=v1)
    for n in range(seconds):
        flight.second(n, functools.partial(extra, log))
    return log


def v1_and_v2_mixed() -> MadeLog:
    """A SiK radio, a v1 ground station, an ADS-B receiver under the vehicle's id, frames lost on the way."""
    log = MadeLog()
    flight = Flight(log)
    for n in range(30):

        def extra(tenth: int, n: int = n) -> None:
            if tenth == 1:
                _ground_station(log, v1=True)
                log.put(mavlink.MAVLink_radio_status_message(120, 110, 90, 30, 28, 0, 0), 51, 68, v1=True)
                log.put(mavlink.MAVLink_heartbeat_message(ADSB, INVALID, 0, 0, 4, 3), 1, 0)
            if tenth == 7 and n % 6 == 2:
                log.lose(count=3)

        flight.second(n, extra)
    return log


def mavlink_1_only() -> MadeLog:
    return _flown(30, lambda log, tenth: tenth == 3 and _ground_station(log, v1=True), v1=True)


def re_trimmed_with_the_senders_checksum() -> MadeLog:
    """QGroundControl's recording of components that do not trim."""
    distance = mavlink.MAVLink_distance_sensor_message(1000, 20, 4000, 300, 0, 1, 25, 0)

    def extra(log: MadeLog, tenth: int) -> None:
        log.put(distance, 1, 194, retrimmed=True)
        if tenth == 2:
            _ground_station(log)

    return _flown(30, extra, autopilot=PX4)


def unknown_ids() -> MadeLog:
    return _flown(20, lambda log, tenth: tenth in (2, 8) and log.put_unknown())


def cut_off_at_the_end() -> MadeLog:
    log = _flown(10)
    log.put_junk((log.now_us.to_bytes(8, "big") + b"cut")[:11])
    return log


def clocks_that_step() -> MadeLog:
    """Records 3 ms out of order, and another flight appended a year later."""
    log = MadeLog()
    flight = Flight(log)
    for n in range(20):
        flight.second(n)
        log.now_us -= 103_000
    log.now_us += 365 * 86_400_000_000
    for n in range(20, 30):
        flight.second(n)
    return log


def flood_of_heartbeats() -> MadeLog:
    """A program under an id of its own sends MAVLink 1 heartbeats, type GENERIC, autopilot INVALID, at 100 Hz."""
    flood = mavlink.MAVLink_heartbeat_message(GENERIC, INVALID, 0, 0, 3, 3)

    def extra(log: MadeLog, tenth: int) -> None:
        for _ in range(10):
            log.put(flood, 2, 2, v1=True)
        if tenth == 0:
            _ground_station(log)

    return _flown(15, extra)


def signed_by_the_ground_station() -> MadeLog:
    text = mavlink.MAVLink_statustext_message(6, b"Mission Planner 1.3.80")
    return _flown(10, lambda log, tenth: tenth == 4 and log.put(text, 255, 190, sign=True), autopilot=PX4)


def plane() -> MadeLog:
    return _beats_and_positions(FIXED_WING)


def submarine() -> MadeLog:
    return _beats_and_positions(SUBMARINE)


def _beats_and_positions(kind: int) -> MadeLog:
    log = MadeLog()
    for n in range(20):
        log.put(mavlink.MAVLink_heartbeat_message(kind, ARDUPILOT, ARMED, n // 10 * 10, 4, 3))
        log.put(mavlink.MAVLink_attitude_message(1000 * n, 0.0, 0.0, 0.1 * n, 0.0, 0.0, 0.0))
        place = 437_806_000 + 100 * n, -794_653_000, 180_000, 1000 * n
        log.put(mavlink.MAVLink_global_position_int_message(1000 * n, *place, 0, 0, 0, 0))
        log.now_us += 1_000_000
    return log


def indoors() -> MadeLog:
    """A PX4 without GNSS, which knows where it is from its own origin, and warns of much."""
    log = MadeLog()
    for n in range(60):
        log.put(mavlink.MAVLink_heartbeat_message(QUADROTOR, PX4, ARMED, 3 << 16, 4, 3))
        log.put(mavlink.MAVLink_local_position_ned_message(1000 * n, n / 10, 2.0, -1.5, 0.1, 0.0, 0.0))
        if n == 10:
            returns = struct.unpack("<f", struct.pack("<i", 2))[0]  # an integer as PX4 sends it
            log.put(mavlink.MAVLink_param_value_message(b"COM_OBL_RC_ACT", returns, 6, 900, 7))
        log.put(mavlink.MAVLink_attitude_message(1000 * n, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
        log.put(mavlink.MAVLink_statustext_message(4, f"warning number {n}".encode()))
        log.now_us += 1_000_000
    return log


def everything_a_vehicle_says() -> MadeLog:
    """Versions, parameters, missions, targets, a failsafe, answers to others, and a reboot in the middle."""
    log = MadeLog()
    version = (1 << 0 | 1 << 3 | 1 << 17, 0x04_05_07_FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1)
    place = 437_806_000, -794_653_000, 190.0
    for n in range(80):
        boot_ms = 1000 * (n + 100 if n < 40 else n - 38)
        state = 5 if 10 <= n < 20 else 4
        log.put(mavlink.MAVLink_heartbeat_message(QUADROTOR, ARDUPILOT, ARMED, 4 if n < 30 else 9, state, 3))
        heights = 180_000 + 100 * n, 100 * n
        log.put(mavlink.MAVLink_global_position_int_message(boot_ms, *place[:2], *heights, 0, 0, 0, 0))
        log.put(mavlink.MAVLink_system_time_message(T0_US, boot_ms))
        log.put(
            mavlink.MAVLink_highres_imu_message(n, 0, 0, -9.8, 0, 0, 0, 0.2, 0, 0.4, 990.0, 0.0, 188.0, 21.5, 0xFFFF)
        )
        log.put(mavlink.MAVLink_rc_channels_raw_message(boot_ms, 0, *[1500] * 8, 200))
        log.put(mavlink.MAVLink_position_target_global_int_message(boot_ms, 6, 0xDF8, *place, 0, 0, 0, 0, 0, 0, 0, 0))
        if n % 10 == 0:
            log.put(mavlink.MAVLink_autopilot_version_message(*version))
            log.put(mavlink.MAVLink_param_value_message(b"WPNAV_SPEED", 500.0 + n, 9, 1000, 7))
            log.put(mavlink.MAVLink_mission_item_reached_message(n // 10))
            log.put(mavlink.MAVLink_mission_current_message(n // 10))
            log.put(mavlink.MAVLink_mission_ack_message(255, 190, 0))
            log.put(mavlink.MAVLink_mission_count_message(255, 190, 3))
            log.put(mavlink.MAVLink_timesync_message(boot_ms * 1_000_000, 17))
            log.put(mavlink.MAVLink_file_transfer_protocol_message(0, 255, 190, [0] * 251))
            log.put(mavlink.MAVLink_extended_sys_state_message(0, 2 if n % 20 else 1))
        if n == 5:
            log.put(mavlink.MAVLink_vfr_hud_message(0.0, 3.0, 90, 40, 180.0, 0.0))
            log.put(mavlink.MAVLink_param_value_message(b"SYSID_MYGCS", 255.0, 4, 1000, 8))
            log.put(mavlink.MAVLink_param_value_message(b"no name!", 1.0, 77, 1000, 9))
        if n == 12:
            log.put(mavlink.MAVLink_statustext_message(3, b"GCS Failsafe"))
        if n == 40:
            log.put(mavlink.MAVLink_statustext_message(6, b"ArduPilot Ready"))
            log.put(mavlink.MAVLink_statustext_message(6, b"ArduCopter V4.5.7 (0123abcd)"))
        log.now_us += 1_000_000
    return log


def serial_line_with_losses() -> MadeLog:
    """Bytes as they came from a serial line: noise between frames, and frames that lost their first bytes."""
    rng = random.Random(5)

    def extra(log: MadeLog, tenth: int) -> None:
        if tenth == 4:
            log.put_junk(rng.randbytes(rng.randrange(1, 60)))
        if tenth == 8:
            log.lose()
            log.put(mavlink.MAVLink_radio_status_message(120, 110, 90, 30, 28, 0, 0), 51, 68, v1=True)

    return _flown(40, extra, kind=RAW)


def serial_line_without_noise() -> MadeLog:
    return _flown(20, autopilot=PX4, kind=RAW)


MADE: dict[str, Callable[[], MadeLog]] = {
    "made-v1-v2-mixed.tlog": v1_and_v2_mixed,
    "made-v1.tlog": mavlink_1_only,
    "made-retrimmed.tlog": re_trimmed_with_the_senders_checksum,
    "made-unknown-ids.tlog": unknown_ids,
    "made-cut-off.tlog": cut_off_at_the_end,
    "made-clock-steps.tlog": clocks_that_step,
    "made-flood.tlog": flood_of_heartbeats,
    "made-signed.tlog": signed_by_the_ground_station,
    "made-plane.tlog": plane,
    "made-submarine.tlog": submarine,
    "made-indoors.tlog": indoors,
    "made-everything.tlog": everything_a_vehicle_says,
    "made-serial-losses.raw": serial_line_with_losses,
    "made-serial.raw": serial_line_without_noise,
}


@functools.cache
def made(name: str) -> tuple[bytes, dict[str, Any]]:
    """(content, what is expected of it)."""
    return MADE[name]().done()
