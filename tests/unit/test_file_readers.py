"""Every reader of files: whatever is in one, it gives values or problems, never another exception.

One Hypothesis test over all of them. Valid files are changed where it matters: values of JSON and TOML by values of
other types and sizes, numbers in text by numbers that are none or too large, members of a zip, lines, bytes.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import tomllib
import zipfile
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.cli import fleet_files, missions, params
from skygcs.config import files
from skygcs.config.loader import load_fleet
from skygcs.config.router_import import import_router
from skygcs.core.geo import Origin
from skygcs.core.mission.formats import read_plan
from skygcs.core.params import param_file
from skygcs.core.plan import plan_files
from skygcs.core.plan.fleet_plan import FlightSpace, TimedPlan
from skygcs.core.plan.plan_json import write_plan_json
from skygcs.core.plan.skyc import write_skyc
from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.core.trajectory import Piece as _Piece
from skygcs.errors import SkygcsError
from skygcs.ext.federation.hub_inventory import load_inventory
from skygcs.ext.plans.position_table import parse_table
from skygcs.spelling import parse_toml
from support.table import each

ORIGIN = Origin(47.4, 8.5, 400.0)

ODD: list[Any] = [
    *(None, True, "", "x", "\x00", "\x1b[2J", "ü" * 300, [], {}, [[]], [{}], [0], {"": []}),
    *(0, -1, 1.5, 256, 2**31, 2**63, 10**400, -(10**400), 1e308, -1e308, 1e-320, float("nan"), float("inf")),
    *([0, 0], [1e9, 1e9], ["a", "b"], [None, None], [[], []], {"$ref": "./show.json#"}, [0] * 3000),
]

ODD_WORDS = [
    "",
    "x",
    "-",
    "4" * 400,
    "-" + "9" * 60,
    "1e999",
    "nan",
    "inf",
    "0x",
    "²",
    "1_0",
    '"',
    "\x00",
    "\ufeff",
    ",",
]

LINE = _Piece(4.0, (0.0, 1.0) + (0.0,) * 6, (0.0,) * 8, (5.0,) + (0.0,) * 7, (0.0,) * 8)
PATHS = {"alpha": Trajectory([LINE, LINE]), "bravo": Trajectory([LINE])}

PLAN = json.dumps(
    {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": 12,
            "vehicleType": 2,
            "cruiseSpeed": 15,
            "hoverSpeed": 5,
            "plannedHomePosition": [47.4, 8.5, 400],
            "items": [
                {
                    "type": "SimpleItem",
                    "command": 22,
                    "frame": 3,
                    "autoContinue": True,
                    "doJumpId": 1,
                    "params": [0, 0, 0, None, 47.4, 8.5, 20],
                },
                {
                    "type": "SimpleItem",
                    "command": 16,
                    "frame": 3,
                    "autoContinue": True,
                    "doJumpId": 2,
                    "params": [0, 0, 0, None, 47.401, 8.501, 20],
                },
            ],
        },
        "geoFence": {
            "version": 2,
            "polygons": [{"inclusion": True, "version": 1, "polygon": [[47.3, 8.4], [47.5, 8.4], [47.5, 8.6]]}],
            "circles": [{"inclusion": False, "version": 1, "circle": {"center": [47.4, 8.5], "radius": 30}}],
            "breachReturn": [47.4, 8.5, 30],
        },
        "rallyPoints": {"version": 2, "points": [[47.4, 8.5, 20]]},
    }
).encode()

WPL = b"""QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.4\t8.5\t400\t1
1\t0\t3\t22\t0\t0\t0\t0\t47.4\t8.5\t20\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.401\t8.501\t20\t1
"""

FLEET = b"""[daemon]
sysid = 255
vehicle_timeout_s = 5.0
[origin]
lat_deg = 47.4
lon_deg = 8.5
alt_amsl_m = 400.0
[links.net]
type = "udp_server"
port = 14550
max_peers = 8
[links.radio]
type = "serial"
device = "/dev/ttyUSB0"
baud = 57600
role = "radio"
[vehicles.alpha]
sysid = 1
"""

HUB = b"""listen = "0.0.0.0:4222"
store = "hub-store"
[users.north]
role = "site"
nkey = "UCXYZ"
orders = ["*"]
[users.boss]
role = "operator"
nkey_file = "boss.pub"
"""


@dataclass(frozen=True)
class Reader:
    name: str
    read: Callable[[bytes, Path], object]
    seeds: tuple[bytes, ...]
    kind: str
    """What its files consist of: json, toml, text or zip."""


def _of_plan(suffix: str, vehicle: str | None = None) -> Callable[[bytes, Path], object]:
    file = f"f.{suffix}"
    return lambda data, folder: plan_files.read_plan(file, data, MotionLimits(), ORIGIN, vehicle=vehicle)


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _file(load: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    def read(data: bytes, folder: Path) -> object:
        (folder / "f.toml").write_bytes(data)
        return load(folder / "f.toml")

    return read


READERS = (
    Reader("mission .plan", lambda data, folder: read_plan(data, "f.plan"), (PLAN,), "json"),
    Reader("mission .waypoints", lambda data, folder: read_plan(data, "f.waypoints"), (WPL,), "text"),
    Reader("plan .json", _of_plan("json"), (write_plan_json(TimedPlan(PATHS), FlightSpace()).encode(),), "json"),
    Reader("plan .skyc", _of_plan("skyc"), (write_skyc(PATHS),), "zip"),
    Reader("plan .csv", _of_plan("csv"), (b"vehicle,t,x,y,z,yaw\nalpha,0,0,0,5,90\nalpha,10,20,0,5,0\n",), "text"),
    Reader("plan .plan", _of_plan("plan", "alpha"), (PLAN,), "json"),
    Reader(
        "positions",
        lambda data, folder: parse_table("f.csv", data),
        (b"vehicle,initial_x,initial_y,initial_z\na,0,5,1\n",),
        "text",
    ),
    Reader(
        "positions of TOML",
        lambda data, folder: parse_table("f.toml", data),
        (b"[vehicles.a]\ninitial = [0, 0, 5]\n",),
        "toml",
    ),
    Reader(
        "parameters",
        lambda data, folder: param_file.parse(_text(data), "f.param"),
        (
            b"# Stack: PX4 Pro\n4\t1\tMPC_THR_HOVER\t0.5\t9\n4\t1\tNAV_RCL_ACT\t2\t6\n",
            b"WPNAV_SPEED,500 # why\nA_B 0x1F\n",
        ),
        "text",
    ),
    Reader("fleet file", _file(load_fleet), (FLEET,), "toml"),
    Reader("hub's inventory", _file(load_inventory), (HUB,), "toml"),
    Reader(
        "mavlink-router's file",
        lambda data, folder: import_router(_text(data), "main.conf"),
        (b"[General]\nTcpServerPort=5760\n[UdpEndpoint a]\nMode=Server\nAddress=0.0.0.0\nPort=14550\n",),
        "text",
    ),
)


def _changed_value(value: Any, rng: random.Random) -> Any:
    """The same JSON with one to three values replaced, removed or doubled."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        places: list[tuple[Any, Any]] = []

        def walk(node: Any, places: list[tuple[Any, Any]] = places) -> None:
            for key, item in node.items() if isinstance(node, dict) else enumerate(node):
                places.append((node, key))
                if isinstance(item, dict | list):
                    walk(item)

        if not isinstance(value, dict | list):
            return value
        walk(value)
        if not places:
            return deepcopy(rng.choice(ODD))
        node, key = rng.choice(places)
        match rng.randrange(6):
            case 0:
                del node[key]
            case 1 if isinstance(node, list):
                node.insert(key, deepcopy(node[key]))
            case 2 if isinstance(node, dict):
                node[f"{key} "] = node[key]
            case _:
                node[key] = deepcopy(rng.choice(ODD))  # a later change must not change the table
    return value


