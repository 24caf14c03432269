"""Two emulated radios with altered timing are measured in virtual time: what was altered is found again.

The expected values are closed forms of the emulated network's parameters, written out here, and a least-squares fit by
numpy; nothing of the estimator's own arithmetic is used.
"""

from __future__ import annotations

import math
import re
from random import Random
from typing import NamedTuple

import numpy as np
import pytest

from skygcs.config.dialects import load_dialect
from skygcs.errors import RefusedError
from skygcs.ext.radio_tools.link_probe import FRAME_SIZES, LinkProbe, Phase, Sent
from skygcs.ext.radio_tools.timing_estimate import Ends, Timing, estimate, wilson
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import TdmConfig, TdmNetwork

DIALECT = load_dialect("ardupilotmega")
STEP_S = 0.004
"""How often the ports are read."""


class Air(NamedTuple):
    """The firmware's timing, and everything else of a case."""

    slot_s: float
    sync_s: float
    packet_bytes: int = 252
    nodes: int = 2
    other: int = 1
    """Node of the second modem; the first is the master, node 0."""
    loss: float = 0.0
    baud: int = 57600
    seconds: float = 60.0
    known_nodes: bool = True


LATENCY_S = 0.006


def network(air: Air, seed: int) -> TdmNetwork:
    """A network of which 6 ms of each slot are switching over, the rest on air (at 1 kbit/s: bits are milliseconds)."""
    config = TdmConfig(
        air.nodes,
        air_kbps=1.0,
        baud=air.baud,
        loss=air.loss,
        slot_bits=(air.slot_s - LATENCY_S) * 1000,
        slot_latency_s=LATENCY_S,
        sync_bits=0.0,
        sync_latency_s=air.sync_s,
        packet_bytes=air.packet_bytes,
    )
    return TdmNetwork(config, DIALECT, Rng(seed), now=Random(seed).random())


def measured(
    air: Air, seed: int, noise: bytes = b"", sizes: tuple[int, ...] = FRAME_SIZES, step_s: float = STEP_S
) -> LinkProbe:
    radios, now = network(air, seed), 1.0
    probe = LinkProbe(DIALECT, seconds=air.seconds, session=seed + 7, lost_after_s=3.0, now=now, sizes=sizes)
    nodes = (0, air.other)
    while not probe.done and not probe.silent:
        for end, node in enumerate(nodes):
            for raw in probe.take_output(end):
                radios.write(node, raw, now)
        now = round(now + step_s, 6)
        for node, raw in radios.step(now):
            if node in nodes:
                probe.feed(nodes.index(node), noise + raw, now)
        probe.advance(now)
        assert now < 20 * air.seconds, "it does not end"
    return probe


def timing(air: Air, seed: int) -> Timing:
    return estimate(measured(air, seed).frames, ends(air))


def ends(air: Air) -> Ends:
    return Ends((air.baud, air.baud), air.nodes if air.known_nodes else None, (0, air.other))


