"""MCAP as an independent reader sees it: schemas hold, and counts are the log's."""

from __future__ import annotations

import json
import math
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from skygcs.config.dialects import offline_dialect
from skygcs.core.geo import Origin, quaternion_from_euler
from skygcs.errors import SkygcsError
from skygcs.ext.logs.census import Census
from skygcs.ext.logs.foxglove_schemas import SCHEMAS, encoded, pose_json, poses_in_frame
from skygcs.ext.logs.mcap_file import write_mcap
from skygcs.ext.logs.motion import orientation_of
from skygcs.ext.logs.path import MOST_POINTS, FlownPath
from skygcs.tlog.files import opened_log
from skygcs.tlog.selection import Selection
from support.examples import thinned
from support.public_data import ROOT
from support.table import each

COSTS = "whole logs through MCAP, and read again by its own reader"

FLIGHT = ROOT / "tests" / "data" / "sitl-3ardupilot-2px4.tlog"
LOGS = sorted((ROOT / "tests" / "data").glob("*.tlog"))

PYTHON_TYPES: dict[str, tuple[type, ...]] = {
    "number": (int, float),
    "integer": (int,),
    "string": (str,),
    "null": (type(None),),
}


def census(path: Path) -> dict[str, Any]:
    counts = Census(offline_dialect())
    with opened_log(path, offline_dialect()) as log:
        for entry in log.entries():
            counts.add(entry)
        return counts.as_dict(log.faults)


def check(schema: dict[str, Any], value: Any, where: str) -> None:
    """The part of JSON Schema that the schemas use."""
    kinds = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    if "object" in kinds:
        assert isinstance(value, dict), where
        assert value.keys() <= schema["properties"].keys(), (where, value.keys() - schema["properties"].keys())
        for key, inner in value.items():
            check(schema["properties"][key], inner, f"{where}.{key}")
    elif "array" in kinds:
        assert isinstance(value, list), where
        for inner in value:
            check(schema["items"], inner, f"{where}[]")
    else:
        assert isinstance(value, tuple(t for kind in kinds for t in PYTHON_TYPES[kind])), (where, value)
        assert not isinstance(value, bool), where


def exported(tmp_path: Path, log: Path = FLIGHT, **selected: Any) -> Path:
    out = tmp_path / "out.mcap"
    write_mcap(log, out, Selection(**selected), {1: "alpha"}, None, offline_dialect(), True)
    return out


def read(path: Path) -> list[tuple[Any, Any, Any]]:
    with path.open("rb") as file:
        return list(make_reader(file, validate_crcs=True).iter_messages())


@each("wrong_us", [2**64 - 1, 2**63, 2**40 * 10**4])
def test_a_record_with_a_wrong_time_ends_no_export(wrong_us: int, tmp_path: Path) -> None:
    log = FLIGHT.with_name("px4-mission-flight.tlog")
    data = log.read_bytes()[:12_000]
    begin = tmp_path / "begin.tlog"
    begin.write_bytes(data)
    damaged = tmp_path / "damaged.tlog"
    damaged.write_bytes(wrong_us.to_bytes(8, "big") + data[8:])
    whole, rest = read(exported(tmp_path, begin)), read(exported(tmp_path, damaged))
    assert 0 < len(whole) - len(rest) < 10


@pytest.mark.parametrize("log", thinned(LOGS, 2, turn=1), ids=lambda p: p.stem)
def test_mcap_has_the_log_s_counts_and_every_message_fits_its_schema(log: Path, tmp_path: Path) -> None:
    counts, topics = census(log), Counter[str]()
    schemas: dict[int, Any] = {}
    for schema, channel, message in read(exported(tmp_path, log)):
        known = schemas.setdefault(schema.id, json.loads(schema.data))
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        assert known["title"] == schema.name
        check(known, json.loads(message.data), channel.topic)
        topics[channel.topic] += 1
    by_type, by_source = Counter[str](), Counter[str]()
    for topic, count in topics.items():
        if topic.startswith("/mavlink/"):
            _, _, source, name = topic.split("/")
            by_type[name] += count
            by_source[source.replace(".", "/")] += count
    unknown = {name for name in counts["types"] if name not in by_type}
    assert all(name.isdigit() or name.startswith(("id", "unknown")) for name in unknown), unknown
    assert by_type == {name: n for name, n in counts["types"].items() if name not in unknown}
    assert sum(by_source.values()) == counts["ok"]
    if not unknown:
        assert by_source == counts["sources"]


def test_what_a_viewer_shows_without_set_up_is_there_for_every_vehicle(tmp_path: Path) -> None:
    counts: Counter[tuple[str, str]] = Counter()
    newest: dict[str, Any] = {}
    for schema, channel, message in read(exported(tmp_path)):
        counts[schema.name, channel.topic] += 1
        newest[channel.topic] = json.loads(message.data)
    positions = census(FLIGHT)["types"]["GLOBAL_POSITION_INT"]
    names = ["alpha", "v2", "v3", "v4", "v5"]
    poses = sum(counts["foxglove.PoseInFrame", f"/{name}/pose"] for name in names)
    assert poses == counts["foxglove.FrameTransforms", "/tf"]
    assert 0.99 * positions <= poses <= positions  # without those before a vehicle's first heartbeat
    assert sum(counts["foxglove.Log", f"/{name}/log"] for name in names) > 20
    for name in names:
        assert counts["foxglove.PosesInFrame", f"/{name}/path"] > 30
        assert counts["vehicle.Battery", f"/{name}/battery"] > 10
        fix = newest[f"/{name}/location"]
        assert fix["latitude"] == pytest.approx(47.3977, abs=0.01) and fix["frame_id"] == name
        assert newest[f"/{name}/path"]["poses"][-1]["position"] == pytest.approx(
            newest[f"/{name}/pose"]["pose"]["position"], abs=5.0
        )


