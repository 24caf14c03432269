"""Filters of a channel: mavlink-router's twelve allow/block keys, and rate limits, which no router has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skygcs.core.routing.link_choice import DEFAULT_COST
from skygcs.core.token_bucket import TokenBucket

MAX_RATE_KEYS = 4096
"""Bound of one limiter's table of (source, msgid); 250 vehicles send some 20 each. Above it the table is cleared."""

BURST = 1.5
"""Tokens a message may save up: enough to take a jittering 1.0-rate stream whole, too little for two at once."""

MIN_BUCKET_BYTES = 280
"""The longest frame must fit in the byte budget at least once."""


@dataclass(frozen=True, slots=True)
class MessageFilter:
    """Allow and block sets for one direction. An empty allow set allows all; block wins over allow."""

    allow_msgids: frozenset[int] = frozenset()
    block_msgids: frozenset[int] = frozenset()
    allow_sysids: frozenset[int] = frozenset()
    block_sysids: frozenset[int] = frozenset()
    allow_compids: frozenset[int] = frozenset()
    block_compids: frozenset[int] = frozenset()

    def __bool__(self) -> bool:
        """False if it passes everything, so that it need not be called for each frame."""
        return bool(
            self.allow_msgids
            or self.block_msgids
            or self.allow_sysids
            or self.block_sysids
            or self.allow_compids
            or self.block_compids
        )

    def passes(self, msgid: int, sysid: int, compid: int) -> bool:
        """True if a frame with this header may pass."""
        return (
            msgid not in self.block_msgids
            and sysid not in self.block_sysids
            and compid not in self.block_compids
            and (not self.allow_msgids or msgid in self.allow_msgids)
            and (not self.allow_sysids or sysid in self.allow_sysids)
            and (not self.allow_compids or compid in self.allow_compids)
        )


class RateLimiter:
    """Upper rates of one channel and direction.

    ``rates_hz`` by msgid apply to every frame of that message, per source, targeted ones too; ``default_hz`` to
    broadcast frames of all other messages but HEARTBEAT; ``bytes_per_s`` to the sum of broadcast frames but HEARTBEAT.
    An addressed frame passes unless its message is named: a lost command is no saving of bandwidth.
    """

    __slots__ = ("_buckets", "_budget", "bytes_per_s", "default_hz", "rates_hz")

    def __init__(
        self, rates_hz: Mapping[int, float], default_hz: float | None = None, bytes_per_s: float | None = None
    ) -> None:
        self.rates_hz = dict(rates_hz)
        self.default_hz = default_hz
        self.bytes_per_s = bytes_per_s
        self._buckets: dict[int, TokenBucket] = {}
        self._budget = None if bytes_per_s is None else TokenBucket(bytes_per_s, max(MIN_BUCKET_BYTES, bytes_per_s / 2))

    def __bool__(self) -> bool:
        return bool(self.rates_hz) or self.default_hz is not None or self.bytes_per_s is not None

    def passes(self, source: int, msgid: int, size: int, targeted: bool, now: float) -> bool:
        """True if this frame may pass now; if so it is counted against the limits. ``source`` is sysid<<8|compid."""
        rate = self.rates_hz.get(msgid)
        exempt = targeted or msgid == 0
        if rate is None and not exempt:
            rate = self.default_hz
        if rate is not None and not self._take_message(source << 24 | msgid, rate, now):
            return False
        return self._budget is None or self._budget.take(now, size) or exempt

    def _take_message(self, key: int, rate_hz: float, now: float) -> bool:
        if rate_hz <= 0:
            return False
        bucket = self._buckets.get(key)
        if bucket is None:
            if len(self._buckets) >= MAX_RATE_KEYS:
                self._buckets.clear()
            bucket = self._buckets[key] = TokenBucket(rate_hz, BURST, now)
        return bucket.take(now)


@dataclass(frozen=True, slots=True)
class ChannelPolicy:
    """How a channel takes part in routing (design: links have roles)."""

    role: str = "peer"
    link: str = ""
    """Name of the link: two channels of one link with one autopilot are two vehicles of one id, or two of its ports."""
    replayed: bool = False
    """The channel carries a recording: it is shown to ground stations, never to vehicles, and nothing is sent there."""
    group: str | None = None
    cost: int = DEFAULT_COST
    """Cost of the link; the link of lower cost is used where two good ones lead to a vehicle."""
    vehicles: frozenset[int] = frozenset()
    """System ids that the channel is bound to; empty: it is not bound."""
    forward_unknown: bool = True
    filter_in: MessageFilter = field(default_factory=MessageFilter)
    filter_out: MessageFilter = field(default_factory=MessageFilter)
    rates_in: Mapping[int, float] = field(default_factory=dict)
    rates_out: Mapping[int, float] = field(default_factory=dict)
    default_hz_in: float | None = None
    default_hz_out: float | None = None
    bytes_per_s_in: float | None = None
    bytes_per_s_out: float | None = None

    @property
    def carries_vehicles(self) -> bool:
        """Roles to which one vehicle's broadcast telemetry is not sent."""
        return self.role in ("vehicle", "radio")

    def limiter_in(self) -> RateLimiter:
        return RateLimiter(self.rates_in, self.default_hz_in, self.bytes_per_s_in)

    def limiter_out(self) -> RateLimiter:
        return RateLimiter(self.rates_out, self.default_hz_out, self.bytes_per_s_out)
