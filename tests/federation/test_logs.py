"""Recordings of other sites through a real hub: whole, continued after an end, checked, and nothing else is given."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import random
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from skygcs.errors import BusError, SkygcsError
from skygcs.ext.federation.bridge.bus import Bus
from skygcs.ext.federation.bridge.hub_config import LOGS
from skygcs.ext.federation.bridge.logs import MAX_FILES, PART_BYTES, LogCollector, SiteLogs
from support.hub import Hub
from support.made_logs import made

LONG = 2 * PART_BYTES + 12_345


@contextlib.asynccontextmanager
async def offered(hub: Hub, folder: Path, *, reader: str = "boss") -> AsyncIterator[tuple[SiteLogs, Bus]]:
    """A site that offers a folder, and the hub as another station has it."""
    async with hub.bus("south") as south, hub.bus(reader) as bus:
        logs = SiteLogs(south, "south", "run1", folder)
        running = asyncio.create_task(logs.run())
        await asyncio.sleep(0.1)
        try:
            yield logs, bus
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two recordings, and what is none."""
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "long.tlog").write_bytes(random.Random(1).randbytes(LONG))
    (folder / "empty.tlog").write_bytes(b"")
    (folder / "secret.txt").write_text("not yours")
    (folder / "link.tlog").symlink_to(folder / "secret.txt")
    os.utime(folder / "empty.tlog", (1e9, 1e9))
    return folder


