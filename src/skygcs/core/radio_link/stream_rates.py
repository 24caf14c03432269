"""Which message at which rate from each vehicle behind one radio, so that all of them together fit.

Pure. `fit` divides what the radio carries down among the vehicles; `Downlink` says how much that is now, from losses
and the radio's own state; `RateController` has one vehicle follow its part: what it is asked for is verified by what
comes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skygcs.core.radio_link.capacity import FRAME_BYTES, PROFILES
from skygcs.core.radio_link.requested_streams import STREAM_GROUPS

POSITION = "GLOBAL_POSITION_INT"
"""What a fleet is watched by: it is slowed down last."""

POSITION_FLOOR_HZ = 0.2
"""However little room there is: a position every five seconds."""

OTHERS_FLOOR = 0.2
"""Of their wanted rates, before the position is slowed down, too."""

GRID_HZ = (
    0.05,
    0.1,
    0.2,
    0.25,
    0.33,
    0.5,
    0.66,
    1.0,
    1.33,
    2.0,
    2.5,
    3.0,
    4.0,
    5.0,
    6.0,
    8.0,
    10.0,
    15.0,
    20.0,
    25.0,
    50.0,
)
"""Rates that are asked for. Steps of a quarter and more: a vehicle more or less does not change everybody's."""

NORMAL, SELECTED, CONTROLLED = 1.0, 2.0, 4.0
"""Weights: of one byte for a vehicle nobody looks at, an operator's vehicle gets two, one flown by setpoints four."""

KEPT = frozenset(
    {
        "HEARTBEAT",
        "STATUSTEXT",
        "COMMAND_ACK",
        "PARAM_VALUE",
        "AUTOPILOT_VERSION",
        "PROTOCOL_VERSION",
        "MESSAGE_INTERVAL",
        "TIMESYNC",
        "PING",
        "MISSION_ACK",
        "MISSION_COUNT",
        "MISSION_REQUEST",
        "MISSION_REQUEST_INT",
        "MISSION_ITEM",
        "MISSION_ITEM_INT",
        "MISSION_ITEM_REACHED",
        "FILE_TRANSFER_PROTOCOL",
        "LOG_ENTRY",
        "LOG_DATA",
        "EVENT",
        "CURRENT_EVENT_SEQUENCE",
        "RESPONSE_EVENT_ERROR",
        "HIGH_LATENCY2",
    }
)
"""Never turned off: heartbeats, and what is said once, in answer to somebody or because something happened."""

GRACE_S = 1.0
"""After a vehicle is met."""

STEP_S = 0.1
"""Between two requests to one vehicle."""

SETTLE_S = 2.0
"""After a request what comes is not judged: it takes two rounds of a large network to be heard and obeyed."""

COMING_S, QUIET_S = 3.0, 12.0
"""Two of a message within the former that nobody wants: it streams. Fewer within the latter: it does not."""

PERIODS = 5.0
LEAST_WINDOW_S = 5.0
"""A wanted message is judged over so many of its periods, and so long at least."""

SLOW, FAST = 0.5, 1.5
"""Of the wanted rate, what is taken for it: a radio loses a part, and firmwares round."""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 3.0, 60.0
"""Before a request is repeated that did nothing; growing."""

HINT_AFTER = 4
"""Requests in vain before a person is told."""

SILENCES = 3
"""Times that an ArduPilot is told to stop all of its streams at once."""


def profile_rates(name: str) -> dict[str, float]:
    """Hz of each message of a profile, without the heartbeat, which nobody asks for. KeyError for an unknown name."""
    return {message: hz for message, hz in PROFILES[name].items() if message != "HEARTBEAT"}


@dataclass(frozen=True, slots=True)
class RateDemand:
    """What one vehicle would send if there were room."""

    rates_hz: Mapping[str, float]
    weight: float = NORMAL


