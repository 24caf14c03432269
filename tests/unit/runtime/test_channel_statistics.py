"""Counters of channels and sources: they survive a replug, and their tables are bounded."""

from __future__ import annotations

from skygcs.links.base import MAX_SOURCES_PER_CHANNEL
from skygcs.runtime.channel_statistics import MAX_CLOSED_CHANNELS, MAX_CLOSED_SOURCES, OTHER_SOURCES
from support.plain_hub import HubBench
from support.routed import heartbeat


async def test_counters_survive_a_replug_and_the_pause_is_no_loss() -> None:
    bench = HubBench()
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
    bench = HubBench()
    for n in range(MAX_CLOSED_CHANNELS + 100):
        channel = bench.channel("udp", f"peer{n}")
        bench.feed(channel, heartbeat(7))
        bench.hub.detach(channel, "gone")
    assert len(bench.hub.statistics._closed_channels) == MAX_CLOSED_CHANNELS
    assert bench.hub.channels == {}


async def test_passing_peers_that_carry_a_large_fleet_leave_a_bounded_memory_too() -> None:
    bench = HubBench()
    for n in range(2 * MAX_CLOSED_SOURCES // 200 + 2):
        channel = bench.channel("udp", f"peer{n}")
        bench.feed(channel, *(heartbeat(sysid) for sysid in range(1, 201)))
        bench.hub.detach(channel, "gone")
    kept = list(bench.hub.statistics._closed_channels.values())
    assert MAX_CLOSED_SOURCES - 200 < sum(map(len, kept)) <= MAX_CLOSED_SOURCES
    assert kept[-1] is channel.sources, "who left last is who may come back"


async def test_sources_beyond_the_bound_are_counted_together() -> None:
    bench = HubBench()
    channel = bench.channel("bad")
    wanted = MAX_SOURCES_PER_CHANNEL + 50
    for n in range(wanted):
        bench.feed(channel, heartbeat(1 + n % 200, 1 + n // 200, gcs=True))
    assert len(channel.sources) == MAX_SOURCES_PER_CHANNEL + 1
    assert channel.sources[OTHER_SOURCES].frames == 50


async def test_an_autopilot_is_counted_by_itself_though_the_channels_table_is_full() -> None:
    bench = HubBench()
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


async def test_the_totals_of_a_link_include_channels_that_have_closed() -> None:
    bench = HubBench()
    first = bench.channel("udp", "a")
    bench.feed(first, heartbeat(7), heartbeat(7, seq=1))
    bench.hub.detach(first, "gone")
    bench.feed(bench.channel("udp", "b"), heartbeat(8))
    bench.feed(bench.channel("radio"), heartbeat(9))
    assert bench.hub.statistics.link_totals("udp")["rx_frames"] == 3
    assert bench.hub.statistics.link_totals("radio")["rx_frames"] == 1


async def test_after_a_reboot_the_new_sequence_numbers_are_no_loss() -> None:
    bench = HubBench()
    channel = bench.channel("radio")
    bench.feed(channel, heartbeat(7, seq=100), heartbeat(8, seq=100))
    bench.hub.statistics.restart_source(7 << 8 | 1)
    bench.feed(channel, heartbeat(7, seq=3), heartbeat(8, seq=103))
    assert [stats.lost for stats in channel.sources.values()] == [0, 2]
