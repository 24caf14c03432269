"""Brings the messages that one vehicle streams to the wanted rates, and verifies them by what arrives.

Pure. Two modes, with the same requests, pauses and bookkeeping:

- *planned* (a radio): the vehicle sends the planned messages at the planned rates and nothing else. Every other stream
  is turned off, the one with most bytes first; an ArduPilot is silenced by one frame before anything is requested.
- *not planned* (any other link): a wanted message that does not arrive is requested. Nothing that arrives already is
  slowed down or turned off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skygcs.core.radio_link.stream_rates import ARDUPILOT_ONLY, POSITION, STREAM_GROUPS

KEPT_MESSAGES = frozenset(
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
"""Never turned off: heartbeats, and what is sent once, as an answer or because something happened."""

GRACE_S, LISTEN_S = 1.0, 2.0
"""After a vehicle is met: with a plan, and without one. Without one, its own streams have this long to arrive."""

STEP_S = 0.1
"""Between two requests to one vehicle."""

SETTLE_S = 2.0
"""After a request what arrives is not judged: in a large network a request and its effect take two rounds."""

ARRIVING_S, QUIET_S = 3.0, 12.0
"""Two of an unwanted message within the former: it is streamed. Fewer within the latter: it is not."""

PERIODS = 5.0
MIN_WINDOW_S = 5.0
"""A wanted message is judged over so many of its periods, and so long at least."""

SLOW, FAST = 0.5, 1.5
"""A measured rate between these parts of the planned rate is right: radios lose frames, and firmwares round."""

SAME_INTERVAL = 1.5
"""A message that a vehicle streams with up to this much of the wanted interval is not requested."""

FIRST_PAUSE_S, MAX_PAUSE_S = 3.0, 60.0
"""Before a request without effect is repeated; the pause doubles each time."""

HINT_AFTER = 4
"""Requests without effect before an operator gets a hint."""

SILENCES = 3
"""Times that an ArduPilot is requested to stop all of its streams at once."""


@dataclass(frozen=True, slots=True)
class RateRequest:
    """One request to a vehicle. ``rate_hz`` 0 turns it off. Exactly one of ``message`` (SET_MESSAGE_INTERVAL) and
    ``stream`` (REQUEST_DATA_STREAM; 0 is all of them). ``read``: only ask at which interval it streams the message
    (GET_MESSAGE_INTERVAL)."""

    message: str | None
    rate_hz: float
    stream: int | None = None
    read: bool = False


@dataclass(slots=True)
class _Watch:
    """One message of one vehicle: how many arrived since when, and what was requested."""

    since: float
    count: int
    right: bool | None = None
    """True if it arrives as wanted; None: not known yet."""
    requested_at: float | None = None
    read_at: float | None = None
    """When its interval was asked for; None: that question is not open."""
    pause_s: float = FIRST_PAUSE_S
    requests: int = 0
    hz: float = 0.0
    """At the last judgement."""


@dataclass(slots=True)
class RateController:
    """One vehicle's. Call `plan` whenever the wanted rates change, `due` a few times a second for the next request.

    Acknowledgements are not needed: over a shared radio one takes as long as several requests, and what arrives is the
    better evidence.
    """

    rates_hz: dict[str, float] = field(default_factory=dict)
    planned: bool = False
    old: bool = False
    """The firmware does not know SET_MESSAGE_INTERVAL."""
    _left: set[str] = field(default_factory=set)
    _watches: dict[str, _Watch] = field(default_factory=dict)
    _met_at: float | None = None
    _stepped_at: float = float("-inf")
    _silenced: int = 0
    _silenced_at: float = float("-inf")

    def plan(self, rates_hz: Mapping[str, float], *, planned: bool = True) -> bool:
        """Set what the vehicle is to send from now on; return whether anything changed. What changed is requested
        anew."""
        if planned != self.planned:
            self._watches.clear()
        changed = {n for n in {*rates_hz, *self.rates_hz} if rates_hz.get(n) != self.rates_hz.get(n)}
        for name in changed:
            self._watches.pop(name, None)
        self.rates_hz = dict(rates_hz)
        self.planned = planned
        return bool(changed)

    def restart(self) -> None:
        """The vehicle rebooted or came back: it has forgotten every request."""
        self._watches.clear()
        self._left.clear()
        self._met_at = None
        self._silenced = 0
        self._silenced_at = float("-inf")
        self.old = False

    def recount(self, counts: Mapping[str, int], now: float) -> None:
        """Frames are counted otherwise from now on, or none were counted for a while: what arrives is judged anew."""
        for name, watch in self._watches.items():
            watch.since, watch.count = max(now, watch.since), counts.get(name, 0)

    def measured_hz(self) -> dict[str, float]:
        """Hz of each message when it was judged last."""
        return {name: watch.hz for name, watch in self._watches.items()}

    def leave(self, name: str) -> None:
        """Do not request this message until the vehicle restarts: an operator set its rate, or the vehicle refused."""
        self._left.add(name)

    def is_left(self, name: str) -> bool:
        """See `leave`."""
        return name in self._left

    @property
    def settled(self) -> bool:
        """True if every wanted message was requested and none is known to arrive wrongly."""
        return all(
            name in self._left or ((watch := self._watches.get(name)) is not None and watch.right is not False)
            for name in self.rates_hz
        )

    def unresponsive(self) -> list[tuple[str, float]]:
        """(message, Hz) of what still arrives after several requests to stop it."""
        return [
            (name, watch.hz)
            for name, watch in self._watches.items()
            if name not in self.rates_hz and watch.requests >= HINT_AFTER and watch.right is not True
        ]

    def on_interval(self, name: str, interval_us: float, now: float) -> None:
        """The vehicle reported at which interval it streams a message (0 or less: not at all).

        A PX4 without a position sends none at any rate. A request for 2 Hz would leave it at 2 Hz when it has one,
        instead of its own 5, for every program on the link.
        """
        watch, rate_hz = self._watches.get(name), self.rates_hz.get(name, 0.0)
        if watch is None or watch.read_at is None or rate_hz <= 0:
            return
        if 0 < interval_us <= SAME_INTERVAL * 1e6 / rate_hz:
            self._note_request(watch, rate_hz, now)
        else:
            watch.read_at = float("-inf")

    def due(
        self, counts: Mapping[str, int], now: float, *, ardupilot: bool, frame_bytes: Mapping[str, int]
    ) -> RateRequest | None:
        """The next request, if one is due. ``counts``: how often each message has arrived since the vehicle was met."""
        # watch what arrives
        if self._met_at is None:
            self._met_at = now
        for name in counts.keys() | self.rates_hz.keys() if self.planned else self.rates_hz.keys():
            if name not in KEPT_MESSAGES:
                self._watch(name, counts.get(name, 0), now)
        if now < self._met_at + (GRACE_S if self.planned else LISTEN_S) or now < self._stepped_at + STEP_S:
            return None
        # request the most urgent
        request = None
        if self.planned:
            request = (self._silence(counts, now) if ardupilot else None) or self._stop(now, ardupilot, frame_bytes)
        request = request or self._next(counts, now, ardupilot)
        if request is not None:
            self._stepped_at = now
        return request

    def _watch(self, name: str, count: int, now: float) -> None:
        watch = self._watches.get(name)
        if watch is None:
            self._watches[name] = _Watch(now, count)
            return
        past_s = now - watch.since
        if past_s <= 0:
            watch.count = count
            return
        arrived, wanted = count - watch.count, self.rates_hz.get(name, 0.0)
        if wanted <= 0:
            if (past_s >= ARRIVING_S and arrived >= 2) or past_s >= QUIET_S:
                self._judge(watch, arrived < 2, arrived / past_s, count, now)
        elif past_s >= max(MIN_WINDOW_S, PERIODS / wanted):
            expected = wanted * past_s
            right = SLOW * expected - 1 <= arrived <= FAST * expected + 1
            if self.old or not self.planned:
                right = arrived > 0  # by groups, other rates cannot be had; without a plan, every rate will do
            self._judge(watch, right, arrived / past_s, count, now)

    def _judge(self, watch: _Watch, right: bool, hz: float, count: int, now: float) -> None:
        watch.right, watch.hz, watch.since, watch.count = right, hz, now, count
        if right:
            watch.pause_s, watch.requests, watch.read_at = FIRST_PAUSE_S, min(watch.requests, 1), None

    def _silence(self, counts: Mapping[str, int], now: float) -> RateRequest | None:
        """One frame stops all streams of an ArduPilot; it is sent before anything is requested, and again while
        several messages still stream."""
        if self._silenced >= SILENCES or now < self._silenced_at + SETTLE_S + ARRIVING_S:
            return None
        flooding = [n for n, w in self._watches.items() if n not in self.rates_hz and w.right is False]
        if self._silenced and len(flooding) < 3:
            return None
        self._silenced += 1
        self._silenced_at = now
        for name, watch in self._watches.items():  # it stops what was requested as well
            if name in self.rates_hz:
                watch.right = None
                watch.requested_at = None
            watch.since, watch.count = now + SETTLE_S, counts.get(name, 0)
        return RateRequest(None, 0.0, 0)

    def _may(self, name: str, now: float) -> bool:
        watch = self._watches[name]
        return name not in self._left and (watch.requested_at is None or now >= watch.requested_at + watch.pause_s)

    def _stop(self, now: float, ardupilot: bool, frame_bytes: Mapping[str, int]) -> RateRequest | None:
        """Turn off the unwanted stream with most bytes. Old firmware knows whole groups only, and those are wanted."""
        if self.old and ardupilot:
            return None
        floods = [
            n for n, w in self._watches.items() if n not in self.rates_hz and w.right is False and self._may(n, now)
        ]
        if not floods:
            return None
        worst = max(floods, key=lambda n: self._watches[n].hz * frame_bytes.get(n, 0))
        self._note_request(self._watches[worst], 0.0, now)
        return RateRequest(worst, 0.0)

    def _next(self, counts: Mapping[str, int], now: float, ardupilot: bool) -> RateRequest | None:
        """Request a wanted message that does not arrive as wanted, the position first."""
        for name in sorted(self.rates_hz, key=lambda n: n != POSITION):
            rate_hz, watch = self.rates_hz[name], self._watches.get(name)
            if watch is None or rate_hz <= 0 or not self._may(name, now):
                continue
            if not self.planned and name in ARDUPILOT_ONLY and not ardupilot:
                continue
            # a message that was not judged yet is requested at once, without a plan only if it has never arrived
            unknown = watch.right is None and watch.requested_at is None
            if watch.right is not False and not (unknown and (self.planned or not counts.get(name))):
                continue
            if self.old and ardupilot:
                if name in STREAM_GROUPS:
                    return self._request_group(STREAM_GROUPS[name], now)
                continue
            if not self.planned and not ardupilot:
                if watch.read_at is None:
                    watch.read_at = now
                    return RateRequest(name, rate_hz, read=True)
                if now < watch.read_at + SETTLE_S:
                    continue
            self._note_request(watch, rate_hz, now)
            return RateRequest(name, rate_hz)
        return None

    def _request_group(self, group: int, now: float) -> RateRequest:
        """Old firmware knows whole groups at whole rates only."""
        members = {n: hz for n, hz in self.rates_hz.items() if STREAM_GROUPS.get(n) == group and n not in self._left}
        for name, hz in members.items():
            self._note_request(self._watches[name], hz, now)
        return RateRequest(None, max(1.0, *(float(round(hz)) for hz in members.values())), group)

    def _note_request(self, watch: _Watch, rate_hz: float, now: float) -> None:
        window_s = max(MIN_WINDOW_S, PERIODS / rate_hz) if rate_hz > 0 else ARRIVING_S
        if watch.requested_at is not None:
            watch.pause_s = min(2 * watch.pause_s, MAX_PAUSE_S)
        watch.pause_s = max(watch.pause_s, window_s + SETTLE_S)
        watch.requested_at, watch.since, watch.right = now, now + SETTLE_S, None
        watch.read_at = None
        watch.requests += 1
