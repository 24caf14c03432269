"""Alarms of the daemon: which events and states need a person, what belongs to one cause, and what was acknowledged.

The kinds of alarms, and the events and states that raise and end them:

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
    keys          a companion cannot read its keys any more      it can, or restarts; the ground: at once  alarm
    operator      nobody at the controls, and vehicles flew      at once                                   alarm
    autopilot     a text of level critical and above             at once                                   warning
    fault         a fault inside skygcs                          at once                                   alarm

The last column is the severity of a vehicle that is known to be disarmed; else it is an alarm, but for `unwatched` and
what the table of thresholds says.

The open and acknowledged alarms of a daemon (`Alarms`):

    state of an alarm      its condition begins        its condition is over    a person acknowledges it
    --------------------   -------------------------   ----------------------   ------------------------
    (none)                 open                        -                        -
    open                   open, counted               open, over               acknowledged
    open, over             open, counted               -                        (none)
    acknowledged           acknowledged, counted       (none)                   -
    acknowledged, worse    open: a warning became an alarm

Alarms of one cause are one: while a vehicle is lost, what follows from that (`CONSEQUENCES`) is counted with it, and
what followed from it already and nobody has acknowledged goes into it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple, get_args

from skygcs.events import Event

# --- kinds ------------------------------------------------------------------------------------------------------------

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


OF_THE_PROCESS = frozenset({"recorder", "keys"})
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


def _companion(event: Event, _: VehicleFacts) -> list[Signal]:
    change, here = event.data.get("change"), event.vehicle is None  # else the ground heard it, and may miss its end
    if change not in ("keys_kept", "keys_read"):
        return []
    return [Signal("keys", event.vehicle, change == "keys_kept", event.text, lasts=here)]


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
    "companion": _companion,
    "ground_lost": _lasting("ground"),
    "warning": _warning,
    "statustext": _statustext,
    "fault": lambda event, facts: [Signal("fault", event.vehicle, True, event.text, lasts=False)],
}
"""By the kind of the event."""


# --- severity of events -----------------------------------------------------------------------------------------------

EventSeverity = Literal["alarm", "warning", "info"]

SEVERITIES: tuple[EventSeverity, ...] = get_args(EventSeverity)
"""The gravest first."""

WARNING_LEVEL = 4
"""MAV_SEVERITY_WARNING."""

WARNINGS = frozenset({"warning", "conflict", "link_degraded", "undo", "reboot"})
"""Kinds that report a change to the worse, whatever is in them."""

WARNING_RESULTS = frozenset({"failed", "denied", "timeout", "lost", "refused", "unsupported"})


def severity_of(event: Event, facts: VehicleFacts) -> EventSeverity:
    """Return the severity of the alarm that the event raises; of an event that raises none: warning for a change to the
    worse, else info."""
    if event.kind == "alarm":  # one that comes from a state has no other event
        news = event.data.get("change") == "raised" and not event.data.get("logged")
        return event.data["severity"] if news else "info"
    raised = [signal.severity for signal in signals(event, facts) if signal.raised]
    if raised:
        return "alarm" if "alarm" in raised else "warning"
    return "warning" if _is_worse(event) else "info"


def _is_worse(event: Event) -> bool:
    """True if an event that raises no alarm reports a change to the worse."""
    data = event.data
    match event.kind:
        case "statustext":
            level = data.get("level")
            return isinstance(level, int) and level <= WARNING_LEVEL
        case "command":
            outcome = data if "result" in data or "ok" in data else data.get("outcome") or {}
            return outcome.get("ok") is False or outcome.get("result") in WARNING_RESULTS
        case "separation":
            return data.get("level") == "notice"
        case "vehicle_lost":
            return True
        case "recorder":  # it records again, and has lost something
            return "error" in data or bool(data.get("lost"))
        case "link_down":
            return not data.get("finished")
        case kind:
            return kind in WARNINGS


def event_record(event: Event, unix_s: float, facts: VehicleFacts) -> dict[str, Any]:
    """Return the event as RPC clients and pages get it."""
    return {
        "time_unix_s": round(unix_s, 3),
        "kind": event.kind,
        "vehicle": event.vehicle,
        "sysid": event.sysid,
        "severity": severity_of(event, facts),
        "text": event.text,
        "data": event.data,
    }


def with_severity(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the record of another daemon's event with a severity. One of an earlier version has none: it gets that of
    a vehicle that may be armed. Where its data have another shape it is a warning, so that somebody sees it."""
    if record.get("severity") in SEVERITIES:
        return dict(record)
    try:
        event = Event(record["kind"], record.get("vehicle"), record.get("sysid"), record["text"], record["data"])
        severity: Any = severity_of(event, VehicleFacts())
    except (KeyError, TypeError, AttributeError):
        severity = None
    return {**record, "severity": severity if severity in SEVERITIES else "warning"}


