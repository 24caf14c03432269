"""The fleet behind emulated multipoint radios: 64 kbit/s on the air, 57600 baud at the port, 2 % lost."""

from __future__ import annotations

import re
import time
from typing import Any

import pytest

from support.firmware_air import EmulatedAir
from support.firmware_field import HEIGHT_M, Field

AIR_KBPS = 64.0
BAUD = 57600
LOSS = 0.02


def radio_toml(field: Field, device: str) -> str:
    link = f'[links.vehicles]\ntype = "serial"\ndevice = "{device}"\nbaud = {BAUD}\nrole = "radio"\n'
    link += f'air_speed_kbps = {AIR_KBPS:g}\nnodes = 3\nstream_profile = "nav"\n\n'
    return re.sub(r"\[links\.vehicles\]\n.*?(?=\[links\.gcs\])", link, field.toml(), flags=re.DOTALL)


@pytest.mark.minutes
def test_the_fleet_flies_behind_the_radio(ground: Field, figures: dict[str, Any]) -> None:
    air = EmulatedAir(ground.sysids, air_kbps=AIR_KBPS, baud=BAUD, loss=LOSS)
    ground.relay.air = air
    try:
        ground.restart_daemon(radio_toml(ground, air.device))
        time.sleep(20)  # until streams are planned and measured
        began = time.monotonic()
        figures["takeoff s"] = ground.takeoff()
        ground.order("vehicles.goto", "all", enu_m=[5, 10, HEIGHT_M])
        figures["goto s"] = ground.wait(
            lambda: all(abs(ground.enu(n)[1] - 10) < 2 for n in ground.names), 60, "both are there"
        )
        time.sleep(10)
        for name in ground.names:
            ages = sorted(
                s["position"]["age_s"]
                for at, s in ground.watcher.states
                if at > began and s["name"] == name and s["position"]
            )
            rate = ground.daemon.call("messages.latest", target=name, name="GLOBAL_POSITION_INT")["rate_hz"]
            loss = [link["loss_ratio"] for link in ground.state(name)["links"].values()]
            figures[name] = {"position Hz": rate, "age p95 s": ages[int(0.95 * len(ages))], "lost": loss[0]}
            assert figures[name]["age p95 s"] < 3
        outcomes = ground.order("vehicles.stop", "all")
        figures["stop s"] = max(o["elapsed_s"] for o in outcomes.values())
        figures["land s"] = ground.land()
        figures["not sent by autopilots"] = air.not_sent
    finally:
        ground.relay.air = None
        ground.restart_daemon(ground.toml())
        air.close()
