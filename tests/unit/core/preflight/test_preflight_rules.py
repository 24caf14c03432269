"""Comparisons with one parameter: what holds, what is told, what would make it right."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.mavlink.param_encoding import float32
from skygcs.core.params.expectations import Rule
from support.table import each

VALUES = st.integers(-1000, 1000) | st.floats(-1000, 1000, width=32)


@each(
    ("rule", "holds", "not_"),
    [
        (Rule(one_of=(4,)), [4, 4.0], [3, 5, 4.1]),
        (Rule(one_of=(0, 2)), [0, 2], [1]),
        (Rule(one_of=(0.95,)), [float32(0.95)], [0.96]),
        (Rule(least=5, most=30), [5, 30, 12.5], [4.99, 31]),
        (Rule(most=0.1), [float32(0.1)], [0.11]),
        (Rule(bits=8), [8, 9, 24], [0, 7]),
        (Rule(no_bits=3), [0, 4], [1, 2, 7]),
        (Rule(bits=8, no_bits=1), [8, 10], [9, 2]),
        (Rule(bits=1), [1], [1.5]),
        (Rule(), [0, -7.5], []),
    ],
)
def test_what_holds(rule: Rule, holds: list[float], not_: list[float]) -> None:
    assert all(rule.holds(value) for value in holds)
    assert not any(rule.holds(value) for value in not_)
    assert rule.empty is (rule == Rule())


@each(
    ("rule", "words"),
    [
        (Rule(one_of=(0, 2)), "0 or 2"),
        (Rule(least=5, most=30), "5 to 30"),
        (Rule(most=3000), "at most 3000"),
        (Rule(least=1), "at least 1"),
        (Rule(bits=9, no_bits=2), "with bits 0 and 3 set, with bit 1 clear"),
        (Rule(), "anything"),
    ],
)
def test_words(rule: Rule, words: str) -> None:
    assert str(rule) == words


@each(
    ("rule", "value", "fix"),
    [
        (Rule(one_of=(0, 2)), 3, 0),
        (Rule(one_of=(0, 2), set_to=2), 3, 2),
        (Rule(one_of=(0, 2), least=1), 3, 2),
        (Rule(least=5, most=30), 60.0, 30),
        (Rule(least=5, most=30), 1, 5),
        (Rule(bits=8), 1, 9),
        (Rule(no_bits=3), 7, 4),
        (Rule(bits=8, most=4), 1, None),
    ],
)
def test_the_nearest_value_that_would_do(rule: Rule, value: float, fix: float | None) -> None:
    assert rule.fix(value) == fix


@given(
    value=VALUES,
    rule=st.builds(
        Rule,
        one_of=st.lists(VALUES, max_size=3).map(tuple),
        least=st.none() | VALUES,
        most=st.none() | VALUES,
        bits=st.integers(0, 15),
        no_bits=st.integers(0, 15),
    ),
)
def test_what_is_set_is_as_expected_or_nothing_is(rule: Rule, value: float) -> None:
    fix = rule.fix(value)
    assert fix is None or rule.holds(fix)
    if rule.holds(value) and not rule.one_of:
        assert fix == value
