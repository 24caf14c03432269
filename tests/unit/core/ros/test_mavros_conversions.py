"""Every topic, field by field, against MAVROS' conversions of the same bytes (`mavros_oracle`), which pymavlink
decodes: recorded flights, and messages that pymavlink packed of those that no recording has."""

from __future__ import annotations

import functools
import itertools
import random
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import Frame, check
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.memory import VehicleMemory
from skygcs.core.ros.topics import SOURCES, TELEMETRY, samples
from skygcs.tlog.files import opened_log
from support.pymav_filled import filled
from support.table import each
from unit.core.ros.mavros_oracle import Mavros, like

DATA = Path(__file__).parents[3] / "data"
DIALECT = load_dialect(("ardupilotmega", "px4-extras"))

LOGS = (
    *("px4-mission-flight", "px4-battery-low", "px4-plan-transfer", "copter-radio-flight", "sitl-3ardupilot-2px4"),
    "second-heartbeat-1hz",
)
"""Together they have all messages but those of `PACKED`."""

PACKED = ("HIGHRES_IMU", "SCALED_IMU", "LOCAL_POSITION_NED_COV", "RC_CHANNELS_RAW")

DRIFT, STEP_US = 2e-4, 1_000_000
"""Stamps: a vehicle's clock may drift by so much, and is begun anew after a step of so much (`core.ros.stamps`)."""

MOST_FRAMES, MOST_OF_ONE = 600, 8
"""Frames of one recording that are looked at, and how many of each message of a vehicle are compared."""

DRIFT_US = 200
"""The drift of a second: a recorder may write two links' frames in another order than they came in."""

NOW_US = 1_700_000_000_000_000

EVENT = struct.Struct("<IIHBBB40s")


class Heard(NamedTuple):
    """One frame, as it came."""

    sysid: int
    unix_us: int
    raw: bytes


def recorded(name: str) -> Iterator[Heard]:
    with opened_log(DATA / f"{name}.tlog", DIALECT) as log:
        for entry in log.entries():
            frame = entry.frame
            if frame is not None and frame.info is not None and frame.name in SOURCES:
                own = (frame.compid == 1 and frame.sysid <= 250) or frame.name == "RADIO_STATUS"
                if own:
                    yield Heard(frame.sysid, entry.unix_us, bytes(frame.raw))


def packed(seed: int, names: tuple[str, ...] = PACKED) -> Iterator[Heard]:
    """A vehicle of these messages, and of an attitude, at random."""
    chance = random.Random(seed)
    line = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    arrival_us = NOW_US
    for n in range(15):
        for name in chance.sample(["ATTITUDE", *names], len(names) + 1):
            boot_ms = 5000 + 100 * n
            arrival_us = max(arrival_us, NOW_US + 1000 * boot_ms + chance.randint(0, 400_000))
            stamps = {"time_boot_ms": boot_ms, "time_usec": 1000 * boot_ms}
            ports = {"port": chance.randint(0, 1), "fields_updated": chance.getrandbits(16)}
            raw = filled(name, chance, **stamps, **ports).pack(line)
            yield Heard(1, arrival_us, bytes(raw))


def by_pymavlink(raw: bytes, name: str) -> Any:
    """The message as pymavlink decodes it; EVENT, which it has not, by its layout."""
    if name != "EVENT":
        return mav.MAVLink(None).decode(bytearray(raw))
    payload = raw[10 : 10 + raw[1]].ljust(EVENT.size, b"\0")
    number, boot_ms, sequence, _, _, levels, arguments = EVENT.unpack(payload[: EVENT.size])
    return SimpleNamespace(
        get_type=lambda: "EVENT",
        id=number,
        event_time_boot_ms=boot_ms,
        sequence=sequence,
        log_levels=levels,
        arguments=arguments,
    )


def frame_of(raw: bytes) -> Frame:
    frame, verdict = check(raw, DIALECT.messages)
    assert frame is not None, verdict
    return frame


