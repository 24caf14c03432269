"""Suggestions for a name that does not exist."""

from __future__ import annotations

from collections.abc import Iterable


def near_names(word: str, known: Iterable[str], *, n: int = 3, cutoff: float = 0.6) -> list[str]:
    """At most ``n`` of the known names that are spelled like ``word``, the most similar first."""
    import difflib  # with the first typing error: 0.15 MB that a daemon does without

    return difflib.get_close_matches(word, list(known), n=n, cutoff=cutoff)
