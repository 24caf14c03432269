"""Others who send with a vehicle's ids: what skygcs believes, and what the vehicle does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.firmware_field import HEIGHT_M, Field
from support.udp_relay import EARTH_M_PER_DEG


@contextmanager
def repeated(send: Callable[[], None], rate_hz: float) -> Iterator[None]:
    ending = threading.Event()

    def run() -> None:
        while not ending.wait(1 / rate_hz):
            send()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join(5)


def seen(field: Field) -> tuple[Any, ...]:
    state = field.state(field.one)
    return state["autopilot"], state["type"], state["armed"]


def test_heartbeats_of_no_autopilot_with_a_vehicles_ids(air: Field, figures: dict[str, Any]) -> None:
    """What an onboard computer with wrong ids sends at 1 Hz, and a flood of it."""
    before = seen(air)
    for rate_hz, kind in ((1, mav.MAV_TYPE_ONBOARD_CONTROLLER), (50, mav.MAV_TYPE_GENERIC)):
        with air.peer(air.sysids[0]) as peer, repeated(lambda k=kind: peer.mav.heartbeat_send(k, 8, 0, 0, 3), rate_hz):  # type: ignore[misc]
            done = 0
            for _ in range(6):
                outcome = air.daemon.call("vehicles.stop", targets=air.one)["outcomes"][air.one]
                done += outcome["ok"]
                assert seen(air) == before
                time.sleep(0.7)
            figures[f"stops at {rate_hz} Hz"] = f"{done} of 6"
            assert done == 6
            assert air.daemon.call("vehicles.land", targets=air.two)["outcomes"][air.two]["ok"]
            air.daemon.call("vehicles.hold", targets=air.two)


def test_one_forged_disarmed_heartbeat_under_control(air: Field, figures: dict[str, Any]) -> None:
    began = time.monotonic()
    kind, autopilot = (2, 12) if air.px4 else (2, 3)
    with air.controlled("attitude"), air.peer(air.sysids[0]) as peer:
        peer.mav.heartbeat_send(kind, autopilot, 1, 0, 3)
        low, far = HEIGHT_M, 0.0
        end = time.monotonic() + 6
        while time.monotonic() < end:
            x, y, up = air.enu(air.one)
            low, far = min(low, up), max(far, abs(x), abs(y))
            time.sleep(0.05)
        figures["lowest m"], figures["farthest m"] = low, far
        figures["control mode after"] = air.control(air.one)["control_mode"]
        figures["armed"] = air.state(air.one)["armed"]
        figures["events"] = [e["text"][:80] for e in air.watcher.events_since(began, "duplicate", "control")][:4]
        assert air.truth(air.one).armed
        assert air.state(air.one)["armed"]
        assert low > HEIGHT_M - 2.5
        assert far < 3


@pytest.mark.parametrize("mode", ["hold", pytest.param("velocity", marks=pytest.mark.minutes)])
def test_forged_positions_fly_nobody(air: Field, figures: dict[str, Any], mode: str) -> None:
    """Positions 30 m north of it at 10 Hz, with its ids, from another peer."""
    began = time.monotonic()
    truth = air.truth(air.one)

    def forge() -> None:
        boot_ms = int((time.monotonic() - began) * 1000) + 60_000
        north = 30 / EARTH_M_PER_DEG
        peer.mav.global_position_int_send(
            boot_ms, int((truth.lat_deg + north) * 1e7), int(truth.lon_deg * 1e7), 190_000, 10_000, 0, 0, 0, 0
        )

    with (
        air.controlled(mode) if mode != "hold" else nullcontext(),
        air.peer(air.sysids[0]) as peer,
        repeated(forge, 10),
    ):
        at, far, seen_far = (truth.lat_deg, truth.lon_deg), 0.0, 0.0
        end = time.monotonic() + 8
        while time.monotonic() < end:
            far = max(far, truth.metres_from(*at))
            seen_far = max(seen_far, abs(air.state(air.one)["position"]["enu_m"][1]))
            time.sleep(0.05)
        if mode == "hold":  # an order in the middle of it goes where it says
            air.order("vehicles.hold", air.one)
            time.sleep(2)
            far = max(far, truth.metres_from(*at))
        else:
            figures["control"] = air.control(air.one)["state"]
    figures["moved m"], figures["seen north m"] = far, seen_far
    figures["events"] = [e["text"] for e in air.watcher.events_since(began, "duplicate", "conflict", "control")][:4]
    assert far < 3
    assert seen_far < 4
    assert figures["events"], "nothing was reported"


def test_a_second_vehicle_with_the_same_id_is_switched_on(air: Field, figures: dict[str, Any]) -> None:
    """A bench vehicle: heartbeats and positions of the same family from another peer, disarmed."""
    began = time.monotonic()
    kind, autopilot = (2, 12) if air.px4 else (2, 3)
    with air.peer(air.sysids[0]) as peer:

        def second() -> None:
            peer.mav.heartbeat_send(kind, autopilot, 81, 0, 3)
            peer.mav.global_position_int_send(5000, 437000000, -794000000, 150_000, 0, 0, 0, 0, 0)

        with repeated(second, 1):
            time.sleep(8)
            figures["seen"] = seen(air)
            outcomes = {}
            for order in ("hold", "stop", "land"):
                outcomes[order] = air.daemon.call(f"vehicles.{order}", targets=air.one)["outcomes"][air.one]["ok"]
            figures["orders"] = outcomes
            assert air.truth(air.one).armed
            figures["mode"] = air.truth(air.one).mode
            assert air.truth(air.one).mode == "LAND"
            assert all(outcomes.values())
    figures["events"] = [e["text"][:90] for e in air.watcher.events_since(began, "duplicate", "conflict")][:3]
    assert figures["events"]
    air.land()


def test_quick_orders_are_no_second_vehicle(ground: Field, figures: dict[str, Any]) -> None:
    """Arming and modes that change several times in a few seconds are one vehicle that obeys."""
    began = time.monotonic()
    for _ in range(3):
        ground.order("vehicles.arm", ground.one, wait_s=60)
        ground.order("vehicles.disarm", ground.one)
    figures["seconds"] = time.monotonic() - began
    figures["events"] = [e["text"][:90] for e in ground.watcher.events_since(began, "duplicate", "conflict")]
    assert not figures["events"]
