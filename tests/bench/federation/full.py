"""Part "full": four sites with 250 simulated vehicles each, and all that a user runs of them: four `skygcs run` with
their bridges, four `skygcs sim`, the hub, an observer, the web page at one site, the command line.

One machine carries all of it, so what is measured is what this machine carries: how often the states of a vehicle of
another site are newer, how old they are, and what each kind of process takes. Whatever the rate: every vehicle is
shown, every one has one outcome of an order to all, and the page gets counts of every site.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp

from bench.results import Found, cpu_s, percentile
from skygcs.rpc.client import connect
from support.hub import Hub
from support.process import free_port
from support.web_station import WebStation, command

SITES = ("north", "south", "east", "west")
VEHICLES = int(os.environ.get("FULL_VEHICLES", "250"))
"""Of each site: FULL_VEHICLES=25 for a quick look."""

SPEEDUP = os.environ.get("FULL_SPEEDUP", "1")
"""Seconds of the simulators in a second, for a machine that cannot carry all of it in real time: with 0.3 each vehicle
sends 0.3 of its messages and is heard once in 3.3 s, which is still there (5 s)."""

HOMES = ("43.7806,-79.4653,180", "43.7846,-79.4653,180", "43.7806,-79.4593,180", "43.7846,-79.4593,180")
"""400 m apart."""

ROLES = {site: {"role": "site", "orders": ["*"]} for site in SITES} | {"visitor": {"role": "observer"}}

FLEET = """
[daemon]
socket = "gcs.sock"
log_dir = "logs"

[federation]
site = "{site}"
servers = ["{url}"]
nkey = "{key}"

[links.vehicles]
type = "udp_server"
role = "vehicle"
host = "127.0.0.1"
port = {port}

[defaults.streams]
GLOBAL_POSITION_INT = 4
ATTITUDE = 1
"""

OBSERVER = """
[federation]
role = "observer"
servers = ["{url}"]
nkey = "{key}"
"""

READY_WITHIN_S = 300.0
CLI_WITHIN_S = 120.0


def measure_full(seconds: float) -> Found:
    """Start everything, measure, order all, end everything."""
    with tempfile.TemporaryDirectory(prefix="skygcs-bench-full-") as folder:
        return asyncio.run(_measure(Path(folder), seconds))


def check_full(found: Found) -> list[tuple[str, bool]]:
    """(line, whether it holds). The rate and the ages are this machine's: they are told, and miss nothing."""
    total, page, order = found["vehicles"], found["page"], found["order"]
    return [
        (
            f"{found['shown']} of {total} vehicles are shown at one site, in {found['ready_s']:.0f} s",
            found["shown"] == total,
        ),
        (
            f"vehicles of other sites: {found['updates_hz']:.2f} newer states a second each, total age p50/p99 "
            f"{found['age_s_p50']:.2f}/{found['age_s_p99']:.2f} s on {os.cpu_count()} cores (told)",
            found["updates_hz"] > 0,
        ),
        (
            f"page: {page['sites']} sites, {page['vehicles']} vehicles, {page['batches_hz']:.1f} batches a second, "
            f"{page['kb_per_s']:.0f} kB/s",
            page["sites"] == len(SITES) and page["vehicles"] == total,
        ),
        (
            f"an order to all: {order['outcomes']} outcomes, {order['ok']} done, {order['took_s']:.1f} s",
            order["outcomes"] == total,
        ),
        (
            f"skygcs-cli status in {found['cli_status_s']:.1f} s with {found['cli_lines']} lines",
            found["cli_lines"] >= total,
        ),
    ]


async def _measure(folder: Path, seconds: float) -> Found:
    hub = Hub(folder, ROLES)
    await hub.start()
    with _processes(folder, hub) as groups:
        try:
            return await _measured(folder, seconds, groups, hub)
        finally:
            await hub.stop()


