"""Routing of a vehicle that several channels hear: `core.routing.state_source` in the router."""

from __future__ import annotations

from skygcs.core.routing.filters import ChannelPolicy
from support.routed import RoutedNet, heartbeat, message
from support.table import each

GCS = ChannelPolicy(role="gcs", link="gcs")
KEY = 1 << 8 | 1


def opened(**policies: ChannelPolicy) -> RoutedNet:
    net = RoutedNet()
    for name, policy in policies.items():
        net.open(name, policy)
    return net


def two_vehicles() -> RoutedNet:
    """The one over "a" was there first; over "b" another sends with its ids."""
    net = opened(a=ChannelPolicy(link="a"), b=ChannelPolicy(link="b"))
    net.datagram("a", heartbeat(1, seq=1))
    for n in range(8):
        net.now += 1.0
        net.router.expire(net.now)
        for name, up_s in (("a", 100.0), ("b", 9000.0)):
            seq = (10 * n + (name == "b") * 128) & 0xFF
            net.datagram(name, heartbeat(1, seq=seq))
            net.datagram(name, message("ATTITUDE", 1, 1, seq + 1, time_boot_ms=round((up_s + net.now) * 1000)))
    return net


def test_orders_go_where_the_state_comes_from_and_emergencies_everywhere() -> None:
    net = two_vehicles()
    assert {name for name, counts in net.counted if counts} == {"a"}
    assert net.router.route_own(1, 1, net.now) == (net.ids["a"],)
    assert set(net.router.route_own(1, 1, net.now, everywhere=True)) == set(net.ids.values())
    assert net.router.selection.duplicates == {KEY}
    assert net.router.channels_of(KEY) == (net.ids["a"], net.ids["b"])
    (note,) = [n for n in net.router.table.notes if n.kind == "duplicate"]
    assert (note.channel_id, note.present_id) == (net.ids["b"], net.ids["a"])


@each("closed", [True, False])
def test_an_order_is_not_sent_to_the_other_vehicle_until_the_first_is_lost(closed: bool) -> None:
    net = two_vehicles()
    a, b = net.ids["a"], net.ids["b"]
    if closed:
        net.close("a")
        assert net.router.route_own(1, 1, net.now) == ()
        assert net.router.route_own(1, 1, net.now, everywhere=True) == (b,)
    for n in range(20):
        net.now += 1.0
        net.datagram("b", heartbeat(1, seq=n))
        net.router.expire(net.now)
    assert net.router.route_own(1, 1, net.now) == (b,)
    assert net.router.channels_of(KEY) == ((b,) if closed else (b, a)), "what supplies the state comes first"
    (replaced,) = [n for n in net.router.table.notes if n.kind == "replaced"]
    assert (replaced.channel_id, replaced.present_id) == (b, 0 if closed else a)


def test_a_restart_that_another_channel_pretends_clears_no_route() -> None:
    net = two_vehicles()
    net.router.table.notes.clear()
    for name, before_ms, cleared in (("b", 9_000_000, False), ("a", 90_000, True)):
        net.datagram(name, message("SYSTEM_TIME", 1, 1, 77, time_boot_ms=before_ms))
        net.datagram(name, message("SYSTEM_TIME", 1, 1, 78, time_boot_ms=1_000))
        assert ("cleared" in [n.kind for n in net.router.table.notes]) is cleared
        assert net.router.route_own(1, 1, net.now) == (net.ids["a"],)
    assert net.router.channels_of(KEY) == (net.ids["a"],)


def test_a_channel_whose_table_is_full_supplies_nothing_either() -> None:
    """Frames of a source that finds no room there are no less those of another channel."""
    net = opened(a=ChannelPolicy(link="a"), flood=ChannelPolicy(link="flood"))
    net.datagram("a", heartbeat(1))
    for sysid in range(2, 12):
        for compid in range(1, 200):
            net.datagram("flood", message("ATTITUDE", sysid, compid, 0))
    net.datagram("flood", message("GLOBAL_POSITION_INT", 1, 1, 9, lat=1, lon=1))
    assert net.router.channels_of(KEY) == (net.ids["a"],)
    assert net.counted == [("flood", False)]


@each("role", ["peer", "gcs"])
def test_a_bound_program_never_supplies_the_state_of_its_vehicle(role: str) -> None:
    program = ChannelPolicy(link="program", role="gcs", vehicles=frozenset({1}))
    net = opened(air=ChannelPolicy(link="air", role=role), program=program)
    net.datagram("air", heartbeat(1))
    net.datagram("program", message("GLOBAL_POSITION_INT", 1, 1, 9, lat=1, lon=1))
    assert net.counted in ([], [("program", False)])


