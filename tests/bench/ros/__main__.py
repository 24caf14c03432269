"""`make bench-ros`: ten vehicles at 50 Hz as topics of ROS 2, and the rates behind a radio.

A process of its own sends LOCAL_POSITION_NED and ATTITUDE of ten vehicles by UDP, 50 times a second each, and notes
when. A reader of DDS in this process reads their poses and IMUs. The number of a message is its north, so the age of
each pose is its own: from the send call to the callback of the reader, through daemon, socket, process of ROS and DDS.
Another, simulated vehicle is flown by skygcs' setpoints all the while: its control's ticks show what the daemon feels.

Without readers and with them in turns within one run. Behind the emulated radio the reader counts what comes.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import random
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.sharedctypes import SynchronizedArray
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from bench.results import cpu_s
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.ext.ros.dds import DdsNode, Network
from support.process import DaemonProcess, wait_until

VEHICLES = 10
RATE_HZ = 50
SECONDS = 20
TURNS = 3
"""Of each: without and with readers, in turns."""

MOST_AGE_P99_MS = 20.0
MOST_TICKS_RATIO = 1.1

FIELD = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0
[links.senders]
type = "udp_server"
host = "127.0.0.1"
port = {port}
[links.flown]
type = "simulated"
px4 = 1
first_sysid = 100
[ros]
domain = {domain}
[ros.rates]
LOCAL_POSITION_NED = 50
ATTITUDE = 50
"""

RADIO = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0
[links.radio]
type = "simulated"
role = "radio"
px4 = 5
ardupilot = 5
radio = {{ air_kbps = 64 }}
air_speed_kbps = 64
nodes = 11
[ros]
domain = {domain}
"""


TOPICS = {"LOCAL_POSITION_NED": "local_position/pose", "ATTITUDE": "imu/data"}
"""The message of each topic that is read. On this radio there is no room for the first one."""


def send(port: int, times: SynchronizedArray[float], stop: Any) -> None:
    """Send both messages of all vehicles, RATE_HZ times a second, until ``stop`` is set."""
    links = []
    for sysid in range(1, VEHICLES + 1):
        out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        out.connect(("127.0.0.1", port))
        links.append((out, mav.MAVLink(None, srcSystem=sysid, srcComponent=1)))
    begun, number = time.monotonic(), 0
    while not stop.is_set():
        for i, (out, link) in enumerate(links):
            boot_ms = int((time.monotonic() - begun) * 1000) + 1000
            if number % RATE_HZ == 0:
                out.send(link.heartbeat_encode(2, 12, 81, 0x03040000, 4, 3).pack(link))
            out.send(link.attitude_encode(boot_ms, 0, 0, 0, 0, 0, 0).pack(link))
            times[number % len(times) // VEHICLES * VEHICLES + i] = time.monotonic()
            out.send(link.local_position_ned_encode(boot_ms, float(number), 0, -10, 0, 0, 0).pack(link))
        number += 1
        time.sleep(max(begun + number / RATE_HZ - time.monotonic(), 0))


class Reader:
    """Reads poses and IMUs of vehicles; ``ages_s`` of poses, and how many of each came."""

    def __init__(self, node: DdsNode, names: list[str], times: SynchronizedArray[float] | None) -> None:
        self.node = node
        self.read: list[Any] = []
        self.ages_s: list[float] = []
        self.counts: dict[str, int] = {}
        self.times = times
        for i, name in enumerate(names):
            self._read(f"/{name}/mavros/local_position/pose", "geometry_msgs/msg/PoseStamped", i)
            self._read(f"/{name}/mavros/imu/data", "sensor_msgs/msg/Imu", i)

    def _read(self, topic: str, type_: str, index: int) -> None:
        self.counts[topic] = 0

        def take(message: dict[str, Any]) -> None:
            self.counts[topic] += 1
            if self.times is not None and type_.endswith("PoseStamped"):
                number = round(message["pose"]["position"]["y"])  # north
                sent = self.times[number % len(self.times) // VEHICLES * VEHICLES + index]
                self.ages_s.append(time.monotonic() - sent)

        self.read.append(self.node.subscribe(topic, type_, "sensor", take))

    def close(self) -> None:
        for subscriber in self.read:
            subscriber.close()


def opened(domain: int) -> DdsNode:
    """A node; a process has one domain of a number."""
    return DdsNode(Network(domain, True, ()), ros2_interfaces("1.16"), asyncio.get_running_loop())


@contextmanager
def senders(port: int) -> Iterator[SynchronizedArray[float]]:
    """The process that sends, and when it sent what."""
    times = multiprocessing.Array("d", VEHICLES * 10_000, lock=False)
    stop = multiprocessing.Event()
    process = multiprocessing.Process(target=send, args=(port, times, stop))
    process.start()
    try:
        yield times
    finally:
        stop.set()
        process.join()


async def span(daemon: DaemonProcess, reader: Reader | None) -> dict[str, float]:
    """SECONDS with or without a reader: processor time of both processes, ages, messages, and the control's ticks."""
    assert daemon.process is not None
    pids = {"daemon": daemon.process.pid, "ros": daemon.call("ros.status")["pid"]}
    await asyncio.sleep(2.0)
    if reader is not None:
        reader.ages_s.clear()
        reader.counts = dict.fromkeys(reader.counts, 0)
    before = {name: cpu_s(pid) for name, pid in pids.items()}
    begun = time.monotonic()
    await asyncio.sleep(SECONDS)
    took_s = time.monotonic() - begun
    found = {f"{name}_cpu": (cpu_s(pid) - before[name]) / took_s for name, pid in pids.items()}
    status = await asyncio.to_thread(daemon.call, "control.status", targets="flown")
    found["tick_lateness_p99_ms"] = status[0]["lateness_p99_s"] * 1000
    if reader is not None:
        ages_ms = np.array(reader.ages_s) * 1000
        found |= {"age_p50_ms": float(np.median(ages_ms)), "age_p99_ms": float(np.percentile(ages_ms, 99))}
        found["messages_per_s"] = sum(reader.counts.values()) / took_s
    return found


