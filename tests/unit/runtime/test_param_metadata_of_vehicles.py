"""Metadata of a vehicle's parameters in the running daemon: its own file, what is shipped, and hostile files."""

from __future__ import annotations

import asyncio
import json
import lzma
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skygcs.core.mavlink.frame import encode
from skygcs.core.params.metadata import MetadataTable, ParamMetadata
from skygcs.core.protocols.command import Outcome
from skygcs.core.protocols.ftp import FileOutcome
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime import param_metadata
from skygcs.runtime.param_cache import ParamCache
from skygcs.runtime.param_metadata import VehicleMetadata
from support.vehicles import ARDUPILOT, PX4, Voice, flight_dialect, parsed

pytestmark = pytest.mark.looptime

GENERAL, FILE = "etc/extras/component_general.json.xz", "etc/extras/parameters.json.xz"
PARAMETERS = {"parameters": [{"name": "MPC_XY_CRUISE", "min": 1, "max": 7, "units": "m/s", "shortDesc": "its own"}]}


def packed(document: Any) -> bytes:
    return lzma.compress(json.dumps(document).encode(), preset=1)


def mavlink_crc(data: bytes) -> int:
    """CRC32 of MAVLink FTP: reflected, from 0, without the last inversion; bit by bit, as PX4's generator has it."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc


@dataclass
class Board:
    """A vehicle with files on board, and what was asked of it."""

    cache: ParamCache
    files: dict[str, bytes] = field(default_factory=dict)
    rate: float | None = None
    autopilot: int = PX4
    uri: str = f"mftp://{GENERAL}"
    asked: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.vehicle = Vehicle(3, 1, flight_dialect())
        self.vehicle.on_frame(Voice(3).beat(self.autopilot), 0.0)
        self.services, self.params, self.request = SimpleNamespace(dialect=flight_dialect()), self, self._request
        self.metadata = VehicleMetadata(cast(Any, self))

    async def _request(self, message: str) -> Outcome:
        self.asked.append(message)
        info = flight_dialect().by_name[message]
        raw = encode(info, {"uri": self.uri, "file_crc": 1, "time_boot_ms": 1}, sysid=3, compid=1, seq=0)
        self.vehicle.on_frame(parsed(raw), 1.0)
        return cast(Any, SimpleNamespace(message="accepted"))

    async def file(self, path: str, *, max_bytes: int) -> FileOutcome:
        self.asked.append(path)
        await asyncio.sleep(0.1)
        data = self.files.get(path)
        if data is None or len(data) > max_bytes:
            return FileOutcome(False, "unknown", "it has no such file", b"", 1, 0.1)
        return FileOutcome(True, "accepted", "", data, 1, 0.1)

    @classmethod
    def with_file(cls, cache: ParamCache, document: Any = PARAMETERS, **rest: Any) -> Board:
        own = packed(document)
        entry = {"type": 1, "uri": f"mftp://{FILE}", "fileCrc": mavlink_crc(own)}
        return cls(cache, {GENERAL: packed({"version": 1, "metadataTypes": [entry]}), FILE: own}, **rest)


def test_the_crc_is_that_of_mavlink_ftp() -> None:
    data = bytes(range(256)) * 3
    assert zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF == mavlink_crc(data)


async def test_a_px4s_own_file_counts_and_is_read_once_for_all_of_its_build(tmp_path: Path) -> None:
    first = Board.with_file(ParamCache(tmp_path))
    assert first.metadata.refusals({"MPC_XY_CRUISE": 8}) == {}, "by the shipped table, before it was read"
    found = await first.metadata.read(insist=False)
    assert found["own"] and "own file" in found["source"] and found["why_not_own"] == ""
    assert first.asked == ["COMPONENT_METADATA", GENERAL, FILE]
    [refusal] = first.metadata.refusals({"MPC_XY_CRUISE": 8}).values()
    assert refusal.startswith("refused: 8 is outside its range of 1 to 7 m/s (its own); insist with force")
    await first.metadata.read(insist=True)
    assert len(first.asked) == 3
    again = Board.with_file(ParamCache(tmp_path))
    assert (await again.metadata.read(insist=False))["own"] and again.asked == ["COMPONENT_METADATA", GENERAL]
    first.metadata.on_reboot()  # it has rebooted, perhaps with another firmware
    assert first.metadata.refusals({"MPC_XY_CRUISE": 8}) == {}


async def test_without_a_cache_folder_its_table_is_kept_in_memory() -> None:
    board = Board.with_file(ParamCache(None))
    assert (await board.metadata.read(insist=False))["own"] and board.metadata.refusals({"MPC_XY_CRUISE": 8})


async def test_over_a_slow_link_it_is_read_on_request_only(tmp_path: Path) -> None:
    board = Board.with_file(ParamCache(tmp_path), rate=2880.0)
    found = await board.metadata.read(insist=False)
    assert not found["own"] and board.asked == [] and "PX4" in found["source"]
    assert (await board.metadata.read(insist=True))["own"]


@pytest.mark.parametrize(
    ("board", "why"),
    [
        (Board(ParamCache(None), autopilot=ARDUPILOT), "its firmware has none on board"),
        (Board(ParamCache(None)), "it has no such file"),
        (Board(ParamCache(None), uri="https://host/general.json"), "its general metadata is not on board"),
        (Board(ParamCache(None), {GENERAL: b"\xfd7zXZ\x00rubbish"}), "it cannot be unpacked"),
        (Board(ParamCache(None), {GENERAL: packed({})[:-9]}), "it is not whole"),
        (Board(ParamCache(None), {GENERAL: b"{" * 5000}), "it is not JSON"),
        (Board(ParamCache(None), {GENERAL: b"[1]"}), "name no parameter file"),
        (Board.with_file(ParamCache(None), {"parameters": "none"}), "it has no parameters"),
        (Board.with_file(ParamCache(None), "x" * 17_000_000), "it is not whole, or larger than 16 MiB"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
async def test_what_cannot_be_used_leaves_the_shipped_table(board: Board, why: str) -> None:
    found = await board.metadata.read(insist=False)
    assert not found["own"] and why in found["why_not_own"]
    asked = len(board.asked)
    assert (await board.metadata.read(insist=False))["why_not_own"] == found["why_not_own"]
    assert len(board.asked) == asked, "it is not tried again before its next start"
    family = "ArduPilot" if board.autopilot == ARDUPILOT else "PX4"
    assert family in found["source"] and board.metadata.of(["MPC_XY_CRUISE", "WPNAV_SPEED"])


async def test_a_file_that_does_not_have_the_crc_it_claims_is_not_kept_under_it(tmp_path: Path) -> None:
    """Else one vehicle could change the ranges of all that have that build."""
    claimed = mavlink_crc(packed(PARAMETERS))
    lax = Board.with_file(ParamCache(tmp_path), {"parameters": [{"name": "MPC_XY_CRUISE", "max": 1e9}]})
    entry = {"type": 1, "uri": f"mftp://{FILE}", "fileCrc": claimed}
    lax.files[GENERAL] = packed({"metadataTypes": [entry]})
    await lax.metadata.read(insist=False)
    honest = Board.with_file(ParamCache(tmp_path))
    await honest.metadata.read(insist=False)
    assert FILE in honest.asked and honest.metadata.refusals({"MPC_XY_CRUISE": 8})


async def test_nothing_of_a_table_stays_in_memory(tmp_path: Path) -> None:
    board = Board.with_file(ParamCache(tmp_path))
    await board.metadata.read(insist=False)
    assert board.metadata.outside([]) == {} and board.metadata._uncached == b""
    assert not [name for name, value in vars(param_metadata).items() if isinstance(value, bytes) and len(value) > 100]


async def test_notes_say_what_a_change_needs(tmp_path: Path) -> None:
    board = Board(ParamCache(tmp_path), rate=1.0)
    assert board.metadata.notes({"MAV_SYS_ID": 3, "MPC_XY_CRUISE": 5}) == {
        "MAV_SYS_ID": "it takes effect after a reboot"
    }
    assert "outside its range" in board.metadata.notes({"MPC_XY_CRUISE": 500})["MPC_XY_CRUISE"]


def test_many_names_are_looked_up_in_one_pass_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pass for each of 250 names took 0.4 s, of each vehicle."""
    passes: list[int] = []
    of = MetadataTable.of

    def counted(table: MetadataTable, names: Iterable[str]) -> dict[str, ParamMetadata]:
        passes.append(1)
        return of(table, names)

    monkeypatch.setattr(MetadataTable, "of", counted)
    board = Board.with_file(ParamCache(None))
    known = board.metadata.of(name for name in ("MPC_XY_CRUISE", "MPC_XY_VEL_MAX", "NO_SUCH"))
    assert set(known) == {"MPC_XY_CRUISE", "MPC_XY_VEL_MAX"} and len(passes) == 1
