"""Shares of long searches: some in `make test`, all in the deep run."""

from __future__ import annotations

import pytest

from support.examples import CASES, VARIABLE, each_value, examples, flown_cases, seeds, thinned


def test_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    for multiple, expected in (
        (None, (100, 10, 8, 3, 2, [0, 5, 10], [1, 6, 11])),
        ("10", (4000, 400, 80, 12, 4, list(range(15)), list(range(15)))),
        ("100", (40_000, 4000, 800, 120, 40, list(range(15)), list(range(15)))),
    ):
        monkeypatch.delenv(VARIABLE, raising=False) if multiple is None else monkeypatch.setenv(VARIABLE, multiple)
        table = range(15)
        found = (
            *(examples(count) for count in (400, 40, 8)),
            *(len(seeds(count)) for count in (12, 4)),
            list(thinned(table, 3)),
            list(thinned(table, 3, turn=1)),
        )
        assert found == expected, multiple
    monkeypatch.delenv(VARIABLE)
    assert list(thinned("ab", 3)) == ["a", "b"]
    assert sorted(thinned(range(10), 3, turn=9)) == [2, 5, 9]


def test_each_flight_has_cases_of_its_own_turn() -> None:
    cases = ["0-px4", "0-copter", "1-px4", "1-copter"]
    assert {case for turn in range(8) for case in flown_cases(cases, turn)} == set(cases)
    assert all(len(flown_cases(cases, turn)) == CASES for turn in range(8))
    assert flown_cases(["alone"], 12345) == ["alone"] and flown_cases([], 1) == []


def test_the_deep_run_flies_every_value_of_every_parameter_and_no_product_of_them() -> None:
    cases = [(mode, kind, wind) for mode in "abc" for kind in ("px4", "copter") for wind in ("calm", "gusts")]
    chosen = [cases[number] for number in each_value(cases)]
    assert [{case[n] for case in chosen} for n in range(3)] == [{case[n] for case in cases} for n in range(3)]
    assert len(chosen) == 3
    rows = [("a",), ("b",), ("c",)]
    assert each_value(rows) == [0, 1, 2] and each_value([()]) == []
