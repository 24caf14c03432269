"""The table [formation], and the vehicles that may be members."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import ValidationError

from skygcs.config.models import FleetConfig
from skygcs.errors import RefusedError
from skygcs.ext.formation.config import FormationConfig
from skygcs.ext.formation.extension import MOST_MEMBERS, Formation


def test_an_empty_table_is_enough_and_bad_values_are_refused() -> None:
    assert FormationConfig().speed_mps == 2.0
    for bad in ({"speed_mps": 0.0}, {"lowest_m": -1.0}, {"speed": 2.0}, {"climb_mps": float("nan")}):
        with pytest.raises(ValidationError):
            FormationConfig.model_validate(bad)


def test_a_daemon_that_keeps_no_vehicles_flies_no_formation() -> None:
    fleet = FleetConfig.model_validate({"daemon": {"keep_vehicles": False}})
    (problem,) = Formation.problems(FormationConfig(), fleet)
    assert "keep_vehicles" in problem.text
    assert Formation.problems(FormationConfig(), FleetConfig()) == []


async def test_more_members_than_a_step_has_time_for_are_refused() -> None:
    many: list[Any] = [SimpleNamespace(name=f"v{n}") for n in range(MOST_MEMBERS + 1)]
    core: Any = SimpleNamespace(fleet=SimpleNamespace(resolve=lambda targets: many))
    formation = Formation(core, FormationConfig())
    wanted: Any = SimpleNamespace(targets="all", leader=None)
    with pytest.raises(RefusedError, match="30 members at most"):
        await formation.begin(wanted)
    assert formation.status() == {"state": "none", "members": []}
