"""Captures and import files: our own, those made here, and other people's, which are read where they lie beside the
project, skipped where they are absent, and never copied."""

from __future__ import annotations

import atexit
import functools
import json
import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from support.made_files import made_file, made_names
from support.made_logs import MADE, made

ROOT = Path(__file__).resolve().parents[2]
PUBLIC = Path(os.environ.get("SKYGCS_PUBLIC_DATA", ROOT.parent / "shared" / "data" / "public"))
"""SKYGCS_PUBLIC_DATA=/nowhere runs the tests as in a clone that does not have it."""

OWN = ROOT / "tests" / "data"
CAPTURE = OWN / "sitl-3ardupilot-2px4.tlog"
"""Our own: three ArduCopter and two PX4, 75 s, 8144 records, both directions."""


def public_file(relative: str) -> Path:
    """That file, one of our own, or one that is made here; skips the test if there is none."""
    folder, _, name = relative.partition("/")
    content = made(name)[0] if folder == "tlog" and name in MADE else made_file(relative)
    if content is not None:
        path = _made_folder() / relative
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        return path
    path = OWN / name if folder == "tlog" and (OWN / name).is_file() else PUBLIC / relative
    if not path.is_file():
        pytest.skip(f"no public data: {relative}")
    return path


class Present(list[str]):
    """Names of files that are there: none in a clone without the public ones, where the test is skipped."""


def present(folder: str, names: Iterable[str]) -> Present:
    """Those of the names whose files are there, for parametrize and `each`: a clone without the public ones skips what
    it does not have."""
    made_here = {*MADE, *(p.name for p in OWN.iterdir())} if folder == "tlog" else set(made_names(folder))
    return Present(name for name in names if name in made_here or (PUBLIC / folder / name).is_file())


def own_capture(name: str) -> bytes:
    """Content of one of our own captures (tests/data), which are always there."""
    return (OWN / f"{name}.tlog").read_bytes()


def public_folder(relative: str) -> list[Path]:
    """The files of that folder, those made here as well, sorted; skips the test if there is none."""
    files = sorted(p for p in (PUBLIC / relative).glob("*") if p.is_file())
    files += [public_file(f"{relative}/{name}") for name in made_names(relative)]
    if not files:
        pytest.skip(f"no public data: {relative}")
    return files


@functools.cache
def expected() -> dict[str, Any]:
    """What independent readers found: of our own captures (pymavlink's tables), of those made here, and of the public
    ones where they are there (their expected.json)."""
    path = PUBLIC / "tlog" / "expected.json"
    public = dict(json.loads(path.read_text())) if path.is_file() else {}
    own = dict(json.loads((OWN / "expected.json").read_text()))
    return {**own, **{name: made(name)[1] for name in MADE}, **public}


def captures(kind: str) -> list[str]:
    """Names of the captures of that kind ("tlog" or "raw"), for parametrize: our own, made here, and public."""
    path = PUBLIC / "tlog" / "expected.json"
    public = [name for name in json.loads(path.read_text()) if name.endswith(kind)] if path.is_file() else []
    own = [name for name in json.loads((OWN / "expected.json").read_text()) if name.endswith(kind)]
    return [*own, *(name for name in MADE if name.endswith(kind)), *public]


def capture(name: str) -> tuple[bytes, dict[str, Any]]:
    """(content, what is expected of it); skips without the data."""
    return public_file(f"tlog/{name}").read_bytes(), expected()[name]


def vehicles_of(name: str) -> dict[str, int]:
    """Heartbeats by system/component, of real autopilots that are no ground stations."""
    return {
        f"{sysid}/{compid}": count
        for sysid, compid, autopilot, kind, _, count in expected()[name]["heartbeats"]
        if autopilot != "MAV_AUTOPILOT_INVALID" and kind != "MAV_TYPE_GCS"
    }


@functools.cache
def _made_folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="skygcs-made-logs-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
