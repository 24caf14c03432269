"""Channels over a byte stream: a serial port, a TCP connection.

In: bytes to the channel's parser, and the parser's rescue after a silence. Out: a priority queue in front of the
descriptor, written when it takes something; a frame once begun is finished before anything else, unless the authority
over its vehicle has ended (`Channel.gate`).
"""

from __future__ import annotations

import asyncio
import os
import select
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from typing import Any

from skygcs.core.radio_link.admission import ThirdPartyRules
from skygcs.core.radio_link.capacity import RadioRates
from skygcs.core.radio_link.transmit_queue import Outgoing, OwnMessage, Priority, TxQueue
from skygcs.core.routing.peer_places import PARK_S, GarbageGauge
from skygcs.links.base import Channel, Link
from skygcs.links.paced import AirBudget, flow_of
from skygcs.links.reading import waiting_bytes

RESCUE_AFTER_S = 0.1
"""Silence after which what the parser holds back is searched for whole frames. The longest frame takes 49 ms at 57600
baud, so a pause of twice that is not within one; the rescue harms no slow frame either, it only finds whole ones.
"""

READ_BYTES = 8192
"""Most bytes taken at one wake-up: some 200 commands, 3 ms. Where many are flooded, each takes less (`links.reading`):
with this for each of them, 32 clients kept the loop for 0.08 s at a time."""

OLD = "this process or computer stood still: what is under way is old"
"""Why a TCP connection is made anew."""

SHALLOW_BYTES = 256
"""Outstanding bytes in the kernel at which writing stops: an urgent frame then waits at most 44 ms at 57600 baud."""

SHALLOW_S = 0.02
"""The same as a time, for fast ports, where 256 bytes would be gone before the next look."""

MIN_LOOK_S = 0.002
"""Shortest time between two looks at the kernel's buffer."""


class DescriptorWatcher:
    """Calls ``on_ready`` while ``fd`` can be read, has hung up, or (after `want_write`) can be written.

    The descriptor is in an epoll of its own, and the loop watches that epoll. Reason: libuv (uvloop) stops watching a
    descriptor for good at its first EPOLLERR, which an unplugged serial port or a reset connection gives while there is
    still something to read, and a connected UDP socket each time its peer is not there. An epoll in an epoll can only
    become readable.
    """

    __slots__ = ("_epoll", "_fd", "_loop", "_reading", "_writing")

    def __init__(self, loop: asyncio.AbstractEventLoop, fd: int, on_ready: Callable[[], None]) -> None:
        self._loop = loop
        self._fd = fd
        self._reading = True
        self._writing = False
        self._epoll = select.epoll(1)
        try:
            self._epoll.register(fd, select.EPOLLIN)
            loop.add_reader(self._epoll.fileno(), on_ready)
        except BaseException:
            self._epoll.close()
            raise

    def want_write(self, wanted: bool) -> None:
        """Choose whether writability counts as ready too."""
        if wanted != self._writing and not self._epoll.closed:
            self._writing = wanted
            self._modify()

    def want_read(self, wanted: bool) -> None:
        """Choose whether readability counts as ready; an end or an error does in any case."""
        if wanted != self._reading and not self._epoll.closed:
            self._reading = wanted
            self._modify()

    def _modify(self) -> None:
        events = (select.EPOLLIN if self._reading else 0) | (select.EPOLLOUT if self._writing else 0)
        self._epoll.modify(self._fd, events)

    def close(self) -> None:
        """Stop watching; to be called before the descriptor is closed. Idempotent."""
        if not self._epoll.closed:
            self._loop.remove_reader(self._epoll.fileno())
            self._epoll.close()


