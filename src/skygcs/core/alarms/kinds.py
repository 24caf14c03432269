"""The kinds of alarms, and the events and states that raise and end them. Pure.

    kind          raised by                                      over when                                 on the ground
    -----------   --------------------------------------------   ---------------------------------------   -------------
    lost          vehicle_lost                                   it is heard again, or forgotten           warning
    deaf          uplink_lost: it does not hear us               uplink_back                               warning
    battery       charge at or below `[alarms]`                  2 % above the limit                       warning
    failsafe      failsafe                                       its failsafe is over                      alarm
    stop          an emergency stop refused or unanswered        another order stops or ends its flight    alarm
    takeoff       a take-off at a wrong height                   it is disarmed                            alarm
    return        it waited for its return, which was given up   it is ordered to return, land or stop     alarm
    guard         control held by the guard                      control goes on or ends                   alarm
    unattended    it follows setpoints and nobody flies it       at once; it stays until acknowledged      warning
    fence         it is outside its autopilot's fence            it is inside again; a PX4: disarmed       warning
    separation    a conflict of level warning or action          the conflict is over                      alarm
    unwatched     the monitor cannot watch it                    it is watched again                       warning
    duplicate     two vehicles with one system id                only one is left                          alarm
    plan          a plan stopped or aborted                      a plan flies again, or is over            alarm
    ground        a companion has lost its ground                at once                                   alarm
    recorder      the disk is full or fails: no recording        it records again, or skygcs restarts      alarm
    operator      nobody at the controls, and vehicles flew      at once                                   alarm
    autopilot     a text of level critical and above             at once                                   warning
    fault         a fault inside skygcs                          at once                                   alarm

The last column is the severity of a vehicle that is known to be disarmed; else it is an alarm, but for `unwatched` and
what the table of thresholds says.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from skygcs.events import Event

Severity = Literal["alarm", "warning"]

EVERY = "*"
"""Kind of a signal that stands for every alarm of the vehicle."""

HYSTERESIS_PERCENT = 2
"""A battery's charge is estimated from its voltage, which rises when it is used less."""

CRITICAL_LEVEL = 2
"""MAV_SEVERITY_CRITICAL; emergency and alert are below."""

BEFORE_FLIGHT = re.compile(r"^(PreArm|Arm:|Preflight Fail|Arming denied)", re.IGNORECASE)
"""Texts that an autopilot repeats on the ground until it may be armed."""

STOPS = frozenset({"stop", "hold", "land", "rtl", "disarm"})
"""Orders after which an emergency stop that failed is no concern any more."""

RETURNED = STOPS - {"hold"}
"""Orders after which nobody waits for a return that was given up."""

CONSEQUENCES: Mapping[str, frozenset[str]] = {
    "lost": frozenset({"separation", "unwatched", "deaf", "battery", "guard", "unattended", "autopilot"}),
    "deaf": frozenset({"guard", "stop", "unattended"}),
}
"""Kinds that follow from a cause, by kind of the cause, for the same vehicle. They are counted with it and raise no
alarms."""


OF_THE_PROCESS = frozenset({"recorder"})
"""Kinds whose condition ends with the daemon that has it; the next one raises them anew."""


class VehicleFacts(NamedTuple):
    """Facts known of a vehicle when something happens to it; None: it is not known."""

    armed: bool | None = None


class Signal(NamedTuple):
    """A condition that has begun, or is over. ``other``: the second vehicle it concerns. ``lasts`` False: it has no end
    of its own, and its alarm stays until it is acknowledged."""

    kind: str
    vehicle: str | None
    raised: bool
    text: str = ""
    severity: Severity = "alarm"
    other: str | None = None
    lasts: bool = True


Rule = Callable[[Event, VehicleFacts], list[Signal]]


def signals(event: Event, facts: VehicleFacts) -> list[Signal]:
    """Return what an event begins or ends."""
    rule = RULES.get(event.kind)
    return [] if rule is None else rule(event, facts)


def battery(vehicle: str, percent: float, limits: tuple[float, float], facts: VehicleFacts) -> Signal | None:
    """Return what a battery's charge begins or ends. ``limits``: low and critical, in percent."""
    low, critical = limits
    if percent > low + HYSTERESIS_PERCENT:
        return Signal("battery", vehicle, False)
    if percent > low:
        return None
    severity: Severity = "alarm" if percent <= critical and facts.armed is not False else "warning"
    limit = critical if percent <= critical else low
    return Signal("battery", vehicle, True, f"battery {percent:.0f} % (limit {limit:g} %)", severity)


def _grounded(facts: VehicleFacts) -> Severity:
    return "warning" if facts.armed is False else "alarm"


def _lost(event: Event, facts: VehicleFacts) -> list[Signal]:
    if event.data.get("forgotten"):
        return [Signal(EVERY, event.vehicle, False)]
    return [Signal("lost", event.vehicle, True, event.text, _grounded(facts))]


