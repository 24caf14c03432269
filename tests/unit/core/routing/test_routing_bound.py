"""Channels bound to vehicles: what reaches them, what may leave them, and how alike programs are told apart."""

from __future__ import annotations

import pytest

from skygcs.core.routing.filters import ChannelPolicy, MessageFilter
from skygcs.core.routing.routing_table import RoutingVerdict
from support.frames import unknown_frame
from support.routed import RoutedNet, heartbeat, message
from support.table import each

PROGRAM = (255, 0)
"""What every pymavlink program calls itself; our own system id, and another component."""


def bound(*sysids: int, **more: object) -> ChannelPolicy:
    return ChannelPolicy(role="gcs", vehicles=frozenset(sysids), **more)  # type: ignore[arg-type]


def one_radio() -> RoutedNet:
    """Systems 1 to 3 behind a radio, system 4 on a wire of its own, a ground station, and programs: P1 and P3 with one
    vehicle, P4 with that on the wire, P12 with two. All programs have the same id."""
    net = RoutedNet()
    net.open("radio", ChannelPolicy(role="radio"))
    net.open("wire", ChannelPolicy(role="vehicle"))
    net.open("qgc", ChannelPolicy(role="gcs"))
    for name, sysids in {"P1": (1,), "P3": (3,), "P4": (4,), "P12": (1, 2)}.items():
        net.open(name, bound(*sysids))
    for sysid in (1, 2, 3):
        net.datagram("radio", heartbeat(sysid))
    net.datagram("wire", heartbeat(4))
    net.datagram("qgc", heartbeat(250, 190, gcs=True))
    for name in ("P1", "P3", "P4", "P12"):
        net.datagram(name, heartbeat(*PROGRAM, gcs=True))
    net.clear()
    return net


def sent(net: RoutedNet, channel: str, data: bytes) -> set[str]:
    net.clear()
    net.datagram(channel, data)
    return net.reached()


def order(target: int, seq: int = 0, **values: object) -> bytes:
    return message("COMMAND_LONG", *PROGRAM, seq, target_system=target, command=400, **values)


# -- to a bound channel


@pytest.fixture
def net() -> RoutedNet:
    return one_radio()


def test_it_hears_its_vehicle_with_all_its_components_and_nobody_else(net: RoutedNet) -> None:
    net.open("P51", bound(51))
    for channel, data, heard in (
        ("radio", message("ATTITUDE", 1), {"qgc", "P1", "P12"}),
        ("radio", message("MOUNT_STATUS", 1, 154), {"qgc", "P1", "P12"}),
        ("radio", message("ATTITUDE", 2), {"qgc", "P12"}),
        ("wire", message("ATTITUDE", 4), {"qgc", "P4"}),
        ("radio", unknown_frame(sysid=3), {"qgc", "P3"}),
        ("qgc", heartbeat(250, 190, gcs=True), {"radio", "wire"}),
        ("qgc", order(1), {"radio"}),
        ("radio", message("RADIO_STATUS", 51, 68), {"qgc"}),  # a radio is not a vehicle of that id
    ):
        assert sent(net, channel, data) == heard, (channel, heard)
    net.close("P51")
    ours = {name for name, i in net.ids.items() if i in net.router.route_own(0, 0, net.now)}
    assert ours == {"radio", "wire", "qgc"}


def test_an_order_of_ours_for_a_component_met_behind_a_bound_channel_does_not_go_there(net: RoutedNet) -> None:
    for seq, (name, goes_to) in enumerate((("P1", ()), ("P3", ()), ("qgc", ("qgc",)))):
        net.datagram(name, message("HEARTBEAT", 9, 191, seq, type=18, autopilot=8, mavlink_version=3))
        assert net.router.route_own(9, 191, net.now, everywhere=True) == tuple(net.ids[n] for n in goes_to)
        assert name != "P1" or net.router.channels_of(9 << 8 | 191) == (net.ids["P1"],)


# -- from a bound channel


def test_it_reaches_its_vehicle(net: RoutedNet) -> None:
    for component in (0, 1, 154):
        for program, target, link in (("P1", 1, "radio"), ("P4", 4, "wire"), ("P12", 2, "radio")):
            assert sent(net, program, order(target, target_component=component)) == {link}
    assert sent(net, "P1", message("MANUAL_CONTROL", *PROGRAM, target=1)) == {"radio"}


