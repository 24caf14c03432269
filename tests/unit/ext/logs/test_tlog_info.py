"""`tlog info`: counts of the public captures, the vehicles a daemon would have found, files that are no logs."""

from __future__ import annotations

import gzip
import json
import os
import threading
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.core.mavlink.signing import sign
from skygcs.errors import DialectError, SkygcsError
from skygcs.ext.logs.commands import print_info
from skygcs.tlog.format import encode_record
from support.examples import thinned
from support.frames import dialect, frame, heartbeat, noise, unknown_frame
from support.public_data import CAPTURE, OWN, ROOT, captures, expected, public_file, vehicles_of
from support.table import each

T0 = 1_700_000_000_000_000
KEYS = [
    *("records", "ok", "bad_crc", "unknown", "signed", "skipped_bytes", "backwards", "most_backwards_s", "clock_steps"),
    *("duration_s", "sources", "types", "vehicles"),
]


def info(path: Path, capsys: pytest.CaptureFixture[str], dialect: str | None = None) -> dict[str, Any]:
    assert print_info([path], True, dialect) == 0
    out, err = capsys.readouterr()
    assert err == ""
    answer: dict[str, Any] = json.loads(out)
    assert list(answer) == KEYS
    return answer


def tlog(path: Path, *frames: bytes) -> Path:
    path.write_bytes(b"".join(encode_record(T0 + n * 1_000_000, raw) for n, raw in enumerate(frames)))
    return path


