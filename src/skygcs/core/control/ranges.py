"""The check that every table of limits needs: each value within its range, all problems at once."""

from __future__ import annotations


def out_of_range(config: object, *ranges: tuple[str, float, float]) -> list[str]:
    """A text for each field, by name, that is outside its least and its largest value, NaN included. One that is None
    is not set."""
    found = []
    for name, low, high in ranges:
        value = getattr(config, name)
        if value is not None and not low <= value <= high:
            found.append(f"{name}: {value} is not in {low:g}..{high:g}")
    return found