@each("target", [2, 3, 4, 9, 250, 255])
def test_it_reaches_nobody_else_and_not_us(target: int) -> None:
    net = one_radio()
    net.router.table.notes.clear()
    named = {"target_system": target, "target_component": 25}
    control, setting = message("MANUAL_CONTROL", *PROGRAM, target=target), message("PARAM_SET", *PROGRAM, **named)
    for count, data in enumerate((order(target), order(target, seq=1), control, setting), 1):
        assert sent(net, "P1", data) == set()
        assert net.decisions[0].verdict is RoutingVerdict.OUT_OF_BOUNDS and not net.decisions[0].local
        assert net.router.counters[RoutingVerdict.OUT_OF_BOUNDS] == count
        assert net.router.port_counters(net.ids["P1"])["out_of_bounds"] == count
    noted = [(n.kind, n.sysid, n.compid, n.channel_id, n.target) for n in net.router.table.notes]
    assert noted == [("out_of_bounds", *PROGRAM, net.ids["P1"], target)], "told once"


@each("name", ["COMMAND_LONG", "MANUAL_CONTROL", "PARAM_REQUEST_LIST", "COMMAND_ACK"])
@each("version", [1, 2])
def test_what_is_for_all_is_for_none_of_several(name: str, version: int) -> None:
    net = one_radio()
    assert sent(net, "P12", message(name, *PROGRAM, version=version)) == set()
    assert net.decisions[0].verdict is RoutingVerdict.OUT_OF_BOUNDS


@each("name", ["HEARTBEAT", "SYSTEM_TIME", "GPS_RTCM_DATA", "unknown"])
def test_what_is_for_nobody_by_name_stays_out_of_a_radio_that_others_hear(name: str) -> None:
    net = one_radio()
    values = {"type": 6, "autopilot": 8} if name == "HEARTBEAT" else {}
    data = unknown_frame(sysid=255, compid=0) if name == "unknown" else message(name, *PROGRAM, **values)
    for program, reached in (("P1", {"qgc"}), ("P4", {"qgc", "wire"}), ("P12", {"qgc"})):
        assert sent(net, program, data) == reached
        assert net.decisions[0].local, "a heartbeat is an operator's presence"


def test_a_radio_is_its_vehicles_own_once_the_others_are_gone_and_not_before_it_is_heard() -> None:
    net = RoutedNet(route_timeout_s=60)
    net.open("radio", ChannelPolicy(role="radio"))
    net.open("P1", bound(1))
    beat = heartbeat(*PROGRAM, gcs=True)
    assert sent(net, "P1", beat) == set(), "who is behind a radio is not known before it is heard"
    net.datagram("radio", heartbeat(1))
    assert sent(net, "P1", beat) == {"radio"}
    net.datagram("radio", heartbeat(2))
    assert sent(net, "P1", beat) == set()
    net.now += 50
    net.datagram("radio", heartbeat(1, seq=1))
    net.now += 20
    net.router.expire(net.now)
    assert sent(net, "P1", beat) == {"radio"}


def test_an_autopilot_behind_a_bound_channel_is_an_echo_and_our_own_id_a_conflict(net: RoutedNet) -> None:
    net.router.table.notes.clear()
    assert sent(net, "P1", heartbeat(1)) == set()
    assert sent(net, "P1", heartbeat(77)) == set(), "also of one that nobody hears"
    assert net.router.counters[RoutingVerdict.DUPLICATE] == 2
    assert [n.kind for n in net.router.table.notes] == ["echo", "echo"]
    assert net.router.channels_of(77 << 8 | 1) == ()
    assert sent(net, "P1", message("COMMAND_LONG", 255, 25, target_system=1)) == set()
    assert net.decisions[0].verdict is RoutingVerdict.CONFLICT


# -- programs that are alike


def test_equal_frames_of_alike_programs_are_no_copies(net: RoutedNet) -> None:
    for name in ("P1", "P12", "qgc"):
        assert sent(net, name, order(1, 5)) == {"radio"}, name
    for name in ("P1", "P3", "P4", "P12", "qgc"):
        sent(net, name, heartbeat(*PROGRAM, 6, gcs=True))
        assert net.decisions[0].local, name
    assert net.router.counters[RoutingVerdict.DUPLICATE] == 0


ANSWER = {"command": 400, "target_system": PROGRAM[0], "target_component": PROGRAM[1]}


def test_an_answer_goes_to_the_programs_of_who_answers(net: RoutedNet) -> None:
    for channel, sysid, reached in (("radio", 3, {"P3"}), ("radio", 2, {"P12"}), ("wire", 4, {"P4"})):
        assert sent(net, channel, message("COMMAND_ACK", sysid, **ANSWER)) == reached
        assert net.decisions[0].local, "255/0 is our system, and no component of it"
    net.datagram("qgc", heartbeat(*PROGRAM, 9, gcs=True))
    assert sent(net, "radio", message("COMMAND_ACK", 3, 1, 1, **ANSWER)) == {"P3", "qgc"}


