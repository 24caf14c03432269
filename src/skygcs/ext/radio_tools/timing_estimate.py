"""Timing of a network of radios, from the frames of a `LinkProbe`: round, slot, throughput, delay, loss.

All arrivals of one way lie on a grid: a node sends once a round, always at the same place in it. The grid's period is
the round, and the distance of both ways' grids is the number of slots between their nodes. The period is found as the
longest one with which (nearly) all times between two arrivals agree, and fitted by least squares without outliers; both
bear losses, which leave out points of the grid and move none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, inf, pi, sqrt
from statistics import fmean, median

from skygcs.core.radio_link.capacity import BITS_PER_BYTE
from skygcs.errors import RefusedError
from skygcs.ext.radio_tools.link_probe import WAYS, Phase, Sent

Z95 = 1.96

NEAR_BEST = 0.9
"""Part of the best period's agreement with which a longer one is taken for the true one: a half and a third of the
true period agree as well, noise apart."""

FAR_RESIDUAL = 4.0
"""Arrivals further from the grid than so many usual residuals are left out of the fit."""

LEAST_RESIDUAL_S = 0.0005
"""No port is read more exactly than that."""

LEAST_ARRIVALS = 6
"""Fewer arrivals of a size and way are no grid."""

LEAST_GAPS = 24
"""Fewer times between arrivals, of all sizes and ways, show no period."""

OVERFLOW_LOSS = 0.1
"""Part of a stream that is lost beyond what chance and the air explain: a buffer ran over."""

LEAST_FRAME_BYTES = 100
"""Frames that count for the slot's size are at least so long: many short ones cost the radio's own time."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A measured value between bounds within which the true one is with 95 % confidence."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Ends:
    """Facts about both ends that are known beforehand: ``nodes`` of the network and the ends' places in it (0 is the
    first). None: not known, or a pair of radios."""

    bauds: tuple[int, int]
    nodes: int | None = None
    places: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class SizeFigures:
    """Frames of one size on one way."""

    way: int
    frame_bytes: int
    throughput_bytes_per_s: float | None
    """None: too little came through to say."""
    loss: Figure
    stream_loss: float
    delay_mean_s: float
    delay_p50_s: float
    delay_p95_s: float
    """From writing a frame, at any moment of the round, until all of it is read at the other end."""
    singles: int


