"""The parts that only radios need: the plan of their streams, and reports of what they do not carry of other programs.

They are imported with the daemon if its fleet file has a radio, else at the first tick that finds a channel into one;
before it there is nothing to plan or report.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from skygcs.config.models import FleetConfig
from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.link_view import LinkWatch

if TYPE_CHECKING:  # see above
    from skygcs.runtime.admission_reports import AdmissionReports
    from skygcs.runtime.air_planner import AirPlanner


class Radios:
    """Call `tick` once a second and `step` some ten times a second."""

    def __init__(
        self, config: FleetConfig, hub: Hub, fleet: Fleet, watch: LinkWatch, on_event: Callable[[Event], None]
    ) -> None:
        self._own = config.daemon
        self._hub = hub
        self._fleet = fleet
        self._watch = watch
        self._on_event = on_event
        self._selected: set[int] = set()
        self._planner: AirPlanner | None = None
        self._reports: AdmissionReports | None = None
        if any(link.role == "radio" or link.type == "xbee" for link in config.links.values()):
            self._make()

    def tick(self, now: float) -> None:
        """Plan anew after changes, and report what was not carried since the last call."""
        if self._planner is None and any(c.air is not None or c.link.shares_air for c in self._hub.channels.values()):
            self._make()
        if self._planner is not None and self._reports is not None:
            self._reports.tick(now)
            self._planner.tick(now)

    def step(self, now: float) -> None:
        """Send requests for planned rates."""
        if self._planner is not None:
            self._planner.step(now)

    def select(self, keys: set[int]) -> None:
        """Give these vehicles, and no others, higher rates from now on."""
        self._selected = keys
        if self._planner is not None:
            self._planner.select(keys)

    def status(self, now: float) -> list[dict[str, Any]]:
        """Every radio with a budget: uplink and downlink, its vehicles, its history."""
        return [] if self._planner is None else self._planner.status(now)

    def radios(self, now: float) -> list[dict[str, Any]]:
        """`status` without the single vehicles, what others send, and the history."""
        return [] if self._planner is None else self._planner.radios(now)

    def _make(self) -> None:
        from skygcs.runtime.admission_reports import AdmissionReports
        from skygcs.runtime.air_planner import AirPlanner

        dialect = self._hub.dialect
        self._reports = AdmissionReports(self._hub, self._own, dialect, self._on_event)
        self._planner = AirPlanner(self._hub, self._fleet, self._watch, dialect, self._on_event)
        self._planner.select(self._selected)
