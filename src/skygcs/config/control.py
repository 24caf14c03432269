"""The ``control`` table of a vehicle, a type or the defaults: how skygcs flies it by setpoints.

Every key is optional at every level; a key that no level sets has the default of `core.control`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field

from skygcs.config.tables import Model
from skygcs.core.control.analysis import LEAST_DELAY_S, why_not_delay
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.gains import LARGEST_GAIN, UTIAS_HOVER_THRUST, UTIAS_XY, UTIAS_Z, AxisGains, ControlConfig
from skygcs.core.control.guard import GuardConfig
from skygcs.core.control.velocity_predictor import ARDUCOPTER_LOOP, MAX_RATE_HZ, PX4_LOOP, why_not_predicted
from skygcs.core.geo import Origin
from skygcs.core.radio_link.capacity import FLOWN_HZ
from skygcs.core.trajectory import MotionLimits
from skygcs.core.vehicle.raw_setpoint import RawLimits
from skygcs.core.vehicle.trajectory_flight import TrajectoryLimits
from skygcs.errors import ConfigError

Gain = Annotated[float, Field(ge=0, le=LARGEST_GAIN)]
Seconds = Annotated[float, Field(gt=0, le=60)]
Span = Annotated[tuple[float, float], Field(description="[least, most] in metres")]

GROUND = "ground"
"""`ControlSettings.at` of vehicles whose setpoints this daemon makes."""

ATTITUDE_HZ, ATTITUDE_MIN_HZ = 50.0, FLOWN_HZ["attitude"]
VELOCITY_HZ, POSITION_HZ = FLOWN_HZ["velocity"], FLOWN_HZ["position"]
"""The defaults of `core.vehicle.offboard_controller.OffboardConfig`; a test compares them."""


ACC_XY_MAX_MPS2, ACC_Z_MAX_MPS2 = 2.0, 1.0
"""Less than an ArduCopter brakes with (2.5 m/s² across, 1 m/s² up and down), which has to stop it after a fall. With
2.5 across, and the link 0.5 s slower when it flies at 2.5 m/s, it goes 6.3 m beyond an 8 m step, with 2 half of that
(docs/explanation/control-law.md)."""


class GainSettings(Model):
    """Gains of one axis; see `core.control.gains.AxisGains`."""

    pos_p_per_s: Gain | None = None
    vel_p: Annotated[float, Field(ge=1e-3, le=LARGEST_GAIN)] | None = None
    vel_i: Gain | None = None
    vel_d: Gain | None = None


class ControlFenceSettings(Model):
    """The box about the fleet's origin that neither vehicle nor reference may leave while skygcs flies it."""

    x_m: Span | None = None
    y_m: Span | None = None
    up_m: Span | None = None
    margin_m: Annotated[float, Field(ge=0, le=100)] | None = None
    """References are refused this near to the fence already: 2."""


class RawSettings(Model):
    """Limits of the user's own controller (`control set raw`); see `core.vehicle.raw_setpoint.RawLimits`. A setpoint
    beyond one of them is refused."""

    tilt_max_deg: Annotated[float, Field(ge=1, le=80)] | None = None
    rate_max_deg_s: Annotated[float, Field(ge=1, le=1000)] | None = None
    thrust_min: Annotated[float, Field(ge=0, le=1)] | None = None
    thrust_max: Annotated[float, Field(ge=0, le=1)] | None = None
    acc_max_mps2: Annotated[float, Field(ge=0.1, le=30)] | None = None


class TrajectorySettings(Model):
    """Limits of trajectories that a vehicle may be sent along; see `core.vehicle.trajectory_flight.TrajectoryLimits`.
    Plans are timed by the speeds, acceleration and jerk; one that is not set has the default of `MotionLimits`
    there."""

    start_within_m: Annotated[float, Field(ge=0.1, le=100)] | None = None
    speed_mps: Annotated[float, Field(ge=0.01, le=100)] | None = None
    acceleration_mps2: Annotated[float, Field(ge=0.01, le=30)] | None = None
    climb_mps: Annotated[float, Field(ge=0.01, le=100)] | None = None
    descent_mps: Annotated[float, Field(ge=0.01, le=100)] | None = None
    jerk_mps3: Annotated[float, Field(ge=0.01, le=1000)] | None = None
    """Not limited unless it is set."""
    velocity_jump_mps: Annotated[float, Field(ge=0, le=100)] | None = None
    brake_mps2: Annotated[float, Field(ge=0.05, le=30)] | None = None


