"""`skygcs-cli plan`: exit code 0 certified, 1 refused, 2 usage."""

from __future__ import annotations

import io
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner, Result

from skygcs.cli.main import app
from skygcs.ext.plans.commands.plan_certificates import _print_terms
from support.table import each

GOALS = """vehicle,x,y,z
alpha,0,0,10
alpha,20,0,10
bravo,20,0,10
bravo,0,0,10
charlie,10,-10,10
charlie,10,10,10
"""
PASSING = "vehicle,t,x,y,z\nalpha,0,0,0,10\nalpha,10,40,0,10\nbravo,0,40,{0},10\nbravo,10,0,{0},10\n"


@pytest.fixture
def goals(tmp_path: Path) -> str:
    path = tmp_path / "goals.csv"
    path.write_text(GOALS)
    return str(path)


def plan(*args: object) -> Result:
    return CliRunner().invoke(app, ["plan", *map(str, args)])


def test_the_terms_of_a_margin_are_whole_on_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = "v9 measured over 102 s; v10 measured over 97 s, and the clock measured by 125 exchanges"
    shown = io.StringIO()
    monkeypatch.setattr("skygcs.ext.plans.commands.plan_certificates.console", lambda: Console(file=shown, width=80))
    closest = {
        "vehicles": ["v9", "v10"],
        "terms": {"v9": {"tracking error p99": 0.658}, "v10": {"tracking error p99": 0.659}},
        "sources": {"v9": {"tracking error p99": measured}, "v10": {"tracking error p99": measured}},
    }
    _print_terms(closest, 2.0)
    assert "0.658" in shown.getvalue() and "0.659" in shown.getvalue() and "exchanges" in shown.getvalue()


def test_a_plan_is_made_written_and_certified_again(goals: str, tmp_path: Path) -> None:
    output = tmp_path / "plan.json"
    made = plan("make", goals, "-o", output)
    assert made.exit_code == 0, made.output
    assert "plan: 3 layers" in made.output and "tried before: straight, timed: alpha and bravo" in made.output
    checked = plan("check", output, "--json")
    assert checked.exit_code == 0
    answer = json.loads(checked.output)
    assert (answer["certified"], answer["kind"], answer["vehicles"]) == (True, "phased", 3)
    wanted = {"half wingspan": 0.35, "position error": 0.9, "tracking error p99": 0.4}
    assert answer["closest"]["terms"]["alpha"] == wanted
    assert answer["closest"]["distance_at_least_m"] >= answer["closest"]["margin_m"]


def test_what_a_file_says_of_itself_is_not_believed(goals: str, tmp_path: Path) -> None:
    output = tmp_path / "plan.json"
    plan("make", goals, "-o", output)
    content = json.loads(output.read_text())
    for phase in content["phases"]:
        for place in phase["goals"].values():
            place[2] = 10.0  # all at one height
    output.write_text(json.dumps(content))
    refused = plan("check", output)
    assert refused.exit_code == 1
    assert "REFUSED: 3 vehicles, phased" in refused.output
    assert "alpha and bravo come within 0.000 m in phase cross" in refused.output


@each(("beside", "code"), [("2.499", 1), ("2.501", 0)])
def test_a_path_file_is_certified_to_the_millimetre(beside: str, code: int, tmp_path: Path) -> None:
    path = tmp_path / "paths.csv"
    path.write_text(PASSING.format(beside))
    checked = plan("check", path, "--margin", 2.5)
    assert checked.exit_code == code, checked.output
    assert f"alpha and bravo come within {beside} m at 5.00 s" in checked.output


@each("name", ["show.skyc", "folder", "plan.json"])
def test_exchanged_goals_are_written_in_formats_of_others_and_read_again(goals: str, name: str, tmp_path: Path) -> None:
    output = tmp_path / name
    made = plan("make", goals, "--exchange", "--margin", 2.5, "-o", output)
    assert made.exit_code == 0 and "plan: straight, timed" in made.output
    files = sorted(output.glob("*.csv")) if output.is_dir() else [output]
    assert plan("check", *files, "--margin", 2.5).exit_code == 0
    shown = json.loads(plan("show", *files, "--json").output)
    assert sorted(shown["vehicles"]) == ["alpha", "bravo", "charlie"]