@contextlib.contextmanager
def _processes(folder: Path, hub: Hub) -> Iterator[dict[str, list[int]]]:
    """Simulators, daemons with their bridges, an observer; by kind their process ids."""
    started: list[subprocess.Popen[bytes]] = []
    groups: dict[str, list[int]] = {"simulators": [], "daemons": []}

    def start(kind: str, line: list[str], place: Path) -> None:
        with open(place / f"{kind}.log", "ab") as log:
            environment = os.environ | {"XDG_STATE_HOME": str(place), "XDG_CACHE_HOME": str(place)}
            process = subprocess.Popen(line, stdout=log, stderr=log, cwd=place, env=environment)
        started.append(process)
        groups[kind].append(process.pid)

    try:
        for site, home in zip(SITES, HOMES, strict=True):
            place, port = folder / site, free_port()
            place.mkdir()
            text = FLEET.format(site=site, url=hub.url, key=hub.key_file(site), port=port)
            (place / "fleet.toml").write_text(text)
            kinds = ["--px4", str((VEHICLES + 1) // 2), "--ardupilot", str(VEHICLES // 2), "--dynamics", "kinematic"]
            start("daemons", command("run", "fleet.toml"), place)
            start(
                "simulators",
                command("sim", *kinds, "--udp", f"127.0.0.1:{port}", "--home", home, "--speedup", SPEEDUP),
                place,
            )
        place = folder / "visitor"
        place.mkdir()
        (place / "fleet.toml").write_text(OBSERVER.format(url=hub.url, key=hub.key_file("visitor")))
        line = command("federation", "run", "fleet.toml", "--no-daemon", "--socket", str(place / "gcs.sock"))
        groups["observer"] = []
        start("observer", line, place)
        yield groups
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGTERM)
        for process in started:
            try:
                process.wait(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


async def _measured(folder: Path, seconds: float, groups: dict[str, list[int]], hub: Hub) -> Found:
    total, path = len(SITES) * VEHICLES, folder / SITES[0] / "gcs.sock.federation"
    found: Found = {"vehicles": total, "seconds": seconds, "speedup": float(SPEEDUP)}
    began = time.monotonic()
    found["shown"] = await _until_shown(path, total)
    found["ready_s"] = round(time.monotonic() - began, 1)
    assert hub.process.process is not None
    groups |= {"hub": [hub.process.process.pid], "bridges": _children(groups["daemons"])}
    web = WebStation(folder / SITES[0], None)
    web.start()
    assert web.web_process is not None
    groups["web"] = [web.web_process.pid]
    try:
        before = {kind: sum(map(cpu_s, pids)) for kind, pids in groups.items()}
        states, found["page"] = await asyncio.gather(_read_states(path, seconds), _read_page(web, seconds))
        found |= states
        found["cpu"] = {
            kind: round((sum(map(cpu_s, pids)) - before[kind]) / seconds, 2) for kind, pids in groups.items()
        }
        print(f"  cores taken: {found['cpu']}", flush=True)
        found["order"] = await _order_all(path)
    finally:
        web.close()
    began = time.monotonic()
    line = [sys.executable, "-c", "from skygcs.cli.main import main; main()", "--socket", str(path), "status"]
    done = await asyncio.to_thread(subprocess.run, line, capture_output=True, text=True, timeout=CLI_WITHIN_S)
    found |= {"cli_status_s": round(time.monotonic() - began, 1), "cli_lines": len(done.stdout.splitlines())}
    async with connect(folder / "visitor" / "gcs.sock.federation") as visitor:
        sites = (await visitor.call("federation.sites"))["sites"]
    found["observer"] = {site["site"]: [site["vehicles"]["heard"], site["age_s"], site["batches"]] for site in sites}
    return found


async def _until_shown(path: Path, total: int) -> int:
    """How many vehicles one site shows as connected, once all are, or when the time is over."""
    deadline, shown = time.monotonic() + READY_WITHIN_S, 0
    while time.monotonic() < deadline and shown < total:
        await asyncio.sleep(1.0)
        with contextlib.suppress(Exception):  # the bridge is not there yet, or knows no other site
            async with connect(path) as gcs:
                shown = sum(state["connected"] for state in await gcs.vehicles("*/all"))
    return shown


async def _read_states(path: Path, seconds: float) -> Found:
    """What a program gets of vehicles of other sites: newer states of each, and their total ages."""
    ages: list[float] = []
    newest: dict[str, float] = {}
    newer = 0
    async with connect(path) as gcs:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                async for state in gcs.telemetry("*/all", rate_hz=10.0, groups=["position"]):
                    position = state["position"]
                    if "/" not in state["name"] or position is None or position["age_s"] is None:
                        continue
                    ages.append(position["age_s"])
                    came_at = time.monotonic() - position["age_s"]
                    if came_at > newest.get(state["name"], 0.0) + 0.05:
                        newest[state["name"]] = came_at
                        newer += 1
    others = (len(SITES) - 1) * VEHICLES
    return {
        "updates_hz": round(newer / others / seconds, 3),
        "age_s_p50": round(percentile(ages, 0.5), 3),
        "age_s_p99": round(percentile(ages, 0.99), 3),
        "others_seen": len(newest),
    }


async def _read_page(web: WebStation, seconds: float) -> Found:
    """What a page gets that shows the sites folded, and one of them unfolded."""
    batches = size = 0
    counts: dict[str, int] = {}
    names: set[str] = set()
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        await session.get(await asyncio.to_thread(web.address), allow_redirects=False)
        socket = await session.ws_connect(f"{web.base}/ws", origin=web.base, max_msg_size=0)
        for number, (method, params) in enumerate(
            (("web.subscribe", {"rate_hz": 10}), ("web.view", {"sites": ["south"]}))
        ):
            await socket.send_str(json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params}))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                async for message in socket:
                    told = json.loads(message.data)
                    if told.get("method") != "web.state":
                        continue
                    batches, size, batch = batches + 1, size + len(message.data), told["params"]
                    counts = {site["site"]: site["vehicles"] for site in batch.get("sites") or ()} or counts
                    names.update(vehicle["name"] for vehicle in batch["vehicles"])
                    names.update(row[0] for row in batch.get("brief") or ())
        await socket.close()
    small = len({name.rpartition("/")[0] for name in names})
    return {
        "sites": len(counts) or small,
        "vehicles": sum(counts.values()) or len(names),
        "batches_hz": round(batches / seconds, 2),
        "kb_per_s": round(size / seconds / 1000, 1),
    }


async def _order_all(path: Path) -> Found:
    """Hold, which vehicles on the ground take or refuse: each has one outcome."""
    began = time.monotonic()
    async with connect(path) as gcs:
        outcomes = await gcs.hold("*/all")
    results: dict[str, int] = {}
    for outcome in outcomes.values():
        said = f"{outcome['result']}: {outcome['message'][:80]}"
        results[said] = results.get(said, 0) + 1
    ok = sum(outcome["ok"] for outcome in outcomes.values())
    return {"outcomes": len(outcomes), "ok": ok, "results": results, "took_s": round(time.monotonic() - began, 2)}


def _children(pids: list[int]) -> list[int]:
    """Processes that these have started."""
    found = []
    for pid in pids:
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += [int(child) for child in (task / "children").read_text().split()]
    return found
