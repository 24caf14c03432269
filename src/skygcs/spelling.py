"""Names in texts for people: suggestions for one that does not exist, and lists of many."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

MAX_WORD_CHARS = 80
"""Part of a word that is compared: a megabyte takes half a second."""


def near_names(word: str, known: Iterable[str], *, n: int = 3, cutoff: float = 0.6) -> list[str]:
    """At most ``n`` of the known names that are spelled like the begin of ``word``, the most similar first."""
    import difflib  # with the first typing error: 0.15 MB that a daemon does without

    return difflib.get_close_matches(word[:MAX_WORD_CHARS], list(known), n=n, cutoff=cutoff)


def enumerated(names: Iterable[object], most: int = 5) -> str:
    """At most ``most`` names or numbers as a part of a sentence: "a", "a and b", "a, b and 3 more"."""
    shown = [str(name) for name in names]
    if (left_out := len(shown) - most) > 0:
        shown[most:] = [f"{left_out} more"]
    return " and ".join(filter(None, (", ".join(shown[:-1]), *shown[-1:])))


def listed(texts: Sequence[str], most: int) -> str:
    """At most ``most`` texts that are sentences themselves: "a; b; and 3 more"."""
    return "; ".join([*texts[:most], *([f"and {len(texts) - most} more"] if len(texts) > most else [])])
