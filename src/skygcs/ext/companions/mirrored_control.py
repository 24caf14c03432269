"""The companion's control as the ground shows it: state, control mode, flight and gains, from its reports. Pure.

    what comes                                       state here                reasons
    ----------------------------------------------   -----------------------   --------------------------------------
    report, newer than all orders given              as reported               as reported
    report made before the newest order was known    as it was                 as they were
    outcome of an order                              as reported beside it     as reported
    `release` on the ground                          off at once               the release's
    no report for `REPORTS_SILENT_S`                 as it was last            "the companion has not answered for ..."
    … and the autopilot shows another mode           off                       the mode
    another session of the companion                 off                       it has restarted

It has the attributes of an `OffboardController` that other parts of the ground read.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import EnuFrame
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardState
from skygcs.core.vehicle.trajectory_flight import TrajectoryFlight

REPORTS_SILENT_S = 3.0
"""Reports come twice a second; as long as a plan waits for a position (`execution.POSITION_SILENT_S`)."""

MAX_TEXT = 500
LARGEST_FIGURE = 1e15
"""Largest figure accepted: whole numbers of JSON have no end, and floats do."""

MAX_REASONS = 8


@dataclass(slots=True)
class MirroredClock:
    """Figures of the companion's control clock."""

    ticks: int = 0
    late: int = 0
    skipped: int = 0
    p99_s: float | None = None

    def lateness_p99_s(self) -> float | None:
        """The 99th percentile."""
        return self.p99_s


@dataclass(slots=True)
class MirroredTracking:
    """Measurements of its tracking by the companion; see `TrackingRecord`."""

    tracking_error_m: float | None = None
    measured_s: float = 0.0
    delay_s: float | None = None
    round_trips: int = 0


@dataclass(frozen=True, slots=True)
class MirroredDelay:
    """The ground's setpoints have no uplink: they are made at the companion."""

    uplink_s: float | None = None


