"""Where the built page is, and whether it is there: it is built by make web and part of a built package."""

from __future__ import annotations

from pathlib import Path

STATIC = Path(__file__).with_name("static")

NOT_BUILT = "The page is not built: run make web in the source folder, or install a built package."


def is_built() -> bool:
    """True if `skygcs web` has a page to serve."""
    return (STATIC / "index.html").is_file()
