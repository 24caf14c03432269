"""A fake daemon whose vehicles can be controlled: gains, setpoints, and places they fly to.

As a process, for the command line: python -m support.controlled SOCKET
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from skygcs.core.geo import Origin
from skygcs.rpc.server import RpcServer
from support.command_line import Served
from support.fake_daemon import NAMES, FakeDaemon, FakeFleet, FakeOutcome, FakeVehicle

TAKEN = FakeOutcome(True, "accepted", "taken", attempts=0, elapsed_s=0.0)
OFF: dict[str, Any] = {
    "mode": None,
    "control_mode": None,
    "state": "off",
    "reasons": [],
    "successor": None,
    "reference": None,
    "error_enu_m": None,
    "error_m": None,
    **dict.fromkeys(("state_age_s", "delay_p95_s", "rtt_s", "rate_hz", "lateness_p99_s", "thrust"), None),
    **dict.fromkeys(("roll_deg", "pitch_deg", "recording"), None),
    **dict.fromkeys(("ticks", "late", "skipped"), 0),
    "raw": None,
    "stream": None,
    "setpoints_refused": 0,
    "trajectory": None,
    "prediction": None,
    "saturation": [],
    "integral_enu": [0.0, 0.0, 0.0],
}
FLYING: dict[str, Any] = {
    **OFF,
    "mode": "attitude",
    "control_mode": "attitude",
    "state": "flying",
    "reference": {"pos_enu_m": [1.0, 2.0, 5.0], "vel_enu_mps": [0.0, 0.0, 0.0], "yaw_deg": 90.0},
    "error_enu_m": [0.3, -0.4, -0.001],
    "error_m": 0.5,
    "state_age_s": 0.085,
    "delay_p95_s": 0.0912,
    "rtt_s": 0.012,
    "rate_hz": 50.0,
    "ticks": 12345,
    "late": 2,
    "skipped": 1,
    "thrust": 0.46,
    "roll_deg": 1.4,
    "pitch_deg": -3.2,
    "saturation": ["tilt"],
}


class ControlledVehicle(FakeVehicle):
    """Flies three quarters of its way between two looks; takes setpoints until ``refuses`` says why not."""

    def __init__(self, sysid: int, name: str) -> None:
        super().__init__(sysid, name, "px4", ())
        self.position_m: list[float] | None = [10.0 * sysid, 0.0, 5.0]
        self.goal_m: Sequence[float] | None = None
        self.stuck = False
        self.no_frame = False
        self.control_told: dict[str, Any] = OFF
        self.gains_told: dict[str, Any] = {
            "xy": {"pos_p_per_s": 0.95, "vel_p": 0.08, "vel_i": 0.02, "vel_d": 0.0},
            "z": {"pos_p_per_s": 1.0, "vel_p": 0.3, "vel_i": 0.02, "vel_d": 0.0},
            "hover_thrust": 0.45,
            "limits": {"thrust_min": 0.1, "thrust_max": 0.9},
        }
        self.offboard.gains = lambda: self.gains_told
        self.offboard.record = self._record
        self.setpoints: list[dict[str, Any]] = []
        self.on_setpoint: Callable[[], None] | None = None
        self.aloud = False
        """Prints what it is told, for a test in another process to wait for."""
        self.refuses: str | None = None
        self.refuses_after: int | None = None
        """Takes so many setpoints before."""

    @property
    def vehicle(self) -> Any:
        """As much of it as planning asks for."""
        place = None if self.no_frame else self.position_m
        return SimpleNamespace(
            replayed=False, enu_m=lambda: place, telemetry_at=lambda _: time.monotonic(), in_air=lambda now: True
        )

    async def goto(self, **place: Any) -> FakeOutcome:
        outcome = await self._order("goto", **place)
        if outcome.ok and not self.stuck:
            self.goal_m = place["enu_m"]
        self._say("goto")
        return outcome

    def _say(self, word: str) -> None:
        if self.aloud:
            print(self.name, word, flush=True)

    async def change_gains(self, *, changes: dict[str, Any], force: bool) -> FakeOutcome:
        outcome = await self._order("change_gains", changes=changes, force=force)
        if outcome.ok:
            for key, value in changes.items():
                new = {**self.gains_told[key], **value} if isinstance(value, dict) else value
                self.gains_told = {**self.gains_told, key: new}
        return outcome

    def control_state(self, now: float) -> dict[str, Any]:
        return self.control_told

    async def _record(self, on: bool) -> str | None:
        return f"/logs/{self.name}.csv" if on else None

    def take(self, setpoint: dict[str, Any]) -> FakeOutcome:
        refuses = self.refuses
        if self.refuses_after is not None and len(self.setpoints) < self.refuses_after:
            refuses = None
        if refuses is not None:
            return replace(TAKEN, ok=False, result="refused", message=refuses)
        self.setpoints.append(setpoint)
        self._say("setpoint")
        if self.on_setpoint is not None:
            self.on_setpoint()
        return TAKEN

    def whole_state(self, now: float) -> dict[str, Any]:
        state = super().whole_state(now)
        if self.goal_m is not None and self.position_m is not None:
            self.position_m = [p + (g - p) * 0.75 for p, g in zip(self.position_m, self.goal_m, strict=True)]
        enu_m = None if self.no_frame else self.position_m
        state["position"] = None if self.position_m is None else {**state["position"], "enu_m": enu_m}
        state["control"] = self.control_told
        return state


class ControlledFleet(FakeFleet):
    def __init__(self, vehicles: Sequence[FakeVehicle]) -> None:
        super().__init__(vehicles)
        self.origin = Origin(43.7806, -79.4653, 180.0)

    def setpoint(self, targets: str | list[str], client: object, /, **setpoint: Any) -> dict[str, FakeOutcome]:
        vehicles = [v for v in self.resolve(targets) if isinstance(v, ControlledVehicle)]
        given = {k: x for k, x in setpoint.items() if x is not None and not (k == "take_over" and x is False)}
        return {v.name: v.take(given) for v in vehicles}


class Commanded(Served[FakeDaemon]):
    """Its three vehicles are under control."""

    def __init__(self, folder: Path) -> None:
        daemon = FakeDaemon()
        self.vehicles = {name: ControlledVehicle(i, name) for i, name in enumerate(NAMES, 1)}
        daemon.fleet = ControlledFleet(list(self.vehicles.values()))
        super().__init__(folder, daemon)

    def stop_soon(self) -> None:
        """For a vehicle to end its daemon in mid-stream."""
        self.loop.call_soon(lambda: asyncio.ensure_future(self.server.close()))


async def serve(path: str) -> None:
    """Until it is killed; says on stdout who was told to go, and of every setpoint."""
    daemon = FakeDaemon()
    vehicles = [ControlledVehicle(i, name) for i, name in enumerate(NAMES, 1)]
    for vehicle in vehicles:
        vehicle.aloud = True
    daemon.fleet = ControlledFleet(vehicles)
    server = RpcServer(daemon, path)
    await server.start()
    print("ready", flush=True)
    try:
        await asyncio.Event().wait()
    finally:
        await server.close()


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1]))
