"""What other programs asked for, who is gone, and what puts a vehicle's streams back."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.radio_link.program_streams import (
    ALL_GROUPS,
    ARDUPILOT_GROUPS,
    MOST_ITEMS,
    MOST_PROGRAMS,
    Leftover,
    ProgramStreams,
    Stream,
    StreamRequest,
    restoring,
)
from support.table import each

MAVPROXY, QGC = (1, 0xFFE6), (2, 0xFFBE)
POSITION, RAW = Stream(6, None), Stream(1, None)
ATTITUDE = Stream(None, "ATTITUDE")
WANTED = {"GLOBAL_POSITION_INT": 2.0, "ATTITUDE": 1.0}


def left(requests: ProgramStreams, *connected: tuple[int, int]) -> dict[int, set[Stream]]:
    found = requests.left_behind(lambda program: program in connected)
    return {vehicle: {leftover.stream for leftover in leftovers} for vehicle, leftovers in found.items()}


def requested(*requests: tuple[int, tuple[int, int], Stream, dict[str, float]]) -> ProgramStreams:
    """Each: vehicle, program, stream, and what came before it."""
    made = ProgramStreams()
    for vehicle, program, stream, before_hz in requests:
        made.on_request(vehicle, program, stream, lambda before_hz=before_hz: before_hz)
    return made


def test_a_stream_is_left_behind_when_the_last_that_asked_is_gone() -> None:
    one, four = {"ATTITUDE": 1.0}, {"ATTITUDE": 4.0}
    both = (1, MAVPROXY, POSITION, one), (1, QGC, POSITION, four)
    requests = requested(*both, (1, MAVPROXY, RAW, four), (2, QGC, ATTITUDE, {}))
    assert left(requests, MAVPROXY, QGC) == {}
    assert left(requests, QGC) == {1: {RAW}}
    (leftover,) = requests.left_behind(lambda program: False)[1]
    assert leftover == Leftover(POSITION, one)  # as before the first of them
    assert left(requests) == {}


def test_all_streams_are_each_of_the_groups_and_a_rebooted_vehicle_knows_of_no_request() -> None:
    requests = requested((1, MAVPROXY, Stream(ALL_GROUPS, None), {}), (1, QGC, POSITION, {}))
    assert left(requests, QGC) == {1: {Stream(group, None) for group in ARDUPILOT_GROUPS} - {POSITION}}
    requests = requested((1, MAVPROXY, POSITION, {}))
    requests.forget(1)
    assert left(requests) == {}


def test_a_flood_of_requests_is_bounded_and_counted() -> None:
    requests = ProgramStreams()
    for n in range(100):
        requests.on_request(1, MAVPROXY, Stream(None, f"M{n}"), lambda: {})
        requests.on_request(2, (n, n), POSITION, lambda: {})
    found = left(requests)
    assert len(found[1]) == MOST_ITEMS and found[2] == {POSITION}
    assert requests.not_counted == 100 - MOST_ITEMS + 100 - MOST_PROGRAMS


def asked(stream: Stream | str, rate_hz: float | None) -> StreamRequest:
    return StreamRequest(Stream(None, stream) if isinstance(stream, str) else stream, rate_hz)


PLACE, NED = "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"
RAW_NOW = dict.fromkeys(("RAW_IMU", "SCALED_IMU2", "SCALED_PRESSURE"), 4.0)


@each(
    ("stream", "before_hz", "now_hz", "wanted", "requests"),
    [
        # a group that did not stream is stopped, and our own messages are asked for again
        (POSITION, {PLACE: 2.0}, {PLACE: 4.0, NED: 4.0}, WANTED, [asked(POSITION, 0.0), asked(PLACE, 2.0)]),
        (POSITION, {PLACE: 2.0}, {PLACE: 1.9}, WANTED, []),
        # a group that streamed gets its rate back, also if a program stopped it
        (POSITION, {PLACE: 4.8, NED: 4.9}, {}, WANTED, [asked(POSITION, 5.0)]),
        (POSITION, {PLACE: 4.8, NED: 4.9}, {PLACE: 10.0, NED: 10.0}, WANTED, [asked(POSITION, 5.0)]),
        (POSITION, {PLACE: 4.8, NED: 4.9}, {PLACE: 5.1, NED: 5.0}, WANTED, []),
        # one message of many was asked for by itself
        (RAW, {"RAW_IMU": 10.0}, RAW_NOW, WANTED, [asked(RAW, 0.0), asked("RAW_IMU", 10.0)]),
        # a message goes back to the vehicle's default, or to what we ask for
        (ATTITUDE, {"ATTITUDE": 20.0}, {"ATTITUDE": 50.0}, WANTED, [asked(ATTITUDE, None)]),
        (ATTITUDE, {"ATTITUDE": 1.0}, {"ATTITUDE": 50.0}, WANTED, [asked(ATTITUDE, 1.0)]),
        (ATTITUDE, {"ATTITUDE": 20.0}, {}, {}, [asked(ATTITUDE, None)]),
        (ATTITUDE, {"ATTITUDE": 20.0}, {"ATTITUDE": 19.0}, WANTED, []),
    ],
)
def test_streams_are_put_back_as_they_were(stream, before_hz, now_hz, wanted, requests) -> None:
    assert restoring(Leftover(stream, before_hz), now_hz, wanted) == requests


NAMES = sorted({n for names in ARDUPILOT_GROUPS.values() for n in names})
RATES = st.dictionaries(st.sampled_from(NAMES), st.floats(0, 100))


@given(st.sampled_from(sorted(ARDUPILOT_GROUPS)), RATES, RATES)
def test_what_is_as_before_is_left_alone_and_nothing_of_ours_is_turned_off(group, before_hz, now_hz) -> None:
    leftover = Leftover(Stream(group, None), before_hz)
    assert restoring(leftover, before_hz, WANTED) == []
    requests = restoring(leftover, now_hz, WANTED)
    if requests and requests[0].rate_hz == 0.0:
        ours = [name for name in ARDUPILOT_GROUPS[group] if before_hz.get(name, 0.0) <= WANTED.get(name, -1.0)]
        assert set(ours) <= {request.stream.message for request in requests[1:]}
