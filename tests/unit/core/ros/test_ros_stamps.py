"""Stamps: the least delayed message sets the clock; reboots and steps begin anew."""

from __future__ import annotations

import pytest

from skygcs.core.ros.ros_names import ros_name, vehicle_root
from skygcs.core.ros.stamps import VehicleClock
from support.table import each

MS = 1_000_000
UNIX_NS = 1_700_000_000 * 10**9


def test_delay_of_the_radio_is_not_in_the_stamp() -> None:
    clock = VehicleClock()
    boot_ms = 5000
    delays_ms = [30, 120, 25, 400, 60, 25]
    stamps = []
    for n, delay_ms in enumerate(delays_ms):
        measured_ns = UNIX_NS + 100 * n * MS
        stamps.append(clock.stamp_ns((boot_ms + 100 * n) * 1000, measured_ns + delay_ms * MS) - measured_ns)
    assert stamps[0] == stamps[1] - 20_000 * (stamps[1] > 30 * MS) or abs(stamps[1] - 30 * MS) < MS
    assert all(abs(late_ns - 25 * MS) < MS for late_ns in stamps[2:])


def test_drift_is_followed_and_a_reboot_begins_anew() -> None:
    clock = VehicleClock()
    for second in range(600):  # the vehicle's clock loses 100 ppm
        arrival_ns = UNIX_NS + second * 10**9
        stamp_ns = clock.stamp_ns(round(second * 1e6 * (1 - 1e-4)), arrival_ns)
        assert abs(arrival_ns - stamp_ns) < MS
    rebooted_ns = UNIX_NS + 700 * 10**9
    assert clock.stamp_ns(1_000_000, rebooted_ns) == rebooted_ns
    assert clock.stamp_ns(1_100_000, rebooted_ns + 100 * MS) == rebooted_ns + 100 * MS


def test_time_since_1970_is_taken_and_never_from_the_future() -> None:
    clock = VehicleClock()
    assert clock.stamp_ns(UNIX_NS // 1000, UNIX_NS + 5 * MS) == UNIX_NS
    assert clock.stamp_ns(UNIX_NS // 1000 + 10**9, UNIX_NS) == UNIX_NS


@each(
    ("name", "ros"),
    [("alpha", "alpha"), ("uav-1", "uav_1"), ("7th", "v7th"), ("Ä", "v"), ("a__b", "a_b"), ("_x_", "x")],
)
def test_names(name: str, ros: str) -> None:
    assert ros_name(name) == ros
    assert vehicle_root("/{name}", name, 3) == f"/{ros}"


def test_roots() -> None:
    assert vehicle_root("/uav_{sysid}/mav", "alpha", 3) == "/uav_3/mav"
    for pattern in ("alpha", "/{nom}", "/{name", "/{0}", "/a b", "/", "/{name}/", "/{sysid}", "/{name.x}"):
        with pytest.raises(ValueError):
            vehicle_root(pattern, "alpha", 3)
