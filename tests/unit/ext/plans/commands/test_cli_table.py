"""`skygcs-cli table`: vehicles sent to their places, watched until they arrive."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.errors import ConfigError, RpcError, SkygcsError
from skygcs.ext.plans.commands.table import TableFlight, flight_table, read_table, send
from skygcs.ext.plans.position_table import Spot, spots
from support.controlled import Commanded
from support.fake_daemon import FakeOutcome
from support.table import each

DONE, FAILED, USAGE = 0, 1, 2
TABLE = """vehicle,initial_x,initial_y,initial_z,final_x,final_y,final_z,final_heading_deg
alpha,10,0,5,10,20,5,90
bravo,20,0,5,20,20,5,
3,30,0,5,30,20,5,-45
"""


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Commanded]:
    with Commanded(tmp_path) as fleet:
        yield fleet


@pytest.fixture
def table(tmp_path: Path) -> str:
    path = tmp_path / "places.csv"
    path.write_text(TABLE)
    return str(path)


def test_all_fly_to_their_places_and_their_arrivals_are_reported(fleet: Commanded, table: str) -> None:
    text = fleet.run("table", table, "final")
    assert "all 3 arrived in" in text
    assert sum("arrived, 0." in line for line in text.splitlines()) == 3
    order, place = fleet.vehicles["carol"].orders[0]
    assert (order, place["enu_m"], place["yaw_deg"]) == ("goto", [30.0, 20.0, 5.0], -45.0)
    assert fleet.vehicles["bravo"].orders[0][1]["yaw_deg"] is None


def test_a_vehicle_that_is_there_already_has_arrived(fleet: Commanded, table: str) -> None:
    assert fleet.json("table", table, "initial")["vehicles"]["alpha"]["arrived"]


def test_only_some_of_the_table(fleet: Commanded, table: str) -> None:
    answer = fleet.json("table", table, "final", "alpha,3")
    assert answer["ok"] and list(answer["vehicles"]) == ["alpha", "carol"]
    assert answer["vehicles"]["alpha"]["distance_m"] <= 0.5
    assert not fleet.vehicles["bravo"].orders
    assert "has no delta; it has: alpha, bravo, 3" in fleet.run("table", table, "final", "delta", code=FAILED)


def test_a_vehicle_that_does_not_arrive_in_time_is_named_with_its_distance(fleet: Commanded, table: str) -> None:
    fleet.vehicles["bravo"].stuck = True
    text = fleet.run("table", table, "final", "--timeout", "2", code=FAILED)
    assert "2 of 3 arrived in 2." in text and "not: bravo (20.00 m away)" in text


def test_a_vehicle_that_refuses_is_not_waited_for(fleet: Commanded, table: str) -> None:
    fleet.vehicles["bravo"].outcome = FakeOutcome(False, "refused", "refused: it is on the ground")
    text = fleet.run("table", table, "final", code=FAILED)
    assert "bravo does not fly: refused: it is on the ground" in text and "2 of 3 arrived" in text
    answer = fleet.json("table", table, "final", code=FAILED)
    assert answer["vehicles"]["bravo"]["refused"] == "refused: it is on the ground"


async def test_more_vehicles_than_the_daemon_takes_orders_at_once() -> None:
    class Busy:
        under_way = most = 0

        async def goto(self, name: str, **_: object) -> dict[str, dict[str, object]]:
            self.under_way += 1
            self.most = max(self.most, self.under_way)
            await asyncio.sleep(0)
            self.under_way -= 1
            if name == "v7":
                raise RpcError(-32602, "yaw_deg: is wrong")
            return {name: {"ok": True}}

    busy = Busy()
    flights = [TableFlight(f"v{i}", Spot((float(i), 0.0, 5.0)), 9.0) for i in range(250)]
    await send(busy, flights, "all")  # type: ignore[arg-type]
    assert busy.most == 32
    assert [f.name for f in flights if f.refused] == ["v7"]


def nothing_flew(fleet: Commanded) -> bool:
    return not any(vehicle.orders for vehicle in fleet.vehicles.values())


HEAD = "vehicle,final_x,final_y,final_z\n"


@each(
    ("rows", "words"),
    [
        ("alpha,0,0,5\ndelta,9,0,5\n44,20,0,5\n", ["the table names delta, 44; the daemon knows: alpha, bravo, carol"]),
        ("alpha,0,0,5\n1,9,0,5\n", ["twice"]),
        ("alpha,40,0,5\n", ["alpha and bravo", "alpha and carol"]),  # who takes no part is in the way
    ],
)
def test_a_table_that_cannot_be_flown_says_why_and_no_vehicle_flies(
    fleet: Commanded, tmp_path: Path, rows: str, words: list[str]
) -> None:
    path = tmp_path / "t.csv"
    path.write_text(HEAD + rows)
    text = fleet.run("table", str(path), "final", code=FAILED)
    assert all(word in text for word in words) and nothing_flew(fleet)


def test_without_an_origin_a_position_or_a_vehicle_no_vehicle_flies(fleet: Commanded, table: str) -> None:
    fleet.vehicles["bravo"].no_frame = True
    assert "skygcs-cli origin set" in fleet.run("table", table, "final", code=FAILED)
    fleet.vehicles["bravo"].position_m = None
    assert "bravo: no position yet" in fleet.run("table", table, "final", code=FAILED)
    fleet.vehicles["alpha"].connected = False
    assert "alpha: not connected" in fleet.run("table", table, "final", code=FAILED)
    assert nothing_flew(fleet)


def test_a_table_that_lacks_a_place_says_whose(fleet: Commanded, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(HEAD + "alpha,0,0,5\n")
    assert "alpha: the table has no initial position" in fleet.run("table", str(path), "initial", code=FAILED)


def test_places_too_near_are_refused_also_with_force(fleet: Commanded, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("vehicle,final_x,final_y,final_z\nalpha,10,0,5\nbravo,11,0,5\n")
    text = fleet.run("table", str(path), "final", "--force", code=FAILED)
    assert "alpha and bravo come within 1.000 m in phase standing at the goals" in text and nothing_flew(fleet)
    assert "margin 3.300 m" in text and "--separation" in text
    fleet.run("table", str(path), "final", "--separation", "0.5")


def test_crossing_paths_need_force(fleet: Commanded, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("vehicle,final_x,final_y,final_z\nalpha,20,0,5\nbravo,10,0,5\n")
    text = fleet.run("table", str(path), "final", code=FAILED)
    assert "alpha and bravo come within 0.000 m in phase straight, at (10.00, 0.00, 5.00)" in text
    assert "--force insists" in text and "plan make FILE --fleet" in text and nothing_flew(fleet)
    assert "come within" in fleet.run("table", str(path), "final", "--force")


@each(
    "args", [("--arrive", "0"), ("--timeout", "-1"), ("--separation", "nan"), ("--separation", "-1"), ("--arrive", "x")]
)
def test_a_wrong_option_is_a_usage_error(fleet: Commanded, table: str, args: tuple[str, str]) -> None:
    assert args[0] in fleet.run("table", table, "final", *args, code=USAGE)


def checked(path: Path, text: str, *args: str, code: int = DONE) -> str:
    path.write_text(text)
    result = CliRunner().invoke(app, ["table", str(path), "check", *args])
    assert result.exit_code == code, result.output + repr(result.exception)
    return result.output


def test_check_needs_no_daemon_and_finds_all(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    first, closest = checked(path, TABLE).splitlines()
    assert first == "3 vehicles: 3 initial positions, 3 final positions; certified"
    assert closest.startswith(
        "closest: alpha and bravo come within 10.000 m in phase initial to final, at (10.00, 0.00"
    )
    swapped = "vehicle,initial_x,initial_y,initial_z,final_x,final_y,final_z\na,0,0,5,10,0,5\nb,10,0,5,0,0,5\n"
    text = checked(path, swapped + "c,10,1,5,,,\n", code=FAILED)
    assert "b and c come within 1.000 m in phase standing at the initial positions" in text
    assert "a and b come within 0.000 m in phase initial to final" in text
    (pair,) = json.loads(checked(path, swapped, "--json", code=FAILED))["too_near"]["paths"]
    assert (pair["vehicles"], pair["distance_m"], pair["margin_m"]) == (["a", "b"], 0.0, 3.3)
    assert len(pair["places_m"]) == 2 and pair["places_m"][0][2] == 5.0
    assert "line 2: final x" in checked(path, "vehicle,final_x,final_y,final_z\na,x,1,2\n", code=FAILED)


@each(
    ("rows", "what"),
    [
        # at one speed they pass, but one of them may be late
        (
            "a,0,0,5,30,0,5\nb,10,-20,5,10,20,5\n",
            "a and b come within 0.000 m in phase initial to final, at (10.00, 0.00",
        ),
        # above each other, within the downwash
        ("a,0,0,5,0,9,5\nb,0,0,11,0,9,11\n", "a and b come within 3.000 m in phase standing at the initial positions"),
    ],
)
def test_whoever_is_late_and_whoever_is_below_counts(tmp_path: Path, rows: str, what: str) -> None:
    header = "vehicle,initial_x,initial_y,initial_z,final_x,final_y,final_z\n"
    assert what in checked(tmp_path / "t.csv", header + rows, code=FAILED)


def test_the_margin_can_be_given(fleet: Commanded, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("vehicle,final_x,final_y,final_z\nalpha,10,9,5\nbravo,12.5,9,5\n")
    assert "margin 3.300 m" in fleet.run("table", str(path), "final", code=FAILED) and nothing_flew(fleet)
    fleet.run("table", str(path), "final", "--separation", "2")
    assert not nothing_flew(fleet)


def test_arrival_is_taken_back_when_a_vehicle_leaves() -> None:
    flight = TableFlight("alpha", Spot((0.0, 0.0, 5.0)), 10.0)
    assert not flight.see((1.0, 0.0, 5.0), 1.0, 0.5)
    assert flight.see((0.4, 0.0, 5.0), 2.0, 0.5) and not flight.see((0.3, 0.0, 5.0), 2.5, 0.5)
    assert flight.arrived_s == 2.0
    flight.see((0.6, 0.0, 5.0), 3.0, 0.5)
    assert flight.arrived_s is None and not flight.settled
    assert flight.see((0.4, 0.0, 5.0), 4.0, 0.5) and flight.arrived_s == 4.0


def test_the_live_table_shows_where_each_vehicle_is() -> None:
    from rich.console import Console

    spot = Spot((10.0, -2.5, 5.0))
    flights = [
        TableFlight("alpha", spot, 0.2, arrived_s=3.0),
        TableFlight("bravo", spot, 7.5),
        TableFlight("carol", spot, 9.0, refused="not armed"),
        TableFlight("delta", spot, 9.0, connected=False),
    ]
    screen = Console(width=100)
    with screen.capture() as capture:
        screen.print(flight_table(flights, 4.25))
    lines = [" ".join(line.split()) for line in capture.get().splitlines()]
    assert lines[0] == "4.2 s"
    assert lines[2:] == [
        "alpha 10, -2.5, 5 0.20 m 3.0 s arrived",
        "bravo 10, -2.5, 5 7.50 m 4.2 s on its way",
        "carol 10, -2.5, 5 9.00 m refused: not armed",
        "delta 10, -2.5, 5 9.00 m 4.2 s lost",
    ]


# -- Tables of positions: both formats, and everything that can be wrong with them.


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
