"""When a sender of garbage is parked."""

from __future__ import annotations

from skygcs.core.routing.garbage import BURST_BYTES, BYTES_PER_S, PARK_S, GarbageGauge


def test_a_radio_full_of_noise_is_never_parked() -> None:
    gauge = GarbageGauge(0.0)
    assert not any(gauge.skipped(115, 0.01 * step) for step in range(100_000))  # 115200 baud
    assert gauge.parkings == 0


def test_a_flood_is_searched_for_no_more_than_its_part_and_comes_back_after_a_pause() -> None:
    gauge = GarbageGauge(5.0)
    searched = 0
    for step in range(60_000):
        now = 5.0 + 0.001 * step
        if not gauge.is_parked(now):
            searched += 1000
            gauge.skipped(1000, now)
    assert gauge.parkings > 25
    assert searched < 60 * BYTES_PER_S
    assert gauge.is_parked(now) or not gauge.skipped(0, now)
    assert not gauge.is_parked(now + PARK_S)
    assert not gauge.skipped(int(BURST_BYTES / 5), now + PARK_S)
