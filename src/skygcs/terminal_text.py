"""Text of others on a terminal: names, messages, paths may hold what moves the cursor, or hides or reorders text.

Everything that is printed and not made here goes through `visible`: a vehicle's name or a file's key with an escape
sequence shows it and does nothing.
"""

from __future__ import annotations

import re

_CONTROLS = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff"
"""Control characters of both sets but tab and newline, marks that turn the direction of text, and lone surrogates,
which no stream encodes."""

_LINE = re.compile(f"[{_CONTROLS}\n\t]")
_LINES = re.compile(f"[{_CONTROLS}]")


def visible(text: str, *, lines: bool = False) -> str:
    """The text with each such character written as Python would (\\x1b). ``lines``: newlines and tabs stay."""
    if text.isprintable():
        return text
    return (_LINES if lines else _LINE).sub(lambda found: found[0].encode("unicode_escape").decode(), text)
