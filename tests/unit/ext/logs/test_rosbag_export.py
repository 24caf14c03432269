"""A bag has what the live node of ROS 2 publishes: read by rosbags, with the definitions that the bag itself states."""

from __future__ import annotations

import dataclasses
import math
import sqlite3
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from pydantic_core import from_json, to_json
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.config.dialects import offline_dialect
from skygcs.core.geo import Origin
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.heartbeat import DEFAULT_LOST_S, discovers, heartbeat_fields
from skygcs.core.mavlink.modes import family, mode_name
from skygcs.core.ros.shared_topics import SHARED
from skygcs.core.ros.topics import DEPTHS, TELEMETRY
from skygcs.errors import SkygcsError
from skygcs.ext.logs.recorded_node import Naming, Wanted
from skygcs.ext.logs.rosbag_file import write_rosbag
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from skygcs.tlog.files import opened_log
from skygcs.tlog.format import encode_record
from skygcs.tlog.selection import Selection
from support.examples import thinned
from support.public_data import CAPTURE, OWN, captures, public_file
from support.ros_node import KeptNode
from support.table import each

COSTS = "logs through the live node's bridge and through rosbag2, read again by rosbags"

LOGS = [name for name in captures("tlog") if (OWN / name).is_file()]
PUBLIC = [name for name in captures("tlog") if name not in LOGS]
PART_BYTES = 60_000
PARTS = {"px4-late-frames.tlog": 0, "second-heartbeat-1hz.tlog": 80_000}
"""Both firmwares, and two vehicles of one id, whose second begins 15,000 bytes after this place. `make test` exports
`PART_BYTES` from here, cut within records; `make test-deep` every log as it is."""
PX4 = Naming(px4_msgs="1.16")


Messages = dict[str, list[tuple[int, Any]]]
"""By topic: bag time and message."""


def part_of(log: Path, tmp_path: Path, begin: int = 0, size: int = PART_BYTES) -> Path:
    part = tmp_path / log.name
    part.write_bytes(log.read_bytes()[begin : begin + size])
    return part


def exported(tmp_path: Path, log: Path = CAPTURE, **wanted: Any) -> Path:
    bag = tmp_path / "bag.of.mine"
    write_rosbag(log, bag, Wanted(**wanted), offline_dialect())
    return bag


def plain(value: Any) -> Any:
    """A message as a dictionary; NaN is None, which equals itself."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list):
        return [plain(one) for one in value]
    if hasattr(value, "__msgtype__"):
        names = [field.name for field in dataclasses.fields(value) if field.default is dataclasses.MISSING]
        return {name: plain(getattr(value, name)) for name in names}  # without the constants of its interface
    return None if isinstance(value, float) and math.isnan(value) else value


def without_nan(value: Any) -> Any:
    """The same of a dictionary."""
    if isinstance(value, dict):
        return {name: without_nan(one) for name, one in value.items()}
    if isinstance(value, list):
        return [without_nan(one) for one in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def read(bag: Path) -> Messages:
    """Every message, by the definitions in the bag: none of ours is used."""
    messages: Messages = defaultdict(list)
    with Reader(bag) as opened:
        store = get_typestore(Stores.EMPTY)
        for connection in opened.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            assert store.hash_rihs01(connection.msgtype) == connection.digest
        for connection, time_ns, data in opened.messages():
            messages[connection.topic].append((time_ns, plain(store.deserialize_cdr(data, connection.msgtype))))
    return messages


@pytest.fixture(scope="module")
def capture_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag of the first 20 s of CAPTURE, in which each of its topics has a message."""
    return exported(tmp_path_factory.mktemp("bags"), naming=PX4, selection=Selection(end=20.0))


