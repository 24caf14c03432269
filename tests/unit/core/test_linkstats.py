"""Counters per source: sequence loss modulo 256, rates, and who is not counted."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.linkstats import SourceStats
from skygcs.core.tlog import iter_records
from support.frames import dialect
from support.public_data import capture


def fed(seqs: list[int], sysid: int = 1, compid: int = 1) -> SourceStats:
    stats = SourceStats(sysid, compid)
    for n, seq in enumerate(seqs):
        stats.on_frame(seq & 0xFF, 20, n * 0.1)
    return stats


@given(st.integers(0, 255), st.integers(1, 2000))
def test_an_unbroken_sequence_loses_nothing_wherever_it_wraps(first: int, count: int) -> None:
    stats = fed(list(range(first, first + count)))
    assert (stats.lost, stats.frames, stats.bytes) == (0, count, count * 20)
    assert stats.loss_ratio == 0.0


@given(st.integers(0, 255), st.lists(st.integers(1, 249), min_size=1, max_size=30))
def test_gaps_are_counted_modulo_256(first: int, gaps: list[int]) -> None:
    seqs = [first]
    for gap in gaps:
        seqs.append(seqs[-1] + gap + 1)
    stats = fed(seqs)
    assert stats.lost == sum(gaps)
    assert stats.loss_ratio == pytest.approx(sum(gaps) / (sum(gaps) + len(seqs)))


def test_a_late_frame_takes_its_loss_back_and_a_repeated_one_changes_nothing() -> None:
    assert fed([1, 3, 2, 4]).lost == 0
    assert fed([1, 2, 2, 3]).lost == 0
    assert fed([250, 253, 251, 252, 254]).lost == 0


def test_a_restart_of_the_sender_is_no_loss() -> None:
    stats = fed([100, 101])
    stats.restart()
    stats.on_frame(0, 20, 1.0)
    assert stats.lost == 0


@pytest.mark.parametrize(("sysid", "compid"), [(1, 190), (255, 190), (51, 68)])
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


def test_two_senders_on_one_link_lose_nothing_where_a_count_per_link_would() -> None:
    """mavlink-router counts per endpoint: every change of sender looks like loss there."""
    stats = {s: SourceStats(s, 1) for s in (1, 2)}
    for n in range(300):
        for sysid, offset in ((1, 0), (2, 77)):
            stats[sysid].on_frame(n + offset & 0xFF, 20, n / 10)
    assert [s.lost for s in stats.values()] == [0, 0]


def test_a_lossless_public_capture_shows_almost_no_loss_per_source() -> None:
    data, expected = capture("binus-hexa-5src-mixed.tlog")
    stats: dict[tuple[int, int], SourceStats] = {}
    for record in iter_records(data, dialect()):
        if record.frame is not None:
            source = (record.frame.sysid, record.frame.compid)
            found = stats.setdefault(source, SourceStats(*source))
            found.on_frame(record.frame.seq, len(record.raw), record.elapsed_s)
    assert expected["seq_lost"]["1/1"] == 0
    assert stats[1, 1].lost == 0 and stats[255, 230].lost == 0
    assert stats[1, 190].lost == 0