def as_text(value: Any) -> str:
    """A value of a saved alarm as text, without control characters."""
    return "".join(c for c in str(value) if c.isprintable())[:500]


# --- alarms -----------------------------------------------------------------------------------------------------------


MAX_ALARMS = 500
"""A few for each of 300 vehicles; further ones displace those whose condition is over, the oldest first."""

BEFORE_CAUSE_S = 15.0
"""A vehicle is called lost after a few seconds of silence; what happened to it in that time has the same cause."""

FORMAT = 1


@dataclass(slots=True)
class Alarm:
    """One alarm. Times are seconds of the Unix clock: they outlive the daemon."""

    number: int
    kind: str
    vehicle: str | None
    other: str | None
    severity: Severity
    text: str
    raised_unix_s: float
    changed_unix_s: float
    active: bool = True
    """Its condition lasts."""
    count: int = 1
    consequences: dict[str, int] = field(default_factory=dict)
    """Number of its consequences, by kind of alarm."""
    acknowledged_by: str | None = None
    acknowledged_unix_s: float | None = None

    @property
    def open(self) -> bool:
        """True until somebody acknowledges it."""
        return self.acknowledged_by is None

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {name: getattr(self, name) for name in _FIELDS} | {"consequences": dict(self.consequences)}


_FIELDS = tuple(each.name for each in fields(Alarm))


_Key = tuple[str, str | None, str | None]