def _changed_text(data: bytes, rng: random.Random) -> bytes:
    """The same text with words, lines or bytes changed."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        match rng.randrange(5):
            case 0 | 1 if words := list(re.finditer(rb"[^\s,=\"\[\]{}:]+", data)):
                word = rng.choice(words)
                data = data[: word.start()] + rng.choice(ODD_WORDS).encode() + data[word.end() :]
            case 2 if data:
                lines = data.splitlines(keepends=True)
                lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
                del lines[rng.randrange(len(lines))]
                data = b"".join(lines)
            case 3 if data:
                at = rng.randrange(len(data))
                data = data[:at] + rng.randbytes(rng.randrange(4)) + data[at + rng.randrange(4) :]
            case _:
                data = data[: rng.randrange(len(data) + 1)]
    return data


def _changed_zip(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.3:
        return _changed_text(data, rng)
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as before, zipfile.ZipFile(file, "w") as after:
        chosen = rng.choice(before.namelist())
        for name in before.namelist():
            content = before.read(name)
            if name == chosen:
                content = _changed_json(content, rng)
            packing = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
            after.writestr(name, content, packing if name == chosen else zipfile.ZIP_DEFLATED)
    return file.getvalue()


def _changed_json(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.2:
        return _changed_text(data, rng)
    return json.dumps(_changed_value(json.loads(data), rng)).encode()


def _as_toml(value: Any) -> str:
    """A TOML value, as far as it has one."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(k))} = {_as_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_as_toml, value)) + "]"
    return {None: '""'}.get(value) or json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")


