"""Decides in each tick, before the control law runs, whether setpoints may be sent and in which control mode.

    any fact of ...                                                      engaging    flying     afterwards
    ─────────────────────────────────────────────────────────────────────────────────────────────────────
    1 not ours  lost, rebooted, not armed (and nothing says that it      release     release    nothing more
                flies all the same), on the ground,
                autopilot in a mode that does not follow us (flying)
    2 unsafe    no state or older than position_stale_s, NaN, no fix,    release     hold       nothing more
                no position, vehicle or reference outside the fence,
                battery low, autopilot refuses our setpoints,
                "disarmed" in the air, two senders on its link
    3 unfit     state older than stale_s                                 position    position   │ as it is; higher
                delay p95 above velocity_delay_s (unless predicted),     position    position   │ again only after
                or rate below 2 Hz                                                              │
                delay p95 above attitude_delay_s or not measured yet,    velocity    velocity   │ return_after_s of
                rate below rate_min_hz, attitude_refused                                        │ all well, if set
                the same for raw, or raw_refused                     position    position   │
    4 none of these                                                      wanted      wanted

The first row that applies decides. *Release* comes before *hold*: a hold is an order, and skygcs sends no orders to a
vehicle that something else (a pilot, another station, its failsafe) controls. A vehicle that does not follow yet
(engaging) is not under our control either, so there an unsafe fact only ends the attempt. *Hold* comes before the
choice of a control mode because no mode is safe with such a fact. Both are final until `Guard.reset`: to continue, the
autopilot's mode must be changed again, and a person must order that. Within row 3 the change to a lower mode is
immediate and the change to a higher one needs ``return_after_s``, so that the mode cannot oscillate. While engaging the
mode follows the facts in both directions: no setpoint is flown yet, and the round trip is still being measured.

A single late tick changes nothing until it is ``stale_s`` late: delays are judged by their 95th percentile. NaN counts
as bad in every fact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple

from skygcs.core.control.cascade import LARGEST_INPUT, Estimate
from skygcs.core.control.gains import out_of_range
from skygcs.core.control.velocity_loop import record
from skygcs.errors import ConfigError

Action = Literal["send", "hold", "release"]

STREAM_MIN_HZ = 2.0
"""PX4 leaves OFFBOARD below 2 setpoints per second; ArduPilot keeps the last velocity for up to 3 s."""

FUTURE_SLACK_S = 0.1
"""A state may be this much newer than the tick (it arrived meanwhile). A later date means a wrong clock."""


class ControlMode(StrEnum):
    """Which loops skygcs closes: all of them, the outer one, none. Raw: the user's own controller closes them."""

    RAW = "raw"
    ATTITUDE = "attitude"
    VELOCITY = "velocity"
    POSITION = "position"


CONTROL_MODES = (ControlMode.ATTITUDE, ControlMode.VELOCITY, ControlMode.POSITION)
"""In fallback order."""

BY_DELAY = (ControlMode.RAW, *CONTROL_MODES)
"""All of them; each needs at most as much delay as the next."""

FALLBACKS = {
    ControlMode.RAW: (ControlMode.RAW, ControlMode.POSITION),
    **{control_mode: CONTROL_MODES[i:] for i, control_mode in enumerate(CONTROL_MODES)},
}
"""Modes that each wanted mode may become. skygcs never replaces the user's own controller by its own law; the vehicle
holds its position instead."""

_, _VELOCITY, _POSITION = CONTROL_MODES
"""Naming a member of an enumeration takes 75 ns (CPython 3.11), twice in every tick."""