def live(log: Path, **config: Any) -> KeptNode:
    """Topics of the live node for this log: what the daemon sends its bridge, which somebody reads all topics of."""
    node, now = KeptNode(), [0]
    bridge = Bridge(node, RosConfig(**config), lambda: now[0])
    names: dict[tuple[int, int], str] = {}
    states: dict[tuple[int, int], dict[str, Any]] = {}
    heard: dict[tuple[int, int], tuple[float, int]] = {}
    looked_s = -math.inf

    def lose(at_s: float, keys: Iterable[tuple[int, int]]) -> None:
        """The daemon says so DEFAULT_LOST_S after a vehicle's last heartbeat."""
        for key in keys:
            if key in states and states[key]["connected"] and at_s - heard[key][0] > DEFAULT_LOST_S:
                states[key]["connected"] = False
                now[0] = heard[key][1] + round(DEFAULT_LOST_S * 1e9)
                bridge.on_state(states[key])

    with opened_log(log, offline_dialect()) as opened:
        for entry in opened.entries():
            frame, time_ns = entry.frame, entry.unix_ns()
            if frame is None or frame.info is None or time_ns is None:
                continue
            if entry.at_s - looked_s >= 1.0:
                looked_s = entry.at_s
                lose(entry.at_s, list(states))
            key = frame.sysid, frame.compid
            if discovers(frame):
                lose(entry.at_s, [key])
                heard[key] = entry.at_s, time_ns
            now[0] = time_ns
            if key in states and discovers(frame) and not states[key]["connected"]:
                states[key]["connected"] = True
                bridge.on_state(states[key])
            if key not in names and discovers(frame):
                twice = any(sysid == frame.sysid for sysid, _ in names)
                names[key] = f"v{frame.sysid}-{frame.compid}" if twice else f"v{frame.sysid}"
                custom_mode, kind, autopilot, base_mode = heartbeat_fields(frame)
                mode = mode_name(autopilot, kind, base_mode, custom_mode)
                state = {"name": names[key], "sysid": key[0], "compid": key[1], "connected": True}
                states[key] = {**state, "autopilot": family(autopilot), "mode": mode, "armed": False}
                bridge.on_state(states[key])
                node.read(*(name for name in node.publications if not node.publications[name].readers))
            message = {"vehicle": names.get(key), "compid": key[1], "name": frame.name, "fields": frame.fields()}
            bridge.on_message({**from_json(to_json(message, inf_nan_mode="null")), "age_s": 0.0})
    return node


@each("name", PARTS)
def test_every_topic_of_a_cut_log_has_what_the_live_node_publishes(name: str, tmp_path: Path) -> None:
    compare_with_the_live_node(part_of(OWN / name, tmp_path, PARTS[name]), tmp_path)


@pytest.mark.deep  # seconds of each
@each("name", [*thinned(LOGS, 4, turn=1), *thinned(PUBLIC, 2)])
def test_every_topic_has_what_the_live_node_publishes(name: str, tmp_path: Path) -> None:
    compare_with_the_live_node(OWN / name if name in LOGS else public_file(f"tlog/{name}"), tmp_path)


def compare_with_the_live_node(log: Path, tmp_path: Path) -> None:
    try:
        bag = exported(tmp_path, log, naming=PX4)
    except SkygcsError as error:
        assert "no message of a vehicle" in str(error)
        assert not live(log, px4_msgs="1.16").publications.keys() - SHARED.keys()
        return
    found = read(bag)
    node = live(log, px4_msgs="1.16")
    expected = {name: made.messages for name, made in node.publications.items() if made.messages}
    static = expected.pop("/tf_static")  # a bag has the origins of local frames as well, which the daemon reports
    children = {transform["child_frame_id"] for transform in static[-1]["transforms"]}
    assert children <= {transform["child_frame_id"] for transform in found["/tf_static"][-1][1]["transforms"]}
    assert found.keys() - {"/diagnostics", "/tf_static"} == expected.keys()
    for topic, messages in expected.items():
        sent = Counter(map(repr, map(without_nan, messages)))
        got = Counter(repr(message) for _, message in found[topic])
        assert got == sent, topic


