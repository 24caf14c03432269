"""Makes the setpoint of one tick in a control mode: the control law's step and the message. Pure.

control mode    loops closed here            message
raw             none                         what the user's own controller asks for (`raw_setpoint`)
attitude        position and velocity        SET_ATTITUDE_TARGET
velocity        position                     SET_POSITION_TARGET_LOCAL_NED with a velocity, and an acceleration where
                                             the reference has one
position        none                         SET_POSITION_TARGET_GLOBAL_INT with the place the reference reaches
                                             when the message takes effect, and while it moves with its velocity
                                             and, to PX4, its acceleration and what its drag takes
                                             (`control.drag_estimate`); to ArduCopter, which takes that in its
                                             local frame only, SET_POSITION_TARGET_LOCAL_NED once the origin of its
                                             estimator is known. As velocity where no axis has a position.

An axis that follows a velocity beside one that has a position is sent, in `position`, with the position that velocity
has led to: to mix the two kinds in one message needs the vehicle's local frame on PX4, whose height may be reset, and
is not possible on ArduCopter. No loop is closed here by it, so no delay makes it unstable.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from skygcs.core.control.cascade import Estimate, Memory, Output, Quaternion, Reference, Vector, step, velocity_step
from skygcs.core.control.drag_estimate import DragObserver
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.guard import CONTROL_MODES, ControlMode
from skygcs.core.control.trace import PredictionStep, TraceRow
from skygcs.core.control.velocity_loop import clip, record
from skygcs.core.control.velocity_predictor import (
    PX4_LOOP,
    AutopilotLoop,
    PredictorMemory,
    Timing,
    predicted_setpoint,
)
from skygcs.core.vehicle import setpoint
from skygcs.core.vehicle.estimate_view import EstimateView
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.offboard_entry import PX4_RESPONSE_S, boosts_thrust
from skygcs.core.vehicle.origin import EstimatorOrigin
from skygcs.core.vehicle.raw_setpoint import RawSetpoint
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event

LEAST_DEG = 1e-7
"""Resolution of coordinates on the wire, 1 cm."""

NOTHING = Memory()

ATTITUDE, VELOCITY, POSITION = CONTROL_MODES
"""To name a member of an enumeration takes 75 ns each time (CPython 3.11)."""

Message = tuple[str, dict[str, Any]]
"""Name of a message and its fields, but for target_system and target_component."""


@record
class TickInput:
    """Input that the setpoint of one tick is made from. Times are the loop's."""

    at: float
    dt_s: float
    """Measured since the last tick, not clamped."""
    estimate: Estimate | None
    state_age_s: float | None
    reference: Reference
    following: bool
    """True if the autopilot obeys: the integrators run only then."""
    loop: AutopilotLoop | None = None
    """Velocity control predicts the state with this model; None: without prediction."""
    round_trip_s: float = 0.0
    """To predict over."""
    hold_s: float = 0.0
    """Until the next setpoint."""
    lead_s: float = 0.0
    """How much later than this tick the vehicle flies by its setpoint, on average."""


@record
class Tick:
    """Output that one tick asks for. ``hold``: have the autopilot hold position, once.

    ``left``: it ended because the autopilot shows another mode; see whether that stays so.
    ``row`` is for the trace, with the law's memory before and after the step.
    """

    message: Message | None = None
    events: tuple[Event, ...] = ()
    hold: bool = False
    left: bool = False
    row: TraceRow | None = None
    before: Memory | None = None
    after: Memory | None = None
    prediction: PredictionStep | None = None
    """Prediction of velocity control in this tick, for the trace."""


IDLE = Tick()


