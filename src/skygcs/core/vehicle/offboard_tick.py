"""Input and output of one tick of flight control."""

from __future__ import annotations

from typing import Any

from skygcs.core.control.cascade import Estimate, Memory, Reference
from skygcs.core.control.record import record
from skygcs.core.control.trace import PredictionStep, TraceRow
from skygcs.core.control.velocity_predictor import VelocityLoop
from skygcs.events import Event

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
    loop: VelocityLoop | None = None
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
