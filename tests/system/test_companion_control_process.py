"""Control at the companion with both daemons as processes: orders over TLS, the companion killed."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.pinned import NAME, make_pair
from support.process import DaemonProcess, free_port, wait_until

pytestmark = pytest.mark.system

VEHICLE = f"[vehicles.{NAME}]\nsysid = 1\n"
ORIGIN = "[origin]\nlat_deg = 43.7806\nlon_deg = -79.4653\nalt_amsl_m = 180.0\n"


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[DaemonProcess, DaemonProcess]]:
    """The ground and the companion, on which a simulated ArduCopter is."""
    mavlink, rpc = free_port(), free_port(socket.SOCK_STREAM)
    make_pair(tmp_path / "ground", tmp_path / "companion")
    ground = DaemonProcess(
        tmp_path,
        f'[companions]\nkey_dir = "ground"\n[companions.{NAME}]\nrpc = "127.0.0.1:{rpc}"\n{ORIGIN}{VEHICLE}'
        'control = { at = "companion" }\n'
        f'[links.wifi]\ntype = "udp_server"\nhost = "127.0.0.1"\nport = {mavlink}\nrole = "vehicle"\n',
        name="ground",
    )
    companion = DaemonProcess(
        tmp_path,
        f'[companion]\nvehicle = "{NAME}"\nkey_dir = "companion"\nrpc_listen = "127.0.0.1:{rpc}"\n'
        f'ground = "udp:127.0.0.1:{mavlink}"\n{VEHICLE}'
        '[links.autopilot]\ntype = "simulated"\nardupilot = 1\nrole = "vehicle"\ndynamics = "kinematic"\n',
        name="companion",
    )
    try:
        ground.start()
        companion.start()
        yield ground, companion
    finally:
        companion.stop()
        ground.stop()


def test_the_ground_flies_it_through_its_companion(pair: tuple[DaemonProcess, DaemonProcess]) -> None:
    ground, companion = pair

    def state() -> dict[str, Any]:
        found: list[dict[str, Any]] = ground.call("vehicles.list", targets="all")
        return next((one for one in found if one["name"] == NAME and one["connected"]), {})

    def control() -> dict[str, Any]:
        return dict(state().get("control") or {})

    wait_until(lambda: control().get("companion", {}).get("up"), "the ground has contact and the clock")
    taken_off = ground.call("vehicles.takeoff", targets=NAME, height_m=5.0, wait_s=120)["outcomes"][NAME]
    assert taken_off["ok"], taken_off
    wait_until(lambda: (state().get("position") or {}).get("alt_rel_m", 0.0) > 4.5, "it is up")
    engaged = ground.call("control.set", targets=NAME, mode="position")["outcomes"][NAME]
    assert engaged["ok"], engaged
    assert control()["state"] == "flying" and control()["companion"]["origins_agree"]
    gone = ground.call("vehicles.goto", targets=NAME, enu_m=[4.0, 0.0, 5.0])["outcomes"][NAME]
    assert gone["ok"], gone
    wait_until(lambda: abs((state()["position"]["enu_m"] or [0.0])[0] - 4.0) < 0.5, "it goes there")
    held = ground.call("vehicles.hold", targets=NAME)["outcomes"][NAME]
    assert held["ok"], held
    wait_until(lambda: companion.call("control.status", targets="all")[0]["state"] == "off", "the release came")
    wait_until(lambda: control()["state"] == "off", "the ground has the companion's next report")

    companion.kill()
    wait_until(lambda: ground.call("companions.status")["companions"][0]["state"] == "down", "the ground notices")
    (status,) = ground.call("control.status", targets="all")
    assert not status["companion"]["up"]
    refused = ground.call("control.set", targets=NAME, mode="position")["outcomes"][NAME]
    assert refused["result"] == "refused" and "not connected" in refused["message"]
    assert ground.call("daemon.info")["faults"] == 0
