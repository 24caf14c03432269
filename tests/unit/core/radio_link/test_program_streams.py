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

MAVPROXY, QGC = (1, 0xFFE6), (2, 0xFFBE)
POSITION, RAW = Stream(6, None), Stream(1, None)
ATTITUDE = Stream(None, "ATTITUDE")
WANTED = {"GLOBAL_POSITION_INT": 2.0, "ATTITUDE": 1.0}


def left(requests: ProgramStreams, *connected: tuple[int, int]) -> dict[int, set[Stream]]:
    found = requests.left_behind(lambda program: program in connected)
    return {vehicle: {leftover.stream for leftover in leftovers} for vehicle, leftovers in found.items()}


def test_a_stream_is_left_behind_when_the_last_that_asked_is_gone() -> None:
    requests = ProgramStreams()
    requests.on_request(1, MAVPROXY, POSITION, lambda: {"ATTITUDE": 1.0})
    requests.on_request(1, QGC, POSITION, lambda: {"ATTITUDE": 4.0})
    requests.on_request(1, MAVPROXY, RAW, lambda: {"ATTITUDE": 4.0})
    requests.on_request(2, QGC, ATTITUDE, lambda: {})
    assert left(requests, MAVPROXY, QGC) == {}
    assert left(requests, QGC) == {1: {RAW}}
    (leftover,) = requests.left_behind(lambda program: False)[1]
    assert leftover == Leftover(POSITION, {"ATTITUDE": 1.0})  # as before the first of them
    assert left(requests) == {}


def test_all_streams_are_each_of_the_groups() -> None:
    requests = ProgramStreams()
    requests.on_request(1, MAVPROXY, Stream(ALL_GROUPS, None), lambda: {})
    requests.on_request(1, QGC, POSITION, lambda: {})
    assert left(requests, QGC) == {1: {Stream(group, None) for group in ARDUPILOT_GROUPS} - {POSITION}}


def test_a_rebooted_vehicle_knows_of_no_request() -> None:
    requests = ProgramStreams()
    requests.on_request(1, MAVPROXY, POSITION, lambda: {})
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


def test_a_group_that_did_not_stream_is_stopped_and_our_own_messages_are_asked_for_again() -> None:
    leftover = Leftover(POSITION, {"GLOBAL_POSITION_INT": 2.0})
    now = {"GLOBAL_POSITION_INT": 4.0, "LOCAL_POSITION_NED": 4.0}
    assert restoring(leftover, now, WANTED) == [
        StreamRequest(POSITION, 0.0),
        StreamRequest(Stream(None, "GLOBAL_POSITION_INT"), 2.0),
    ]
    assert restoring(leftover, {"GLOBAL_POSITION_INT": 1.9}, WANTED) == []


def test_a_group_that_streamed_gets_its_rate_back_also_if_a_program_stopped_it() -> None:
    leftover = Leftover(POSITION, {"GLOBAL_POSITION_INT": 4.8, "LOCAL_POSITION_NED": 4.9})
    assert restoring(leftover, {}, WANTED) == [StreamRequest(POSITION, 5.0)]
    assert restoring(leftover, {"GLOBAL_POSITION_INT": 10.0, "LOCAL_POSITION_NED": 10.0}, WANTED) == [
        StreamRequest(POSITION, 5.0)
    ]
    assert restoring(leftover, {"GLOBAL_POSITION_INT": 5.1, "LOCAL_POSITION_NED": 5.0}, WANTED) == []


def test_one_message_of_many_was_asked_for_by_itself() -> None:
    leftover = Leftover(RAW, {"RAW_IMU": 10.0})
    now = dict.fromkeys(("RAW_IMU", "SCALED_IMU2", "SCALED_PRESSURE"), 4.0)
    assert restoring(leftover, now, WANTED) == [StreamRequest(RAW, 0.0), StreamRequest(Stream(None, "RAW_IMU"), 10.0)]


def test_a_message_goes_back_to_the_vehicles_default_or_to_what_we_ask_for() -> None:
    assert restoring(Leftover(ATTITUDE, {"ATTITUDE": 20.0}), {"ATTITUDE": 50.0}, WANTED) == [
        StreamRequest(ATTITUDE, None)
    ]
    assert restoring(Leftover(ATTITUDE, {"ATTITUDE": 1.0}), {"ATTITUDE": 50.0}, WANTED) == [
        StreamRequest(ATTITUDE, 1.0)
    ]
    assert restoring(Leftover(ATTITUDE, {"ATTITUDE": 20.0}), {}, {}) == [StreamRequest(ATTITUDE, None)]
    assert restoring(Leftover(ATTITUDE, {"ATTITUDE": 20.0}), {"ATTITUDE": 19.0}, WANTED) == []


RATES = st.dictionaries(
    st.sampled_from(sorted({n for names in ARDUPILOT_GROUPS.values() for n in names})), st.floats(0, 100)
)


@given(st.sampled_from(sorted(ARDUPILOT_GROUPS)), RATES, RATES)
def test_what_is_as_before_is_left_alone_and_nothing_of_ours_is_turned_off(
    group: int, before_hz: dict[str, float], now_hz: dict[str, float]
) -> None:
    leftover = Leftover(Stream(group, None), before_hz)
    assert restoring(leftover, before_hz, WANTED) == []
    requests = restoring(leftover, now_hz, WANTED)
    if requests and requests[0].rate_hz == 0.0:
        asked = {request.stream.message for request in requests[1:]}
        assert {
            name for name in ARDUPILOT_GROUPS[group] if name in WANTED and before_hz.get(name, 0.0) <= WANTED[name]
        } <= asked
