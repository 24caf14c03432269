"""`make soak`: one daemon that records a fleet for an hour. Is its memory flat, and is anything lost?

    make soak                        # an hour, 250 vehicles, 5,000 frames/s
    make soak SOAK_MINUTES=20

A real process between a UDP port of vehicles (the load generator of tests/bench/native) and a ground station, with
fleet state, statistics and recording on, and one client of its socket that follows all vehicles at 2 Hz. It runs in
legs of a minute: each has ports of its own, as clients that come and go have. Resident memory is sampled every 5 s;
growth is the slope of a line through the samples after the warm-up. All in build/bench/soak.json and soak.png. Old logs
are deleted under way: an hour is 0.9 GB.
"""

from __future__ import annotations

import json
import os
import socket
import statistics
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from support import router_bench as bench

OUT = bench.ROOT / "build" / "bench"
MINUTES = float(os.environ.get("SOAK_MINUTES", "60"))
VEHICLES = int(os.environ.get("SOAK_VEHICLES", "250"))
RATE_PER_S = int(os.environ.get("SOAK_RATE", "5000"))

SAMPLE_S = 5.0
LEG_S = 60.0
KEPT_LOGS = 2
LOG_MB = 50

WARM_UP_S = 300.0
"""At most, and a quarter of short soaks: rings and queues fill, the allocator finds its level."""

LIMIT_MB = 90.0
FLAT_MB = 1.0
"""What a line through an hour's samples may rise by; one small object a second and vehicle is 50 MB."""


@dataclass
class Samples:
    """What the sampler saw; ``rss`` is (seconds, MB)."""

    rss: list[tuple[float, float]] = field(default_factory=list)
    deleted_bytes: int = 0
    told: int = 0
    cpu_s: float = 0.0


class Sampler(threading.Thread):
    """Looks at the daemon every SAMPLE_S, deletes old logs."""

    def __init__(self, pid: int, logs: Path) -> None:
        super().__init__(name="sampler")
        self.samples = Samples()
        self.ended = threading.Event()
        self._pid, self._logs = pid, logs
        self._began = time.monotonic()

    def run(self) -> None:
        while not self.ended.wait(SAMPLE_S):
            try:
                self._look()
            except OSError:  # the daemon is gone: the main thread tells
                return

    def _look(self) -> None:
        self.samples.rss.append((time.monotonic() - self._began, bench.rss_mb(self._pid)))
        self.samples.cpu_s = bench.cpu_s(self._pid)
        for old in sorted(self._logs.glob("*.tlog"))[:-KEPT_LOGS]:
            self.samples.deleted_bytes += old.stat().st_size
            old.unlink()


class Follower(threading.Thread):
    """A client that follows every vehicle and the events, and only counts what it is told."""

    def __init__(self, path: Path) -> None:
        super().__init__(name="follower")
        self.lines = 0
        self.ended = threading.Event()
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))
        self._socket.settimeout(0.5)
        for number, params in enumerate(({"topic": "telemetry", "rate_hz": 2}, {"topic": "events"})):
            request = {"jsonrpc": "2.0", "id": number, "method": "subscribe", "params": params}
            self._socket.sendall(json.dumps(request).encode() + b"\n")

    def run(self) -> None:
        with self._socket:
            while not self.ended.is_set():
                try:
                    data = self._socket.recv(1 << 20)
                except TimeoutError:
                    continue
                if not data:
                    return
                self.lines += data.count(b"\n")


def soak() -> dict[str, Any]:
    """Run it; the report."""
    with tempfile.TemporaryDirectory(prefix="skygcs-soak-") as name:
        folder = Path(name)
        load = bench.generator(folder)
        router = bench.skygcs("soak", keep_vehicles=True, record=True)
        router.fleet = router.fleet.replace("[daemon]\n", f"[daemon]\nrecord_max_mb = {LOG_MB}\n", 1)
        with bench.running(router, folder) as daemon:
            bench.wait_forwarding(daemon, load, vehicles=1)
            at_rest = bench.rss_mb(daemon.process.pid)
            sampler = Sampler(daemon.process.pid, folder / "soak" / "logs")
            follower = Follower(folder / "soak" / "s")
            threads: tuple[Sampler, Follower] = (sampler, follower)
            for thread in threads:
                thread.start()
            try:
                totals = _legs(daemon, load)
            finally:
                for thread in threads:
                    thread.ended.set()
                for thread in threads:
                    thread.join()
    return _report(sampler.samples, totals, follower.lines, at_rest)


