"""A socket that answers as a station's does, with made-up vehicles of several sites, for tests and figures of the page.

    python -m support.many_sites SOCKET [--sites 4] [--vehicles 250]

The vehicles of the first site are the station's own; all fly circles. Orders are accepted, and written beside the
socket (.orders), one JSON object a line; questions for their outcomes, too. The answer of v13 of another site to hold
is lost: the site is still busy with the order when it is asked for the first time, and then has carried it out.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import secrets
import time
from pathlib import Path
from typing import Any

SITES = ("north", "south", "east", "west", "hill", "lake", "wood", "moor")
APART_M = 400.0
CIRCLE_M, SPEED_MPS = 12.0, 4.0
SPACING_M = 20.0
LAT_DEG, LON_DEG, METRES_PER_DEG = 43.7806, -79.4653, 111_200.0
SLICE = 50
UNANSWERED = ("vehicles.hold", "/v13")


ACCEPTED = {"ok": True, "result": "accepted", "message": "accepted"}


def _lost(name: str) -> dict[str, Any]:
    """As `orders_sent` says it."""
    ident = f"{name.partition('/')[0]}/{secrets.token_hex(16)}"
    text = f"outcome unknown: no reply came; ask: skygcs-cli federation outcome {ident}"
    return {"ok": False, "result": "unknown", "message": text, "id": ident}


class UnknownMethod(Exception):
    """A method that these sites do not have: an answer of another shape would be a fault of the daemon's."""


