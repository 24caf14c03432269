"""TCP: a server with a channel per client, and a client. Each connection is a stream with its own bounded queue."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from collections.abc import Iterator
from typing import Any

from skygcs.config import models
from skygcs.core.routing.peer_places import Peer
from skygcs.descriptors import is_of_the_last
from skygcs.errors import LinkError, explain_address_error
from skygcs.links.base import Channel, Link, LinkHost
from skygcs.links.peers import Address, Admission, format_address, format_host, resolve
from skygcs.links.stream import DescriptorWatcher, StreamChannel, WriteLimits

CONNECT_TIMEOUT_S = 5.0
"""Per address. A LAN answers in milliseconds and Linux' own limit is two minutes."""

STUCK_AFTER_S = 10.0
"""A client that takes nothing for this long has gone without saying so, or is of no use to anybody."""

SEND_BUFFER_BYTES = 256 << 10
"""Requested from the kernel, which counts a small frame under way as some 1 kB: 256 frames within one round trip. More
would only let a slow client fall further behind."""

KEEPALIVE_IDLE_S = 10
KEEPALIVE_STEP_S = 5
KEEPALIVE_TRIES = 3
"""A silent client whose cable was pulled is noticed after 10 + 3 * 5 s."""

BACKLOG = 64
"""Connections that the kernel keeps until they are accepted, and as many, and one each, whose opening is under way."""

ACCEPTS_PER_WAKEUP = 16

ACCEPT_AGAIN_S = 1.0
"""Pause after the process ran out of descriptors: the listening socket stays readable and would spin the loop."""

_OUT_OF_RESOURCES = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})


def _set_options(sock: socket.socket) -> None:
    """Set the options that every connection has. Some of it fails if the peer has closed already; reading reports
    that."""
    with contextlib.suppress(OSError):
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEPALIVE_IDLE_S)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEPALIVE_STEP_S)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEPALIVE_TRIES)


class TcpServerLink(Link):
    """Listens on every address its host name has; each client is a channel. A client's end is not the link's."""

    config: models.TcpServerLinkConfig

    def __init__(self, config: models.TcpServerLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._listeners: dict[socket.socket, DescriptorWatcher | None] = {}
        self._clients: dict[StreamChannel, socket.socket] = {}
        self._hosts: dict[StreamChannel, str] = {}
        """Their addresses, without ports."""
        self._again: asyncio.TimerHandle | None = None
        self._session = 0
        self._admission = Admission(self, config.max_clients, config.allow_from, self._places)
        self._short_of_descriptors = 0

    @property
    def channels(self) -> list[Channel]:
        return list(self._clients)

    @property
    def bound_port(self) -> int:
        """The port while open, also where 0 (any) was configured; else 0."""
        return next((int(s.getsockname()[1]) for s in self._listeners), 0)

    async def open(self) -> None:
        config = self.config
        session = self._session
        try:
            found = await resolve(self.loop, config.host, config.port, socket.SOCK_STREAM)
        except LinkError as error:
            raise LinkError(f"tcp_server {error}") from None
        if session != self._session:
            raise LinkError(f"tcp_server {config.host}:{config.port}: closed while it was being opened")
        try:
            for family, address in found if config.port else found[:1]:  # port 0 would be another one each time
                self._listen(family, address)
        except BaseException as error:
            await self.close()
            if isinstance(error, OSError):
                reason = explain_address_error(error, config.host, config.port)
                raise LinkError(f"tcp_server {config.host}:{config.port}: {reason}") from None
            raise

    async def close(self) -> None:
        self._session += 1
        if self._again is not None:
            self._again.cancel()
            self._again = None
        for listener, readiness in self._listeners.items():
            self.host.reading.remove(listener)
            if readiness is not None:
                readiness.close()
            listener.close()
        self._listeners.clear()
        for channel in list(self._clients):
            self._drop(channel, self.why_closed)

    def counters(self) -> dict[str, Any]:
        admission = self._admission
        return {
            "clients_refused": admission.refused + self._short_of_descriptors,
            "clients_put_out": admission.put_out,
            "not_allowed": admission.not_allowed,
        }

    def _listen(self, family: int, address: Address) -> None:
        listener = socket.socket(family, socket.SOCK_STREAM)
        self._listeners[listener] = None
        listener.setblocking(False)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # own port again at once after a restart
        if family == socket.AF_INET6:
            both = len(self._listeners) == 1  # the only one: it takes IPv4 clients too, as "::" is expected to
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, not both)
        listener.bind(address)
        listener.listen(BACKLOG)
        self.host.reading.add(listener, listener.fileno(), lambda: 2 * (BACKLOG + 1))
        self._watch(listener)

    def _watch(self, listener: socket.socket) -> None:
        self._listeners[listener] = DescriptorWatcher(
            self.loop, listener.fileno(), lambda: self._on_connecting(listener)
        )

    def _on_connecting(self, listener: socket.socket) -> None:
        reading = self.host.reading
        if reading.asleep():
            return
        for _ in range(ACCEPTS_PER_WAKEUP):
            try:
                sock, address = listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                reading.trust(listener)
                return
            except OSError as error:
                if error.errno in _OUT_OF_RESOURCES:
                    self._pause_accepting()
                elif listener in self._listeners:
                    reason = explain_address_error(error, self.config.host, self.config.port)
                    self.fail(f"tcp_server {self.config.host}:{self.config.port}: {reason}")
                return
            if is_of_the_last(sock.fileno()):
                self._short_of_descriptors += 1
                sock.close()
            elif listener in reading.stale:
                sock.close()  # it waited during a standstill, with what was sent then: it connects anew
                if reading.emptied(listener, 1):
                    reading.trust(listener)
            elif self._admission.allows(address) and self._has_place(address):
                self._welcome(sock, address)
            else:
                sock.close()

    def _has_place(self, address: Address) -> bool:
        """True if a newcomer is admitted by its address; the client it replaces is closed."""
        if len(self._clients) < self.config.max_clients:
            return True
        admitted, key = self._admission.place_for(address, autopilot=False, now=self.loop.time())
        if isinstance(key, StreamChannel):
            self._drop(key, f"its place was given to {format_address(address)}: all were taken")
        return admitted

    def _places(self) -> Iterator[Peer]:
        for channel in self._clients:
            autopilot, kept = self.host.carries_autopilot(channel), self.host.leads_to_flying(channel)
            yield Peer(channel, self._hosts[channel], autopilot, channel.last_rx_at, kept)

    def _welcome(self, sock: socket.socket, address: Address) -> None:
        _set_options(sock)
        try:
            channel = StreamChannel(
                self,
                format_address(address),
                sock.fileno(),
                self._drop,
                WriteLimits(stuck_after_s=STUCK_AFTER_S, parks=True),
            )
        except OSError:  # no descriptor left for it
            self._short_of_descriptors += 1
            sock.close()
            return
        self._clients[channel] = sock
        self._hosts[channel] = format_host(address)
        self.host.attach(channel)
        self._admission.places.changed()

    def _drop(self, channel: StreamChannel, reason: str) -> None:
        sock = self._clients.pop(channel, None)
        if sock is not None:
            del self._hosts[channel]
            channel.close()
            sock.close()
            self.host.detach(channel, reason)
            self._admission.left(len(self._clients))

    def _pause_accepting(self) -> None:
        for listener, readiness in self._listeners.items():
            if readiness is not None:
                readiness.close()
                self._listeners[listener] = None
        if self._again is None:
            self._again = self.loop.call_later(ACCEPT_AGAIN_S, self._accept_again)

    def _accept_again(self) -> None:
        self._again = None
        try:
            for listener in self._listeners:
                if self._listeners[listener] is None:
                    self._watch(listener)
        except OSError:  # still none
            self._pause_accepting()


