"""Watches the take-offs of one vehicle: an alarm if one leads to a wrong height, control by setpoints after it
(engage_after_takeoff), and what waits for its end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Coroutine
from typing import Any

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.takeoff_watch import TakeoffWatch, WrongHeight, reports_takeoff
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.command_client import SUPERSEDED
from skygcs.runtime.order_runner import OrderRunner
from skygcs.runtime.task_set import TaskSet

KIND = "takeoff"

LOOK_S = 0.2

LEAVES = frozenset({"AUTO.TAKEOFF", "AUTO.LOITER", "GUIDED", "TAKEOFF"})
"""Modes that a take-off leaves a vehicle in (`core.vehicle.takeoff_watch`)."""

NOT_ORDERED_S = 60.0
"""Longest wait for a take-off that was not ordered here, and whose height is not known."""


class Takeoffs:
    """``control_mode``: of the fleet file; "off": no control is ever begun."""

    def __init__(
        self,
        vehicle: Vehicle,
        control_mode: str,
        orders: OrderRunner,
        engage: Callable[[str], Coroutine[Any, Any, Outcome]],
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
    ) -> None:
        self._vehicle = vehicle
        self._control_mode = control_mode
        self._orders = orders
        self._engage = engage
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event, vehicle.name, vehicle.sysid)
        self._watch: TakeoffWatch | None = None
        """Watch over the take-off under way."""
        self._ended_by: str | None = None
        """Reason why the last take-off ended early; None: it reached its height."""
        self._over = asyncio.Event()
        """No take-off is watched."""

    def begin(self, outcome: Outcome, from_amsl_m: float | None, height_m: float, *, engage: bool) -> None:
        """Watch a take-off that has this outcome. ``engage``: begin control at its end, if the fleet file says so. The
        watch over one before goes on if the vehicle has refused this one."""
        number = outcome.order_number
        if number is not None and self._orders.ledger.effective >= number:
            self.cancel()
        if not outcome.ok or from_amsl_m is None:
            return
        self._watch = watch = TakeoffWatch(self._vehicle, from_amsl_m, height_m, self._loop.time())
        self._ended_by = SUPERSEDED
        self._over.clear()
        control_mode = self._control_mode if engage else "off"
        number = self._orders.ledger.effective if number is None else number
        self._tasks.start(self._follow(watch, number, control_mode), "watch of the take-off")

    def cancel(self) -> None:
        """Watch no more: something else was ordered, or the daemon ends. Idempotent."""
        self._watch = None
        self._over.set()
        self._tasks.close()

    def under_way(self) -> str | None:
        """A take-off under way, in words; None: there is none."""
        if self._watch is not None:
            return f"it is taking off ({self._watch.progress()})"
        return "it reports a take-off" if reports_takeoff(self._vehicle, self._loop.time()) else None

    async def ended(self) -> str | None:
        """Wait until no take-off is under way, and the control that begins after it has begun. Returns None, or why
        what waited for that must not go on: a newer order came, or the take-off did not end as it was ordered."""
        if self._watch is not None:
            await self._over.wait()
            return self._ended_by
        number, until = self._orders.ledger.effective, self._loop.time() + NOT_ORDERED_S
        mode = self._vehicle.mode
        while reports_takeoff(self._vehicle, self._loop.time()):
            await asyncio.sleep(LOOK_S)
            if self._orders.ledger.effective > number:
                return SUPERSEDED
            if self._loop.time() > until:
                return "it still reports a take-off, which was not ordered here"
        return self._switched({mode})

    def _switched(self, expected: Collection[str]) -> str | None:
        """Why a take-off is over: the vehicle was switched to another mode than a take-off leaves it in, or one of
        these."""
        mode = self._vehicle.mode
        return None if mode in LEAVES or mode in expected else f"it was switched to {mode} during its take-off"

    async def _follow(self, watch: TakeoffWatch, number: int, control_mode: str) -> None:
        try:
            # while another order is being sent, which it may refuse, nothing is judged
            while self._orders.ledger.in_progress or (verdict := watch.look(self._loop.time())) == "climbs":
                await asyncio.sleep(LOOK_S)
                if self._orders.ledger.effective > number:
                    return  # another order came: what it wants is flown
            if verdict != "reached":
                self._ended_by = f"its take-off did not end as it was ordered: {verdict}"
                self._report(verdict, control_mode)
                return
            begun = None if control_mode == "off" else await self._engage(control_mode)
            if begun is None or begun.result != "cancelled":
                self._ended_by = self._switched({"OFFBOARD"} if begun is not None and begun.ok else ())
        finally:
            if self._watch is watch:
                self._watch = None
                self._over.set()

    def _report(self, verdict: WrongHeight | str, control_mode: str) -> None:
        vehicle = self._vehicle
        if isinstance(verdict, WrongHeight):
            data = {"height_m": round(verdict.height_m, 2), "wanted_m": verdict.wanted_m}
            self._on_event(Event(KIND, vehicle.name, vehicle.sysid, f"its take-off is wrong: {verdict}", data))
        if control_mode != "off":
            text = f"control is not engaged after the take-off: {verdict}"
            self._on_event(Event("control", vehicle.name, vehicle.sysid, text, {"state": "off"}))