class ManySites:
    """``sites`` of ``vehicles`` each."""

    def __init__(self, sites: int, vehicles: int, orders: Path) -> None:
        self.names = [
            (site, name if site == SITES[0] else f"{site}/{name}", n)
            for site in SITES[:sites]
            for n, name in ((n, f"v{n + 1}") for n in range(vehicles))
        ]
        self.orders = orders
        self._began = time.monotonic()
        self._asked: set[str] = set()

    def state(self, site: str, name: str, n: int) -> dict[str, Any]:
        t = time.monotonic() - self._began
        turn = t * SPEED_MPS / CIRCLE_M + n
        east0 = SITES.index(site) % 2 * APART_M + n % 16 * SPACING_M
        north0 = SITES.index(site) // 2 * APART_M + n // 16 * SPACING_M
        x, y, z = east0 + CIRCLE_M * math.cos(turn), north0 + CIRCLE_M * math.sin(turn), 10.0 + n % 7
        velocity = [-SPEED_MPS * math.sin(turn), SPEED_MPS * math.cos(turn), 0.0]
        flying, failsafe = n % 5 != 0, n == 3
        age_s = 0.05 if site == SITES[0] else 0.3
        position = {
            "age_s": age_s,
            "lat_deg": LAT_DEG + y / METRES_PER_DEG,
            "lon_deg": LON_DEG + x / METRES_PER_DEG / math.cos(math.radians(LAT_DEG)),
            "alt_amsl_m": 180.0 + z,
            "alt_rel_m": z,
            "heading_deg": (90 - math.degrees(turn + math.pi / 2)) % 360,
            "vel_enu_mps": velocity,
            "enu_m": [x, y, z],
            "vel_world_mps": velocity,
            "yaw_world_deg": math.degrees(turn + math.pi / 2),
            "origin_generation": 1 if site == SITES[0] else None,
        }
        return {
            "name": name,
            "sysid": n % 250 + 1,
            "compid": 1,
            "autopilot": "px4" if n % 2 else "ardupilot",
            "type": "QUADROTOR",
            "groups": ["scouts"] if n % 10 == 0 else [],
            "connected": True,
            "last_heartbeat_age_s": age_s,
            "armed": flying,
            "mode": "AUTO.LOITER" if n % 2 else "GUIDED",
            "system_status": "active",
            "landed": "in_air" if flying else "on_ground",
            "failsafe": failsafe,
            "position": position,
            "battery": {"age_s": age_s, "volts": 15.1, "amps": 9.0, "percent": 90 - n % 60, "remaining_s": None},
            "links": {"radio": {"frames": 1, "lost": 0, "loss_ratio": 0.0, "age_s": age_s}} if site == SITES[0] else {},
        }

    def answer(self, method: str, params: dict[str, Any]) -> Any:
        match method:
            case "daemon.info":
                return {"now_s": time.monotonic(), "fleet_file": "many.toml", "operator_timeout_s": None}
            case "federation.sites":
                return {"site": SITES[0], "role": "site", "hub": {"connected": True}, "sites": []}
            case "origin.get":
                return {"origin": {"lat_deg": LAT_DEG, "lon_deg": LON_DEG, "alt_amsl_m": 180.0, "x_heading_deg": 90.0}}
            case "events.recent" | "links.list" | "link.status":
                return []
            case "vehicles.get":
                return next(self.state(*each) for each in self.names if each[1] == params["target"])
            case "operator.relay" | "operator.active" | "unsubscribe":
                return None
        if method == "federation.outcome":
            self._keep(method, params)
            return self._outcome(params["id"])
        if method.startswith("vehicles."):
            self._keep(method, params)
            targets = params["targets"]
            names = targets if isinstance(targets, list) else [name for _, name, _ in self.names]
            lost = [name for name in names if method == UNANSWERED[0] and name.endswith(UNANSWERED[1])]
            return {"outcomes": {name: _lost(name) if name in lost else ACCEPTED for name in names}}
        raise UnknownMethod(method)

    def _keep(self, method: str, params: dict[str, Any]) -> None:
        with self.orders.open("a") as file:
            file.write(json.dumps({"method": method, **params}) + "\n")

    def _outcome(self, ident: str) -> dict[str, Any]:
        done = ident in self._asked
        self._asked.add(ident)
        status, text = ("done", "") if done else ("running", "still being carried out")
        return {"id": ident, "status": status, "text": text, "outcome": ACCEPTED if done else None, "answered": True}

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        feeding: set[asyncio.Task[None]] = set()
        try:
            while line := await reader.readline():
                request = json.loads(line)
                method, params = request["method"], request.get("params", {})
                if method == "subscribe":
                    number = request["id"]
                    answer: Any = {"result": {"subscription": number, "now_s": time.monotonic()}}
                    if params["topic"] == "telemetry":
                        feeding.add(asyncio.create_task(self._feed(writer, number, params["rate_hz"])))
                else:
                    try:
                        answer = {"result": self.answer(method, params)}
                    except UnknownMethod:
                        answer = {"error": {"code": -32601, "message": f"no method {method}"}}
                if "id" in request:
                    _write(writer, {"jsonrpc": "2.0", "id": request["id"], **answer})
        except (ConnectionError, asyncio.IncompleteReadError):
            pass
        finally:
            for task in feeding:
                task.cancel()
            writer.close()

    async def _feed(self, writer: asyncio.StreamWriter, number: int, rate_hz: float) -> None:
        while not writer.is_closing():
            for n, each in enumerate(self.names, 1):
                params: dict[str, Any] = {"state": self.state(*each), "subscription": number}
                if n == len(self.names):
                    params["last"] = True
                _write(writer, {"jsonrpc": "2.0", "method": "telemetry", "params": params})
                if n % SLICE == 0:
                    await writer.drain()
                    await asyncio.sleep(0)
            await asyncio.sleep(1 / rate_hz)


def _write(writer: asyncio.StreamWriter, message: dict[str, Any]) -> None:
    writer.write(json.dumps(message, separators=(",", ":")).encode() + b"\n")


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("socket", type=Path)
    parser.add_argument("--sites", type=int, default=4)
    parser.add_argument("--vehicles", type=int, default=250)
    options = parser.parse_args()
    station = ManySites(options.sites, options.vehicles, options.socket.with_suffix(".orders"))
    server = await asyncio.start_unix_server(station.serve, options.socket, limit=1 << 20)
    async with server:
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main())