def test_it_is_one_channel_again_when_nobody_else_has_its_ids() -> None:
    net = two_vehicles()
    for n in range(80):
        net.now += 1.0
        net.datagram("a", heartbeat(1, seq=n & 0xFF))
        net.router.expire(net.now)
    assert net.router.state_sources == {}
    (over,) = [n for n in net.router.table.notes if n.kind == "duplicate_over"]
    assert (over.channel_id, over.present_id) == (0, net.ids["a"])
    net.counted.clear()
    net.datagram("a", heartbeat(1, seq=99))
    assert net.counted == [], "nothing is compared any more"


def test_a_station_that_handed_back_frames_gives_way_to_the_vehicles_own_channel() -> None:
    net = opened(gcs=GCS, radio=ChannelPolicy(role="radio", link="radio"))
    net.datagram("gcs", message("ATTITUDE", 1))
    net.datagram("radio", heartbeat(1, seq=3))
    assert net.router.channels_of(KEY) == (net.ids["radio"],), "it was no heartbeat"
    net = opened(gcs=GCS, radio=ChannelPolicy(role="radio", link="radio"))
    net.datagram("gcs", heartbeat(1, seq=250))
    for n in range(20):
        net.now += 0.2
        net.datagram("radio", message("ATTITUDE", 1, 1, 2 * n, time_boot_ms=round(net.now * 1000)))
        net.datagram("radio", heartbeat(1, seq=2 * n + 1))
        net.datagram("gcs", heartbeat(1, seq=2 * n + 1))
    assert net.router.route_own(1, 1, net.now) == (net.ids["radio"],)
    assert net.router.channels_of(KEY) == (net.ids["radio"],), "the station was no way to it"


def test_a_setpoint_also_goes_over_the_other_link_while_the_first_is_in_doubt() -> None:
    net = opened(a=ChannelPolicy(link="a"), b=ChannelPolicy(link="b"))
    a, b = net.ids["a"], net.ids["b"]
    selection = net.router.selection

    def attitude(name: str, seq: int) -> None:
        net.datagram(name, message("ATTITUDE", 1, 1, seq, time_boot_ms=round(net.now * 1000)))

    for n in range(60):
        net.now += 0.5
        for name, offset in (("a", 0), ("b", 128)):
            seq = (2 * n + offset) & 0xFF
            net.datagram(name, heartbeat(1, seq=seq))
            attitude(name, seq + 1)
        selection.choose_links(net.now)
        net.router.expire(net.now)
    assert net.router.route_own(1, 1, net.now, setpoint=True) == (a,)
    assert set(net.router.route_own(1, 1, net.now, everywhere=True)) == {a, b}
    net.now += 0.75
    attitude("b", 7)
    assert net.router.route_own(1, 1, net.now, setpoint=True) == (a, b), "it is silent"
    assert net.router.route_own(1, 1, net.now) == (a,)
    attitude("a", 9)
    assert net.router.route_own(1, 1, net.now, setpoint=True) == (a,)
    selection.uplink_lost(KEY)
    switched: list[tuple[int, int]] = []
    selection.on_switched = lambda *change: switched.append(change)
    selection.choose_links(net.now)
    assert switched == [(KEY, b)]
    assert net.router.route_own(1, 1, net.now) == (b,)
    (note,) = [n for n in net.router.table.notes if n.kind == "switched"]
    assert (note.sysid, note.compid, note.channel_id, note.present_id) == (1, 1, b, a)
    assert selection.links_to_probe(net.now + 5.0) == [(KEY, a)]
    selection.uplink_lost(9 << 8 | 1)  # one that is heard on one link, or not at all


def test_what_is_recorded_unknown_or_handed_back_supplies_no_state() -> None:
    net = two_vehicles()
    net.open("replay", ChannelPolicy(link="replay", replayed=True))
    net.open("gcs", GCS)
    net.open("bound", ChannelPolicy(link="bound", role="gcs", vehicles=frozenset({1})))
    (beat,) = net.parsers["replay"].feed_datagram(heartbeat(1, seq=77))
    for name in ("replay", "gcs", "bound"):
        assert not net.router.selection.supplies(net.ids[name], beat, net.now, copy_of=None), name
    assert net.router.selection.supplies(net.ids["a"], beat, net.now, copy_of=None)
    unknown = bytes((0xFD, 1, 0, 0, 9, 1, 1, 0x40, 0xEE, 0x02)) + b"a\x12\x34"
    (frame,) = net.parsers["a"].feed_datagram(unknown)
    assert frame.info is None and not net.router.selection.supplies(net.ids["a"], frame, net.now, copy_of=None)