def fit(
    demands: Mapping[int, RateDemand], total_bytes_per_s: float, each_bytes_per_s: float, frame_bytes: Mapping[str, int]
) -> dict[int, dict[str, float]]:
    """Hz of each message from each vehicle, so that all heartbeats and streams are within ``total_bytes_per_s`` and no
    vehicle's above ``each_bytes_per_s`` (its own timeslot), as far as the floors allow.

    Room is divided by the wishes' weights; who wants less leaves the rest to the others. ``frame_bytes`` by message.
    """
    beat = FRAME_BYTES["HEARTBEAT"]
    wanted = {key: _bytes(demand.rates_hz, frame_bytes) for key, demand in demands.items()}
    left = max(0.0, total_bytes_per_s - beat * len(demands))
    given = dict.fromkeys(demands, 0.0)
    open_keys = {key for key in demands if wanted[key] > 0}
    while open_keys and left > 1e-6:
        per_weight = left / sum(demands[key].weight for key in open_keys)
        limits = {key: min(wanted[key], max(0.0, each_bytes_per_s - beat)) for key in open_keys}
        sated = {key for key in open_keys if limits[key] - given[key] <= per_weight * demands[key].weight}
        for key in sated or open_keys:
            share = limits[key] - given[key] if sated else per_weight * demands[key].weight
            given[key] += share
            left -= share
        open_keys -= sated or open_keys
    return {key: _within(demand.rates_hz, given[key], frame_bytes) for key, demand in demands.items()}


def on_grid(rate_hz: float) -> float:
    """The next lower rate of the grid; the lowest for anything below it."""
    lower = [hz for hz in GRID_HZ if hz <= rate_hz + 1e-9]
    return lower[-1] if lower else GRID_HZ[0]


def intended_rate(measured_hz: float) -> float:
    """The rate that was asked for, of what is measured: up to a tenth is lost on the way. 0 for nothing."""
    if measured_hz < GRID_HZ[0]:
        return 0.0
    return next((hz for hz in GRID_HZ if hz >= 0.9 * measured_hz), measured_hz)


def plan_bytes_per_s(rates_hz: Mapping[str, float], frame_bytes: Mapping[str, int]) -> float:
    """Of one vehicle, its heartbeat included."""
    return FRAME_BYTES["HEARTBEAT"] + _bytes(rates_hz, frame_bytes)


def _bytes(rates_hz: Mapping[str, float], frame_bytes: Mapping[str, int]) -> float:
    return sum(hz * frame_bytes[name] for name, hz in rates_hz.items())


def _within(rates_hz: Mapping[str, float], room: float, frame_bytes: Mapping[str, int]) -> dict[str, float]:
    """The rates that fit: first the others are slowed down to their floor, then the position to its own."""
    wanted = {name: hz for name, hz in rates_hz.items() if hz > 0}
    if _bytes(wanted, frame_bytes) <= room + 1e-6:
        return wanted
    position = wanted.get(POSITION, 0.0) * frame_bytes.get(POSITION, 0)
    others = _bytes(wanted, frame_bytes) - position
    scale = max(OTHERS_FLOOR, (room - position) / others) if others else 1.0
    left = room - scale * others
    result = {name: on_grid(hz * min(1.0, scale)) for name, hz in wanted.items() if name != POSITION}
    if POSITION in wanted:
        held = min(wanted[POSITION], max(POSITION_FLOOR_HZ, left / frame_bytes[POSITION]))
        result = {POSITION: wanted[POSITION] if held == wanted[POSITION] else on_grid(held), **result}
    return result


LOSS_HIGH, LOSS_LOW = 0.15, 0.05
WORSE_AFTER_S, BETTER_AFTER_S = 8.0, 30.0
WORSE, BETTER, LEAST = 0.75, 1.15, 0.3
"""More is lost than the former for so long: the streams get this much of what they had. Less than the latter for
longer: they get more again, and never less than the least. Two marks and two times: it does not chatter."""

TXBUF_LOW = 0.15
"""Of the ground radio's buffer free: the air is so full of what comes down that what is to go up does not get out."""


