"""The origin of the fleet's frame as it was read from the daemon, with the generation that states name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from skygcs.core.geo import Origin


class FleetOrigin(NamedTuple):
    """The result of origin.get. ``origin``: None if none is set; ``generation``: increases with every change."""

    origin: Origin | None
    generation: int

    @classmethod
    def read(cls, status: Mapping[str, Any]) -> FleetOrigin:
        """The result of origin.get."""
        origin = status["origin"]
        return cls(None if origin is None else Origin(**origin), status["generation"])

    def is_of(self, position: Mapping[str, Any] | None) -> bool:
        """True if a state's ``position`` is in this frame, or names no frame."""
        return position is None or position.get("origin_generation") == self.generation