@each("program", [(245, 190), (1, 240)])
def test_answers_to_other_ids_go_the_same_way(program: tuple[int, int]) -> None:
    """MAVROS calls itself a component of system 1, which is another program's vehicle here."""
    net = one_radio()
    for name in ("P1", "P3", "P4", "P12"):
        net.datagram(name, message("HEARTBEAT", *program, type=18, autopilot=8, mavlink_version=3))
    answer = {"command": 400, "target_system": program[0], "target_component": program[1]}
    assert sent(net, "radio", message("COMMAND_ACK", 3, **answer)) == {"P3"}
    assert sent(net, "P3", message("COMMAND_LONG", *program, target_system=3)) == {"radio"}
    assert sent(net, "P3", message("HEARTBEAT", *program, 2, type=18, autopilot=8)) == {"qgc"}


def test_a_program_that_starts_again_does_not_cost_the_others_their_routes(net: RoutedNet) -> None:
    for name, boot_ms in (("P1", 900_000), ("P3", 900_000), ("P1", 100)):
        net.datagram(name, message("SYSTEM_TIME", *PROGRAM, time_boot_ms=boot_ms))
    assert net.ids["P3"] in net.router.channels_of(PROGRAM[0] << 8 | PROGRAM[1])
    net.datagram("qgc", message("SYSTEM_TIME", *PROGRAM, time_boot_ms=900_000))
    net.datagram("qgc", message("SYSTEM_TIME", *PROGRAM, 1, time_boot_ms=100))
    assert net.ids["P3"] in net.router.channels_of(PROGRAM[0] << 8 | PROGRAM[1])


def test_parallel_ground_stations_and_bound_programs_of_one_id_are_kept_apart(net: RoutedNet) -> None:
    net.open("qgc2", ChannelPolicy(role="gcs"))
    for seq in range(200):
        for name in ("qgc", "qgc2", "P3"):
            net.datagram(name, heartbeat(*PROGRAM, seq % 256, gcs=True))
        net.now += 0.1
    for boot_ms in (900_000, 100):
        net.datagram("P3", message("SYSTEM_TIME", *PROGRAM, time_boot_ms=boot_ms))
    reached = sent(net, "radio", message("COMMAND_ACK", 3, **ANSWER))
    assert "P3" in reached
    assert len(reached & {"qgc", "qgc2"}) == 1, "parallel they stay, whatever a bound one's clock says"


def test_opening_and_closing_a_bound_channel_changes_who_hears_and_its_filters_count(net: RoutedNet) -> None:
    net.open("quiet", bound(1, filter_out=MessageFilter(block_msgids=frozenset({30}))))
    assert sent(net, "radio", message("HIGHRES_IMU", 1)) == {"qgc", "P1", "P12", "quiet"}
    assert sent(net, "radio", message("ATTITUDE", 1, seq=1)) == {"qgc", "P1", "P12"}
    net.close("P1")
    assert sent(net, "radio", message("ATTITUDE", 1, seq=2)) == {"qgc", "P12"}
    for name in ("P3", "P4", "P12"):
        net.close(name)
    assert sent(net, "radio", message("ATTITUDE", 1, seq=3)) == {"qgc"}
    net.open("again", bound(1))
    assert sent(net, "radio", message("ATTITUDE", 1, seq=4)) == {"qgc", "again"}


# -- the fast path


def test_the_fast_path_carries_a_vehicles_frames_to_its_own_programs_and_none_of_a_programs(net: RoutedNet) -> None:
    (first,) = net.parsers["radio"].feed_datagram(message("ATTITUDE", 1))
    (other,) = net.parsers["radio"].feed_datagram(message("ATTITUDE", 3))
    for frame, programs in ((first, {"qgc", "P1", "P12"}), (other, {"qgc", "P3"})):
        decision = net.router.decide(net.ids["radio"], frame, net.now)
        entry = net.router.forwarding_entry(net.ids["radio"], frame)
        assert entry is not None
        assert entry.destinations == decision.destinations
        assert {name for name, i in net.ids.items() if i in entry.destinations} == programs
    (beat,) = net.parsers["P4"].feed_datagram(heartbeat(245, 190, gcs=True))
    net.router.decide(net.ids["P4"], beat, net.now)
    assert net.router.forwarding_entry(net.ids["P4"], beat) is None
