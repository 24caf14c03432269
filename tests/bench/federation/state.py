"""Part "state": the states of four sites with 250 vehicles each, at 10 Hz, to three readers through a real hub.

Three runs of the same length: one site alone; all four; all four with one reader stopped (SIGSTOP) for the whole of it.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from bench.results import Found, cpu_s, percentile
from support.hub import Hub
from support.process import ROOT

SITES = ("s1", "s2", "s3", "s4")
READERS = ("r1", "r2", "r3")
VEHICLES = 250
RATE_HZ = 10.0
PERIOD_S = 1.0 / RATE_HZ

READY_WITHIN_S = 120.0
LEAD_S = 1.0
HEAL_S = 8.0
"""For the reader that was stopped, to find out that it was cut off, and to connect again."""

AGE_P99_S = 0.050


def measure_state(seconds: float) -> Found:
    """All three runs."""
    return asyncio.run(_measure(seconds))


def check_state(found: Found) -> list[tuple[str, bool]]:
    """(line, whether it holds)."""
    rows: list[tuple[str, bool]] = []
    for name, run in (("four sites", found["all"]), ("with one reader stopped", found["stopped"])):
        wanted = found["seconds"] * RATE_HZ
        counts = [count for reader in run["readers"] for count in reader["batches"].values()]
        least, most = min(counts, default=0), max(counts, default=0)
        even = len(counts) == len(SITES) * len(run["readers"]) and wanted - 1 <= least and most <= wanted + 1
        rows += [
            (f"{name}: {least} to {most} batches per site and reader in {wanted:g} periods (one each)", even),
            (
                f"{name}: oldest state shown {run['oldest_ms_max']:.0f} ms ({2e3 * PERIOD_S:.0f})",
                run["oldest_ms_max"] <= 2e3 * PERIOD_S,
            ),
            (
                f"{name}: age p50/p99 {run['age_ms_p50']:.1f}/{run['age_ms_p99']:.1f} ms ({1e3 * AGE_P99_S:.0f})",
                run["age_ms_p99"] <= 1e3 * AGE_P99_S,
            ),
            (
                f"{name}: total age shown is wrong by {run['age_error_ms_p99']:.1f} ms at p99 (10)",
                run["age_error_ms_p99"] <= 10.0,
            ),
            (
                f"{name}: ages are shown too small by {run['age_understated_ms_max']:.1f} ms at most (20)",
                run["age_understated_ms_max"] <= 20.0,
            ),
        ]
    stopped = found["stopped"]["stopped_reader"]
    rows.append((f"the stopped reader: {stopped['what']}", stopped["cut_off"] or stopped["dropped"]))
    fresh_s = stopped["fresh_after_s"]
    rows.append((f"the stopped reader: fresh states {fresh_s} s after it went on (5)", (fresh_s or 99.0) <= 5.0))
    return rows


async def _measure(seconds: float) -> Found:
    found: Found = {"seconds": seconds, "vehicles": VEHICLES, "rate_hz": RATE_HZ}
    for name, sites, stopped in (("alone", SITES[:1], False), ("all", SITES, False), ("stopped", SITES, True)):
        with tempfile.TemporaryDirectory() as folder:
            found[name] = await _run(Path(folder), sites, seconds, stopped=stopped)
        print(f"  {name}: {_line(found[name])}", flush=True)
    alone, everything = found["alone"], found["all"]
    found["ratio_to_one_site"] = {
        "age_p99": round(everything["age_ms_p99"] / max(alone["age_ms_p99"], 1e-3), 2),
        "cpu_reader": round(everything["cpu_reader"] / max(alone["cpu_reader"], 1e-4), 2),
        "cpu_hub": round(everything["cpu_hub"] / max(alone["cpu_hub"], 1e-4), 2),
    }
    return found


async def _run(folder: Path, sites: tuple[str, ...], seconds: float, *, stopped: bool) -> Found:
    users = {**{name: {"role": "site"} for name in sites}, **{name: {"role": "observer"} for name in READERS}}
    hub = Hub(folder, users)
    await hub.start()
    try:
        publishers = [await _start(hub, "publisher", name, str(VEHICLES), f"{RATE_HZ:g}") for name in sites]
        readers = [await _start(hub, "reader", name, str(len(sites))) for name in READERS]
        begin_s = await _begin([*publishers, *readers], seconds, HEAL_S if stopped else 0.0)
        await asyncio.sleep(begin_s - time.clock_gettime(time.CLOCK_BOOTTIME))
        server = hub.process.process
        assert server is not None
        cpu_before = cpu_s(server.pid)
        if stopped:
            readers[-1].send_signal(signal.SIGSTOP)
        await asyncio.sleep(begin_s + seconds - time.clock_gettime(time.CLOCK_BOOTTIME))
        cpu_hub = (cpu_s(server.pid) - cpu_before) / seconds
        if stopped:
            readers[-1].send_signal(signal.SIGCONT)
        said = [await _said(process) for process in (*publishers, *readers)]
    finally:
        await hub.stop()
    return _summary(said[: len(sites)], said[len(sites) :], cpu_hub, stopped=stopped)


async def _start(hub: Hub, kind: str, name: str, *more: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "bench.federation.station", kind, hub.url, str(hub.key_file(name)), name, *more),
        env={**os.environ, "PYTHONPATH": str(ROOT / "tests")},
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        limit=1 << 26,
    )


async def _begin(processes: list[asyncio.subprocess.Process], seconds: float, more_s: float) -> float:
    """When the measurement begins: LEAD_S after all are ready."""
    async with asyncio.timeout(READY_WITHIN_S):
        for process in processes:
            assert process.stdout is not None
            while (line := await process.stdout.readline()) != b"ready\n":
                if not line:
                    raise RuntimeError("a process of the bench ended before it was ready")
    begin_s = time.clock_gettime(time.CLOCK_BOOTTIME) + LEAD_S
    for process in processes:
        assert process.stdin is not None
        process.stdin.write(f"{begin_s:.3f} {begin_s + seconds:.3f} {begin_s + seconds + more_s:.3f}\n".encode())
    return begin_s


async def _said(process: asyncio.subprocess.Process) -> Found:
    out, _ = await process.communicate()
    told: Found = json.loads(out.splitlines()[-1])  # after what it logged
    return told


def _summary(publishers: list[Found], readers: list[Found], cpu_hub: float, *, stopped: bool) -> Found:
    found: Found = {}
    if stopped:
        *readers, last = readers
        cut = last["connections"] > 1
        lost = sum(site["lost"] for site in last["lost"].values())
        what = "cut off by the hub" if cut else f"{lost} batches dropped"
        fresh_s = last["fresh_after_s"]
        found["stopped_reader"] = {"cut_off": cut, "dropped": lost > 0, "what": what, "fresh_after_s": fresh_s}
    ages = [age for reader in readers for age in reader["ages_s"]]
    errors = [abs(error) for reader in readers for error in reader["errors_s"]]
    understated_s = max((-error for reader in readers for error in reader["errors_s"]), default=0.0)
    shown = [
        {key: value for key, value in reader.items() if key not in ("ages_s", "oldest_s", "errors_s")}
        for reader in readers
    ]
    return found | {
        "age_ms_p50": _quantile_ms(ages, 0.5),
        "age_ms_p99": _quantile_ms(ages, 0.99),
        "age_ms_max": _quantile_ms(ages, 1.0),
        "oldest_ms_max": max((1e3 * age for reader in readers for age in reader["oldest_s"]), default=0.0),
        "age_error_ms_p99": _quantile_ms(errors, 0.99),
        "age_understated_ms_max": round(1e3 * max(0.0, understated_s), 2),
        "cpu_site": round(max(publisher["cpu_share"] for publisher in publishers), 4),
        "cpu_reader": round(max(reader["cpu_share"] for reader in readers), 4),
        "cpu_hub": round(cpu_hub, 4),
        "batch_bytes": max(publisher["bytes"] for publisher in publishers),
        "load": os.getloadavg()[0],
        "publishers": publishers,
        "readers": shown,
    }


def _line(run: Found) -> str:
    return (
        f"age p50/p99/max {run['age_ms_p50']:.1f}/{run['age_ms_p99']:.1f}/{run['age_ms_max']:.1f} ms, "
        f"a batch {run['batch_bytes'] / 1e3:.1f} kB, of a core: a site {run['cpu_site']:.1%}, a reader "
        f"{run['cpu_reader']:.1%}, the hub {run['cpu_hub']:.1%}; load {run['load']:.1f}"
    )


def _quantile_ms(values: list[float], share: float) -> float:
    return 1e3 * percentile(values, share) if values else float("inf")