def test_a_refusal_names_pair_time_and_place(goals: str, tmp_path: Path) -> None:
    output = tmp_path / "plan.json"
    refused = plan("make", goals, "--kind", "timed", "--margin", 2.5, "-o", output, "--json")
    assert refused.exit_code == 1
    (reason,) = json.loads(refused.output)["reasons"]
    assert reason.startswith("straight, timed: alpha and bravo come within 0.000 m at 3.88 s, at (10.00, 0.00, 10.00)")
    assert not output.exists()


def test_a_formation_is_the_goal(goals: str) -> None:
    made = plan("make", goals, "--formation", "line", "--spacing", 6, "--at", "50,0,10", "--margin", 2.5, "--json")
    assert made.exit_code == 0, made.output
    assert json.loads(made.output)["closest"]["distance_m"] >= 2.5


def test_a_formation_from_a_file_is_moved_turned_and_scaled(goals: str, tmp_path: Path) -> None:
    star, output = tmp_path / "star.csv", tmp_path / "plan.json"
    star.write_text("x,y,z\n100,0,1\n108,0,3\n100,8,1\n")
    made = plan("make", goals, "--formation", star, "--at", "0,0,15", "--yaw", 90, "--scale", 2, "-o", output)
    assert made.exit_code == 0, made.output
    ends = [v["end_m"] for v in json.loads(plan("show", output, "--json").output)["vehicles"].values()]
    # about their middle (102.667, 2.667, 1.667): x → y, y → -x, twice as large
    assert sorted(ends) == [[-10.667, -5.333, 13.667], [5.333, -5.333, 13.667], [5.333, 10.667, 17.667]]


def test_the_current_formation_is_turned_about_its_middle(goals: str, tmp_path: Path) -> None:
    output = tmp_path / "plan.json"
    made = plan("make", goals, "--formation", "current", "--yaw", 180, "--scale", 2, "-o", output)
    assert made.exit_code == 0, made.output
    shown = json.loads(plan("show", output, "--json").output)["vehicles"]
    assert shown["alpha"]["end_m"] == pytest.approx([30.0, -10.0, 10.0], abs=0.001)
    assert shown["bravo"]["end_m"] == pytest.approx([-10.0, -10.0, 10.0], abs=0.001)


@each(
    ("options", "code", "words"),
    [
        (("--formation", "star", "--at", "0,0,9"), 2, "neither one of line, column"),
        (("--formation", "line"), 2, "needs --at"),
        (("--formation", "line", "--at", "0,0"), 2, "not 3 numbers"),
        (("--formation", "missing.csv"), 1, "missing.csv: cannot be read: No such file"),
        (("--formation", "current", "--scale", 0), 1, "a scale of 0"),
    ],
)
def test_a_formation_that_is_none_is_an_error(goals: str, options: tuple[object, ...], code: int, words: str) -> None:
    made = plan("make", goals, *options)
    assert made.exit_code == code and words in made.output, made.output