class Downlink:
    """What share of the planned downlink the streams get; `look` once a second."""

    def __init__(self) -> None:
        self.factor = 1.0
        self._bad_since: float | None = None
        self._good_since: float | None = None

    def look(self, loss: float | None, txbuf_free: float | None, now: float) -> bool:
        """Whether the factor changed. ``loss``: of all vehicles' frames lately, None if not known."""
        bad = (loss is not None and loss > LOSS_HIGH) or (txbuf_free is not None and txbuf_free < TXBUF_LOW)
        good = not bad and (loss is None or loss < LOSS_LOW)
        self._bad_since = (self._bad_since if self._bad_since is not None else now) if bad else None
        self._good_since = (self._good_since if self._good_since is not None else now) if good else None
        before = self.factor
        if self._bad_since is not None and now - self._bad_since >= WORSE_AFTER_S:
            self.factor, self._bad_since = max(LEAST, self.factor * WORSE), now
        elif self._good_since is not None and now - self._good_since >= BETTER_AFTER_S:
            self.factor, self._good_since = min(1.0, self.factor * BETTER), now
        return self.factor != before


@dataclass(frozen=True, slots=True)
class RateRequest:
    """One request to a vehicle. ``rate_hz`` 0 turns it off. Exactly one of ``message`` (SET_MESSAGE_INTERVAL) and
    ``stream`` (REQUEST_DATA_STREAM; 0 is all of them)."""

    message: str | None
    rate_hz: float
    stream: int | None = None


@dataclass(slots=True)
class _Watch:
    """One message of one vehicle: how many came since when, and what was asked."""

    since: float
    count: int
    right: bool | None = None
    """Whether it comes as planned; None: not known yet."""
    asked_at: float | None = None
    pause_s: float = FIRST_PAUSE_S
    asked: int = 0
    hz: float = 0.0
    """Of the last look."""


