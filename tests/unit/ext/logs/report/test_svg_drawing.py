"""Curves and maps: round ticks, one scale on both axes, gaps that stay gaps."""

from __future__ import annotations

import itertools
import math
import re
import xml.etree.ElementTree as ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.ext.logs.report.svg_drawing import MAP_HEIGHT, WIDTH, Drawn, curves, ground_map, ticks
from support.examples import examples

finite = st.floats(-1e6, 1e6)
maybe = st.one_of(finite, st.just(math.nan))


def paths(svg: str) -> list[list[tuple[str, float, float]]]:
    """Commands with their places, of each path."""
    root = ElementTree.fromstring(svg)
    found = []
    for path in root.iter("path"):
        pieces = re.findall(r"([ML])(-?[\d.]+) (-?[\d.]+)", path.attrib["d"])
        found.append([(command, float(x), float(y)) for command, x, y in pieces])
    return found


@settings(max_examples=examples(200))
@given(finite, st.floats(1e-3, 1e6), st.integers(1, 8))
def test_ticks_are_round_and_few_and_within(low: float, span: float, most: int) -> None:
    found = ticks(low, low + span, most)
    assert len(found) <= most + 1
    assert all(low - 1e-6 * span <= tick <= low + span * (1 + 1e-6) for tick in found)
    steps = {round((b - a) / span, 6) for a, b in itertools.pairwise(found)}
    assert len(steps) <= 1


@settings(max_examples=examples(200))
@given(st.lists(st.tuples(maybe, maybe), min_size=1, max_size=20))
def test_a_map_has_one_scale_and_everything_is_on_it(places: list[tuple[float, float]]) -> None:
    xs, ys = [x for x, _ in places], [y for _, y in places]
    drawing = ground_map("map", [Drawn("flown", (xs, ys))])
    known = [(x, y) for x, y in places if math.isfinite(x) and math.isfinite(y)]
    if not known:
        assert "<path" not in drawing
        return
    (drawn,) = paths(drawing)
    assert all(0 <= x <= WIDTH and 0 <= y <= MAP_HEIGHT for _, x, y in drawn)
    assert len(drawn) == len(known)
    for (_, x0, y0), (_, x1, y1), a, b in zip(drawn, drawn[1:], known, known[1:], strict=False):
        wide, high = b[0] - a[0], b[1] - a[1]
        if abs(wide) > 1 and abs(high) > 1 and min(abs(x1 - x0), abs(y1 - y0)) > 20:
            assert (x1 - x0) / wide == pytest.approx(-(y1 - y0) / high, rel=0.02)


def test_a_gap_is_not_drawn_over_and_a_single_value_is_seen() -> None:
    line = [0.0, 1.0, 2.0, 3.0, 4.0], [1.0, 2.0, math.nan, 3.0, 4.0]
    (drawn,) = paths(curves("height", [Drawn("flown", line)], " m"))
    assert [command for command, _, _ in drawn] == ["M", "L", "M", "L"]
    assert "h0.1" in curves("height", [Drawn("flown", ([5.0], [1.0]))], " m")
    assert curves("height", [Drawn("flown", ([], []))], " m") == ""
    assert curves("height", [Drawn("flown", ([1.0], [math.nan]))], " m") == ""


def test_labels_are_escaped_and_times_are_of_the_day() -> None:
    noon = 1_780_056_000.0  # 2026-05-29 12:00:00
    svg = curves('<&">', [Drawn("flown", ([noon, noon + 3600], [0.0, 10.0]))], " <m>")
    words = [text.text for text in ElementTree.fromstring(svg).iter("text")]
    assert "12:00" in words and "12:15" in words and "5 <m>" in words