class Clock:
    """Stamps by their definition: the message's time plus the smallest delay so far, which may have grown by DRIFT."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, float]] = []
        self.last_boot_us = 0

    def stamp_us(self, boot_us: int, arrival_us: int) -> float:
        if boot_us > 10**15:
            return min(boot_us, arrival_us)
        delay, least = arrival_us - boot_us, self.least(arrival_us)
        if least is None or abs(delay - least) > STEP_US or self.last_boot_us - boot_us > STEP_US:
            self.seen = []
        now = arrival_us
        self.seen = [(at, one) for at, one in self.seen if one + DRIFT * max(now - at, 0) < delay]  # others never count
        self.seen.append((arrival_us, delay))
        self.last_boot_us = boot_us
        return min(boot_us + float(self.least(arrival_us) or 0), arrival_us)

    def least(self, arrival_us: int) -> float | None:
        return min((delay + DRIFT * max(arrival_us - at, 0) for at, delay in self.seen), default=None)


def compared(heard: Iterator[Heard]) -> Counter[str]:
    """Compare everything that is published; by topic, how many messages were."""
    known = ros2_interfaces()
    memories: dict[int, VehicleMemory] = {}
    oracles: dict[int, tuple[Mavros, Clock]] = {}
    found: Counter[str] = Counter()
    for sysid, unix_us, raw in heard:
        frame = frame_of(raw)
        mavros, clock = oracles.setdefault(sysid, (Mavros(), Clock()))
        memory = memories.setdefault(sysid, VehicleMemory())
        expected = mavros.of(by_pymavlink(raw, frame.name))
        out = dict(samples(frame.name, dict(frame.fields()), 1000 * unix_us, memory))
        assert out.keys() == expected.keys(), frame.name
        stamps: dict[int, float] = {}
        for topic, message in out.items():
            type_ = TELEMETRY[topic].type
            decoded, wanted = known.decode(type_, known.encode(type_, message)), dict(expected[topic])
            boot_us, frame_id = wanted.pop("t", None), wanted.pop("@", "")
            if "header" in decoded:
                head = decoded.pop("header")
                assert head["frame_id"] == frame_id, topic
                if boot_us is not None and boot_us not in stamps:
                    stamps[boot_us] = clock.stamp_us(boot_us, unix_us)
                stamp_us = unix_us if boot_us is None else stamps[boot_us]
                assert head["stamp"]["sec"] * 1e6 + head["stamp"]["nanosec"] / 1e3 == pytest.approx(
                    stamp_us, abs=DRIFT_US
                ), topic
            like(decoded, wanted, topic)
            found[topic] += 1
    return found


@functools.cache
def of_log(log: str) -> tuple[Counter[str], frozenset[str]]:
    """Topics that were compared, and the messages that they were made of."""
    heard, counts = [], Counter[tuple[int, str]]()
    for one in itertools.islice(recorded(log), MOST_FRAMES):
        of_one = (one.sysid, frame_of(one.raw).name)
        counts[of_one] += 1
        if counts[of_one] <= MOST_OF_ONE:
            heard.append(one)
    return compared(iter(heard)), frozenset(name for _, name in counts)


@functools.cache
def of_packed(names: tuple[str, ...]) -> Counter[str]:
    return compared(packed(1, names))


@each("log", LOGS)
def test_recorded_messages_are_converted_as_mavros_does(log: str) -> None:
    assert of_log(log)[0].total() > 60


@each("names", [PACKED, *((name,) for name in PACKED)])
def test_packed_messages_are_converted_as_mavros_does(names: tuple[str, ...]) -> None:
    """All of them at random, and each alone: some take the place of others."""
    assert of_packed(names).total() > 20


def test_no_topic_is_left_out() -> None:
    """The recordings and the packed messages have every message of the table, and every topic."""
    sources = frozenset(PACKED).union(*(of_log(log)[1] for log in LOGS))
    assert sources == SOURCES.keys()
    found = sum((of_log(log)[0] for log in LOGS), Counter[str]()) + sum(
        (of_packed((name,)) for name in PACKED), Counter[str]()
    )
    assert found.keys() == TELEMETRY.keys(), TELEMETRY.keys() ^ found.keys()
