"""`make bench-radio`: what one radio carries, plain and with skygcs. A table on stdout, all in build/bench/radio.json,
a picture in build/bench/radio.png. Virtual time on emulated radios: docs/explanation/airtime.md says what they are.

python -m bench.radio [--quick]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from bench.radio.cell import Column, measure

OUT = Path(__file__).parents[3] / "build" / "bench"
VEHICLES = (2, 4, 8, 10, 15)
AIRS_KBPS = (64.0, 125.0)
COLUMNS: tuple[Column, ...] = ("plain", "skygcs")

AGE_S = 2.5
ACK_SPARE_S = 0.5
EMERGENCY_REPEAT_S = 0.5
"""The targets: position age at p95; acknowledgements within two rounds and this; a stop within two rounds and its
first repeats."""

CARRIES = {64.0: 10, 125.0: 15}
"""Vehicles that are to be carried, by air speed."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.radio", description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="4 and 10 vehicles at 64 kbit/s only")
    options = parser.parse_args()
    began = time.monotonic()
    airs, numbers = ((64.0,), (4, 10)) if options.quick else (AIRS_KBPS, VEHICLES)
    cells = [(c, n, air) for air in airs for n in numbers for c in COLUMNS]
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(_measured, cells))
    _table(rows)
    missed = _missed(rows)
    OUT.mkdir(parents=True, exist_ok=True)
    told = {"cells": rows, "missed": missed, "seconds": round(time.monotonic() - began, 1)}
    (OUT / "radio.json").write_text(json.dumps(told, indent=2) + "\n")
    _picture(rows, OUT / "radio.png")
    print(f"\n{told['seconds']:.0f} s; all of it in {OUT / 'radio.json'}, a picture in {OUT / 'radio.png'}")
    for what in missed:
        print(f"MISSED: {what}")
    return 1 if missed else 0


def _measured(cell: tuple[Column, int, float]) -> dict[str, Any]:
    return measure(*cell).as_dict()


def _table(rows: list[dict[str, Any]]) -> None:
    head = ("air", "veh.", "", "heard", "age p50", "p95", "pos/s", "loss", "ack p50", "p95", "lost", "usable", "stop")
    widths = (5, 5, 8, 6, 8, 8, 7, 7, 8, 8, 7, 8, 12)
    print("".join(f"{h:>{w}}" for h, w in zip(head, widths, strict=True)))
    for row in rows:
        stop = row["emergency_max_s"]
        cells = (
            f"{row['air_kbps']:g}",
            row["vehicles"],
            row["column"],
            row["heard"],
            _s(row["age_p50_s"]),
            _s(row["age_p95_s"]),
            f"{row['positions_per_vehicle_per_s']:.2f}",
            f"{row['loss']:.1%}",
            _s(row["ack_p50_s"]),
            _s(row["ack_p95_s"]),
            f"{row['lost_commands']}/{row['commands']}",
            _s(row["usable_s"]) if row["usable_s"] is not None else "never",
            f"{row['emergency_reached']} in {_s(stop)}" if stop is not None else "none",
        )
        print("".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True)))


def _s(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


def _missed(rows: list[dict[str, Any]]) -> list[str]:
    """Targets of the skygcs column that were not met, where they are to be."""
    missed = []
    for row in rows:
        if row["column"] != "skygcs" or row["vehicles"] > CARRIES[row["air_kbps"]]:
            continue
        where = f"{row['vehicles']} vehicles at {row['air_kbps']:g} kbit/s"
        ack, stop = 2 * row["round_s"] + ACK_SPARE_S, 2 * row["round_s"] + EMERGENCY_REPEAT_S
        checks = (
            ("position age p95", row["age_p95_s"], AGE_S),
            ("acknowledgement p95", row["ack_p95_s"], ack),
            ("lost commands", row["lost_commands"], 0),
            ("emergency stop", row["emergency_max_s"], stop),
        )
        missed += [
            f"{where}: {what} {got} (target {limit:.2f})" for what, got, limit in checks if got is None or got > limit
        ]
        if row["emergency_reached"] < row["vehicles"]:
            missed.append(f"{where}: the emergency stop reached {row['emergency_reached']} of them")
    return missed


def _picture(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(13, 4), constrained_layout=True)
    told = (("age_p95_s", "position age, p95 (s)"), ("ack_p95_s", "command ACK, p95 (s)"), ("loss", "frames lost"))
    for axis, (key, title) in zip(axes, told, strict=True):
        for air, dash in zip(AIRS_KBPS, ("-", "--"), strict=True):
            for column, colour in zip(COLUMNS, ("tab:red", "tab:blue"), strict=True):
                cells = [r for r in rows if r["column"] == column and r["air_kbps"] == air]
                points = [(r["vehicles"], r[key]) for r in cells if r[key] is not None]
                if points:
                    axis.plot(
                        *zip(*points, strict=True), dash, color=colour, marker="o", label=f"{column}, {air:g} kbit/s"
                    )
        axis.set_title(title)
        axis.set_xlabel("vehicles")
        if key != "loss":
            axis.set_yscale("log")
    axes[0].axhline(AGE_S, color="grey", linewidth=0.8)
    axes[0].legend(fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    sys.exit(main())
