"""The parts of every link, and the interface of its host.

A **link** is an endpoint of the fleet file (one serial port, one UDP port). A **channel** is one route target on it:
the serial port itself, one UDP peer, one TCP connection. A link opens, provides channels, and fails as a whole; the
supervisor opens it again. The host (the hub) gets whole frames and hands out frames to send.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

from skygcs.back_off import BackOff
from skygcs.config.models import LinkConfig
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import Outgoing, OwnMessage, Priority
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.core.routing.sysid_translation import SysidTranslator
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.links.reading import ReadingTurns

if TYPE_CHECKING:
    from skygcs.links._fast_path import FastPath, Out, Table
    from skygcs.links.paced import AirBudget


class StateUpdate(NamedTuple):
    """The state update for frames of one source and message that need not be checked one by one."""

    slot: Any = None
    """Gets the newest frame, its time and the count (`core.vehicle.message_cache.Slot`); None: no state is kept."""
    watches: list[Any] | None = None
    """While it is not empty, a task waits for what such frames may change, and each frame must be shown."""
    again: Callable[[float], None] | None = None
    """Called with the time at the end of a burst of frames that repeat the same payload."""


class ForwardingPath(NamedTuple):
    """Path of all further frames of one source and message: no rule has to be applied."""

    outs: tuple[Out, ...]
    stats: SourceStats
    heard: dict[int, float]
    """The time of the last frame by source: the routing table's own."""
    state_update: StateUpdate
    steady: bytes | None = None
    """The payload they must have; None: any."""


MAX_SOURCES_PER_CHANNEL = 512
"""Bound of the per-source table of one channel; what comes from further sources is counted together."""

CHANNEL_TOTALS = (
    *("rx_frames", "rx_bytes", "tx_frames", "tx_bytes", "tx_dropped"),
    *("bad_crc", "unknown", "skipped_bytes"),
)
"""Counters of a channel that are added up for its link."""


class ChannelSigning(Protocol):
    """How a channel with a signing key treats what comes and what is ours."""

    def admit(self, channel: Channel, frames: list[Frame]) -> list[Frame]:
        """Those of the frames that may count; the others are counted."""
        ...

    def sign(self, raw: bytes, info: MessageInfo) -> bytes:
        """A frame of ours, which is unsigned MAVLink 2, as it is to be sent."""
        ...

    def counters(self) -> dict[str, int]:
        """Frames since the channel was opened, by what became of them."""
        ...


Gate = Callable[[int, Outgoing], bool]
"""True if this may leave now on the channel with this id (`Hub.may_leave`)."""


class LinkHost(Protocol):
    """The hub, as links see it. All calls are synchronous, on the loop's thread, and never raise."""

    @property
    def dialect(self) -> Dialect:
        """Return what a link needs that makes or reads frames itself (simulated, replay)."""
        ...

    @property
    def fast_path(self) -> Table | None:
        """Return what the fast paths of all links share; None: every frame goes through `on_frames`."""
        ...

    @property
    def reading(self) -> ReadingTurns:
        """How much each wake-up of a link may take."""
        ...

    def after_fast_path(self) -> None:
        """Count and record the frames of the fast path; call it before reading channels or sources."""
        ...

    def new_parser(self, config: LinkConfig) -> FrameParser:
        """A parser for one channel of this link."""
        ...

    def attach(self, channel: Channel) -> None:
        """Note an open channel, to which frames may be routed from now on. Sets its id."""
        ...

    def detach(self, channel: Channel, reason: str) -> None:
        """The channel is gone. Idempotent."""
        ...

    def on_frames(self, channel: Channel, frames: list[Frame], now: float) -> None:
        """Frames in the order they came. The host counts them on the channel and sets its ``last_rx_at``."""
        ...

    def on_sent(self, channel: Channel, message: OwnMessage, raw: bytes) -> None:
        """A message of our own was written (for the recorder)."""
        ...

    def leads_to_flying(self, channel: Channel) -> bool:
        """True if this channel is the last way to a vehicle that may be in the air."""
        ...

    def carries_autopilot(self, channel: Channel) -> bool:
        """True if an autopilot is heard on this channel."""
        ...

    def vouches_for(self, config: LinkConfig, frames: list[Frame]) -> bool:
        """True if an unknown sender of these frames may become a peer of this link: where signatures are required, one
        frame must be signed with the link's key."""
        ...

    def on_event(self, event: Event) -> None:
        """Something about the link that a person should know."""
        ...


