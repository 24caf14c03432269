"""Other people's captures, read where they lie beside the project and skipped where they are absent. Never copied."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PUBLIC = ROOT.parent / "shared" / "data" / "public"
OWN = ROOT / "tests" / "data"
CAPTURE = OWN / "sitl-3ardupilot-2px4.tlog"
"""Our own: three ArduCopter and two PX4, 75 s, 8144 records, both directions."""


def public_file(relative: str) -> Path:
    """That file; skips the test if there is none."""
    path = PUBLIC / relative
    if not path.is_file():
        pytest.skip(f"no public data: {relative}")
    return path


def own_capture(name: str) -> bytes:
    """Content of one of our own captures (tests/data), which are always there."""
    return (OWN / f"{name}.tlog").read_bytes()


def public_folder(relative: str) -> list[Path]:
    """The files of that folder, sorted; skips the test if there is none."""
    files = sorted(p for p in (PUBLIC / relative).glob("*") if p.is_file())
    if not files:
        pytest.skip(f"no public data: {relative}")
    return files


@functools.cache
def expected() -> dict[str, Any]:
    """expected.json of the public tlogs, {} without them."""
    path = PUBLIC / "tlog" / "expected.json"
    return dict(json.loads(path.read_text())) if path.is_file() else {}


def captures(kind: str) -> list[str]:
    """Names of the public captures of that kind ("tlog" or "raw"), for parametrize."""
    return [name for name, entry in expected().items() if entry["kind"] == kind] or ["absent"]


def capture(name: str) -> tuple[bytes, dict[str, Any]]:
    """(content, what is expected of it); skips without the data."""
    content = public_file(f"tlog/{name}").read_bytes()
    return content, expected()[name]
