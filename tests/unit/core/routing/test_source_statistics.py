"""Counters per source: sequence loss modulo 256, rates, and who is not counted."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.routing.source_statistics import BURST_MAX, FIRST_NUMBERS, WINDOW, LossWindow, SourceStats
from skygcs.tlog.reading import LogReader
from support.frames import dialect
from support.public_data import capture, own_capture
from support.table import each


def fed(seqs: list[int], sysid: int = 1, compid: int = 1) -> SourceStats:
    stats = SourceStats(sysid, compid)
    for n, seq in enumerate(seqs):
        stats.on_frame(seq & 0xFF, 20, n * 0.1)
    return stats


ARRIVALS = st.lists(
    st.tuples(st.integers(0, 30) | st.just(0), st.integers(0, 30) | st.just(0), st.none() | st.integers(1, 30)),
    min_size=1,
    max_size=400,
)
"""Of each frame that arrives: how many before it never do, by how many places it comes late, and how much later it
comes once more."""


@given(st.integers(0, 255), ARRIVALS)
def test_whatever_comes_late_twice_or_never_is_counted_as_by_one_who_sees_the_whole_numbers(first, arrivals) -> None:
    number, order = first, []
    for lost_before, late, again in arrivals:
        number += lost_before + 1
        order += [(number + late, number), *([] if again is None else [(number + late + again, number)])]
    numbers = [number for _, number in sorted(order)]
    lost = len({*range(numbers[0], max(numbers) + 1)} - set(numbers))
    stats = fed(numbers)
    assert (stats.lost, stats.frames, stats.bytes) == (lost, len(numbers), 20 * len(numbers))
    assert stats.loss_ratio == pytest.approx(lost / (lost + len(numbers)))


@given(st.integers(WINDOW, 191), st.integers(1, 50))
def test_an_outage_is_counted_once_the_next_frame_continues_it(gap: int, more: int) -> None:
    stats = fed([0, gap + 1])
    assert stats.lost == 0
    for n in range(more):
        stats.on_frame(gap + 2 + n & 0xFF, 20, 0.1 * (2 + n))
    assert stats.lost == gap


@given(st.integers(1, 600), st.integers(0, 255))
def test_an_outage_of_seconds_is_counted_modulo_256(outage: int, first: int) -> None:
    stats = fed([first])
    resumed = first + outage + 1
    for n in range(3):
        stats.on_frame(resumed + n & 0xFF, 20, 60.0 + n / 10)
    starts_anew = resumed & 0xFF < FIRST_NUMBERS
    same_again = outage % 256 >= 254
    assert stats.lost == (0 if starts_anew or same_again else outage % 256)


@given(st.integers(0, 255), st.lists(st.integers(0, 255), max_size=300))
def test_what_another_program_sends_under_the_same_ids_is_no_loss_if_it_never_counts(fixed, other) -> None:
    """Programs that send each frame with the same number, one or several between two of the vehicle's."""
    stats = fed([seq for n, times in enumerate(other) for seq in (n, *[fixed] * (times % 3))])
    assert stats.lost <= 2 * WINDOW  # when the vehicle's numbers pass the fixed one; each frame used to count


@each(
    ("seqs", "lost"),
    [
        ([*range(20), 33, *range(21, 33), 20, 34], 0),  # 12 places late, as PX4 sends them
        ([*range(10), *range(10), *range(10, 20)], 0),  # a datagram delivered twice
        ([0] * 300, 0),
        ([10, 8, 9, 12], 1),  # two came before the first
    ],
)
def test_a_late_frame_takes_its_loss_back_and_a_repeated_one_changes_nothing(seqs: list[int], lost: int) -> None:
    assert fed(seqs).lost == lost


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 30), st.floats(2.0, 60.0))
def test_a_reboot_is_no_loss_even_if_it_shows_after_some_frames(last, first, shows_after, silent_s) -> None:
    stats = fed([last - 2, last])
    for n in range(40):
        if n == shows_after:
            stats.restart()
        stats.on_frame(first + n & 0xFF, 20, 1.0 + silent_s + 0.1 * n)
    assert stats.lost == 1


def test_a_sender_that_starts_at_0_after_a_silence_has_started_anew() -> None:
    """Programs send no time since boot, so nothing else would show it."""
    stats = fed([100, 101, 102])
    for n in range(5):
        stats.on_frame(n, 20, 10.0 + n)
    assert stats.lost == 0


def test_loss_of_long_before_stays_when_the_sender_reboots() -> None:
    stats = fed([0, 11])
    for n in range(12, 200):
        stats.on_frame(n, 20, 1.0 + n)
    stats.restart()
    assert stats.lost == 10


SEQUENCES = st.lists(st.tuples(st.sampled_from([1, 1, 1, 1, 1, 2, 0, 20, 250, 100]), st.integers(1, 40)), max_size=60)


