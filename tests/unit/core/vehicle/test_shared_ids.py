"""Other senders with a vehicle's ids: what is reported of them, how often, and when it is over."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.core.vehicle.shared_ids import (
    BESIDE_OVER_S,
    CONFIRM_S,
    JITTER_MS,
    REPORT_AGAIN_S,
    WRAP_MS,
    BootClock,
    Finding,
    SharedIds,
)
from support.table import each

NEVER = -1e9
OVER_S = 1.5 + BESIDE_OVER_S


class Rig:
    def __init__(self) -> None:
        self.ids = SharedIds(7, 1)
        self.heartbeats: Any = SimpleNamespace(contradicted_at=NEVER, alternating=False)
        self.two_clocks = False
        self.boot: Any = SimpleNamespace(two_clocks=lambda now: self.two_clocks)

    def beat(self, origin: Any, now: float) -> Finding | None:
        return self.ids.on_heartbeat(origin, "QUADROTOR", "PX4", "armed", "LOITER, disarmed", now)

    def tick(self, now: float) -> Finding | None:
        return self.ids.tick(self.heartbeats, self.boot, now)


@each(
    ("origin", "kind", "change", "beside"),
    [("other", "conflict", "other_heartbeat", False), ("duplicate", "duplicate", "duplicate", True)],
)
def test_heartbeats_of_others_are_reported_once_a_minute_with_their_number(
    origin: Any, kind: str, change: str, beside: bool
) -> None:
    rig = Rig()
    counts = {}
    for second in range(int(REPORT_AGAIN_S) + 2):
        if (found := rig.beat(origin, float(second))) is not None:
            assert (found[0], found[2]["change"]) == (kind, change)
            counts[second] = found[2]["count"]
    assert counts == {0: 1, REPORT_AGAIN_S: REPORT_AGAIN_S + 1}
    assert (rig.ids.beside, rig.ids.where) == (beside, "on one link" if beside else None)


def test_two_vehicles_are_over_when_neither_heartbeats_nor_clocks_contradict_and_begin_anew() -> None:
    rig = Rig()
    rig.beat("duplicate", 0.0)
    rig.heartbeats.contradicted_at = 1.0
    assert rig.tick(1.0 + BESIDE_OVER_S) is None
    for holds in ({"alternating": True}, {}):
        rig.heartbeats.alternating, rig.two_clocks = bool(holds), not holds
        assert rig.tick(OVER_S) is None and rig.ids.beside
    rig.two_clocks = False
    over = rig.tick(OVER_S)
    assert over is not None and over[2] == {"change": "duplicate_over"} and not rig.ids.beside
    assert rig.tick(OVER_S + 1.0) is None
    # the same one within the minute of its report
    again = rig.beat("duplicate", OVER_S + 2.0)
    assert again is not None and again[2] == {"change": "duplicate"} and rig.ids.beside
    assert rig.beat("duplicate", OVER_S + 3.0) is None


def test_a_second_clock_is_a_second_vehicle_and_reported_once() -> None:
    rig = Rig()
    assert rig.ids.on_clock(rig.boot, 0.0) is None
    rig.two_clocks = True
    found = rig.ids.on_clock(rig.boot, 1.0)
    assert found is not None and found[2] == {"change": "duplicate", "sysid": 7} and rig.ids.beside
    assert found[1].startswith("two vehicles with system id 7 send on one link: their clocks")
    assert rig.ids.on_clock(rig.boot, 2.0) is None


def test_another_vehicle_on_another_channel_is_named_by_the_fleets_table() -> None:
    rig = Rig()
    rig.ids.others = {7 << 8 | 2: "elsewhere"}
    assert rig.ids.where is rig.ids.elsewhere is None
    rig.ids.others = {7 << 8 | 1: "radio 2"}
    assert rig.ids.where == rig.ids.elsewhere == "radio 2"


def test_a_clock_that_goes_back_is_a_reboot_told_once() -> None:
    clock = BootClock()
    assert not clock.on_boot_ms(500_000, 0.0)
    assert not clock.on_boot_ms(501_000, 1.0)
    assert clock.on_boot_ms(2_000, 20.0)
    assert not clock.on_boot_ms(3_000, 21.0)
    assert clock.uptime_s(22.0) == pytest.approx(4.0)


@each("old_ms, silent_s, new_ms", [(3_272, 4.9, 2_636), (10_000, 15.0, 12_000)])
def test_one_that_had_just_begun_and_begins_again_is_a_reboot(old_ms: int, silent_s: float, new_ms: int) -> None:
    """The first was seen with a PX4 that was killed 3 s after its start, and took as long to start again."""
    clock = BootClock()
    assert not clock.on_boot_ms(old_ms, 0.0)
    # in bursts, one each second
    reported = [clock.on_boot_ms(new_ms + 100 * n, silent_s + n // 10) for n in range(100)]
    assert reported.index(True) == pytest.approx(10 * CONFIRM_S, abs=10) and sum(reported) == 1


@each("rate", [1.6, 3.0, 10.0])
def test_frames_that_a_radio_had_kept_for_longer_than_it_is_up_are_no_reboot(rate: float) -> None:
    """It is up for 5 s, and is not heard for 30 s; what it sent meanwhile comes then, faster than it was sent."""
    clock = BootClock()
    sent_ms = range(1_000, 90_000, 100)
    came_s = [at_ms / 1000 if at_ms < 5_000 else max(at_ms / 1000, 35 + (at_ms / 1000 - 5) / rate) for at_ms in sent_ms]
    assert not any(itertools.starmap(clock.on_boot_ms, zip(sent_ms, came_s, strict=True)))
    assert clock.went_back_at is None
    assert clock.on_boot_ms(1_000, 95.0), "its next reboot is one"


def test_a_silence_of_a_young_vehicle_is_no_reboot() -> None:
    clock = BootClock()
    assert not clock.on_boot_ms(3_000, 0.0)
    assert not clock.on_boot_ms(22_500, 20.0)


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
