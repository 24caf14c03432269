from __future__ import annotations

import pytest

from skygcs.core.vehicle.boot import CONFIRM_S, JITTER_MS, WRAP_MS, BootClock
from support.table import each


def test_a_clock_that_goes_back_is_a_reboot_told_once() -> None:
    clock = BootClock()
    assert not clock.on_boot_ms(500_000, 0.0)
    assert not clock.on_boot_ms(501_000, 1.0)
    assert clock.on_boot_ms(2_000, 20.0)
    assert not clock.on_boot_ms(3_000, 21.0)
    assert clock.uptime_s(22.0) == pytest.approx(4.0)


def test_frames_out_of_order_are_no_reboot() -> None:
    clock = BootClock()
    clock.on_boot_ms(500_000, 0.0)
    assert not clock.on_boot_ms(500_000 - JITTER_MS, 0.1)
    assert clock.uptime_s(0.0) == pytest.approx(500.0)
    assert not clock.on_boot_ms(501_000, 1.0)


def test_the_32_bit_wrap_is_no_reboot() -> None:
    clock = BootClock()
    clock.on_boot_ms(WRAP_MS - 500, 0.0)
    assert not clock.on_boot_ms(500, 1.0)
    assert not clock.on_boot_ms(1500, 2.0)


@each("other_ms", [10_000, 5_000_000])
def test_two_vehicles_under_one_id_are_no_reboots(other_ms: int) -> None:
    clock = BootClock()
    clock.on_boot_ms(500_000, 0.0)
    reported = []
    for n in range(1, 20):
        reported.append(clock.on_boot_ms(other_ms + 1000 * n, n - 0.5))
        reported.append(clock.on_boot_ms(500_000 + 1000 * n, float(n)))
    assert not any(reported)
    assert clock.two_clocks(20.0)
    for n in range(20, 40):
        reported.append(clock.on_boot_ms(500_000 + 1000 * n, float(n)))
    assert not any(reported)
    assert not clock.two_clocks(40.0)


def test_a_clock_that_goes_back_without_a_silence_is_a_reboot_once_it_is_alone() -> None:
    clock = BootClock()
    clock.on_boot_ms(500_000, 0.0)
    reported = [clock.on_boot_ms(1_000 + 500 * n, 1.0 + 0.5 * n) for n in range(20)]
    assert reported.index(True) == CONFIRM_S / 0.5
    assert sum(reported) == 1


def test_reboots_in_a_row_are_not_two_vehicles() -> None:
    clock = BootClock()
    for n in range(6):
        clock.on_boot_ms(100_000, 100.0 * n)
        clock.on_boot_ms(1_000, 100.0 * n + 50)
        assert not clock.two_clocks(100.0 * n + 50)


def test_uptime_is_unknown_until_told() -> None:
    assert BootClock().uptime_s(5.0) is None