@dataclass(frozen=True, slots=True)
class GuardConfig:
    """Limits of the guard; derivations in docs/explanation/control-guard.md. Raises ConfigError with every problem."""

    attitude_delay_s: float = 0.1
    """Largest delay (p95 of state age plus setpoint transport) for attitude: half of the z axis' delay margin with
    the default gains (0.213 s); the rest is for the airframe's lag. For other gains: `analysis.why_not_delay`."""
    velocity_delay_s: float = 0.5
    """The same for velocity: skygcs then closes only the outer P loop, whose delay margin is π/2 s at 1/s."""
    stale_s: float = 0.5
    """If the newest state is older than this in any tick, neither attitude nor velocity setpoints are sent."""
    position_stale_s: float = 2.0
    """If it is older than this, no setpoints are sent. At 2 Hz three states in a row may be lost, at 1 Hz none."""
    battery_min_percent: float | None = 20.0
    """Below this charge: hold. None: not watched."""
    return_after_s: float | None = None
    """Control returns to a higher mode after it was possible for this time without a break. None: only on order."""

    def __post_init__(self) -> None:
        problems = out_of_range(
            self,
            ("attitude_delay_s", 0.001, 1.0),
            ("velocity_delay_s", 0.001, 5.0),
            ("stale_s", 0.01, 5.0),
            ("position_stale_s", 0.01, 60.0),
            ("battery_min_percent", 0.0, 100.0),
            ("return_after_s", 1.0, 3600.0),
        )
        if self.attitude_delay_s > self.velocity_delay_s:
            problems.append(
                f"attitude_delay_s: {self.attitude_delay_s} is above velocity_delay_s ({self.velocity_delay_s}), "
                "but attitude tolerates less delay"
            )
        if self.stale_s > self.position_stale_s:
            problems.append(
                f"stale_s: {self.stale_s} is above position_stale_s ({self.position_stale_s}), "
                "but position setpoints tolerate older states"
            )
        if problems:
            raise ConfigError("guard", problems)


@record
class GuardFacts:
    """The guard's input in one tick. None means unknown."""

    connected: bool
    armed: bool
    following: bool
    """The autopilot is in the mode that follows setpoints."""
    state_age_s: float | None
    """Age of the newest position; None: none has come yet."""
    rtt_p95_s: float | None
    delay_p95_s: float | None
    """From `DelayMeter`. While unmeasured, attitude is refused and velocity is limited by ``stale_s``."""
    estimate: Estimate | None
    """About the vehicle's local origin. None: no position."""
    finite: bool
    """No NaN in the reported state and attitude."""
    fix_ok: bool
    airborne: bool | None
    """False (certainly landed) ends control; None does not: many autopilots do not report it."""
    battery_percent: float | None
    """None (not reported) is accepted: the autopilot has a battery failsafe of its own."""
    inside_fence: bool
    reference_inside_fence: bool
    rate_hz: float
    """Setpoints per second that the link budget allows for this vehicle."""
    rate_min_hz: float
    """The minimum for attitude."""
    refusing: str | None
    """Why the autopilot refuses our setpoints or our mode, in its own words."""
    engaging: bool = False
    """Setpoints are sent so that the mode can be entered; the vehicle need not follow yet."""
    rebooted: bool = False
    """Its time since boot ran backwards since control began."""
    flies_disarmed: str | None = None
    """The evidence that it flies although its heartbeat shows it disarmed; None: no evidence."""
    two_senders: bool = False
    """Another vehicle sends with its ids on the same link: its state may be the other vehicle's."""
    attitude_refused: str | None = None
    """Why this autopilot must not get attitude setpoints (ArduPilot: thrust may mean climb rate); None: it may."""
    raw_refused: str | None = None
    """Why the user's own controller must not fly on: the measured tilt, or a fence it could not stop before; None: it
    may."""
    position_breach: str | None = None
    reference_breach: str | None = None
    """The texts of `Fence.why_not`, reported instead of a sentence without figures."""
    predicted: bool = False
    """Velocity control predicts the state over the delay, and its delay margin holds: instead of ``velocity_delay_s``.
    """
    pings_overdue: bool = False
    """Pings without an answer say that the round trip is longer than those measured; ``delay_p95_s`` counts with it."""


@record
class Verdict:
    """The guard's decision for this tick.

    send: setpoints for ``control_mode``. hold: order a hold once (when ``changed``), send nothing. release: send
    nothing at all.
    """

    action: Action
    control_mode: ControlMode | None
    """None unless ``action`` is send."""
    reasons: tuple[str, ...]
    """Why it is not the wanted mode, for the operator: the figure and its limit. Empty if it is."""
    changed: bool
    """True if it has to be reported now: at each change of action or mode, and at each new kind of reason."""
    kinds: tuple[str, ...] = ()
    """The kinds of the reasons, without figures, for programs."""


class Refusal(NamedTuple):
    """One reason not to send."""

    kind: str
    text: str


