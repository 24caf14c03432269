"""Suggestions for a name that does not exist."""

from __future__ import annotations

from collections.abc import Iterable

MAX_WORD_CHARS = 80
"""Part of a word that is compared: a megabyte takes half a second."""


def near_names(word: str, known: Iterable[str], *, n: int = 3, cutoff: float = 0.6) -> list[str]:
    """At most ``n`` of the known names that are spelled like the begin of ``word``, the most similar first."""
    import difflib  # with the first typing error: 0.15 MB that a daemon does without

    return difflib.get_close_matches(word[:MAX_WORD_CHARS], list(known), n=n, cutoff=cutoff)
