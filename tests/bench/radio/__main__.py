"""`make bench-radio`: what one radio carries, plain and with skygcs. A table on stdout, all in build/bench/radio.json.
Virtual time on emulated radios: docs/explanation/airtime.md says what they are.

python -m bench.radio [--quick]
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from bench.commanded_daemon import Column
from bench.radio import report
from bench.radio.cell import measure
from bench.results import keep

VEHICLES = (2, 4, 8, 10, 15)
AIRS_KBPS = (64.0, 125.0)
COLUMNS: tuple[Column, ...] = ("plain", "skygcs")


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.radio", description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="4 and 10 vehicles at 64 kbit/s only")
    options = parser.parse_args()
    began = time.monotonic()
    airs, numbers = ((64.0,), (4, 10)) if options.quick else (AIRS_KBPS, VEHICLES)
    cells = [(c, n, air) for air in airs for n in numbers for c in COLUMNS]
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(_measured, cells))
    targets, expected = report.verdicts(rows), report.collapse(rows)
    missed = [verdict.line() for verdict in targets if not verdict.met]
    print(report.table(rows))
    print(report.summary(targets))
    print("\n".join(verdict.line() for verdict in expected))
    seconds = round(time.monotonic() - began, 1)
    told = {
        "cells": rows,
        "targets": [verdict._asdict() for verdict in targets],
        "expected": [verdict._asdict() for verdict in expected],
        "missed": missed,
        "seconds": seconds,
    }
    path = keep("radio", told)
    print(f"\n{seconds:.0f} s; all of it in {path}")
    return 1 if missed else 0


def _measured(cell: tuple[Column, int, float]) -> dict[str, Any]:
    return measure(*cell).as_dict()


if __name__ == "__main__":
    sys.exit(main())
