"""The ``separation`` tables and ``[monitor]`` of the fleet file."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig
from skygcs.core.separation import Footprint
from skygcs.errors import ConfigError
from support.table import each


def load(folder: Path, text: str) -> FleetConfig:
    path = folder / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def test_the_monitor_is_advisory_and_the_footprint_the_cores_unless_set(tmp_path: Path) -> None:
    fleet = load(tmp_path, "[vehicles.alpha]\nsysid = 1\n")
    assert fleet.monitor.mode == "advisory"
    for vehicle in (fleet.vehicle_configs()[0], fleet.default_vehicle(9)):
        assert vehicle.separation.footprint() == Footprint()
        assert vehicle.separation.priority is None


def test_levels_are_laid_over_each_other_key_by_key(tmp_path: Path) -> None:
    fleet = load(
        tmp_path,
        """
[monitor]
mode = "acting"
[defaults.separation]
wingspan_m = 1.0
priority = 1
[types.big.separation]
wingspan_m = 3.0
acceleration_mps2 = 2.0
[vehicles.alpha]
sysid = 1
type = "big"
[vehicles.alpha.separation]
priority = 5
""",
    )
    assert fleet.monitor.mode == "acting"
    (alpha,) = fleet.vehicle_configs()
    assert alpha.separation.footprint() == Footprint(wingspan_m=3.0, acceleration_mps2=2.0)
    assert alpha.separation.priority == 5
    assert fleet.default_vehicle(7).separation.footprint() == Footprint(wingspan_m=1.0)


@each(
    ("text", "said"),
    [
        ('[monitor]\nmode = "on"', "acting"),
        ("[monitor]\nmodes = 1", "mode"),
        ("[defaults.separation]\nwingspan_m = 0", "wingspan_m"),
        ("[defaults.separation]\nposition_error_m = -1", "position_error_m"),
        ("[defaults.separation]\ndownwash_ratio = 0.5", "downwash_ratio"),
        ("[defaults.separation]\nacceleration_mps2 = nan", "acceleration_mps2"),
        ("[defaults.separation]\npriority = 1.5", "priority"),
        ("[defaults.separation]\nwing_span = 1", "did you mean wingspan_m?"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        load(tmp_path, text + "\n")
    assert any(said in problem for problem in error.value.problems), error.value.problems
