"""Map tiles of a local file: what is read of MBTiles and PMTiles, what is refused, and that nothing grows."""

from __future__ import annotations

import asyncio
import gzip
import io
import os
import random
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image
from pmtiles.reader import MmapSource, Reader
from pmtiles.tile import Compression, TileType, deserialize_directory, zxy_to_tileid

from skygcs.web import map_tiles
from skygcs.web.http_server import tile_response
from skygcs.web.map_tiles import MAX_WAITING, MapTiles, TilesBusyError, open_tiles
from skygcs.web.pmtiles_file import MAX_ENTRIES, PmtilesFile, directory_of, tile_id
from skygcs.web.tile_set import (
    MAX_TILE_BYTES,
    TileFileError,
    TileRefusedError,
    TileSet,
    attribution_of,
    bounds_of,
    is_tile,
    picture_type,
)
from support.map_files import claimed_png, png, write_mbtiles, write_pmtiles
from support.table import each

RED = png(16, (200, 30, 30))
BLUE = png(16, (30, 30, 200))
TILES = {(3, 1, 2): RED, (3, 2, 2): BLUE, (5, 9, 11): BLUE}


def picture(kind: str, width: int, height: int, **options: object) -> bytes:
    body = io.BytesIO()
    Image.new("RGB", (width, height), (10, 120, 60)).save(body, kind, **options)  # type: ignore[arg-type]
    return body.getvalue()


# -- pictures, against Pillow


@each(
    ("kind", "options"),
    [
        ("PNG", {}),
        ("JPEG", {}),
        ("JPEG", {"progressive": True}),
        ("JPEG", {"comment": b"\xff\xc0 no frame"}),
        ("WEBP", {}),
        ("WEBP", {"lossless": True}),
        ("WEBP", {"exif": b"Exif\0\0II*\0\x08\0\0\0\0\0\0\0\0\0"}),
    ],
)
@each(("width", "height"), [(256, 256), (512, 511), (1, 3)])
def test_the_size_of_a_picture_is_that_of_pillow(
    kind: str, options: dict[str, object], width: int, height: int
) -> None:
    body = picture(kind, width, height, **options)
    content_type, width_px = picture_type(body)
    with Image.open(io.BytesIO(body)) as read:
        assert (content_type, width_px) == (Image.MIME[str(read.format)], read.width)


@each(
    ("body", "why"),
    [
        (b"", "neither PNG, JPEG nor WebP"),
        (b"<svg onload='alert(1)'/>", "neither PNG, JPEG nor WebP"),
        (gzip.compress(b"vector", mtime=0), "a vector tile"),
        (claimed_png(40_000, 40_000), "40000 x 40000 pixels"),
        (picture("JPEG", 1025, 8), "1025 x 8 pixels"),
        (picture("WEBP", 8, 1025), "8 x 1025 pixels"),
        (RED + bytes(MAX_TILE_BYTES), "larger than 1 MiB"),
        (RED[:20], "without a size"),
        (b"\xff\xd8\xff\xe0\x00", "without a size"),
        (b"RIFF\0\0\0\0WEBPVP8 ", "without a size"),
    ],
)
def test_what_is_no_picture_of_a_tile_is_refused(body: bytes, why: str) -> None:
    with pytest.raises(TileRefusedError, match=why):
        picture_type(body)


def test_no_bytes_of_a_picture_raise_anything_else() -> None:
    dice = random.Random(5)
    for body in (RED, picture("JPEG", 64, 64), picture("WEBP", 64, 64)):
        for _ in range(300):
            broken = bytearray(body[: dice.randrange(len(body) + 1)])
            for _ in range(dice.randrange(4)):
                if broken:
                    broken[dice.randrange(min(len(broken), 40))] = dice.randrange(256)
            try:
                picture_type(bytes(broken))
            except TileRefusedError:
                continue


# -- the two files


WRITERS: dict[str, Callable[..., Path]] = {"field.mbtiles": write_mbtiles, "field.pmtiles": write_pmtiles}