def test_qualities_of_service_are_those_of_the_live_node(capture_bag: Path) -> None:
    px4_topics = 0
    with Reader(capture_bag) as opened:
        for connection in (one for one in opened.connections if not one.topic.endswith("/mavlink")):
            _, _, topic = connection.topic.partition("/mavros/")
            known = TELEMETRY.get(topic) or SHARED.get(connection.topic)
            quality = "px4" if known is None else known.quality
            px4_topics += known is None
            assert connection.msgtype == known.type if known is not None else "/fmu/out/" in connection.topic
            (profile,) = connection.ext.offered_qos_profiles  # type: ignore[union-attr]
            best_effort = profile.reliability is QosReliability.BEST_EFFORT
            lasting = profile.durability is QosDurability.TRANSIENT_LOCAL
            assert (best_effort, lasting) == (quality in ("sensor", "px4"), quality in ("latched", "newest", "px4"))
            assert profile.depth == DEPTHS[quality]
    assert px4_topics == 12


def test_the_bag_is_a_folder_that_ros_reads_and_nothing_else_is_left(capture_bag: Path) -> None:
    bag = capture_bag
    assert sorted(p.name for p in bag.iterdir()) == ["bag.of.mine.db3", "metadata.yaml"]
    assert [p.name for p in bag.parent.iterdir()] == ["bag.of.mine"]
    with sqlite3.connect(bag / "bag.of.mine.db3") as data:
        assert data.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    data.close()
    with pytest.raises(SkygcsError, match="exists"):
        exported(bag.parent)


def test_frames_have_the_log_s_counts_and_its_bytes(tmp_path: Path) -> None:
    name = "copter-signed-flight.tlog"
    found = read(exported(tmp_path, OWN / name, frames=True))
    frames = [message for topic, messages in found.items() if topic.endswith("/mavlink") for _, message in messages]
    got = Counter()
    for message in frames:
        payload = b"".join(word.to_bytes(8, "little") for word in message["payload64"])[: message["len"]]
        tail = message["checksum"].to_bytes(2, "little") + bytes(message["signature"])
        got[message["sysid"], message["compid"], message["msgid"], message["seq"], payload, tail] += 1
    with opened_log(OWN / name, offline_dialect()) as opened:
        sent = [e.frame for e in opened.entries() if e.frame is not None and e.frame.info is not None]
    wanted = Counter()
    for frame in sent:
        end = (10 if frame.raw[0] == 0xFD else 6) + frame.raw[1]
        wanted[frame.sysid, frame.compid, frame.msgid, frame.seq, frame.payload, frame.raw[end:]] += 1
    assert got == wanted


def made_log(tmp_path: Path, *records: tuple[float, int, str, dict[str, Any]]) -> Path:
    """A log of ``(seconds, system id, message, fields)``."""
    dialect, log = offline_dialect(), tmp_path / "made.tlog"
    with log.open("wb") as file:
        for at_s, sysid, name, fields in records:
            frame = encode(dialect.by_name[name], fields, seq=0, sysid=sysid, compid=1)
            file.write(encode_record(1_700_000_000_000_000 + round(at_s * 1e6), frame))
    return log


def heartbeat(autopilot: int = 12, base_mode: int = 0x91) -> dict[str, int]:
    mode = {"custom_mode": 0x3040000, "system_status": 4, "mavlink_version": 3}
    return {"type": 2, "autopilot": autopilot, "base_mode": base_mode, **mode}


PLACE = {"latitude": 437806000, "longitude": -794653000, "altitude": 180_000}


def test_a_vehicle_that_falls_silent_is_lost_and_its_memory_is_new(tmp_path: Path) -> None:
    beats = [(t, 1, "HEARTBEAT", heartbeat()) for t in (0.0, 1.0, 2.0)]
    others = [(float(t), 2, "HEARTBEAT", heartbeat()) for t in range(30)]
    again = [(20.0, 1, "HEARTBEAT", heartbeat())]
    records = sorted([*beats, *others, *again], key=lambda record: record[0])
    found = read(exported(tmp_path, made_log(tmp_path, *records)))
    states = found["/v1/mavros/state"]
    assert [state["connected"] for _, state in states] == [False, True, True, True, False, True, False]
    assert [(at_ns / 1e9) % 1000 for at_ns, _ in states] == pytest.approx([0, 0, 1, 2, 7, 20, 25])
    assert [state["header"]["stamp"]["sec"] % 1000 for _, state in states] == [0, 0, 1, 2, 7, 20, 25]
    assert all(state["connected"] for _, state in found["/v2/mavros/state"][1:])
    status = {m["header"]["stamp"]["sec"] % 1000: m["status"] for _, m in found["/diagnostics"]}
    assert [one["level"] for one in status[10]] == [2, 0] and status[10][0]["name"] == "/v1/mavros: connection"
    assert {pair["key"]: pair["value"] for pair in status[1][0]["values"]} == {"mode": "AUTO.LOITER", "armed": "True"}


