"""One metric for Prometheus: name, type, labels, meaning. Names and units by Prometheus's conventions.

A label has a bounded set of values: links of the fleet, vehicles that are kept (`MAX_VEHICLES`), and constants of the
code. Peers of a link, sources of frames and texts are no labels: others can make up as many as they like.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Kind = Literal["counter", "gauge"]


class MetricInfo(NamedTuple):
    """One metric. ``name`` of a counter ends in _total, as it is scraped."""

    name: str
    kind: Kind
    labels: tuple[str, ...]
    help: str


def metrics_with(labels: str, *rows: tuple[str, str]) -> list[MetricInfo]:
    """Metrics with the same labels; a counter is recognised by its name."""
    return [
        MetricInfo(f"skygcs_{name}", "counter" if name.endswith("_total") else "gauge", tuple(labels.split()), text)
        for name, text in rows
    ]
