"""One Digi XBee module in API mode: every node of its network is a channel.

Vehicles' modules work in transparent mode: what the autopilot writes comes here in pieces, each with its sender's
address, and a node's pieces are one byte stream. What we send is packed: as many whole frames as fit into one payload.
Only a frame that is longer than a payload is split.

The module takes a few payloads at a time (`core.xbee.modem`). So what waits stands in the queue of its channel, the
most urgent class of all nodes goes first, and nodes of one class take turns.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Hashable
from functools import partial
from typing import Any

import serial

from skygcs.config import models
from skygcs.core.mavlink.msgids import GPS_RTCM_DATA, HEARTBEAT
from skygcs.core.radio_link.transmit_queue import Outgoing, OwnMessage, Priority
from skygcs.core.xbee.api_frames import BROADCAST
from skygcs.core.xbee.modem import Heard, XBeeModem
from skygcs.events import Event
from skygcs.links.base import Channel, Link, LinkHost
from skygcs.links.reading import waiting_bytes
from skygcs.links.serial_port import discard, open_port
from skygcs.links.stream import READ_BYTES, RESCUE_AFTER_S, DescriptorWatcher, QueuedChannel, StreamIntake

USABLE_SHARE = 0.5
"""Share of the rate on air that payload gets over one hop: 105.5 of 200 kbit/s for a 900HP (Digi 90002173, P2MP
throughput, measured over a serial port of 115200 baud). Each further hop costs about as much again."""

FOR_ALL = frozenset({HEARTBEAT, GPS_RTCM_DATA})
"""Messages of our own that every node gets alike. Other messages without a target field may be for one vehicle (an
external position, for instance)."""

MAX_UNWRITTEN_BYTES = 4096
"""Bytes the port has not taken yet at which no more is given to the module: more than its window ever needs."""

EXPIRY_LOOK_S = 1.0
"""How often silent nodes are looked for."""


def format_xbee_address(address: int) -> str:
    """The 16 hexadecimal digits on a module's label."""
    return f"{address:016X}"


class XBeeChannel(QueuedChannel):
    """One node, by its 64-bit address."""

    def __init__(self, link: XBeeLink, address: int) -> None:
        super().__init__(link, format_xbee_address(address), None, None)
        self.address = address
        self.intake = StreamIntake(self)
        self.turn = 0
        """Number of the last payload that was its own."""
        self._xbee: XBeeLink | None = link
        self._unsent = b""
        """The frame that was taken from the queue and did not fit any more, or the rest of one that is split."""
        self._unsent_of: Outgoing = b""

    @property
    def urgency(self) -> Priority | None:
        """Class of the most urgent that waits; None if nothing does. What was begun is finished first."""
        if self._unsent:
            return Priority.EMERGENCY
        return next((priority for priority in Priority if self.queue.waiting(priority)), None)

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        link = self._xbee
        if link is None:
            self.tx_dropped += 1
            return False
        if link.broadcasts(outgoing):
            return link.send_to_all(self, outgoing)
        taken = self._offer(outgoing, priority, link.loop.time(), key)
        link.pump()
        return taken

    def take_payload(self, limit: int, now: float) -> bytes:
        """Whole frames, at most ``limit`` bytes together; b"" if nothing may go now."""
        if self._unsent and self.is_kept_back(self._unsent_of):
            self._unsent = b""
            self.tx_dropped += 1
        payload = self._unsent[:limit]
        self._unsent = self._unsent[limit:]
        while not self._unsent and (popped := self._pop(now)) is not None:
            raw = self.encode(popped[0])
            self._unsent_of = popped[0]
            self.tx_frames += 1
            if not payload:
                payload, self._unsent = raw[:limit], raw[limit:]
            elif len(payload) + len(raw) <= limit:
                payload += raw
            else:
                self._unsent = raw
        self.tx_bytes += len(payload)
        return payload

    def drop_waiting(self) -> int:
        gone = super().drop_waiting() + bool(self._unsent)
        self.tx_dropped += bool(self._unsent)
        self._unsent = b""
        if self._xbee is not None:
            self._xbee.drop_unwritten()
        return gone

    def close(self) -> None:
        """Nothing is sent after this; what waits is dropped and counted. Idempotent."""
        self._xbee = None
        self.intake.close()
        self.tx_dropped += self._line.clear() + bool(self._unsent)
        self._unsent = b""

    def counters(self) -> dict[str, Any]:
        link = self.link
        assert isinstance(link, XBeeLink)
        node = link.modem.nodes.get(self.address)
        return {**super().counters(), **({} if node is None else {"node": node.as_dict()})}


