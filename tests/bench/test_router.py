"""skygcs beside the bare forwarder and MAVProxy: cost, loss and latency per frame, interleaved round by round.

Run by `make bench`; results in build/bench/router.json and router.svg. MAVProxy is measured where it is installed
(SKYGCS_BENCH_MAVPROXY, else `mavproxy.py` on the path); further routers by SKYGCS_BENCH_ROUTERS, a JSON object of name:
command line, with {vehicles} for the port to listen on and {gcs} for the one to send to.
Ratios are to the bare forwarder in the same round: what the machine does besides cancels out. Targets are asserted only
with SKYGCS_BENCH_TARGETS=1: on a shared machine they would fail for others' sake.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from bench.results import OUT, keep
from support import router_bench as bench

ROUNDS = int(os.environ.get("SKYGCS_BENCH_ROUNDS", "5"))
SATURATED_PER_S = 400_000
"""More than any of them forwards; the generator's own limit."""

CASES: dict[str, dict[str, Any]] = {
    "saturated": {"rate": SATURATED_PER_S, "seconds": 0.5},
    "10,000/s": {"rate": 10_000, "seconds": 0.6},
    "1,000/s": {"rate": 1_000, "seconds": 1.0},
    "20,000/s, ten a datagram": {"rate": 20_000, "seconds": 0.5, "per_datagram": 10},
}
SLOW = {"MAVProxy, output module only": 30_000}
"""Offered no more than this: a router that is given 20 times what it takes does nothing but drop."""

BARE = "bare C forwarder"
ROUTING, FULL = "skygcs, routing only", "skygcs, vehicles and recording"
TARGETS = {
    ("saturated", ROUTING, "cpu_us"): 1.55,
    ("saturated", FULL, "cpu_us"): 2.1,
    ("1,000/s", ROUTING, "cpu_us"): 1.6,
    ("10,000/s", ROUTING, "p99_us"): 2.0,
    ("20,000/s, ten a datagram", ROUTING, "cpu_us"): 5.1 / 3.5,
}


def routers(folder: Path) -> list[bench.Router]:
    found = [
        bench.forwarder(folder),
        bench.skygcs(ROUTING, keep_vehicles=False, record=False),
        bench.skygcs(FULL, keep_vehicles=True, record=True),
        bench.skygcs(f"{ROUTING}, pure Python", keep_vehicles=False, record=False, pure=True),
        bench.skygcs(f"{FULL}, pure Python", keep_vehicles=True, record=True, pure=True),
    ]
    mavproxy = os.environ.get("SKYGCS_BENCH_MAVPROXY") or shutil.which("mavproxy.py")
    if mavproxy:
        found.append(bench.mavproxy(mavproxy, folder))
    for name, command in json.loads(os.environ.get("SKYGCS_BENCH_ROUTERS", "{}")).items():
        found.append(bench.Router(name, shlex.split(command)))
    return found


def measured(target: bench.Running, load: list[str], case: dict[str, Any]) -> dict[str, float]:
    options = {**case, "rate": min(case["rate"], SLOW.get(target.router.name, case["rate"]))}
    report = bench.run_load(target, load, **options)
    got = report["telemetry"]
    assert not got["wrong"] + got["corrupt"] + got["duplicates"], (target.router.name, got)
    return {
        "cpu_us": report["cpu_us"],
        "per_s": got["received"] / got["elapsed_s"] if got["elapsed_s"] else 0.0,
        "lost_percent": 100 * got["lost"] / got["expected"],
        "out_of_order": got["out_of_order"],
        "p50_us": got["p50_us"],
        "p99_us": got["p99_us"],
        "p999_us": got["p999_us"],
        "rss_mb": report["rss_mb"],
    }


