"""Orders between sites over a network that fails: none is carried out twice, none is lost without a word."""

from __future__ import annotations

from pathlib import Path

from support.order_schedules import memory_schedules


async def test_schedules_of_faults_against_the_model(tmp_path: Path) -> None:
    wrong, happened = await memory_schedules(range(20), tmp_path)
    assert wrong == []
    # the schedules reach what they are for
    for what in ("shown: accepted", "shown: refused", "shown: unknown", "settled: done", "settled: never came"):
        assert happened[what] > 0, happened