def _changed_toml(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.3:
        return _changed_text(data, rng)
    table = _changed_value(tomllib.loads(data.decode()), rng)
    if not isinstance(table, dict):  # its last key went
        return _as_toml(table).encode()
    return "\n".join(f"{json.dumps(str(key))} = {_as_toml(value)}" for key, value in table.items()).encode()


CHANGES = {"json": _changed_json, "toml": _changed_toml, "zip": _changed_zip, "text": _changed_text}


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_the_files_that_are_changed_are_valid(reader: Reader, tmp_path: Path) -> None:
    for seed in reader.seeds:
        try:
            reader.read(seed, tmp_path)
        except SkygcsError as error:
            assert reader.name == "hub's inventory", error  # the keys in it are none


@settings(max_examples=400)
@given(seed=st.integers(0, 2**64))
def test_any_file_gives_values_or_problems(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    rng = random.Random(seed)
    reader = rng.choice(READERS)
    data = CHANGES[reader.kind](rng.choice(reader.seeds), rng)
    folder = tmp_path_factory.getbasetemp()
    try:
        reader.read(data, folder)
    except SkygcsError as error:
        assert str(error)


@each(
    ("name", "old", "new", "problem"),
    [
        ("mission .plan", b"[47.3, 8.4], ", b"[], ", "fence polygon 1: must hold a latitude and a longitude"),
        ("parameters", b"0.5", b"4" * 400, "has more digits than any parameter"),
    ],
)
def test_what_was_a_traceback_is_a_problem(name: str, old: bytes, new: bytes, problem: str, tmp_path: Path) -> None:
    reader = next(reader for reader in READERS if reader.name == name)
    assert old in reader.seeds[0]
    with pytest.raises(SkygcsError, match=problem):
        reader.read(reader.seeds[0].replace(old, new, 1), tmp_path)


@each("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_show_that_unpacks_without_bound_is_refused_before_it_is_unpacked(packing: int) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("show.json", b" " * 1_000_000, packing)
    with pytest.raises(SkygcsError, match="zip it anew without bzip2 or lzma"):
        _of_plan("skyc")(file.getvalue(), Path())


LONG_KEY = ".".join(["a"] * 20_000) + " = 1\n"


@pytest.mark.parametrize("reader", [reader for reader in READERS if reader.kind == "toml"], ids=lambda r: r.name)
@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (LONG_KEY, "line 1: a key has more than 32 dots"),
        (f'\n["x".{".".join("abc" * 20)}]\n', "line 2: a key has more than 32 dots"),
        ("a = " + "[" * 20_000 + "]" * 20_000, "nested too deeply"),
        ("a = " + "9" * 6000, "digits"),
    ],
)
def test_toml_that_costs_gigabytes_or_the_stack_is_a_problem(
    reader: Reader, text: str, problem: str, tmp_path: Path
) -> None:
    with pytest.raises(SkygcsError, match=problem):
        reader.read(text.encode(), tmp_path)


def test_dots_in_numbers_and_names_are_no_long_key() -> None:
    text = "a = [" + ", ".join(["1.5"] * 500) + ']\nb."c.d" = "' + "x" * 100_000 + '"\n'
    assert parse_toml(text)["b"]["c.d"] == "x" * 100_000


ENDLESS: dict[str, Callable[[Path], object]] = {
    "fleet file": load_fleet,
    "hub's inventory": load_inventory,
    "mission": missions.load_plan,
    "parameters": params.read_file,
    "mavlink-router's file": lambda path: fleet_files.import_router_file(path, None, force=False),
}


@pytest.mark.parametrize("read", ENDLESS.values(), ids=ENDLESS)
def test_a_file_without_end_is_a_problem(read: Callable[[Path], object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_NAMED_BYTES", 1 << 20)
    with pytest.raises(SkygcsError, match="is larger than 1 MiB"):
        read(Path("/dev/zero"))


def test_a_plan_is_read_once_as_a_pipe_can_be() -> None:
    reader, writer = os.pipe()
    os.write(writer, PLAN)
    os.close(writer)
    imported, text = missions.load_plan(Path(f"/dev/fd/{reader}"))
    os.close(reader)
    assert imported.format == "plan" and text.encode() == PLAN