class Guard:
    """Keeps the control mode, and ends control finally. One per vehicle and engagement.

    Call `why_not` before control begins, then `check` in every tick, and act on its verdict. The guard begins in the
    wanted mode; the first check finds and reports what refuses it.
    """

    __slots__ = (
        *("_as_before", "_as_wanted", "_cause", "_checked_at", "_clear_since", "_ended", "_reported", "_control_mode"),
        *("config", "wanted"),
    )

    def __init__(self, config: GuardConfig, wanted: ControlMode) -> None:
        self.config = config
        self.reset(wanted)

    @property
    def control_mode(self) -> ControlMode | None:
        """The present mode; None after a hold or a release."""
        return None if self._ended else self._control_mode

    def reset(self, wanted: ControlMode) -> None:
        """Begin again in the wanted mode, because control was ordered again."""
        self.wanted = wanted
        self._control_mode = wanted
        self._ended: Verdict | None = None
        self._reported: set[str] = set()
        self._cause: tuple[Refusal, ...] = ()
        self._clear_since: dict[ControlMode, float] = {}
        self._checked_at = -math.inf
        self._as_wanted = Verdict("send", wanted, (), changed=False)
        self._as_before = False
        """True if the last check found no reason and the mode is the wanted one: another such check changes nothing."""

    def why_not(self, facts: GuardFacts) -> tuple[str, ...]:
        """All present reasons against the wanted mode. Changes nothing."""
        found = (*_not_ours(facts), *_unsafe(self.config, facts), *_unfit(self.config, facts, self.wanted))
        return tuple(refusal.text for refusal in found)

    def check(self, facts: GuardFacts, now: float) -> Verdict:
        """The verdict for this tick. After a hold or a release it stays the same, with its first reasons."""
        if self._as_before and now >= self._checked_at and all_well(self.config, facts, self.wanted):
            return self._as_wanted  # the full check would find the same: 0.8 us instead of 3.9 us
        if self._ended:
            return self._ended
        self._as_before, self._checked_at = False, now
        if refusals := tuple(_not_ours(facts)):
            return self._end("release", refusals[:1])  # the first is the cause, the others are consequences
        if refusals := tuple(_unsafe(self.config, facts)):
            return self._end("release" if facts.engaging else "hold", refusals)
        refused = {
            control_mode: tuple(_unfit(self.config, facts, control_mode)) for control_mode in self._control_modes()
        }
        self._note_clear(refused, now)
        before = self._control_mode
        self._control_mode = self._chosen(refused, now, bound=not facts.engaging)
        if self._control_mode != before:
            self._reported.clear()
        return self._sending(refused, self._control_mode != before, now)

    def _end(self, action: Action, refusals: tuple[Refusal, ...]) -> Verdict:
        reasons, kinds = tuple(r.text for r in refusals), tuple(r.kind for r in refusals)
        self._ended = Verdict(action, None, reasons, changed=False, kinds=kinds)
        return Verdict(action, None, reasons, changed=True, kinds=kinds)

    def _control_modes(self) -> tuple[ControlMode, ...]:
        """The wanted mode and its fallbacks."""
        return FALLBACKS[self.wanted]

    def _note_clear(self, refused: dict[ControlMode, tuple[Refusal, ...]], now: float) -> None:
        for control_mode, refusals in refused.items():
            if refusals:
                self._clear_since.pop(control_mode, None)
            elif self._clear_since.setdefault(control_mode, now) > now:  # the clock ran backwards
                self._clear_since[control_mode] = now

    def _chosen(self, refused: dict[ControlMode, tuple[Refusal, ...]], now: float, *, bound: bool) -> ControlMode:
        """The highest mode without a refusal; position is never refused. ``bound``: not above the present mode."""
        after_s = self.config.return_after_s
        order = self._control_modes()
        for control_mode in order:
            if refused[control_mode]:
                continue
            if not bound or order.index(control_mode) >= order.index(self._control_mode):
                return control_mode
            if after_s is not None and now - self._clear_since[control_mode] >= after_s:
                return control_mode
        return CONTROL_MODES[-1]

    def _sending(self, refused: dict[ControlMode, tuple[Refusal, ...]], moved: bool, now: float) -> Verdict:
        if self._control_mode is self.wanted:
            self._cause = ()
            self._as_before = not any(refused.values())
            return Verdict("send", self._control_mode, (), changed=moved)
        order = self._control_modes()
        above = order[: order.index(self._control_mode)]
        present = tuple({r.kind: r for control_mode in above for r in refused[control_mode]}.values())
        self._cause = present or self._cause
        reasons, kinds = [r.text for r in self._cause], tuple(r.kind for r in self._cause)
        possible = next((control_mode for control_mode in above if not refused[control_mode]), None)
        if possible:
            reasons.append(self._return_text(possible, now - self._clear_since[possible]))
        news = not self._reported.issuperset(kinds)
        self._reported.update(kinds)
        return Verdict("send", self._control_mode, tuple(reasons), changed=moved or news, kinds=kinds)

    def _return_text(self, control_mode: ControlMode, clear_s: float) -> str:
        since = f"{control_mode} has been possible again for {clear_s:.1f} s"
        if self.config.return_after_s is None:
            return f"{since}; it does not return by itself, order {control_mode} again"
        return f"{since}; it returns after {self.config.return_after_s:g} s"


