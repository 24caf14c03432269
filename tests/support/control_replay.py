"""Flight control run over a capture: what would have been sent, tick by tick, had the vehicle obeyed.

As a program it prints the digest: `python -m support.control_replay FILE SYSID SECONDS`, so that a test can have it
from another process, with other hashes and another memory.
"""

from __future__ import annotations

import hashlib
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.core.control.gains import UTIAS_XY, UTIAS_Z, ControlConfig
from skygcs.core.control.guard import ControlMode, GuardConfig, GuardFacts
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardController, OffboardState
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.tlog.reading import LogReader

TICK_S = 0.02
ROUND_TRIP_S = 0.03
STEP_EVERY_S = 8.0
STEP_DEG = 3e-5
"""3 m of latitude."""

TOLERANT = GuardConfig(attitude_delay_s=1.0, velocity_delay_s=5.0, stale_s=1.5, position_stale_s=5.0)
"""Captures tell positions at 1 to 4 Hz. Gaps longer than this fall back, which is to be replayed as well."""


class Obeyed(OffboardController):
    """Flies what flew otherwise: the guard is told that it obeys, and asked for everything else."""

    def _facts(self, *args: Any) -> GuardFacts:
        facts = super()._facts(*args)
        return replace(facts, following=True, armed=True, airborne=None, connected=True, attitude_refused=None)


class Replay:
    """``packed`` are the messages of all ticks, in order; ``names`` how many of each; ``leanings`` the attitude and
    thrust in each SET_ATTITUDE_TARGET: w, x, y, z, thrust."""

    def __init__(self, capture: bytes, sysid: int, seconds: float) -> None:
        self.packed: list[bytes] = []
        self.names: Counter[str] = Counter()
        self.leanings: list[tuple[float, ...]] = []
        self._dialect = load_dialect("ardupilotmega")
        self._vehicle = Vehicle(sysid, 1, self._dialect)
        law = ControlConfig(xy=UTIAS_XY, z=UTIAS_Z, hover_thrust=0.45)
        self._offboard = Obeyed(self._vehicle, OffboardConfig(law, TOLERANT))
        self._next_step_at = 0.0
        self._run(capture, sysid, seconds)

    @property
    def digest(self) -> str:
        return hashlib.sha256(b"".join(self.packed)).hexdigest()

    def _run(self, capture: bytes, sysid: int, seconds: float) -> None:
        due = 0.0
        for record in LogReader(capture, self._dialect):
            if record.at_s > seconds:
                break
            while due < record.at_s:
                self._tick(due)
                due += TICK_S
            frame = record.frame
            if frame is not None and frame.info is not None and (frame.sysid, frame.compid) == (sysid, 1):
                self._vehicle.on_frame(frame, record.at_s)

    def _tick(self, now: float) -> None:
        pilot = self._offboard
        position = self._vehicle.telemetry("position")
        if not self._vehicle.connected or position is None or position["lat_deg"] is None:
            return
        if pilot.state in (OffboardState.OFF, OffboardState.HELD):
            pilot.engage(ControlMode.ATTITUDE, None)
            pilot.entered()
            self._next_step_at = now
        if pilot.delay.due_ping(now):
            pilot.delay.on_pong(pilot.delay.ping(now - ROUND_TRIP_S), now)
        if now >= self._next_step_at:
            self._next_step_at += STEP_EVERY_S
            north = STEP_DEG if int(now / STEP_EVERY_S) % 2 else -STEP_DEG
            pilot.fly_to(
                GeodeticPosition(position["lat_deg"] + north, position["lon_deg"], position["alt_amsl_m"]), now % 3.0
            )
        message = pilot.tick(now).message
        if message is not None:
            name, values = message
            self.names[name] += 1
            self.packed.append(self._dialect.by_name[name].pack(values))
            if name == "SET_ATTITUDE_TARGET":
                self.leanings.append((*values["q"], values["thrust"]))


if __name__ == "__main__":
    print(Replay(Path(sys.argv[1]).read_bytes(), int(sys.argv[2]), float(sys.argv[3])).digest)
