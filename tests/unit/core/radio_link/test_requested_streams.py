"""What a vehicle is asked for: only what is missing, one at a time, ever more rarely, again after a reboot."""

from __future__ import annotations

import itertools

from skygcs.core.radio_link.requested_streams import (
    DEFAULT_RATES_HZ,
    FIRST_PAUSE_S,
    GRACE_S,
    LONGEST_PAUSE_S,
    STREAM_GROUPS,
    StreamRequests,
)

RATES = {"GLOBAL_POSITION_INT": 2.0, "ATTITUDE": 1.0}


def asked(keeper: StreamRequests, until: float, came: dict[str, float], start: float = 0.0) -> list[tuple[float, str]]:
    """Everything asked for between start and until, ticking ten times a second."""
    found = []
    for tick in range(int(start * 10), int(until * 10)):
        now = tick / 10
        due = keeper.due(now, came.get)
        if due is not None:
            found.append((now, due[0]))
    return found


def test_nothing_is_asked_within_the_grace_time() -> None:
    assert asked(StreamRequests(RATES), GRACE_S, {}) == []


def test_missing_messages_are_asked_for_one_after_the_other() -> None:
    first = asked(StreamRequests(RATES), GRACE_S + 1.0, {})
    assert [name for _, name in first] == ["GLOBAL_POSITION_INT", "ATTITUDE"]
    assert first[1][0] > first[0][0]


def test_what_comes_by_itself_is_not_asked_for() -> None:
    keeper = StreamRequests(RATES)
    found = []
    for tick in range(300):
        due = keeper.due(tick / 10, lambda name, now=tick / 10: now - 0.5)
        found.append(due)
    assert set(found) == {None}


def test_what_never_comes_is_asked_for_ever_more_rarely() -> None:
    times = [at for at, _ in asked(StreamRequests({"ATTITUDE": 1.0}), 1000.0, {})]
    pauses = [b - a for a, b in itertools.pairwise(times)]
    assert pauses[0] < FIRST_PAUSE_S + 0.2
    assert all(b >= a - 0.11 for a, b in itertools.pairwise(pauses))
    assert abs(pauses[-1] - LONGEST_PAUSE_S) < 0.2


def test_a_message_that_stops_coming_is_asked_for_again_at_once() -> None:
    keeper = StreamRequests({"ATTITUDE": 1.0})
    assert asked(keeper, 10.0, {})
    came = {"ATTITUDE": 20.0}
    assert asked(keeper, 23.0, came, start=20.0) == []
    found = asked(keeper, 25.0, came, start=23.0)
    assert len(found) == 1


def test_refused_messages_are_left_alone_until_a_reboot() -> None:
    keeper = StreamRequests({"ATTITUDE": 1.0})
    keeper.refuse("ATTITUDE")
    assert asked(keeper, 100.0, {}) == []
    keeper.restart()
    assert len(asked(keeper, 104.0, {}, start=100.0)) == 1


def test_what_only_ardupilot_has_is_asked_of_no_other() -> None:
    for ardupilot, wanted in ((True, ["EKF_STATUS_REPORT"]), (False, [])):
        keeper, found = StreamRequests({"EKF_STATUS_REPORT": 0.2}), []
        for tick in range(60):
            due = keeper.due(tick / 10, lambda name: None, ardupilot=ardupilot)
            found += [due[0]] if due else []
        assert found == wanted


def test_the_estimator_is_among_what_is_asked_for_and_known_by_a_stream_of_old_firmware() -> None:
    assert DEFAULT_RATES_HZ["EKF_STATUS_REPORT"] == 0.2
    assert set(STREAM_GROUPS) >= set(DEFAULT_RATES_HZ) - {"EXTENDED_SYS_STATE"}


def test_no_rates_ask_for_nothing() -> None:
    assert asked(StreamRequests({}), 100.0, {}) == []
    assert asked(StreamRequests({"ATTITUDE": 0.0}), 100.0, {}) == []
