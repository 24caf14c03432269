"""Orders between sites over a network that fails: none is carried out twice, none is lost without a word."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from support.order_schedules import memory_schedule


async def test_schedules_of_faults_against_the_model(tmp_path: Path) -> None:
    wrong: list[str] = []
    happened: Counter[str] = Counter()
    for seed in range(20):
        folder = tmp_path / str(seed)
        folder.mkdir()
        contradictions, counted = await memory_schedule(seed, folder)
        wrong += contradictions
        happened += counted
    assert wrong == []
    # the schedules reach what they are for
    for what in ("shown: accepted", "shown: refused", "shown: unknown", "settled: done", "settled: never came"):
        assert happened[what] > 0, happened
