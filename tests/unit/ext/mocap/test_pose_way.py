"""Which channel carries the poses: the rows of the table."""

from __future__ import annotations

from skygcs.ext.mocap.pose_way import PoseWay
from support.table import each


@each(
    ("before", "flies", "still_open", "ordinary", "after"),
    [
        (None, False, False, 1, 1),
        (None, True, False, 1, 1),
        (1, False, True, 2, 2),
        (1, False, True, None, None),
        (1, True, True, 2, 1),
        (1, True, True, None, 1),
        (1, True, False, 2, 2),
        (1, True, False, None, None),
    ],
)
def test_one_that_flies_keeps_its_channel(
    before: int | None, flies: bool, still_open: bool, ordinary: int | None, after: int | None
) -> None:
    way = PoseWay()
    way.choose(before, "", flies=False, still_open=False)
    why = "two vehicles have its system id" if ordinary is None else ""
    way.choose(ordinary, why, flies=flies, still_open=still_open)
    assert way.channel_id == after
    kept = after is not None and ordinary is None
    assert way.kept_despite == (why if kept else None)
    assert way.why_none == ("" if after is not None else why)