class XBeeLink(Link):
    """The module at a serial port and the nodes it hears. A node becomes a channel with its first packet, and stops
    being one after a silence of ``node_timeout_s`` (`is_given_up`)."""

    config: models.XBeeLinkConfig

    def __init__(self, config: models.XBeeLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self.modem = XBeeModem(escaped=config.api_mode == 2)
        self._allowed = frozenset(int(text, 16) for text in config.nodes)
        self._nodes: dict[int, XBeeChannel] = {}
        self._port: serial.Serial | None = None
        self._watcher: DescriptorWatcher | None = None
        self._unwritten = b""
        self._turn = 0
        self._last_to_all: Outgoing | None = None
        self._to_all = b""
        self._refused = 0
        self._full_reported = False
        self._wrong_reported = False
        self._timers: dict[str, asyncio.TimerHandle] = {}

    @property
    def bytes_per_s(self) -> float:
        return self.config.rf_kbps * 1000 / 8 * USABLE_SHARE

    @property
    def shares_air(self) -> bool:
        return True

    @property
    def channels(self) -> list[Channel]:
        return list(self._nodes.values())

    async def open(self) -> None:
        config = self.config
        self._port = open_port(config.device, config.baud, rtscts=config.rtscts, low_latency=True)
        try:
            self._watcher = DescriptorWatcher(self.loop, self._port.fileno(), self._on_ready)
            fd = self._port.fileno()
            self.host.reading.add(self, fd, partial(waiting_bytes, fd))
            self._write(b"".join(self.modem.start(self.loop.time())))
            self._at("expiry", EXPIRY_LOOK_S, self._look_for_silent)
            self._look_at_modem()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        for address in list(self._nodes):
            self._drop(address, self.why_closed)
        watcher, self._watcher = self._watcher, None
        if watcher is not None:
            watcher.close()
        self.host.reading.remove(self)
        port, self._port = self._port, None
        if port is not None:
            discard(port)
        self.modem = XBeeModem(escaped=self.config.api_mode == 2)
        self._unwritten = self._to_all = b""
        self._last_to_all = None
        self._wrong_reported = False

    def counters(self) -> dict[str, Any]:
        """Return what the module is and counts; ``refused_packets``: from nodes that are not of ``nodes``, or too
        many."""
        return {"device": self.config.device, "modem": self.modem.status(), "refused_packets": self._refused}

    # -- towards the module

    def broadcasts(self, outgoing: Outgoing) -> bool:
        """True if this is sent to all nodes at once."""
        return (
            self.config.broadcast
            and len(self._nodes) > 1
            and isinstance(outgoing, OwnMessage)
            and outgoing.info.msgid in FOR_ALL
            and not any(channel.is_kept_back(outgoing) for channel in self._nodes.values())
        )

    def send_to_all(self, channel: XBeeChannel, outgoing: Outgoing) -> bool:
        """Send this once, though every channel is given it; False if the last one still waits. The sequence number is
        that of the channel which comes first, so vehicles count losses of ours that were none."""
        if outgoing is self._last_to_all:
            return True
        if self._to_all:
            channel.tx_dropped += 1
            return False
        self._last_to_all = outgoing
        self._to_all = channel.encode(outgoing)
        channel.tx_frames += 1
        channel.tx_bytes += len(self._to_all)
        self.pump()
        return True

    def pump(self) -> None:
        """Give the module what it takes, the most urgent first."""
        modem = self.modem
        now = self.loop.time()
        gave = False
        # the rest of a broadcast, if a gate has closed meanwhile
        last = self._last_to_all
        if self._to_all and last is not None and any(channel.is_kept_back(last) for channel in self._nodes.values()):
            self._to_all = b""
        while modem.has_room() and len(self._unwritten) < MAX_UNWRITTEN_BYTES:
            # the node whose frame is most urgent, in turn among equals
            channel = min(
                ((urgency, c.turn, c) for c in self._nodes.values() if (urgency := c.urgency) is not None),
                key=lambda entry: entry[:2],
                default=None,
            )
            if self._to_all and (channel is None or channel[0] >= Priority.HEARTBEAT):
                payload, self._to_all = self._to_all[: modem.payload_bytes], self._to_all[modem.payload_bytes :]
                address = BROADCAST
            elif channel is not None:
                address, payload = channel[2].address, channel[2].take_payload(modem.payload_bytes, now)
                self._turn += 1
                channel[2].turn = self._turn
            else:
                break
            if not payload:
                break
            gave = True
            self._write(modem.transmit(address, payload, now))
        if gave:
            self._look_at_modem()

    def _write(self, data: bytes) -> None:
        if self._port is None:
            return
        waited = bool(self._unwritten)
        self._unwritten += data
        if not waited:
            self._flush()

    def _flush(self) -> None:
        port, watcher = self._port, self._watcher
        if port is None or watcher is None:
            return
        try:
            written = os.write(port.fileno(), self._unwritten)
        except (BlockingIOError, InterruptedError):
            written = 0
        except OSError as error:
            self._broke((error.strerror or str(error)).lower())
            return
        self._unwritten = self._unwritten[written:]
        watcher.want_write(bool(self._unwritten))

    def drop_unwritten(self) -> None:
        """Drop what waits for the module: broadcasts, and packets that the port has not taken. The module itself
        drops a partial packet when another one follows.
        """
        self._unwritten = self._to_all = b""
        if self._watcher is not None:
            self._watcher.want_write(False)

    # -- from the module

    def _on_ready(self) -> None:
        port = self._port
        share = self.host.reading.share(self)
        if port is None or share is None:
            return
        try:
            data = os.read(port.fileno(), min(READ_BYTES, share.bytes))
        except (BlockingIOError, InterruptedError):
            data = None
        except OSError as error:
            self._broke((error.strerror or str(error)).lower())
            return
        if data == b"":
            self._broke("the other end closed it")
            return
        if data:
            self._take(self.modem.feed(data, self.loop.time()))
        if self in self.host.reading.stale and self.host.reading.emptied(self, len(data or b"")):
            self._take(self.modem.on_silence(self.loop.time()))
            for channel in list(self._nodes.values()):
                channel.intake.rescue()
            self.host.reading.trust(self)
        if self._unwritten:
            self._flush()
        self.pump()

    def _take(self, heard: Heard) -> None:
        if heard.questions:
            self.drop_unwritten()
            self._write(b"".join(heard.questions))
        for packet in heard.packets:
            channel = self._nodes.get(packet.address) or self._new_node(packet.address)
            if channel is None:
                self._refused += 1
            else:
                self.modem.admit(packet.address)
                channel.intake.feed(packet.payload)
        if self.modem.parser.pending:
            self._at("silence", RESCUE_AFTER_S, self._on_silence)
        elif (timer := self._timers.pop("silence", None)) is not None:
            timer.cancel()
        if heard.opened or heard.questions:
            self._look_at_modem()

    def _on_silence(self) -> None:
        if self.host.reading.asleep():  # it will be known to be stale, and then be dropped
            self._at("silence", RESCUE_AFTER_S, self._on_silence)
            return
        self._take(self.modem.on_silence(self.loop.time()))
        self.pump()

    def _new_node(self, address: int) -> XBeeChannel | None:
        if self._allowed and address not in self._allowed:
            return None
        if len(self._nodes) >= self.config.max_nodes:
            if not self._full_reported:
                self._full_reported = True
                text = f"link {self.name}: {len(self._nodes)} nodes are heard, further ones are refused (max_nodes)"
                self.host.on_event(Event("warning", None, None, text, {"link": self.name}))
            return None
        channel = self._nodes[address] = XBeeChannel(self, address)
        self.host.attach(channel)
        return channel

    # -- time

    def _at(self, name: str, after_s: float, what: Any) -> None:
        if (timer := self._timers.pop(name, None)) is not None:
            timer.cancel()
        self._timers[name] = self.loop.call_later(max(after_s, 0.001), what)

    def _look_at_modem(self) -> None:
        """Give up what was not answered in time, and report once what is wrong with the module's settings."""
        now = self.loop.time()
        if self.modem.expire(now):
            self.loop.call_soon(self.pump)
        wrong = self.modem.why_mute() or self.modem.why_wrong_mode()
        if wrong is not None and not self._wrong_reported:
            self._wrong_reported = True
            text = f"link {self.name}: {self.config.device}: {wrong}"
            self.host.on_event(Event("warning", None, None, text, {"link": self.name}))
        if (at := self.modem.next_expiry()) is not None:
            self._at("modem", at - now, self._look_at_modem)

    def _look_for_silent(self) -> None:
        now = self.loop.time()
        for address, channel in list(self._nodes.items()):
            if channel.is_given_up(self.config.node_timeout_s, now):
                self._drop(address, f"nothing heard for {self.config.node_timeout_s:g} s")
        self._at("expiry", EXPIRY_LOOK_S, self._look_for_silent)

    def _drop(self, address: int, reason: str) -> None:
        channel = self._nodes.pop(address)
        self.modem.forget(address)
        channel.close()
        self.host.detach(channel, reason)

    def _broke(self, reason: str) -> None:
        if self._watcher is not None:
            self._watcher.close()
        self.fail(f"xbee {self.config.device}: {reason}; unplugged, or its power went")