class TcpClientLink(Link):
    """One connection, one channel. When it ends the link has failed; the supervisor connects again."""

    config: models.TcpClientLinkConfig

    def __init__(self, config: models.TcpClientLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._socket: socket.socket | None = None
        self._channel: StreamChannel | None = None
        self._session = 0

    @property
    def channels(self) -> list[Channel]:
        return [self._channel] if self._channel is not None else []

    async def open(self) -> None:
        where = f"tcp_client {self.config.host}:{self.config.port}"
        session = self._session
        try:
            sock, address = await self._connect()
        except LinkError as error:
            raise LinkError(f"{where}: {error}") from None
        if session != self._session:
            sock.close()
            raise LinkError(f"{where}: closed while it was being opened")
        self._socket = sock
        try:
            _set_options(sock)
            self._channel = StreamChannel(
                self,
                format_address(address),
                sock.fileno(),
                self._on_broken,
                WriteLimits(stuck_after_s=STUCK_AFTER_S, parks=True),
            )
            self.host.attach(self._channel)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        self._session += 1
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()
            self.host.detach(channel, self.why_closed)
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    async def _connect(self) -> tuple[socket.socket, Address]:
        """The first address that answers. Raises LinkError with the last one's reason."""
        host, port = self.config.host, self.config.port
        reason = "the name has no address"
        for family, address in await resolve(self.loop, host, port, socket.SOCK_STREAM):
            sock = socket.socket(family, socket.SOCK_STREAM)
            try:
                sock.setblocking(False)
                async with asyncio.timeout(CONNECT_TIMEOUT_S):
                    await self.loop.sock_connect(sock, address)
                return sock, address
            except TimeoutError:
                reason = f"no answer within {CONNECT_TIMEOUT_S:g} s"
                sock.close()
            except OSError as error:
                reason = explain_address_error(error, host, port)
                sock.close()
            except BaseException:
                sock.close()
                raise
        raise LinkError(reason)

    def _on_broken(self, channel: StreamChannel, reason: str) -> None:
        if channel is self._channel:
            self.fail(f"tcp_client {self.config.host}:{self.config.port}: {reason}")
