"""Which message a simulated vehicle sends at which rate: SET_MESSAGE_INTERVAL's meaning, on absolute deadlines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from skygcs.sim.rng import Rng

NEVER = float("inf")


class Streams:
    """Intervals per message name. A message never asked for and without a default is not sent.

    ``rng`` gives each message its own phase, so that neither the messages of one vehicle nor those of a fleet
    powered at once come in one burst.
    """

    def __init__(self, known: Iterable[str], defaults: Mapping[str, float], rng: Rng, now: float) -> None:
        self._known = frozenset(known)
        self._defaults: dict[str, float] = {}
        self._interval: dict[str, float] = {}
        self._next: dict[str, float] = {}
        self._soonest = NEVER
        self._rng = rng
        self.slowdown_s = 0.0
        """Added to every interval but the heartbeat's: what a full radio does to ArduPilot's streams."""
        self.rate_factor = 1.0
        """Factor on every rate but the heartbeat's: the effect of a full radio on PX4's streams."""
        for name, rate_hz in defaults.items():
            self.set_default(name, rate_hz, now)

    def knows(self, name: str) -> bool:
        return name in self._known

    def set_default(self, name: str, rate_hz: float, now: float) -> None:
        """The rate this message has unless asked otherwise (0: none); takes effect at once."""
        if name in self._known:
            self._defaults[name] = 1.0 / rate_hz if rate_hz > 0 else NEVER
            self.set_interval(name, None, now)

    def set_interval(self, name: str, interval_s: float | None, now: float) -> bool:
        """``interval_s`` NEVER stops the message, None is its default. False for a message this vehicle lacks."""
        if name not in self._known:
            return False
        interval = self._defaults.get(name, NEVER) if interval_s is None else interval_s
        self._interval[name] = interval
        if interval == NEVER:
            self._next.pop(name, None)
        else:
            self._next[name] = now + interval * self._rng.random()
        self._soonest = min(self._next.values(), default=NEVER)
        return True

    def interval(self, name: str) -> float:
        """Seconds between two; NEVER if not sent."""
        return self._interval.get(name, NEVER)

    def due(self, now: float) -> list[str]:
        """The messages to send now, each once."""
        if now < self._soonest:
            return []
        names = [name for name, at in self._next.items() if at <= now]
        for name in names:
            interval = self._interval[name]
            if name != "HEARTBEAT":
                interval = interval / self.rate_factor + self.slowdown_s
            following = self._next[name] + interval
            # a deadline missed by more than a whole interval (a rate above the tick's) is not made up for
            self._next[name] = following if following > now else now + interval
        self._soonest = min(self._next.values(), default=NEVER)
        return names