def _legs(daemon: bench.Running, load: list[str]) -> dict[str, float]:
    """The load until the time is over, leg by leg; what became of its frames."""
    totals = dict.fromkeys(("expected", "received", "lost", "duplicates", "out_of_order", "wrong", "corrupt"), 0.0)
    until = time.monotonic() + MINUTES * 60
    began = time.monotonic()
    while (left_s := until - time.monotonic()) > 1 and daemon.process.poll() is None:
        seconds = min(LEG_S, left_s)
        report = bench.run_load(daemon, load, vehicles=VEHICLES, rate=RATE_PER_S, seconds=round(seconds, 2))
        for key in totals:
            totals[key] += report["telemetry"][key]
        minutes = (time.monotonic() - began) / 60
        print(f"{minutes:6.1f} min  {report['rss_mb']:6.1f} MB  lost {totals['lost']:.0f}", flush=True)
    if daemon.process.poll() is not None:
        raise RuntimeError(f"the daemon has ended: {daemon.output.read_text()[-2000:]}")
    return {**totals, "seconds": time.monotonic() - began}


def _report(samples: Samples, totals: dict[str, float], told: int, at_rest_mb: float) -> dict[str, Any]:
    last_s = samples.rss[-1][0]
    warm_up_s = min(WARM_UP_S, last_s / 4)
    kept = [(t, mb) for t, mb in samples.rss if t >= warm_up_s]
    slope, offset = statistics.linear_regression([t for t, _ in kept], [mb for _, mb in kept])
    return {
        "minutes": round(last_s / 60, 1),
        "vehicles": VEHICLES,
        "frames_per_s": round(totals["received"] / totals["seconds"]),
        **{key: int(totals[key]) for key in totals if key != "seconds"},
        "cpu_share": round(samples.cpu_s / last_s, 3),
        "telemetry_updates": told,
        "recorded_mb_deleted": round(samples.deleted_bytes / 1e6),
        "rss_mb": {
            "one vehicle": round(at_rest_mb, 1),
            "after warm-up": round(offset + slope * warm_up_s, 1),
            "at the end": round(offset + slope * last_s, 1),
            "most": round(max(mb for _, mb in samples.rss), 1),
        },
        "warm_up_s": round(warm_up_s),
        "growth_mb_per_hour": round(slope * 3600, 2),
        "samples": [(round(t, 1), round(mb, 2)) for t, mb in samples.rss],
    }


def _picture(report: dict[str, Any]) -> None:
    """Memory over time; nothing without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return
    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 3.5), layout="constrained")
    axes.plot([t / 60 for t, _ in report["samples"]], [mb for _, mb in report["samples"]], label="resident memory")
    ends = [report["warm_up_s"] / 60, report["minutes"]]
    fitted = [report["rss_mb"]["after warm-up"], report["rss_mb"]["at the end"]]
    axes.plot(ends, fitted, "--", label=f"{report['growth_mb_per_hour']:+.2f} MB per hour")
    axes.set(xlabel="minutes", ylabel="MB", ylim=(0, None))
    axes.set_title(f"{report['vehicles']} vehicles, {report['frames_per_s']} frames/s, recording")
    axes.legend(loc="lower right")
    figure.savefig(OUT / "soak.png", dpi=100)
    pyplot.close(figure)


def main() -> int:
    report = soak()
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "soak.json").write_text(json.dumps(report, indent=1) + "\n")
    _picture(report)
    print(json.dumps({k: v for k, v in report.items() if k != "samples"}, indent=1))
    rise_mb = report["rss_mb"]["at the end"] - report["rss_mb"]["after warm-up"]
    missed = [
        text
        for text, wrong in (
            (f"memory rose by {rise_mb:.1f} MB (limit {FLAT_MB})", rise_mb > FLAT_MB),
            (f"{report['rss_mb']['most']} MB (limit {LIMIT_MB})", report["rss_mb"]["most"] > LIMIT_MB),
            (f"{report['wrong'] + report['duplicates']} frames misdelivered", report["wrong"] + report["duplicates"]),
        )
        if wrong
    ]
    for text in missed:
        print(f"MISSED: {text}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