@dataclass(frozen=True, slots=True)
class Timing:
    """Result of one measurement."""

    round_s: Figure
    jitter_s: float
    """Usual distance of an arrival from the grid."""
    nodes: int
    nodes_known: bool
    """False: the number follows from round and slot."""
    slot_s: float
    sync_s: float
    slot_bytes: float
    serial_limited: bool
    """True if the serial ports and not the air limit throughput: the slot holds ``slot_bytes`` or more."""
    sizes: tuple[SizeFigures, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Grid:
    """Arrivals of one way and size: they lie at ``at`` and whole multiples of the period from it."""

    way: int
    size: int
    period: float
    at: float
    weight: float
    residual: float


def estimate(frames: tuple[Sequence[Sent], Sequence[Sent]], ends: Ends) -> Timing:
    """The timing that these frames show. Raises RefusedError where they show none, with what to do."""
    # rounds: one grid per way and size, on which the arrivals lie
    sizes = sorted({sent.size for way in frames for sent in way})
    arrivals = {(way, size): _on_air(frames[way], size, ends.bauds[1 - way]) for way in WAYS for size in sizes}
    coarse = _period(list(arrivals.values()))
    grids = [grid for (way, size), times in arrivals.items() if (grid := _fit(way, size, times, coarse)) is not None]
    if not all(any(grid.way == way for grid in grids) for way in WAYS):
        raise RefusedError(
            f"too few frames arrived to find the rounds (at least {LEAST_ARRIVALS} of a size and way are needed): "
            "measure longer (--seconds), or with less loss: antennas on, radios a few metres apart"
        )
    # their period, weighted by arrivals, with its error
    total = sum(grid.weight for grid in grids)
    period = sum(grid.period * grid.weight for grid in grids) / total
    jitter = median(grid.residual for grid in grids)
    error = Z95 * sqrt(sum(grid.weight * grid.residual**2 for grid in grids) / total) / sqrt(total)
    remarks: list[str] = []
    # slots of a round
    slot, nodes = _slot(grids, period, ends)
    known = ends.nodes is not None or ends.places is None
    sync = period - nodes * slot
    if not -0.02 * period <= sync <= max(slot, 0.02 * period):
        remarks.append(
            f"a round of {period * 1000:.1f} ms is not {nodes} slots of {slot * 1000:.1f} ms and a sync slot: "
            "is the network set up for so many nodes (--nodes)?"
        )
    # figures of each way and size, and what spoils them
    rows = tuple(_figures(frames[way], way, size, period) for way in WAYS for size in sizes)
    slot_bytes, limited = _slot_bytes(rows, period, ends)
    if limited:
        remarks.append(
            "the serial ports limit the throughput: a slot holds the bytes given or more; "
            "for its true size raise SERIAL_SPEED of both radios"
        )
    if any(_runs_over(row, _single_loss(rows, row.way)) for row in rows):
        remarks.append("streams lose more than single frames: a buffer of a radio runs over (RTSCTS = 1 and its wires)")
    if jitter > 0.1 * period:
        remarks.append("frames do not arrive on a grid of rounds: this firmware may have no fixed timeslots")
    figure = Figure(period, period - error, period + error)
    return Timing(figure, jitter, nodes, known, slot, max(0.0, sync), slot_bytes, limited, rows, tuple(remarks))


# -- the grid of rounds


def _on_air(frames: Sequence[Sent], size: int, baud: int) -> list[float]:
    """When single frames of a size left the air: when they were read, less their time on the serial line."""
    line_s = size * BITS_PER_BYTE / baud
    return [s.arrived_at - line_s for s in frames if s.size == size and s.phase is Phase.SINGLE and s.arrived_at]


def _gaps(times: Sequence[float]) -> list[float]:
    return [later - earlier for earlier, later in pairwise(times)]


def _period(arrivals: Sequence[Sequence[float]]) -> float:
    """The longest period that agrees with the times between arrivals, about."""
    gaps = sorted(gap for times in arrivals for gap in _gaps(times) if gap > 0)
    if len(gaps) < LEAST_GAPS:
        return inf
    gaps = gaps[: len(gaps) * 9 // 10]  # the longest ones are losses in a row
    usual = median(gaps)
    steps = [usual * 2.2 * 0.995**n for n in range(500)]  # down to 0.18 of it
    scores = [fmean(cos(2 * pi * gap / step) for gap in gaps) for step in steps]
    best = max(scores)
    first = next(n for n, score in enumerate(scores) if score >= NEAR_BEST * best)
    while first + 1 < len(scores) and scores[first + 1] > scores[first]:
        first += 1
    return _refined(gaps, steps[first])


def _refined(gaps: Sequence[float], period: float) -> float:
    for _ in range(4):
        counted = [(gap, round(gap / period)) for gap in gaps]
        period = median(gap / count for gap, count in counted if count > 0)
    return period


def _fit(way: int, size: int, times: Sequence[float], period: float) -> _Grid | None:
    """The grid through these arrivals: least squares, twice without those that lie far from it."""
    if len(times) < LEAST_ARRIVALS or period == inf:
        return None
    counts = [0]
    for gap in _gaps(times):
        counts.append(counts[-1] + round(gap / period))
    points = list(zip(counts, times, strict=True))
    middle_n = middle_t = weight = usual = 0.0
    for _ in range(3):
        middle_n, middle_t = fmean(n for n, _ in points), fmean(t for _, t in points)
        weight = sum((n - middle_n) ** 2 for n, _ in points)
        if not weight:
            return None
        period = sum((n - middle_n) * (t - middle_t) for n, t in points) / weight
        far = [abs(t - middle_t - (n - middle_n) * period) for n, t in points]
        usual = median(far)
        points = [p for p, distance in zip(points, far, strict=True) if distance <= FAR_RESIDUAL * usual + 1e-9]
    nearest = round(middle_n)
    at = middle_t + (nearest - middle_n) * period
    return _Grid(way, size, period, at, weight, max(1.4826 * usual, LEAST_RESIDUAL_S))


def _slot(grids: Sequence[_Grid], period: float, ends: Ends) -> tuple[float, int]:
    """The slot's length and the number of nodes."""
    if ends.places is None:  # a pair, which takes turns
        return period / 2, 2
    apart = ends.places[1] - ends.places[0]
    by_size = {(grid.way, grid.size): grid.at for grid in grids}
    offsets = []
    for way, size in by_size:
        if way == 0 and (1, size) in by_size:
            later = by_size[1, size] - by_size[0, size]
            offsets.append((later if apart > 0 else -later) % period)
    if not offsets or not apart:
        raise RefusedError("the places of both nodes in the round are not known: give the radios different node ids")
    slot = median(offsets) / abs(apart)
    return slot, ends.nodes or max(int(period / slot + 0.02), max(ends.places) + 1)


# -- throughput, loss, delay


def _figures(frames: Sequence[Sent], way: int, size: int, period: float) -> SizeFigures:
    single = [s for s in frames if s.size == size and s.phase is Phase.SINGLE]
    delays = _weighted_delays(single, period)
    stream = [s for s in frames if s.size == size and s.phase is Phase.STREAM]
    lost = sum(s.arrived_at is None for s in stream)
    return SizeFigures(
        way,
        size,
        _throughput(stream, period),
        wilson(len(single) - len(delays), len(single)),
        lost / len(stream) if stream else 0.0,
        sum(delay * weight for delay, weight in delays) if delays else inf,
        _quantile(delays, 0.5),
        _quantile(delays, 0.95),
        len(single),
    )


def _weighted_delays(single: Sequence[Sent], period: float) -> list[tuple[float, float]]:
    """(delay, weight), the smallest delay first. A frame's weight is the part of the round about the moment at which it
    was written: chance, and losses, leave parts of it with fewer frames."""
    placed = sorted((s.sent_at % period, s.arrived_at - s.sent_at) for s in single if s.arrived_at is not None)
    if len(placed) < 2:
        return [(delay, 1.0) for _, delay in placed]
    moments = [moment for moment, _ in placed]
    before, after = [moments[-1] - period, *moments[:-1]], [*moments[1:], moments[0] + period]
    parts = [(later - earlier) / (2 * period) for earlier, later in zip(before, after, strict=True)]
    return sorted((delay, part) for (_, delay), part in zip(placed, parts, strict=True))


def _throughput(stream: Sequence[Sent], period: float) -> float | None:
    """Bytes/s that arrived, over a whole number of rounds from the first arrival on: the first and the last round of a
    stream are not full."""
    arrived = sorted((s.arrived_at, s.size) for s in stream if s.arrived_at is not None)
    last_written = max((s.sent_at for s in stream), default=0.0)
    if not arrived:
        return None
    begin = arrived[0][0] + 0.9 * period  # the first round may hold less; and in the pause between two, not at a border
    rounds = int((last_written - begin) / period)
    if rounds < 1:
        return None
    end = begin + rounds * period
    return sum(size for at, size in arrived if begin <= at < end) / (rounds * period)


def _single_loss(rows: Sequence[SizeFigures], way: int) -> Figure:
    """Loss of single frames of all sizes: that of the air, since no buffer holds more than one."""
    own = [row for row in rows if row.way == way]
    return wilson(round(sum(row.loss.value * row.singles for row in own)), sum(row.singles for row in own))


def _runs_over(row: SizeFigures, air: Figure) -> bool:
    """True if a stream lost more than the air: the rest was lost in a buffer and not sent."""
    return row.stream_loss > air.high + OVERFLOW_LOSS


def _slot_bytes(rows: Sequence[SizeFigures], period: float, ends: Ends) -> tuple[float, bool]:
    """Bytes that a node sends in its slot, those that get lost included, of the way that carries less; and whether the
    serial ports limit it."""
    most = []
    for way in WAYS:
        air = _single_loss(rows, way)
        sent = [
            row.throughput_bytes_per_s / (1 - (air.value if _runs_over(row, air) else row.stream_loss))
            for row in rows
            if row.way == way and row.throughput_bytes_per_s is not None
            if row.frame_bytes >= LEAST_FRAME_BYTES or row.frame_bytes == max(r.frame_bytes for r in rows)
        ]
        most.append(max(sent, default=0.0))
    if not all(most):
        raise RefusedError("no stream came through in one of the ways: measure longer (--seconds)")
    return min(most) * period, min(most) > 0.93 * min(ends.bauds) / BITS_PER_BYTE


def wilson(count: int, of: int) -> Figure:
    """A share with its 95 % bounds (Wilson's score interval)."""
    if not of:
        return Figure(0.0, 0.0, 1.0)
    share, z2 = count / of, Z95**2
    middle = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = Z95 / (1 + z2 / of) * sqrt(share * (1 - share) / of + z2 / (4 * of * of))
    low, high = middle - half, middle + half
    return Figure(share, max(0.0, low) if count else 0.0, min(1.0, high) if count < of else 1.0)


def _quantile(delays: Sequence[tuple[float, float]], share: float) -> float:
    """The delay below which this share of the weight lies; infinite without any."""
    below = 0.0
    for delay, weight in delays:
        below += weight
        if below >= share:
            return delay
    return delays[-1][0] if delays else inf