def fly(daemon: DaemonProcess) -> None:
    """The simulated vehicle is in the air, under control by position."""
    order = {"targets": "flown", "height_m": 10.0, "arm": True}
    wait_until(lambda: daemon.call("vehicles.takeoff", **order)["outcomes"]["flown"]["ok"], "it takes off")
    wait_until(lambda: (daemon.vehicles()["flown"]["position"] or {}).get("alt_rel_m", 0) > 9, "it is up")
    outcome = daemon.call("control.set", targets="flown", mode="position")["outcomes"]["flown"]
    assert outcome["ok"], outcome


async def at_50_hz(folder: Path) -> dict[str, dict[str, float]]:
    """Medians over the turns, without readers and with them."""
    domain = random.SystemRandom().randrange(50, 200)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    names = [f"v{sysid}" for sysid in range(1, VEHICLES + 1)]
    toml = FIELD.format(port=port, domain=domain) + "[vehicles.flown]\nsysid = 100\n"
    spans: dict[str, list[dict[str, float]]] = {"without": [], "with": []}
    with DaemonProcess(folder, toml) as daemon, senders(port) as times:
        wait_until(lambda: len(daemon.vehicles()) == VEHICLES + 1, "all are known")
        wait_until(lambda: daemon.call("ros.status")["report"] is not None, "the process of ROS is up")
        await asyncio.to_thread(fly, daemon)
        node = opened(domain)
        for _ in range(TURNS):
            spans["without"].append(await span(daemon, None))
            reader = Reader(node, names, times)
            spans["with"].append(await span(daemon, reader))
            reader.close()
    return {
        which: {key: float(np.median([one[key] for one in found])) for key in found[0]}
        for which, found in spans.items()
    }


async def behind_a_radio(folder: Path) -> list[tuple[str, float, float]]:
    """For each topic that is read: its name, the rate at which the air plan has its message, and the rate that came."""
    domain = random.SystemRandom().randrange(50, 200)
    with DaemonProcess(folder, RADIO.format(domain=domain), name="radio") as daemon:
        wait_until(lambda: len(daemon.vehicles()) == VEHICLES, "all are known")
        names = list(daemon.vehicles())
        reader = Reader(opened(domain), names, None)
        await asyncio.sleep(60.0)  # requests go one after another, and rates settle
        reader.counts = dict.fromkeys(reader.counts, 0)
        await asyncio.sleep(SECONDS)
        (radio,) = await asyncio.to_thread(daemon.call, "link.status")
        planned = {one["name"]: one["streams"] for one in radio["vehicles"]}
        reader.close()
    found = []
    for name in names:
        for message, topic in TOPICS.items():
            path = f"/{name}/mavros/{topic}"
            planned_hz = planned[name].get(message, {"planned_hz": 0.0})["planned_hz"]
            found.append((path, planned_hz, reader.counts[path] / SECONDS))
    return found


def main() -> int:
    argparse.ArgumentParser(description="Ten vehicles as topics of ROS 2.").parse_args()
    with tempfile.TemporaryDirectory() as folder:
        spans = asyncio.run(at_50_hz(Path(folder)))
        print(json.dumps(spans, indent=1))
        rates = asyncio.run(behind_a_radio(Path(folder)))
    for name, planned_hz, read_hz in rates:
        print(f"{name}: {planned_hz:.2f} Hz planned, {read_hz:.2f} Hz read")
    age_ms = spans["with"]["age_p99_ms"]
    ratio = spans["with"]["tick_lateness_p99_ms"] / spans["without"]["tick_lateness_p99_ms"]
    of_that = f"of that without readers ({MOST_TICKS_RATIO})"
    checks = [
        (f"age p99 {age_ms:.1f} ms ({MOST_AGE_P99_MS:.0f})", age_ms <= MOST_AGE_P99_MS),
        (f"control's ticks: lateness p99 {ratio:.2f} {of_that}", ratio <= MOST_TICKS_RATIO),
        ("behind the radio something is planned", any(planned > 0.0 for _, planned, _ in rates)),
        ("and comes as planned", all(0.7 * planned <= read <= 1.25 * planned for _, planned, read in rates)),
    ]
    for text, ok in checks:
        print(f"{'ok  ' if ok else 'MISS'} {text}")
    return 0 if all(ok for _, ok in checks) else 1


if __name__ == "__main__":
    raise SystemExit(main())
