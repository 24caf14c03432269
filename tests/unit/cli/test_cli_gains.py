"""`skygcs-cli gains`: what it answers, prints and draws, and what it does not take."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from skygcs.cli.gains import Question
from support.command_line import said
from support.public_data import ROOT
from support.table import each

COSTS = "step responses of three loops, and matplotlib"

DONE, FAILED, USAGE = 0, 1, 2
SHORT = ("--duration", "2")
"""Where the responses do not matter."""

UTIAS = ("--xy", "0.95,0.08,0.02", "--z", "1,0.3,0.02")


run = partial(said, "gains")


@cache
def answer(*args: str) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    found: dict[str, Any] = json.loads(run(*args, "--json"), parse_constant=refuse)
    return found


def loop(found: dict[str, Any], axis: str, plant: str) -> dict[str, Any]:
    (one,) = (x for x in found["loops"] if (x["axis"], x["plant"]) == (axis, plant))
    return dict(one)


def test_without_gains_it_is_about_the_default_gains_on_both_plants() -> None:
    found = answer()
    assert found == answer(*UTIAS, "--hover", "0.45")
    expected = {("xy", "tilt"): 9.81, ("z", "tilt"): 1.0, ("xy", "thrust"): 21.8, ("z", "thrust"): 21.8}
    assert {(x["axis"], x["plant"]): round(x["plant_gain"], 3) for x in found["loops"]} == expected
    margins = loop(found, "z", "thrust")["margins"]
    assert margins["crossover_radps"] == pytest.approx(6.615, abs=1e-3)
    assert margins["phase_margin_deg"] == pytest.approx(80.8, abs=0.05)
    assert margins["delay_margin_s"] == pytest.approx(0.213, abs=1e-3)
    assert margins["gain_up"] is None and margins["gain_down"] == pytest.approx(104.64)
    assert loop(found, "xy", "thrust")["polynomial"] == pytest.approx([1, 1.744, 2.0928, 0.4142])
    assert loop(found, "xy", "thrust")["routh_first_column"] == pytest.approx([1, 1.744, 1.8553, 0.4142])
    assert all(x["stable"] and x["suggestion"] is None and x["margins_with_delay"] is None for x in found["loops"])


def test_without_options_it_prints_three_lines_and_a_hint() -> None:
    lines = run().splitlines()
    assert [line.split()[0] for line in lines[:3]] == ["default", "xy", "z"]
    assert "Kp 0.95  Kv 0.08  Ki 0.02" in lines[1] and "0.507 s" in lines[1] and "0.213 s" in lines[2]
    assert len(lines) == 5 and "--delay" in lines[-1] and "--full" in lines[-1]
    assert len(run("--hover", "0.4", *SHORT).splitlines()) > 20


def test_eq_16_is_reported_row_by_row_and_y_as_unstable() -> None:
    rows = answer()["utias_eq16"]
    numbers = {axis: (round(row["kiv"], 3), round(row["kpv"], 3)) for axis, row in rows.items()}
    assert {axis: n for axis, n in numbers.items() if axis != "x"} == {"y": (0.125, 0.712), "z": (0.305, 0.234)}
    assert numbers["x"] == (pytest.approx(0.815, abs=6e-4), 0.556)
    assert round(rows["y"]["kpx"], 3) == -1.497
    assert [round(pole, 3) for pole in rows["y"]["unstable_poles"]] == [1.497]
    assert rows["x"]["unstable_poles"] == rows["z"]["unstable_poles"] == []
    text = run("--full", *SHORT)
    for word in ("0.815", "0.556", "0.125", "0.712", "0.305", "0.234", "K'Px = -1.497", "unstable pole at +1.497"):
        assert word in text


@each("args", [("--xy", "0.95,0.09,0.02"), ("--z", "1,0.2,0.02"), ("--plant-gain", "9.81,1")])
def test_eq_16_is_not_reported_of_other_gains(args: tuple[str, str]) -> None:
    assert answer(*args, *SHORT)["utias_eq16"] is None
    assert "Eq. 16" not in run(*args, *SHORT)


def test_a_delay_brings_what_is_left_and_gains_with_twice_the_delay_as_margin() -> None:
    found = answer("--delay", "0.3", "--lag", "0", "--rate", "1000", *SHORT)
    xy, z = loop(found, "xy", "thrust"), loop(found, "z", "thrust")
    assert xy["margins_with_delay"]["delay_margin_s"] == pytest.approx(0.207, abs=1e-3)
    assert xy["margins_with_delay"]["gain_up"] > 1
    assert z["margins_with_delay"] is None
    assert xy["suggestion"]["factor"] == pytest.approx(0.602 / 0.50707, rel=1e-4)
    for one in (xy, z):
        assert one["suggestion"]["margins"]["delay_margin_s"] == pytest.approx(0.602)
        assert one["suggestion"]["delay_margin_s"] == pytest.approx(0.602)
        factor, gains = one["suggestion"]["factor"], found["gains"][one["axis"]]
        assert one["suggestion"]["gains"] == pytest.approx(
            {
                "pos_p_per_s": gains["pos_p_per_s"] / factor,
                "vel_p": gains["vel_p"] / factor,
                "vel_i": gains["vel_i"] / factor**2,
                "vel_d": 0.0,
            }
        )
    text = run("--delay", "0.3", *SHORT)
    assert "left with 0.3 s" in text and "UNSTABLE" in text and "λ" in text


def test_a_delay_brings_the_margin_of_velocity_with_prediction() -> None:
    found = answer("--delay", "0.8", *SHORT)["velocity_prediction"]
    assert found["px4"]["holds"] and found["ardupilot"]["holds"]
    assert found["px4"]["least_s"] == 0.0 and round(found["px4"]["most_s"], 2) == 1.38
    assert round(found["px4"]["margin_s"], 2) == 0.58
    assert not answer("--delay", "1.5", *SHORT)["velocity_prediction"]["px4"]["holds"]
    assert answer("--delay", "0.8", "--xy", "-1,0.1,0.1", *SHORT)["velocity_prediction"]["px4"] is None
    assert answer()["velocity_prediction"] is None
    assert "velocity with prediction, px4: stable from 0.000 to 1.378 s" in run("--delay", "0.8", *SHORT)


def test_the_reserve_is_the_users() -> None:
    found = loop(answer("--delay", "0.3", "--reserve", "3", *SHORT), "z", "thrust")
    assert found["suggestion"]["delay_margin_s"] == pytest.approx(3 * (0.3 + 0.01 + 0.01))


def test_rate_telemetry_and_lag_count_in_what_is_suggested() -> None:
    def factor(*args: str) -> float:
        return float(loop(answer("--delay", "0.1", *args, *SHORT), "z", "thrust")["suggestion"]["factor"])

    assert factor("--lag", "0") == pytest.approx(2 * 0.12 / 0.21329, rel=1e-3)
    assert factor("--lag", "0", "--rate", "5") == pytest.approx(2 * 0.3 / 0.21329, rel=1e-3)
    assert factor("--lag", "0", "--rate", "50", "--telemetry", "5") == pytest.approx(2 * 0.21 / 0.21329, rel=1e-3)
    assert factor("--rate", "5") > factor("--lag", "0", "--rate", "5") + 0.5
    suggested = loop(answer("--delay", "0.1", "--rate", "5"), "z", "thrust")["steps"][-1]
    assert suggested["gains"] == "suggested" and suggested["stable"] and suggested["overshoot"] < 0.3
    assert "positions at 4 Hz" in run("--delay", "0.1", "--rate", "20", "--telemetry", "4", *SHORT)


@each("args", [("--lag", "-1"), ("--lag", "3"), ("--telemetry", "0"), ("--telemetry", "nan")])
def test_a_lag_or_a_rate_that_no_vehicle_has_is_no_option(args: tuple[str, str]) -> None:
    run("--delay", "0.1", *args, code=USAGE)


def test_gains_that_bear_the_delay_are_left_and_no_third_response_is_made() -> None:
    found = answer("--delay", "0.05", "--lag", "0.05", *SHORT)
    assert [x["suggestion"]["factor"] for x in found["loops"]] == [1.0] * 4
    assert [len(x["steps"]) for x in found["loops"]] == [2] * 4
    assert run("--delay", "0.05", "--lag", "0.05", *SHORT).count("as they are") == 4


def test_no_delay_at_all_makes_one_response() -> None:
    assert [len(x["steps"]) for x in answer("--delay", "0", *SHORT)["loops"]] == [1] * 4


def test_step_responses_have_figures_and_a_trace() -> None:
    steps = loop(answer("--delay", "0.3", "--duration", "20", "--lag", "0"), "xy", "thrust")["steps"]
    assert [(s["gains"], s["delay_s"]) for s in steps] == [("given", 0.0), ("given", 0.3), ("suggested", 0.3)]
    for step in steps:
        every_s = 0.04 if step["gains"] == "suggested" else 0.05  # at 50 Hz, and continuous
        assert step["stable"] and step["every_s"] == pytest.approx(every_s)
        assert len(step["positions"]) == round(20 / every_s) + 1
        assert step["positions"][0] == 0.0 and step["positions"][-1] == pytest.approx(1, abs=0.05)
    assert steps[0]["overshoot"] == pytest.approx(0.08, abs=1e-3)
    assert steps[0]["overshoot"] < steps[2]["overshoot"] < steps[1]["overshoot"]


def test_an_unstable_response_has_no_figures_but_a_trace() -> None:
    step = loop(answer("--delay", "0.3"), "z", "thrust")["steps"][1]
    assert (step["stable"], step["overshoot"], step["rise_s"], step["settling_s"]) == (False, None, None, None)
    assert max(step["positions"]) > 100


def test_a_rate_is_a_delay_of_half_its_period() -> None:
    """0.5 s is borne by xy (0.507 s) continuously, and not at 50 Hz."""
    smooth = loop(answer("--delay", "0.5"), "xy", "thrust")["steps"][1]
    sampled = loop(answer("--delay", "0.5", "--rate", "50"), "xy", "thrust")["steps"][1]
    assert (smooth["stable"], sampled["stable"]) == (True, False)
    text = run("--rate", "50", *SHORT)
    assert "at 50 Hz" in text


def test_a_plant_gain_of_ones_own_replaces_both() -> None:
    expected = [("xy", "given", 15.0), ("z", "given", 15.0)]
    assert [(x["axis"], x["plant"], x["plant_gain"]) for x in answer("--plant-gain", "15", *SHORT)["loops"]] == expected
    assert [x["plant_gain"] for x in answer("--plant-gain", "15,3", *SHORT)["loops"]] == [15.0, 3.0]


def test_hover_thrust_sets_the_gain_of_thrust() -> None:
    assert loop(answer("--hover", "0.3", *SHORT), "z", "thrust")["plant_gain"] == pytest.approx(32.7)


def test_unstable_gains_are_reported_as_such_and_get_no_suggestion() -> None:
    args = ("--xy", "0.95,0.08,0.02", "--plant-gain", "-9.81", "--delay", "0.2", *SHORT)
    found = loop(answer(*args), "xy", "given")
    assert (found["stable"], found["margins"], found["suggestion"]) == (False, None, None)
    assert found["poles"][0] == {"re": pytest.approx(1.497, abs=1e-3), "im": 0.0}
    text = run(*args)
    assert "UNSTABLE" in text and "slower gains do not help" in text


def test_a_law_without_integrator_is_analysed_too() -> None:
    found = loop(answer("--xy", "0.95,0.08,0", *SHORT), "xy", "thrust")
    assert len(found["poles"]) == 2 and found["factorings"] == []
    assert found["margins"]["gain_down"] is None
    assert "÷∞ to ×∞" in run("--xy", "0.95,0.08,0", *SHORT)


@each(
    ("args", "word"),
    [
        (("--xy", "1,2"), "3 numbers"),
        (("--z", "1,2,x"), "not a number"),
        (("--z", "1,nan,2"), "not a finite number"),
        (("--xy", "1e9,1,1"), "1e+06"),
        (("--plant-gain", "0"), "not 0"),
        (("--plant-gain", "1,2,3"), "1 or 2 numbers"),
        (("--hover", "0"), "--hover"),
        (("--hover", "nan"), "--hover"),
        (("--delay", "-1"), "--delay"),
        (("--delay", "inf"), "--delay"),
        (("--reserve", "0.5"), "--reserve"),
        (("--rate", "0"), "--rate"),
        (("--duration", "1e6"), "--duration"),
        (("--plot", "x.pdf"), ".svg"),
    ],
)
def test_a_wrong_option_is_a_usage_error_that_names_it(args: tuple[str, str], word: str) -> None:
    assert word in run(*args, code=USAGE)


def test_defaults_of_the_options_are_those_of_the_analysis() -> None:
    wanted = Question()
    found = answer("--delay", "0.1")
    assert (found["hover"], found["reserve"]) == (wanted.hover, wanted.reserve)
    assert found["loops"][0]["steps"][0]["every_s"] * 600 == pytest.approx(wanted.duration_s)


def test_svg_is_a_figure_with_every_loop_and_its_margin(tmp_path: Path) -> None:
    file = tmp_path / "steps.svg"
    assert str(file) in run("--delay", "0.3", "--plot", str(file), *SHORT)
    root = ElementTree.parse(file).getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    text = "\n".join(root.itertext())
    for word in (
        "xy, normalised thrust, G = 21.8: delay margin 0.507 s",
        "z, tilt angle and vertical acceleration, G = 1",
    ):
        assert word in text
    kp = loop(answer("--delay", "0.3"), "z", "thrust")["suggestion"]["gains"]["pos_p_per_s"]
    assert "0.3 s delay: unstable" in text and f"suggested: Kp {kp:.4g}" in text


def test_png_is_a_picture_with_lines_in_it(tmp_path: Path) -> None:
    from matplotlib.image import imread

    file = tmp_path / "steps.PNG"
    run("--plot", str(file), "--plant-gain", "21.8", *SHORT)
    picture = imread(file, format="png")
    assert picture.shape[0] > 600 and picture.shape[1] > 600
    blue = (abs(picture[..., :3] - (0, 0x72 / 255, 0xB2 / 255)) < 0.02).all(axis=2)
    assert blue.sum() > 300  # of the curves, and not only of the legend


@pytest.mark.deep  # draws, as the two above
def test_json_and_plot_go_together_and_stdout_stays_json(tmp_path: Path) -> None:
    assert answer("--plot", str(tmp_path / "x.svg"), *SHORT)["loops"]
    assert (tmp_path / "x.svg").exists()


def test_a_plot_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    text = run("--plot", str(tmp_path / "missing" / "x.svg"), *SHORT, code=FAILED)
    assert "No such file" in text and text.count("\n") == 1


def test_without_matplotlib_it_says_how_to_get_it_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    text = run("--plot", str(tmp_path / "x.png"), code=FAILED)
    assert "pip install 'skygcs[plot]'" in text and text.count("\n") == 1
    assert not list(tmp_path.iterdir())
    assert run(*SHORT)


@pytest.mark.system
def test_only_what_is_needed_is_imported() -> None:
    """No numpy for the other commands, no matplotlib without a plot, no rich for JSON."""
    script = (
        "import sys\n"
        "from skygcs.cli.main import app\n"
        "heavy = ('numpy', 'matplotlib', 'rich', 'skygcs.core.control')\n"
        "print([m for m in heavy if m in sys.modules], file=sys.stderr)\n"
        "app(['gains', '--json'], standalone_mode=False)\n"
        "print([m for m in heavy if m in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert done.stderr.splitlines() == ["[]", "['numpy', 'skygcs.core.control']"]


def test_the_reference_names_every_key_of_the_answer() -> None:
    text = (ROOT / "docs" / "reference" / "gains.md").read_text(encoding="utf-8")
    found = answer("--delay", "0.3")
    one = loop(found, "xy", "thrust")
    parts = (
        found,
        one,
        one["margins"],
        one["suggestion"],
        one["steps"][0],
        found["gains"]["xy"],
        found["utias_eq16"]["y"],
    )
    missing = {key for part in parts for key in part if f"`{key}`" not in text}
    assert not missing
