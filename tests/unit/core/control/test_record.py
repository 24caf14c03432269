"""Records: what a frozen dataclass is, but for who refuses to assign."""

from __future__ import annotations

from dataclasses import asdict, replace

from skygcs.core.control.record import record


@record
class Point:
    x: float
    y: float = 2.0


def test_a_record_is_compared_hashed_replaced_and_shown_as_a_frozen_dataclass_is() -> None:
    point = Point(1.0)
    assert point == Point(1.0, 2.0) and hash(point) == hash(Point(1.0, 2.0))
    assert replace(point, y=3.0) == Point(1.0, 3.0) != point
    assert asdict(point) == {"x": 1.0, "y": 2.0}
    assert repr(point) == "Point(x=1.0, y=2.0)"


def test_a_record_has_its_fields_and_nothing_else() -> None:
    assert not hasattr(Point(1.0), "__dict__")
