"""Numbers of one collection: bounded in number, and sums that never decrease although their parts come and go."""

from __future__ import annotations

from types import SimpleNamespace

from prometheus_client.parser import text_string_to_metric_families

from skygcs.ext.metrics.collector import MAX_COUNTED, _GrowingSums
from skygcs.ext.metrics.table import METRICS
from skygcs.metrics import exposition
from skygcs.metrics.exposition import SLICE_LINES, Samples, written


def test_series_beyond_the_limit_are_left_out_and_counted() -> None:
    samples = Samples()
    for number in range(exposition.MAX_SERIES + 5):
        samples.put("skygcs_link_up", 1, f"link{number}")
    samples.put("skygcs_link_up", 0, "link3")  # one that is there can change
    assert (samples.count, samples.dropped) == (exposition.MAX_SERIES, 5)
    assert samples.by_metric["skygcs_link_up"]["link3",] == 0


def test_a_value_that_is_not_known_is_no_sample() -> None:
    samples = Samples()
    samples.put("skygcs_corrections_age_seconds", None)
    assert samples.by_metric == {}


def test_a_metric_in_slices_has_one_header_and_all_its_lines() -> None:
    metric = METRICS["skygcs_vehicle_lost_frames_total"]
    samples = [((f'v"{n}\n\\', "radio"), float(n)) for n in range(2 * SLICE_LINES + 3)]
    pieces = list(written(metric, samples))
    assert len(pieces) == 3
    (family,) = text_string_to_metric_families(b"".join(pieces).decode())
    assert (family.type, family.documentation) == ("counter", metric.help)
    assert [(s.labels["vehicle"], s.value) for s in family.samples] == [(labels[0], v) for labels, v in samples]


def source(frames: int, lost: int = 0) -> SimpleNamespace:
    return SimpleNamespace(frames=frames, lost=lost)


def counted(*sources: SimpleNamespace) -> list[tuple[tuple[str, ...], object, tuple[int, ...]]]:
    return [(("v1", "radio"), s, (s.frames, s.lost)) for s in sources]


def test_sums_grow_although_peers_come_go_and_come_back() -> None:
    sums, first, second = _GrowingSums(), source(1000, 3), source(50)
    assert sums.update(counted(first)) == {("v1", "radio"): [1000, 3]}
    assert sums.update(counted(first, second)) == {("v1", "radio"): [1050, 3]}
    second.frames = 60
    assert sums.update(counted(second)) == {("v1", "radio"): [1060, 3]}, "the first has closed"
    first.frames = 1001
    assert sums.update(counted(first, second)) == {("v1", "radio"): [1061, 3]}, "it came back with its counters"
    first.frames = 2  # it was counted anew
    assert sums.update(counted(first, second)) == {("v1", "radio"): [1063, 3]}


def test_peers_without_end_are_not_remembered_without_end() -> None:
    sums = _GrowingSums()
    for _ in range(MAX_COUNTED + 100):
        total = sums.update(counted(source(1)))
    assert total == {("v1", "radio"): [MAX_COUNTED + 100, 0]}
    assert len(sums._last) <= MAX_COUNTED + 1