class Alarms:
    """Those of one daemon."""

    def __init__(self) -> None:
        self.changes = 0
        """Number of changes. That a person has acknowledged an alarm is not counted."""
        self.displaced = 0
        """Alarms that made room for others."""
        self._by_key: dict[_Key, Alarm] = {}
        self._last_number = 0

    def all(self) -> list[Alarm]:
        """Open alarms first, the newest first."""
        return sorted(self._by_key.values(), key=lambda alarm: (not alarm.open, -alarm.number))

    def take(self, signal: Signal, now_unix_s: float) -> Alarm | None:
        """A condition begins or is over. Returns the alarm that a person has to be told of anew: a new one, or one that
        became worse; None: nothing new."""
        if not signal.raised:
            self._end(signal, now_unix_s)
            return None
        self.changes += 1
        if (cause := self._cause(signal)) is not None:
            cause.consequences[signal.kind] = cause.consequences.get(signal.kind, 0) + 1
            cause.changed_unix_s = now_unix_s
            return None
        alarm = self._by_key.get(key := _key(signal))
        if alarm is None:
            return self._add(key, signal, now_unix_s)
        worse = signal.severity == "alarm" != alarm.severity
        news = worse or (signal.lasts and not alarm.active)
        alarm.severity, alarm.text, alarm.changed_unix_s = signal.severity, signal.text, now_unix_s
        alarm.count += 1
        alarm.active = signal.lasts
        if news:
            alarm.acknowledged_by = alarm.acknowledged_unix_s = None
        return alarm if news else None

    def acknowledge(self, numbers: Collection[int] | None, by: str, now_unix_s: float) -> list[Alarm]:
        """Acknowledge open alarms, by their numbers or (None) all; returns those that were open."""
        done = [a for a in self.all() if a.open and (numbers is None or a.number in numbers)]
        for alarm in done:
            alarm.acknowledged_by, alarm.acknowledged_unix_s = by, now_unix_s
            if not alarm.active:
                self._drop(alarm)
        return done

    # -- a file

    def saved(self) -> dict[str, Any]:
        """JSON-able, for `restore`."""
        return {"format": FORMAT, "last": self._last_number, "alarms": [a.as_dict() for a in self._by_key.values()]}

    def restore(self, saved: Any) -> None:
        """Take over what `saved` returned. Raises ValueError, TypeError, KeyError for anything else."""
        if saved["format"] != FORMAT:
            raise ValueError(f"format {saved['format']!r}")
        alarms = [_read(entry) for entry in saved["alarms"][:MAX_ALARMS]]
        self._by_key = {(alarm.kind, alarm.vehicle, alarm.other): alarm for alarm in alarms}
        self._last_number = max([int(saved["last"]), *(alarm.number for alarm in alarms)])

    # -- private

    def _add(self, key: _Key, signal: Signal, now_unix_s: float) -> Alarm:
        if len(self._by_key) >= MAX_ALARMS:
            self._displace()
        self._last_number += 1
        alarm = Alarm(
            self._last_number,
            signal.kind,
            signal.vehicle,
            signal.other,
            signal.severity,
            signal.text,
            now_unix_s,
            now_unix_s,
            active=signal.lasts,
        )
        for earlier in list(self._by_key.values()):
            if earlier.open and now_unix_s - earlier.changed_unix_s <= BEFORE_CAUSE_S and _follows(earlier, alarm):
                alarm.consequences[earlier.kind] = alarm.consequences.get(earlier.kind, 0) + earlier.count
                self._drop(earlier)
        self._by_key[key] = alarm
        return alarm

    def _cause(self, signal: Signal) -> Alarm | None:
        """The alarm that this follows from."""
        return next((alarm for alarm in self._by_key.values() if alarm.active and _follows(signal, alarm)), None)

    def _end(self, signal: Signal, now_unix_s: float) -> None:
        for alarm in list(self._by_key.values()):
            if alarm.vehicle != signal.vehicle or signal.kind not in (EVERY, alarm.kind) or not alarm.active:
                continue
            if signal.other is not None and alarm.other != signal.other:
                continue
            alarm.active, alarm.changed_unix_s = False, now_unix_s
            self.changes += 1
            if not alarm.open:
                self._drop(alarm)

    def _displace(self) -> None:
        """Remove the alarm that is needed least: one that is over before one that lasts, a warning before an alarm."""
        least = min(self._by_key.values(), key=lambda a: (a.active, a.open, a.severity == "alarm", a.number))
        self._drop(least)
        self.displaced += 1

    def _drop(self, alarm: Alarm) -> None:
        self._by_key.pop((alarm.kind, alarm.vehicle, alarm.other), None)


def _key(signal: Signal) -> _Key:
    return signal.kind, signal.vehicle, signal.other


def _follows(effect: Alarm | Signal, cause: Alarm) -> bool:
    """True if an alarm of this kind follows from the cause."""
    if effect.kind not in CONSEQUENCES.get(cause.kind, ()) or cause.vehicle is None:
        return False
    return cause.vehicle in (effect.vehicle, effect.other)


def _read(entry: Mapping[str, Any]) -> Alarm:
    """One saved alarm. Raises ValueError, TypeError, KeyError."""
    severity: Severity = "warning" if entry["severity"] == "warning" else "alarm"
    names = [None if entry[key] is None else as_text(entry[key]) for key in ("vehicle", "other", "acknowledged_by")]
    at = entry["acknowledged_unix_s"]
    return Alarm(
        int(entry["number"]),
        as_text(entry["kind"]),
        names[0],
        names[1],
        severity,
        as_text(entry["text"]),
        float(entry["raised_unix_s"]),
        float(entry["changed_unix_s"]),
        active=entry["active"] is True,
        count=int(entry["count"]),
        consequences=_counts(entry["consequences"].items()),
        acknowledged_by=names[2],
        acknowledged_unix_s=None if at is None else float(at),
    )


def _counts(items: Iterable[tuple[Any, Any]]) -> dict[str, int]:
    return {as_text(kind): int(count) for kind, count in list(items)[:50]}
