"""The hub: order of things, isolation of faults, counters that survive a replug, one record per message of ours."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.models import FleetConfig, LinkConfig, MemoryLinkConfig, RateLimits, ReplayLinkConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.decision import RouteNote
from skygcs.links.base import MAX_SOURCES_PER_CHANNEL, Channel, Link
from skygcs.links.outgoing import Outgoing
from skygcs.runtime.hub import (
    MAX_CHANNEL_ID,
    MAX_CLOSED_CHANNELS,
    MAX_CLOSED_SOURCES,
    OTHER_SOURCES,
    Hub,
    channel_policy,
)
from support.routed import DIALECT, heartbeat, message
from support.services import connect, list_recorder


class PlainLink(Link):
    """A link whose channels are made by hand."""

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    @property
    def channels(self) -> list[Channel]:
        return []


class PlainChannel(Channel):
    """Keeps what it is given."""

    def __init__(self, link: Link, peer: str) -> None:
        super().__init__(link, peer)
        self.got: list[bytes] = []
        self.priorities: list[Priority] = []

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        self.got.append(self.encode(outgoing))
        self.priorities.append(priority)
        return True


class Bench:
    """A hub whose surroundings only take notes."""

    def __init__(self, **daemon: Any) -> None:
        self.loop = asyncio.get_running_loop()
        self.vehicle_frames: list[tuple[int, str, str]] = []
        self.recorded: list[bytes] = []
        self.notes: list[tuple[str, int]] = []
        self.faults: list[str] = []
        self.hub = Hub(
            FleetConfig.model_validate({"daemon": daemon}),
            DIALECT,
            self.loop,
            lambda event: self.faults.append(event.text),
            recorder=list_recorder(lambda raw, unix_us: self.recorded.append(raw)),
        )
        self.fleet = connect(self.hub, self.on_vehicle_frame, self.on_note)

    def on_vehicle_frame(self, key: int, frame: Frame, label: str, now: float) -> None:
        if frame.name == "VFR_HUD":
            raise RuntimeError("a fault behind one message")
        self.vehicle_frames.append((key, frame.name, label))

    def on_note(self, note: RouteNote, channel: Channel | None) -> None:
        self.notes.append((note.kind, note.sysid))

    def channel(self, name: str, peer: str = "x", **keys: Any) -> PlainChannel:
        return self.channel_of(MemoryLinkConfig(name=name, **keys), peer)

    def channel_of(self, config: LinkConfig, peer: str = "x") -> PlainChannel:
        channel = PlainChannel(PlainLink(config, self.hub, self.loop), peer)
        self.hub.attach(channel)
        return channel

    def feed(self, channel: Channel, *raws: bytes, now: float = 1.0) -> None:
        for raw in raws:
            self.hub.on_frames(channel, channel.parser.feed_datagram(raw), now)


async def test_a_frame_is_routed_recorded_and_shown_to_the_fleet() -> None:
    bench = Bench()
    radio, gcs = bench.channel("radio", role="radio"), bench.channel("gcs", role="gcs")
    raw = heartbeat(7)
    bench.feed(radio, raw)
    assert gcs.got == [raw]
    assert radio.got == []
    assert bench.recorded == [raw]
    assert bench.vehicle_frames == [(7 << 8 | 1, "HEARTBEAT", "radio")]
    assert bench.notes == [("learned", 7)]
    assert (radio.rx_frames, radio.rx_bytes) == (1, len(raw))


async def test_a_fault_behind_one_frame_is_told_once_and_the_next_frames_pass() -> None:
    bench = Bench()
    radio, gcs = bench.channel("radio"), bench.channel("gcs")
    faulty = [message("VFR_HUD", 7, seq=n) for n in range(3)]
    bench.feed(radio, b"".join([*faulty, heartbeat(7, seq=3)]))
    assert len(gcs.got) == 4
    assert len(bench.faults) == 1
    assert bench.hub.faults == 3
    assert bench.vehicle_frames == [(7 << 8 | 1, "HEARTBEAT", "radio")]


async def test_copies_and_conflicts_are_neither_recorded_nor_shown() -> None:
    bench = Bench()
    a, b = bench.channel("a"), bench.channel("b")
    raw = heartbeat(7)
    bench.feed(a, raw)
    bench.feed(b, raw)
    bench.feed(a, heartbeat(255, 25, gcs=True))
    assert bench.recorded == [raw]
    assert len(bench.vehicle_frames) == 1
    assert ("conflict", 255) in bench.notes
    assert b.sources[7 << 8 | 1].frames == 1, "a copy still tells how good its link is"


async def test_a_message_of_ours_goes_where_its_target_was_heard_and_is_recorded_once() -> None:
    bench = Bench()
    a, b, gcs = bench.channel("a"), bench.channel("b"), bench.channel("gcs", role="gcs")
    bench.feed(a, heartbeat(7))
    bench.feed(b, heartbeat(8))
    bench.recorded.clear()
    for channel in (a, b, gcs):
        channel.got.clear()
    info = DIALECT.find("COMMAND_LONG")
    assert bench.hub.send(info, {"target_system": 8, "command": 400}, 8, 1, Priority.COMMAND)
    assert (len(a.got), len(b.got), len(gcs.got)) == (0, 1, 0)
    assert not bench.hub.send(info, {"target_system": 99}, 99, 1, Priority.COMMAND)
    assert bench.hub.send(info, {"command": 400}, 0, 0, Priority.EMERGENCY)
    assert (len(a.got), len(b.got), len(gcs.got)) == (1, 2, 0), "our broadcast orders are for vehicles"
    assert len(bench.recorded) == 2
    assert [raw[4] for raw in b.got] == [0, 1], "each channel counts its own sequence"


async def test_the_heartbeat_goes_everywhere() -> None:
    bench = Bench()
    channels = [bench.channel("a"), bench.channel("radio", role="radio"), bench.channel("gcs", role="gcs")]
    bench.hub.send_heartbeat(DIALECT.find("HEARTBEAT"), {"type": 6, "autopilot": 8, "mavlink_version": 3})
    assert [len(c.got) for c in channels] == [1, 1, 1]
    assert {c.priorities[0] for c in channels} == {Priority.HEARTBEAT}


async def test_a_channel_is_greeted_with_our_heartbeat_as_soon_as_it_is_open() -> None:
    bench = Bench()
    bench.hub.send_heartbeat(DIALECT.find("HEARTBEAT"), {"type": 6, "autopilot": 8, "mavlink_version": 3})
    opened, gone = bench.channel("a"), bench.channel("b")
    bench.hub.detach(gone, "closed at once")
    assert opened.got == [], "not from within the link's own opening"
    await asyncio.sleep(0)
    assert [raw[7] for raw in opened.got] == [0]
    assert opened.priorities == [Priority.HEARTBEAT]
    assert gone.got == []


async def test_a_message_everywhere_takes_every_channel_to_its_target_but_no_ground_station() -> None:
    bench = Bench()
    a, b, gcs = bench.channel("a"), bench.channel("b"), bench.channel("gcs", role="gcs")
    bench.feed(a, heartbeat(7, seq=1))
    bench.feed(b, heartbeat(7, seq=2), now=1.1)
    for channel in (a, b, gcs):
        channel.got.clear()
    info = DIALECT.find("COMMAND_LONG")
    assert bench.hub.send(info, {"target_system": 7, "command": 21}, 7, 1, Priority.COMMAND)
    assert len(a.got) + len(b.got) == 1
    assert bench.hub.send(info, {"target_system": 7, "command": 21}, 7, 1, Priority.COMMAND, everywhere=True)
    assert len(a.got) + len(b.got) == 3
    assert gcs.got == []


REPLAY = ReplayLinkConfig(name="flight", file=Path("flight.tlog"))


async def test_what_a_recording_orders_reaches_nobody_but_a_ground_station() -> None:
    bench = Bench()
    radio, peer, gcs = bench.channel("radio", role="radio"), bench.channel("peer"), bench.channel("gcs", role="gcs")
    recording = bench.channel_of(REPLAY)
    bench.feed(radio, heartbeat(7))
    bench.feed(peer, heartbeat(8))
    for channel in (radio, peer, gcs):
        channel.got.clear()
    gcs_heartbeat = heartbeat(255, 190, gcs=True)
    order = message("COMMAND_LONG", 255, 190, target_system=7, target_component=1, command=400)
    to_all = message("COMMAND_LONG", 255, 190, seq=1, command=400)
    bench.feed(recording, gcs_heartbeat, order, to_all)
    assert radio.got == peer.got == []
    assert order not in gcs.got
    assert gcs_heartbeat in gcs.got
    assert not bench.hub.send(DIALECT.find("COMMAND_LONG"), {"target_system": 255}, 255, 190, Priority.COMMAND)
    assert recording.got == []


async def test_a_recorded_vehicle_is_told_from_a_live_one_and_gives_way_to_it() -> None:
    bench = Bench()
    recording, radio = bench.channel_of(REPLAY), bench.channel("radio", role="radio")
    gcs = bench.channel("gcs", role="gcs")
    key = 7 << 8 | 1
    bench.feed(recording, heartbeat(7, seq=1))
    assert bench.fleet.changed == [key] and bench.hub.replayed == {key}
    bench.feed(gcs, heartbeat(7, seq=99))
    assert [link for _, _, link in bench.vehicle_frames] == ["flight"], "a ground station's echo of it is not shown"
    bench.feed(radio, heartbeat(7, seq=50))
    assert bench.fleet.changed == [key, key] and not bench.hub.replayed
    bench.feed(recording, heartbeat(7, seq=2))
    assert [link for _, _, link in bench.vehicle_frames] == ["flight", "radio"]
    assert bench.hub.replayed == set()


async def test_counters_survive_a_replug_and_the_pause_is_no_loss() -> None:
    bench = Bench()
    radio = bench.channel("radio", "/dev/ttyUSB0")
    bench.feed(radio, heartbeat(7, seq=1), heartbeat(7, seq=3))
    bench.hub.detach(radio, "unplugged")
    bench.hub.detach(radio, "unplugged")
    again = bench.channel("radio", "/dev/ttyUSB0")
    bench.feed(again, heartbeat(7, seq=90))
    stats = again.sources[7 << 8 | 1]
    assert (stats.frames, stats.lost) == (3, 1)
    bench.feed(radio, heartbeat(7, seq=91))
    assert stats.frames == 3, "a callback of the closed channel is passed over"


async def test_a_thousand_passing_peers_leave_a_bounded_memory() -> None:
    bench = Bench()
    for n in range(MAX_CLOSED_CHANNELS + 100):
        channel = bench.channel("udp", f"peer{n}")
        bench.feed(channel, heartbeat(7))
        bench.hub.detach(channel, "gone")
    assert len(bench.hub._closed_channels) == MAX_CLOSED_CHANNELS
    assert bench.hub.channels == {}


async def test_passing_peers_that_carry_a_large_fleet_leave_a_bounded_memory_too() -> None:
    bench = Bench()
    for n in range(2 * MAX_CLOSED_SOURCES // 200 + 2):
        channel = bench.channel("udp", f"peer{n}")
        bench.feed(channel, *(heartbeat(sysid) for sysid in range(1, 201)))
        bench.hub.detach(channel, "gone")
    kept = list(bench.hub._closed_channels.values())
    assert MAX_CLOSED_SOURCES - 200 < sum(map(len, kept)) <= MAX_CLOSED_SOURCES
    assert kept[-1] is channel.sources, "who left last is who may come back"


async def test_sources_beyond_the_bound_are_counted_together() -> None:
    bench = Bench()
    channel = bench.channel("bad")
    wanted = MAX_SOURCES_PER_CHANNEL + 50
    for n in range(wanted):
        bench.feed(channel, heartbeat(1 + n % 200, 1 + n // 200, gcs=True))
    assert len(channel.sources) == MAX_SOURCES_PER_CHANNEL + 1
    assert channel.sources[OTHER_SOURCES].frames == 50


async def test_an_autopilot_is_counted_by_itself_though_the_channels_table_is_full() -> None:
    bench = Bench()
    channel = bench.channel("bad")
    for n in range(MAX_SOURCES_PER_CHANNEL + 50):
        bench.feed(channel, heartbeat(1 + n % 200, 1 + n // 200, gcs=True), now=1.0 + n)
    bench.feed(channel, heartbeat(1, 1, gcs=True), now=900.0)
    bench.feed(channel, heartbeat(250, 1), heartbeat(250, 1, seq=1), now=901.0)
    assert channel.sources[250 << 8 | 1].frames == 2
    assert 1 << 8 | 1 in channel.sources
    assert 2 << 8 | 1 not in channel.sources, "which was silent for longest"
    assert len(channel.sources) == MAX_SOURCES_PER_CHANNEL + 1
    assert bench.faults == []


async def test_a_tap_hears_what_it_asked_for_until_it_is_removed() -> None:
    bench = Bench()
    channel = bench.channel("a")
    heard: list[tuple[str, int]] = []
    remove = bench.hub.add_observer({30}, {2 << 8 | 1}, lambda f, c, now: heard.append((f.name, f.sysid)))
    bench.feed(channel, message("ATTITUDE", 1), message("ATTITUDE", 2), heartbeat(2))
    remove()
    remove()
    bench.feed(channel, message("ATTITUDE", 2, seq=9))
    assert heard == [("ATTITUDE", 2)]


async def test_a_known_frame_with_a_bad_crc_passes_only_where_that_is_configured() -> None:
    good = message("ATTITUDE", 7, seq=1, roll=0.5, yawspeed=0.25)
    bad = good[:-1] + bytes((good[-1] ^ 0x55,))
    for policy, expected in (("drop", 0), ("pass", 1)):
        bench = Bench(bad_crc=policy)
        radio, gcs = bench.channel("radio"), bench.channel("gcs")
        bench.feed(radio, heartbeat(7))
        gcs.got.clear()
        bench.feed(radio, bad)
        assert len(gcs.got) == expected
        assert radio.parser.stats.bad_crc == 1


def test_only_a_replay_is_routed_as_a_recording() -> None:
    assert channel_policy(REPLAY, DIALECT).replayed
    assert not channel_policy(MemoryLinkConfig(name="x"), DIALECT).replayed


def test_a_policy_has_the_message_ids_of_its_names() -> None:
    config = MemoryLinkConfig(
        name="x",
        role="radio",
        block_msg_id_out=("ATTITUDE", "24", 60000),
        rate_out=RateLimits(messages={"VFR_HUD": 2.0, "*": 5.0, "1": 1.0}, bytes_per_s=500.0),
    )
    policy = channel_policy(config, DIALECT)
    assert policy.filter_out.block_msgids == {30, 24, 60000}
    assert policy.rates_out == {74: 2.0, 1: 1.0}
    assert (policy.default_hz_out, policy.bytes_per_s_out) == (5.0, 500.0)
    assert policy.forward_unknown is False
    with pytest.raises(KeyError, match="no message 'ATITUDE'"):
        channel_policy(MemoryLinkConfig(name="x", allow_msg_id_in=("ATITUDE",)), DIALECT)


async def test_ids_of_channels_stay_within_what_the_compiled_path_remembers() -> None:
    """A peer that comes under ever new addresses gets there in hours. Ids that are taken are left out."""
    bench = Bench()
    first, second = bench.channel("a"), bench.channel("b")
    bench.hub._next_id = MAX_CHANNEL_ID
    assert bench.channel("c").id == MAX_CHANNEL_ID
    assert (first.id, second.id, bench.channel("d").id) == (1, 2, 3)


async def test_a_fault_behind_a_whole_datagram_stays_in_the_hub() -> None:
    bench = Bench()
    radio, gcs = bench.channel("radio"), bench.channel("gcs")

    def fail(*_: object) -> bool:
        raise RuntimeError("a fault behind a datagram")

    radio.in_datagrams = True
    gcs.send = fail  # type: ignore[method-assign]
    bench.feed(radio, heartbeat(7) + heartbeat(7, seq=1))
    assert bench.faults == ["internal fault, please report it: RuntimeError: a fault behind a datagram"]
