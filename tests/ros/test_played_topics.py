"""Vehicles that send every MAVLink message of the tables: every topic of three vehicles is read by Fast DDS, and
rosbags reads the same in the bytes of each message."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Iterator
from typing import Any

import pytest

from ros.bridge_graph import graph_of
from ros.every_topic import EveryTopicNode
from ros.played_vehicle import PX4, VEHICLES, PlayedFleet
from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import encode
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.px4_telemetry import PX4_SOURCES, PX4_TELEMETRY
from skygcs.core.ros.topics import SOURCES, TELEMETRY
from skygcs.ext.ros.config import RosConfig
from support.needed import needs
from support.process import wait_until
from support.pymav import UdpPeer
from support.pymav_filled import filled
from support.system_programs import FAST_DDS

REPLACING = ("SCALED_IMU", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED_COV", "HIGHRES_IMU")
"""They take the place of others, so they are sent last."""

OWN_THREAD = ("HEARTBEAT", "EXTENDED_SYS_STATE", "GLOBAL_POSITION_INT")
NOT_OF_PYMAVLINK = ("EVENT", "RADIO_STATUS")
"""The radio's comes of another system."""

HALF = (0.5, -0.5, 0.5, 0.5)
FIELDS: dict[str, Any] = {
    **{"type": 1, "chancount": 8, "port": 0, "fix_type": 3, "fields_updated": 0xFFFF, "q": HALF},
    **dict(zip(("q1", "q2", "q3", "q4"), HALF, strict=True)),
}
EVENT = {"id": 0x01AB_CDEF, "event_time_boot_ms": 61_000, "sequence": 7, "log_levels": 0x34, "arguments": [5] * 40}


class Played(PlayedFleet):
    """Vehicles that send every message, some times."""

    def play(self) -> None:
        radio = UdpPeer(51, 68, self.port)
        info = load_dialect(("ardupilotmega", "px4-extras")).find("EVENT")
        plain = [
            name for name in {**SOURCES, **PX4_SOURCES} if name not in (*REPLACING, *OWN_THREAD, *NOT_OF_PYMAVLINK)
        ]
        for _ in range(4):
            for vehicle in self.wire.values():
                for name in (*plain, *REPLACING):
                    vehicle.play(name, time_unix_usec=time.time_ns() // 1000, **FIELDS)
                    time.sleep(0.002)
                vehicle.send(encode(info, EVENT, sysid=vehicle.mav.srcSystem, compid=1, seq=0))
            radio.send(radio.pack(filled("RADIO_STATUS", random.Random(1))))
            time.sleep(0.5)
        radio.close()


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Played, EveryTopicNode]]:
    needs("test-ros", *FAST_DDS)
    fleet = Played(tmp_path_factory.mktemp("played"), "none")
    vehicles = {name: (n, "px4" if kind == PX4 else "ardupilot") for n, (name, kind) in enumerate(VEHICLES.items(), 1)}
    graph = asyncio.run(graph_of(RosConfig(px4_msgs="1.16"), vehicles))
    assert not graph.services and not graph.inputs
    try:
        with EveryTopicNode(tmp_path_factory.mktemp("node"), fleet.domain, ros2_interfaces("1.16"), graph) as node:
            node.wait_for_the_bridge(fleet)
            fleet.play()
            yield fleet, node
    finally:
        fleet.close()


def test_nothing_is_silent(played: tuple[Played, EveryTopicNode]) -> None:
    """Every topic of MAVROS' names and of PX4's, for each vehicle."""
    _, node = played
    wanted = {f"/{name}/mavros/{topic}" for name in VEHICLES for topic in TELEMETRY}
    px4 = {name for name in node.graph.topics if "/fmu/out/" in name}
    assert len(px4) == 2 * len(PX4_TELEMETRY)

    def came() -> bool:
        found = node.dump()
        silent = {name for name in wanted | px4 if not found[name]}
        print(sorted(silent))
        return not silent

    wait_until(came, "every topic has come")
    for name, messages in node.dump().items():
        for message in messages:
            node.checked(node.graph.topics[name][0], message)
