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
    assert net.router.channels_of(77 << 8 | 1)
    assert net.router.channels_of(1 << 8 | 1)
    assert not net.router.channels_of(1 << 8 | 2)
    assert len(net.router.table.routes()) == MAX_CHANNEL_ROUTES
    assert net.router.table.room.evicted == 1
    assert net.router.port_counters(net.ids["radio"])["routes_evicted"] == 1


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
    heard = [net.ids["vehicles"]] * 200
    assert [channel for *_, channel, _ in net.router.table.routes() if channel == net.ids["vehicles"]] == heard
    evicted = [net.router.port_counters(net.ids[f"hostile{n}"])["routes_evicted"] for n in range(4)]
    assert sum(evicted) == net.router.table.room.evicted > 0
    assert evicted == sorted(evicted)


def test_a_full_channel_is_noted_once_with_the_source_and_once_when_it_has_emptied(net: RoutedNet) -> None:
    net.open("hostile", NET)
    flood(net, "hostile", 3000)
    kinds = [note.kind for note in net.router.table.notes]
    assert kinds.count("crowded") == 1
    assert kinds.count("learned") == ROUTE_NOTES
    assert net.router.table.unreported_routes == MAX_CHANNEL_ROUTES - ROUTE_NOTES
    note = next(note for note in net.router.table.notes if note.kind == "crowded")
    assert (note.sysid, note.compid) == (1 + MAX_CHANNEL_ROUTES // 255, 1 + MAX_CHANNEL_ROUTES % 255)
    net.router.table.notes.clear()
    net.router.expire(net.now + 30)
    assert not net.router.table.notes
    net.router.expire(net.now + 61)
    kinds = [note.kind for note in net.router.table.notes]
    assert kinds.count("crowded_over") == 1
    assert kinds.count("expired") <= ROUTE_NOTES
    assert net.router.table.routes() == []


def test_channels_that_come_flood_and_go_are_reported_now_and_then_only(net: RoutedNet) -> None:
    for again in range(6):
        net.open(f"client{again}", NET)
        flood(net, f"client{again}", MAX_CHANNEL_ROUTES + 10)
        net.close(f"client{again}")
        net.now += 0.2
        net.router.expire(net.now)
    kinds = [note.kind for note in net.router.table.notes]
    assert kinds.count("crowded") == 1
    assert kinds.count("learned") <= ROUTE_NOTES + 5


def test_a_closed_link_gives_all_its_room_back(net: RoutedNet) -> None:
    for again in range(2):
        for number in range(5):
            net.open(f"{again}/{number}", NET)
            flood(net, f"{again}/{number}", 1000)
        for number in range(5):
            net.close(f"{again}/{number}")
    assert net.router.table.routes() == []
    net.open("radio", NET)
    flood(net, "radio", 10)
    assert len(net.router.table.routes()) == 10


def test_a_reboot_is_noticed_after_a_flood_of_clocks(net: RoutedNet) -> None:
    net.open("radio", RADIO)
    net.datagram("radio", heartbeat(77))
    net.datagram("radio", message("SYSTEM_TIME", 77, time_boot_ms=60_000))
    for number in range(5000):
        net.datagram("radio", message("SYSTEM_TIME", 1 + number // 255, 1 + number % 255, time_boot_ms=5))
    net.now += 61
    net.datagram("radio", heartbeat(77))
    net.router.expire(net.now)
    net.datagram("radio", heartbeat(78))
    net.datagram("radio", message("SYSTEM_TIME", 78, time_boot_ms=60_000))
    net.router.table.notes.clear()
    net.datagram("radio", message("SYSTEM_TIME", 78, time_boot_ms=1_000))
    assert [note.kind for note in net.router.table.notes if note.kind == "cleared"] == ["cleared"]


def test_a_forged_clock_keeps_no_order_from_a_vehicle_that_is_heard(net: RoutedNet) -> None:
    net.open("radio", RADIO)
    net.open("gcs", ChannelPolicy(link="gcs"))
    net.open("hostile", NET)
    net.datagram("gcs", heartbeat(250, 190, gcs=True))
    for second in range(20):
        net.datagram("radio", heartbeat(77, seq=second))
        net.datagram("gcs", heartbeat(250, 190, seq=second, gcs=True))
        for step in range(10):
            net.now += 0.1
            for source in ((77, 190), (77, 1), (250, 190), (250, 7)):
                net.datagram("hostile", message("SYSTEM_TIME", *source, step, time_boot_ms=60_000 - step))
                net.datagram("hostile", message("SYSTEM_TIME", *source, step, time_boot_ms=step))
            net.clear()
            net.datagram("gcs", command(77, step))
            assert "radio" in net.reached()
            net.clear()
            ack = message("COMMAND_ACK", 77, 1, step, command=400, target_system=250, target_component=190)
            net.datagram("radio", ack)
            assert "gcs" in net.reached()
    assert [note.kind for note in net.router.table.notes].count("cleared") <= ROUTE_NOTES + 20


def test_what_is_wrong_on_channels_that_come_and_go_is_noted_now_and_then_only(net: RoutedNet) -> None:
    for again in range(500):
        net.open(f"client{again}", NET)
        net.datagram(f"client{again}", heartbeat(255, 25))
        net.close(f"client{again}")
    assert [note.kind for note in net.router.table.notes].count("conflict") == ROUTE_NOTES


LINKS = {"a1": "a", "a2": "a", "a3": "a", "b1": "b"}


@settings(max_examples=examples(25), deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted(LINKS)),
            st.integers(0, 12),
            st.sampled_from([1, 20, 400, 1100]),
            st.booleans(),
            st.sampled_from(["flood", "expire", "reopen"]),
        ),
        max_size=16,
    )
)
def test_whatever_floods_the_table_keeps_its_bounds_and_its_counts(
    steps: list[tuple[str, int, int, bool, str]],
) -> None:
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
    assert not net.router.table.room._of_link
    net.open("new", ChannelPolicy(link="a"))
    flood(net, "new", 2000)
    assert len(net.router.table.routes()) == MAX_CHANNEL_ROUTES


def test_a_source_without_a_route_is_still_forwarded_and_answered_by_nobody(net: RoutedNet) -> None:
    net.open("hostile", NET)
    net.open("gcs", ChannelPolicy(link="gcs"))
    flood(net, "hostile", MAX_CHANNEL_ROUTES)
    net.clear()
    net.datagram("hostile", heartbeat(200, 7, gcs=True))
    assert net.reached() == {"gcs"}
    net.datagram("gcs", command(200))
    assert net.decisions[-1].verdict is RoutingVerdict.UNKNOWN_TARGET
