"""The vehicle's estimate as the controller uses it: position and velocity in the local frame, their age, GPS, battery.
Pure.

The *local origin* is the position where control began; its frame is true ENU, whatever the fleet's world frame is.
Values are decoded from the vehicle's state once per message, because every tick, 50 a second, reads them.

`VelocityPrediction` judges whether velocity control may predict this state over the link's delay now, and over which
round trip:

not judged     the fleet file has no ``velocity_predictor``        velocity control without prediction
refused        round trip not measured; position too seldom;       velocity control without prediction, if the guard
               the delay margin does not hold (`velocity_predictor`) lets it fly with this delay
allowed        none of these                                       prediction, whatever ``velocity_delay_s`` says
"""

from __future__ import annotations

import math

from skygcs.core.control.cascade import ZERO, Estimate, Reference, Vector
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.delay import DelayMeter
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.velocity_predictor import ARDUCOPTER_LOOP, PX4_LOOP, AutopilotLoop, why_not_predicted
from skygcs.core.geo import EnuFrame, Origin, ecef, yaw_enu_from_heading_deg
from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.decoding import GlobalPosition, finite_angles, global_position
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.offboard_entry import braking_limits, loss_reach
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

GPS_FIX_3D = 3
"""GPS_FIX_TYPE_3D_FIX; without it the estimator's position drifts within seconds."""

REPORT_FRESH_S = 10.0
"""GPS and battery are reported every two seconds; older values are not used."""

ATTITUDE_FRESH_S = 3.0
"""An attitude older than this is not checked for NaN: it may not be streamed any more."""

JUDGE_S = 0.1
"""Period of evaluating slow values: the percentile of a window of seconds, fix and battery."""

LONGEST_S = 5.0
"""A state is not taken for the present beyond this age: by then the guard has ended control (`position_stale_s`)."""

MAX_LAT_DEG = 90.0
"""Largest latitude; larger numbers are invalid."""

_MESSAGES = ("GLOBAL_POSITION_INT", "ATTITUDE", "ATTITUDE_QUATERNION")


