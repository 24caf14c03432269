"""The gate through which every request, command and setpoint of nodes goes: may it still be carried out?

    it waited in a process of ROS     through a sleep, a standstill or a long turn (``is_awake``): late
    it was long under way             by the stamp of its computer, or to the process of rospy (`LATE`): late
    it ends a flight                  never late (`ending_orders`)

It is asked once, before anything is done with a request. What its handler orders has a deadline besides
(`order_connection`), because handlers wait as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextvars import ContextVar
from typing import Any

from skygcs.ext.ros.ending_orders import request_ends_flight

LATE: ContextVar[str | None] = ContextVar("late", default=None)
"""Why the request that the task carries out came late, as its node found; None: it did not find that."""

WAITED = "it waited while the process of ROS stood still, or was busy for more than a second"


class LateGate:
    """``is_awake()``: False while what is read may have waited in this process."""

    def __init__(self, is_awake: Callable[[], bool]) -> None:
        self._is_awake = is_awake

    def refusal(self, name: str, fields: Mapping[str, Any]) -> str | None:
        """Why a request or message of this name must not be carried out any more; None: it may."""
        late = LATE.get() if self._is_awake() else WAITED
        return None if late is None or request_ends_flight(name, fields) else late
