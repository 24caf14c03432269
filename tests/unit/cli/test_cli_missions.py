"""`mission check` and `mission convert`: what they print, write and exit with."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

from support.command_line import said
from support.table import each

DONE, FAILED, USAGE = 0, 1, 2
MISSION = [
    "0 1 0 16 0 0 0 0 43.78 -79.46 180 1",
    "1 0 3 22 0 0 0 0 43.78 -79.46 10 1",
    "2 0 3 16 0 0 0 0 43.7801 -79.46 nan 1",
]


run = partial(said)


def waypoints(folder: Path, *rows: str) -> Path:
    path = folder / "a.waypoints"
    path.write_text("\n".join(["QGC WPL 110", *rows]))
    return path


def fenced_plan(folder: Path) -> Path:
    square = [[43.779, -79.461], [43.779, -79.459], [43.781, -79.459], [43.781, -79.461]]
    item = {"type": "SimpleItem", "command": 22, "frame": 3, "params": [0, 0, 0, None, 43.78, -79.46, 10]}
    plan: dict[str, Any] = {
        "fileType": "Plan",
        "version": 1,
        "mission": {"version": 2, "items": [item], "plannedHomePosition": [43.78, -79.46, 180]},
        "geoFence": {"version": 2, "polygons": [{"inclusion": True, "polygon": square, "version": 1}]},
    }
    path = folder / "fenced.plan"
    path.write_text(json.dumps(plan))
    return path


def test_an_error_is_reported_with_its_item_and_the_exit_code(tmp_path: Path) -> None:
    said = run("mission", "check", waypoints(tmp_path, *MISSION), code=FAILED)
    assert "2 mission items, home at 43.78, -79.46" in said
    assert "ERROR    mission item 2: the altitude is not set (NaN)" in said
    assert "1 error, 0 warnings" in said


def test_json_holds_items_and_findings(tmp_path: Path) -> None:
    answer = json.loads(run("mission", "check", waypoints(tmp_path, *MISSION), "--json", code=FAILED))
    assert answer["ok"] is False
    assert answer["mission"][1]["params"] == [0, 0, 0, 0, 43.7801, -79.46, None]
    assert answer["mission"][0]["name"] == "MAV_CMD_NAV_TAKEOFF"
    assert answer["findings"] == [
        {"severity": "error", "list": "mission", "item": 2, "text": "the altitude is not set (NaN)"}
    ]


@each("content", [None, b"\xff\xfe", b'{"a": 1,', b"QGC WPL 110\n1 2 3"])
def test_json_of_a_file_that_cannot_be_read_is_json(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "a.plan"
    if content is not None:
        path.write_bytes(content)
    answer = json.loads(run("mission", "check", path, "--json", code=FAILED))
    good = json.loads(run("mission", "check", fenced_plan(tmp_path), "--json"))
    assert answer.keys() == good.keys() and answer["ok"] is False and answer["mission"] == []
    (finding,) = answer["findings"]
    assert finding["severity"] == "error" and str(path) in finding["text"]


@each(
    ("options", "said"),
    [
        (("--max-height", "5"), "over the limit of 5 m"),
        (("--vehicle", "43.9,-79.46"), "from the vehicle, over the limit of 1,000 m"),
        (("--max-items", "2", "--autopilot", "ardupilot"), "3 items are too many"),
    ],
)
def test_limits_are_options(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    assert said in run("mission", "check", waypoints(tmp_path, *MISSION), *options, code=FAILED)


def test_a_good_plan_has_no_problem(tmp_path: Path) -> None:
    said = run("mission", "check", fenced_plan(tmp_path), "--max-distance", "1e4", "--vehicle", "43.77,-79.46")
    assert "1 mission item, a fence of 1 polygon, home" in said
    assert said.endswith("no problem found\n")


@each("options", [("--max-height", "nan"), ("--vehicle", "1"), ("--vehicle", "91,0")])
def test_a_wrong_option_is_usage(tmp_path: Path, options: tuple[str, ...]) -> None:
    run("mission", "check", waypoints(tmp_path, *MISSION), *options, code=USAGE)


def test_a_file_that_is_no_plan_is_one_line(tmp_path: Path) -> None:
    said = run("mission", "check", waypoints(tmp_path, MISSION[0], MISSION[2]), code=FAILED)
    assert said.startswith("skygcs-cli: ") and "line 3: item 1 is missing: this is item 2" in said
    assert "cannot be read: No such file" in run("mission", "check", tmp_path / "gone.plan", code=FAILED)


def test_a_mission_goes_into_the_other_format_and_back(tmp_path: Path) -> None:
    source, there, back = waypoints(tmp_path, *MISSION), tmp_path / "b.plan", tmp_path / "c.waypoints"
    assert "2 mission items" in run("mission", "convert", source, there)
    run("mission", "convert", there, back)
    assert [line.split() for line in back.read_text().splitlines()[1:]] == [row.split() for row in MISSION]


def test_a_fenced_plan_needs_a_choice_for_wpl(tmp_path: Path) -> None:
    source, target = fenced_plan(tmp_path), tmp_path / "b.waypoints"
    assert "choose with --only" in run("mission", "convert", source, target, code=FAILED)
    assert not target.exists()
    run("mission", "convert", source, target, "--only", "fence")
    assert target.read_text().count("5001") == 4


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    source, target = fenced_plan(tmp_path), tmp_path / "b.plan"
    target.write_text("precious")
    assert "exists; --force overwrites it" in run("mission", "convert", source, target, code=FAILED)
    assert target.read_text() == "precious"
    run("mission", "convert", source, target, "--force")
    assert "precious" not in target.read_text()


def test_an_unknown_ending_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    assert "must end in .plan" in run("mission", "convert", fenced_plan(tmp_path), tmp_path / "b.kml", code=FAILED)
    assert not (tmp_path / "b.kml").exists()


SURVEYED = (
    "0 1 0 16 0 0 0 0 43.78 -79.46 180 1",
    "1 0 3 22 0 0 0 0 43.78 -79.46 20 1",
    "2 0 2 530 0 2 0 0 0 0 0 1",
    "3 0 3 16 0 0 0 0 43.7801 -79.46 20 1",
    "4 0 3 20 0 0 0 0 43.78 -79.46 20 1",
)


@each(
    ("autopilot", "line"),
    [
        ("px4", "  changed  mission item 4: the position of NAV_RETURN_TO_LAUNCH"),
        ("ardupilot", "  changed  mission item 2: SET_CAMERA_MODE, which an ArduPilot does not take, is left out"),
    ],
)
def test_the_check_says_what_an_upload_would_change(tmp_path: Path, autopilot: str, line: str) -> None:
    path = waypoints(tmp_path, *SURVEYED)
    text = run("mission", "check", path, "--autopilot", autopilot)
    assert line in text and text.endswith("no problem found\n")
    (change,) = json.loads(run("mission", "check", path, "--autopilot", autopilot, "--json"))["changes"]
    assert change["text"] in text
    assert "changed" not in run("mission", "check", path)


def test_a_plan_is_converted_for_an_autopilot(tmp_path: Path) -> None:
    path, out = waypoints(tmp_path, *SURVEYED), tmp_path / "out.plan"
    assert "changed: mission item 2: SET_CAMERA_MODE" in run(
        "mission", "convert", path, out, "--autopilot", "ardupilot"
    )
    assert [item["command"] for item in json.loads(out.read_text())["mission"]["items"]] == [22, 16, 20]
    run("mission", "convert", path, out, "--force")
    assert [item["command"] for item in json.loads(out.read_text())["mission"]["items"]] == [22, 530, 16, 20]