@each("name", thinned(captures("tlog"), 3, turn=7))
def test_a_tlog_is_counted_exactly(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    answer = info(public_file(f"tlog/{name}"), capsys)
    wanted = expected()[name]
    status = wanted["status"]
    assert (answer["signed"], answer["backwards"] + answer["clock_steps"]) == (wanted["signed"], wanted["ts_backwards"])
    assert (answer["ok"], answer["bad_crc"], answer["unknown"], answer["skipped_bytes"]) == tuple(
        status.get(key, 0) for key in ("ok", "badcrc", "unknown", "skipped_bytes")
    )
    assert answer["records"] == wanted["frames"]
    assert answer["duration_s"] == wanted["duration_s"]
    assert answer["sources"] == wanted["sources"]
    assert sum(answer["types"].values()) == answer["ok"]
    for kind, count in answer["types"].items():  # expected.json counts the bad ones among its types, too
        assert count == wanted["types"][kind] or (count < wanted["types"][kind] and status.get("badcrc"))


@each("name", thinned(captures("tlog") + captures("raw"), 3, turn=8))
def test_vehicles_are_the_autopilots_and_nothing_else(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No radio, no companion 1/0, no flood of 2/2, no GCS that calls itself ArduPilot."""
    answer = info(public_file(f"tlog/{name}"), capsys)
    found = {f"{v['sysid']}/{v['compid']}": v["heartbeats"] for v in answer["vehicles"]}
    wanted = vehicles_of(name)
    assert found.keys() == wanted.keys()
    if not expected()[name]["status"].get("unknown"):  # there the list also counts heartbeats inside unknown records
        assert found == wanted


@each("name", captures("raw"))
def test_a_raw_capture_is_recognised_and_has_no_times(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    answer = info(public_file(f"tlog/{name}"), capsys)
    assert answer["ok"] >= expected()[name]["status"]["ok"]
    assert answer["sources"] == expected()[name]["sources"]
    assert answer["duration_s"] is None
    assert all(v["first_s"] is None and v["last_s"] is None for v in answer["vehicles"])


def test_own_flight_has_five_vehicles_their_modes_and_that_they_flew(capsys: pytest.CaptureFixture[str]) -> None:
    answer = info(CAPTURE, capsys)
    assert (answer["records"], answer["ok"], answer["duration_s"]) == (8144, 8144, 75.1)
    vehicles = answer["vehicles"]
    assert [(v["sysid"], v["autopilot"], v["type"], v["armed"]) for v in vehicles] == [
        *((sysid, "ardupilot", "QUADROTOR", True) for sysid in (1, 2, 3)),
        *((sysid, "px4", "QUADROTOR", True) for sysid in (4, 5)),
    ]
    assert vehicles[0]["modes"] == ["STABILIZE", "GUIDED", "LAND"]
    assert "OFFBOARD" in vehicles[3]["modes"]
    assert vehicles[0]["first_s"] < 1.0 and vehicles[0]["last_s"] > 74.0


def test_what_is_out_of_the_ordinary_is_counted_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    signed = sign(heartbeat(1, seq=4), dialect().find("HEARTBEAT").crc_extra_byte, bytes(32), 1, 5)
    frames = [heartbeat(1, seq=0), heartbeat(1, seq=3), signed, heartbeat(1, seq=5)]
    frames += [
        heartbeat(1, seq=9, type=18, autopilot=8),
        heartbeat(1, seq=9, type=18, autopilot=8),
        heartbeat(1, seq=6),
    ]
    times_us = (0, 5, 4, 1_000_000, 1_000_100, 1_000_200, 980_200)
    path = tmp_path / "x.tlog"
    path.write_bytes(b"".join(encode_record(T0 + t, raw) for t, raw in zip(times_us, frames, strict=True)))
    assert print_info([path], True) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["signed"], answer["backwards"], answer["most_backwards_s"]) == (1, 2, 0.02)
    (vehicle,) = answer["vehicles"]
    assert (vehicle["heartbeats"], vehicle["lost"]) == (5, 4)  # 2, and 3 for the other program's, of which one came
    assert vehicle["conflicting"] == [{"autopilot": "INVALID", "type": "ONBOARD_CONTROLLER", "heartbeats": 2}]
    assert print_info([path]) == 0
    shown = capsys.readouterr().out
    for line in (
        "1 signed frames",
        "the time goes backwards 2×, by up to 20 ms",
        "conflicting heartbeats under 1/1: 2 of INVALID ONBOARD_CONTROLLER",
    ):
        assert line in shown


@each("name", ["px4-late-frames", "second-heartbeat-1hz"])
def test_a_flight_that_lost_nothing_shows_no_loss(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    answer = info(OWN / f"{name}.tlog", capsys)
    assert len(answer["vehicles"]) == 5
    assert [v["lost"] for v in answer["vehicles"]] == [0] * 5


def test_forged_heartbeats_conflict_and_change_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    answer = info(OWN / "forged-heartbeat-50hz.tlog", capsys)
    first, *others = answer["vehicles"]
    assert (first["autopilot"], first["type"], first["modes"]) == ("ardupilot", "QUADROTOR", ["GUIDED", "LAND"])
    assert first["conflicting"] == [{"autopilot": "INVALID", "type": "GENERIC", "heartbeats": 782}]
    assert first["lost"] <= 1
    assert [(v["lost"], v["conflicting"]) for v in others] == [(0, [])] * 4


def test_frames_nothing_vouches_for_make_no_vehicle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = bytearray(heartbeat(3))
    bad[-1] ^= 1
    path = tlog(tmp_path / "x.tlog", heartbeat(1), bytes(bad), unknown_frame(sysid=4), heartbeat(0), heartbeat(1))
    answer = info(path, capsys)
    assert [v["sysid"] for v in answer["vehicles"]] == [1]
    assert (answer["bad_crc"], answer["unknown"]) == (1, 1)
    assert answer["sources"] == {"1/1": 2, "0/1": 1}
    assert answer["types"] == {"HEARTBEAT": 3}


def test_px4_extras_are_known_without_asking_and_another_dialect_may_be_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tlog(tmp_path / "x.tlog", heartbeat(1), frame("EVENT", {"id": 5}), heartbeat(1))
    assert info(path, capsys)["types"]["EVENT"] == 1
    assert info(path, capsys, "common")["unknown"] == 1
    assert info(path, capsys, str(ROOT / "dialects" / "utias.xml"))["unknown"] == 0
    with pytest.raises(DialectError, match="no dialect of this name"):
        print_info([path], True, "nope")


def test_a_tlog_of_nothing_but_unknown_ids_is_believed_by_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = info(tlog(tmp_path / "x.tlog", *[unknown_frame()] * 5), capsys)
    assert (answer["records"], answer["unknown"], answer["vehicles"]) == (5, 5, [])


@each("content", [b"", b"\0", b"hello\n" * 100, noise(300_000, 4)])
@each("suffix", ["tlog", "bin"])
def test_a_file_that_is_no_log_says_so(tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(content)
    with pytest.raises(SkygcsError, match=r"x\.\w+: no MAVLink in it" if content else "it is empty"):
        print_info([path])


@each(
    ("content", "what"),
    [
        (b"ULog\x01\x12\x35\x01" + bytes(200), "a PX4 wrote on board"),
        (b"\xa3\x95\x80\x80" + bytes(200), "an ArduPilot wrote on board"),
        (gzip.compress(b"a tlog " * 99, mtime=0), "gunzip"),
        (b"PK\x03\x04" + bytes(200), "unzip"),
    ],
)
@each("suffix", ["tlog", "bin"])
def test_a_file_of_another_kind_is_named(tmp_path: Path, content: bytes, what: str, suffix: str) -> None:
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(content)
    with pytest.raises(SkygcsError, match=f"no MAVLink in it, .*: it is .*{what}"):
        print_info([path])


def test_a_message_that_the_dialect_lacks_comes_with_those_near_it(tmp_path: Path) -> None:
    path = tlog(tmp_path / "x.tlog", heartbeat())
    found = CliRunner().invoke(app, ["tlog", "csv", str(path), "--message", "atitude"])
    assert "did you mean ATTITUDE" in " ".join(found.output.split())


def test_a_file_that_can_not_be_read_says_why(tmp_path: Path) -> None:
    for path, complaint in ((tmp_path / "gone.tlog", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(SkygcsError, match=complaint):
            print_info([path])


def test_a_pipe_is_read_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    content = tlog(tmp_path / "x.tlog", heartbeat(1), heartbeat(2)).read_bytes()
    writer = threading.Thread(target=path.write_bytes, args=(content,))
    writer.start()
    assert info(path, capsys)["records"] == 2
    writer.join()


def test_a_person_gets_the_same_as_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert print_info([CAPTURE]) == 0
    out, _ = capsys.readouterr()
    assert "8144 records, 75.1 s" in out
    for word in ("ardupilot", "px4", "GUIDED", "OFFBOARD", "GLOBAL_POSITION_INT", "255/190"):
        assert word in out
    assert print_info([tlog(tmp_path / "[odd] name.tlog", frame("SYS_STATUS"))]) == 0
    out, _ = capsys.readouterr()
    assert "[odd] name.tlog: tlog, 1 records" in out and "no vehicle" in out


def test_a_person_gets_no_table_without_end_and_no_escape_sequence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skygcs.ext.logs.commands.MOST_ROWS", 3)
    assert print_info([tlog(tmp_path / "a\x1b[2J.tlog", *map(heartbeat, range(1, 9)))]) == 0
    out, _ = capsys.readouterr()
    assert "3/1" in out and "4/1" not in out and out.count("and 5 more; --json has all") == 2
    assert "\x1b" not in out and "a\\x1b[2J.tlog: tlog" in out


def test_modes_without_end_are_not_listed_without_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (vehicle,) = info(
        tlog(tmp_path / "x.tlog", *(heartbeat(1, autopilot=3, custom_mode=n) for n in range(500))), capsys
    )["vehicles"]
    assert vehicle["heartbeats"] == 500 and len(vehicle["modes"]) == 100


def test_several_files_are_a_list_and_a_bad_one_does_not_hide_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tlog(tmp_path / f"{name}.tlog", frame("SYS_STATUS")) for name in ("a", "b")]
    bad = tmp_path / "none.tlog"
    result = CliRunner().invoke(app, ["tlog", "info", str(files[0]), str(bad), str(files[1]), "--json"])
    assert result.exit_code == 1
    assert [(a["file"], a["records"]) for a in json.loads(result.stdout)] == [(str(file), 1) for file in files]
    assert "none.tlog: No such file" in result.stderr
    shown = CliRunner().invoke(app, ["tlog", "info", *map(str, files)])
    assert shown.exit_code == 0
    assert "a.tlog: tlog, 1 records" in shown.output and "b.tlog: tlog, 1 records" in shown.output