@each("name", WRITERS)
def test_tiles_are_read_by_zoom_column_and_row_from_the_north(tmp_path: Path, name: str) -> None:
    tiles = open_tiles(WRITERS[name](tmp_path / name, TILES, attribution="&copy; <a href='https://x'>X</a>\n  Y"))
    assert {place: tiles.read(*place) for place in TILES} == TILES
    assert tiles.read(3, 1, 5) is None and tiles.read(3, 2, 1) is None and tiles.read(4, 0, 0) is None
    info = tiles.info
    assert (info.min_zoom, info.max_zoom, info.tile_px, info.attribution) == (3, 5, 16, "© X Y")
    tiles.close()


def test_mbtiles_may_be_a_view_and_say_its_bounds(tmp_path: Path) -> None:
    path = write_mbtiles(tmp_path / "f.mbtiles", TILES, bounds="-79.5,43.7,-79.4,43.9", format="jpg")
    base = sqlite3.connect(path)
    base.executescript(
        """CREATE TABLE images (tile_data BLOB, tile_id TEXT);
        CREATE TABLE map (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_id TEXT);
        INSERT INTO images SELECT DISTINCT tile_data, hex(tile_data) FROM tiles;
        INSERT INTO map SELECT zoom_level, tile_column, tile_row, hex(tile_data) FROM tiles;
        DROP TABLE tiles;
        CREATE VIEW tiles AS SELECT map.zoom_level AS zoom_level, map.tile_column AS tile_column,
            map.tile_row AS tile_row, images.tile_data AS tile_data
            FROM map JOIN images ON images.tile_id = map.tile_id;"""
    )
    base.close()
    tiles = open_tiles(path)
    assert tiles.info.bounds_deg == (-79.5, 43.7, -79.4, 43.9)
    assert tiles.read(3, 1, 2) == RED
    tiles.close()


def test_a_name_with_what_an_address_would_cut_off(tmp_path: Path) -> None:
    folder = tmp_path / "a?mode=rw#x %41"
    folder.mkdir()
    tiles = open_tiles(write_mbtiles(folder / "f ü.mbtiles", TILES))
    assert tiles.read(3, 1, 2) == RED
    tiles.close()
    assert sorted(os.listdir(folder)) == ["f ü.mbtiles"]  # nothing is written beside it


def test_pmtiles_with_leaf_directories_as_the_packages_own_reader(tmp_path: Path) -> None:
    dice = random.Random(3)
    tiles = {}
    while len(tiles) < 7_000:
        place = (12, dice.randrange(4096), dice.randrange(4096))
        tiles[place] = RED[:-1] + bytes([dice.randrange(256)])
    path = write_pmtiles(tmp_path / "f.pmtiles", tiles)
    read = open_tiles(path)
    with open(path, "rb") as file:
        theirs = Reader(MmapSource(file))
        assert theirs.header()["leaf_directory_length"] > 0
        for place in [*list(tiles)[:30], *((12, n, 7 * n) for n in range(30)), (11, 0, 0), (13, 0, 0)]:
            assert read.read(*place) == theirs.get(*place)
    read.close()


def test_ids_of_tiles_are_those_of_the_package() -> None:
    dice = random.Random(7)
    for _ in range(2000):
        zoom = dice.randrange(25)
        place = (zoom, dice.randrange(1 << zoom), dice.randrange(1 << zoom))
        assert tile_id(*place) == zxy_to_tileid(*place)


def test_tiles_that_are_compressed_besides_are_decompressed_within_a_bound(tmp_path: Path) -> None:
    packed = {(1, 0, 0): gzip.compress(RED), (1, 1, 0): gzip.compress(RED + bytes(8 * MAX_TILE_BYTES))}
    tiles = open_tiles(write_pmtiles(tmp_path / "f.pmtiles", packed, compression=Compression.GZIP))
    assert tiles.read(1, 0, 0) == RED
    with pytest.raises(TileFileError, match="cut off, or larger than 1,048,576 bytes"):
        tiles.read(1, 1, 0)
    tiles.close()


# -- bad files: the error names the file and the key


