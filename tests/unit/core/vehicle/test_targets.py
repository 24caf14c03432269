from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.vehicle.targets import MAX_PARTS, absent_sysids, expression_of, select
from skygcs.errors import TargetError
from support.table import each


@dataclass(frozen=True)
class Named:
    sysid: int
    name: str
    groups: tuple[str, ...] = ()
    compid: int = 1


FLEET = [
    Named(3, "charlie", ("red",)),
    Named(1, "alpha", ("red", "lead")),
    Named(2, "bravo"),
    Named(9, "v9"),
    Named(5, "echo", ("blue",)),
]


def sysids(expression: str | int | list[str | int]) -> list[int]:
    return [v.sysid for v in select(expression, FLEET)]


@each(
    ("expression", "expected"),
    [
        ("1", [1]),
        (1, [1]),
        ("1,3", [1, 3]),
        ("3, 1 ,1", [1, 3]),
        ("2-5", [2, 3, 5]),
        ("2 - 5", [2, 3, 5]),
        ("alpha", [1]),
        ("red", [1, 3]),
        ("all", [1, 2, 3, 5, 9]),
        ("red,5,8-10", [1, 3, 5, 9]),
        (["bravo", "9"], [2, 9]),
        (["alpha,echo", 3], [1, 3, 5]),
        (["all", "alpha"], [1, 2, 3, 5, 9]),
        ("v9", [9]),
    ],
)
def test_expressions_name_vehicles_by_system_id_each_once(
    expression: str | int | list[str | int], expected: list[int]
) -> None:
    assert sysids(expression) == expected


@each("bad", ["7", "delta", "6-8", "red,7", "ALL", "-1", "1.5"])
def test_a_part_that_names_none_is_named_with_what_there_is(bad: str) -> None:
    with pytest.raises(TargetError) as caught:
        sysids(bad)
    part = bad.split(",")[-1]
    assert repr(part) in str(caught.value)
    assert "1 (alpha), 2 (bravo), 3 (charlie), 5 (echo), 9" in str(caught.value)
    assert "groups: blue, lead, red" in str(caught.value)


@each(
    ("expression", "said"),
    [
        ("5-2", "2-5"),
        *((empty, "no target") for empty in ("", ",", " , ", [])),
        (",".join(["1"] * (MAX_PARTS + 1)), "at most"),
        # of a megabyte each took the loop minutes to days
        *(
            (long, "characters")
            for long in ("a" + " " * 30_000 + "b", "a" + " " * 400_000 + "b", "/" * 30_000, "x" * 200)
        ),
        *((long, "has 5000 characters") for long in ("9" * 5000, f"1-{'9' * 4998}", f"{'9' * 4998}/1", ["9" * 5000])),
        (["1"] * (MAX_PARTS + 1), "at most"),
        *(([number], "from 1 to 255") for number in (10**5000, -(10**5000))),
        *(
            (wrong, f"no vehicle '{wrong}'; did you mean '{right}'")
            for wrong, right in (("alhpa", "alpha"), ("bravo1", "bravo"), ("bleu", "blue"))
        ),
    ],
)
def test_what_names_nothing_says_what_was_meant(expression: str | list[str | int], said: str) -> None:
    with pytest.raises(TargetError, match=said):
        sysids(expression)


def test_all_of_nobody_is_an_error() -> None:
    with pytest.raises(TargetError, match="no vehicle has been heard yet"):
        select("all", [])


def test_a_name_comes_before_a_group_of_it_and_both_autopilots_of_a_system_are_meant_by_its_number() -> None:
    assert [v.sysid for v in select("red", [Named(1, "red"), Named(2, "b", ("red",))])] == [1]
    assert [v.name for v in select("1", [Named(1, "a"), Named(1, "a-2", compid=2)])] == ["a", "a-2"]


@given(st.text(alphabet="0123456789,- abclr*", max_size=30))
def test_any_expression_gives_vehicles_in_order_or_a_target_error(expression: str) -> None:
    try:
        found = sysids(expression)
    except TargetError as error:
        assert str(error)
    else:
        assert found and found == sorted(set(found))


@given(st.lists(st.sampled_from(["1", "2-3", "alpha", "red", "9", "echo"]), min_size=1))
def test_a_mixture_is_the_union_of_its_parts(parts: list[str]) -> None:
    union: set[int] = set()
    for part in parts:
        union |= set(sysids(part))
    assert set(sysids(",".join(parts))) == union


def test_ids_of_ranges_without_a_vehicle_are_found() -> None:
    ids = [v.sysid for v in FLEET]
    assert absent_sysids("1-6,alpha", ids) == [4, 6]
    assert absent_sysids("1-3", ids) == absent_sysids("all,7", ids) == []


@each(("sysids", "expression"), [([], ""), ([4], "4"), ([9, 8, 7, 4, 8], "4,7-9"), ([1, 2, 4, 5, 250], "1-2,4-5,250")])
def test_ids_are_written_as_an_expression(sysids: list[int], expression: str) -> None:
    assert expression_of(sysids) == expression
