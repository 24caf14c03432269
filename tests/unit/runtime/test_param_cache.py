"""The cache of parameters: exact, bounded, and never in the way."""

from __future__ import annotations

import asyncio
import math
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from skygcs.core.mavlink.param_encoding import Param, ParamType, float32
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.runtime import param_cache
from skygcs.runtime.param_cache import CachedParams, CacheKey, ParamCache, default_cache_dir
from support.table import each

KEY = CacheKey("px4", 3, 1, "00ff", "1.16.0")
PARAMS = (
    Param("A", float32(0.1)),
    Param("B", -(2**31), ParamType.INT32),
    Param("C", math.inf),
    Param("_HASH_CHECK", 2**32 - 1, ParamType.UINT32),
)


def test_what_is_stored_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    cache = ParamCache(tmp_path / "new" / "folder")
    assert cache.load(KEY) is None
    cache.store(KEY, CachedParams(PARAMS, 880957584))
    assert cache.load(KEY) == CachedParams(PARAMS, 880957584)
    assert [p.name for p in (tmp_path / "new" / "folder").iterdir()] == ["px4-3-1-00ff.json"]


@pytest.mark.parametrize(
    "change", [{"firmware": "1.16.1"}, {"board": "00fe"}, {"sysid": 4}, {"autopilot": "ardupilot"}]
)
def test_another_vehicle_or_firmware_has_none(tmp_path: Path, change: dict[str, object]) -> None:
    cache = ParamCache(tmp_path)
    cache.store(KEY, CachedParams(PARAMS, 1))
    assert cache.load(replace(KEY, **change)) is None  # type: ignore[arg-type]


def test_the_files_unused_for_longest_go_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(param_cache, "MAX_FILES", 3)
    cache = ParamCache(tmp_path)
    for sysid in (1, 2, 3):
        cache.store(replace(KEY, sysid=sysid), CachedParams(PARAMS, 1))
        os.utime(tmp_path / f"px4-{sysid}-1-00ff.json", (sysid, sysid))
    cache.load(replace(KEY, sysid=1))
    cache.store(replace(KEY, sysid=4), CachedParams(PARAMS, 1))
    assert sorted(p.name[4] for p in tmp_path.iterdir()) == ["1", "3", "4"]


@each("folder", ["file", None])
def test_a_folder_that_cannot_be_made_and_none_keep_nothing(tmp_path: Path, folder: str | None) -> None:
    (tmp_path / "file").write_text("")
    cache = ParamCache(None if folder is None else tmp_path / folder)
    cache.store(KEY, CachedParams(PARAMS, 1))
    assert cache.load(KEY) is None


def test_a_file_out_of_all_proportion_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = ParamCache(tmp_path)
    cache.store(KEY, CachedParams(PARAMS, 1))
    monkeypatch.setattr(param_cache, "MAX_FILE_BYTES", 10)
    assert cache.load(KEY) is None


def test_it_lies_where_caches_lie(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert default_cache_dir() == Path("/somewhere/skygcs/params")


async def test_a_full_disk_is_reported_once_until_it_takes_files_again(tmp_path: Path) -> None:
    events: list[Event] = []
    cache, folder = ParamCache(tmp_path / "folder"), tmp_path / "folder"
    cache.disk = disk = DiskWriter(asyncio.get_running_loop(), events.append)
    for full in (True, True, False, True):
        if full:
            folder.write_text("")  # in the place of the folder
        cache.store(KEY, CachedParams(PARAMS, 1))
        await disk.settled()
        folder.unlink() if full else shutil.rmtree(folder)
    await disk.close()
    text = "the parameter cache cannot be written: File exists; everything else goes on"
    assert [event.text for event in events] == [text] * 2
    assert (disk.status()["written"], disk.status()["failed"]) == (1, 3)