class EstimateView:
    """The estimate of one vehicle as it comes over the link. Call `set_local_origin` first, then `measure` once per
    tick; times are the loop's."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.frame: EnuFrame | None = None
        """The local frame; None before the first `set_local_origin`."""
        self.delay = _delay_meter()
        self.delay_p95_s: float | None = None
        self.fix_ok = True
        """False if its GPS reports no fix."""
        self.battery_percent: float | None = None
        self._vehicle = vehicle
        self._fence: Fence | None = None
        self._judged_at = -math.inf
        decoder = vehicle.message_cache.decoder
        self._position_id, self._attitude_id, self._quaternion_id = map(decoder.msgid_of, _MESSAGES)
        self._read_position, self._read_attitude = map(decoder.read.get, _MESSAGES[:2])
        self._reported: tuple[Frame | None, EnuFrame | None] = (None, None)
        """The frame that the estimate below was decoded from."""
        self._position: GlobalPosition | None = None
        self._estimate: Estimate | None = None
        self._point_m = ZERO
        self._at = 0.0
        self._attitude: tuple[Frame | None, bool] = (None, True)
        self._place: tuple[Reference | None, GeodeticPosition | None] = (None, None)
        self._breach: tuple[GlobalPosition | None, str | None] = (None, None)
        self._fenced: tuple[GeodeticPosition | None, str | None] = (None, None)

    def set_local_origin(self, fence: Fence | None) -> None:
        """The present position becomes the local origin; earlier measurements are dropped. The fence stays on earth.

        Raises RefusedError without a position.
        """
        position = self._vehicle.telemetry("position")
        if position is None or position["lat_deg"] is None:
            raise RefusedError("its position is not known")
        self.frame = EnuFrame(Origin(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]))
        self._fence, self._breach, self._fenced = fence, (None, None), (None, None)
        self.delay, self.delay_p95_s, self._judged_at = _delay_meter(), None, -math.inf

    def measure(self, state_age_s: float | None, now: float) -> None:
        """Note the age of the state (`age_s`) in a tick; every JUDGE_S also the slow values."""
        self.delay.on_tick(state_age_s, now)
        if self.delay.bound_s:  # the link got slow: not to wait for JUDGE_S
            self.delay_p95_s = self.delay.delay_p95_s
        if not 0.0 <= now - self._judged_at < JUDGE_S:
            self._judged_at = now
            self.delay_p95_s = self.delay.delay_p95_s
            self.fix_ok, self.battery_percent = self._reported_fix_ok(now), self._reported_battery_percent(now)

    def estimate(self) -> Estimate | None:
        """Its position and velocity in the local frame, as last reported; None without a position."""
        slot = self._vehicle.slots.get(self._position_id)
        frame = None if slot is None else slot.frame
        if slot is not None:
            self._at = slot.at
        if self._reported[0] is not frame or self._reported[1] is not self.frame:
            self._reported = (frame, self.frame)
            self._position = self._estimate = None
            if frame is not None and self.frame is not None and self._read_position is not None:
                # Not `telemetry`, which decodes more fields: 2.2 us instead of 5.5 for each position.
                self._position = global_position(self._read_position(frame.payload))
                lat_deg, lon_deg, alt_amsl_m, vel_enu_mps = self._position
                if lat_deg is not None and lon_deg is not None:
                    self._point_m = ecef(lat_deg, lon_deg, alt_amsl_m)
                    self._estimate = Estimate(self.frame.from_ecef(self._point_m), vel_enu_mps)
        return self._estimate

    def age_s(self, now: float) -> float | None:
        """Age of the last `estimate`; None without one."""
        return None if self._estimate is None else now - self._at

    def present_place(self, now: float) -> Vector | None:
        """Where it is by now, if it went on as it last reported; None without a position."""
        return self._place_after(self._since_s(now))

    def measured_place(self) -> tuple[Vector, float] | None:
        """The newest position, and when it was measured: its reception less the downlink's delay; None without one."""
        estimate = self.estimate()
        if estimate is None or not estimate.usable:
            return None
        return estimate.pos_enu_m, self._at - (self.delay.uplink_s or 0.0)

    def place_at_arrival(self, now: float) -> Vector | None:
        """Where it is when a setpoint that is sent now reaches it, if it goes on as it last reported."""
        return self._place_after(self._since_s(now) + (self.delay.uplink_s or 0.0))

    def _place_after(self, time_s: float) -> Vector | None:
        estimate = self.estimate()
        if estimate is None or not estimate.usable:
            return None
        (x, y, z), (vx, vy, vz) = estimate.pos_enu_m, estimate.vel_enu_mps
        return x + vx * time_s, y + vy * time_s, z + vz * time_s

    def braking_offset(self, vel_enu_mps: Vector, now: float) -> Vector:
        """From the place of the newest state to where the vehicle stands if it is ordered now to stop, and flies with
        this velocity until the order reaches it."""
        return braking_limits(self._vehicle).offset(vel_enu_mps, self._since_s(now) + (self.delay.uplink_s or 0.0))

    def stopping_place(self, now: float) -> Vector | None:
        """Where it comes to rest if it is ordered now to stop; None without a position.

        Within the fence: where that would be outside, the place it was last known at.
        """
        estimate = self.estimate()
        if estimate is None or not estimate.usable:
            return None
        (x, y, z), (dx, dy, dz) = estimate.pos_enu_m, self.braking_offset(estimate.vel_enu_mps, now)
        place = (x + dx, y + dy, z + dz)
        return place if self.reference_breach(Reference(place)) is None else estimate.pos_enu_m

    def _since_s(self, now: float) -> float:
        """How long ago the newest state was measured: its age here plus the downlink's delay."""
        return min(max(now - self._at, 0.0) + (self.delay.uplink_s or 0.0), LONGEST_S)

    def way_out(self, reference: Reference, now: float, *, margin: bool) -> str | None:
        """Why the velocity of a reference leads out of the fence: the autopilot would go on with it for as long as it
        waits for setpoints that have ceased, and then needs its braking distance. None: it does not, or rests."""
        fence, frame = self._fence, self.frame
        if fence is None or frame is None or not reference.moves:
            return None
        velocity, reach, estimate = reference.vel_enu_mps, loss_reach(self._vehicle), self.estimate()
        x, y, z = reference.pos_enu_m
        way_x, way_y, way_z = reach.offset_m(velocity)
        if estimate is not None and (reference.velocity_only_xy or reference.velocity_only_z):
            # from the vehicle itself, which has flown on since it reported where it is
            blind_s = self._since_s(now) + (self.delay.uplink_s or 0.0)
            if reference.velocity_only_xy:
                x, y, _ = estimate.pos_enu_m
                way_x, way_y = way_x + velocity[0] * blind_s, way_y + velocity[1] * blind_s
            if reference.velocity_only_z:
                z, way_z = estimate.pos_enu_m[2], way_z + velocity[2] * blind_s
        place = frame.to_geodetic(x, y, z)
        return fence.leads_out(*place, (way_x, way_y, way_z), margin=margin, what=reach.what)

    def yaw_rad(self) -> float:
        """Its present yaw (ENU); north if it is not reported."""
        position = self._vehicle.telemetry("position")
        heading = None if position is None else position["heading_deg"]
        if heading is None:
            attitude = self._vehicle.telemetry("attitude")
            heading = 0.0 if attitude is None else attitude["yaw_deg"]
        return math.radians(yaw_enu_from_heading_deg(heading))

    def attitude_is_finite(self, now: float) -> bool:
        """True unless its reported attitude contains NaN."""
        slots = self._vehicle.slots
        slot = slots.get(self._attitude_id)
        if slot is None or slot.frame is None or self._quaternion_id in slots or self._read_attitude is None:
            return self._whole_attitude_is_finite(now)
        if now - slot.at > ATTITUDE_FRESH_S:
            return True
        frame = slot.frame
        if self._attitude[0] is not frame:
            # Only the angles, not the telemetry group with its quaternion: 0.6 us instead of 8 for each attitude.
            self._attitude = (frame, finite_angles(self._read_attitude(frame.payload)))
        return self._attitude[1]

    def _whole_attitude_is_finite(self, now: float) -> bool:
        """`attitude_is_finite` for a vehicle that reports two attitude messages, or the other one."""
        slot = self._vehicle.slot("ATTITUDE") or self._vehicle.slot("ATTITUDE_QUATERNION")
        if slot is None or now - slot.at > ATTITUDE_FRESH_S:
            return True
        return self._vehicle.telemetry("attitude") is not None

    def in_local_frame(self, place: GeodeticPosition) -> Vector:
        """A geodetic position in the local frame."""
        assert self.frame is not None  # set by `set_local_origin`
        return self.frame.from_geodetic(place.lat_deg, place.lon_deg, place.alt_amsl_m)

    def place_of(self, reference: Reference) -> GeodeticPosition:
        """The reference as a geodetic position."""
        known, place = self._place
        if place is None or known is not reference:
            assert self.frame is not None
            place = GeodeticPosition(*self.frame.to_geodetic(*reference.pos_enu_m))
            self._place = (reference, place)
        return place

    def breach(self) -> str | None:
        """Why the vehicle, at the position of `estimate`, is outside the fence; None: it is inside."""
        fence, position = self._fence, self._position
        if fence is None or position is None:
            return None
        if self._breach[0] is not position:
            self._breach = (position, self._breach_at(fence, position))
        return self._breach[1]

    def _breach_at(self, fence: Fence, position: GlobalPosition) -> str | None:
        lat_deg, lon_deg, alt_amsl_m, _ = position
        if lat_deg is None or lon_deg is None or (abs(lat_deg) <= MAX_LAT_DEG and fence.holds(self._point_m)):
            return None
        return fence.why_not(lat_deg, lon_deg, alt_amsl_m)

    def reference_breach(self, reference: Reference) -> str | None:
        """Why the reference is outside the fence; None: it is inside.

        References are taken with the fence's margin (`OffboardEngagement`); here the fence itself counts, so that a
        vehicle taken over near a wall may stay where it is.
        """
        fence = self._fence
        if fence is None or self._estimate is None:
            return None
        place = self.place_of(reference)
        if place is not self._fenced[0]:
            why = fence.why_not(
                *(place.lat_deg, place.lon_deg, place.alt_amsl_m),
                what="the target position",
                free_xy=reference.velocity_only_xy,
                free_z=reference.velocity_only_z,
            )
            self._fenced = (place, why)
        return self._fenced[1]

    def _reported_fix_ok(self, now: float) -> bool:
        gps, at = self._vehicle.message_cache.telemetry("gps")
        if gps is None or now - at > REPORT_FRESH_S:
            return True  # the estimator, whose position is checked, has a fix of its own
        return bool(gps["fix_type"] >= GPS_FIX_3D)

    def _reported_battery_percent(self, now: float) -> float | None:
        battery, at = self._vehicle.message_cache.telemetry("battery")
        return None if battery is None or now - at > REPORT_FRESH_S else battery["percent"]