@given(st.integers(0, 255), SEQUENCES, st.sampled_from([0.0, 0.4, 0.6, 3.0]), st.sampled_from([1, 190]))
def test_a_burst_counts_as_its_frames_one_by_one(seq, sequences, silent_s, compid) -> None:
    single, burst = SourceStats(1, compid), SourceStats(1, compid)
    now = 1000.0
    for step, count in sequences:
        seqs = bytes(seq + step * n & 0xFF for n in range(count))
        seq += step * count
        now += silent_s
        for n, number in enumerate(seqs):
            single.on_frame(number, 20, now + n / 1000)
        last_at = now + (count - 1) / 1000
        burst.on_burst(seqs, 20 * count, now, last_at)
        now = last_at
        assert burst.as_dict(now) == single.as_dict(now)
    for name in set(SourceStats.__slots__) - {"_paused_at"}:
        assert getattr(burst, name) == getattr(single, name), name
    assert burst._missing.bit_length() <= WINDOW


def test_a_burst_of_the_most_frames_in_order_is_counted_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    stats = fed([7])
    monkeypatch.setattr(SourceStats, "_on_irregular", lambda *a: pytest.fail("looked at each frame"))
    stats.on_burst(bytes(8 + n & 0xFF for n in range(BURST_MAX)), 1, 1.0, 1.1)
    stats.on_burst(bytes(8 + n & 0xFF for n in range(BURST_MAX)), 1, 1.0, 1.1)
    assert (stats.lost, stats.frames) == (0, 1 + 2 * BURST_MAX)


def losses(data: bytes) -> dict[tuple[int, int], int]:
    """Frames lost of each source of a recording."""
    stats: dict[tuple[int, int], SourceStats] = {}
    for record in LogReader(data, dialect()):
        if record.frame is not None:
            source = (record.frame.sysid, record.frame.compid)
            found = stats.setdefault(source, SourceStats(*source))
            found.on_frame(record.frame.seq, len(record.raw), record.at_s)
    return {source: s.lost for source, s in stats.items()}


def test_recordings_show_the_loss_that_was_made_and_no_other() -> None:
    """Our own are of loopback; a vehicle 1 whose heartbeats another program forges is one frame off, of 962."""
    made = losses(capture("made-v1-v2-mixed.tlog")[0])
    assert made == {(1, 1): 15, (255, 190): 0, (51, 68): 0, (1, 0): 0}, "three frames in each of five seconds"
    public = losses(capture("binus-hexa-5src-mixed.tlog")[0])
    assert [public[source] for source in ((1, 1), (255, 230), (1, 190))] == [0, 0, 0]
    for name, lossless in (
        ("px4-late-frames", {11, 12, 1, 2, 3}),
        ("forged-heartbeat-50hz", {11, 12, 2, 3}),
        ("second-heartbeat-1hz", {11, 12, 1, 2, 3}),
        ("sitl-3ardupilot-2px4", {1, 2, 3, 4, 5}),
    ):
        own = losses(own_capture(name))
        assert [own[sysid, 1] for sysid in lossless] == [0] * len(lossless), name
        assert own[1, 1] <= 1, name


@each(("sysid", "compid"), [(1, 190), (255, 190), (51, 68)])
def test_relays_and_the_radio_are_counted_without_loss(sysid: int, compid: int) -> None:
    stats = fed([1, 50, 3, 200], sysid, compid)
    assert (stats.lost, stats.frames) == (0, 4)


def test_rates_are_those_since_the_last_sample() -> None:
    stats = SourceStats(1, 1)
    stats.sample(10.0)
    for n in range(20):
        stats.on_frame(n, 30, 10.0 + n / 10)
    stats.sample(12.0)
    assert stats.frames_per_s == pytest.approx(10.0)
    assert stats.bytes_per_s == pytest.approx(300.0)
    stats.sample(14.0)
    assert stats.frames_per_s == 0.0
    assert stats.as_dict(15.0)["age_s"] == pytest.approx(15.0 - 11.9)


FRAMES = st.lists(st.tuples(st.integers(0, 255), st.sampled_from([0.0, 0.01, 0.7, 2.5])), max_size=300)


@given(FRAMES, st.integers(0, 9))
def test_whatever_comes_the_loss_is_none_or_some_and_no_more_than_the_numbers_allow(frames, restart_every) -> None:
    stats, now = SourceStats(1, 1), 0.0
    for n, (seq, pause_s) in enumerate(frames, 1):
        now += pause_s
        stats.on_frame(seq, 20, now)
        if restart_every and n % (10 * restart_every) == 0:
            stats.restart()
        assert 0 <= stats.lost <= 256 * n and 0.0 <= stats.loss_ratio < 1.0
    assert stats.frames == len(frames)


def test_losses_of_the_last_while() -> None:
    window = LossWindow()
    assert window.loss() is None
    window.sample(1000, 900, 0.0)  # what was lost long ago
    window.sample(1010, 900, 1.0)
    assert window.loss() is None and window.frames() == 10
    window.sample(1030, 910, 2.0)
    assert window.loss() == pytest.approx(10 / 40)
    for second in range(3, 60):
        window.sample(1030 + 10 * second, 910, float(second))
    assert window.loss() == 0.0
    window.sample(5, 0, 60.0)  # the counters began anew
    assert window.loss() is None
