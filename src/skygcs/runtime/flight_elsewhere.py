"""Flight by setpoints that another program makes and sends, to which the daemon relays the orders of control.

`OffboardEngagement` makes setpoints here. For a vehicle whose `ControlSettings.at` is an extension's, that extension
puts a `FlightElsewhere` in its place: both are asked the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import EnuFrame
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import TrajectoryClock
from skygcs.core.vehicle.flight_lock import FlightLock
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardState
from skygcs.core.vehicle.raw_setpoint import RawSetpoint
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, StartTube, TrajectoryFlight


class FlownBySetpoints(Protocol):
    """Flight by setpoints, which a newer order takes over: it holds the vehicle until that order has taken effect."""

    def hand_over(self, reason: str) -> None:
        """A newer order is about to be sent."""
        ...

    def taken_over(self) -> None:
        """The order has taken effect: send nothing more. Idempotent."""
        ...

    def keep(self, why: str) -> None:
        """The order did not take effect: go on holding. Idempotent."""
        ...


class ClockFigures(Protocol):
    """Figures of a control clock; see `ControlClock`."""

    ticks: int
    late: int
    skipped: int

    def lateness_p99_s(self) -> float | None: ...


class TrackingFigures(Protocol):
    """Measured figures of the tracking; see `TrackingRecord`."""

    tracking_error_m: float | None
    measured_s: float
    delay_s: float | None
    round_trips: int


class UplinkDelay(Protocol):
    """Delay of setpoints on their way up; None: it is not ours."""

    @property
    def uplink_s(self) -> float | None: ...


class ControlShown(Protocol):
    """Attributes of an `OffboardController` that the daemon reads."""

    config: OffboardConfig
    state: OffboardState
    wanted: ControlMode
    control_mode: ControlMode | None
    reasons: tuple[str, ...]
    frame: EnuFrame | None
    """The frame that ``flight`` is in."""
    flight: TrajectoryFlight | None

    @property
    def delay(self) -> UplinkDelay: ...
    @property
    def guard_falls(self) -> Mapping[str, int]: ...
    @property
    def active(self) -> bool:
        """True while it is, or is about to be, flown by setpoints."""
        ...

    @property
    def streaming(self) -> bool:
        """True while we stream setpoints to it."""
        ...

    @property
    def period_s(self) -> float: ...


class FlightElsewhere(Protocol):
    """The flight of one vehicle. The methods that `OffboardEngagement` has, too, are described there."""

    lock: FlightLock | None

    @property
    def sends_setpoints(self) -> bool:
        """True if the daemon itself sends them over its links."""
        ...

    @property
    def successor(self) -> str | None: ...
    @property
    def silent_after_s(self) -> float:
        """After so long without a sign of life it is not known whether the other program flies the vehicle."""
        ...

    @property
    def controller(self) -> ControlShown: ...
    @property
    def clock(self) -> ClockFigures: ...
    @property
    def tracking(self) -> TrackingFigures: ...
    @property
    def flying(self) -> bool: ...
    @property
    def may_send(self) -> bool:
        """True if another program's setpoints may still come to the vehicle, as far as is known."""
        ...

    @property
    def lead_s(self) -> float:
        """How long before its time an order to a clock must be given."""
        ...

    @property
    def reported(self) -> bool:
        """True if the other program has said what it does, since this daemon began."""
        ...

    def flown_by(self, now: float) -> str | None:
        """The other program, while it flies the vehicle and is in contact; None: it does not, or is silent."""
        ...

    def down_reason(self) -> str | None:
        """Why no order reaches the other program; None if it does."""
        ...

    # -- orders
    async def engage(self, control_mode: ControlMode, *, force: bool = False) -> Outcome: ...
    def release(self, reason: str) -> None: ...
    def hand_over(self, reason: str) -> None: ...
    def taken_over(self) -> None: ...
    def keep(self, why: str) -> None: ...
    def why_not_to(self, place: GeodeticPosition) -> str | None: ...
    async def fly_to(self, place: GeodeticPosition, yaw_enu_rad: float | None) -> Outcome: ...
    def follow(self, setpoint: Setpoint, valid_s: float) -> Outcome: ...
    def follow_raw(self, setpoint: RawSetpoint, valid_s: float) -> Outcome: ...
    def insist(self) -> None:
        """The next setpoint takes the vehicle over from clients of the other program's own."""
        ...

    async def change_gains(self, changes: Mapping[str, Any], *, force: bool = False) -> Outcome: ...
    def gains(self) -> dict[str, Any]: ...
    async def record(self, on: bool) -> str | None: ...

    # -- trajectories
    async def prepare(self, loaded: LoadedTrajectory) -> str | None: ...
    def trajectory_refusal(
        self, loaded: LoadedTrajectory, speed_factor: float, lock: FlightLock, tube: StartTube | None = None
    ) -> str | None: ...
    def follow_trajectory(
        self, loaded: LoadedTrajectory, clock: TrajectoryClock, lock: FlightLock
    ) -> TrajectoryFlight: ...

    # -- as frames and time come
    def on_timesync(self, frame: Frame, now: float) -> None: ...
    def on_text(self, text: str) -> None: ...
    def link_changed(self) -> None: ...
    def heard_again(self) -> None: ...
    def rate_set(self, name: str) -> None: ...
    def origin_changed(self) -> None: ...
    def watch(self, now: float) -> None: ...
    def status(self, now: float) -> dict[str, Any]: ...
    async def settled(self) -> None: ...
    def close(self, reason: str) -> None: ...
