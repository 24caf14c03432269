"""JSON of what comes to a socket of ours: the one reader of a request. Pure."""

from __future__ import annotations

import json
import re
from collections import Counter
from typing import Any

from pydantic_core import from_json, to_json

LEAST_DIGITS = 309
"""A number without an exponent is beyond the range of a float (1.8e308) only with so many digits."""

_TO_ZERO = bytes(ord("0") if chr(byte).isdigit() and byte < 128 else byte for byte in range(256))
_LONG_NUMBER = b"0" * LEAST_DIGITS

_STRING = re.compile(rb'"([^"]*)"[ \t\r\n]*(:?)')
"""A string without escapes, and the colon after it if it is a key."""


def parse(line: bytes) -> Any:
    """The JSON value of one line. Raises ValueError with a text for a person (also for NaN, too deep nesting, and a
    number that no float can hold, as 1e999, which would be read as infinity)."""
    value = from_json(line, allow_inf_nan=False, cache_strings="keys")
    if _may_overflow(line) and _has_infinity(value):
        raise ValueError("a number in it is too large: 1.79e308 at most")
    return value


def _may_overflow(line: bytes) -> bool:
    """False if no number of a line is beyond the range of a float. 2 ms for 1 MiB."""
    return b"e" in line or b"E" in line or _LONG_NUMBER in line.translate(_TO_ZERO)


def _has_infinity(value: object) -> bool:
    """True if a number of the value is infinite. The value is asked, not its text: 2 ms for 1 MiB of text, 20 ms for
    260,000 floats. A text may have the word, too, and has it in either form."""
    word = b"Infinity"
    written = to_json(value, inf_nan_mode="constants")
    return word in written and written.count(word) != to_json(value, inf_nan_mode="null").count(word)


def key_twice(line: bytes) -> str | None:
    """A key that an object of a line has twice, which `parse` does not report. ``line``: what `parse` accepted."""
    found: list[str] = []
    if (
        b"\\" not in line
    ):  # most large lines are trajectories, in which no key occurs twice anywhere: 0.4 ms and not 34 for 1 MB
        seen = [string for string, colon in _STRING.findall(line) if colon]
        if len(set(seen)) == len(seen):
            return None

    def collect(pairs: list[tuple[str, Any]]) -> None:
        keys = [key for key, _ in pairs]
        if not found and len(set(keys)) < len(keys):
            found.append(Counter(keys).most_common(1)[0][0])

    json.loads(line, object_pairs_hook=collect, parse_int=str)  # str: int() refuses numbers that `parse` accepts
    return found[0] if found else None