def test_schemas_have_the_fields_of_foxglove_s_own() -> None:
    """Against the descriptors that foxglove-sdk ships."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from foxglove import messages
    integers = {FieldDescriptorProto.TYPE_FIXED32, FieldDescriptorProto.TYPE_ENUM, FieldDescriptorProto.TYPE_UINT32}

    def compare(schema: dict[str, Any], types: dict[str, Any], name: str) -> None:
        fields = {field.name: field for field in types[name].field}
        for key, inner in schema["properties"].items():
            field = fields[key]
            repeated = field.label == FieldDescriptorProto.LABEL_REPEATED
            assert (inner["type"] == "array") == repeated, (name, key)
            inner = inner["items"] if repeated else inner
            if field.type == FieldDescriptorProto.TYPE_MESSAGE:
                if not field.type_name.startswith(".google"):
                    compare(inner, types, field.type_name.lstrip("."))
            else:
                expected = {FieldDescriptorProto.TYPE_STRING: "string", FieldDescriptorProto.TYPE_DOUBLE: "number"}
                assert inner["type"] == ("integer" if field.type in integers else expected[field.type]), (name, key)

    compared = 0
    for name, schema in SCHEMAS.items():
        if not name.startswith("foxglove."):
            continue
        own = getattr(messages, name.partition(".")[2]).get_schema()
        types = {
            f"{file.package}.{message.name}": message
            for file in FileDescriptorSet.FromString(own.data).file
            for message in file.message_type
        }
        compare(schema, types, name)
        compared += 1
    assert compared == 5


def test_a_selection_chooses_what_is_written_but_vehicles_are_found_before_it(tmp_path: Path) -> None:
    messages = read(exported(tmp_path, begin=30.0, end=40.0, sources=frozenset({(4, None)})))
    topics = {channel.topic for _, channel, _ in messages}
    assert "/v4/pose" in topics and not any(t.startswith(("/alpha", "/v5", "/mavlink/1.")) for t in topics)
    span = [message.log_time for _, _, message in messages]
    assert max(span) - min(span) <= 10_100_000_000


def test_nothing_is_left_of_an_export_that_fails(tmp_path: Path) -> None:
    empty = tmp_path / "noise.tlog"
    empty.write_bytes(bytes(range(256)) * 10)
    with pytest.raises(SkygcsError, match=r"no MAVLink|no message"):
        write_mcap(empty, tmp_path / "x.mcap", Selection(), {}, None, offline_dialect(), False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["noise.tlog"]


def test_the_origin_that_is_given_is_zero(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    write_mcap(FLIGHT, out, Selection(), {}, Origin(47.0, 8.0, 0.0), offline_dialect(), True)
    first = next(json.loads(m.data) for _, c, m in read(out) if c.topic.endswith("/pose"))
    east, north = first["pose"]["position"]["x"], first["pose"]["position"]["y"]
    assert 30_000 < east < 60_000 and 30_000 < north < 60_000


@each(
    "angles, nose",
    [
        ((0, 0, 0), (0, 1, 0)),  # north
        ((0, 0, 90), (1, 0, 0)),  # east
        ((0, 90, 0), (0, 0, 1)),  # nose up
        ((45, 0, 90), (1, 0, 0)),
    ],
)
def test_the_nose_points_where_the_autopilot_says(angles: tuple[float, float, float], nose: tuple[int, ...]) -> None:
    x, y, z, w = orientation_of(*angles)
    turned = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))  # of the x axis
    assert turned == pytest.approx(nose, abs=1e-9)


def test_a_roll_to_the_right_lowers_the_right_side() -> None:
    x, y, z, w = orientation_of(30, 0, 0)  # heading north: the left side is west
    left = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
    assert left == pytest.approx((-math.cos(math.radians(30)), 0, 0.5), abs=1e-9)
    assert quaternion_from_euler(0, 0, 0) == (1, 0, 0, 0)


@each("number", [0, 1, 3])
def test_a_path_is_put_together_from_poses_that_were_encoded_once(number: int) -> None:
    poses = [pose_json((float(n), 2.0, -3.5), (0.0, 0.0, 0.0, 1.0)) for n in range(number)]
    text = poses_in_frame(12_000_000_034, [encoded(pose) for pose in poses])
    assert json.loads(text) == {"timestamp": {"sec": 12, "nsec": 34}, "frame_id": "map", "poses": poses}


def test_a_path_stays_bounded_and_keeps_its_ends() -> None:
    path = FlownPath()
    for n in range(100_000):
        path.add((0.1 * n, 0.0, 0.0), "{}")
        assert len(path.points) <= MOST_POINTS
    assert path.points[0][0] == (0.0, 0.0, 0.0) and path.points[-1][0][0] > 9900