def test_the_origin_that_is_given_is_the_frame_map(tmp_path: Path) -> None:
    log = made_log(
        tmp_path,
        (0.0, 1, "HEARTBEAT", heartbeat()),
        (0.1, 2, "HEARTBEAT", heartbeat()),
        (0.2, 1, "GPS_GLOBAL_ORIGIN", PLACE),
        (0.3, 2, "GPS_GLOBAL_ORIGIN", {**PLACE, "latitude": 437806900}),
        (0.4, 2, "GPS_GLOBAL_ORIGIN", {**PLACE, "latitude": 437806900}),
        (0.5, 1, "GPS_GLOBAL_ORIGIN", {**PLACE, "latitude": 0, "longitude": 0}),
    )
    messages = [message for _, message in read(exported(tmp_path, log))["/tf_static"]]
    one, other = ([f"v{n}/{frame}" for frame in ("map", "map_ned", "base_link_frd")] for n in (1, 2))
    children = [one[1:], one[1:] + other[1:], one + other[1:], one + other]
    assert [[t["child_frame_id"] for t in m["transforms"]] for m in messages] == children
    first, second = messages[-1]["transforms"][::3]
    assert first["header"]["frame_id"] == "map" and first["transform"]["translation"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    assert second["transform"]["translation"]["y"] == pytest.approx(10.0, abs=0.05)  # 9e-5 degrees to the north
    (tmp_path / "other").mkdir()
    north = Origin(43.7806, -79.4653, 170.0, x_heading_deg=0.0)
    given = read(exported(tmp_path / "other", log, origin=north))["/tf_static"][-1][1]["transforms"][3]["transform"]
    assert given["translation"]["x"] == pytest.approx(10.0, abs=0.05)
    assert given["translation"]["z"] == pytest.approx(10.0, abs=0.01)
    (tmp_path / "plain").mkdir()
    plain_names = Naming(frame_prefix="")
    assert not {"/tf", "/tf_static"} & read(exported(tmp_path / "plain", log, naming=plain_names)).keys()


def test_a_part_of_a_log_begins_with_what_a_later_reader_gets(tmp_path: Path, capture_bag: Path) -> None:
    whole = read(capture_bag)
    (tmp_path / "part").mkdir()
    chosen = Selection(begin=10.0, end=15.0, sources=frozenset({(4, None)}))
    found = read(exported(tmp_path / "part", naming=PX4, selection=chosen))
    assert all(name.startswith("/v4/") or name in SHARED for name in found)
    times = [at_ns for messages in found.values() for at_ns, _ in messages]
    assert max(times) - min(times) <= 5_100_000_000
    home = whole["/v4/mavros/home_position/home"]
    before = [message for at_ns, message in home if at_ns < min(times)]
    assert found["/v4/mavros/home_position/home"][0] == (min(times), before[-1])
    pose = [(at, m) for at, m in whole["/v4/mavros/local_position/pose"] if min(times) <= at <= max(times)]
    assert found["/v4/mavros/local_position/pose"] == pose
    (tmp_path / "named").mkdir()
    beats = Selection(messages=frozenset({0}))
    log = OWN / "px4-mission-flight.tlog"
    assert read(exported(tmp_path / "named", log, selection=beats)).keys() == {"/v11/mavros/state"}


def test_names_are_those_of_the_fleet_file(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.toml"
    ros = '[ros]\nroot = "/uav_{sysid}"\nframe_prefix = "{name}/"\npx4_msgs = "1.14"\n'
    fleet.write_text(f"[vehicles]\nalpha_1 = {{ sysid = 1 }}\ndelta = {{ sysid = 4 }}\n{ros}")
    place = {"time_boot_ms": 1000, "x": 1.0, "y": 2.0, "z": -3.0, "vx": 0.0, "vy": 0.0, "vz": 0.0}
    log = made_log(
        tmp_path,
        (0.0, 1, "HEARTBEAT", heartbeat(autopilot=3)),
        (0.1, 1, "LOCAL_POSITION_NED", place),
        (0.2, 4, "HEARTBEAT", heartbeat()),
        (0.3, 1, "HEARTBEAT", heartbeat(autopilot=3)),
    )
    out = tmp_path / "bag"
    arguments = ["tlog", "export", str(log), "--rosbag2", "--fleet", str(fleet), "-o", str(out)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "2 vehicles" in done.stdout
    found = read(out)
    assert found["/uav_1/mavros/local_position/pose"][0][1]["header"]["frame_id"] == "alpha_1/map"
    assert "/uav_4/fmu/out/vehicle_status" in found  # without a version, as 1.14 has it
    refused = CliRunner().invoke(app, [*arguments[:-1], str(tmp_path / "x"), "--px4-msgs", "1.13"])
    assert refused.exit_code == 2 and "1.16" in refused.output
    assert CliRunner().invoke(app, ["tlog", "export", str(CAPTURE), "--mcap", "--frames"]).exit_code == 2


def test_vehicles_with_one_name_in_ros_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = made_log(tmp_path, *((0.1 * n, 1 + n % 2, "HEARTBEAT", heartbeat()) for n in range(4)))
    found = read(exported(tmp_path, log, names={1: "uav-1", 2: "uav_1"}))
    assert len(found["/uav_1/mavros/state"]) == 3
    assert "2/1 has no topics: /uav_1/ are" in capsys.readouterr().err.replace("/uav_1 are", "/uav_1/ are")


@each("wrong_us", [2**64 - 1, 2**63, 2**40 * 10**4, (1 << 31) * 10**6 - 1])
def test_a_record_with_a_wrong_time_ends_no_export(wrong_us: int, tmp_path: Path) -> None:
    damaged = part_of(OWN / "px4-mission-flight.tlog", tmp_path, size=12_000)
    damaged.write_bytes(wrong_us.to_bytes(8, "big") + damaged.read_bytes()[8:])
    assert len(read(exported(tmp_path, damaged, naming=PX4))) > 10


def test_fields_that_no_message_of_ros_takes_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    huge = {"time_boot_ms": 1000, "x": math.inf, "y": 3.4e38, "z": math.nan, "vx": -math.inf, "vy": 0.0, "vz": 0.0}
    log = made_log(
        tmp_path,
        (0.0, 1, "HEARTBEAT", heartbeat(autopilot=3)),
        (0.1, 1, "LOCAL_POSITION_NED", huge),
        (0.2, 1, "GPS_GLOBAL_ORIGIN", {**PLACE, "latitude": 2_000_000_000}),
        (0.3, 1, "HEARTBEAT", heartbeat(autopilot=3)),
    )
    found = read(exported(tmp_path, log))
    place = found["/v1/mavros/local_position/pose"][0][1]["pose"]["position"]
    assert place["y"] is None and place["z"] is None and place["x"] == pytest.approx(3.4e38)
    assert len(found["/v1/mavros/state"]) == 3
    capsys.readouterr()


def test_nothing_is_left_of_an_export_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = tmp_path / "noise.tlog"
    empty.write_bytes(bytes(range(256)) * 10)
    with pytest.raises(SkygcsError, match="no MAVLink"):
        exported(tmp_path, empty)
    station = made_log(tmp_path, (0.0, 255, "HEARTBEAT", {**heartbeat(), "type": 6, "autopilot": 8}))
    with pytest.raises(SkygcsError, match="no message of a vehicle"):
        exported(tmp_path, station)
    full = sqlite3.OperationalError("database or disk is full")

    def write(*_: object) -> None:
        raise full

    monkeypatch.setattr("rosbags.rosbag2.storage_sqlite3.Sqlite3Writer.write", write)
    with pytest.raises(SkygcsError, match="disk is full"):
        exported(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["made.tlog", "noise.tlog"]
