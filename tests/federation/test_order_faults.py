"""Seeded schedules of faults over a real nats-server, checked against the model (`support.order_faults`)."""

from __future__ import annotations

from pathlib import Path

from support.order_schedules_real import real_schedules


async def test_no_order_is_carried_out_twice_or_lost_without_a_word(tmp_path: Path) -> None:
    wrong, happened = await real_schedules(range(6), tmp_path)
    assert wrong == []
    for what in ("shown: accepted", "shown: unknown", "fault: hub replace", "fault: bridge"):
        assert happened[what] > 0, happened
