"""A plan that the dry run passes is flown to its end; the command of a refusal leads on (`support.dry_runs`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.dry_runs import judge
from support.examples import seeds

COSTS = "each seed flies some random plans of two or three vehicles to their ends"


@pytest.mark.parametrize("seed", seeds(8))
async def test_random_plans_are_flown_as_their_dry_runs_say(tmp_path: Path, seed: int) -> None:
    judged = await judge(seed, tmp_path, plans=4)
    assert not judged.faults
    assert judged.refused == judged.led_on and judged.passed + judged.refused == 4