class SetpointGenerator:
    """The setpoints of one vehicle. Keeps the control law's memory from tick to tick."""

    def __init__(self, vehicle: Vehicle, estimate_view: EstimateView) -> None:
        self.memory = Memory()
        self.output: Output | None = None
        """Output of the last step in the present control mode; only attitude has one."""
        self.predictor = PredictorMemory()
        """Velocity control's, after the last tick; a new one while it does not predict."""
        self.tracing = False
        """True if ticks carry a row for the trace."""
        self.drag = DragObserver(PX4_RESPONSE_S)
        """Position control's, of a PX4."""
        self._vehicle = vehicle
        self._estimate_view = estimate_view
        self._estimator_origin = EstimatorOrigin(vehicle)

    def begin(self) -> None:
        """A new flight by setpoints."""
        self.forget()
        self.drag = DragObserver(PX4_RESPONSE_S)
        self._estimator_origin.begin()

    def forget(self, memory: Memory = NOTHING) -> None:
        """Begin anew, with this memory: an integral of another time is no use, and the first error has no slope yet."""
        self.memory = memory
        self.output = None
        self.predictor = PredictorMemory()

    def move_integral_up(self, thrust: float, bound: float) -> None:
        """Add to the integral of the vertical thrust; it stays within ± ``bound``."""
        east, north, up = self.memory.integral_enu
        self.memory = replace(self.memory, integral_enu=(east, north, clip(up + thrust, bound)))

    def generate(self, control_mode: ControlMode, law: ControlConfig, given: TickInput) -> Tick:
        """The message of this tick and its row for the trace; `IDLE` if there is nothing to fly by."""
        row = self._row(control_mode, given)
        if control_mode is ATTITUDE:
            return self._attitude(law, given, row)
        if control_mode is VELOCITY or (given.reference.velocity_only_xy and given.reference.velocity_only_z):
            return self._velocity(law, given, row)
        return self._position(given, row)

    def handover(self, attitude_ned_frd: Quaternion, thrust: float, given: TickInput) -> Tick:
        """The message of a fixed attitude between two control modes (`handover_attitude`)."""
        row = self._row(POSITION, given)
        if row is not None:
            row = replace(row, attitude_ned_frd=attitude_ned_frd, thrust=thrust)
        boost = boosts_thrust(self._vehicle)
        message = setpoint.attitude_target(attitude_ned_frd, thrust, _boot_ms(given.at), angle_boost=boost)
        return Tick(message, row=row, before=self.memory, after=self.memory)

    def raw(self, wanted: RawSetpoint, tilt_cosine: float | None, given: TickInput) -> Tick:
        """The message of the user's own controller; ``tilt_cosine`` of the vehicle as it reports it."""
        row = self._row(ControlMode.RAW, given)
        if row is not None:
            row = replace(
                row,
                reference=None,
                attitude_ned_frd=wanted.attitude_ned_frd,
                thrust=wanted.thrust,
                rates_frd_radps=wanted.rates_frd_radps,
                acc_setpoint_enu_mps2=wanted.acc_enu_mps2,
            )
        return Tick(self._raw_message(wanted, tilt_cosine, given.at), row=row, before=self.memory, after=self.memory)

    def _raw_message(self, wanted: RawSetpoint, tilt_cosine: float | None, at: float) -> Message:
        boosts = boosts_thrust(self._vehicle)
        if wanted.acc_enu_mps2 is not None:
            return setpoint.acceleration_target(wanted.acc_enu_mps2, wanted.yaw_enu_rad, _boot_ms(at))
        assert wanted.thrust is not None
        if wanted.attitude_ned_frd is not None:
            attitude, thrust = wanted.attitude_ned_frd, wanted.thrust
            return setpoint.attitude_target(attitude, thrust, _boot_ms(at), angle_boost=boosts)
        assert wanted.rates_frd_radps is not None
        cosine = tilt_cosine if boosts else None
        return setpoint.body_rate_target(wanted.rates_frd_radps, wanted.thrust, _boot_ms(at), boost_cosine=cosine)

    def _attitude(self, law: ControlConfig, given: TickInput, row: TraceRow | None) -> Tick:
        before = self.memory
        if given.estimate is None:
            return IDLE
        output, self.memory = step(law, before, given.estimate, given.reference, given.dt_s, following=given.following)
        if output is None:
            return IDLE
        row = None if row is None else row.with_output(output, self.memory)
        self.output = output
        attitude, thrust = output.attitude_ned_frd, output.collective_thrust
        boost = boosts_thrust(self._vehicle)
        message = setpoint.attitude_target(attitude, thrust, _boot_ms(given.at), angle_boost=boost)
        return Tick(message, row=row, before=before, after=self.memory)

    def _velocity(self, law: ControlConfig, given: TickInput, row: TraceRow | None) -> Tick:
        if given.loop is not None and given.following:
            return self._predicted(law, given, row)
        self.predictor = PredictorMemory()
        if given.estimate is None:
            return IDLE
        before = self.memory
        velocity, self.memory = velocity_step(law, before, given.estimate, given.reference, given.dt_s)
        if velocity is None:
            return IDLE
        acceleration, (yaw, yaw_rate) = self._feed_forward(given.reference.acc_enu_mps2), _turn(given.reference)
        message = setpoint.velocity_target(
            *(velocity, yaw, _boot_ms(given.at)),
            acc_enu_mps2=acceleration if any(acceleration) else None,
            yaw_rate_enu_radps=yaw_rate,
        )
        row = None if row is None else row.with_velocity(velocity)
        return Tick(message, row=row, before=before, after=self.memory)

    def _predicted(self, law: ControlConfig, given: TickInput, row: TraceRow | None) -> Tick:
        """The velocity and acceleration for the state and the reference at the moment at which they act."""
        estimate, age_s, loop = given.estimate, given.state_age_s, given.loop
        if estimate is None or age_s is None or loop is None:
            return IDLE
        before, timing = self.predictor, Timing(given.at, age_s, given.round_trip_s, given.hold_s)
        found, self.predictor = predicted_setpoint(law, loop, before, estimate, given.reference, timing)
        if found is None:
            return IDLE
        yaw, yaw_rate = _turn(given.reference)
        message = setpoint.velocity_target(
            *(found.vel_enu_mps, yaw, _boot_ms(given.at)),
            acc_enu_mps2=found.acc_enu_mps2,
            yaw_rate_enu_radps=yaw_rate,
        )
        if row is None:
            return Tick(message, before=self.memory, after=self.memory)
        row = replace(row, round_trip_s=timing.round_trip_s, hold_s=timing.hold_s).with_prediction(found)
        step_made = PredictionStep(loop, before, self.predictor)
        return Tick(message, row=row, before=self.memory, after=self.memory, prediction=step_made)

    def _position(self, given: TickInput, row: TraceRow | None) -> Tick:
        reference, family = _led(given.reference, given.lead_s), self._vehicle.family
        place = self._estimate_view.place_of(reference)
        yaw, yaw_rate = _turn(reference)
        velocity = reference.vel_enu_mps if reference.moves else None
        # as it is: with the 1.2 of `_feed_forward` a real PX4 was .96 m off a circle that is led, without it .90
        acceleration = reference.acc_enu_mps2 if reference.moves else None
        if family == "px4":
            acceleration = self._against_drag(given, acceleration, reference)
        local = self._estimator_origin.local_enu_m(place) if family == "ardupilot" and reference.moves else None
        if local is not None:
            message = setpoint.position_target_local(
                *(local, yaw, _boot_ms(given.at), family),
                vel_enu_mps=velocity,
                acc_enu_mps2=acceleration,
                yaw_rate_enu_radps=yaw_rate,
            )
        else:
            message = setpoint.position_target(
                *(_beside_zero(place), yaw, _boot_ms(given.at), family),
                vel_enu_mps=velocity,
                acc_enu_mps2=acceleration if family == "px4" else None,
                yaw_rate_enu_radps=yaw_rate,
            )
        return Tick(message, row=row, before=self.memory, after=self.memory)

    def _against_drag(self, given: TickInput, acceleration: Vector | None, led: Reference) -> Vector | None:
        """The acceleration to send with a moving reference, with what the vehicle's drag takes."""
        now, reference = given.at, given.reference
        if acceleration is None or reference.velocity_only_xy:
            self.drag.pause()
            return acceleration
        self.drag.note(reference.pos_enu_m, reference.vel_enu_mps, now)
        if (measured := self._estimate_view.measured_place()) is not None:
            self.drag.observe(*measured)
        east, north, up = self.drag.estimate.acceleration_mps2(led.vel_enu_mps)
        return acceleration[0] + east, acceleration[1] + north, acceleration[2] + up

    def _feed_forward(self, acc_enu_mps2: Vector) -> Vector:
        """The acceleration to send for this one: PX4's derivative gain takes a part of the measured one off again."""
        if self._vehicle.family != "px4":
            return acc_enu_mps2
        (east, north, up), gain = acc_enu_mps2, PX4_LOOP.feed_forward_xy
        return gain * east, gain * north, up

    def _row(self, control_mode: ControlMode, given: TickInput) -> TraceRow | None:
        """The input of this tick for the trace; None if nobody records."""
        if not self.tracing or given.estimate is None:
            return None
        return TraceRow(
            *(given.at, given.dt_s, control_mode.value, given.following),
            *(given.reference, given.estimate, given.state_age_s),
        )


