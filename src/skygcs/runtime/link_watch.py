"""How well each vehicle is heard lately: losses over the last half minute, and what the radios say of their signal."""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.core.mavlink.frame import Frame
from skygcs.core.preflight.facts import LinkFacts
from skygcs.core.preflight.losses import LossWindow
from skygcs.links.base import Channel
from skygcs.runtime.hub import Hub

"""The same fields; SiK sends the former, RFD900x firmware both."""

DB_PER_COUNT = 1 / 1.9
"""Of a SiK radio's rssi and noise: dBm = count / 1.9 - 127 (SiK's documentation of RADIO_STATUS)."""

RADIO_FRESH_S = 10.0
"""A radio tells once a second while it hears the other end."""

UNTOLD = 255
"""UINT8_MAX: invalid or unknown (common.xml)."""


@dataclass(slots=True)
class _Radio:
    margin_db: float
    at: float


class LinkWatch:
    """`tick` once a second; `on_radio` for every RADIO_STATUS. Never more entries than the hub has sources."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._losses: dict[tuple[int, int], LossWindow] = {}
        self._radios: dict[int, _Radio] = {}

    def tick(self, now: float) -> None:
        """Take the counters of every source of every channel."""
        seen: dict[tuple[int, int], LossWindow] = {}
        for channel_id, channel in self._hub.channels.items():
            for key, stats in channel.sources.items():
                window = self._losses.get((channel_id, key)) or LossWindow()
                window.sample(stats.frames, stats.lost, now)
                seen[channel_id, key] = window
        self._losses = seen
        self._radios = {n: radio for n, radio in self._radios.items() if n in self._hub.channels}

    def on_radio(self, frame: Frame, channel: Channel, now: float) -> None:
        """A radio at our end tells of both; a recorded one tells of another day."""
        if channel.config.type == "replay":
            return
        if channel.air is not None:
            channel.air.on_radio(frame, channel.tx_bytes, now)
        fields = frame.fields()
        ends = [(fields["rssi"], fields["noise"]), (fields["remrssi"], fields["remnoise"])]
        margins = [(rssi - noise) * DB_PER_COUNT for rssi, noise in ends if 0 < rssi < UNTOLD and noise < UNTOLD]
        if margins:
            self._radios[channel.id] = _Radio(min(margins), now)

    def of(self, key: int, now: float) -> dict[str, LinkFacts]:
        """By link, how a vehicle (sysid << 8 | compid) is heard; of several peers of one link, of the one that supplies
        its state."""
        facts: dict[str, LinkFacts] = {}
        for channel_id in self._hub.router.channels_of(key):
            link = self._hub.channels[channel_id].link.name
            if link in facts:
                continue
            window, radio = self._losses.get((channel_id, key)), self._radios.get(channel_id)
            facts[link] = LinkFacts(
                loss=None if window is None else window.loss(),
                frames=0 if window is None else window.frames(),
                margin_db=None if radio is None or now - radio.at > RADIO_FRESH_S else radio.margin_db,
            )
        return facts
