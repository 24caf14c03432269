"""The short form of the router benchmark: what is delivered, never how fast."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from support import router_bench as bench

pytestmark = pytest.mark.system


def check(report: dict[str, Any]) -> None:
    for stream in ("telemetry", "commands"):
        bad = {k: report[stream][k] for k in ("lost", "duplicates", "out_of_order", "wrong", "corrupt")}
        assert not any(bad.values()), (stream, bad)


@pytest.mark.parametrize("pure", [False, True], ids=["fast path", "pure"])
def test_nothing_is_lost_or_misdelivered(tmp_path: Path, pure: bool) -> None:
    load = bench.generator(tmp_path)
    router = bench.skygcs("skygcs", keep_vehicles=True, record=True, pure=pure, gcs=2)
    # 200 datagrams at a time: they fit in a socket's buffer (276 with Linux' defaults), however long a busy machine
    # lets the router wait
    with bench.running(router, tmp_path, gcs=2) as target:
        bench.wait_forwarding(target, load)
        check(bench.run_load(target, load, rate=1_000, seconds=0.2))
        check(bench.run_load(target, load, rate=10_000, seconds=0.2, per_datagram=10))


def test_commands_reach_the_one_vehicle_they_are_for(tmp_path: Path) -> None:
    load = bench.generator(tmp_path)
    with bench.running(bench.skygcs("skygcs", keep_vehicles=True, record=True, gcs=2), tmp_path, gcs=2) as target:
        bench.wait_forwarding(target, load, own_sockets=1)
        check(bench.run_load(target, load, rate=1_000, commands=500, seconds=0.5, own_sockets=1))
