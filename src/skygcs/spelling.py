"""Text of files, programs and people: numbers as they come and as they are shown, TOML, misspelt and listed names."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Sequence
from typing import Any, TypeGuard

MAX_DOTS = 32
"""Dots in one key; tables of ours are four deep."""

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MAX_DOTS}}}")


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


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text of ours. Raises ValueError for what is not TOML, or not readable: nested too deeply, a
    number has more than 4300 digits, or a key more than `MAX_DOTS` dots (tomllib needs 1.6 GB for 20,000)."""
    if (long := _LONG_KEY.search(text)) is not None:
        line = text.count("\n", 0, long.start()) + 1
        raise ValueError(f"line {line}: a key has more than {MAX_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


MAX_WORD_CHARS = 80
"""Part of a word that is compared: a megabyte takes half a second."""


def near_names(word: str, known: Iterable[str], *, n: int = 3, cutoff: float = 0.6) -> list[str]:
    """At most ``n`` of the known names that are spelled like the begin of ``word``, in whatever case, the most similar
    first; of names that differ in their case only, that in the case of ``word``."""
    import difflib  # with the first typing error: 0.15 MB that a daemon does without

    begin = word[:MAX_WORD_CHARS]
    folded: dict[str, list[str]] = {}
    for name in known:
        folded.setdefault(name.casefold(), []).append(name)
    near = difflib.get_close_matches(begin.casefold(), folded, n=n, cutoff=cutoff)
    return [name for same in near for name in difflib.get_close_matches(begin, folded[same], n=n, cutoff=0.0)][:n]


def enumerated(names: Iterable[object], most: int = 5) -> str:
    """At most ``most`` names or numbers as a part of a sentence: "a", "a and b", "a, b and 3 more"."""
    shown = [str(name) for name in names]
    if (left_out := len(shown) - most) > 0:
        shown[most:] = [f"{left_out} more"]
    return " and ".join(filter(None, (", ".join(shown[:-1]), *shown[-1:])))


def listed(texts: Sequence[str], most: int) -> str:
    """At most ``most`` texts that are sentences themselves: "a; b; and 3 more"."""
    return "; ".join([*texts[:most], *([f"and {len(texts) - most} more"] if len(texts) > most else [])])
