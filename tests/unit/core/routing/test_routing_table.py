"""A flood of forged sources: what it may take of the routing table, and what it may not."""

from __future__ import annotations

import functools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.routing.filters import ChannelPolicy
from skygcs.core.routing.routing_table import (
    KEPT_ROUTES,
    MAX_CHANNEL_ROUTES,
    MAX_LINK_ROUTES,
    ROUTE_NOTES,
    RoutingVerdict,
)
from support.examples import examples
from support.routed import RoutedNet, heartbeat, message

NET = ChannelPolicy(link="net")
RADIO = ChannelPolicy(role="radio", link="radio")


def flood(net: RoutedNet, name: str, sources: int, *, first: int = 0, autopilot: bool = False) -> None:
    """So many sources that nobody has, from one channel."""
    for number in range(first, first + sources):
        net.datagram(name, forged(number, autopilot))


@functools.cache
def forged(number: int, autopilot: bool) -> bytes:
    return heartbeat(1 + number // 255, 1 + number % 255, gcs=not autopilot)


def command(target: int, seq: int = 1) -> bytes:
    return message("COMMAND_LONG", 250, 190, seq, target_system=target, target_component=1, command=400)


@pytest.fixture
def net() -> RoutedNet:
    return RoutedNet()


def test_8160_sources_of_one_peer_leave_room_for_a_vehicle_on_another_link(net: RoutedNet) -> None:
    net.open("hostile", NET)
    net.open("radio", RADIO)
    net.open("gcs", ChannelPolicy(link="gcs"))
    flood(net, "hostile", 8160)
    assert len(net.router.table.routes()) == MAX_CHANNEL_ROUTES
    assert net.router.table.room.refused == 8160 - MAX_CHANNEL_ROUTES
    net.clear()
    net.datagram("hostile", forged(8160, False))
    assert net.reached() == {"radio", "gcs"}, "what finds no room is forwarded all the same"
    net.datagram("gcs", command(1 + 8160 // 255))
    assert net.decisions[-1].verdict is RoutingVerdict.UNKNOWN_TARGET
    net.datagram("radio", heartbeat(77))
    net.clear()
    net.datagram("gcs", command(77))
    assert net.reached() == {"radio"}
    assert net.router.route_own(77, 1, net.now) == (net.ids["radio"],)


def test_peers_of_one_link_keep_some_routes_each_whatever_the_others_send(net: RoutedNet) -> None:
    for number in range(6):
        net.open(f"hostile{number}", NET)
        flood(net, f"hostile{number}", 1100, autopilot=True)
    in_link = len(net.router.table.routes())
    assert in_link == MAX_LINK_ROUTES + 2 * KEPT_ROUTES
    net.open("vehicle", NET)
    net.datagram("vehicle", heartbeat(77))
    assert net.router.channels_of(77 << 8 | 1)[-1] == net.ids["vehicle"]


def test_an_autopilot_takes_the_place_of_the_silent_source_of_its_own_full_channel(net: RoutedNet) -> None:
    net.open("radio", RADIO)
    flood(net, "radio", 100)
    net.now += 1
    flood(net, "radio", MAX_CHANNEL_ROUTES - 100, first=100)
    net.datagram("radio", heartbeat(1, 1, gcs=True))  # the first of all is heard again
    net.datagram("radio", heartbeat(77))
    assert [bool(net.router.channels_of(key)) for key in (77 << 8 | 1, 1 << 8 | 1, 1 << 8 | 2)] == [True, True, False]
    assert len(net.router.table.routes()) == MAX_CHANNEL_ROUTES
    assert net.router.table.room.evicted == net.router.port_counters(net.ids["radio"])["routes_evicted"] == 1


def test_an_autopilot_takes_no_place_of_another_autopilot(net: RoutedNet) -> None:
    net.open("radio", RADIO)
    flood(net, "radio", MAX_CHANNEL_ROUTES, autopilot=True)
    before = net.router.table.routes()
    net.datagram("radio", heartbeat(250))
    assert net.router.table.routes() == before
    assert net.router.table.room.refused == 1


def test_within_a_link_the_channel_with_most_sources_gives_way(net: RoutedNet) -> None:
    for number in range(4):
        net.open(f"hostile{number}", NET)
        flood(net, f"hostile{number}", 1000 + 8 * number)
    net.open("vehicles", NET)
    flood(net, "vehicles", 200, autopilot=True)
    assert [channel for *_, channel, _ in net.router.table.routes()].count(net.ids["vehicles"]) == 200
    evicted = [net.router.port_counters(net.ids[f"hostile{n}"])["routes_evicted"] for n in range(4)]
    assert sum(evicted) == net.router.table.room.evicted > 0 and evicted == sorted(evicted)


def kinds_of(net: RoutedNet) -> list[str]:
    return [note.kind for note in net.router.table.notes]


def test_a_full_channel_is_noted_once_with_the_source_and_once_when_it_has_emptied(net: RoutedNet) -> None:
    net.open("hostile", NET)
    flood(net, "hostile", 3000)
    assert [kinds_of(net).count(kind) for kind in ("crowded", "learned")] == [1, ROUTE_NOTES]
    assert net.router.table.unreported_routes == MAX_CHANNEL_ROUTES - ROUTE_NOTES
    note = next(note for note in net.router.table.notes if note.kind == "crowded")
    assert (note.sysid, note.compid) == (1 + MAX_CHANNEL_ROUTES // 255, 1 + MAX_CHANNEL_ROUTES % 255)
    net.router.table.notes.clear()
    net.router.expire(net.now + 30)
    assert not net.router.table.notes
    net.router.expire(net.now + 61)
    assert kinds_of(net).count("crowded_over") == 1 and kinds_of(net).count("expired") <= ROUTE_NOTES
    assert net.router.table.routes() == []


def test_channels_that_come_flood_and_go_are_reported_now_and_then_only(net: RoutedNet) -> None:
    for again in range(6):
        net.open(f"client{again}", NET)
        flood(net, f"client{again}", MAX_CHANNEL_ROUTES + 10)
        net.close(f"client{again}")
        net.now += 0.2
        net.router.expire(net.now)
    assert kinds_of(net).count("crowded") == 1 and kinds_of(net).count("learned") <= ROUTE_NOTES + 5
    for again in range(500):
        net.open(f"own{again}", NET)
        net.datagram(f"own{again}", heartbeat(255, 25))
        net.close(f"own{again}")
    assert kinds_of(net).count("conflict") == ROUTE_NOTES


def test_a_reboot_is_noticed_after_a_flood_of_clocks(net: RoutedNet) -> None:
    def clock(sysid: int, compid: int, boot_ms: int) -> None:
        net.datagram("radio", message("SYSTEM_TIME", sysid, compid, time_boot_ms=boot_ms))

    net.open("radio", RADIO)
    net.datagram("radio", heartbeat(77))
    clock(77, 1, 60_000)
    for number in range(5000):
        clock(1 + number // 255, 1 + number % 255, 5)
    net.now += 61
    net.datagram("radio", heartbeat(77))
    net.router.expire(net.now)
    net.datagram("radio", heartbeat(78))
    clock(78, 1, 60_000)
    net.router.table.notes.clear()
    clock(78, 1, 1_000)
    assert kinds_of(net).count("cleared") == 1


def test_a_forged_clock_keeps_no_order_from_a_vehicle_that_is_heard(net: RoutedNet) -> None:
    net.open("radio", RADIO)
    net.open("gcs", ChannelPolicy(link="gcs"))
    net.open("hostile", NET)
    for second in range(20):
        net.datagram("radio", heartbeat(77, seq=second))
        net.datagram("gcs", heartbeat(250, 190, seq=second, gcs=True))
        for step in range(10):
            net.now += 0.1
            for source in ((77, 190), (77, 1), (250, 190), (250, 7)):
                for boot_ms in (60_000 - step, step):
                    net.datagram("hostile", message("SYSTEM_TIME", *source, step, time_boot_ms=boot_ms))
            ack = message("COMMAND_ACK", 77, 1, step, command=400, target_system=250, target_component=190)
            for name, data, to in (("gcs", command(77, step), "radio"), ("radio", ack, "gcs")):
                net.clear()
                net.datagram(name, data)
                assert to in net.reached()
    assert kinds_of(net).count("cleared") <= ROUTE_NOTES + 20


LINKS = {"a1": "a", "a2": "a", "a3": "a", "b1": "b"}


FLOODS = st.lists(
    st.tuples(
        st.sampled_from(sorted(LINKS)),
        st.integers(0, 12),
        st.sampled_from([1, 20, 400, 1100]),
        st.booleans(),
        st.sampled_from(["flood", "expire", "reopen"]),
    ),
    max_size=16,
)


@settings(max_examples=examples(25), deadline=None)
@given(FLOODS)
def test_whatever_floods_the_table_keeps_its_bounds_and_its_counts(steps) -> None:
    net = RoutedNet()
    for name, link in LINKS.items():
        net.open(name, ChannelPolicy(link=link))
    autopilots: dict[str, set[int]] = {name: set() for name in LINKS}
    for name, first, sources, autopilot, what in steps:
        net.now += 1.0
        if what == "flood":
            flood(net, name, sources, first=first * 300, autopilot=autopilot)
        elif what == "expire":
            net.now += 61
            net.router.expire(net.now)
        else:
            net.close(name)
            net.open(name, ChannelPolicy(link=LINKS[name]))
        by_channel = dict.fromkeys(net.ids.values(), 0)
        for _, _, channel, _ in net.router.table.routes():
            by_channel[channel] += 1
        assert max(by_channel.values()) <= MAX_CHANNEL_ROUTES
        for link in ("a", "b"):
            ours = [by_channel[net.ids[n]] for n, of in LINKS.items() if of == link]
            assert sum(ours) <= MAX_LINK_ROUTES + KEPT_ROUTES * len(ours)
        # an autopilot that was kept stays until it is silent, whatever comes
        for other in LINKS:
            now_here = {s << 8 | c for s, c, channel, _ in net.router.table.routes() if channel == net.ids[other]}
            if what == "flood":
                assert autopilots[other] <= now_here
            port = net.router._ports[net.ids[other]]
            autopilots[other] = set(port.vehicles)
            assert sum(map(len, port.of_system.values())) == len(port.heard)
    # what is counted is what is there: a table emptied takes as much as a new one
    for name in LINKS:
        net.close(name)
    assert not net.router.table.room._of_link and net.router.table.routes() == []
    net.open("new", ChannelPolicy(link="a"))
    flood(net, "new", 2000)
    assert len(net.router.table.routes()) == MAX_CHANNEL_ROUTES
