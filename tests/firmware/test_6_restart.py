"""Reboots of vehicles, and of the daemon."""

from __future__ import annotations

import time
from typing import Any

import pytest

from support.firmware_field import Field


def test_the_daemon_is_killed_and_knows_all_again(air: Field, figures: dict[str, Any]) -> None:
    air.daemon.kill()
    time.sleep(2)
    began = time.monotonic()
    air.daemon.start()
    air.wait(
        lambda: air.daemon.known() == 2 and all(s["armed"] for s in air.daemon.vehicles().values()), 30, "both, armed"
    )
    figures["known after s"] = time.monotonic() - began
    air.order("vehicles.goto", "all", enu_m=[5, 8, 10])
    air.wait(lambda: abs(air.enu(air.one)[1] - 8) < 2, 40, "it goes where the new daemon says")
    figures["land s"] = air.land()


@pytest.mark.only("ardupilot")
def test_a_reboot_and_an_arm_that_waits_for_a_position(ground: Field, figures: dict[str, Any]) -> None:
    began = time.monotonic()
    ground.order("vehicles.reboot", ground.one)
    ground.wait(lambda: ground.watcher.events_since(began, "reboot", vehicle=ground.one), 60, "the reboot is reported")
    figures["reboot seen s"] = time.monotonic() - began
    ground.wait(ground.connected, 30, "it is heard again")
    began = time.monotonic()
    outcome = ground.order("vehicles.arm", ground.one, wait_s=100)[ground.one]
    figures["armed after s"], figures["mode"] = time.monotonic() - began, ground.truth(ground.one).mode
    figures["message"] = outcome["message"]
    ground.order("vehicles.takeoff", ground.one, height_m=5)
    ground.wait(lambda: ground.truth(ground.one).alt_rel_m > 4, 40, "it is up")
    ground.land()


def test_a_fleet_order_after_everything(ground: Field, figures: dict[str, Any]) -> None:
    figures["takeoff s"] = ground.takeoff()
    figures["land s"] = ground.land()
