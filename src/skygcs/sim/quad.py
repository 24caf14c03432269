"""A rigid quadrotor: thrust along its own axis, an attitude that follows with a lag, drag against moving air.

    attitude setpoint ─> closed attitude loop (lag, rate limits) ──┐
    thrust setpoint ──> motors (lag, saturation, battery) ──────────┴─> force + gravity + drag ─> velocity ─> position

The inner attitude loop is the autopilot's; it is taken as closed, and what is left of it is its lag. The tilt has
priority over the yaw, as in both firmwares. Position and velocity setpoints are flown by `steering`.
Measured on one desktop core (CPython 3.11): 13 µs a tick under an attitude setpoint, 23 µs under a position.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan2, copysign, cos, exp, hypot, inf, radians, sin, sqrt

from skygcs.core.geo import quaternion_from_euler, quaternion_product
from skygcs.sim.body import GRAVITY_MPS2, AccelerationSetpoint, AttitudeSetpoint, Body, Quaternion, Vector, turned_by
from skygcs.sim.kinematics import Limits, Setpoint
from skygcs.sim.steering import Steering
from skygcs.sim.wind import Wind

SUB_STEPS = 2
"""Sub-steps of a tick of 20 ms. Halving the sub-step moves no point of a 3 m step by 1 cm (test_sim_quad)."""


RATE_LAG = 0.3
"""The rate loop's lag as a share of the attitude loop's, which it is a part of (PX4's MC_ROLL_P 6.5 is 0.15 s)."""

RATE_MAX_RADPS = radians(720)
YAW_RATE_MAX_RADPS = radians(200)
"""Body rates that motors of this size reach; yaw as PX4's MC_YAWRATE_MAX."""


@dataclass(frozen=True, slots=True)
class Airframe:
    """Airframe of a quadrotor. The defaults are the UTIAS lab's F450; lags of 0 and no drag make it ideal."""

    mass_kg: float = 1.2
    """Take-off weight in section 2.1 of the UTIAS report."""
    hover_thrust: float = 0.45
    """Normalised thrust that carries the weight at ``nominal_v``; px4_command's Hover_throttle for the F450."""
    attitude_lag_s: float = 0.15
    """Time constant of the closed attitude loop; 0: the attitude is the setpoint."""
    thrust_lag_s: float = 0.05
    """Time constant of motors and propellers; 0: none."""
    drag_linear_n_per_mps: float = 0.18
    """Rotor drag, 0.15/s of speed."""
    drag_quadratic_n_per_mps2: float = 0.024
    """Air 1.2 kg/m³ against 0.04 m² of frame. With the linear part: 15 m/s at 35° of tilt."""
    tilt_rate_max_radps: float = radians(220)
    """PX4's MC_ROLLRATE_MAX and MC_PITCHRATE_MAX. An attitude without lag has no rate either."""
    yaw_rate_max_radps: float = radians(60)
    """PX4's MPC_YAWRAUTO_MAX."""
    nominal_v: float = 15.6
    """4 cells half-way through a flight."""
    battery_sag: bool = True
    """Thrust goes with the square of the battery's voltage, as at a fixed duty cycle; False: always as nominal."""


F450 = Airframe()

IDEAL = Airframe(
    attitude_lag_s=0.0,
    thrust_lag_s=0.0,
    drag_linear_n_per_mps=0.0,
    drag_quadratic_n_per_mps2=0.0,
    yaw_rate_max_radps=inf,
    battery_sag=False,
)
"""The plant of docs/explanation/control-law.md: acceleration = g * thrust / hover, at once, in still air."""


SIH = Airframe(
    mass_kg=1.0,
    hover_thrust=0.49,
    attitude_lag_s=0.1,
    drag_linear_n_per_mps=1.0,
    drag_quadratic_n_per_mps2=0.0,
    battery_sag=False,
)
"""The quadrotor of PX4's own simulator: SIH_MASS 1, SIH_T_MAX 5 N a motor, SIH_KDV 1 (six times the F450's drag: 1/s of
speed, 12 degrees of lean at 2 m/s)."""


class Quad(Body):
    """One quadrotor with its attitude, thrust and the wind about it; starts at rest on the ground, motors off.

    ``thrust`` is what the motors give now. ``supply_v`` is the battery's voltage; whoever has a battery sets it.
    """

    __slots__ = ("_gains", "_steering", "airframe", "attitude_ned_frd", "supply_v", "thrust", "wind")

    def __init__(self, airframe: Airframe = F450, *, yaw_rad: float = 0.0, wind: Wind | None = None) -> None:
        super().__init__(yaw_rad)
        self.airframe = airframe
        self.wind = wind or Wind()
        self.supply_v = airframe.nominal_v
        self.thrust = 0.0
        self.attitude_ned_frd: Quaternion = level(self.yaw_rad)
        self._steering = Steering(airframe.hover_thrust, airframe.attitude_lag_s)
        self._gains = (0.0, 0.0, 0.0)

    def place(self, east_m: float, north_m: float, up_m: float) -> None:
        """Put it there, still and level, at hover thrust if that is in the air: where a test begins."""
        self.east_m, self.north_m, self.up_m = east_m, north_m, up_m
        self.crashed = False
        self.rest()
        self.attitude_ned_frd = level(self.yaw_rad)
        self.thrust = self.airframe.hover_thrust if up_m > 0.0 else 0.0
        self._steering.restart()

    def set_up(self) -> None:
        self.place(self.east_m, self.north_m, 0.0)

    def step(
        self, dt_s: float, setpoint: Setpoint | AttitudeSetpoint | AccelerationSetpoint | None, limits: Limits
    ) -> None:
        """Move on by ``dt_s``. Without a setpoint the motors stop: it stays on the ground, or falls."""
        if setpoint is None:
            self._steering.restart()
            self.fly(dt_s, None, 0.0)
            return
        attitude, thrust = self._steering.step(self, dt_s, setpoint, limits)
        if isinstance(setpoint, AttitudeSetpoint) and setpoint.attitude_ned_frd is None and setpoint.rates_frd_radps:
            roll, pitch, yaw = setpoint.rates_frd_radps
            rates = (
                self.roll_rate_radps if roll is None else roll,
                self.pitch_rate_radps if pitch is None else pitch,
                self.yaw_rate_radps if yaw is None else yaw,
            )
            self.fly(dt_s, None, thrust, rates)
            return
        self.fly(dt_s, attitude, thrust)

    def fly(self, dt_s: float, attitude: Quaternion | None, thrust: float, rates: Vector | None = None) -> None:
        """The body alone: move on by ``dt_s`` under an attitude or body rates (neither: as it lies) and a collective
        thrust (0..1)."""
        frame = self.airframe
        h = dt_s / SUB_STEPS
        if h != self._gains[0]:
            self._gains = (h, _share(h, frame.attitude_lag_s), _share(h, frame.thrust_lag_s))
        thrust_share = self._gains[2]
        wanted = 0.0 if thrust < 0.0 else 1.0 if thrust > 1.0 else thrust
        wind = self.wind.step(dt_s)
        lift = GRAVITY_MPS2 / frame.hover_thrust
        if frame.battery_sag:
            lift *= (self.supply_v / frame.nominal_v) ** 2
        before = (self.vel_e_mps, self.vel_n_mps, self.vel_u_mps)
        for _ in range(SUB_STEPS):
            self.thrust += (wanted - self.thrust) * thrust_share
            if self.up_m <= 0.0 and self.vel_u_mps <= 0.0 and (self.crashed or self.thrust * lift <= GRAVITY_MPS2):
                self._lie()  # the ground carries it, whatever it wants to lie like
                before = (0.0, 0.0, 0.0)
                continue
            if attitude is not None:
                self._rotate(h, attitude)
            elif rates is not None:
                self._spin(h, rates)
            self._move(h, self.thrust * lift, wind)
        self._report_angles()
        # what an accelerometer averages over the step
        self.accel_enu_mps2 = (
            (self.vel_e_mps - before[0]) / dt_s,
            (self.vel_n_mps - before[1]) / dt_s,
            (self.vel_u_mps - before[2]) / dt_s,
        )

    def _lie(self) -> None:
        self.up_m = 0.0
        self.touch()
        self.yaw_rate_radps = 0.0
        self.attitude_ned_frd = quaternion_from_euler(self.roll_rad, self.pitch_rad, self.yaw_rad)

    def _move(self, h: float, push_mps2: float, wind: Vector) -> None:
        w, x, y, z = self.attitude_ned_frd
        # the push is against the body's down axis, the third column of the rotation to NED
        north = -push_mps2 * 2.0 * (x * z + w * y)
        east = -push_mps2 * 2.0 * (y * z - w * x)
        up = push_mps2 * (1.0 - 2.0 * (x * x + y * y)) - GRAVITY_MPS2
        frame = self.airframe
        rel_e, rel_n, rel_u = self.vel_e_mps - wind[0], self.vel_n_mps - wind[1], self.vel_u_mps - wind[2]
        speed = sqrt(rel_e * rel_e + rel_n * rel_n + rel_u * rel_u)
        drag = (frame.drag_linear_n_per_mps + frame.drag_quadratic_n_per_mps2 * speed) / frame.mass_kg
        east -= drag * rel_e
        north -= drag * rel_n
        up -= drag * rel_u
        self.east_m += (self.vel_e_mps + 0.5 * east * h) * h
        self.north_m += (self.vel_n_mps + 0.5 * north * h) * h
        self.up_m += (self.vel_u_mps + 0.5 * up * h) * h
        self.vel_e_mps += east * h
        self.vel_n_mps += north * h
        self.vel_u_mps += up * h
        if self.up_m <= 0.0 and self.vel_u_mps <= 0.0:
            self._lie()

    def _rotate(self, h: float, setpoint: Quaternion) -> None:
        """Turn by a share of what is missing: first the tilt (a swing about a level axis), then the yaw (a twist)."""
        frame = self.airframe
        share = self._gains[1]
        q = self.attitude_ned_frd
        w, x, y, z = quaternion_product((q[0], -q[1], -q[2], -q[3]), setpoint)  # about body axes, what is missing
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        norm = hypot(w, z)
        tw, tz = (w / norm, z / norm) if norm > 1e-9 else (1.0, 0.0)
        sx, sy = x * tw - y * tz, y * tw + x * tz
        size = hypot(sx, sy)
        swing = 2.0 * atan2(size, norm) * share
        if swing > frame.tilt_rate_max_radps * h and frame.attitude_lag_s > 0.0:
            swing = frame.tilt_rate_max_radps * h
        most, twist = frame.yaw_rate_max_radps * h, 2.0 * atan2(tz, tw) * share
        if abs(twist) > most:
            twist = copysign(most, twist)
        if size > 1e-12:
            half = sin(swing / 2.0) / size
            q = quaternion_product(q, (cos(swing / 2.0), sx * half, sy * half, 0.0))
            self.roll_rate_radps, self.pitch_rate_radps = swing / h * sx / size, swing / h * sy / size
        else:
            self.roll_rate_radps = self.pitch_rate_radps = 0.0
        q = quaternion_product(q, (cos(twist / 2.0), 0.0, 0.0, sin(twist / 2.0)))
        self.yaw_rate_radps = twist / h
        length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        self.attitude_ned_frd = (q[0] / length, q[1] / length, q[2] / length, q[3] / length)

    def _spin(self, h: float, rates: Vector) -> None:
        """Turn with the rates, as fast as the rate loops of roll, pitch and yaw take them on."""
        frame = self.airframe
        share = _share(h, frame.attitude_lag_s * RATE_LAG)
        most = (RATE_MAX_RADPS, RATE_MAX_RADPS, YAW_RATE_MAX_RADPS)
        p, q, r = (max(-m, min(m, wanted)) for wanted, m in zip(rates, most, strict=True))
        self.roll_rate_radps += (p - self.roll_rate_radps) * share
        self.pitch_rate_radps += (q - self.pitch_rate_radps) * share
        self.yaw_rate_radps += (r - self.yaw_rate_radps) * share
        step = turned_by((self.roll_rate_radps, self.pitch_rate_radps, self.yaw_rate_radps), h)
        self.attitude_ned_frd = quaternion_product(self.attitude_ned_frd, step)

    def _report_angles(self) -> None:
        w, x, y, z = self.attitude_ned_frd
        self.roll_rad = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        self.pitch_rad = asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
        self.yaw_rad = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def level(yaw_rad: float) -> Quaternion:
    """Level, the nose at this compass yaw."""
    return cos(yaw_rad / 2.0), 0.0, 0.0, sin(yaw_rad / 2.0)


def _share(h: float, lag_s: float) -> float:
    """Share of the way to the setpoint that a first-order lag goes in ``h``."""
    return 1.0 if lag_s <= 0.0 else 1.0 - exp(-h / lag_s)
