"""Nodes of ROS fly a real autopilot: MAVROS' offboard node on Fast DDS and on rospy, and PX4's by its own topics."""

from __future__ import annotations

import math
import random
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ros.fast_dds import built
from ros.rosmaster import Master
from support.firmware_field import Field
from support.needed import needs
from support.system_programs import FAST_DDS, ROS1

NODE_S = 300
"""A flight takes half a minute."""

RATES = "[ros.rates]\nLOCAL_POSITION_NED = 10\nATTITUDE = 10\n"


@pytest.fixture(scope="module")
def program() -> Path:
    needs("test-ros", *FAST_DDS)
    return built("offboard_node")


@pytest.fixture
def domain(ground: Field) -> Iterator[int]:
    """A daemon with [ros] in a domain of its own."""
    number = random.SystemRandom().randrange(50, 200)
    releases = 'px4_msgs = "1.16"\n' if ground.px4 else ""
    with_table(ground, f"domain = {number}\n{releases}")
    yield number
    ground.restart_daemon(ground.toml())


def with_table(field: Field, keys: str) -> None:
    field.restart_daemon(f'{field.toml()}\n[ros]\ncommands = "all"\n{keys}{RATES}')
    field.wait(lambda: field.daemon.call("ros.status")["report"], 60, "the process of ROS has reported")
    field.wait(
        lambda: {v["name"] for v in field.daemon.call("ros.status")["report"]["vehicles"]} == set(field.names),
        60,
        "it has all vehicles",
    )


def land_mode(field: Field) -> str:
    return "AUTO.LAND" if field.px4 else "LAND"


def landed(field: Field, figures: dict[str, Any], begun: tuple[float, float, float] | None = None) -> None:
    """The square ends at ``begun``, where rospy's node begins, or else at the origin of the vehicle's local frame."""
    field.wait(lambda: not field.state(field.one)["armed"], 90, "it is disarmed")
    if begun is None:
        local = field.daemon.call("messages.latest", target=field.one, name="LOCAL_POSITION_NED")["fields"]
        off_m = math.hypot(local["x"], local["y"])
    else:
        off_m = math.dist(field.enu(field.one)[:2], begun[:2])
    figures["landed m from the end of its square"] = off_m
    assert off_m < 3


def test_mavros_offboard_node_on_fast_dds(ground: Field, program: Path, domain: int, figures: dict[str, Any]) -> None:
    line = [str(program), str(domain), "fly", f"/{ground.one}/mavros", land_mode(ground)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=NODE_S, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert done.stdout.count("mode OFFBOARD") == 5
    landed(ground, figures)


@pytest.mark.only("px4")
def test_px4s_own_node_by_its_own_topics(ground: Field, program: Path, domain: int, figures: dict[str, Any]) -> None:
    line = [str(program), str(domain), "px4", f"/{ground.one}"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=NODE_S, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert done.stdout.count("nav_state 14") == 4
    assert {"ack 176 0", "ack 400 0", "ack 21 0"} <= set(done.stdout.splitlines())
    landed(ground, figures)


def test_a_node_that_is_killed_leaves_the_vehicle_hovering(
    ground: Field, program: Path, domain: int, figures: dict[str, Any]
) -> None:
    line = [str(program), str(domain), "fly", f"/{ground.one}/mavros", land_mode(ground)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as node:
        assert node.stdout is not None
        for text in node.stdout:
            if text.startswith("corner 0 4"):
                break
        node.kill()
    figures["still after s"] = ground.wait(lambda: ground.steady(ground.one), 60, "it stays where it is")
    state = ground.state(ground.one)
    assert state["armed"] and state["position"]["alt_rel_m"] > 2
    ground.land()


def test_mavros_offboard_node_on_rospy(ground: Field, tmp_path: Path, figures: dict[str, Any]) -> None:
    needs("test-ros", *ROS1)
    begun = ground.enu(ground.one)
    master = Master(tmp_path)
    master.start()
    try:
        with_table(ground, f'version = 1\nmaster = "{master.uri}"\n')
        done = master.node("fly", f"/{ground.one}/mavros", land_mode(ground))
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        landed(ground, figures, begun)
    finally:
        master.stop()
        ground.restart_daemon(ground.toml())
