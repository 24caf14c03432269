"""Each vehicle's outcome as it comes, in a whole daemon: an emergency stop of ten of which one does not hear us."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from support.flown import Flown, aloft

pytestmark = pytest.mark.looptime


class Seen:
    """What a client is told, with the seconds since the order."""

    def __init__(self, gcs: Flown) -> None:
        self._gcs, self._began = gcs, gcs.now
        self.vehicles: list[str] = []
        self.came: dict[str, tuple[float, Any]] = {}

    def begun(self, vehicles: Iterable[str], /) -> None:
        self.vehicles = list(vehicles)

    def ended(self, vehicle: str, outcome: Any, /) -> None:
        self.came[vehicle] = (self._gcs.now - self._began, outcome)


async def test_a_stop_shows_who_holds_at_once_although_one_does_not_hear_it(tmp_path: Path) -> None:
    """It showed nothing for 30 s: seven had confirmed and two had refused within a second."""
    async with aloft(tmp_path, px4=5, ardupilot=5) as gcs:
        gcs.sim("v3").faults.deaf = True
        gcs.sim("v8").faults.refuse_mode = "requires position"
        seen = Seen(gcs)
        outcomes = (await gcs("vehicles.stop", targets="all", reports=seen))["outcomes"]
        assert seen.vehicles == list(outcomes)
        assert {name: outcome.as_dict() for name, (_, outcome) in seen.came.items()} == outcomes
        took_s = {name: at for name, (at, _) in seen.came.items()}
        assert max(at for name, at in took_s.items() if name != "v3") < 2.0, took_s
        assert took_s["v3"] > 25.0 and not outcomes["v3"]["ok"]
        assert [name for name in outcomes if not outcomes[name]["ok"]] == ["v3", "v8"]
        assert "requires position" in outcomes["v8"]["message"]
