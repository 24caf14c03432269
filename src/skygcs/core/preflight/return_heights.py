"""Heights in which vehicles return if the ground station is lost: far enough apart that all may return at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple


class ReturnHeight(NamedTuple):
    """The parameter of the height in which a vehicle returns, and its units per metre."""

    param: str
    per_metre: float
    height_m: float


def offered_heights(heights: Mapping[str, ReturnHeight | None], apart_m: float) -> dict[str, float]:
    """Return heights in metres that are far enough apart: in the order they have now, none lower than it is."""
    offered: dict[str, float] = {}
    last_m = -math.inf
    for name, height in sorted(
        ((n, h) for n, h in heights.items() if h is not None), key=lambda item: (item[1].height_m, item[0])
    ):
        last_m = max(height.height_m, last_m + apart_m)
        offered[name] = float(math.ceil(last_m - 1e-9))
        last_m = offered[name]
    return offered