def _boot_ms(at: float) -> int:
    """Neither autopilot looks at it for attitude or velocity; it orders the setpoints in a log."""
    return int(at * 1000) & 0xFFFFFFFF


def _led(reference: Reference, lead_s: float) -> Reference:
    """The reference at the time at which the vehicle flies by it. A position that a velocity has led to is not sent
    ahead: nobody waits for the vehicle there, and at the end of the velocity it would have to come back."""
    led = reference.ahead(lead_s)
    if led is reference or not reference.velocity_only:
        return led
    (x, y, z), (led_x, led_y, led_z) = reference.pos_enu_m, led.pos_enu_m
    across = (x, y) if reference.velocity_only_xy else (led_x, led_y)
    return replace(led, pos_enu_m=(*across, z if reference.velocity_only_z else led_z))


def _turn(reference: Reference) -> tuple[float | None, float | None]:
    """Yaw and yaw rate as a message carries them: a rate of 0 is left out, and the yaw where a rate alone turns it."""
    return None if reference.yaw_rate_only else reference.yaw_rad, reference.yaw_rate_radps or None


def _beside_zero(place: GeodeticPosition) -> GeodeticPosition:
    """The place, moved off a coordinate of 0 by the resolution of the wire: 0 counts as never filled in
    (`setpoint.position_target`), but the equator and the first meridian are places like any other."""
    if abs(place.lat_deg) >= LEAST_DEG and abs(place.lon_deg) >= LEAST_DEG:
        return place
    lat_deg, lon_deg = (c if abs(c) >= LEAST_DEG else LEAST_DEG for c in (place.lat_deg, place.lon_deg))
    return GeodeticPosition(lat_deg, lon_deg, place.alt_amsl_m)
