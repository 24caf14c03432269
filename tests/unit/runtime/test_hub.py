"""The hub: order of things, isolation of faults, one record per message of ours."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace

import pytest

from skygcs.config.models import ReplayLinkConfig
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.runtime.hub import MAX_CHANNEL_ID
from support.clearances import cleared
from support.plain_hub import HubBench
from support.routed import DIALECT, heartbeat, message


@pytest.fixture
async def bench() -> HubBench:
    return HubBench()


async def test_a_frame_is_routed_recorded_and_shown_to_the_fleet(bench: HubBench) -> None:
    radio, gcs = bench.channel("radio", role="radio"), bench.channel("gcs", role="gcs")
    raw = heartbeat(7)
    bench.feed(radio, raw)
    assert gcs.got == [raw]
    assert radio.got == []
    assert bench.recorded == [raw]
    assert bench.vehicle_frames == [(7 << 8 | 1, "HEARTBEAT", "radio")]
    assert bench.notes == [("learned", 7)]
    assert (radio.rx_frames, radio.rx_bytes) == (1, len(raw))


async def test_a_fault_behind_one_frame_is_told_once_and_the_next_frames_pass(bench: HubBench) -> None:
    radio, gcs = bench.channel("radio"), bench.channel("gcs")
    faulty = [message("VFR_HUD", 7, seq=n) for n in range(3)]
    bench.feed(radio, b"".join([*faulty, heartbeat(7, seq=3)]))
    assert len(gcs.got) == 4
    assert len(bench.faults) == 1
    assert bench.hub.faults == 3
    assert bench.vehicle_frames == [(7 << 8 | 1, "HEARTBEAT", "radio")]


async def test_copies_and_conflicts_are_neither_recorded_nor_shown(bench: HubBench) -> None:
    a, b = bench.channel("a"), bench.channel("b")
    raw = heartbeat(7)
    bench.feed(a, raw)
    bench.feed(b, raw)
    bench.feed(a, heartbeat(255, 25, gcs=True))
    assert bench.recorded == [raw]
    assert len(bench.vehicle_frames) == 1
    assert ("conflict", 255) in bench.notes
    assert b.sources[7 << 8 | 1].frames == 1, "a copy still tells how good its link is"


async def test_a_message_of_ours_goes_where_its_target_was_heard_and_is_recorded_once(bench: HubBench) -> None:
    a, b, gcs = bench.channel("a"), bench.channel("b"), bench.channel("gcs", role="gcs")
    bench.feed(a, heartbeat(7))
    bench.feed(b, heartbeat(8))
    bench.recorded.clear()
    for channel in (a, b, gcs):
        channel.got.clear()
    info = DIALECT.find("COMMAND_LONG")
    assert bench.hub.send(
        info, {"target_system": 8, "command": 400}, 8, 1, Priority.COMMAND, clearance=cleared("disarm")
    )
    assert (len(a.got), len(b.got), len(gcs.got)) == (0, 1, 0)
    assert not bench.hub.send(info, {"target_system": 99, "command": 21}, 99, 1, Priority.COMMAND)
    assert bench.hub.send(info, {"command": 400}, 0, 0, Priority.EMERGENCY, clearance=cleared("disarm"))
    assert (len(a.got), len(b.got), len(gcs.got)) == (1, 2, 0), "our broadcast orders are for vehicles"
    assert len(bench.recorded) == 2
    assert [raw[4] for raw in b.got] == [0, 1], "each channel counts its own sequence"


async def test_the_heartbeat_goes_everywhere(bench: HubBench) -> None:
    channels = [bench.channel("a"), bench.channel("radio", role="radio"), bench.channel("gcs", role="gcs")]
    bench.hub.send_heartbeat(DIALECT.find("HEARTBEAT"), {"type": 6, "autopilot": 8, "mavlink_version": 3})
    assert [len(c.got) for c in channels] == [1, 1, 1]
    assert {c.priorities[0] for c in channels} == {Priority.HEARTBEAT}


async def test_a_channel_is_greeted_with_our_heartbeat_as_soon_as_it_is_open(bench: HubBench) -> None:
    bench.hub.send_heartbeat(DIALECT.find("HEARTBEAT"), {"type": 6, "autopilot": 8, "mavlink_version": 3})
    opened, gone = bench.channel("a"), bench.channel("b")
    bench.hub.detach(gone, "closed at once")
    assert opened.got == [], "not from within the link's own opening"
    await asyncio.sleep(0)
    assert [raw[7] for raw in opened.got] == [0]
    assert opened.priorities == [Priority.HEARTBEAT]
    assert gone.got == []


async def test_a_message_everywhere_takes_every_channel_to_its_target_but_no_ground_station(bench: HubBench) -> None:
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


async def test_what_waited_during_a_standstill_is_recorded_and_nothing_else(bench: HubBench) -> None:
    radio, gcs, played = bench.channel("radio", role="radio"), bench.channel("gcs", role="gcs"), bench.channel("sim")
    bench.hub.reading.stale = {radio: 1}  # the others had nothing to wait, as a simulation or a recording
    raw, new = heartbeat(7, seq=1), heartbeat(8)
    bench.feed(radio, raw)
    bench.feed(played, new)
    assert bench.recorded == [raw, new] and bench.hub.stale_frames == 1
    assert gcs.got == [new] and [key for key, *_ in bench.vehicle_frames] == [8 << 8 | 1]
    assert radio.rx_frames == 0 and radio.sources == {}
    bench.hub.reading.trust(radio)
    bench.feed(radio, heartbeat(7, seq=2))
    assert bench.hub.stale_frames == 1 and gcs.got[-1] == heartbeat(7, seq=2)


async def test_nothing_is_made_while_what_was_known_is_not_yet_forgotten(bench: HubBench) -> None:
    radio = bench.channel("radio", role="radio")
    bench.feed(radio, heartbeat(7))
    radio.got.clear()
    info = DIALECT.find("TIMESYNC")
    bench.hub.asleep = lambda: True
    assert not any(bench.hub.send(info, {"ts1": n}, 7, 1, Priority.COMMAND) for n in range(3))
    bench.hub.asleep = lambda: False
    assert bench.hub.send(info, {"ts1": 3}, 7, 1, Priority.COMMAND) and len(radio.got) == 1


async def test_no_link_to_a_vehicle_that_was_forgotten_is_probed_until_it_is_heard(bench: HubBench) -> None:
    radio = bench.channel("radio", role="radio")
    bench.feed(radio, heartbeat(7))
    bench.hub._fleet = fleet = SimpleNamespace(vehicles={}, vehicles_of=lambda _: [])  # type: ignore[assignment]
    bench.hub.router.selection.links_to_probe = lambda _: [(7 << 8 | 1, radio.id)]  # type: ignore[method-assign]
    bench.hub.choose_links(5.0)
    assert radio.got == []
    fleet.vehicles[7 << 8 | 1] = "heard again"
    bench.hub.choose_links(5.0)
    assert len(radio.got) == 1


REPLAY = ReplayLinkConfig(name="flight", file=Path("flight.tlog"))


async def test_what_a_recording_orders_reaches_nobody_but_a_ground_station(bench: HubBench) -> None:
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
    assert not bench.hub.send(
        DIALECT.find("COMMAND_LONG"), {"target_system": 255, "command": 21}, 255, 190, Priority.COMMAND
    )
    assert recording.got == []


async def test_a_recorded_vehicle_is_told_from_a_live_one_and_gives_way_to_it(bench: HubBench) -> None:
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


async def test_a_known_frame_with_a_bad_crc_passes_only_where_that_is_configured() -> None:
    good = message("ATTITUDE", 7, seq=1, roll=0.5, yawspeed=0.25)
    bad = good[:-1] + bytes((good[-1] ^ 0x55,))
    for policy, expected in (("drop", 0), ("pass", 1)):
        bench = HubBench(bad_crc=policy)
        radio, gcs = bench.channel("radio"), bench.channel("gcs")
        bench.feed(radio, heartbeat(7))
        gcs.got.clear()
        bench.feed(radio, bad)
        assert len(gcs.got) == expected
        assert radio.parser.stats.bad_crc == 1


async def test_ids_of_channels_stay_within_what_the_compiled_path_remembers(bench: HubBench) -> None:
    """A peer that comes under ever new addresses gets there in hours. Ids that are taken are left out."""
    first, second = bench.channel("a"), bench.channel("b")
    bench.hub._next_id = MAX_CHANNEL_ID
    assert bench.channel("c").id == MAX_CHANNEL_ID
    assert (first.id, second.id, bench.channel("d").id) == (1, 2, 3)


async def test_a_fault_behind_a_whole_datagram_stays_in_the_hub(bench: HubBench) -> None:
    radio, gcs = bench.channel("radio"), bench.channel("gcs")

    def fail(*_: object) -> bool:
        raise RuntimeError("a fault behind a datagram")

    radio.in_datagrams = True
    gcs.send = fail  # type: ignore[method-assign]
    bench.feed(radio, heartbeat(7) + heartbeat(7, seq=1))
    assert bench.faults == ["internal fault, please report it: RuntimeError: a fault behind a datagram"]