def _delay_meter() -> DelayMeter:
    """Ages count from the reception of a state: the loop's delay includes the downlink and the uplink."""
    return DelayMeter(share=1.0)


STATE_AGE_MAX_S = 0.75
"""95th percentile of the state's age over 3 s: 4 Hz with two in a row lost, 5 Hz with three. Between two states the
model runs on alone; what gusts of 1 m/s do in that time is 0.1 m."""


class VelocityPrediction:
    """Prediction of one vehicle. `judge` it once a tick, after the delay was measured."""

    def __init__(self, vehicle: Vehicle, estimate_view: EstimateView) -> None:
        self.refused: str | None = None
        """Why there is no prediction though it was chosen, as of the last `judge`; None: nothing stands against it."""
        self.round_trip_s: float | None = None
        """To predict over; None: without prediction."""
        self._vehicle = vehicle
        self._view = estimate_view
        self._judged_at = -math.inf

    def forget(self) -> None:
        """Forget all measurements: control begins anew."""
        self.refused, self.round_trip_s, self._judged_at = None, None, -math.inf

    @property
    def allowed(self) -> bool:
        """True if velocity control predicts now."""
        return self.round_trip_s is not None

    def judge(self, law: ControlConfig, period_s: float, now: float) -> None:
        """Judge anew, every JUDGE_S; a setpoint is sent each ``period_s``."""
        measured_s = self._view.delay.recent_rtt_s
        if self.round_trip_s is not None and measured_s is not None:
            self.round_trip_s = measured_s
        if 0.0 <= now - self._judged_at < JUDGE_S:
            return
        self._judged_at = now
        self.refused = self._refusal(law, period_s)
        self.round_trip_s = measured_s if self.refused is None else None

    def loop(self) -> AutopilotLoop:
        """The model of this vehicle's velocity loop."""
        return PX4_LOOP if self._vehicle.family == "px4" else ARDUCOPTER_LOOP

    def _refusal(self, law: ControlConfig, period_s: float) -> str | None:
        delay = self._view.delay
        usual_s, p95_s, delay_p95_s = delay.recent_rtt_s, delay.rtt_p95_s, self._view.delay_p95_s
        if usual_s is None or p95_s is None or delay_p95_s is None:
            return "the round trip is not measured yet"
        age_p95_s = delay_p95_s - delay.share * max(p95_s, delay.bound_s)
        if not age_p95_s <= STATE_AGE_MAX_S:
            return f"the position is {age_p95_s:.2f} s old in 95 of 100 ticks (prediction: {STATE_AGE_MAX_S:g} s)"
        # on average the state is half of its largest age old, and a setpoint is held for half of its period
        assumed_s = usual_s + 0.5 * (age_p95_s + period_s)
        return why_not_predicted(law, self.loop(), assumed_s, abs(p95_s - usual_s))