def held(air: Air, size: int) -> int:
    """Bytes of a packet full of frames of this size: none is split, and a longer one has a packet for itself."""
    return max(1, air.packet_bytes // size) * size


def near(value: float | None, true: float) -> bool:
    return value is not None and abs(value - true) <= 0.05 * true


AIRS = {
    "open_sik_64": Air(0.0812, 0.0186),
    "slower": Air(0.105, 0.031),
    "quicker": Air(0.047, 0.009, baud=115200),
    "larger_packets": Air(0.12, 0.02, packet_bytes=300),
    "smaller_packets": Air(0.07, 0.025, packet_bytes=210),
    "silent_nodes": Air(0.0455, 0.011, nodes=5, other=3, seconds=120),
    "sixteen_nodes": Air(0.0812, 0.0186, nodes=16, other=15, seconds=300),
    "nodes_not_known": Air(0.0812, 0.0186, nodes=4, other=1, seconds=120, known_nodes=False),
    "loss_10": Air(0.09, 0.015, loss=0.1, seconds=120),
    "loss_25": Air(0.06, 0.02, loss=0.25, seconds=300),
}


AGAIN = pytest.mark.deep  # seconds of each: minutes of packets, one after the other


@pytest.mark.parametrize("air", AIRS.values(), ids=AIRS.keys())
@pytest.mark.parametrize("seed", [1, pytest.param(4_000_014, marks=AGAIN)])  # most of its first frames are lost
def test_altered_timing_is_recovered_within_5_percent(air: Air, seed: int) -> None:
    found = timing(air, seed)
    # expected: closed forms
    round_s = air.nodes * air.slot_s + air.sync_s
    packet_s = (air.slot_s - LATENCY_S) / 2
    assert near(found.round_s.value, round_s), found
    assert near(found.slot_s, air.slot_s), found
    assert found.nodes == air.nodes
    assert not found.serial_limited
    for row in found.sizes:
        whole = held(air, row.frame_bytes)
        if not air.loss:
            assert near(row.throughput_bytes_per_s, 2 * whole / round_s), row
        line_s = row.frame_bytes * 10 / air.baud
        delay_s = 2 * line_s + round_s / 2 + LATENCY_S + packet_s
        between_s = round_s / row.singles  # moments of the round at which a frame was written
        assert abs(row.delay_mean_s - delay_s) <= 0.05 * delay_s + between_s / 2, row
    singles = sum(row.singles for row in found.sizes)
    lost = sum(row.loss.value * row.singles for row in found.sizes) / singles
    assert abs(lost - air.loss) <= 0.01 + 4 * math.sqrt(air.loss * (1 - air.loss) / singles), "four times its deviation"
    for row in found.sizes:
        assert abs(row.loss.value - air.loss) <= row.loss.high - row.loss.low, row  # twice 95 %: for every seed
    best = 2 * max(held(air, size) for size in (128, 252))
    assert near(found.slot_bytes, best), found
    assert found.round_s.low <= found.round_s.value <= found.round_s.high


@pytest.mark.parametrize("seed", [1_000_006, *(pytest.param(seed, marks=AGAIN) for seed in (2, 3))])
def test_loss_and_what_comes_through_are_recovered_within_5_percent(seed: int) -> None:
    """Some 15,000 packets: then chance itself is below 2 %. In the first, twice the round was measured."""
    air = Air(0.06, 0.02, loss=0.2, seconds=1200)
    found = estimate(measured(air, seed, sizes=(252,), step_s=0.01).frames, ends(air))
    for row in found.sizes:
        assert near(row.stream_loss, 0.2), row
        assert abs(row.loss.value - 0.2) <= row.loss.high - row.loss.low, row  # twice 95 %
        assert near(row.throughput_bytes_per_s, 2 * 252 * 0.8 / 0.14), row
    assert near(found.slot_bytes, 504) and near(found.slot_s, 0.06)


def test_the_round_is_that_of_numpys_least_squares_through_the_arrivals() -> None:
    air = Air(0.0812, 0.0186, seconds=40)
    probe, true = measured(air, 5), 0.181
    slopes = []
    for frames in probe.frames:
        for size in FRAME_SIZES:
            times = np.array([s.arrived_at for s in frames if s.size == size and s.phase is Phase.SINGLE])
            numbers = np.round((times - times[0]) / true)
            slopes.append((np.polyfit(numbers, times, 1)[0], np.var(numbers) * len(numbers)))
    fitted = np.average([slope for slope, _ in slopes], weights=[weight for _, weight in slopes])
    found = estimate(probe.frames, ends(air)).round_s
    assert found.value == pytest.approx(fitted, rel=1e-4)
    assert found.low <= fitted <= found.high


def test_a_serial_port_that_is_slower_than_the_air_is_named() -> None:
    air = Air(0.03, 0.005, seconds=40)
    found = timing(air, 1)
    assert found.serial_limited and any("SERIAL_SPEED" in text for text in found.remarks)
    assert near(found.round_s.value, 0.065) and near(found.slot_s, 0.03)


def test_a_buffer_that_runs_over_is_named_and_makes_no_slot_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    """Radios with a transmit buffer of 600 bytes and no flow control: what it loses never was on air."""
    monkeypatch.setattr("skygcs.sim.tdm.TX_BUFFER_BYTES", 600)
    found = timing(Air(0.0812, 0.0186, seconds=60), 1)
    assert any("a buffer of a radio runs over" in text for text in found.remarks), found
    assert 0.7 * 504 < found.slot_bytes <= 1.05 * 504


def test_other_nodes_than_there_are_do_not_go_with_round_and_slot() -> None:
    air = Air(0.0812, 0.0186, seconds=40)
    found = estimate(measured(air, 3).frames, Ends((57600, 57600), 5, (0, 1)))
    assert any(re.search(r"is not 5 slots of 8[0-2]\.", text) for text in found.remarks), found.remarks


def test_garbage_between_the_frames_changes_nothing_and_is_counted() -> None:
    air = Air(0.0812, 0.0186, seconds=40)
    probe = measured(air, 4, noise=b"\xfd\xff garbage \xfe\x09")
    assert min(probe.noise_bytes) > 1000
    assert near(estimate(probe.frames, ends(air)).round_s.value, 0.181)


def test_frames_of_another_run_and_repeated_ones_do_not_count() -> None:
    mine, other = (LinkProbe(DIALECT, seconds=9, session=n, lost_after_s=3, now=0.0) for n in (1, 2))
    mine.advance(0.0)
    other.advance(0.0)
    (theirs,), (own,) = other.take_output(0), mine.take_output(0)
    mine.feed(1, theirs, 0.1)
    mine.feed(0, own, 0.1)  # an echo, at the end where it was written
    assert mine.frames[0][0].arrived_at is None and mine.duplicates == 0
    mine.feed(1, own + own, 0.2)
    assert mine.frames[0][0].arrived_at == 0.2 and mine.duplicates == 1


def test_a_way_on_which_nothing_arrives_is_named_and_ends_it() -> None:
    probe, now = LinkProbe(DIALECT, seconds=9, session=1, lost_after_s=3, now=0.0), 0.0
    while (deadline := probe.next_deadline()) is not None:
        for raw in probe.take_output(0):
            probe.feed(1, raw, now + 0.05)
        now = max(deadline, now + 0.1)
        probe.advance(now)
        assert now < 60
    assert probe.silent == [1] and not probe.done


def test_too_few_arrivals_are_refused_with_what_to_do() -> None:
    few = [Sent(24, Phase.SINGLE, n * 0.2, n * 0.2 + 0.1) for n in range(5)]
    with pytest.raises(RefusedError, match="measure longer"):
        estimate((few, few), Ends((57600, 57600), 2, (0, 1)))


def test_the_bounds_of_a_share_are_wilsons() -> None:
    """Newcombe 1998, table I: 81 of 263 and 0 of 20."""
    assert [round(x, 4) for x in (wilson(81, 263).low, wilson(81, 263).high)] == [0.2553, 0.3662]
    assert [round(x, 4) for x in (wilson(0, 20).low, wilson(0, 20).high)] == [0.0, 0.1611]