def all_well(config: GuardConfig, facts: GuardFacts, wanted: ControlMode) -> bool:
    """True if no rule rejects the wanted mode or its fallbacks: `_not_ours`, `_unsafe` and `_unfit` in one expression,
    for the many ticks without a reason."""
    # any mode
    age_s, estimate, delay_s = facts.state_age_s, facts.estimate, facts.delay_p95_s
    if (
        not facts.connected
        or facts.rebooted
        or not facts.armed
        or facts.airborne is False
        or not (facts.following or facts.engaging)
        or not facts.finite
        or not facts.fix_ok
        or not facts.inside_fence
        or not facts.reference_inside_fence
        or facts.refusing is not None
        or facts.two_senders
        or age_s is None
        or estimate is None
        or not estimate.usable
    ):
        return False
    # battery, then by mode: the more it needs the later
    floor, battery = config.battery_min_percent, facts.battery_percent
    if floor is not None and battery is not None and not battery >= floor:
        return False
    if wanted is _POSITION:
        return not _too_old(age_s, config.position_stale_s)
    if _too_old(age_s, config.stale_s) or not facts.rate_hz >= STREAM_MIN_HZ:  # stale_s is the smaller one of the two
        return False
    if wanted is _VELOCITY:
        return delay_s is None or delay_s <= config.velocity_delay_s or facts.predicted
    return (
        facts.rtt_p95_s is not None
        and facts.rtt_p95_s >= 0
        and delay_s is not None
        and delay_s <= config.attitude_delay_s  # which is not above velocity_delay_s
        and facts.rate_hz >= facts.rate_min_hz
        and facts.attitude_refused is None
        and (wanted is not ControlMode.RAW or facts.raw_refused is None)
    )


def _not_ours(facts: GuardFacts) -> Iterator[Refusal]:
    """Row 1, causes before consequences: a vehicle that rebooted is also disarmed and in another mode."""
    if not facts.connected:
        yield Refusal("lost", "the vehicle is lost: no heartbeat")
    if facts.rebooted:
        yield Refusal("rebooted", "the autopilot rebooted and lost all earlier orders")
    if not facts.armed and facts.flies_disarmed is None:
        yield Refusal("not_armed", "the vehicle is not armed")
    if facts.airborne is False:
        # On the ground the loop is open: the integrators wind up, a sideways error tips the vehicle over, and an
        # upward one is a take-off that was not ordered.
        yield Refusal("on_ground", "the vehicle is on the ground, where setpoints tip it over: take off first")
    if not facts.following and not facts.engaging:
        yield Refusal(
            "mode",
            "the autopilot left the mode that follows skygcs: a pilot, another station or its failsafe took over",
        )


