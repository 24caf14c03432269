"""Signing on a firmware that can (ArduPilot 4.6; PX4 1.16 cannot)."""

from __future__ import annotations

import time
from typing import Any

import pytest

from support.firmware_field import Field

pytestmark = [pytest.mark.only("ardupilot"), pytest.mark.minutes]


def test_signed_flight_and_nobody_else(ground: Field, figures: dict[str, Any]) -> None:
    key = ground.folder / "lab.key"
    key.unlink(missing_ok=True)
    made = ground.daemon.cli("signing", "key", str(key))
    assert made.returncode == 0, made.stderr
    setup = ground.daemon.cli("signing", "setup", "all", "--key", str(key), "--force")
    assert setup.returncode == 0, setup.stdout + setup.stderr
    try:
        ground.restart_daemon(ground.toml(link=f'[links.vehicles.signing]\nkey_file = "{key}"\n'))
        status = ground.daemon.call("signing.status")
        figures["status"] = str(status)[:200]
        figures["takeoff s"] = ground.takeoff(ground.one)
        with ground.peer(255, 190) as stranger, ground.peer(ground.sysids[0]) as forger:
            for _ in range(5):
                stranger.mav.command_long_send(ground.sysids[0], 1, 176, 0, 1, 9, 0, 0, 0, 0, 0)  # LAND
                forger.mav.heartbeat_send(2, 3, 81, 0, 3)
                time.sleep(0.3)
            assert ground.state(ground.one)["armed"]
            assert ground.truth(ground.one).mode == "GUIDED"
        figures["land s"] = ground.land()
    finally:
        ground.relay.clear()
        off = ground.daemon.cli("signing", "off", "all")
        figures["off"] = off.stdout.strip().splitlines()[:2]
        ground.restart_daemon(ground.toml())
    assert off.returncode == 0, off.stdout + off.stderr