class ControlSettings(Model):
    """Settings of flight control; None: not set at this level."""

    rate_hz: Annotated[float, Field(ge=5, le=200)] | None = None
    """Attitude setpoints per second, default 50; the link's budget may leave fewer."""
    velocity_hz: Annotated[float, Field(ge=3, le=100)] | None = None
    """Velocity setpoints per second: 10. PX4 leaves OFFBOARD below 2."""
    position_hz: Annotated[float, Field(ge=3, le=50)] | None = None
    """Position setpoints per second: 5."""
    rate_min_hz: Annotated[float, Field(ge=2, le=50)] | None = None
    """Attitude is not flown with fewer setpoints per second than this: 20. Half a period is delay, too."""
    xy: GainSettings | None = None
    z: GainSettings | None = None
    hover_thrust: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Default: the autopilot's own (MPC_THR_HOVER, MOT_THST_HOVER), else 0.45."""
    thrust_min: Annotated[float, Field(ge=0, lt=1)] | None = None
    thrust_max: Annotated[float, Field(gt=0, le=1)] | None = None
    tilt_max_deg: Annotated[float, Field(gt=0, le=80)] | None = None
    vel_xy_max_mps: Annotated[float, Field(gt=0, le=100)] | None = None
    vel_z_max_mps: Annotated[float, Field(gt=0, le=100)] | None = None
    acc_xy_max_mps2: Annotated[float, Field(ge=0.1, le=100)] | None = None
    """How fast the velocity towards a far reference builds up, and what it brakes with before that: 2."""
    acc_z_max_mps2: Annotated[float, Field(ge=0.1, le=100)] | None = None
    """The same up and down: 1."""
    attitude_delay_s: Seconds | None = None
    velocity_delay_s: Seconds | None = None
    stale_s: Seconds | None = None
    position_stale_s: Seconds | None = None
    battery_min_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    return_after_s: Seconds | None = None
    """The ordered control mode is resumed when the cause of the fallback was absent for so long; default: never."""
    velocity_predictor: bool | None = None
    """Velocity control predicts the vehicle's state over the link's delay: false."""
    fence: ControlFenceSettings | None = None
    raw: RawSettings | None = None
    trajectory: TrajectorySettings | None = None
    at: str | None = None
    """Where the control loops run: here, which is "ground", or where an extension of the fleet file relays all orders
    of control to (`Extension.control_at`)."""
    engage_after_takeoff: Literal["off", "position", "velocity", "attitude"] | None = None
    """Control is engaged in this mode when a take-off that was ordered through skygcs has reached its height: "off"."""

    def over(self, lower: ControlSettings) -> ControlSettings:
        """These settings, completed key by key from ``lower``. Not checked: see `problems`."""
        merged: dict[str, Any] = {}
        for key in type(self).model_fields:
            mine, below = getattr(self, key), getattr(lower, key)
            if (
                isinstance(mine, GainSettings | ControlFenceSettings | RawSettings | TrajectorySettings)
                and below is not None
            ):
                given = {k: v for k, v in mine.model_dump().items() if v is not None}
                mine = below.model_copy(update=given)
            merged[key] = below if mine is None else mine
        return ControlSettings.model_construct(**merged)

    @property
    def attitude_period_s(self) -> float:
        return 1.0 / (self.rate_hz or ATTITUDE_HZ)

    def law(self, hover_thrust: float | None = None) -> ControlConfig:
        """The law's gains and limits; ``hover_thrust`` is what the autopilot reports. Raises ConfigError."""
        hover = self.hover_thrust or hover_thrust or UTIAS_HOVER_THRUST
        keys = ("thrust_min", "thrust_max", "vel_xy_max_mps", "vel_z_max_mps", "acc_xy_max_mps2", "acc_z_max_mps2")
        limits = {"acc_xy_max_mps2": ACC_XY_MAX_MPS2, "acc_z_max_mps2": ACC_Z_MAX_MPS2}
        limits |= {key: value for key in keys if (value := getattr(self, key)) is not None}
        if self.tilt_max_deg is not None:
            limits["tilt_max_rad"] = math.radians(self.tilt_max_deg)
        return ControlConfig(
            xy=_gains(UTIAS_XY, self.xy),
            z=_gains(UTIAS_Z, self.z),
            hover_thrust=hover,
            period_s=self.attitude_period_s,
            **limits,
        )

    def guard(self) -> GuardConfig:
        """Return what the guard watches."""
        keys = ("attitude_delay_s", "velocity_delay_s", "stale_s", "position_stale_s", "battery_min_percent")
        given = {key: value for key in (*keys, "return_after_s") if (value := getattr(self, key)) is not None}
        return GuardConfig(**given)

    def raw_limits(self) -> RawLimits:
        """Limits of the user's own controller. Raises ConfigError."""
        raw = self.raw or RawSettings()
        return RawLimits(**{key: value for key, value in raw.model_dump().items() if value is not None})

    def trajectory_limits(self) -> TrajectoryLimits:
        """Return what it may be sent along. Raises ConfigError."""
        given = (self.trajectory or TrajectorySettings()).model_dump()
        return TrajectoryLimits(**{key: value for key, value in given.items() if value is not None})

    def motion_limits(self) -> MotionLimits:
        """Within which a plan for it is timed."""
        keys = ("speed_mps", "acceleration_mps2", "jerk_mps3", "climb_mps", "descent_mps")
        settings = self.trajectory or TrajectorySettings()
        return MotionLimits(**{key: value for key in keys if (value := getattr(settings, key)) is not None})

    def fence_at(self, origin: Origin) -> Fence:
        """The box, standing on earth about this origin. Raises ConfigError."""
        fence = self.fence or ControlFenceSettings()
        given = {key: value for key in ControlFenceSettings.model_fields if (value := getattr(fence, key)) is not None}
        return Fence(origin, **given)

    def problems(self) -> list[tuple[tuple[str, ...], str]]:
        """Return what is impossible together though each key by itself is not: the path of a key in this table, and a
        text.

        For complete settings only (`over`): a key of one level may be valid only with one of another.
        """
        found = [
            *_problems((), self.law),
            *_problems((), self.guard),
            *_problems(("raw",), self.raw_limits),
            *_problems(("trajectory",), self.trajectory_limits),
            *_problems(("fence",), lambda: self.fence_at(Origin(0.0, 0.0, 0.0))),
        ]
        rate_hz, least_hz = self.rate_hz or ATTITUDE_HZ, self.rate_min_hz or ATTITUDE_MIN_HZ
        if rate_hz < least_hz:
            found.append((("rate_hz",), f"{rate_hz:g} is below rate_min_hz ({least_hz:g}): attitude is never flown"))
        return [*(found or self._delay_problems()), *self._predictor_problems()]

    def _delay_problems(self) -> list[tuple[tuple[str, ...], str]]:
        """Gains that do not bear the delay with which they may be flown. A limit that is not set is lowered in flight
        to what they bear (`OffboardEngagement`), unless that is less than links have. With a derivative gain no delay
        margin is known."""
        law = self.law()
        if law.xy.vel_d or law.z.vel_d:
            return []
        why = why_not_delay(law, LEAST_DELAY_S if self.attitude_delay_s is None else self.attitude_delay_s)
        if why is None:
            return []
        keys = ("attitude_delay_s", why[: why.index(":")], "hover_thrust")
        return [((next((key for key in keys if getattr(self, key) is not None), "xy"),), why)]

    def _predictor_problems(self) -> list[tuple[tuple[str, ...], str]]:
        """Rates and gains with which prediction is never flown. Gains are refused if neither autopilot's loop bears
        them over the least delay that links have; each vehicle's own delay is looked at in flight."""
        velocity_hz = self.velocity_hz or VELOCITY_HZ
        if not self.velocity_predictor:
            return []
        if velocity_hz > MAX_RATE_HZ:
            why = f"is above {MAX_RATE_HZ:g}: each setpoint under way is a step of it"
            return [(("velocity_hz",), f"{velocity_hz:g} with velocity_predictor {why}")]
        try:
            law = self.law()
        except ConfigError:
            return []  # `problems` says why
        delay_s = LEAST_DELAY_S + 0.5 / velocity_hz
        reasons = [why_not_predicted(law, loop, delay_s, 0.0) for loop in (PX4_LOOP, ARDUCOPTER_LOOP)]
        if None in reasons:
            return []
        key = next((key for key in ("xy", "z") if getattr(self, key) is not None), "velocity_predictor")
        return [((key,), f"{reasons[0]}; lower pos_p_per_s, or set velocity_predictor to false")]


def _problems(table: tuple[str, ...], make: Callable[[], object]) -> list[tuple[tuple[str, ...], str]]:
    """Problems that `core.control` finds; its texts begin with the keys they are about."""
    try:
        make()
    except ConfigError as error:
        parts = [problem.partition(": ") for problem in error.problems]
        return [((*table, *keys.split(", ")[0].split(".")), _about(keys, text)) for keys, _, text in parts]
    return []


def _about(keys: str, text: str) -> str:
    return f"{keys}: {text}" if "," in keys else text


def _gains(seed: AxisGains, settings: GainSettings | None) -> AxisGains:
    given = {} if settings is None else {k: v for k, v in settings.model_dump().items() if v is not None}
    return AxisGains(
        given.get("pos_p_per_s", seed.pos_p_per_s),
        given.get("vel_p", seed.vel_p),
        given.get("vel_i", seed.vel_i),
        given.get("vel_d", seed.vel_d),
    )
