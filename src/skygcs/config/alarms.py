"""``[alarms]``: from when on a value is an alarm."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from skygcs.config.tables import Model

Percent = Annotated[float, Field(ge=0, le=100)]


class AlarmsConfig(Model):
    """[alarms]"""

    battery_low_percent: Percent = 25.0
    """A battery's charge from which it is a warning, in percent."""
    battery_critical_percent: Percent = 12.0
    """A battery's charge from which it is an alarm while the vehicle is armed, in percent."""

    @model_validator(mode="after")
    def _in_order(self) -> AlarmsConfig:
        if self.battery_critical_percent > self.battery_low_percent:
            raise ValueError(
                f"battery_critical_percent {self.battery_critical_percent:g} is above battery_low_percent "
                f"{self.battery_low_percent:g}"
            )
        return self