class Channel(ABC):
    """One route target. ``peer`` is a person's name for the other end ("192.168.1.7:14550", "/dev/ttyUSB0")."""

    in_datagrams = False
    """True if what comes from here comes in datagrams."""

    whole_datagrams = False
    """True if frames of one datagram with the same destinations may be sent on in one (`send_whole`)."""

    fast_path: FastPath | None = None
    """The compiled fast path for datagrams from this peer, and ..."""
    out: Out | None = None
    """... this peer as a destination of fast paths."""

    def __init__(self, link: Link, peer: str) -> None:
        self.id = 0
        self.link = link
        self.config: LinkConfig = link.config
        self.peer = peer
        self.parser: FrameParser = link.host.new_parser(link.config)
        self.version = 2
        self.signing: ChannelSigning | None = None
        """Set by the host if the link has a signing key."""
        self.translator: SysidTranslator | None = None
        """Set by the host if the link is bound to vehicles: the ids that its program sees."""
        self.gate: Gate | None = None
        """Set by the host where vehicles may be commanded by other sites: asked last before a frame is written."""
        self.air: AirBudget | None = None
        """The budget of a channel into a radio."""
        self.opened_at = link.loop.time()
        self.last_rx_at = self.opened_at
        self.rx_frames = 0
        self.rx_bytes = 0
        self.tx_frames = 0
        self.tx_bytes = 0
        self.tx_dropped = 0
        self.sources: dict[int, SourceStats] = {}
        self._seq = 0

    @abstractmethod
    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        """Send or queue; False if it was dropped or refused (counted). Never blocks, never raises."""

    def waiting(self, priority: Priority) -> int:
        """How many of this class wait to be sent."""
        return 0

    def holds(self, priority: Priority, sysid: int, key: Hashable) -> bool:
        """True if a message of ours to this system waits to be sent under this key."""
        return False

    def drop_setpoints(self, sysid: int) -> int:
        """Forget setpoints of ours for this system that wait to be sent here, as they go over another link from now on;
        how many that were."""
        return 0

    def drop_waiting(self) -> int:
        """Forget all that waits to be sent here; how much that was."""
        return 0

    def send_whole(self, data: bytes, frames: int) -> None:
        """Send so many frames as one datagram; only where ``whole_datagrams``."""
        raise NotImplementedError

    def add_flow(self, frame: Frame, path: ForwardingPath) -> None:
        """Open a flow for further frames of this source and message; only if there is a ``fast_path``."""
        raise NotImplementedError

    def is_given_up(self, timeout_s: float, now: float) -> bool:
        """True if nothing was heard here for so long, but for the last way to a vehicle in the air: its downlink may be
        lost alone. The one rule for every link that lets go of silent peers."""
        return now - self.last_rx_at >= timeout_s and not self.link.host.leads_to_flying(self)

    def is_kept_back(self, outgoing: Outgoing) -> bool:
        """True if the gate keeps this from being written now. Only where there is a ``gate``."""
        return self.gate is not None and not self.gate(self.id, outgoing)

    def encode(self, outgoing: Outgoing) -> bytes:
        """Bytes to write now; a message of our own takes this channel's next sequence number and is recorded."""
        if type(outgoing) is bytes:
            return outgoing
        if isinstance(outgoing, Frame):
            return outgoing.raw
        assert isinstance(outgoing, OwnMessage)
        if self.signing is None:
            raw = outgoing.encode(self._seq, self.version)
        else:
            raw = self.signing.sign(outgoing.encode(self._seq, 2), outgoing.info)
        self._seq = (self._seq + 1) & 0xFF
        self.link.host.on_sent(self, outgoing, raw)
        return raw

    def totals(self) -> dict[str, int]:
        """Counters of `CHANNEL_TOTALS`."""
        stats = self.parser.stats
        counts = (self.rx_frames, self.rx_bytes, self.tx_frames, self.tx_bytes, self.tx_dropped)
        return dict(zip(CHANNEL_TOTALS, (*counts, stats.bad_crc, stats.unknown, stats.skipped_bytes), strict=True))

    def counters(self) -> dict[str, Any]:
        """JSON-able counters of this channel; subclasses add their own."""
        signing = {} if self.signing is None else {"signing": self.signing.counters()}
        translator = {} if self.translator is None else self.translator.counters()
        return {**self.totals(), "good": self.parser.stats.good, **translator, **signing}


