"""Controls one vehicle by setpoints: what is sent in each tick, and when control ends. Pure.

    state      what is sent                               what ends it
    --------   ----------------------------------------   ------------------------------------------------------------
    off        nothing                                    `engage` -> engaging
    engaging   setpoints "stay where you are", for the    `entered` (the autopilot obeys) -> flying; `release` -> off
               autopilot's entry
    flying     setpoints in the mode the guard allows     guard: hold -> held; guard: release, `release` -> off
    held       nothing: hold was ordered once             `engage` -> engaging; `release` -> off

The law works in a local frame: true ENU around the local origin, the position where control began. References are
converted from the fleet's world frame when they come in, so a change of the fleet's origin moves no vehicle. (While it
is under control the fleet's origin does not change: `flight_lock`.)
A reference comes as a place to hold (`fly_to`) or as a stream of setpoints with a deadline each (`follow`), which moves
on by its velocity and acceleration between them; when a stream's deadline passes, the vehicle stays where it comes to
rest.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from skygcs.core.control.cascade import Estimate, Memory, Quaternion, Reference, Vector
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.delay import DelayMeter
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.guard import BY_DELAY, CONTROL_MODES, ControlMode, Guard, GuardConfig, GuardFacts, Verdict
from skygcs.core.geo import EnuFrame
from skygcs.core.vehicle.estimate_view import EstimateView, VelocityPrediction
from skygcs.core.vehicle.flight_evidence import contradiction
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.offboard_entry import (
    PX4_RESPONSE_S,
    attitude_refusal,
    guided_mode,
    loss_timeout_s,
    moves_setpoints_on,
)
from skygcs.core.vehicle.raw_setpoint import RawLimits, RawSetpoint, RawSource
from skygcs.core.vehicle.reference_source import ReferenceSource, SteadyThrust, handover_attitude, handover_s
from skygcs.core.vehicle.setpoint_generator import IDLE, NOTHING, SetpointGenerator, Tick, TickInput
from skygcs.core.vehicle.trajectory_flight import TrajectoryFlight
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event

LARGEST_DT_S = 1.0
"""The longest pause between two steps that the law is given; it clamps to 1.5 periods itself."""


OLD_S = 0.2
"""Age of a state above which the reference is moved back by the excess: it is compared with the reference of that time.
Else a reference that moves on while no state comes pulls with ever more speed: 2 m/s for 0.5 s by 1 m/s."""

LONGEST_LEAD_S = 1.0
"""Longest lead of a moving reference ahead of the present. A circle of 5 m at 2 m/s, led by position, velocity and
acceleration, is missed by v·ω²·t³/6 = 5 cm after 1 s and by 43 cm after 2 s."""


class OffboardState(StrEnum):
    OFF = "off"
    ENGAGING = "engaging"
    FLYING = "flying"
    HELD = "held"


ATTITUDE, VELOCITY, POSITION = CONTROL_MODES
RAW = ControlMode.RAW
OFF, ENGAGING, FLYING, HELD = OffboardState
"""To name a member of an enumeration takes 75 ns each time (CPython 3.11): 1.5 us of every tick."""


@dataclass(frozen=True, slots=True)
class OffboardConfig:
    """The configuration of control. Rates in setpoints per second; ``rate_min_hz``: attitude is not flown with
    fewer."""

    law: ControlConfig
    guard: GuardConfig
    attitude_hz: float = 50.0
    velocity_hz: float = 10.0
    position_hz: float = 5.0
    rate_min_hz: float = 20.0
    velocity_predictor: bool = False
    """Velocity control predicts the state over the delay where its delay margin holds (`VelocityPrediction`)."""
    raw: RawLimits = field(default_factory=RawLimits)


@dataclass(slots=True)
class _Last:
    """Input and output of the last tick, for display."""

    at: float = -math.inf
    estimate: Estimate | None = None
    state_age_s: float | None = None


class OffboardController:
    """Control of one vehicle. `tick` at ``period_s`` while ``active``; times are the loop's.

    ``attitude_hz_allowed``, what the link's budget leaves, may be set at any time.
    """

    def __init__(self, vehicle: Vehicle, config: OffboardConfig) -> None:
        self.vehicle = vehicle
        self.config = config
        self.state = OFF
        self.wanted = POSITION
        self.control_mode: ControlMode | None = None
        self.reasons: tuple[str, ...] = ()
        self.attitude_hz_allowed = math.inf
        self.fast_pings = True
        """True if the link bears a ping five times a second while attitude is flown; may be set at any time."""
        self.was_entered = False
        """True if the autopilot obeyed since the last `engage`."""
        self.refusing: str | None = None
        """The autopilot's text when it rejected one of our setpoints since the last `engage`."""
        # where references and setpoints come from
        self._estimate_view = EstimateView(vehicle)
        self._source = ReferenceSource(self._estimate_view)
        self._raw = RawSource(vehicle)
        self._setpoints = SetpointGenerator(vehicle, self._estimate_view)
        self._prediction = VelocityPrediction(vehicle, self._estimate_view)
        self._predicting = False
        """True if the last report was that it predicts."""
        self._steady_thrust = SteadyThrust(vehicle)
        # the guard, and the end of control
        self._guard = Guard(config.guard, POSITION)
        self._obeys = -1
        self._last = _Last()
        self._velocity_ended = False
        """The guard has fallen back to position setpoints, by which no velocity is flown."""
        self.guard_falls: Counter[str] = Counter()
        """How often the guard fell back to "velocity" or "position", ordered to "hold", or ended control ("release"),
        since the vehicle is known."""
        self._handover: tuple[float, Quaternion, float] | None = None
        """Until when this attitude and thrust go before the setpoints of the control mode."""

    # -- orders

    @property
    def memory(self) -> Memory:
        """The control law's, after the last tick."""
        return self._setpoints.memory

    @property
    def tracing(self) -> bool:
        """True if ticks carry a row for the trace."""
        return self._setpoints.tracing

    @tracing.setter
    def tracing(self, on: bool) -> None:
        self._setpoints.tracing = on

    @property
    def active(self) -> bool:
        """True if `tick` has anything to do."""
        return self.state is FLYING or self.state is ENGAGING

    @property
    def period_s(self) -> float:
        """The period of ticks, for the present control mode and the link's budget."""
        control_mode = self.wanted if self.control_mode is None else self.control_mode
        if control_mode is ATTITUDE or control_mode is RAW:
            return 1.0 / self.attitude_hz
        return 1.0 / (self.config.velocity_hz if control_mode is VELOCITY else self.config.position_hz)

    @property
    def attitude_hz(self) -> float:
        """Attitude setpoints per second: as configured, or as many as the link bears if that is enough to fly."""
        return max(min(self.config.attitude_hz, self.attitude_hz_allowed), self.config.rate_min_hz)

    @property
    def streaming(self) -> bool:
        """True if a stream of setpoints leads it now."""
        return self._source.streaming or self._raw.setpoint is not None

    @property
    def handing_over(self) -> bool:
        """True if a fixed attitude is sent before the setpoints of the control mode (`handover_attitude`)."""
        return self._handover is not None

    @property
    def frame(self) -> EnuFrame | None:
        """The local frame; None before the first `engage`."""
        return self._estimate_view.frame

    @property
    def delay(self) -> DelayMeter:
        """Delay of the present control; another after each `engage`."""
        return self._estimate_view.delay

    @property
    def delay_p95_s(self) -> float | None:
        """95th percentile of the delay as of the last tick."""
        return self._estimate_view.delay_p95_s

    @property
    def reference(self) -> Reference | None:
        """The reference in the local frame; None without one, or with raw setpoints."""
        return self._source.reference if self.state is FLYING and self.control_mode is not RAW else None

    def engage(self, control_mode: ControlMode, fence: Fence | None) -> None:
        """Begin to stream "stay where you are" so that the autopilot can be switched over.

        The fence stands on earth until control ends. Raises RefusedError without a position.
        """
        self._estimate_view.set_local_origin(fence)
        self._prediction.forget()
        self._predicting = False
        self.state, self.wanted, self.control_mode, self.reasons = ENGAGING, control_mode, None, ()
        self.was_entered, self.refusing, self._velocity_ended = False, None, False
        self._handover = None
        self._guard.reset(control_mode)
        self._last = _Last()
        self._obeys = guided_mode(self.vehicle)
        self._setpoints.begin()
        self._steady_thrust.forget()
        self._raw.end()
        self._source.stop(self._last.at, self._estimate_view.yaw_rad())

    def entered(self) -> None:
        """The autopilot obeys our setpoints: from now on the reference stays where it is."""
        if self.state is ENGAGING:
            self.state, self.control_mode = FLYING, None
            self.was_entered = True
            self._guard.reset(self.wanted)
            self._setpoints.forget()
            self._source.stop(self._last.at)

    def want(self, control_mode: ControlMode) -> None:
        """Use another control mode from the next tick on, if the guard allows it; the reference stays."""
        if self.control_mode is RAW or control_mode is RAW:
            self._source.stop(self._last.at)
        self._raw.end()
        self.wanted, self.reasons = control_mode, ()
        self._velocity_ended = False
        self._guard.reset(control_mode)

    def release(self, reason: str) -> Tick:
        """Send nothing from now on."""
        if self.state is OFF:
            return IDLE
        self.state, self.control_mode, self.reasons = OFF, None, (reason,)
        self._source.end_stream()
        self._raw.end()
        return Tick(events=(self._event(f"control ended: {reason}", "off"),))

    def why_not(self, control_mode: ControlMode, now: float) -> tuple[str, ...]:
        """The reasons against this control mode at the last tick; changes nothing."""
        facts = replace(self._facts(self._last.estimate, self._last.state_age_s, now), engaging=True)
        return Guard(self.config.guard, control_mode).why_not(facts)

    def change_law(self, law: ControlConfig) -> None:
        """New gains from the next tick on. What was integrated is kept: it is thrust, whatever the gains.

        What of a new hover thrust was integrated already is taken out of the integral: the thrust does not jump.
        """
        learnt = law.hover_thrust - self.config.law.hover_thrust
        if learnt:
            self._setpoints.move_integral_up(-learnt, law.thrust_max)
        self.config = replace(self.config, law=law)

    def limit_attitude_delay(self, delay_s: float) -> None:
        """Set the guard's largest delay for attitude."""
        if self.config.guard.attitude_delay_s != delay_s:
            self.config = replace(self.config, guard=replace(self.config.guard, attitude_delay_s=delay_s))
        self._guard.config = self.config.guard

    def fly_to(self, place: GeodeticPosition, yaw_enu_rad: float | None) -> None:
        """Go to a point on earth and stay there; None keeps the yaw."""
        self._source.hold_at(place, yaw_enu_rad)

    def follow(self, wanted: Setpoint, now: float, until: float) -> str | None:
        """One setpoint of a stream, good ``until`` then. Why not, if its velocity leads out of the fence, or is not
        flown in a control mode that the guard has fallen back to: the reference stays as it was."""
        wanted_reference = self._source.reference_of(wanted, now)
        if self._velocity_ended and wanted_reference.velocity_only:
            # one more stop would be farther on each time, for as long as no newer state comes
            return f"a velocity is not flown by position setpoints: {'; '.join(self.reasons)}"
        if (why := self._estimate_view.way_out(wanted_reference, now, margin=True)) is not None:
            return why
        self._source.follow(wanted_reference, now, until)
        return None

    @property
    def flight(self) -> TrajectoryFlight | None:
        """The trajectory it follows."""
        return self._source.flight

    def follow_trajectory(self, flight: TrajectoryFlight, now: float) -> None:
        """Follow a trajectory that was checked, from now on."""
        self._source.follow_trajectory(flight, now)

    def here(self, now: float) -> Vector | None:
        """Where it is by now, in the local frame; None without a position."""
        return self._estimate_view.present_place(now)

    def measured(self) -> tuple[Vector, float] | None:
        """Its newest position in the local frame, and when it was measured; None without one."""
        return self._estimate_view.measured_place()

    def follow_raw(self, setpoint: RawSetpoint, until: float) -> bool:
        """One setpoint of the user's own controller, in force ``until`` then; it was checked. True for the first after
        none was in force."""
        began = self._raw.setpoint is None
        self._raw.follow(setpoint, until)
        return began

    @property
    def raw_allowed(self) -> bool:
        """True if raw setpoints are flown: they were ordered, and the guard has not rejected them."""
        return self.state is FLYING and self.wanted is RAW and self._guard.control_mode is RAW

    def stay(self) -> None:
        """End a stream now: stay where it comes to rest."""
        self._raw.end()
        self._source.stop(self._last.at)

    # -- tick by tick

    def tick(self, now: float) -> Tick:
        """One step of control; ``now`` measures the step."""
        if not self.active:
            return IDLE
        last = self._last
        first = last.at == -math.inf
        dt_s = self.config.law.period_s if first else min(max(now - last.at, 0.0), LARGEST_DT_S)
        last.at = now
        estimate = self._estimate_view.estimate()
        age_s = self._estimate_view.age_s(now)
        last.estimate, last.state_age_s = estimate, age_s
        by_attitude = self.wanted is ATTITUDE or self.wanted is RAW
        self.delay.fast = by_attitude and self.fast_pings and self._guard.control_mode is self.wanted
        self._estimate_view.measure(age_s, now)
        if self.config.velocity_predictor:
            self._prediction.judge(self.config.law, 1.0 / self.config.velocity_hz, now)
        events: list[Event] = []
        if self.state is ENGAGING:
            self._source.stop(now)
        elif self._source.expire(now):
            events.append(self._event("the setpoints ended: it stays where it is", "flying"))
        elif self._raw.expire(now):
            self._source.stop(now)
            events.append(self._event("the raw setpoints ended: it holds its position by position setpoints", "flying"))
        elif self._source.streaming or self._source.flight is not None:
            why = self._estimate_view.way_out(self._source.advance(now), now, margin=False)
            if why is not None:
                self._source.stop(now)
                events.append(
                    self._event(f"its reference leads out of the fence, it stays where it is: {why}", "flying")
                )
        verdict = self._guard.check(self._facts(estimate, age_s, now), now)
        if verdict.action == "release":
            return self._released(verdict, events)
        if self.state is ENGAGING:
            return self._send(verdict.control_mode or POSITION, dt_s, following=False)
        self.reasons = verdict.reasons
        if verdict.changed:
            events += self._on_change(verdict)
        if verdict.control_mode is not POSITION or self.wanted is POSITION:
            self._velocity_ended = False
        elif not self._velocity_ended:
            # a velocity is not flown on in a control mode that the guard has refused for it
            self._velocity_ended = True
            if self._source.velocity_only:
                self._source.stop(now)
                events.append(self._event("its velocity setpoints end: it stays where it is", "flying"))
        if verdict.action == "hold" or verdict.control_mode is None:
            self.state, self.control_mode = HELD, None
            self._source.end_stream()
            self._raw.end()
            return Tick(events=tuple(events), hold=True)
        if verdict.control_mode is not RAW and self._raw.setpoint is not None:  # its own controller must not fly on
            self._raw.end()
            self._source.stop(now)
        sent = self._send(verdict.control_mode, dt_s, following=True)
        if self.config.velocity_predictor:
            events += self._on_prediction()
        return replace(sent, events=tuple(events)) if events else sent

    def status(self, now: float) -> dict[str, Any]:
        """The status, in the local frame."""
        # tracking error, without the axes that are flown by velocity
        last, output, reference = self._last, self._setpoints.output, self.reference
        error = None
        if reference is not None and last.estimate is not None and not reference.velocity_only_xy:
            error = [r - x for r, x in zip(reference.pos_enu_m, last.estimate.pos_enu_m, strict=True)]
            if reference.velocity_only_z:
                error[2] = 0.0
        # output of the attitude law, if it flies
        attitude = output if self.control_mode is ATTITUDE else None
        return {
            "mode": None if self.state is OFF else self.wanted.value,
            "control_mode": None if self.control_mode is None else self.control_mode.value,
            "state": self.state.value,
            "reasons": list(self.reasons),
            "prediction": self._prediction_status(),
            "reference": reference,
            "error_enu_m": error,
            "error_m": None if error is None else math.hypot(*error),
            "state_age_s": last.state_age_s if self.active else None,
            "delay_p95_s": self.delay_p95_s,
            "rtt_s": self.delay.rtt_p95_s,
            "rate_hz": 1.0 / self.period_s if self.active else None,
            "trajectory": None if self.flight is None else self.flight.status(now),
            "raw": None if self._raw.setpoint is None else self._raw.setpoint.kind,
            "saturation": [] if attitude is None else list(attitude.saturation.names()),
            "integral_enu": list(self._setpoints.memory.integral_enu),
            "thrust": None if attitude is None else attitude.collective_thrust,
            "roll_deg": None if attitude is None else math.degrees(attitude.roll_frd_rad),
            "pitch_deg": None if attitude is None else math.degrees(attitude.pitch_frd_rad),
        }

    # -- internal

    def _prediction_status(self) -> dict[str, Any] | None:
        """None unless the fleet file chooses it."""
        if not self.config.velocity_predictor:
            return None
        active = self.state is FLYING and self.control_mode is VELOCITY and self._prediction.allowed
        return {
            "active": active,
            "refused": self._prediction.refused if self.wanted is VELOCITY else None,
            "round_trip_s": self._prediction.round_trip_s if active else None,
            "disturbance_enu_mps2": list(self._setpoints.predictor.disturbance_enu_mps2) if active else None,
        }

    def _send(self, control_mode: ControlMode, dt_s: float, *, following: bool) -> Tick:
        raw = self._raw.setpoint
        if control_mode is RAW and raw is not None and following:
            return self._send_raw(raw, dt_s)
        if control_mode is RAW:
            control_mode = POSITION  # none is in force: it stays where it is
        last, period_s = self._last, 1.0 / self.attitude_hz
        if self.config.law.period_s != period_s:  # a step is measured against the rate that the link leaves
            self.config = replace(self.config, law=replace(self.config.law, period_s=period_s))
        attitude = control_mode is ATTITUDE
        if not attitude or not following:
            self._steady_thrust.observe(self.config.law, last.estimate, last.at)
        if control_mode is not self.control_mode or (attitude and not following):
            self._handover = None if attitude or not following else self._begin_handover()
            self.control_mode = control_mode
            self._setpoints.forget(self._steady_thrust.memory(self.config.law, last.at) if attitude else NOTHING)
        given = self._given(control_mode, dt_s, following=following)
        if self._handover is not None:
            until, orientation, thrust = self._handover
            if last.at < until and attitude_refusal(self.vehicle) is None:
                return self._setpoints.handover(orientation, thrust, given)
            self._handover = None
        return self._setpoints.generate(control_mode, self.config.law, given)

    def _given(self, control_mode: ControlMode, dt_s: float, *, following: bool) -> TickInput:
        last, reference = self._last, self._source.reference
        at, estimate, age_s = last.at, last.estimate, last.state_age_s
        if control_mode is POSITION:
            return TickInput(at, dt_s, estimate, age_s, reference, following, lead_s=self._lead_s())
        if control_mode is VELOCITY and (round_trip_s := self._prediction.round_trip_s) is not None:
            hold_s, loop = 1.0 / self.config.velocity_hz, self._prediction.loop()
            return TickInput(at, dt_s, estimate, age_s, reference, following, loop, round_trip_s, hold_s)
        if age_s is not None and age_s > OLD_S:
            reference = reference.ahead(OLD_S - age_s)
        return TickInput(at, dt_s, estimate, age_s, reference, following)

    def _begin_handover(self) -> tuple[float, Quaternion, float] | None:
        """At the end of attitude setpoints: the last one is flown on, or taken for a lasting one."""
        estimate = self._last.estimate
        by_attitude = self.control_mode is ATTITUDE or self.control_mode is RAW
        if not by_attitude or attitude_refusal(self.vehicle) is not None:
            return None
        if estimate is None or not estimate.usable:
            return None
        law, yaw_rad = self.config.law, self._source.reference.yaw_rad
        integral, timeout_s = self._setpoints.memory.integral_enu, loss_timeout_s(self.vehicle)
        attitude, thrust = handover_attitude(law, integral, estimate.vel_enu_mps, yaw_rad, timeout_s)
        return self._last.at + handover_s(self.vehicle), attitude, thrust

    def _lead_s(self) -> float:
        """How much later than now the vehicle flies by a position sent now, on average: the uplink and half of
        the time for which it is held with the autopilot's response, unless the autopilot itself moves it on."""
        held_s = 0.0 if moves_setpoints_on(self.vehicle) else 0.5 / self.config.position_hz + PX4_RESPONSE_S
        return min((self.delay.uplink_s or 0.0) + held_s, LONGEST_LEAD_S)

    def _send_raw(self, raw: RawSetpoint, dt_s: float) -> Tick:
        last, self._handover = self._last, None
        if self.control_mode is not RAW:
            self.control_mode = RAW
            self._setpoints.forget(NOTHING)
        given = TickInput(last.at, dt_s, last.estimate, last.state_age_s, self._source.reference, True)
        return self._setpoints.raw(raw, self._raw.tilt_cosine(last.at), given)

    def _facts(self, estimate: Estimate | None, age_s: float | None, now: float) -> GuardFacts:
        # facts that others derive from
        vehicle, config, estimate_view = self.vehicle, self.config, self._estimate_view
        engaging = self.state is ENGAGING
        breach = estimate_view.breach()
        reference_breach = None if engaging else estimate_view.reference_breach(self._source.reference)
        flies_disarmed = None if vehicle.armed else contradiction(vehicle, now)
        return GuardFacts(
            connected=vehicle.connected,
            armed=vehicle.armed,
            following=vehicle.custom_mode == self._obeys,
            state_age_s=age_s,
            rtt_p95_s=estimate_view.delay.rtt_p95_s,
            delay_p95_s=estimate_view.delay_p95_s,
            estimate=estimate,
            finite=estimate_view.attitude_is_finite(now),
            fix_ok=estimate_view.fix_ok,
            airborne=vehicle.in_air(now) if flies_disarmed is None else True,
            flies_disarmed=flies_disarmed,
            two_senders=vehicle.ids.beside,
            battery_percent=estimate_view.battery_percent,
            inside_fence=breach is None,
            reference_inside_fence=reference_breach is None,
            rate_hz=min(config.attitude_hz, self.attitude_hz_allowed),
            rate_min_hz=config.rate_min_hz,
            refusing=self.refusing,
            attitude_refused=attitude_refusal(vehicle) if self.wanted is ATTITUDE or self.wanted is RAW else None,
            raw_refused=self._raw_refused(estimate, now) if self.wanted is RAW else None,
            engaging=engaging,
            position_breach=breach,
            reference_breach=reference_breach,
            predicted=self._prediction.allowed,
            pings_overdue=estimate_view.delay.overdue,
        )

    def _on_prediction(self) -> list[Event]:
        """The event of a change between velocity control with and without prediction, in flight."""
        predicting = self.control_mode is VELOCITY and self._prediction.allowed
        if predicting == self._predicting or not (predicting or self.control_mode is VELOCITY):
            self._predicting = predicting
            return []
        self._predicting = predicting
        round_trip_s, refused = self._prediction.round_trip_s, self._prediction.refused
        text = (
            f"its state is predicted over {round_trip_s:.3f} s of round trip"
            if round_trip_s is not None
            else f"its state is not predicted any more: {refused}"
        )
        return [self._event(text, "flying", VELOCITY)]

    def _raw_refused(self, estimate: Estimate | None, now: float) -> str | None:
        """Why the user's own controller must not fly on; None if it may."""
        if self._raw.setpoint is None:
            return None
        tilt = self._raw.tilt_refusal(self.config.raw, now)
        if tilt is not None or estimate is None or not estimate.usable:
            return tilt
        # flown on unchanged after a loss of setpoints, and then stopped, it must still be inside
        moving = Reference(
            estimate.pos_enu_m, vel_enu_mps=estimate.vel_enu_mps, velocity_only_xy=True, velocity_only_z=True
        )
        return self._estimate_view.way_out(moving, now, margin=True)

    def _released(self, verdict: Verdict, events: list[Event]) -> Tick:
        """The guard ended control."""
        self.guard_falls["release"] += 1
        ended = self.release("; ".join(verdict.reasons))
        return Tick(events=(*events, *ended.events), left="mode" in verdict.kinds)

    def _on_change(self, verdict: Verdict) -> list[Event]:
        first = self.control_mode is None and verdict.control_mode is self.wanted
        why = "; ".join(verdict.reasons)
        if verdict.action == "hold":
            self.guard_falls["hold"] += 1
            return [self._event(f"holding, nothing more is sent: {why}", "held")]
        if verdict.control_mode is None or first:
            return []  # that it flies as it was wanted is the order's own outcome
        if BY_DELAY.index(verdict.control_mode) > BY_DELAY.index(self.control_mode or self.wanted):
            self.guard_falls[verdict.control_mode.value] += 1
        text = f"flown by {verdict.control_mode.value} setpoints" + (f": {why}" if why else " again")
        if verdict.control_mode is POSITION and self.wanted is RAW:
            text = f"its own controller flies no more, it holds its position: {why}"
        return [self._event(text, "flying", verdict.control_mode)]

    def _event(self, text: str, state: str, control_mode: ControlMode | None = None) -> Event:
        data = {
            "state": state,
            "control_mode": None if control_mode is None else control_mode.value,
            "reasons": list(self.reasons),
        }
        return Event("control", self.vehicle.name, self.vehicle.sysid, text, data)