def sql(*statements: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        base = sqlite3.connect(path)
        for statement in statements:
            base.execute(statement)
        base.commit()
        base.close()

    return write


EMPTY = "CREATE TABLE metadata (name, value)", "CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data)"

ENDLESS = (
    "CREATE TABLE metadata (name, value)",
    "CREATE VIEW tiles AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
    "SELECT 1 AS zoom_level, i AS tile_column, 0 AS tile_row, x'00' AS tile_data FROM n WHERE i < 0",
)


def _made(data: str, of: str = "") -> str:
    return f"CREATE VIEW tiles AS SELECT 1 AS zoom_level, 0 AS tile_column, 0 AS tile_row, {data} AS tile_data {of}"


HUGE = (
    "CREATE TABLE metadata (name, value)",
    "CREATE VIEW tiles AS WITH RECURSIVE n(i, b) AS (SELECT 1, zeroblob(1000000) UNION "
    "SELECT i + 1, zeroblob(1000000 - i % 1000) FROM n) "
    "SELECT i AS zoom_level, 0 AS tile_column, 0 AS tile_row, b AS tile_data FROM n",
)
"""Keeps each of its rows to find equal ones: gigabytes of temporary file within few steps."""

PRODUCT = (
    "CREATE TABLE metadata (name, value)",
    "CREATE TABLE map (zoom_level, tile_id)",
    "CREATE TABLE images (tile_data)",
    "INSERT INTO map WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 3000) SELECT 1, i FROM n",
    "INSERT INTO images VALUES (zeroblob(100000))",
    "CREATE VIEW tiles AS SELECT map.zoom_level AS zoom_level, map.tile_id AS tile_column, 0 AS tile_row, "
    "images.tile_data AS tile_data FROM map, map AS other, map AS third, images "
    "WHERE other.tile_id + third.tile_id < 0",
)

KEPT = (
    "CREATE TABLE metadata (name, value)",
    "CREATE TABLE images (tile_id, tile_data)",
    "INSERT INTO images WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 60) "
    "SELECT i, randomblob(100000) FROM n",
    "CREATE VIEW tiles AS SELECT DISTINCT one.tile_id AS zoom_level, other.tile_id AS tile_column, 0 AS tile_row, "
    "one.tile_data || other.tile_data AS tile_data FROM images AS one, images AS other",
)
"""720 MB of rows, kept to find equal ones."""

BAD: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda path: None, "No such file"),
    "folder": (lambda path: path.mkdir(), "Is a directory"),
    "pipe": (os.mkfifo, "not a regular file"),
    "empty": (lambda path: path.write_bytes(b""), "neither MBTiles nor PMTiles"),
    "a picture": (lambda path: path.write_bytes(RED), "neither MBTiles nor PMTiles"),
    "no database": (lambda path: path.write_bytes(b"SQLite format 3\0" + bytes(4096)), "no MBTiles file"),
    "another schema": (sql("CREATE TABLE shopping (item)"), "no such table: metadata"),
    "other columns": (sql(EMPTY[0], "CREATE TABLE tiles (z, x, y)"), "no such column: zoom_level"),
    "no tiles": (sql(*EMPTY), "has no tiles"),
    "endless": (sql(*ENDLESS), "its tiles need a recursion"),
    "huge blobs without end": (sql(*HUGE), "its tiles need"),
    "a function": (sql(EMPTY[0], _made("zeroblob(1000000)")), "its tiles need 'zeroblob'"),
    "a table of its own": (sql(EMPTY[0], "CREATE TABLE loot (x)", _made("x", "FROM loot")), "its tiles need 'loot'"),
    "the schema": (sql(EMPTY[0], _made("sql", "FROM sqlite_master")), "its tiles need 'sqlite_master'"),
    "a product": (sql(*PRODUCT), "a tile takes too long to find"),
    "a product that is kept": (sql(*KEPT), "more than 64 MiB"),
    "words for zooms": (sql(*EMPTY, "INSERT INTO tiles VALUES ('a', 0, 0, x'00')"), "zooms a to a"),
    "text for a tile": (sql(*EMPTY, "INSERT INTO tiles VALUES (1, 0, 0, 'text')"), "no picture"),
    "vector MBTiles": (lambda path: write_mbtiles(path, TILES, format="pbf"), "vector tiles"),
    "other MBTiles": (lambda path: write_mbtiles(path, TILES, format="tiff"), "format 'tiff'"),
    "vectors without a name": (lambda path: write_mbtiles(path, {(1, 0, 0): gzip.compress(b"x")}), "a vector tile"),
    "a huge first tile": (
        lambda path: write_mbtiles(path, {(1, 0, 0): RED + bytes(MAX_TILE_BYTES)}),
        "larger than 1 MiB",
    ),
    "huge pixels": (lambda path: write_mbtiles(path, {(1, 0, 0): claimed_png(9999, 9999)}), "9999 x 9999 pixels"),
    "vector PMTiles": (lambda path: write_pmtiles(path, TILES, TileType.MVT), "vector tiles"),
    "AVIF": (lambda path: write_pmtiles(path, TILES, TileType.AVIF), "AVIF"),
    "Brotli": (lambda path: write_pmtiles(path, TILES, compression=Compression.BROTLI), "Brotli"),
    "PMTiles of version 2": (lambda path: path.write_bytes(b"PMTiles\x02" + bytes(200)), "version 2"),
    "a header alone": (lambda path: path.write_bytes(b"PMTiles\x03"), "ends too early"),
    "half": (lambda path: write_pmtiles(path, TILES).write_bytes(path.read_bytes()[:150]), "ends too early"),
}