def _unsafe(config: GuardConfig, facts: GuardFacts) -> Iterator[Refusal]:
    """Row 2."""
    if not facts.armed and facts.flies_disarmed is not None:
        # A heartbeat from another sender: without setpoints an ArduCopter in the air levels and drifts.
        yield Refusal("disarmed_in_air", f"its heartbeat shows it disarmed, but {facts.flies_disarmed}")
    if facts.two_senders:
        yield Refusal("two_senders", "two vehicles send with its ids on one link, so its state cannot be trusted")
    if facts.state_age_s is None:
        yield Refusal("no_state", "no position has come from the vehicle yet")
    elif _too_old(facts.state_age_s, config.position_stale_s):
        yield Refusal("silent", _age_text(facts.state_age_s, config.position_stale_s, "any setpoint"))
    if not facts.finite:
        yield Refusal("not_finite", "the vehicle reports NaN in its state or attitude")
    if not facts.fix_ok:
        yield Refusal("no_fix", "the vehicle has no usable position fix")
    if facts.estimate is None:
        yield Refusal("no_position", "the vehicle's position is not known")
    elif not facts.estimate.usable:
        position = ", ".join(f"{value:g}" for value in (*facts.estimate.pos_enu_m, *facts.estimate.vel_enu_mps))
        yield Refusal(
            "estimate", f"position and velocity ({position}) are not all numbers up to {LARGEST_INPUT:g} m and m/s"
        )
    if not facts.inside_fence:
        yield Refusal("fence", facts.position_breach or "the vehicle is outside the control fence")
    if not facts.reference_inside_fence:
        yield Refusal("fence_reference", facts.reference_breach or "the reference is outside the control fence")
    floor, battery = config.battery_min_percent, facts.battery_percent
    if floor is not None and battery is not None and not battery >= floor:
        yield Refusal("battery", f"the battery is at {battery:g} % (limit {floor:g} %)")
    if facts.refusing is not None:
        yield Refusal("refusing", f"the autopilot refuses: {facts.refusing or 'it does not say why'}")


def _unfit(config: GuardConfig, facts: GuardFacts, control_mode: ControlMode) -> Iterator[Refusal]:
    """Row 3. Position has no entry: its limits are in row 2."""
    if control_mode is ControlMode.POSITION:
        return
    if facts.state_age_s is None or _too_old(facts.state_age_s, config.stale_s):
        age_s = float("nan") if facts.state_age_s is None else facts.state_age_s
        yield Refusal("stale", _age_text(age_s, config.stale_s, "attitude and velocity"))
    delay_s = facts.delay_p95_s
    if control_mode is ControlMode.VELOCITY:
        if delay_s is not None and not delay_s <= config.velocity_delay_s and not facts.predicted:
            yield Refusal("velocity_delay", _delay_text(facts, config.velocity_delay_s, control_mode))
        if not facts.rate_hz >= STREAM_MIN_HZ:
            yield Refusal(
                "velocity_rate",
                f"the link leaves {facts.rate_hz:.3g} setpoints per second (velocity needs {STREAM_MIN_HZ:g}, "
                "or the autopilot treats the stream as lost)",
            )
        return
    if facts.rtt_p95_s is None or delay_s is None:
        yield Refusal("unmeasured", "the round trip is not measured yet, so the delay for attitude is unknown")
    elif not (facts.rtt_p95_s >= 0 and delay_s <= config.attitude_delay_s):
        yield Refusal("attitude_delay", _delay_text(facts, config.attitude_delay_s, control_mode))
    if not facts.rate_hz >= facts.rate_min_hz:
        yield Refusal("attitude_rate", _rate_text(facts.rate_hz, facts.rate_min_hz))
    if facts.attitude_refused is not None:
        yield Refusal("attitude_refused", facts.attitude_refused or "the autopilot cannot be given attitude and thrust")
    if control_mode is ControlMode.RAW and facts.raw_refused is not None:
        yield Refusal("raw_refused", facts.raw_refused)


def _too_old(age_s: float, limit_s: float) -> bool:
    """True also for NaN and for times in the future, whose age is unknown."""
    return not -FUTURE_SLACK_S <= age_s <= limit_s


def _age_text(age_s: float, limit_s: float, what: str) -> str:
    return f"state is {age_s:.2f} s old (limit for {what} {limit_s:g} s)"


def _delay_text(facts: GuardFacts, limit_s: float, control_mode: ControlMode) -> str:
    limit = f"limit for {control_mode} {limit_s:g} s"
    if facts.pings_overdue:
        least = f"at least {facts.delay_p95_s:.3f} s, by pings that are not answered"
        return f"state age plus setpoint transport is {least} ({limit})"
    return f"state age plus setpoint transport is {facts.delay_p95_s:.3f} s in 95 of 100 ticks ({limit})"


def _rate_text(rate_hz: float, least_hz: float) -> str:
    """Text with the average delay by holding a setpoint: half a period."""
    text = f"the link leaves {rate_hz:.3g} setpoints per second (attitude needs {least_hz:.3g})"
    if rate_hz > 0 and least_hz > 0:
        text += (
            f": each is held until the next, on average {0.5 / rate_hz:.3f} s of additional delay, "
            f"instead of {0.5 / least_hz:.3f} s"
        )
    return text
