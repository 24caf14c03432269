"""UDP: a server with a channel per peer, a client, and a broadcaster that locks onto the peer that answers.

One raw socket per link, many datagrams per wake-up; a datagram is a unit, never part of a stream. The socket is never
connected: a connected one keeps its local address when the machine changes its network, and reports every datagram to a
closed port as an error. Datagrams from other peers are ignored by their address instead.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import time
from abc import abstractmethod
from collections.abc import Hashable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from skygcs.config import models
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import Outgoing, Priority
from skygcs.core.routing.peer_places import GarbageGauge, Peer
from skygcs.errors import LinkError, explain_address_error
from skygcs.events import Event
from skygcs.links.base import Channel, ForwardingPath, Link, LinkHost
from skygcs.links.fast_path import new_fast_path, new_out
from skygcs.links.peers import Address, Admission, format_address, format_host, resolve
from skygcs.links.reading import LARGEST_DATAGRAM_BYTES, Share, waiting_datagrams

if TYPE_CHECKING:
    from skygcs.links._fast_path import FastPath

DATAGRAMS_PER_WAKEUP = 64
"""Enough that the wake-up costs little per datagram; few enough that other links have their turn within 1 ms. See
`links.reading` for large ones and those that take long."""

RECEIVE_BUFFER_BYTES = 4 << 20
"""Requested from the kernel (which may grant less): holds the datagrams of a few seconds."""

BROADCAST_AGAIN_S = 5.0
"""Silence after which a broadcaster forgets its peer (mavlink-router's time)."""

PARKED_AGAIN_S = 30.0
"""Least time between two reports that senders of a link are parked."""

MIN_EXPIRY_STEP_S = 0.01
"""Least time between two looks for silent peers; a loop may count time in whole milliseconds."""

_TRANSIENT = frozenset(
    {
        errno.EINTR,
        errno.ECONNREFUSED,
        errno.ENETUNREACH,
        errno.EHOSTUNREACH,
        errno.ENETDOWN,
        errno.ENOBUFS,
        errno.ENOMEM,
    }
)
"""Errors of receiving that do not mean a broken socket."""


class UdpChannel(Channel):
    """One peer; ``address`` is where it is sent to. A datagram the kernel does not take is dropped and counted."""

    in_datagrams = True

    def __init__(self, link: UdpLink, sock: socket.socket, address: Address) -> None:
        super().__init__(link, format_address(address))
        self.address = address
        self.whole_datagrams = link.config.whole_datagrams
        self.garbage = GarbageGauge(self.opened_at)
        self._sendto = sock.sendto

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        if self.gate is not None and not self.gate(self.id, outgoing):
            self.tx_dropped += 1
            return False
        raw = outgoing if type(outgoing) is bytes else self.encode(outgoing)
        if self.gate is not None and not self.gate(self.id, outgoing):  # the process may have been stopped since
            self.tx_dropped += 1
            return False
        try:
            self._sendto(raw, self.address)
        except OSError:  # no buffer, no route, closed: the next datagram may well go through
            self.tx_dropped += 1
            return False
        self.tx_frames += 1
        self.tx_bytes += len(raw)
        return True

    def send_whole(self, data: bytes, frames: int) -> None:
        try:
            self._sendto(data, self.address)
        except OSError:
            self.tx_dropped += frames
            return
        self.tx_frames += frames
        self.tx_bytes += len(data)

    def use_fast_path(self, fast_path: FastPath, fd: int) -> None:
        """Call once it is attached. A peer of IPv6 has no fast path."""
        self.out = new_out(fd, self.address, self, whole=self.whole_datagrams)
        if self.out is not None:
            fast_path.add_peer(self.address, self, self.parser.stats, self.id)
            self.fast_path = fast_path

    def add_flow(self, frame: Frame, path: ForwardingPath) -> None:
        if self.fast_path is not None:
            source = frame.sysid << 8 | frame.compid
            slot, watches, again = path.state_update
            self.fast_path.add_flow(
                self.address,
                source,
                frame.msgid,
                path.stats,
                path.heard,
                path.outs,
                slot,
                watches,
                path.steady,
                again,
            )


class UdpLink(Link):
    """The common part of the three kinds: the socket, and the path of a datagram to its peer's channel."""

    config: models.UdpServerLinkConfig | models.UdpClientLinkConfig | models.UdpBroadcastLinkConfig

    def __init__(
        self,
        config: models.UdpServerLinkConfig | models.UdpClientLinkConfig | models.UdpBroadcastLinkConfig,
        host: LinkHost,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        super().__init__(config, host, loop)
        self._peers: dict[Address, UdpChannel] = {}
        self._socket: socket.socket | None = None
        self._watched = -1
        self._fast_path: FastPath | None = None
        self._resuming = False
        self._session = 0
        self._ignored = 0
        self._too_large = 0
        self._parked = 0
        self._parked_reported_at = -PARKED_AGAIN_S
        self._strangers = GarbageGauge(loop.time())
        """Gauge of the garbage from all addresses that are no peers: a sender may claim a new one with each
        datagram."""

    @property
    def channels(self) -> list[Channel]:
        return list(self._peers.values())

    @property
    def bound_port(self) -> int:
        """The local port while open, also where 0 (any) was configured; else 0."""
        return int(self._socket.getsockname()[1]) if self._socket is not None else 0

    async def open(self) -> None:
        config = self.config
        session = self._session
        try:
            family, address = (await resolve(self.loop, config.host, config.port, socket.SOCK_DGRAM))[0]
        except LinkError as error:
            raise LinkError(f"{config.type} {error}") from None
        if session != self._session:
            raise LinkError(f"{config.type} {config.host}:{config.port}: closed while it was being opened")
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            sock.setblocking(False)
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            self._set_up(sock, family, address)
            if self.host.fast_path is not None and family == socket.AF_INET:
                self._fast_path = new_fast_path(
                    self.host.fast_path,
                    sock.fileno(),
                    clock=self.loop.time,
                    slow=self._on_datagram,
                    after=self.host.after_fast_path,
                    broken=partial(self._on_receive_error, sock),
                )
            on_readable = self._on_readable if self._fast_path is None else self._on_readable_fast
            # Not by a `DescriptorWatcher`: a socket that is not connected shows no errors, and an epoll less saves 6 %
            # of all at 1,000 frames a second.
            self.loop.add_reader(sock.fileno(), on_readable)
            self._watched = sock.fileno()
            self._socket = sock
            self.host.reading.add(self, sock.fileno(), partial(waiting_datagrams, sock), self._kept)
            self._begin(sock, address)
        except BaseException as error:
            await self.close()
            sock.close()
            if isinstance(error, OSError):
                raise LinkError(f"{config.type} {format_address(address)}: {self._explain(error)}") from None
            raise

    async def close(self) -> None:
        self._session += 1
        self.host.reading.remove(self)
        if self._watched >= 0:
            self.loop.remove_reader(self._watched)
            self._watched = -1
        channels = self.channels
        self._peers.clear()
        for channel in channels:
            self.host.detach(channel, self.why_closed)
        if self._fast_path is not None:
            self._too_large += self._fast_path.too_large
            self._fast_path.close()
            self._fast_path = None
            self._resuming = False
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def counters(self) -> dict[str, Any]:
        """``ignored_datagrams``: without a good frame, or from an address that is no peer. ``parked_datagrams``: of
        senders of garbage, read only as far as they begin with frames."""
        too_large = self._too_large + (0 if self._fast_path is None else self._fast_path.too_large)
        return {
            "ignored_datagrams": self._ignored,
            "too_large_datagrams": too_large,
            "parked_datagrams": self._parked,
        }

    @abstractmethod
    def _set_up(self, sock: socket.socket, family: int, address: Address) -> None:
        """Bind and set options. May raise OSError."""

    @abstractmethod
    def _begin(self, sock: socket.socket, address: Address) -> None:
        """The socket is ready: attach the channel that is there from the start."""

    @abstractmethod
    def _stranger(self, data: bytes, address: Address, now: float) -> UdpChannel | None:
        """The channel for a datagram from an unknown address, None to pass it over."""

    def _explain(self, error: OSError) -> str:
        return explain_address_error(error, self.config.host, self.config.port)

    def _on_readable(self) -> None:
        """HOT: from datagram to host without allocation but the frames, without a log line, without an await."""
        sock = self._socket
        if sock is None:
            return
        share = self.host.reading.share(self)
        if share is None:
            return
        taken = self._receive(sock, share)
        if self in self.host.reading.stale and self.host.reading.emptied(self, taken):
            self.host.reading.trust(self)

    def _receive(self, sock: socket.socket, share: Share) -> int:
        """The number of datagrams that were received."""
        receive = sock.recvfrom
        now = self.loop.time()
        left_bytes, seconds = share
        ends_at = time.perf_counter() + seconds
        for taken in range(DATAGRAMS_PER_WAKEUP):
            try:
                data, address = receive(LARGEST_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                return taken
            except OSError as error:
                self._on_receive_error(sock, error)
                return taken
            left_bytes -= len(data)
            if len(data) > LARGEST_DATAGRAM_BYTES:
                self._too_large += 1
            else:
                self._on_datagram(data, address, now)
            if left_bytes <= 0 or time.perf_counter() >= ends_at:
                return taken + 1
        return DATAGRAMS_PER_WAKEUP

    def _on_readable_fast(self) -> None:
        """The fast path's turn. While it keeps datagrams that were beyond its share, the loop calls it once a turn."""
        fast_path, sock = self._fast_path, self._socket
        if fast_path is None or sock is None:
            return
        reading = self.host.reading
        share = reading.share(self)
        if share is None:
            if self._resuming:  # the loop does not watch the socket meanwhile
                self.loop.call_soon(self._on_readable_fast)
            return
        taken = 0
        try:
            if self in reading.stale and not fast_path.kept:  # no flow is open: each is counted here
                taken = self._receive(sock, share)
            else:
                fast_path.ready(*share)
        finally:
            if self in reading.stale and reading.emptied(self, taken):
                reading.trust(self)
            if fast_path.kept:
                self.loop.remove_reader(self._watched)
                self._resuming = True
                self.loop.call_soon(self._on_readable_fast)
            elif self._resuming and self._fast_path is fast_path:
                self._resuming = False
                self.loop.add_reader(self._watched, self._on_readable_fast)

    def _kept(self) -> int:
        """Datagrams that the fast path has received and not handled."""
        return 0 if self._fast_path is None else self._fast_path.kept

    def _on_datagram(self, data: bytes, address: Address, now: float) -> None:
        """HOT: a datagram that the fast path leaves to Python."""
        channel = self._peers.get(address)
        if channel is None:
            channel = self._stranger(data, address, now)
            if channel is None:
                return
        frames = self._read(channel.parser, data, channel.garbage, now)
        if frames:
            self.host.on_frames(channel, frames, now)

    def _read(self, parser: FrameParser, data: bytes, garbage: GarbageGauge, now: float) -> list[Frame]:
        """The frames of a datagram; of a parked sender's only those that it begins with."""
        before = parser.stats.skipped_bytes
        parked = garbage.is_parked(now)
        frames = parser.feed_datagram(data, search=not parked)
        skipped = parser.stats.skipped_bytes - before
        if skipped and parked:
            self._parked += 1
        elif skipped and garbage.skipped(skipped, now):
            self._report_parked(now)
        return frames

    def _report_parked(self, now: float) -> None:
        if now - self._parked_reported_at >= PARKED_AGAIN_S:
            self._parked_reported_at = now
            text = f"link {self.name}: it gets so many bytes that are no MAVLink that not all are searched for frames"
            self.host.on_event(Event("warning", None, None, text, {"link": self.name}))

    def _good_frames(self, probe: FrameParser, data: bytes, now: float) -> list[Frame]:
        """The frames of a stranger's datagram if any has a good CRC, else none. The parser learns nothing from it."""
        good = probe.stats.good
        frames = self._read(probe, data, self._strangers, now)
        probe.verified.clear()
        return frames if probe.stats.good != good else []

    def _on_receive_error(self, sock: socket.socket, error: OSError) -> None:
        if self._socket is sock and error.errno not in _TRANSIENT:
            self.fail(f"{self.config.type} port {self.bound_port}: {self._explain(error)}")

    def _attach(self, address: Address, sock: socket.socket) -> UdpChannel:
        channel = self._peers[address] = UdpChannel(self, sock, address)
        self.host.attach(channel)
        if self._fast_path is not None:
            channel.use_fast_path(self._fast_path, sock.fileno())
        return channel


class UdpServerLink(UdpLink):
    """Listens. An address becomes a channel with its first good frame and stops being one after a silence.

    Noise makes no channels and takes no memory: an address is stored with its first good frame.
    """

    config: models.UdpServerLinkConfig

    def __init__(self, config: models.UdpServerLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._probe = host.new_parser(config)
        self._admission = Admission(self, config.max_peers, config.allow_from, self._places)
        self._expiry: asyncio.TimerHandle | None = None
        self._none_expires_before = 0.0
        self._expired = 0

    async def close(self) -> None:
        if self._expiry is not None:
            self._expiry.cancel()
            self._expiry = None
        await super().close()

    def counters(self) -> dict[str, Any]:
        admission = self._admission
        return {
            **super().counters(),
            "peers_refused": admission.refused,
            "peers_put_out": admission.put_out,
            "peers_expired": self._expired,
            "not_allowed": admission.not_allowed,
        }

    def _set_up(self, sock: socket.socket, family: int, address: Address) -> None:
        sock.bind(address)

    def _begin(self, sock: socket.socket, address: Address) -> None:
        pass

    def _stranger(self, data: bytes, address: Address, now: float) -> UdpChannel | None:
        if not self._admission.allows(address):
            return None
        frames = self._good_frames(self._probe, data, now)
        if not frames or not self.host.vouches_for(self.config, frames):
            self._ignored += 1
            return None
        if len(self._peers) >= self.config.max_peers and now >= self._none_expires_before:
            self._expire(now)
        if self._socket is None:
            return None
        if len(self._peers) >= self.config.max_peers and not self._takes_place(address, frames, now):
            return None
        channel = self._attach(address, self._socket)
        self._admission.places.changed()
        if self._expiry is None:
            self._plan_expiry(now)
        return channel

    def _takes_place(self, address: Address, frames: list[Frame], now: float) -> bool:
        """True if a newcomer is admitted although all places are taken; the peer it replaces is detached."""
        autopilot = any(frame.msgid == HEARTBEAT and discovers(frame) for frame in frames)
        admitted, key = self._admission.place_for(address, autopilot=autopilot, now=now)
        if isinstance(key, tuple):
            self._let_go(self._peers[key], f"its place was given to {format_address(address)}: all were taken")
        return admitted

    def _places(self) -> Iterator[Peer]:
        self.host.after_fast_path()  # which counts when each was last heard
        for address, channel in self._peers.items():
            autopilot, kept = self.host.carries_autopilot(channel), self.host.leads_to_flying(channel)
            yield Peer(address, format_host(address), autopilot, channel.last_rx_at, kept)

    def _let_go(self, channel: UdpChannel, reason: str) -> None:
        del self._peers[channel.address]
        if channel.fast_path is not None:
            channel.fast_path.remove_peer(channel.address)
        self.host.detach(channel, reason)
        self._admission.left(len(self._peers))

    def _expire(self, now: float) -> None:
        """Let go of every peer that was silent for too long."""
        self.host.after_fast_path()  # when each was last heard
        timeout_s = self.config.peer_timeout_s
        for channel in list(self._peers.values()):
            if channel.is_given_up(timeout_s, now):
                self._expired += 1
                self._let_go(channel, f"silent for {timeout_s:g} s")
        self._none_expires_before = self._first_expiry(now)

    def _plan_expiry(self, now: float) -> None:
        self._none_expires_before = self._first_expiry(now)
        delay_s = max(self._none_expires_before - now, MIN_EXPIRY_STEP_S)
        self._expiry = self.loop.call_later(delay_s, self._on_expiry)

    def _first_expiry(self, now: float) -> float:
        """When the next peer may be let go of; one that stays although it is silent is looked at again later."""
        timeout_s = self.config.peer_timeout_s
        due = (c.last_rx_at + timeout_s for c in self._peers.values())
        return min((at if at > now else now + timeout_s for at in due), default=now + timeout_s)

    def _on_expiry(self) -> None:
        self._expiry = None
        now = self.loop.time()
        self._expire(now)
        if self._peers:
            self._plan_expiry(now)


class UdpClientLink(UdpLink):
    """Sends to one address from the start, whether or not a program listens there, and hears only that address."""

    config: models.UdpClientLinkConfig

    def _set_up(self, sock: socket.socket, family: int, address: Address) -> None:
        sock.bind(("::" if family == socket.AF_INET6 else "0.0.0.0", self.config.local_port))

    def _begin(self, sock: socket.socket, address: Address) -> None:
        self._attach(address, sock)

    def _stranger(self, data: bytes, address: Address, now: float) -> UdpChannel | None:
        self._ignored += 1
        return None

    def _explain(self, error: OSError) -> str:
        return explain_address_error(error, "0.0.0.0", self.config.local_port)


class UdpBroadcastLink(UdpLink):
    """Broadcasts until a peer answers with a good frame, then sends to that peer until it is silent for 5 s."""

    config: models.UdpBroadcastLinkConfig

    def __init__(self, config: models.UdpBroadcastLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._probe = host.new_parser(config)
        self._channel: UdpChannel | None = None
        self._everybody: Address = ()
        self._silence: asyncio.TimerHandle | None = None

    @property
    def channels(self) -> list[Channel]:
        return [self._channel] if self._channel is not None else []

    async def close(self) -> None:
        if self._silence is not None:
            self._silence.cancel()
            self._silence = None
        await super().close()
        self._channel = None

    def _set_up(self, sock: socket.socket, family: int, address: Address) -> None:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sock.bind(("::" if family == socket.AF_INET6 else "0.0.0.0", self.config.local_port))

    def _begin(self, sock: socket.socket, address: Address) -> None:
        self._everybody = address
        self._channel = UdpChannel(self, sock, address)
        self.host.attach(self._channel)

    def _stranger(self, data: bytes, address: Address, now: float) -> UdpChannel | None:
        channel = self._channel
        if channel is None or self._peers or not self._good_frames(self._probe, data, now) or self._is_own(address):
            self._ignored += 1
            return None
        self._peers[address] = channel
        channel.address = address
        channel.peer = format_address(address)
        self._silence = self.loop.call_later(BROADCAST_AGAIN_S, self._on_silence)
        return channel

    def _on_silence(self) -> None:
        self._silence = None
        channel = self._channel
        if channel is None:
            return
        left_s = channel.last_rx_at + BROADCAST_AGAIN_S - self.loop.time()
        if left_s > MIN_EXPIRY_STEP_S:
            self._silence = self.loop.call_later(left_s, self._on_silence)
            return
        self._peers.clear()
        channel.address = self._everybody
        channel.peer = format_address(self._everybody)

    def _is_own(self, address: Address) -> bool:
        """True if this is our own broadcast: our port at an address of this machine.

        Connecting a UDP socket sends nothing; to one of its own addresses a machine talks from that same address.
        """
        if address[1] != self.bound_port or self._socket is None:
            return False
        with socket.socket(self._socket.family, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(address)
            except OSError:
                return False
            return bool(probe.getsockname()[0] == address[0])

    def _explain(self, error: OSError) -> str:
        return explain_address_error(error, "0.0.0.0", self.config.local_port)
