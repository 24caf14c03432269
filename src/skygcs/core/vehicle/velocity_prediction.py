"""Judge whether velocity control may predict the vehicle's state over the link's delay now, and over which round trip.
Pure.

not judged     the fleet file has no ``velocity_predictor``        velocity control without prediction
refused        round trip not measured; position too seldom;       velocity control without prediction, if the guard
               the delay margin does not hold (`velocity_predictor`) lets it fly with this delay
allowed        none of these                                       prediction, whatever ``velocity_delay_s`` says
"""

from __future__ import annotations

import math

from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.velocity_predictor import ARDUCOPTER_LOOP, PX4_LOOP, AutopilotLoop, why_not_predicted
from skygcs.core.vehicle.estimate_view import JUDGE_S, EstimateView
from skygcs.core.vehicle.vehicle import Vehicle

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