@each("name", BAD)
def test_a_bad_file_is_refused_with_its_name_and_the_key(tmp_path: Path, name: str) -> None:
    write, why = BAD[name]
    path = tmp_path / "field.tiles"
    write(path)
    with pytest.raises((TileFileError, TileRefusedError)) as caught:
        open_tiles(path)
    assert isinstance(caught.value, TileFileError), caught.value
    assert str(caught.value).startswith(f"web.tiles {path}: ")
    assert why in str(caught.value)


def test_no_bytes_of_a_pmtiles_file_raise_anything_else(tmp_path: Path) -> None:
    whole = write_pmtiles(tmp_path / "f.pmtiles", TILES).read_bytes()
    dice = random.Random(11)
    path = tmp_path / "broken.pmtiles"
    for _ in range(400):
        broken = bytearray(whole)
        for _ in range(dice.randrange(1, 5)):
            broken[dice.randrange(8, min(len(broken), 260))] = dice.choice(
                [0, 1, 2, 127, 128, 255, dice.randrange(256)]
            )
        path.write_bytes(broken[: dice.choice([len(broken), dice.randrange(len(broken))])])
        try:
            tiles = PmtilesFile(path)
        except TileFileError:
            continue
        for place in TILES:
            try:
                tiles.read(*place)
            except (TileFileError, TileRefusedError):
                continue
        tiles.close()


def test_a_directory_is_read_as_the_package_reads_it_and_no_more_than_its_bound() -> None:
    data = bytes([3, 5, 1, 128, 1, 1, 2, 0, 10, 20, 30, 1, 0, 7])
    ours = directory_of(data)
    theirs = deserialize_directory(gzip.compress(data))
    assert [*zip(ours.ids, ours.runs, ours.sizes, ours.offsets, strict=True)] == [
        (e.tile_id, e.run_length, e.length, e.offset) for e in theirs
    ]
    count = MAX_ENTRIES + 1
    with pytest.raises(ValueError, match="65,537 entries"):
        directory_of(bytes([count & 0x7F | 0x80, count >> 7 & 0x7F | 0x80, count >> 14]))
    with pytest.raises(ValueError, match="cut off"):
        directory_of(b"\xff" * 20)


# -- served


def test_a_file_is_opened_in_the_thread_that_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mbtiles(tmp_path / "f.mbtiles", TILES)
    threads = []

    def opening(path: Path) -> TileSet:
        threads.append(threading.current_thread().name)
        return open_tiles(path)

    monkeypatch.setattr(map_tiles, "open_tiles", opening)

    async def opened() -> tuple[str, bytes] | None:
        tiles = await MapTiles.opened(path)
        found = await tiles.read(3, 1, 2)
        tiles.close()
        return found

    assert asyncio.run(opened()) == ("image/png", RED)
    assert [name.startswith("map tiles") for name in threads] == [True]


