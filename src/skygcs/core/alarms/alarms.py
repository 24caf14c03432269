"""The open and acknowledged alarms of a daemon. Pure: `take` a signal, `acknowledge`, `saved` and `restore`.

    state of an alarm      its condition begins        its condition is over    a person acknowledges it
    --------------------   -------------------------   ----------------------   ------------------------
    (none)                 open                        -                        -
    open                   open, counted               open, over               acknowledged
    open, over             open, counted               -                        (none)
    acknowledged           acknowledged, counted       (none)                   -
    acknowledged, worse    open: a warning became an alarm

Alarms of one cause are one: while a vehicle is lost, what follows from that (`kinds.CONSEQUENCES`) is counted with it,
and what followed from it already and nobody has acknowledged goes into it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from skygcs.core.alarms.kinds import CONSEQUENCES, EVERY, Severity, Signal, as_text

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
        """Nobody has acknowledged it."""
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
