"""JSON of other sites, made harmless where it is decoded: what follows may show, add and encode every value. Pure."""

from __future__ import annotations

import math
from typing import Any

MAX_BY_CHARS = 100
"""Longest name of the user and station that gave an order."""

MAX_TEXT_CHARS = 1000
"""Longest text; longer ones are cut."""

MAX_INTEGER = 1 << 63
"""Integers beyond it have no place in a float or in a reader's 64 bits without loss, or at all."""


def cleaned(value: Any, most_chars: int = MAX_TEXT_CHARS) -> Any:
    """The same JSON with `printable` texts and keys; numbers that are not finite or beyond MAX_INTEGER are null.
    (pydantic-core reads 1e999 as infinity, also where infinities are not allowed.)"""
    if isinstance(value, str):
        return printable(value, most_chars)
    if isinstance(value, dict):
        return {printable(key): cleaned(item, most_chars) for key, item in value.items()}
    if isinstance(value, list):
        return [cleaned(item, most_chars) for item in value]
    if isinstance(value, int):
        return value if -MAX_INTEGER <= value <= MAX_INTEGER else None
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def printable(text: str, most_chars: int = MAX_BY_CHARS) -> str:
    """A text of another station for logs and screens: cut to ``most_chars``, control characters replaced."""
    text = text[:most_chars]
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)
