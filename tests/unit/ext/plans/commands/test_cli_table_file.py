"""Tables of positions: both formats, and everything that can be wrong with them."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import ConfigError, SkygcsError
from skygcs.ext.plans.commands.table import read_table
from skygcs.ext.plans.position_table import Spot, spots
from support.table import each

CSV = """# two vehicles
vehicle,initial_x,initial_y,initial_z,initial_heading_deg,final_x,final_y,final_z,final_heading_deg
alpha,0,0,5,,10,-2.5,5,90

bravo, 5, 0, 5, 180, , , ,
"""
TOML = """
[vehicles.alpha]
initial = [0, 0, 5]
final = [10, -2.5, 5]
final_heading_deg = 90

[vehicles.bravo]
initial = [5, 0, 5]
initial_heading_deg = 180.0
"""


def written(folder: Path, text: str, name: str = "t.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def problems(folder: Path, text: str, name: str = "t.csv") -> str:
    with pytest.raises(ConfigError) as error:
        read_table(written(folder, text, name))
    return "\n".join(error.value.problems)


@each(("text", "name"), [(CSV, "t.csv"), (TOML, "t.toml"), ("\ufeff" + CSV, "excel.csv")])
def test_both_formats_say_the_same(tmp_path: Path, text: str, name: str) -> None:
    table = read_table(written(tmp_path, text, name))
    assert table == {
        "alpha": {"initial": Spot((0.0, 0.0, 5.0)), "final": Spot((10.0, -2.5, 5.0), 90.0)},
        "bravo": {"initial": Spot((5.0, 0.0, 5.0), 180.0)},
    }
    assert list(spots(table, "final")) == ["alpha"]


def test_columns_that_are_not_needed_may_be_missing(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, "final_z,final_y,final_x,vehicle\n3,2,1,7\n"))
    assert table == {"7": {"final": Spot((1.0, 2.0, 3.0))}}


def test_every_problem_is_reported_at_once_with_its_line(tmp_path: Path) -> None:
    text = problems(
        tmp_path,
        "vehicle,final_x,final_y,final_z,final_heading_deg\n"
        "alpha,1,2,x,\n"
        "# a remark\n"
        "alpha,1,2,3,\n"
        ",1,2,3,\n"
        "bravo,1,,3,400\n"
        "carol,,,,90\n"
        "delta,1,2,3,4,5\n"
        "echo,1e9,inf,nan,\n",
    )
    for line in (
        "line 2: final z: 'x' is not a number",
        "line 4: alpha has a row already",
        "line 5: it names no vehicle",
        "line 6: final y: missing",
        "line 6: final_heading_deg: 400 is not within ±360",
        "line 7: final_heading_deg without a position",
        "line 7: neither an initial nor a final position",
        "line 8: 6 cells; the header has 5",
        "line 9: final x: 1e+09 is not within ±100000",
        "line 9: final y: inf is not within",
        "line 9: final z: nan is not within",
    ):
        assert line in text


@each(
    ("text", "name", "reason"),
    [
        ("", "t.csv", "it names no vehicle"),
        ("vehicle,final_x\n", "t.csv", "it names no vehicle"),
        ("name,x,y,z\nalpha,1,2,3\n", "t.csv", "not 'name'"),
        ("vehicle,final_x,final_x\n", "t.csv", "the columns are"),
        ("vehicle,final_x,final_y,final_z\n" + "".join(f"v{i},{i},0,5\n" for i in range(300)), "t.csv", "at most 255"),
        ("vehicle,final_x,final_y,final_z\na," + "9" * 200_000, "t.csv", "not CSV: field larger than"),
        ("vehicle,final_x,final_y,final_z\n" + "v,1,2,x\n" * 250, "t.csv", "and 200 more"),
        ("", "t.toml", "it names no vehicle"),
        ("[vehicles", "t.toml", "Expected ']'"),
        ("a = 1\n[vehicles.a]\nfinal=[1,2,3]", "t.toml", "a: unknown"),
        ("vehicles = 3", "t.toml", "vehicles: must be tables"),
        ("[vehicles]\na = 3", "t.toml", "vehicles.a: must be a table"),
        ("[vehicles.a]\nfinal = [1, 2]", "t.toml", "three numbers"),
        ("[vehicles.a]\nfinal = [1, 2, true]", "t.toml", "True is not a number"),
        (f"[vehicles.a]\nfinal = [1, 2, {'9' * 400}]", "t.toml", "inf is not within"),
        ("[vehicles.a]\nfinal = [1, 2, 3]\nyaw = 3", "t.toml", "no key 'yaw'"),
        ("[vehicles.a]\ninitial_heading_deg = 3", "t.toml", "neither an initial nor"),
    ],
)
def test_a_file_that_is_no_table_is_refused_with_the_expected_form(
    tmp_path: Path, text: str, name: str, reason: str
) -> None:
    assert reason in problems(tmp_path, text, name)


def test_a_file_that_cannot_be_read_or_is_no_text_is_reported(tmp_path: Path) -> None:
    with pytest.raises(SkygcsError, match="No such file"):
        read_table(tmp_path / "none.csv")
    (tmp_path / "x.csv").write_bytes(b"vehicle\xff")
    with pytest.raises(SkygcsError, match="not UTF-8 at byte 7"):
        read_table(tmp_path / "x.csv")
    (tmp_path / "x.csv").write_bytes(b"#" * (2 << 20))
    with pytest.raises(SkygcsError, match="larger than 1 MiB"):
        read_table(tmp_path / "x.csv")


@given(st.text(max_size=200), st.sampled_from(["t.csv", "t.toml"]))
def test_any_text_is_a_table_or_an_error(tmp_path_factory: pytest.TempPathFactory, text: str, name: str) -> None:
    path = tmp_path_factory.mktemp("t") / name
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    for content in (text, "vehicle,final_x,final_y,final_z\n" + text):
        path.write_bytes(content.encode("utf-8", "surrogatepass"))
        with contextlib.suppress(SkygcsError):
            read_table(path)
