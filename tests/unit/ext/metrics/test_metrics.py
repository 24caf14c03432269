"""Names by Prometheus's conventions; the dashboard, the alert rules and the page name only metrics that exist."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from itertools import groupby
from types import SimpleNamespace

from prometheus_client.parser import text_string_to_metric_families

from skygcs.ext.federation.bridge.metrics import METRICS as FEDERATION_METRICS
from skygcs.ext.metrics.collector import MAX_COUNTED, _GrowingSums
from skygcs.ext.metrics.table import METRICS as DAEMON_METRICS
from skygcs.metrics import exposition
from skygcs.metrics.exposition import SLICE_LINES, Samples, written
from skygcs.metrics.metric_info import MetricInfo
from support.public_data import ROOT

METRICS = DAEMON_METRICS | FEDERATION_METRICS

UNITS = ("seconds", "bytes", "ratio", "frames", "total", "info", "records", "vehicles", "up")
PAGE = ROOT / "docs" / "reference" / "metrics.md"


def package_file(name: str) -> str:
    return files("skygcs.ext.metrics").joinpath(name).read_text()


def named_in(text: str) -> set[str]:
    return set(re.findall(r"\bskygcs_[a-z0-9_]+", text))


def test_names_follow_the_conventions() -> None:
    for name, metric in METRICS.items():
        assert re.fullmatch(r"skygcs_[a-z0-9]+(_[a-z0-9]+)*", name), name
        assert (metric.kind == "counter") == name.endswith("_total"), name
        assert not re.search(r"_(ms|s|percent|milliseconds|minutes|kb|mb|count)(_|$)", name), f"{name}: base units"
        assert metric.help.endswith(".") and not metric.help[0].islower(), name
        assert all(re.fullmatch("[a-z]+", label) for label in metric.labels), name


def test_no_label_holds_what_others_make_up() -> None:
    """Addresses of peers and sources of frames would be series without end."""
    known = {"version", "dialect", "kind", "order", "result", "verdict", "reason", "link", "type", "role", "direction"}
    known |= {"class", "vehicle", "sysid", "autopilot", "to", "site", "station", "series", "status"}
    assert {label for metric in METRICS.values() for label in metric.labels} <= known


def test_the_dashboard_names_only_metrics_that_exist_and_shows_most_of_them() -> None:
    dashboard = json.loads(package_file("dashboard.json"))
    queries = [t["expr"] for panel in dashboard["panels"] for t in panel.get("targets", [])]
    variables = [v["definition"] for v in dashboard["templating"]["list"] if v["type"] == "query"]
    named = named_in("\n".join(queries + variables))
    assert named <= METRICS.keys(), named - METRICS.keys()
    assert len(named) > len(METRICS) / 2


def test_panels_of_the_dashboard_lie_beside_each_other() -> None:
    taken: set[tuple[int, int]] = set()
    for panel in json.loads(package_file("dashboard.json"))["panels"]:
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert not cells & taken, panel["title"]
        assert place["x"] + place["w"] <= 24
        taken |= cells


def test_alert_rules_name_only_metrics_that_exist() -> None:
    named = named_in(package_file("alerts.yml"))
    assert named and named <= METRICS.keys(), named - METRICS.keys()


def listed(metrics: Mapping[str, MetricInfo]) -> str:
    """A part of the page: metrics by their labels, those without any first."""
    lines: list[str] = []
    for labels, found in groupby(sorted(metrics.values(), key=lambda m: bool(m.labels)), key=lambda m: m.labels):
        if labels:
            lines += ["", "With " + ", ".join(f"`{label}`" for label in labels) + ":", ""]
        lines += [f"- `{m.name}`: {m.help}" for m in found]
    return "\n".join(lines) + "\n"


def test_the_page_has_every_metric_with_its_labels_and_no_other() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert listed(DAEMON_METRICS) in text and listed(FEDERATION_METRICS) in text, "python FILE prints them"
    assert set(re.findall(r"^- `(skygcs_\w+)`", text, re.M)) == METRICS.keys()


if __name__ == "__main__":
    print(listed(DAEMON_METRICS), listed(FEDERATION_METRICS), sep="\n")


# -- Numbers of one collection: bounded in number, and sums that never decrease although their parts come and go.


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
    metric = DAEMON_METRICS["skygcs_vehicle_lost_frames_total"]
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
