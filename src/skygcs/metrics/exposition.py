"""Samples of one collection, bounded in number, and their text in Prometheus's format, a slice at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from prometheus_client.exposition import generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from skygcs.metrics.metric_info import MetricInfo

SLICE_LINES = 50
"""Lines that are written in one turn of the loop: 0.5 ms."""

MAX_SERIES = 10_000
"""Time series of one collection: twice those of 250 vehicles under control on one radio, about 1 MB, which Prometheus
reads easily. Further ones are left out and counted (`skygcs_series_dropped`)."""

Labels = tuple[str, ...]


class Samples:
    """The samples of one collection by metric, bounded in number."""

    def __init__(self) -> None:
        self.by_metric: dict[str, dict[Labels, float]] = {}
        self.count = 0
        self.dropped = 0

    def put(self, name: str, value: float | None, *labels: str) -> None:
        """Add a sample; None: the value is not known now, and no sample is added."""
        if value is None:
            return
        samples = self.by_metric.setdefault(name, {})
        if labels not in samples:
            if self.count >= MAX_SERIES:
                self.dropped += 1
                return
            self.count += 1
        samples[labels] = value


def exposed(samples: Samples, metrics: Mapping[str, MetricInfo], process: Collector) -> Iterator[bytes]:
    """The text of a complete collection in slices: its metrics in the order of ``metrics``, then those of ``process``.

    Adds the metrics skygcs_series and skygcs_series_dropped, which must be in ``metrics``.
    """
    samples.put("skygcs_series_dropped", samples.dropped)
    samples.put("skygcs_series", samples.count + 1)
    for name, metric in metrics.items():
        if name in samples.by_metric:
            yield from written(metric, list(samples.by_metric[name].items()))
    for family in process.collect():
        yield _as_text(family)


class _One(Collector):
    """A collector of one metric, for `generate_latest`."""

    def __init__(self, metric: Metric) -> None:
        self._metric = metric

    def collect(self) -> Iterable[Metric]:
        return (self._metric,)


def _as_text(metric: Metric) -> bytes:
    return generate_latest(_One(metric))


def written(metric: MetricInfo, samples: Sequence[tuple[Labels, float]]) -> Iterator[bytes]:
    """The lines of one metric, SLICE_LINES at a time, under one header."""
    for begin in range(0, len(samples), SLICE_LINES):
        family: CounterMetricFamily | GaugeMetricFamily
        if metric.kind == "counter":
            family = CounterMetricFamily(metric.name, metric.help, labels=metric.labels)
        else:
            family = GaugeMetricFamily(metric.name, metric.help, labels=metric.labels)
        for labels, value in samples[begin : begin + SLICE_LINES]:
            family.add_metric(labels, value)
        text = _as_text(family)
        yield text if begin == 0 else text.split(b"\n", 2)[2]  # without its HELP and TYPE
