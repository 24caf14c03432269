"""Where the figures of a benchmark are kept: build/bench, one file of JSON each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

OUT = Path(__file__).resolve().parents[2] / "build" / "bench"


def keep(name: str, figures: Mapping[str, Any], *, beside: bool = False) -> Path:
    """Write them to ``name``.json; with ``beside`` next to what an earlier run or another case has kept there."""
    path = OUT / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    known = json.loads(path.read_text()) if beside and path.is_file() else {}
    path.write_text(json.dumps({**known, **figures}, indent=1) + "\n")
    return path