class Link(ABC):
    """An endpoint. Life: `open`, then `failed` resolves when it breaks, then `close`; then, after `rearm`, it may be
    opened again. ``finished``: it ended by itself (a replay) and must not be opened again."""

    def __init__(self, config: LinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        self.config = config
        self.name = config.name
        self.host = host
        self.loop = loop
        self.failed: asyncio.Future[str] = loop.create_future()
        self.finished = False

    @property
    def bytes_per_s(self) -> float | None:
        """Return what all its channels together carry, both ways; None where that is no limit."""
        return None

    @property
    def shares_air(self) -> bool:
        """True if all its channels go through one air of `bytes_per_s`, so that the streams of the vehicles behind
        them are planned together. A channel into a radio has an `AirBudget` for that instead."""
        return False

    @abstractmethod
    async def open(self) -> None:
        """Open the device or socket. Raises LinkError with what to do; it then holds nothing open. So it is when
        cancelled, or when `close` is called meanwhile (a LinkError as well)."""

    @abstractmethod
    async def close(self) -> None:
        """Detach all channels and free the device. Idempotent. Never raises."""

    @property
    @abstractmethod
    def channels(self) -> list[Channel]:
        """The channels that are open now."""

    def fail(self, reason: str) -> None:
        """Called by the link's own callbacks when it breaks; the supervisor closes and reopens it."""
        if not self.failed.done():
            self.failed.set_result(reason)

    def rearm(self) -> None:
        """Forget the last failure; to be called before the link is opened again."""
        self.failed = self.loop.create_future()

    def counters(self) -> dict[str, Any]:
        """JSON-able counters of what belongs to no channel (refused peers, noise); subclasses have their own."""
        return {}

    @property
    def why_closed(self) -> str:
        """The reason with which channels are detached: the failure, or "closed" if it was closed on purpose."""
        failed = self.failed
        return failed.result() if failed.done() and not failed.cancelled() else "closed"


LinkState = Literal["opening", "up", "down", "finished"]

FIRST_BACK_OFF_S = 0.5
LONGEST_BACK_OFF_S = 5.0
"""A replugged radio is back within this."""

STABLE_AFTER_S = 5.0
"""A link that was up for less has not recovered: the next back-off is longer still."""


class LinkSupervisor:
    """Owner of one link's life: open, wait until it fails, close, back off, open again. One place for all kinds.

        opening ──► up ──failed──► down ──back-off, opened again──► up          up ──finished──► finished (the end)
           └─────could not open─────▲ └──back-off, could not open──► down

    ``state`` since ``since`` (loop time); ``last_error`` is the latest reason, also after
    recovery. The first failure is reported by a link_down event, later ones are counted in ``failures``, and a link_up
    event ends it. ``opened`` counts successes.
    """

    def __init__(self, link: Link, on_event: Callable[[Event], None]) -> None:
        self.link = link
        self.state: LinkState = "opening"
        self.since = link.loop.time()
        self.last_error: str | None = None
        self.failures = 0
        self.opened = 0
        self._on_event = on_event
        self._down_since: float | None = None

    async def run(self) -> None:
        """Until cancelled, or until the link has finished by itself. Nothing a link raises ends it."""
        back_off = BackOff(FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S, STABLE_AFTER_S)
        try:
            while True:
                reason = await self._one_life()
                up_s = self.link.loop.time() - self.since if self.state == "up" else 0.0
                await self._close()
                if self.link.finished:
                    self._finish(reason)
                    return
                self._went_down(reason)
                await asyncio.sleep(back_off.after(up_s))
        finally:
            await self._close()

    async def _one_life(self) -> str:
        """Open and wait for the end; its reason."""
        link = self.link
        link.rearm()
        try:
            await link.open()
        except LinkError as error:
            return str(error)
        except Exception as error:  # a bug or an unexpected error fails this link only
            return f"{link.config.type} {link.name}: unexpected {type(error).__name__}: {error}"
        self._came_up()
        return await link.failed

    async def _close(self) -> None:
        try:
            await self.link.close()
        except Exception as error:
            self.last_error = f"{self.link.name}: closing: {type(error).__name__}: {error}"

    def _enter(self, state: LinkState) -> None:
        if state != self.state:
            self.state = state
            self.since = self.link.loop.time()

    def _came_up(self) -> None:
        self._enter("up")
        self.opened += 1
        down_s = round(self.since - self._down_since, 1) if self._down_since is not None else None
        text = f"link {self.link.name} is up" + (f" again after {down_s:g} s" if down_s is not None else "")
        self._report("link_up", text, {"down_s": down_s, "failures": self.failures})
        self._down_since = None
        self.failures = 0

    def _went_down(self, reason: str) -> None:
        self._enter("down")
        self.last_error = reason
        self.failures += 1
        if self._down_since is None:
            self._down_since = self.since
            self._report("link_down", f"link {self.link.name} is down: {reason}", {"reason": reason})

    def _finish(self, reason: str) -> None:
        self._enter("finished")
        self._report("link_down", f"link {self.link.name}: {reason}", {"reason": reason, "finished": True})

    def _report(self, kind: str, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event(kind, None, None, text, {"link": self.link.name, **data}))
