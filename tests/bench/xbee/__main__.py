"""`make bench-xbee`: what one XBee network carries with the seed's script and with skygcs, beside one RFD900x with
skygcs. A table on stdout, all in build/bench/xbee.json. Virtual time on emulated networks: docs/howto/xbee.md.

python -m bench.xbee
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import bench.radio.cell
import bench.xbee.cell
from bench.results import keep

VEHICLES = (3, 6, 9)
AGE_S = 2.5
"""Of a position at p95: what the radio bench asks for, too."""

WAYS: dict[str, Callable[[int], Any]] = {
    "XBee, seed's script": lambda vehicles: bench.xbee.cell.measure("plain", vehicles),
    "XBee, skygcs": lambda vehicles: bench.xbee.cell.measure("skygcs", vehicles),
    "RFD900x, skygcs": lambda vehicles: bench.radio.cell.measure("skygcs", vehicles, 64.0),
}


def main() -> int:
    began = time.monotonic()
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(_measured, [(way, n) for n in VEHICLES for way in WAYS]))
    print(f"{'':22} vehicles heard  age p50  age p95  ACK p50  ACK p95  orders lost")
    for row in rows:
        times = "  ".join(f"{_s(row[key]):>7}" for key in ("age_p50_s", "age_p95_s", "ack_p50_s", "ack_p95_s"))
        lost = f"{row['lost_commands']} of {row['commands']}"
        print(f"{row['way']:22} {row['vehicles']:8} {row['heard']:5}  {times}  {lost:>11}")
    missed = [row for row in rows if row["way"].endswith("skygcs") and not _met(row)]
    print(keep("xbee", {"rows": rows, "missed": missed, "seconds": round(time.monotonic() - began, 1)}))
    return 1 if missed else 0


def _measured(cell: tuple[str, int]) -> dict[str, Any]:
    way, vehicles = cell
    return {"way": way, **WAYS[way](vehicles).as_dict()}


def _met(row: dict[str, Any]) -> bool:
    age_s = row["age_p95_s"]
    return row["heard"] == row["vehicles"] and age_s is not None and age_s <= AGE_S and not row["lost_commands"]


def _s(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


if __name__ == "__main__":
    sys.exit(main())
