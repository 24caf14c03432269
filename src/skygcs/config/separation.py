"""The ``separation`` table of a vehicle, a type or the defaults, and ``[monitor]``: what the monitor watches for."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from skygcs.config.tables import Model
from skygcs.core.separation import Footprint

MonitorMode = Literal["off", "advisory", "acting"]


class MonitorConfig(Model):
    """[monitor]: the watch over the distances between vehicles."""

    mode: MonitorMode = "advisory"
    """off: no watch, and orders are not checked; advisory: report, and refuse orders that would bring two vehicles too
    close; acting: also hold the vehicle of lower priority."""


class SeparationSettings(Model):
    """The space that a vehicle needs; None: not set at this level."""

    wingspan_m: Annotated[float, Field(gt=0, le=30)] | None = None
    """Tip to tip, propellers included: 0.7."""
    position_error_m: Annotated[float, Field(ge=0, le=50)] | None = None
    """How far its reported position may be from the truth, against another vehicle beside it: 0.9; with RTK 0.1."""
    downwash_ratio: Annotated[float, Field(ge=1, le=10)] | None = None
    """Vertical distances are divided by it: 2. Of two vehicles the larger counts."""
    acceleration_mps2: Annotated[float, Field(ge=0, le=50)] | None = None
    """The acceleration with which it may have left its course since its last position: 3."""
    tracking_error_m: Annotated[float, Field(ge=0.05, le=20)] | None = None
    """How far it may be from its reference in a plan: 0.4 until it is measured in flight. The larger one counts."""
    priority: Annotated[int, Field(ge=-1000, le=1000)] | None = None
    """The vehicle of lower priority holds when two are about to meet: 0. Equal: the later name."""

    def over(self, lower: SeparationSettings) -> SeparationSettings:
        """These settings, completed key by key from ``lower``."""
        given = {key: value for key in type(self).model_fields if (value := getattr(self, key)) is not None}
        return lower.model_copy(update=given)

    def footprint(self) -> Footprint:
        """The same footprint for `core.separation`."""
        keys = ("wingspan_m", "position_error_m", "downwash_ratio", "acceleration_mps2")
        return Footprint(**{key: value for key in keys if (value := getattr(self, key)) is not None})