MISSION = {
    "fileType": "Plan",
    "version": 1,
    "mission": {
        "version": 2,
        "plannedHomePosition": [47.0, 8.0, 400.0],
        "items": [
            {"type": "SimpleItem", "command": 22, "frame": 3, "params": [0, 0, 0, None, 47.0, 8.0, 10]},
            {"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, 47.0005, 8.0, 10]},
            {"type": "SimpleItem", "command": 20, "frame": 2, "params": [0, 0, 0, 0, 0, 0, 0]},
        ],
    },
}


def test_missions_of_qgroundcontrol_are_paths_of_vehicles(tmp_path: Path) -> None:
    file, output = tmp_path / "alpha.plan", tmp_path / "plan.json"
    file.write_text(json.dumps(MISSION))
    shown = plan("show", file, f"bravo={file}", "--json")
    assert json.loads(shown.stdout)["vehicles"].keys() == {"alpha", "bravo"}
    assert "positions are about 47.0000000, 8.0000000, 400.00 m AMSL" in shown.stderr
    refused = plan("check", file, f"bravo={file}")
    assert refused.exit_code == 1 and "alpha and bravo come within 0.000 m" in refused.output
    assert plan("make", file, "-o", output).exit_code == 0
    assert json.loads(output.read_text())["vehicles"].keys() == {"alpha"}
    twice = plan("check", file, file)
    assert twice.exit_code == 1 and "vehicle alpha is in two files; NAME=FILE" in twice.output
    camera = json.loads(json.dumps(MISSION))
    camera["mission"]["items"][1]["command"] = 2000
    file.write_text(json.dumps(camera))
    other = plan("check", file)
    assert other.exit_code == 1 and "alpha.plan: item 2: IMAGE_START_CAPTURE" in other.output


def test_a_table_of_positions_is_planned(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("vehicle,initial_x,initial_y,initial_z,final_x,final_y,final_z\na,0,0,5,9,0,5\nb,0,9,5,9,9,5\n")
    assert plan("make", table, "--margin", 2.5).exit_code == 0


@each(
    "options",
    [
        ("--ceiling", 16.0),
        ("--standing", "parked,10,0,10", "--kind", "timed", "--exchange"),
        ("--fence", "-5,-5;25,-5;25,5;-5,5"),
        ("--floor", 11.0),
    ],
)
def test_the_space_is_kept(goals: str, options: tuple[object, ...]) -> None:
    assert plan("make", goals, "--margin", 2.5, *options).exit_code == 1


@each(
    "options",
    [
        ("--margin", 0),
        ("--margin", "nan"),
        ("--downwash", 0),
        ("--wingspan", -1),
        ("--limits", "1,2"),
        ("--limits", "0,2,4"),
        ("--fence", "0,0;1,1"),
        ("--standing", "parked,1,2"),
        ("--origin", "95,0,0"),
    ],
)
def test_options_that_are_wrong_are_usage_errors(goals: str, options: tuple[object, ...]) -> None:
    assert plan("check", goals, *options).exit_code == 2


def test_files_that_cannot_be_read_are_one_line(tmp_path: Path) -> None:
    broken = tmp_path / "broken.json"
    broken.write_text("{")
    for file, words in ((broken, "not JSON"), (tmp_path / "none.csv", "No such file"), (tmp_path, "Is a directory")):
        refused = plan("check", file)
        assert refused.exit_code == 1
        assert words in refused.stderr and len(refused.stderr.splitlines()) == 1


def test_two_files_of_one_vehicle_are_refused(goals: str, tmp_path: Path) -> None:
    folder = tmp_path / "flown"
    plan("make", goals, "--margin", 2.5, "-o", folder)
    alpha = folder / "alpha.csv"
    (tmp_path / "alpha.csv").write_text(alpha.read_text())
    assert "vehicle alpha is in two files" in plan("check", alpha, tmp_path / "alpha.csv").stderr


def test_a_plan_is_drawn_as_a_picture_and_as_a_page_of_its_own(goals: str, tmp_path: Path) -> None:
    written = tmp_path / "plan.json"
    plan("make", goals, "-o", written)
    text = written.read_text().replace("alpha", "<b>&alpha")
    written.write_text(text)
    for name in ("plan.svg", "plan.html"):
        shown = plan("show", written, "-o", tmp_path / name)
        assert shown.exit_code == 0, shown.output
    picture = ElementTree.fromstring((tmp_path / "plan.svg").read_text())
    names = [element.text for element in picture.iter("{http://www.w3.org/2000/svg}text")]
    assert "<b>&alpha" in names and "bravo" in names
    assert len(list(picture.iter("{http://www.w3.org/2000/svg}polyline"))) == 6
    page = (tmp_path / "plan.html").read_text()
    assert "<b>" not in page and "@" not in page.replace("@media", "")
    assert plan("show", written, "-o", tmp_path / "plan.gif").exit_code == 2
