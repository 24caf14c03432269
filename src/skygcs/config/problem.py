"""One thing wrong with a fleet file."""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.config.keylines import KeyPath


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong with a fleet file. ``missing``: the key at ``path`` should be there and is not."""

    path: KeyPath
    text: str
    missing: bool = False