def _deaf(event: Event, facts: VehicleFacts) -> list[Signal]:
    return [Signal("deaf", event.vehicle, True, f"does not hear us: {event.text}", _grounded(facts))]


def _failsafe(event: Event, _: VehicleFacts) -> list[Signal]:
    return [Signal("failsafe", event.vehicle, event.data.get("failsafe") is not False, event.text)]


def _command(event: Event, _: VehicleFacts) -> list[Signal]:
    order, ok = event.data.get("order"), event.data.get("ok")
    if ok and order in STOPS:
        returned = [Signal("return", event.vehicle, False)] if order in RETURNED else []
        return [Signal("stop", event.vehicle, False), *returned]
    if order == "rtl" and ok is None and event.data.get("result") == "failed":
        return [Signal("return", event.vehicle, True, event.text)]
    if order != "stop" or ok is not False or event.data.get("result") == "cancelled":
        return []
    return [Signal("stop", event.vehicle, True, f"did not stop: {event.data.get('message') or event.text}")]


def _takeoff(event: Event, _: VehicleFacts) -> list[Signal]:
    return [Signal("takeoff", event.vehicle, True, event.text)]


def _disarmed(event: Event, _: VehicleFacts) -> list[Signal]:
    return [Signal(kind, event.vehicle, False) for kind in ("takeoff", "stop", "return", "guard", "unwatched")]


def _control(event: Event, _: VehicleFacts) -> list[Signal]:
    return [Signal("guard", event.vehicle, event.data.get("state") == "held", event.text)]


def _fence(event: Event, facts: VehicleFacts) -> list[Signal]:
    outside = event.data.get("outside")
    return [] if outside is None else [Signal("fence", event.vehicle, bool(outside), event.text, _grounded(facts))]


def _separation(event: Event, _: VehicleFacts) -> list[Signal]:
    data = event.data
    if (watched := data.get("watched")) is not None:
        return [Signal("unwatched", event.vehicle, not watched, event.text, "warning")]
    raised = data.get("level") in ("warning", "action") or data.get("order") == "hold"
    if (lost := data.get("lost")) is not None:  # the place of one that was lost: its end is not seen
        return [Signal("separation", event.vehicle, raised, event.text, other=lost, lasts=False)]
    return [Signal("separation", event.vehicle, raised, event.text, other=data.get("with"))]


def _duplicate(event: Event, _: VehicleFacts) -> list[Signal]:
    return [Signal("duplicate", event.vehicle, event.data.get("change") != "duplicate_over", event.text)]


def _plan(event: Event, _: VehicleFacts) -> list[Signal]:
    state = event.data.get("state")
    if state is None:
        return []
    return [Signal("plan", None, state in ("stopped", "aborting", "aborted"), event.text)]


def _recorder(event: Event, _: VehicleFacts) -> list[Signal]:
    recording = event.data.get("recording")
    return [] if recording is None else [Signal("recorder", None, not recording, event.text)]


def _warning(event: Event, _: VehicleFacts) -> list[Signal]:
    if "action" not in event.data or "vehicles" not in event.data:
        return []
    return [Signal("operator", None, True, event.text, lasts=False)]


def _statustext(event: Event, facts: VehicleFacts) -> list[Signal]:
    level = event.data.get("level")
    if not isinstance(level, int) or level > CRITICAL_LEVEL or BEFORE_FLIGHT.match(event.text):
        return []
    return [Signal("autopilot", event.vehicle, True, event.text, _grounded(facts), lasts=False)]


def _lasting(kind: str) -> Rule:
    """The rule of what stays until it is acknowledged."""
    return lambda event, facts: [Signal(kind, event.vehicle, True, event.text, _grounded(facts), lasts=False)]


def _over(kind: str) -> Rule:
    return lambda event, facts: [Signal(kind, event.vehicle, False)]


RULES: Mapping[str, Rule] = {
    "vehicle_discovered": _over(EVERY),
    "vehicle_forgotten": _over(EVERY),
    "vehicle_lost": _lost,
    "vehicle_back": _over("lost"),
    "uplink_lost": _deaf,
    "uplink_back": _over("deaf"),
    "failsafe": _failsafe,
    "command": _command,
    "takeoff": _takeoff,
    "disarmed": _disarmed,
    "control": _control,
    "unattended": _lasting("unattended"),
    "fence": _fence,
    "separation": _separation,
    "duplicate": _duplicate,
    "plan": _plan,
    "recorder": _recorder,
    "ground_lost": _lasting("ground"),
    "warning": _warning,
    "statustext": _statustext,
    "fault": lambda event, facts: [Signal("fault", event.vehicle, True, event.text, lasts=False)],
}
"""By the kind of the event."""


def as_text(value: Any) -> str:
    """A value of a saved alarm as text, without control characters."""
    return "".join(c for c in str(value) if c.isprintable())[:500]