@pytest.mark.timeout(600)
def test_router(tmp_path: Path) -> None:
    load = bench.generator(tmp_path)
    with ExitStack() as stack:
        targets = [stack.enter_context(bench.running(router, tmp_path)) for router in routers(tmp_path)]
        for target in targets:
            bench.wait_forwarding(target, load)
        rows = {}
        for name, case in CASES.items():
            cases = {t.router.name: lambda t=t, case=case: measured(t, load, case) for t in targets}
            rows[name] = bench.interleaved(ROUNDS, cases)
        rows["lossless"] = bench.interleaved(
            max(ROUNDS // 2, 1),
            {
                t.router.name: lambda t=t: {"per_s": bench.lossless_per_s(t, load, ladder_start(rows, t.router.name))}
                for t in targets
            },
        )
    table = {
        case: {n: {k: bench.spread(v) for k, v in row.items()} for n, row in by.items()} for case, by in rows.items()
    }
    ratios = {
        case: {key: bench.ratios(by, key, BARE) for key in ("cpu_us", "p99_us", "per_s") if key in by[BARE]}
        for case, by in rows.items()
    }
    keep("router", {"rounds": ROUNDS, "load_average": os.getloadavg(), "table": table, "ratios": ratios})
    show(table, ratios)
    draw(table)
    if os.environ.get("SKYGCS_BENCH_TARGETS"):
        for (case, name, key), limit in TARGETS.items():
            assert ratios[case][key][name]["median"] <= limit, (case, name, key)


def ladder_start(rows: dict[str, Any], name: str) -> float:
    """Below what its cost per frame allows: the ladder has some steps to climb."""
    costs = rows["saturated"][name]["cpu_us"]
    return min(0.3e6 / sorted(costs)[len(costs) // 2], 30_000.0)


def show(table: dict[str, Any], ratios: dict[str, Any]) -> None:
    for case, by in table.items():
        print(f"\n{case}")
        for name, row in by.items():
            if case == "lossless":
                print(f"  {name:46} {row['per_s']['median']:9,.0f}/s  {spread_text(ratios, case, 'per_s', name)}")
                continue
            cost = row["cpu_us"]
            late = "/".join(f"{row[q]['median']:.0f}" for q in ("p50_us", "p99_us", "p999_us"))
            print(
                f"  {name:46} {cost['median']:7.2f} us ({cost['min']:.2f}..{cost['max']:.2f}) "
                f"{spread_text(ratios, case, 'cpu_us', name):26} lost {row['lost_percent']['median']:5.1f} %  "
                f"p50/p99/p99.9 {late} us  {row['rss_mb']['max']:.0f} MB"
            )


def spread_text(ratios: dict[str, Any], case: str, key: str, name: str) -> str:
    r = ratios[case][key][name]
    return f"x {r['median']:.2f} ({r['min']:.2f}..{r['max']:.2f})"


def draw(table: dict[str, Any]) -> None:
    """CPU per frame of each router, one panel a case; nothing without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return
    matplotlib.use("svg")
    matplotlib.rcParams["svg.fonttype"] = "none"
    from matplotlib import pyplot
    from matplotlib.ticker import NullFormatter, NullLocator

    cases = [case for case in table if case != "lossless"]
    figure, panels = pyplot.subplots(1, len(cases), figsize=(3.4 * len(cases), 2.8), sharey=True, layout="constrained")
    for panel, case in zip(panels, cases, strict=True):
        names = list(table[case])[::-1]
        costs = [table[case][n]["cpu_us"] for n in names]
        middle = [c["median"] for c in costs]
        errors = [[c["median"] - c["min"] for c in costs], [c["max"] - c["median"] for c in costs]]
        colors = ["#4477aa" if name.startswith("skygcs") else "#bbbbbb" for name in names]
        panel.barh(names, middle, xerr=errors, color=colors, ecolor="#333333")
        for y, cost in enumerate(costs):
            panel.text(cost["max"] * 1.12, y, f"{cost['median']:.3g}", va="center", fontsize=8)
        panel.set_xscale("log")
        panel.set_xlim(min(middle) / 2, max(middle) * 3)
        ticks = [t for t in (1, 2, 5, 10, 20, 50, 100, 200, 500) if min(middle) / 2 < t < max(middle) * 3]
        panel.set_xticks(ticks, [str(t) for t in ticks])
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_title(case, fontsize=10)
        panel.set_xlabel("CPU per frame, µs (log)")
    figure.savefig(OUT / "router.svg", metadata={"Date": None})
    pyplot.close(figure)