class MirroredControl:
    """The control of one vehicle. ``config`` is the fleet file's, of the ground."""

    def __init__(self, config: OffboardConfig) -> None:
        self.config = config
        self.state = OffboardState.OFF
        self.wanted = ControlMode.POSITION
        self.control_mode: ControlMode | None = None
        self.reasons: tuple[str, ...] = ()
        self.successor: str | None = None
        """The order that takes over from its setpoints, as the companion reports it."""
        self.frame: EnuFrame | None = None
        """The frame that ``flight`` is in."""
        self.flight: TrajectoryFlight | None = None
        self.delay = MirroredDelay()
        self.guard_falls: Counter[str] = Counter()
        self.clock = MirroredClock()
        self.tracking = MirroredTracking()
        self.gains: dict[str, Any] | None = None
        """The answer of the companion's control.gains; None before the first report."""
        self.session: str | None = None
        """The run of the companion's daemon."""
        self.reported_at = -math.inf
        """The ground's clock when the newest report had been made, at the latest."""
        self.section: dict[str, Any] = {}
        """The control section of the newest report."""
        self.unconfirmed = False
        """True if the companion may not know of a release yet."""
        self._made_s = -math.inf
        """The companion's clock when the newest report was made."""
        self._flight_number: int | None = None
        self._ordered = 0
        """The newest order that moves the vehicle and that a report has to know to count."""

    @property
    def active(self) -> bool:
        """True if it is, or is about to be, flown by setpoints."""
        return self.state in (OffboardState.FLYING, OffboardState.ENGAGING)

    @property
    def streaming(self) -> bool:
        """The ground never streams to it."""
        return False

    @property
    def period_s(self) -> float:
        """The period of the companion's ticks as configured."""
        config = self.config
        rates = {
            ControlMode.POSITION: config.position_hz,
            ControlMode.VELOCITY: config.velocity_hz,
        }
        return 1.0 / rates.get(self.control_mode or self.wanted, config.attitude_hz)

    # -- what the ground does

    def release(self, number: int, reason: str) -> None:
        """Control was ended here; reports that do not know this order do not count."""
        self._ordered = max(self._ordered, number)
        self.unconfirmed = True
        self._off(reason)

    def follow(self, flight: TrajectoryFlight, frame: EnuFrame, number: int) -> None:
        """Note that the order with this number begins a trajectory."""
        self.flight, self.frame, self._flight_number = flight, frame, number

    def end_flight(self, now: float) -> None:
        """A trajectory whose clock has come to its end is over here before the companion reports it."""
        if self.flight is not None and self.flight.over(now):
            self.flight, self._flight_number = None, None

    def drop_flight(self, why: str) -> None:
        """It does not follow its trajectory after all."""
        if self.flight is not None:
            self.flight, self._flight_number, self.reasons = None, None, (why[:MAX_TEXT],)

    # -- what the companion reports

    def take(self, report: Mapping[str, Any], now: float) -> tuple[str, ...]:
        """One report of the companion, of whatever content; texts of what has changed by itself."""
        made_s, session = report.get("now_s"), report.get("session")
        if not isinstance(session, str) or not isinstance(made_s, int | float) or not abs(made_s) <= LARGEST_FIGURE:
            return ()
        found: list[str] = []
        if session != self.session:
            if self.session is not None and self.state is not OffboardState.OFF:
                found.append("control ended: the companion's skygcs has restarted")
            self._off("the companion's skygcs has restarted" if self.session is not None else "")
            self.session, self._made_s, self._ordered = session, -math.inf, 0
            self.unconfirmed = False
        if not made_s > self._made_s:
            return tuple(found)
        self._made_s, self.reported_at = float(made_s), now
        self._take_figures(report)
        newest = report.get("newest")
        if isinstance(newest, int) and newest >= self._ordered:
            found += self._take_state(report, newest)
        return tuple(found)

    def silent_s(self, now: float) -> float | None:
        """How long no report has come, if that is too long; None: it is heard, or never was."""
        age_s = now - self.reported_at
        return age_s if REPORTS_SILENT_S < age_s < math.inf else None

    def watch(self, now: float, *, follows: bool, mode: str) -> tuple[str, ...]:
        """Watch the silence. ``follows``: the autopilot shows the mode of setpoints; ``mode``: the one it shows."""
        self.end_flight(now)
        silent_s = self.silent_s(now)
        if silent_s is None or self.state is OffboardState.OFF:
            return ()
        text = f"the companion has not answered for {silent_s:.0f} s"
        if not follows:
            self._off(f"{text}, and the autopilot is in {mode}")
            return (f"control ended: {self.reasons[0]}",)
        if self.flight is not None:
            self.drop_flight(text)
            return (f"{text}: what it flies is not known",)
        self.reasons = (text,)
        return ()

    def _off(self, reason: str) -> None:
        self.state, self.control_mode = OffboardState.OFF, None
        self.flight, self._flight_number, self.successor = None, None, None
        self.reasons = (reason[:MAX_TEXT],) if reason else ()

    def _take_state(self, report: Mapping[str, Any], newest: int) -> list[str]:
        self.unconfirmed = False
        section = report.get("control")
        section = section if isinstance(section, dict) else {}
        self.section = section
        state = _member(OffboardState, section.get("state")) or OffboardState.OFF
        before, self.state = self.state, state
        self.wanted = _member(ControlMode, section.get("mode")) or self.wanted
        mode_before, self.control_mode = self.control_mode, _member(ControlMode, section.get("control_mode"))
        reasons, successor = section.get("reasons"), section.get("successor")
        self.successor = None if successor is None else str(successor)[:MAX_TEXT]
        texts = [str(text)[:MAX_TEXT] for text in reasons[:MAX_REASONS]] if isinstance(reasons, list) else []
        if texts or state is not OffboardState.OFF or before is not OffboardState.OFF:
            self.reasons = tuple(texts)
        began = self._flight_number is not None and newest >= self._flight_number
        if began and report.get("flight") != self._flight_number:
            self.flight, self._flight_number = None, None
        why = f": {'; '.join(self.reasons)}" if self.reasons else ""
        if state is not before and state in (OffboardState.OFF, OffboardState.HELD):
            return [f"control ended{why}" if state is OffboardState.OFF else f"holding, nothing more is sent{why}"]
        if mode_before is not None and self.control_mode not in (None, mode_before):
            return [f"flown by {self.control_mode} setpoints{why}"]
        return []

    def _take_figures(self, report: Mapping[str, Any]) -> None:
        gains, section, tracking = report.get("gains"), report.get("control"), report.get("tracking")
        if isinstance(gains, dict):
            self.gains = gains
        if isinstance(section, dict):
            self.clock.ticks = _count(section.get("ticks"))
            self.clock.late = _count(section.get("late"))
            self.clock.skipped = _count(section.get("skipped"))
            self.clock.p99_s = _figure(section.get("lateness_p99_s"))
        if isinstance(tracking, dict):
            self.tracking.tracking_error_m = _figure(tracking.get("tracking_error_m"))
            self.tracking.measured_s = _figure(tracking.get("measured_s")) or 0.0
            self.tracking.delay_s = _figure(tracking.get("delay_s"))
            self.tracking.round_trips = _count(tracking.get("round_trips"))
        falls = report.get("guard_falls")
        if isinstance(falls, dict):
            self.guard_falls = Counter({str(to)[:20]: _count(n) for to, n in list(falls.items())[:8]})


def _member(kind: type[Any], value: object) -> Any:
    """The member of an enumeration of texts; None if no member has this value."""
    return next((member for member in kind if member.value == value), None)


def _count(value: object) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else 0


def _figure(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= LARGEST_FIGURE:
        return None
    return float(value)
