"""Whether control ticks notice a plan: their lateness in a daemon that flies four simulated vehicles by attitude, with
and without plans of 100 vehicles being certified for a client, one after the other. As a ratio within one run.

python -m bench.plans.tick_lateness
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from skygcs.core.plan.fleet_plan import FlightSpace, TimedPlan
from skygcs.core.plan.plan_json import plan_content
from skygcs.core.plan.straight_flight import straight_trajectories
from skygcs.core.trajectory import MotionLimits
from support.process import FIELD_TOML, DaemonProcess, wait_until

FLEET_FILE = (
    FIELD_TOML
    + """[links.field]
type = "simulated"
px4 = 4
ardupilot = 0
"""
)
WINDOW_S = 11.0
"""The daemon's lateness is of the last 500 ticks: ten seconds at 50 Hz."""

ROUNDS = 3
VEHICLES = 100
NAMES = "v1,v2,v3,v4"


def measured() -> dict[str, Any]:
    """The p99 of the lateness, quiet and while plans are certified; medians of all rounds and vehicles."""
    quiet: list[float] = []
    planning: list[float] = []
    plans = 0
    with tempfile.TemporaryDirectory(prefix="skygcs-ticks-") as folder:
        daemon = DaemonProcess(Path(folder), FLEET_FILE)
        daemon.start()
        try:
            _fly(daemon)
            for _ in range(ROUNDS):
                time.sleep(WINDOW_S)
                quiet += _lateness(daemon)
                until = time.monotonic() + WINDOW_S
                while time.monotonic() < until:
                    answer = daemon.call("plan.certify", plan=_plan(), margin_m=2.5, others=False)
                    assert answer["certificate"]["vehicles"] == VEHICLES
                    plans += 1
                planning += _lateness(daemon)
            loaded = "numpy" in Path(f"/proc/{daemon.call('daemon.info')['pid']}/maps").read_text()
        finally:
            daemon.stop()
    return {
        "what": f"p99 of the lateness of control ticks while plans of {VEHICLES} vehicles are certified, over quiet",
        "quiet_ms": round(1e3 * median(quiet), 3),
        "planning_ms": round(1e3 * median(planning), 3),
        "ratio": round(median(planning) / median(quiet), 2),
        "plans": plans,
        "numpy_in_daemon": loaded,
    }


def _fly(daemon: DaemonProcess) -> None:
    wait_until(lambda: daemon.known() == 4, "four vehicles are known")
    for order, params in (("arm", {"wait_s": 60.0}), ("takeoff", {"height_m": 8.0})):
        outcomes = daemon.call(f"vehicles.{order}", targets=NAMES, **params)["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
    wait_until(lambda: all(_height_m(state) > 7.0 for state in daemon.call("vehicles.list")), "all are up")
    time.sleep(5.0)  # the take-off ends with a mode of its own
    outcomes = daemon.call("control.set", targets=NAMES, mode="attitude")["outcomes"]
    assert all(outcome["ok"] for outcome in outcomes.values()), outcomes


def _height_m(state: dict[str, Any]) -> float:
    return float(state["position"]["alt_rel_m"])


def _lateness(daemon: DaemonProcess) -> list[float]:
    return [float(of["lateness_p99_s"]) for of in daemon.call("control.status", targets=NAMES)]


def _plan() -> dict[str, Any]:
    """In ten rows, 30 m ahead."""
    starts = [(6.0 * (i % 10), 6.0 * (i // 10), 10.0) for i in range(VEHICLES)]
    ways = straight_trajectories(starts, [(x, y + 30.0, z) for x, y, z in starts], MotionLimits())
    plan = TimedPlan({f"p{i}": way for i, way in enumerate(ways)})
    content: dict[str, Any] = json.loads(json.dumps(plan_content(plan, FlightSpace())))
    return content


if __name__ == "__main__":
    print(json.dumps(measured(), indent=2))