class StreamIntake:
    """Hands the frames of one stream to the channel's host, and searches for held-back frames after a silence."""

    __slots__ = ("_channel", "_garbage", "_loop", "_timer", "_touched_at")

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._garbage = GarbageGauge(channel.opened_at)
        self._loop = channel.link.loop
        self._timer: asyncio.TimerHandle | None = None
        self._touched_at = 0.0

    @property
    def parkings(self) -> int:
        """How often it was too much that was no MAVLink."""
        return self._garbage.parkings

    def feed(self, data: bytes) -> bool:
        """Bytes as they came, in any split. True if so much of what came was no MAVLink that its sender, if it can
        wait, is to be left waiting for `PARK_S`."""
        channel = self._channel
        now = self._loop.time()
        skipped = channel.parser.stats.skipped_bytes
        frames = channel.parser.feed(data)
        skipped = channel.parser.stats.skipped_bytes - skipped
        if channel.air is not None:
            channel.air.heard(frames, now)
        if channel.parser.pending:
            self._touched_at = now
            if self._timer is None:
                self._timer = self._loop.call_later(RESCUE_AFTER_S, self._on_silence)
        if frames:
            channel.link.host.on_frames(channel, frames, now)
        return bool(skipped) and self._garbage.skipped(skipped, now)

    def close(self) -> None:
        """No calls to the host after this. Idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def rescue(self) -> None:
        """Deliver what follows a false start, as nothing more is expected for now."""
        channel = self._channel
        while frames := channel.parser.rescue():  # each time it gives some, it holds less
            channel.link.host.on_frames(channel, frames, self._loop.time())

    def _on_silence(self) -> None:
        self._timer = None
        if not self._channel.parser.pending:
            return
        if self._channel.link.host.reading.asleep():  # it will be known to be stale, and then be dropped
            self._timer = self._loop.call_later(RESCUE_AFTER_S, self._on_silence)
            return
        left = self._touched_at + RESCUE_AFTER_S - self._loop.time()
        if left > 0.001:  # one timer for many reads: it is moved on only when it fires
            self._timer = self._loop.call_later(left, self._on_silence)
            return
        self.rescue()


class QueuedChannel(Channel):
    """A channel with a queue: a plain one, or the sender's side of a radio (`paced.AirBudget`).

    What waits is in ``_line``. Subclasses use `_offer` and `_pop`, which count what was dropped or refused.
    """

    def __init__(self, link: Link, peer: str, radio: RadioRates | None, third_party: ThirdPartyRules | None) -> None:
        """``radio``: of the radio at the other end; ``third_party``: what other programs may send into it."""
        super().__init__(link, peer)
        self.queue: TxQueue[Outgoing] = TxQueue()
        if radio is not None:
            self.air = AirBudget(self.queue, radio, link.loop.time(), third_party, link.host.dialect)
        self._line: TxQueue[Outgoing] | AirBudget = self.queue if self.air is None else self.air

    def waiting(self, priority: Priority) -> int:
        return self.queue.waiting(priority)

    def holds(self, priority: Priority, sysid: int, key: Hashable) -> bool:
        return self.queue.holds(priority, None if self.air is None else sysid, key)

    def counters(self) -> dict[str, Any]:
        return {**super().counters(), "tx_waiting": len(self._line)}

    def _offer(self, outgoing: Outgoing, priority: Priority, now: float, key: Hashable | None) -> bool:
        """Queue it; False if it was dropped or refused."""
        if self.air is None:
            counters = self.queue.counters[priority]
            lost = counters.dropped + counters.refused
            taken = self.queue.offer(outgoing, priority, now, key)
            self.tx_dropped += counters.dropped + counters.refused - lost
        else:
            taken = self.air.offer(outgoing, priority, now, key, signed=self.signing is not None)
            self.tx_dropped += self.air.take_lost()
        return taken

    def _pop(self, now: float) -> tuple[Outgoing, Priority] | None:
        """Return what is to be written now; None if nothing waits, the budget is spent, or this process did not run
        while it waited."""
        if not self._line or self.link.host.reading.asleep():
            return None
        popped = self._line.pop(now)
        if self.gate is not None:
            while popped is not None and not self.gate(self.id, popped[0]):  # the authority ended while it waited
                self.tx_dropped += 1
                popped = self._line.pop(now)
        if self.air is not None:
            self.tx_dropped += self.air.take_lost()
        return popped

    def drop_setpoints(self, sysid: int) -> int:
        def is_for_it(entry: Outgoing) -> bool:
            return isinstance(entry, OwnMessage) and flow_of(entry) == sysid

        gone = self.queue.drop(Priority.SETPOINT, is_for_it)
        self.tx_dropped += gone
        return gone

    def drop_waiting(self) -> int:
        gone = self._line.clear()
        self.tx_dropped += gone
        return gone


@dataclass(frozen=True, slots=True)
class WriteLimits:
    """How a descriptor is written. With ``outstanding`` (written bytes that the kernel still holds) and ``bytes_per_s``
    (how fast they go) the kernel's buffer is kept shallow, so that priorities have an effect; without them it is
    filled. ``stuck_after_s``: the channel breaks if the other end takes nothing for this long. ``parks``: the other
    end waits while nothing is read (TCP; a serial port would lose bytes), so one that sends garbage is left waiting."""

    outstanding: Callable[[], int] | None = None
    bytes_per_s: float = 5760.0
    stuck_after_s: float | None = None
    parks: bool = False


class StreamChannel(QueuedChannel):
    """A channel over a non-blocking descriptor, which its owner closes after `close`.

    ``on_broken(channel, reason)`` is called once, from the loop, after the descriptor reported its end or an error, or
    after the other end took nothing for ``limits.stuck_after_s``. With ``radio``, no more is sent than the radio at the
    other end can carry, and no more of other programs' frames than ``third_party`` allows.
    """

    def __init__(
        self,
        link: Link,
        peer: str,
        fd: int,
        on_broken: Callable[[StreamChannel, str], None],
        limits: WriteLimits = WriteLimits(),
        *,
        radio: RadioRates | None = None,
        third_party: ThirdPartyRules | None = None,
    ) -> None:
        super().__init__(link, peer, radio, third_party)
        self.bytes_per_s = limits.bytes_per_s
        self.intake = StreamIntake(self)
        self._fd = fd
        self._loop = link.loop
        self._on_broken = on_broken
        self._outstanding = limits.outstanding
        self._stuck_after_s = limits.stuck_after_s
        self._parks = limits.parks
        self._parked: asyncio.TimerHandle | None = None
        self._rest = b""
        self._rest_of: Outgoing = b""
        """The frame that ``_rest`` is the rest of."""
        self._blocked = False
        self._progress_at = 0.0
        self._look: asyncio.TimerHandle | None = None
        self._due: asyncio.TimerHandle | None = None
        self._stuck: asyncio.TimerHandle | None = None
        self._closed = False
        self._watcher = DescriptorWatcher(link.loop, fd, self._on_ready)
        link.host.reading.add(self, fd, partial(waiting_bytes, fd))
        if self.air is not None:
            self.air.on_due = lambda: link.loop.call_soon(self._on_early)  # not amid what came

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        if self._closed:
            self.tx_dropped += 1
            return False
        taken = self._offer(outgoing, priority, self._loop.time(), key)
        if not self._blocked and self._look is None:
            self._pump()
        return taken

    def close(self) -> None:
        """Stop reading and writing; what waits is dropped and counted. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self.link.host.reading.remove(self)
        self._watcher.close()
        self.intake.close()
        for timer in (self._look, self._due, self._stuck, self._parked):
            if timer is not None:
                timer.cancel()
        self._look = self._due = self._stuck = self._parked = None
        self.tx_dropped += self._line.clear() + bool(self._rest)
        self._rest = b""

    def drop_waiting(self) -> int:
        """The frame that has been begun, too: as long as it is not complete, nothing is done with it. A connection ends
        as soon as what waits in it has been read: more of it waits with the sender."""
        gone = super().drop_waiting()
        if self._rest:
            self._rest = b""
            self.tx_dropped += 1
            gone += 1
        if self._parks and not self._closed and self not in self.link.host.reading.stale:
            self._break(OLD)
        return gone

    def _on_ready(self) -> None:
        share = self.link.host.reading.share(self)
        if share is None:
            return
        data = b""
        try:
            data = os.read(self._fd, min(READ_BYTES, share.bytes))
        except (BlockingIOError, InterruptedError):
            pass
        except OSError as error:
            self._break((error.strerror or str(error)).lower())
            return
        else:
            if not data:
                self._break("the other end closed it")
                return
            if self.intake.feed(data) and self._parks and not self._closed:
                self._park()
        if self.link.host.reading.stale:
            self._look_for_new(len(data))
        if self._blocked and not self._closed:
            self._pump()

    def _look_for_new(self, taken: int) -> None:
        """After a standstill: end with the last of what had waited."""
        reading = self.link.host.reading
        if self in reading.stale and reading.emptied(self, taken):
            if self._parks:
                self._break(OLD)
            else:
                self.intake.rescue()
                reading.trust(self)

    def _park(self) -> None:
        """Read nothing for a while. What is sent meanwhile waits with the sender; writing goes on."""
        self._watcher.want_read(False)
        if self._parked is not None:  # it has hung up, which is read in any case
            self._parked.cancel()
        self._parked = self._loop.call_later(PARK_S, self._read_again)

    def _read_again(self) -> None:
        self._parked = None
        self._watcher.want_read(True)

    def _pump(self) -> None:
        """Write until nothing waits, the descriptor takes no more, or the kernel holds enough."""
        while True:
            rest = self._rest
            if rest and self.is_kept_back(self._rest_of):
                self._rest = rest = b""  # a vehicle that has the begin of a frame drops it when another one follows
                self.tx_dropped += 1
            if not rest:
                if not self._has_room():
                    break
                popped = self._pop(self._loop.time())
                if popped is None:
                    self._wait_for_budget()
                    break
                rest = self.encode(popped[0])
                self._rest_of = popped[0]
            try:
                written = os.write(self._fd, rest)
            except (BlockingIOError, InterruptedError):
                written = 0
            except OSError as error:
                self._break((error.strerror or str(error)).lower())
                return
            if written:
                self.tx_bytes += written
                self._progress_at = self._loop.time()
            self._rest = rest[written:]
            if self._rest:
                self._wait()
                return
            self.tx_frames += 1
        if self._blocked:
            self._blocked = False
            self._watcher.want_write(False)

    def _has_room(self) -> bool:
        """True if the kernel holds little enough to write one more frame; if not, the time to look again is set."""
        if self._outstanding is None or not self._line:
            return True
        held = self._outstanding()
        limit = max(SHALLOW_BYTES, self.bytes_per_s * SHALLOW_S)
        if held < limit:
            return True
        self._look = self._loop.call_later(max((held - limit / 2) / self.bytes_per_s, MIN_LOOK_S), self._on_look)
        return False

    def _wait_for_budget(self) -> None:
        """Go on when the budget bears what is next. What is more urgent and offered meanwhile is tried at once."""
        if self._due is not None:
            self._due.cancel()
            self._due = None
        at = self._line.next_send_time(self._loop.time())
        if at is not None:
            self._due = self._loop.call_at(at, self._on_due)

    def _on_due(self) -> None:
        self._due = None
        if not self._blocked and self._look is None:
            self._pump()

    def _on_early(self) -> None:
        if not self._closed and not self._blocked and self._look is None:
            self._pump()

    def _on_look(self) -> None:
        self._look = None
        self._pump()

    def _wait(self) -> None:
        """The descriptor takes no more for now."""
        if self._blocked:
            return
        self._blocked = True
        self._watcher.want_write(True)
        if self._stuck_after_s is not None and self._stuck is None:
            self._progress_at = self._loop.time()
            self._stuck = self._loop.call_later(self._stuck_after_s, self._on_stuck, self._stuck_after_s)

    def _on_stuck(self, after_s: float) -> None:
        self._stuck = None
        if not self._blocked:
            return
        left = self._progress_at + after_s - self._loop.time()
        if left > 0.001:
            self._stuck = self._loop.call_later(left, self._on_stuck, after_s)
        else:
            self._break(f"the other end took nothing for {after_s:g} s")

    def _break(self, reason: str) -> None:
        self.close()
        self._loop.call_soon(self._on_broken, self, reason)  # not from within a send, amid the host's work on a frame
