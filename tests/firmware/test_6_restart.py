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
    air.wait(lambda: all(map(air.has_position, air.names)), 30, "their positions are known again")
    air.order("vehicles.goto", "all", enu_m=[5, 8, 10])
    air.wait(lambda: abs(air.enu(air.one)[1] - 8) < 2, 40, "it goes where the new daemon says")
    figures["land s"] = air.land()


@pytest.mark.only("px4")
def test_a_reboot_that_the_firmware_does_not_have_is_denied(ground: Field, figures: dict[str, Any]) -> None:
    """PX4's simulator has none (Commander.cpp, CONFIG_BOARDCTL_RESET): skygcs says so, and nothing is lost."""
    outcome = ground.daemon.call("vehicles.reboot", targets=ground.one)["outcomes"][ground.one]
    figures["message"] = outcome["message"]
    assert not outcome["ok"] and outcome["result"] == "denied"
    ground.holds(ground.connected, 3, "a vehicle was lost")
    ground.order("vehicles.arm", ground.one)
    ground.order("vehicles.disarm", ground.one)


@pytest.mark.minutes
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


@pytest.mark.minutes
def test_a_cold_start_is_waited_for(ground: Field, figures: dict[str, Any]) -> None:
    """`arm all --wait 60` and `takeoff all` as soon as the vehicles are heard, before they have a position."""
    off = time.monotonic()
    ground.relaunch()
    began = time.monotonic()
    ground.wait(
        lambda: len(ground.watcher.events_since(off, "reboot")) == len(ground.names), 20, "both reboots are reported"
    )
    arm = ground.daemon.cli("arm", "all", "--wait", "60")
    figures["arm s"], figures["arm says"] = time.monotonic() - began, arm.stdout.splitlines()[-2:]
    assert arm.returncode == 0, arm.stdout + arm.stderr
    figures["armed in"] = [ground.truth(n).mode for n in ground.names]
    if not ground.px4:  # it would arm in STABILIZE long before, and then refuse to take off
        for name in ground.names:
            assert any("is using GPS" in text for text in ground.truth(name).texts_since(began)), ground.summary()
    takeoff = ground.daemon.cli("takeoff", "all", "5")
    figures["takeoff says"] = takeoff.stdout.splitlines()[-2:]
    assert takeoff.returncode == 0, takeoff.stdout + takeoff.stderr
    figures["up s"] = ground.wait(lambda: all(ground.truth(n).alt_rel_m > 4 for n in ground.names), 60, "both are up")
    figures["flies in"] = [ground.truth(n).mode for n in ground.names]
    assert ground.px4 or figures["flies in"] == ["GUIDED", "GUIDED"]
    ground.land()


def test_a_fleet_order_after_everything(ground: Field, figures: dict[str, Any]) -> None:
    figures["takeoff s"] = ground.takeoff()
    figures["land s"] = ground.land()
