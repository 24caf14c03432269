"""Numbers as they come from files and other programs, and as they are shown to people."""

from __future__ import annotations

import math
from typing import TypeGuard


def is_number(value: object) -> TypeGuard[int | float]:
    """True for a finite number; False for a truth value, and for an integer that is too large for a float, which JSON
    and TOML may hold and which raises OverflowError in most that is done with it."""
    try:
        return not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value)
    except OverflowError:
        return False


def rounded(value: float, decimals: int = 1) -> str:
    """A measured or computed number with at most so many decimals and no zeros at its end: 10.9006 is "10.9", 5.0 is
    "5". One that would be shown as 0 keeps two digits: 0.0123 is "0.012"."""
    if not math.isfinite(value):
        return str(value)
    text = f"{value + 0.0:.{decimals}f}"
    if value != 0.0 and float(text) == 0.0:
        return f"{value:.2g}"
    return text.rstrip("0").rstrip(".") if "." in text else text
