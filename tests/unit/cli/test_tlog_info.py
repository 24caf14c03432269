"""`tlog info`: counts of the public captures, the vehicles a daemon would have found, files that are no logs."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli.control import app
from skygcs.cli.tlog import tlog_info
from skygcs.core.tlog import encode_record
from skygcs.errors import DialectError, SkygcsError
from support.frames import frame, heartbeat, noise, unknown_frame
from support.public_data import CAPTURE, ROOT, captures, expected, public_file

T0 = 1_700_000_000_000_000
KEYS = ["records", "ok", "bad_crc", "unknown", "skipped_bytes", "duration_s", "sources", "types", "vehicles"]


def info(path: Path, capsys: pytest.CaptureFixture[str], dialect: str | None = None) -> dict[str, Any]:
    assert tlog_info(path, True, dialect) == 0
    out, err = capsys.readouterr()
    assert err == ""
    answer: dict[str, Any] = json.loads(out)
    assert list(answer) == KEYS
    return answer


def tlog(path: Path, *frames: bytes) -> Path:
    path.write_bytes(b"".join(encode_record(T0 + n * 1_000_000, raw) for n, raw in enumerate(frames)))
    return path


@pytest.mark.parametrize("name", captures("tlog"))
def test_a_public_tlog_is_counted_exactly(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    answer = info(public_file(f"tlog/{name}"), capsys)
    wanted = expected()[name]
    status = wanted["status"]
    assert (answer["ok"], answer["bad_crc"], answer["unknown"], answer["skipped_bytes"]) == tuple(
        status.get(key, 0) for key in ("ok", "badcrc", "unknown", "skipped_bytes")
    )
    assert answer["records"] == wanted["frames"]
    assert answer["duration_s"] == wanted["duration_s"]
    assert answer["sources"] == wanted["sources"]
    assert sum(answer["types"].values()) == answer["ok"]
    for kind, count in answer["types"].items():  # expected.json counts the bad ones among its types, too
        assert count == wanted["types"][kind] or (count < wanted["types"][kind] and status.get("badcrc"))


def heartbeats_of_vehicles(name: str) -> dict[str, int]:
    """By expected.json: a real autopilot and not a GCS."""
    return {
        f"{sysid}/{compid}": count
        for sysid, compid, autopilot, kind, _, count in expected()[name]["heartbeats"]
        if autopilot != "MAV_AUTOPILOT_INVALID" and kind != "MAV_TYPE_GCS"
    }


@pytest.mark.parametrize("name", captures("tlog") + captures("raw"))
def test_vehicles_are_the_autopilots_and_nothing_else(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No radio, no companion 1/0, no flood of 2/2, no GCS that calls itself ArduPilot."""
    answer = info(public_file(f"tlog/{name}"), capsys)
    found = {f"{v['sysid']}/{v['compid']}": v["heartbeats"] for v in answer["vehicles"]}
    wanted = heartbeats_of_vehicles(name)
    assert found.keys() == wanted.keys()
    if not expected()[name]["status"].get("unknown"):  # there the list also counts heartbeats inside unknown records
        assert found == wanted


@pytest.mark.parametrize("name", captures("raw"))
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
        tlog_info(path, True, "nope")


def test_a_tlog_of_nothing_but_unknown_ids_is_believed_by_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = info(tlog(tmp_path / "x.tlog", *[unknown_frame()] * 5), capsys)
    assert (answer["records"], answer["unknown"], answer["vehicles"]) == (5, 5, [])


@pytest.mark.parametrize("content", [b"", b"\0", b"hello\n" * 100, noise(300_000, 4)])
@pytest.mark.parametrize("suffix", ["tlog", "bin"])
def test_a_file_that_is_no_log_says_so(tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(content)
    with pytest.raises(SkygcsError, match=r"x\.\w+: no MAVLink in it"):
        tlog_info(path)


def test_a_file_that_can_not_be_read_says_why(tmp_path: Path) -> None:
    for path, complaint in ((tmp_path / "gone.tlog", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(SkygcsError, match=complaint):
            tlog_info(path)


def test_a_pipe_is_read_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    content = tlog(tmp_path / "x.tlog", heartbeat(1), heartbeat(2)).read_bytes()
    writer = threading.Thread(target=path.write_bytes, args=(content,))
    writer.start()
    assert info(path, capsys)["records"] == 2
    writer.join()


def test_a_person_gets_the_same_as_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tlog_info(CAPTURE) == 0
    out, _ = capsys.readouterr()
    assert "8144 records, 75.1 s" in out
    for word in ("ardupilot", "px4", "GUIDED", "OFFBOARD", "GLOBAL_POSITION_INT", "255/190"):
        assert word in out
    assert tlog_info(tlog(tmp_path / "[odd] name.tlog", frame("SYS_STATUS"))) == 0
    out, _ = capsys.readouterr()
    assert "[odd] name.tlog: tlog, 1 records" in out and "no vehicle" in out


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
