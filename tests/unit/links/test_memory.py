"""The memory link, and stream parsing end to end over networks that are bad on purpose."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from skygcs.config import models
from skygcs.errors import LinkError
from skygcs.links.memory import MAX_IN_FLIGHT, MemoryLink
from support.hosts import RecordingHost, frames_in, heartbeat, own, text

pytestmark = pytest.mark.looptime

NETWORKS: dict[str, dict[str, Any]] = {
    "perfect": {},
    "one byte at a time": {"split": True},
    "a fifth lost": {"loss": 0.2},
    "every other twice": {"duplicate": 0.5},
    "late": {"delay_s": 2.0},
    "out of order": {"delay_s": 0.05, "jitter_s": 0.5},
    "all of it": {"split": True, "loss": 0.2, "duplicate": 0.2, "delay_s": 0.3, "jitter_s": 0.4},
}


def memory_link(hub: RecordingHost, **keys: Any) -> MemoryLink:
    return MemoryLink(models.MemoryLinkConfig(name="air", **keys), hub, asyncio.get_running_loop())


@pytest.mark.parametrize("network", NETWORKS)
async def test_over_a_bad_network_every_frame_that_arrives_is_whole_and_both_ways_work(network: str) -> None:
    keys = NETWORKS[network]
    host = RecordingHost()
    link = memory_link(host, seed=7, **keys)
    await link.open()
    sent = [text(n % 5 + 1, n % 256, f"number {n}") for n in range(400)]
    for n, frame in enumerate(sent):
        link.peer.send(frame)
        assert link.channels[0].send(frame)
        if n % 4 == 3:  # several at one instant keep their order too
            await asyncio.sleep(0.01)
    await asyncio.sleep(3)
    back = b"".join(link.peer.received)
    for got, lost in ((host.raws, link.inward.lost), ([f.raw for f in frames_in(back)], link.outward.lost)):
        assert set(got) <= set(sent), "nothing was invented"
        assert link.channels[0].parser.stats.bad_crc == 0
        if "loss" in keys:
            assert 40 < lost < 140 and 280 < len(set(got)) < 400
        else:
            assert lost == 0 and set(got) == set(sent)
        assert (len(got) > len(set(got))) is ("duplicate" in keys)
        order = [sent.index(raw) for raw in got]
        assert (order == sorted(order)) is ("jitter_s" not in keys)
    assert (max(map(len, link.peer.received)) == 1) is ("split" in keys)
    await link.close()


@pytest.mark.parametrize("network", ["out of order", "all of it"])
async def test_the_same_seed_gives_the_same_network(network: str) -> None:
    runs = []
    for seed in (1, 1, 2):
        host = RecordingHost()
        link = memory_link(host, seed=seed, **NETWORKS[network])
        await link.open()
        for n in range(100):
            link.peer.send(heartbeat(1, n))
        await asyncio.sleep(5)
        await link.close()
        runs.append(host.raws)
    assert runs[0] == runs[1] != runs[2]


async def test_nothing_arrives_from_within_a_send_so_that_answers_do_not_nest() -> None:
    host = RecordingHost()
    link = memory_link(host)
    await link.open()
    link.peer.on_bytes = lambda data: link.peer.send(heartbeat(1))
    link.channels[0].send(heartbeat(255))
    assert link.peer.received == [] and host.heard == []
    await asyncio.sleep(0.1)
    assert link.peer.received == [heartbeat(255)] and host.raws == [heartbeat(1)]
    await link.close()


async def test_a_frame_held_back_by_a_false_start_comes_after_a_silence() -> None:
    host = RecordingHost()
    link = memory_link(host)
    await link.open()
    link.peer.send(bytes((0xFD, 200, 0, 0, 0, 1, 1, 0, 0, 0)) + heartbeat(1))
    await asyncio.sleep(0.09)
    assert host.heard == []
    link.peer.send(heartbeat(2))
    await asyncio.sleep(0.09)
    assert host.heard == [], "the silence is counted from the last byte"
    await asyncio.sleep(0.02)
    assert host.raws == [heartbeat(1), heartbeat(2)]
    await link.close()


async def test_hang_up_fails_the_link_and_an_absent_peer_keeps_it_from_opening() -> None:
    host = RecordingHost()
    link = memory_link(host, delay_s=1.0)
    await link.open()
    channel = link.channels[0]
    link.peer.send(heartbeat(1))
    link.peer.hang_up()
    assert await link.failed == "memory air: the peer hung up"
    await link.close()
    await link.close()
    await asyncio.sleep(2)
    assert host.heard == [] and link.channels == [] and link.inward.lost == 1
    assert channel.send(heartbeat(1)) is False and channel.tx_dropped == 1
    assert host.detached == [(channel, "memory air: the peer hung up")]
    link.peer.absent = "unplugged"
    with pytest.raises(LinkError, match="memory air: unplugged"):
        await link.open()
    link.peer.absent = None
    link.rearm()
    await link.open()
    assert link.channels[0].send(own())
    await asyncio.sleep(2)
    assert [frame.sysid for frame in frames_in(b"".join(link.peer.received))] == [255]
    await link.close()


async def test_what_is_under_way_is_bounded() -> None:
    link = memory_link(RecordingHost(), delay_s=1.0)
    await link.open()
    for n in range(MAX_IN_FLIGHT + 10):
        link.peer.send(heartbeat(1, n))
    assert link.counters() == {"lost_in": 10, "lost_out": 0}
    await link.close()