@dataclass(slots=True)
class RateController:
    """Has one vehicle follow its plan. `plan` whenever it changes, `due` some times a second: what to ask next.

    Requests are not waited for: an acknowledgement over a shared radio takes as long as several of them, and what
    comes tells more. ``old``: the firmware does not know SET_MESSAGE_INTERVAL.
    """

    rates_hz: dict[str, float] = field(default_factory=dict)
    old: bool = False
    _left: set[str] = field(default_factory=set)
    _watches: dict[str, _Watch] = field(default_factory=dict)
    _met_at: float | None = None
    _stepped_at: float = float("-inf")
    _silenced: int = 0
    _silenced_at: float = float("-inf")
    _groups: dict[int, float] = field(default_factory=dict)
    """Of an old firmware: the rate each group was asked for."""

    def plan(self, rates_hz: Mapping[str, float]) -> bool:
        """What it is to send from now on; whether anything changed. What changed is asked for anew."""
        changed = {n for n in {*rates_hz, *self.rates_hz} if rates_hz.get(n) != self.rates_hz.get(n)}
        for name in changed:
            self._watches.pop(name, None)
        self.rates_hz = dict(rates_hz)
        return bool(changed)

    def restart(self) -> None:
        """The vehicle rebooted or came back: what it was asked for is forgotten there."""
        self._watches.clear()
        self._left.clear()
        self._groups.clear()
        self._met_at = None
        self._silenced = 0
        self._silenced_at = float("-inf")
        self.old = False

    def leave(self, name: str) -> None:
        """A person took the rate of this message in hand."""
        self._left.add(name)

    @property
    def settled(self) -> bool:
        """Whether every planned message was asked for and none is known to come wrongly."""
        return all(
            name in self._left or ((watch := self._watches.get(name)) is not None and watch.right is not False)
            for name in self.rates_hz
        )

    def unresponsive(self) -> list[tuple[str, float]]:
        """(message, Hz) of what still comes although it was asked to cease again and again."""
        return [
            (name, watch.hz)
            for name, watch in self._watches.items()
            if name not in self.rates_hz and watch.asked >= HINT_AFTER and watch.right is not True
        ]

    def due(
        self, counts: Mapping[str, int], now: float, *, ardupilot: bool, frame_bytes: Mapping[str, int]
    ) -> RateRequest | None:
        """What to ask for now. ``counts``: how often each message has come, whenever."""
        if self._met_at is None:
            self._met_at = now
        for name in counts.keys() | self.rates_hz.keys():
            if name not in KEPT:
                self._look(name, counts.get(name, 0), now)
        if now < self._met_at + GRACE_S or now < self._stepped_at + STEP_S:
            return None
        ask = self._silence(counts, now) if ardupilot else None
        if ask is None:
            ask = self._next_group(now) if self.old and ardupilot else self._next(now, frame_bytes)
        if ask is not None:
            self._stepped_at = now
        return ask

    def _silence(self, counts: Mapping[str, int], now: float) -> RateRequest | None:
        """One frame stops all streams of an ArduPilot; it goes out before anything is asked for, and again while
        more comes than could by chance."""
        if self._silenced >= SILENCES or now < self._silenced_at + SETTLE_S + COMING_S:
            return None
        flooding = [n for n, w in self._watches.items() if n not in self.rates_hz and w.right is False]
        if self._silenced and len(flooding) < 3:
            return None
        self._silenced += 1
        self._silenced_at = now
        self._groups.clear()
        for name, watch in self._watches.items():  # it stops what was asked for as well
            if name in self.rates_hz:
                watch.right = None
                watch.asked_at = None
            watch.since, watch.count = now + SETTLE_S, counts.get(name, 0)
        return RateRequest(None, 0.0, 0)

    def _look(self, name: str, count: int, now: float) -> None:
        watch = self._watches.get(name)
        if watch is None:
            self._watches[name] = _Watch(now, count)
            return
        past_s = now - watch.since
        if past_s <= 0:
            watch.count = count
            return
        came, wanted = count - watch.count, self.rates_hz.get(name, 0.0)
        if wanted <= 0:
            if (past_s >= COMING_S and came >= 2) or past_s >= QUIET_S:
                self._judge(watch, came < 2, came / past_s, count, now)
        elif past_s >= max(LEAST_WINDOW_S, PERIODS / wanted):
            expected = wanted * past_s
            right = SLOW * expected - 1 <= came <= FAST * expected + 1
            self._judge(watch, right, came / past_s, count, now)

    def _judge(self, watch: _Watch, right: bool, hz: float, count: int, now: float) -> None:
        watch.right, watch.hz, watch.since, watch.count = right, hz, now, count
        if right:
            watch.pause_s, watch.asked = FIRST_PAUSE_S, min(watch.asked, 1)

    def _next(self, now: float, frame_bytes: Mapping[str, int]) -> RateRequest | None:
        """The flood with most bytes first, then what is wanted, the position before all."""

        def may(name: str) -> bool:
            watch = self._watches[name]
            return name not in self._left and (watch.asked_at is None or now >= watch.asked_at + watch.pause_s)

        floods = [n for n, w in self._watches.items() if n not in self.rates_hz and w.right is False and may(n)]
        if floods:
            worst = max(floods, key=lambda n: self._watches[n].hz * frame_bytes.get(n, 0))
            return self._asked(worst, 0.0, now)
        for name in sorted(self.rates_hz, key=lambda n: n != POSITION):
            watch = self._watches.get(name)
            if watch is None or not may(name):
                continue
            if watch.right is False or (watch.right is None and watch.asked_at is None):
                return self._asked(name, self.rates_hz[name], now)
        return None

    def _asked(self, name: str, rate_hz: float, now: float) -> RateRequest:
        watch = self._watches[name]
        window_s = max(LEAST_WINDOW_S, PERIODS / rate_hz) if rate_hz > 0 else COMING_S
        if watch.asked_at is not None:
            watch.pause_s = min(2 * watch.pause_s, LONGEST_PAUSE_S)
        watch.pause_s = max(watch.pause_s, window_s + SETTLE_S)
        watch.asked_at, watch.since, watch.right = now, now + SETTLE_S, None
        watch.asked += 1
        return RateRequest(name, rate_hz)

    def _next_group(self, now: float) -> RateRequest | None:
        """Old firmware knows whole groups at whole rates only."""
        wanted: dict[int, float] = {}
        for name, hz in self.rates_hz.items():
            group = STREAM_GROUPS.get(name)
            if group is not None and name not in self._left:
                wanted[group] = max(wanted.get(group, 0.0), 1.0, float(round(hz)))
        for group, hz in wanted.items():
            if self._groups.get(group) != hz:
                self._groups[group] = hz
                return RateRequest(None, hz, group)
        for name, watch in self._watches.items():
            group = STREAM_GROUPS.get(name)
            if name in self.rates_hz and watch.right is False and watch.hz == 0 and group is not None:
                watch.right = None
                return RateRequest(None, wanted[group], group)
        return None
