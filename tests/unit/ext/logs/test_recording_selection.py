"""Which entries are taken: by time, sender, addressee and message."""

from __future__ import annotations

import itertools

from skygcs.tlog.format import LogEntry, encode_record
from skygcs.tlog.reading import LogReader
from skygcs.tlog.selection import Selection
from support.flight_log import T0_US
from support.frames import dialect, frame, heartbeat, unknown_frame
from support.table import each

ATTITUDE = 30


def entries() -> list[LogEntry]:
    """Nine entries, one a second."""
    bad = bytearray(heartbeat(1))
    bad[-1] ^= 1
    frames = [
        *(heartbeat(1), heartbeat(2), heartbeat(1, compid=190), frame("ATTITUDE", sysid=1), bytes(bad)),
        frame("COMMAND_LONG", {"target_system": 1, "target_component": 1, "command": 400}, sysid=255, compid=190),
        frame("COMMAND_LONG", {"target_system": 2, "target_component": 1, "command": 400}, sysid=255, compid=190),
        *(unknown_frame(sysid=2), heartbeat(1)),
    ]
    data = b"".join(encode_record(T0_US + n * 1_000_000, raw) for n, raw in enumerate(frames))
    return list(LogReader(data, dialect(), "tlog"))


def taken(**wanted: object) -> list[int]:
    selection = Selection(**wanted)  # type: ignore[arg-type]
    return [n for n, entry in enumerate(entries()) if selection.takes(entry)]


@each(
    ("wanted", "found"),
    [
        ({}, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        ({"begin": 2.0, "end": 4.0}, [2, 3, 4]),
        ({"begin": T0_US + 2_000_000, "end": T0_US + 4_000_000}, [2, 3, 4]),
        ({"begin": T0_US + 2_000_001}, [3, 4, 5, 6, 7, 8]),
        ({"sources": frozenset({(1, None)})}, [0, 2, 3, 8]),
        ({"sources": frozenset({(1, 1)})}, [0, 3, 8]),
        ({"sources": frozenset({(2, None)})}, [1, 7]),
        ({"sources": frozenset({(1, None)}), "addressed": True}, [0, 2, 3, 5, 8]),
        ({"sources": frozenset({(1, 190)}), "addressed": True}, [2]),
        ({"messages": frozenset({ATTITUDE})}, [3]),
        ({"messages": frozenset({54321})}, [7]),
        ({"without": frozenset({0})}, [3, 4, 5, 6, 7]),
        ({"sources": frozenset({(1, None)}), "messages": frozenset({0}), "end": 5.0}, [0, 2]),
    ],
)
def test_everything_that_is_asked_for_must_hold(wanted: dict[str, object], found: list[int]) -> None:
    assert taken(**wanted) == found


def test_without_a_time_of_day_none_can_be_asked_for() -> None:
    raw = list(LogReader(heartbeat(1), dialect(), "raw"))
    assert [Selection(begin=T0_US).takes(entry) for entry in raw] == [False]
    assert [Selection(begin=0.0).takes(entry) for entry in raw] == [True]
    assert Selection(end=T0_US).absolute and not Selection(end=1.0).absolute


def test_a_source_is_a_system_or_one_component_of_it() -> None:
    selection = Selection(sources=frozenset({(1, None), (2, 5)}))
    asked = {(s, c) for s, c in itertools.product((1, 2, 3), (1, 5)) if selection.has(s, c)}
    assert asked == {(1, 1), (1, 5), (2, 5)}
    assert Selection().has(77, 1)
