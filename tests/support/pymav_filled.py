"""Messages of pymavlink with a value in every field."""

from __future__ import annotations

import random
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

CLASSES = {cls.msgname: cls for cls in mav.mavlink_map.values()}


def filled(name: str, chance: random.Random, **fields: Any) -> Any:
    """A message whose other values are random, small enough for every type of an integer."""
    cls = CLASSES[name]
    values: dict[str, Any] = {}
    for field, kind, order in zip(cls.fieldnames, cls.fieldtypes, cls.orders, strict=True):
        length = cls.array_lengths[order]
        one = (lambda: chance.uniform(-50, 50)) if kind in ("float", "double") else (lambda: chance.randint(1, 100))
        values[field] = b"text" if kind == "char" else [one() for _ in range(length)] if length else one()
    values |= {key: value for key, value in fields.items() if key in values}
    return cls(*(values[field] for field in cls.fieldnames))