def run(tiles: MapTiles, *places: tuple[int, int, int]) -> list[tuple[str, bytes] | type[Exception] | None]:
    async def answer(place: tuple[int, int, int]) -> tuple[str, bytes] | type[Exception] | None:
        try:
            return await tiles.read(*place)
        except (TilesBusyError, TileRefusedError) as error:
            return type(error)

    async def all_at_once() -> list[tuple[str, bytes] | type[Exception] | None]:
        return await asyncio.gather(*map(answer, places))

    return asyncio.run(all_at_once())


def test_a_picture_none_and_one_that_is_not_drawn_are_three_answers(tmp_path: Path) -> None:
    path = write_mbtiles(tmp_path / "f.mbtiles", TILES | {(3, 3, 3): b"<html>", (3, 4, 4): RED + bytes(MAX_TILE_BYTES)})
    tiles = MapTiles(open_tiles(path), path)
    places = [(3, 1, 2), (3, 0, 0), (3, 3, 3), (3, 4, 4), (3, 8, 0), (3, -1, 0), (99, 0, 0)]
    assert run(tiles, *places) == [("image/png", RED), None, *[TileRefusedError] * 2, *[None] * 3]
    assert tiles.counts == {"served": 1, "none": 1, "refused": 2, "overrun": 0}
    tiles.close()


def test_requests_beyond_the_bound_are_to_come_again(tmp_path: Path) -> None:
    path = write_mbtiles(tmp_path / "f.mbtiles", TILES)
    tiles = MapTiles(open_tiles(path), path)
    found = run(tiles, *[(3, 1, 2)] * (MAX_WAITING + 40))
    assert found.count(TilesBusyError) == 40 and tiles.counts["overrun"] == 40
    assert run(tiles, (3, 1, 2)) == [("image/png", RED)]  # and it goes on
    tiles.close()


def test_a_browser_is_told_what_to_ask_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mbtiles(tmp_path / "f.mbtiles", TILES | {(3, 3, 3): b"<html>"})
    tiles = MapTiles(open_tiles(path), path)

    async def answers() -> list[tuple[int, str | None]]:
        places = [(3, 1, 2), (3, 0, 0), (3, 3, 3)]
        found = [await tile_response(tiles, *place) for place in places]
        monkeypatch.setattr(map_tiles, "MAX_WAITING", 0)
        found.append(await tile_response(tiles, *places[0]))
        return [(response.status, response.headers.get("Retry-After")) for response in found]

    assert asyncio.run(answers()) == [(200, None), (204, None), (422, None), (503, "1")]
    tiles.close()


def test_a_file_that_is_cut_off_later_is_no_tile_and_no_end(tmp_path: Path) -> None:
    path = write_pmtiles(tmp_path / "f.pmtiles", TILES)
    tiles = MapTiles(open_tiles(path), path)
    os.truncate(path, 200)
    assert run(tiles, *[(5, 9, 11)] * 30) == [TileRefusedError] * 30
    assert tiles.counts["refused"] == 30
    tiles.close()


def test_its_address_is_another_one_for_another_file(tmp_path: Path) -> None:
    path = write_mbtiles(tmp_path / "f.mbtiles", TILES)
    first = MapTiles(open_tiles(path), path)
    os.utime(path, ns=(1, 123_456_789))
    second = MapTiles(open_tiles(path), path)
    assert first.as_dict()["url"] != second.as_dict()["url"]
    first.close()
    second.close()


def test_places_areas_and_words() -> None:
    assert is_tile(0, 0, 0) and is_tile(24, (1 << 24) - 1, 0)
    assert not any(is_tile(*place) for place in [(-1, 0, 0), (25, 0, 0), (3, 8, 0), (3, 0, 8), (3, -1, 0)])
    assert bounds_of(["-1", "-2", "3", "4"]) == (-1, -2, 3, 4)
    assert [bounds_of(text) for text in ([], ["a"] * 4, [3, 0, 1, 2], [0, 0, 999, 1], None, ["nan"] * 4)] == [None] * 6
    assert attribution_of(17) == "" and len(attribution_of("x" * 10_000)) == 200
    assert attribution_of("<script>alert(1)</script>") == "alert(1)"
