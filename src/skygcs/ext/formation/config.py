"""[formation] of the fleet file: vehicles that fly together about a leader."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from skygcs.config.models import FleetConfig
from skygcs.config.tables import Model, Problem


class FormationConfig(Model):
    """[formation]: its presence adds the formation methods. It moves nothing by itself."""

    speed_mps: Annotated[float, Field(ge=0.2, le=15)] = 2.0
    """The leader's largest speed. Members fly up to a third faster, to catch up."""
    climb_mps: Annotated[float, Field(ge=0.1, le=5)] = 0.8
    """The leader's largest speed up and down."""
    lowest_m: Annotated[float, Field(ge=0, le=1000)] = 3.0
    """Above the fleet's origin: nobody is sent lower, around another, than this or than it began."""


def formation_problems(config: Any, fleet: FleetConfig) -> list[Problem]:
    """Everything that contradicts the rest of the fleet file."""
    if not fleet.daemon.keep_vehicles:
        return [Problem(("formation",), "needs vehicles to fly: set daemon.keep_vehicles = true")]
    return []
