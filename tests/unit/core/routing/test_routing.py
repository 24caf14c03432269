"""Rules beyond the 22 cases: own id, roles, copies, moves, reboots, expiry, filters, limits, bounds."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from skygcs.core.routing import router
from skygcs.core.routing.filters import ChannelPolicy, MessageFilter
from skygcs.core.routing.router import DuplicateFilter, ParallelChannels
from skygcs.core.routing.routing_table import RoutingVerdict
from support.examples import examples
from support.routed import RoutedNet, five_ports, heartbeat, message
from support.table import each

VEHICLE = ChannelPolicy(role="vehicle")
RADIO = ChannelPolicy(role="radio", forward_unknown=False)
GCS = ChannelPolicy(role="gcs")


def to(target: int, component: int = 1, sysid: int = 250, compid: int = 190, seq: int = 1) -> bytes:
    return message("COMMAND_LONG", sysid, compid, seq, target_system=target, target_component=component, command=400)


def of(**ports: ChannelPolicy) -> RoutedNet:
    net = RoutedNet()
    for name, policy in ports.items():
        net.open(name, policy)
    return net


def reached(net: RoutedNet, port: str, data: bytes) -> set[str]:
    """Where one datagram goes."""
    net.clear()
    net.datagram(port, data)
    return net.reached()


def ack(component: int) -> bytes:
    return message("COMMAND_ACK", 1, 1, 3, command=400, target_system=255, target_component=component)


def test_what_is_for_us_stays_and_what_is_for_others_of_our_system_id_goes_to_them() -> None:
    net = five_ports()
    net.open("qgc")
    net.datagram("qgc", heartbeat(255, 190, gcs=True))
    for component, wanted, local in ((25, set(), True), (190, {"qgc"}, False), (0, {"qgc"}, True)):
        assert reached(net, "V0", ack(component)) == wanted, component
        assert net.decisions[-1].local is local, component
    net.datagram("V0", heartbeat(1, seq=1))
    assert net.decisions[-1].local, "a broadcast is for us, too"


def test_our_own_id_from_outside_is_a_conflict_noted_once_and_not_learned() -> None:
    net = five_ports()
    net.router.table.notes.clear()
    for seq in range(3):
        net.datagram("G0", heartbeat(255, 25, seq, gcs=True))
    assert net.reached() == set()
    assert [n.kind for n in net.router.table.notes] == ["conflict"]
    assert net.router.counters[RoutingVerdict.CONFLICT] == 3
    assert reached(net, "V0", ack(25)) == set()


def test_telemetry_goes_to_ground_stations_and_peers_and_commands_to_whom_they_name() -> None:
    net = of(v1=VEHICLE, v2=VEHICLE, radio=RADIO, gcs=GCS, peer=ChannelPolicy())
    vehicles = {"v1": 1, "v2": 2, "radio": 3}
    for name, sysid in vehicles.items():
        net.datagram(name, heartbeat(sysid))
    for name, sysid in vehicles.items():
        assert reached(net, name, message("ATTITUDE", sysid, seq=2)) == {"gcs", "peer"}, name
    assert reached(net, "v1", to(3, sysid=1, compid=1)) == {"radio"}, "from vehicle to vehicle"
    assert reached(of(v1=VEHICLE, radio=RADIO, gcs=GCS), "gcs", to(0, 0)) == {"v1", "radio"}
    net = of(radio=RADIO, udp=ChannelPolicy(), gcs=GCS)
    net.datagram("udp", heartbeat(7))
    assert reached(net, "udp", message("ATTITUDE", 7, seq=1)) == {"gcs"}, "of a vehicle behind a peer link"
    net = of(a=ChannelPolicy(group="mast"), b=ChannelPolicy(group="mast"), gcs=ChannelPolicy())
    assert reached(net, "a", heartbeat(1)) == {"gcs"}, "links of one group do not feed each other"


def test_radio_status_never_goes_to_vehicles_of_any_role() -> None:
    net = of(radio=RADIO, v1=VEHICLE, peer=ChannelPolicy(), gcs=GCS)
    net.datagram("peer", heartbeat(9))
    for name in ("RADIO_STATUS", "RADIO"):
        assert reached(net, "radio", message(name, 51, 68, 1, txbuf=90)) == {"gcs"}


def test_unknown_ids_go_to_a_radio_only_if_it_says_so_and_teach_no_route() -> None:
    unknown = bytes((0xFD, 1, 0, 0, 9, 250, 77, 0x40, 0xEE, 0x02)) + b"a" + b"\x12\x34"
    net = of(gcs=GCS, radio=RADIO, radio2=ChannelPolicy(role="radio", forward_unknown=True))
    net.datagram("gcs", heartbeat(250, 77, gcs=True))
    assert reached(net, "gcs", unknown) == {"radio2"}
    before = net.router.table.routes()
    net.router.close(net.ids["gcs"])
    net.router.open(net.ids["gcs"], GCS)
    net.datagram("gcs", unknown)  # the parser still trusts the source; the route is not made by it
    assert [r[:2] for r in net.router.table.routes()] == [r[:2] for r in before if r[0] != 250]


def test_a_frame_heard_over_two_links_is_forwarded_once() -> None:
    net = of(a=ChannelPolicy(), b=ChannelPolicy(), gcs=GCS)
    for seq in range(20):
        first, second = ("a", "b") if seq % 3 else ("b", "a")
        for name in (first, second):
            net.datagram(name, message("ATTITUDE", 1, seq=seq, roll=seq * 0.1))
        assert net.router.first_channel_id == net.ids[first]
    assert len(net.got["gcs"]) == 20
    assert net.router.counters[RoutingVerdict.DUPLICATE] == 20
    net = five_ports()
    for _ in range(3):
        net.datagram("G0", to(1))
    assert len(net.got["V0"]) == 3, "scripts that never count their seq up mean what they repeat"


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(1, 3), st.sampled_from((0.0, 0.1, 0.4, 0.9, 1.1, 3.0)))))
@example([(1, 1, 0.0), (0, 1, 0.4), (1, 1, 0.2), (0, 2, 0.5)])
@example([(0, 1, 0.0), (0, 1, 1.1), (0, 2, 0.0)])
@example([(1, 1, 0.0), (0, 1, 0.1), (0, 1, 1.1), (1, 2, 0.9)])
def test_a_frame_is_remembered_for_a_second_and_forgotten_after_two(frames: list[tuple[int, int, float]]) -> None:
    """Unless more than so many are: the oldest of those are forgotten."""
    seen, now, begun = DuplicateFilter(), 50.0, dict[int, tuple[float, int]]()
    for key, channel_id, pause_s in frames:
        now += pause_s
        first = seen.first_heard_on(key, channel_id, now)
        at, before = begun.get(key, (-10.0, channel_id))
        if now - at < 1.0:
            assert first == before
        elif now - at > 2.0:
            assert first == channel_id
        if first == channel_id != before or now - at > 2.0:
            begun[key] = now, channel_id
        elif first == channel_id and now - at >= 1.0:  # forgotten and remembered anew, or not: both are right
            begun[key] = math.nan, channel_id


def test_more_frames_than_are_remembered_are_forgotten_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(router, "MAX_REMEMBERED", 4)
    seen = DuplicateFilter()
    for channel in (1, 2):
        assert [seen.first_heard_on(key, channel, 0.0) for key in range(7)] == [1] * 7
    seen.first_heard_on(7, 1, 0.0)
    assert [seen.first_heard_on(key, 2, 0.0) for key in (4, 7, 0)] == [1, 1, 2]


@each(("lost", "switches"), [(4, False), (8, True)])
def test_a_parallel_link_is_preferred_where_it_hears_a_tenth_more(lost: int, switches: bool) -> None:
    """Compared over 64 frames. A closed link is not preferred, nor one that carries no copies."""
    links = ParallelChannels(1)
    for n in range(64):
        if n >= lost:
            links.on_frame(1, copy=True)
        links.on_frame(2, copy=False)
    assert links.active and links.best == (2 if switches else 1)
    assert links.choose({1: 0.0, 2: 0.0, 3: 9.0}, 9.0) == links.best
    assert links.choose({1: 8.0, 2: 8.5, 3: 9.0}, 9.0) == links.best
    assert links.choose({1: 8.5, 2: 0.0, 3: 9.0}, 9.0) == 1
    for _ in range(3):
        links.on_frame(links.best, copy=False)
    gone = links.best
    links.forget(gone)
    assert links.best == 3 - gone and links.channel_ids == {3 - gone}


def test_a_message_of_ours_goes_to_the_component_where_that_is_heard() -> None:
    net = of(wire=VEHICLE, radio=ChannelPolicy())
    net.datagram("wire", heartbeat(1))
    net.datagram("radio", message("HEARTBEAT", 1, 154, type=30, autopilot=8, mavlink_version=3))
    assert net.router.route_own(1, 1, net.now) == (net.ids["wire"],)
    assert net.router.route_own(1, 154, net.now) == (net.ids["radio"],)


def heard_over(links: dict[str, tuple[int, int]]) -> RoutedNet:
    """Links that hear all frames of two phases but one in so many (0: all, 1: none)."""
    net = of(**dict.fromkeys(links, ChannelPolicy()), gcs=GCS)
    for seq in range(400):
        net.now += 0.02
        for name, loses in links.items():
            if not loses[seq // 200] or seq % loses[seq // 200]:
                net.datagram(name, message("ATTITUDE", 1, seq=seq & 0xFF, roll=seq * 0.1))
    return net


def test_the_better_of_two_parallel_links_is_used_to_send_while_it_is_heard() -> None:
    net = heard_over({"lossy": (3, 3), "good": (0, 0)})
    assert reached(net, "gcs", to(1)) == {"good"}
    assert net.router.route_own(1, 1, net.now) == (net.ids["good"],)
    assert reached(heard_over({"a": (0, 1), "b": (4, 0)}), "gcs", to(1)) == {"b"}, "the better one fell silent"
    net = heard_over({"a": (3, 3), "b": (0, 0)})
    net.close("b")
    assert reached(net, "gcs", to(1)) == {"a"}, "one is left"


def test_two_ground_stations_of_one_id_both_keep_their_answers() -> None:
    """Equal heartbeats by chance do not make two programs one: each gets the answer."""
    net = five_ports()
    net.open("qgc1")
    net.open("qgc2")
    for n in range(400):
        net.now += 1.0
        net.datagram("V0", message("ATTITUDE", 1, seq=n & 0xFF, roll=n * 0.1))
        net.datagram("qgc1", heartbeat(255, 190, n & 0xFF, gcs=True))
        net.datagram("qgc2", heartbeat(255, 190, n & 0xFF if n == 30 else (n + 7) & 0xFF, gcs=True))
    assert reached(net, "V0", ack(190)) == {"qgc1", "qgc2"}


def test_an_echo_from_a_ground_station_is_no_vehicle_and_no_way_to_it() -> None:
    net = of(radio=RADIO, gcs=GCS, gcs2=GCS)
    net.datagram("gcs", heartbeat(1, seq=9))  # met through the station first
    net.datagram("radio", heartbeat(1, seq=1))
    for seq in range(2, 10):
        net.now += 0.2
        net.datagram("radio", heartbeat(1, seq=seq))
        net.datagram("gcs", heartbeat(1, seq=seq))
        net.datagram("gcs", message("ATTITUDE", 1, seq=seq))
    assert net.router.route_own(1, 1, net.now) == (net.ids["radio"],)
    assert reached(net, "gcs2", to(1)) == {"radio"}
    assert [n.kind for n in net.router.table.notes].count("echo") == 1


def test_a_vehicle_whose_own_link_is_gone_is_heard_through_the_ground_station() -> None:
    net = of(radio=RADIO, gcs=GCS)
    net.datagram("radio", heartbeat(1, seq=1))
    net.datagram("gcs", heartbeat(1, seq=5))
    assert net.decisions[-1].verdict is RoutingVerdict.DUPLICATE
    net.now += 61.0
    net.router.expire(net.now)
    net.datagram("gcs", heartbeat(1, seq=6))
    assert net.decisions[-1].verdict is not RoutingVerdict.DUPLICATE
    assert net.router.channels_of(1 << 8 | 1) == (net.ids["gcs"],)


def test_a_recording_reaches_ground_stations_only_and_never_commands_anybody() -> None:
    net = of(replay=ChannelPolicy(replayed=True), radio=RADIO, v1=VEHICLE, peer=ChannelPolicy(), gcs=GCS)
    net.datagram("radio", heartbeat(1))
    net.clear()
    net.datagram("replay", heartbeat(5))
    net.datagram("replay", heartbeat(255, 190, gcs=True))
    assert net.reached() == {"gcs"}
    net.clear()
    net.datagram("replay", to(1, sysid=255, compid=190))
    net.datagram("replay", to(0, 0, sysid=255, compid=190, seq=2))
    assert net.reached() <= {"gcs"}
    assert reached(net, "replay", message("ATTITUDE", 1, seq=7)) == set(), "vehicle 1 is alive"
    net.datagram("gcs", to(5))
    net.datagram("gcs", to(0, 0, seq=2))
    assert "replay" not in net.reached()
    assert net.router.route_own(5, 1, net.now) == ()
    assert net.ids["replay"] not in net.router.route_own(0, 0, net.now)
    net.datagram("replay", heartbeat(255, 25, gcs=True))
    assert "conflict" not in [n.kind for n in net.router.table.notes], "our own old heartbeats are no conflict"


def beats(net: RoutedNet, seconds: float, *ports: str, **modes: int) -> None:
    """Heartbeats of vehicle 1 on these ports, once a second, never as copies."""
    shown = {"type": 2, "autopilot": 3, "mavlink_version": 3}
    for n in range(int(seconds)):
        net.now += 1.0
        net.router.expire(net.now)
        for at, port in enumerate(ports):
            seq = (n * 3 + at * 100) & 0xFF
            net.datagram(port, message("HEARTBEAT", 1, 1, seq, **shown, custom_mode=modes.get(port, 4)))


def notes(net: RoutedNet) -> list[str]:
    return [n.kind for n in net.router.table.notes if n.kind.startswith("duplicate")]


def test_one_id_on_two_peers_of_one_port_is_two_vehicles_until_one_is_gone() -> None:
    net = of(a=ChannelPolicy(link="udp"), b=ChannelPolicy(link="udp"))
    for seconds, ports, noted, duplicates in (
        (3, "ab", [], set()),
        (4, "ab", ["duplicate"], {1 << 8 | 1}),
        (5, "a", ["duplicate", "duplicate_over"], set()),
    ):
        beats(net, seconds, *ports)
        assert (notes(net), net.router.selection.duplicates) == (noted, duplicates)
    net = of(a=ChannelPolicy(link="udp"), b=ChannelPolicy(link="udp"))
    beats(net, 10, "a")
    beats(net, 10, "b")
    assert notes(net) == [], "it moved to the other"


def test_one_vehicle_with_a_radio_and_wifi_is_one_vehicle_unless_it_is_in_two_modes_at_once() -> None:
    late = (10, {}), (2, {"wifi": 5}), (10, {"wifi": 5, "radio": 5})  # the change shows on the radio a little later
    for shown, noted in ((late, []), (((8, {"wifi": 5}),), ["duplicate"])):
        net = of(radio=ChannelPolicy(link="radio"), wifi=ChannelPolicy(link="wifi"))
        for seconds, modes in shown:
            beats(net, seconds, "radio", "wifi", **modes)
        assert notes(net) == noted


def test_system_time_going_back_clears_the_routes_of_that_system_only() -> None:
    net = five_ports()
    net.datagram("V0", message("SYSTEM_TIME", 1, 1, 3, time_boot_ms=600_000))
    net.datagram("V2", heartbeat(1, seq=4))
    net.now += 2.5
    net.datagram("V0", message("SYSTEM_TIME", 1, 1, 5, time_boot_ms=3_000))
    assert reached(net, "G0", to(1)) == {"V0"}
    assert reached(net, "G0", to(2)) == {"V1"}
    assert [n.sysid for n in net.router.table.notes if n.kind == "cleared"] == [1]


def test_the_last_route_to_a_vehicle_in_the_air_does_not_expire() -> None:
    """Its downlink may be lost alone; the older one of two ways goes."""
    net = five_ports()
    net.router.table.may_fly = lambda source: source == 1 << 8 | 1
    net.now += 5
    net.datagram("V2", heartbeat(1, seq=9))
    net.now += 300
    net.router.expire(net.now)
    net.datagram("G0", heartbeat(249, gcs=True))
    assert reached(net, "G0", to(1)) == {"V2"}
    assert reached(net, "G0", to(2)) == set()


def test_routes_expire_and_say_so_once() -> None:
    net = five_ports()
    net.now += 59
    net.datagram("V1", heartbeat(2, seq=1))
    net.now += 2
    net.router.table.notes.clear()
    net.router.expire(net.now)
    net.router.expire(net.now)
    assert sorted((n.kind, n.sysid) for n in net.router.table.notes) == [("expired", s) for s in (1, 1, 3, 249, 250)]
    assert (reached(net, "G0", to(1)), reached(net, "G0", to(2))) == (set(), {"V1"})


def test_what_is_addressed_goes_where_its_target_is_heard() -> None:
    net = five_ports()
    net.datagram("V2", message("HEARTBEAT", 1, 191, type=18, autopilot=8, mavlink_version=3))
    assert reached(net, "G0", to(1, 191)) == {"V2"}, "a component that is heard elsewhere"
    assert reached(net, "G0", to(1, 1, seq=2)) == {"V0"}
    assert reached(net, "G0", message("MANUAL_CONTROL", 250, 190, target=2, x=100)) == {"V1"}, "its field is `target`"
    net.datagram("V2", heartbeat(1, seq=9))
    assert "V2" in reached(net, "G0", to(1, seq=3)), "it moved, and is followed at once"
    net.close("V1")
    assert reached(net, "G0", to(2)) == set(), "a closed channel takes its routes with it"
    assert net.decisions[-1].verdict is RoutingVerdict.UNKNOWN_TARGET


def test_filters_keep_messages_out_in_both_directions() -> None:
    gcs = ChannelPolicy(filter_out=MessageFilter(block_msgids=frozenset({30})))
    only2 = ChannelPolicy(filter_out=MessageFilter(allow_sysids=frozenset({2})))
    net = of(gcs=gcs, only2=only2, v=ChannelPolicy(filter_in=MessageFilter(block_compids=frozenset({100}))))
    for data, to_ports in (
        (message("ATTITUDE", 1), set()),
        (message("ATTITUDE", 2), {"only2"}),
        (heartbeat(1), {"gcs"}),
        (heartbeat(2, 100), set()),
    ):
        assert reached(net, "v", data) == to_ports
    assert all(route[:2] != (2, 100) for route in net.router.table.routes()), "what a filter kept out teaches nothing"
    assert net.router.port_counters(net.ids["gcs"])["filtered_out"] == 2
    assert net.router.port_counters(net.ids["v"])["filtered_in"] == 1


def test_a_rate_limit_per_message_holds_per_source() -> None:
    net = of(gcs=ChannelPolicy(rates_out={30: 2.0}), v=ChannelPolicy())
    for tick in range(1000):
        net.now = 100.0 + tick * 0.01
        for sysid in (1, 2):
            for name in ("ATTITUDE", "VFR_HUD"):
                net.datagram("v", message(name, sysid, seq=tick & 0xFF))
    attitudes = [raw for raw in net.got["gcs"] if raw[7] == 30]
    assert 2 * 20 <= len(attitudes) <= 2 * 22
    assert len(net.got["gcs"]) - len(attitudes) == 2000


def test_a_byte_budget_slows_broadcasts_but_never_commands_or_heartbeats() -> None:
    net = of(thin=ChannelPolicy(bytes_per_s_out=500.0), v=ChannelPolicy(), gcs=ChannelPolicy())
    net.datagram("thin", heartbeat(9))
    net.clear()
    for tick in range(1000):
        net.now = 100.0 + tick * 0.01
        net.datagram("v", message("ATTITUDE", 1, seq=tick & 0xFF, roll=0.1, yawspeed=0.1))
        if tick % 100 == 0:
            net.datagram("v", heartbeat(1, seq=tick & 0xFF))
            net.datagram("gcs", to(9, seq=tick & 0xFF))
    sent = {msgid: [raw for raw in net.got["thin"] if raw[7] == msgid] for msgid in (0, 30, 76)}
    assert (len(sent[0]), len(sent[76])) == (10, 10)
    assert sum(map(len, sent[30])) <= 500 * 10 + 280


ROLES = {"V0": VEHICLE, "V1": VEHICLE, "V2": RADIO, "G0": GCS, "G1": ChannelPolicy()}
SENDERS = st.tuples(st.sampled_from(sorted(ROLES)), st.integers(0, 6), st.sampled_from([1, 25, 100, 190]))
TARGETS = st.tuples(st.integers(0, 6), st.sampled_from([0, 1, 25, 77]))


@settings(max_examples=examples(150), deadline=None)
@given(st.lists(st.tuples(SENDERS, TARGETS, st.booleans()), max_size=60))
def test_whatever_comes_no_frame_returns_to_its_channel_and_targets_stay_private(steps) -> None:
    net = RoutedNet(own=(6, 25))
    for name, policy in ROLES.items():
        net.open(name, policy)
    heard: dict[int, set[str]] = {}
    for (port, sysid, compid), (target, component), is_beat in steps:
        net.clear()
        net.now += 0.3
        frame = heartbeat(sysid, compid) if is_beat else to(target, component, sysid, compid)
        net.datagram(port, frame)
        assert port not in net.reached()
        if (sysid, compid) == (6, 25):
            assert net.reached() == set()
            continue
        if not is_beat and target != 0:
            assert net.reached() <= heard.get(target, set())
        if sysid:
            heard.setdefault(sysid, set()).add(port)


# -- what the fast path may carry, what is counted, and what is noted


def entry(net: RoutedNet, name: str, data: bytes) -> tuple[int, ...] | None:
    """Destinations of all further frames like this one, which is routed first; None where each has to be decided."""
    (frame,) = net.parsers[name].feed_datagram(data)
    net.router.decide(net.ids[name], frame, net.now)
    found = net.router.forwarding_entry(net.ids[name], frame)
    return None if found is None else found.destinations


def test_the_fast_path_carries_frames_whose_decision_stays_the_same() -> None:
    net = five_ports()
    assert entry(net, "V0", message("ATTITUDE", 1, seq=7)) == tuple(net.ids[name] for name in ("V1", "V2", "G0", "G1"))
    blocked, passed = (MessageFilter(block_msgids=frozenset({msgid})) for msgid in (30, 31))
    for why, name, policy, data in (
        ("a clock may show a restart", "V0", None, message("SYSTEM_TIME", 1)),
        ("its own id", "V0", None, heartbeat(255, 25)),
        ("a recording", "R", ChannelPolicy(replayed=True), message("ATTITUDE", 9)),
        ("a limit on what comes", "L", ChannelPolicy(default_hz_in=5.0), message("ATTITUDE", 9)),
        ("a filter keeps it out", "F", ChannelPolicy(filter_in=blocked), message("ATTITUDE", 9)),
        ("an id of no dialect", "V0", None, bytes((0xFD, 1, 0, 0, 9, 1, 1, 0x40, 0xEE, 0x02)) + b"a\x12\x34"),
        ("a ground station hands it back", "S", GCS, message("ATTITUDE", 1)),
    ):
        net = five_ports()
        if policy is not None:
            net.open(name, policy)
        assert entry(net, name, data) is None, why
    for why, policy, carried in (
        ("a limit on what goes", ChannelPolicy(default_hz_out=5.0), False),
        ("a filter that keeps it back", ChannelPolicy(filter_out=blocked), False),
        ("a filter that passes it", ChannelPolicy(filter_out=passed), True),
        ("both", ChannelPolicy(filter_out=passed, default_hz_out=5.0), False),
    ):
        net = five_ports()
        net.open("gcs", policy)
        assert (entry(net, "V0", message("ATTITUDE", 1)) is not None) is carried, why

    net = of(alone=ChannelPolicy())
    assert entry(net, "alone", message("ATTITUDE", 1)) is None, "nobody to forward to, and no copies to compare"
    net.open("b")
    assert entry(net, "alone", message("ATTITUDE", 1, seq=1)) == (net.ids["b"],)
    net.open("gcs", GCS)
    net.datagram("b", message("ATTITUDE", 1, seq=2))
    assert entry(net, "alone", message("ATTITUDE", 1, seq=3)) is None, "it is heard on two channels"


def test_a_limit_on_what_comes_in_drops_what_is_above_it_and_counts_that() -> None:
    net = of(v=ChannelPolicy(default_hz_in=2.0), gcs=GCS)
    for tick in range(100):
        net.now = 100.0 + tick * 0.1
        net.datagram("v", message("ATTITUDE", 1, seq=tick))
        net.datagram("v", message("COMMAND_ACK", 1, 1, tick, command=400, target_system=250))
    passed = len([raw for raw in net.got["gcs"] if raw[7] == 30])
    assert 20 <= passed <= 22
    assert net.router.port_counters(net.ids["v"])["rate_limited"] == 100 - passed
    assert net.router.counters[RoutingVerdict.FILTERED_IN] == 100 - passed
    assert net.router.counters[RoutingVerdict.UNKNOWN_TARGET] == 100, "what is addressed is not slowed down"


def test_an_unknown_channel_is_no_fault() -> None:
    router = five_ports().router
    assert router.port_counters(99) == {} and not router.table.hears(99, 1) and router.table.autopilots_on(99) == ()
    router.close(99)
    net = five_ports()
    assert net.router.table.hears(net.ids["V0"], 1) and not net.router.table.hears(net.ids["V0"], 2)
    assert net.router.table.autopilots_on(net.ids["V1"]) == {2 << 8 | 1}


def test_notes_name_source_and_channel_and_what_is_not_reported_is_counted() -> None:
    net = RoutedNet()
    net.open("hostile")
    net.datagram("hostile", heartbeat(7, 3))
    net.datagram("hostile", heartbeat(255, 25))
    assert [(n.kind, n.sysid, n.compid, n.channel_id) for n in net.router.table.notes] == [
        ("learned", 7, 3, net.ids["hostile"]),
        ("conflict", 255, 25, net.ids["hostile"]),
    ]
    for again_s, conflicts in ((60.0, 1), (60.25, 2)):
        net.now += again_s
        net.datagram("hostile", heartbeat(255, 25))
        assert [n.kind for n in net.router.table.notes].count("conflict") == conflicts
    net.router.table.notes.clear()
    for number in range(300):
        net.datagram("hostile", message("ATTITUDE", 1 + number // 200, 1 + number % 200))
    learned = [n.kind for n in net.router.table.notes].count("learned")
    assert 0 < learned < 300 and net.router.table.unreported_routes == 300 - learned


def test_a_clock_that_goes_back_is_a_restart_only_if_it_began_just_now_or_goes_back_far() -> None:
    for before_ms, after_ms, cleared in (
        *((600_000, 597_000, False), (600_000, 596_999, True), (12_000, 10_000, False), (12_000, 9_999, True)),
        *((9_000, 9_000, False), (9_000, 9_001, False), (9_000, 8_999, True)),
    ):
        net = five_ports()
        net.datagram("V0", message("SYSTEM_TIME", 1, 1, 3, time_boot_ms=before_ms))
        net.datagram("V0", message("SYSTEM_TIME", 1, 1, 4, time_boot_ms=after_ms))
        assert ("cleared" in [n.kind for n in net.router.table.notes]) is cleared, (before_ms, after_ms)


def test_a_restart_leaves_the_routes_on_which_it_was_heard_within_two_seconds() -> None:
    for silent_s, stays in ((2.0, True), (2.25, False)):
        net = five_ports()
        net.datagram("V0", message("SYSTEM_TIME", 1, 1, 3, time_boot_ms=600_000))
        net.datagram("V2", message("ATTITUDE", 1, 7))
        net.now += silent_s
        net.datagram("V0", message("SYSTEM_TIME", 1, 1, 4, time_boot_ms=1_000))
        assert net.router.table.hears(net.ids["V2"], 1) is stays, silent_s


def test_copies_of_one_component_end_what_the_fast_path_carries_of_the_others() -> None:
    """From then on each frame of the system shows which of the links is the better one."""
    net = RoutedNet()
    for name in ("a", "b", "gcs"):
        net.open(name)
    net.datagram("a", heartbeat(1, seq=1))
    net.datagram("b", message("ATTITUDE", 1, seq=99))
    assert entry(net, "a", message("ATTITUDE", 1, 2, 2)) == (net.ids["b"], net.ids["gcs"])
    data = message("ATTITUDE", 1, seq=3)
    net.datagram("a", data)
    (copy,) = net.parsers["b"].feed_datagram(data)
    changes: list[str] = []
    net.router.table.on_change = lambda: changes.append("changed")
    assert net.router.decide(net.ids["b"], copy, net.now).verdict is RoutingVerdict.DUPLICATE
    assert changes
    assert entry(net, "a", message("ATTITUDE", 1, 2, 4)) is None


def test_what_every_change_of_a_route_does_to_the_fast_path() -> None:
    """Each that changes makes earlier entries wrong."""
    net = five_ports()
    changes: list[str] = []
    net.router.table.on_change = lambda: changes.append("changed")
    for happening, name, data, changed in (
        ("a frame of a known source", "V0", message("ATTITUDE", 1, seq=9), False),
        ("a new source without a vehicle", "V0", message("ATTITUDE", 9, 5), False),
        ("the same source on a second channel", "V1", message("ATTITUDE", 9, 5, 1), True),
        ("a new vehicle", "V0", heartbeat(9, 6), True),
        ("a copy, and a second channel", "V2", message("ATTITUDE", 1, seq=9), True),
    ):
        net.datagram(name, data)
        assert bool(changes) is changed, happening
        changes.clear()
    net.now += 61
    net.router.expire(net.now)
    assert changes, "a route that expired"
    changes.clear()
    net.close("G1")
    assert changes, "a channel that closed"