async def test_recordings_come_whole_and_a_second_time_nothing_is_sent(hub: Hub, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    async with offered(hub, folder) as (logs, bus):
        lines: list[str] = []
        done = await LogCollector(bus, out, lines.append).collect(["south"])
        assert done.problems == [] and done.fetched_bytes == LONG
        assert sorted(path.name for path in (out / "south").iterdir()) == ["empty.tlog", "long.tlog"]
        assert (out / "south" / "long.tlog").read_bytes() == (folder / "long.tlog").read_bytes()
        assert (out / "south" / "empty.tlog").stat().st_mtime == 1e9
        parts = logs.counters["parts"]
        again = await LogCollector(bus, out, lines.append).collect(["south"])
        assert len(again.files) == 2 and again.fetched_bytes == 0 and logs.counters["parts"] == parts
        newer = await LogCollector(bus, tmp_path / "newer", lines.append).collect(["south"], since_unix_s=1.1e9)
        assert [path.name for path in newer.files] == ["long.tlog"]


async def test_a_collection_that_was_broken_off_and_a_log_that_grew_go_on_where_they_end(
    hub: Hub, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out" / "south"
    out.mkdir(parents=True)
    whole = (folder / "long.tlog").read_bytes()
    (out / "long.tlog.part").write_bytes(whole[: PART_BYTES + 7])  # killed in the middle of a write
    async with offered(hub, folder) as (_, bus):
        done = await LogCollector(bus, out.parent, print).collect(["south"])
        assert done.problems == [] and done.fetched_bytes == LONG - PART_BYTES - 7
        assert (out / "long.tlog").read_bytes() == whole
        (folder / "long.tlog").write_bytes(whole + b"more")
        done = await LogCollector(bus, out.parent, print).collect(["south"])
        assert done.fetched_bytes == 4 and (out / "long.tlog").read_bytes() == whole + b"more"


async def test_what_is_not_as_it_is_at_the_site_is_thrown_away_and_said(hub: Hub, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out" / "south"
    out.mkdir(parents=True)
    (out / "long.tlog.part").write_bytes(b"of another file")
    (out / "empty.tlog").write_bytes(b"longer than there")
    async with offered(hub, folder) as (_, bus):
        done = await LogCollector(bus, out.parent, print).collect(["south"])
        assert len(done.problems) == 2
        assert any("long.tlog: it differs from the one at the site" in problem for problem in done.problems)
        assert any("is longer than at the site" in problem for problem in done.problems)
        assert not (out / "long.tlog.part").exists() and not (out / "long.tlog").exists()
        assert (out / "empty.tlog").read_bytes() == b"longer than there"
        await LogCollector(bus, out.parent, print).collect(["south"])
        assert (out / "long.tlog").read_bytes() == (folder / "long.tlog").read_bytes()


@pytest.mark.parametrize(
    "question",
    [
        {"part": {"name": "../secret.txt", "offset": 0}},
        {"part": {"name": "secret.txt", "offset": 0}},
        {"part": {"name": "/etc/passwd", "offset": 0}},
        {"part": {"name": "long.tlog", "offset": -1}},
        {"part": {"name": "long.tlog", "offset": 1 << 60}},
        {"part": {"name": "none.tlog", "offset": 0}},
        {"sum": {"name": "long.tlog", "bytes": 1 << 60}},
        {"list": {}},
        {"delete": {"name": "long.tlog"}},
    ],
)
async def test_nothing_but_recordings_can_be_asked_for(
    hub: Hub, folder: Path, question: dict[str, object], tmp_path: Path
) -> None:
    async with offered(hub, folder) as (logs, bus):
        with pytest.raises(SkygcsError):
            await LogCollector(bus, tmp_path / "out", print)._ask("south", question, 10.0)
        assert logs.counters["errors"] == 1 and logs.counters["parts"] == 0


async def test_an_observer_gets_none_and_a_site_that_is_away_stops_no_other(
    hub: Hub, folder: Path, tmp_path: Path
) -> None:
    async with offered(hub, folder, reader="visitor") as (logs, bus):
        done = await LogCollector(bus, tmp_path / "out", print).collect(["south"])
        assert len(done.problems) == 1 and logs.counters["lists"] == 0
    async with offered(hub, folder) as (_, bus):
        done = await LogCollector(bus, tmp_path / "out", print).collect(["east", "south"])
        assert len(done.problems) == 1 and done.problems[0].startswith("east: ") and len(done.files) == 2


async def test_a_part_that_was_changed_on_its_way_is_not_taken(
    hub: Hub, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with offered(hub, folder) as (_, bus):
        collector = LogCollector(bus, tmp_path, print)
        answer = await collector._ask("south", {"part": {"name": "long.tlog", "offset": 0}}, 30.0)
        assert len(await collector._read_object(answer["object"])) == PART_BYTES
        jetstream = bus.jetstream()
        real = jetstream.get_msg

        async def changed(*args: object, **more: object) -> object:
            message = await real(*args, **more)  # type: ignore[arg-type]
            if more.get("next"):
                message.data = b"x" + (message.data or b"")[1:]
            return message

        monkeypatch.setattr(jetstream, "get_msg", changed)
        monkeypatch.setattr(bus, "jetstream", lambda: jetstream)
        with pytest.raises(BusError, match="was changed in the store"):
            await collector._read_object(answer["object"])


@pytest.mark.parametrize(
    "changes",
    [
        {"chunks": "3"},
        {"chunks": 1 << 20, "size": 1},
        {"chunks": -1},
        {"chunks": None, "mtime": [], "description": {}},
        {"chunks": True},
        {"nuid": "*"},
        {"nuid": "a\r\nb"},
        {"nuid": ["x"]},
        {"digest": 7, "chunks": 1.5},
        {"options": "link"},
        None,
        [],
    ],
)
async def test_a_part_that_is_described_as_none_is_one_problem_and_stops_no_other(
    hub: Hub, folder: Path, tmp_path: Path, changes: object
) -> None:
    """Any site may write any description into the store."""
    async with offered(hub, folder) as (logs, bus), hub.bus("south") as south:
        real = logs._offer

        async def described_otherwise(path: Path, offset: int) -> dict[str, object]:
            answer = await real(path, offset)
            info = await (await south.object_store(LOGS)).get_info(answer["object"])
            found = {**info.as_dict(), **changes} if isinstance(changes, dict) else changes
            subject = f"$O.{LOGS}.M.{base64.urlsafe_b64encode(info.name.encode()).decode()}"
            await south.jetstream().publish(
                subject, b"" if found is None else json.dumps(found).encode(), headers={"Nats-Rollup": "sub"}
            )
            return answer

        logs._offer = described_otherwise  # type: ignore[method-assign]
        done = await LogCollector(bus, tmp_path / "out", print).collect(["south"])
        assert [path.name for path in done.files] == ["empty.tlog"]
        (problem,) = done.problems
        assert problem.startswith("south/long.tlog: ") and "is not a part of a log" in problem
        assert logs.counters["parts"] == 1  # another attempt would not change it


@pytest.mark.parametrize("name", [None, 7, [], "", "a/b", "a\x1b[2J", "\u202e", "x" * 129])
async def test_an_object_of_another_name_is_one_problem(hub: Hub, folder: Path, tmp_path: Path, name: object) -> None:
    async with offered(hub, folder) as (logs, bus):

        async def named_otherwise(path: Path, offset: int) -> dict[str, object]:
            return {"object": name, "bytes": 1}

        logs._offer = named_otherwise  # type: ignore[method-assign]
        done = await LogCollector(bus, tmp_path / "out", print).collect(["south"])
        assert done.problems == ["south/long.tlog: the site sent an invalid name of an object"]


async def test_a_list_is_bounded_and_has_the_newest(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "many"
    folder.mkdir()
    for n in range(MAX_FILES + 3):
        (folder / f"{n}.tlog").touch()
        os.utime(folder / f"{n}.tlog", (1e9 + n, 1e9 + n))
    async with offered(hub, folder) as (_, bus):
        answer = await LogCollector(bus, tmp_path, print)._ask("south", {"list": {"since_unix_s": 0}}, 30.0)
    assert len(answer["files"]) == MAX_FILES and answer["more"]
    assert answer["files"][0]["name"] == f"{MAX_FILES + 2}.tlog"


async def test_the_command_writes_tables_that_hold_what_the_recordings_hold(hub: Hub, tmp_path: Path) -> None:
    """pyarrow reads the tables, pymavlink the recordings: every position, once."""
    import pyarrow.parquet as parquet
    from pymavlink import mavutil

    folder, out = tmp_path / "logs", tmp_path / "out"
    folder.mkdir()
    for name in ("made-plane.tlog", "made-submarine.tlog"):
        (folder / name).write_bytes(made(name)[0])
    fleet = tmp_path / "boss.toml"
    fleet.write_text(
        f'[federation]\nrole = "operator"\nservers = ["{hub.url}"]\nnkey = "{hub.key_file("boss")}"\n', encoding="utf-8"
    )
    code = "import sys; from skygcs.cli.main import main; sys.argv[0] = 'skygcs-cli'; main()"
    words = ["federation", "logs", "--parquet", "--fleet", str(fleet), "south", str(out)]
    async with offered(hub, folder):
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-c", code, *words), stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
        output = (await process.communicate())[0].decode()
    assert process.returncode == 0 and "2 logs complete" in output, output
    for log in (out / "south").glob("*.tlog"):
        reader = mavutil.mavlink_connection(str(log))
        positions = []
        while (message := reader.recv_match(type="GLOBAL_POSITION_INT")) is not None:
            positions.append(message.lat / 1e7)
        reader.close()
        (file,) = (out / "south").glob(f"{log.stem}-*.parquet")
        read = [lat for lat in parquet.read_table(file).column("lat").to_pylist() if lat is not None]
        assert len(positions) == made(log.name)[1]["types"]["GLOBAL_POSITION_INT"] == len(read)
        assert read == pytest.approx(positions, abs=1e-9)
    assert len(list((out / "south").glob("*.parquet"))) == 2
