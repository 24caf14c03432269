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
    assert sent(net, "radio", message("ATTITUDE", 1)) == {"qgc", "P1", "P12"}
    assert sent(net, "radio", message("MOUNT_STATUS", 1, 154)) == {"qgc", "P1", "P12"}
    assert sent(net, "radio", message("ATTITUDE", 2)) == {"qgc", "P12"}
    assert sent(net, "wire", message("ATTITUDE", 4)) == {"qgc", "P4"}
    assert sent(net, "radio", unknown_frame(sysid=3)) == {"qgc", "P3"}


def test_no_ground_station_no_radio_and_nothing_of_ours_goes_there(net: RoutedNet) -> None:
    assert sent(net, "qgc", heartbeat(250, 190, gcs=True)) == {"radio", "wire"}
    assert sent(net, "qgc", order(1)) == {"radio"}
    assert sent(net, "radio", message("RADIO_STATUS", 51, 68)) == {"qgc"}
    net.open("P51", bound(51))
    assert sent(net, "radio", message("RADIO_STATUS", 51, 68)) == {"qgc"}, "a radio is not a vehicle of that id"
    net.close("P51")
    ours = {name for name, i in net.ids.items() if i in net.router.route_own(0, 0, net.now)}
    assert ours == {"radio", "wire", "qgc"}


def test_an_order_of_ours_for_a_component_met_behind_a_bound_channel_does_not_go_there(net: RoutedNet) -> None:
    net.datagram("P1", message("HEARTBEAT", 9, 191, type=18, autopilot=8, mavlink_version=3))
    assert net.router.channels_of(9 << 8 | 191) == (net.ids["P1"],)
    assert net.router.route_own(9, 191, net.now, everywhere=True) == ()
    net.datagram("P3", message("HEARTBEAT", 9, 191, 1, type=18, autopilot=8, mavlink_version=3))
    assert net.router.route_own(9, 191, net.now, everywhere=True) == ()
    net.datagram("qgc", message("HEARTBEAT", 9, 191, 2, type=18, autopilot=8, mavlink_version=3))
    assert net.router.route_own(9, 191, net.now, everywhere=True) == (net.ids["qgc"],)


# -- from a bound channel


@each("component", [0, 1, 154])
def test_it_reaches_its_vehicle(component: int) -> None:
    net = one_radio()
    assert sent(net, "P1", order(1, target_component=component)) == {"radio"}
    assert sent(net, "P4", order(4, target_component=component)) == {"wire"}
    assert sent(net, "P12", order(2, target_component=component)) == {"radio"}


@each("target", [2, 3, 4, 9, 250, 255])
def test_it_reaches_nobody_else_and_not_us(target: int) -> None:
    net = one_radio()
    net.router.table.notes.clear()
    assert sent(net, "P1", order(target)) == set()
    assert net.decisions[0].verdict is RoutingVerdict.OUT_OF_BOUNDS
    assert not net.decisions[0].local
    assert net.router.counters[RoutingVerdict.OUT_OF_BOUNDS] == 1
    net.datagram("P1", order(target, seq=1))
    assert net.router.port_counters(net.ids["P1"])["out_of_bounds"] == 2
    noted = [(n.kind, n.sysid, n.compid, n.channel_id, n.target) for n in net.router.table.notes]
    assert noted == [("out_of_bounds", *PROGRAM, net.ids["P1"], target)], "told once"


def test_a_parameter_set_at_us_is_not_set(net: RoutedNet) -> None:
    assert sent(net, "P1", message("PARAM_SET", *PROGRAM, target_system=255, target_component=25)) == set()
    assert net.decisions[0].verdict is RoutingVerdict.OUT_OF_BOUNDS


@each("name", ["COMMAND_LONG", "MANUAL_CONTROL", "PARAM_REQUEST_LIST", "COMMAND_ACK"])
@each("version", [1, 2])
def test_what_is_for_all_is_for_none_of_several(name: str, version: int) -> None:
    net = one_radio()
    assert sent(net, "P12", message(name, *PROGRAM, version=version)) == set()
    assert net.decisions[0].verdict is RoutingVerdict.OUT_OF_BOUNDS


def test_manual_control_names_its_target_too(net: RoutedNet) -> None:
    assert sent(net, "P1", message("MANUAL_CONTROL", *PROGRAM, target=1)) == {"radio"}
    assert sent(net, "P1", message("MANUAL_CONTROL", *PROGRAM, target=2)) == set()


@each("name", ["HEARTBEAT", "SYSTEM_TIME", "GPS_RTCM_DATA"])
def test_what_is_for_nobody_by_name_stays_out_of_a_radio_that_others_hear(name: str) -> None:
    net = one_radio()
    values = {"type": 6, "autopilot": 8} if name == "HEARTBEAT" else {}
    assert sent(net, "P1", message(name, *PROGRAM, **values)) == {"qgc"}
    assert net.decisions[0].local, "a heartbeat is an operator's presence"
    assert sent(net, "P4", message(name, *PROGRAM, **values)) == {"qgc", "wire"}
    assert sent(net, "P12", message(name, *PROGRAM, **values)) == {"qgc"}


def test_an_id_nobody_can_read_goes_where_a_heartbeat_would(net: RoutedNet) -> None:
    assert sent(net, "P4", unknown_frame(sysid=255, compid=0)) == {"qgc", "wire"}
    assert sent(net, "P1", unknown_frame(sysid=255, compid=0)) == {"qgc"}


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


def test_an_autopilot_behind_a_bound_channel_is_an_echo(net: RoutedNet) -> None:
    net.router.table.notes.clear()
    assert sent(net, "P1", heartbeat(1)) == set()
    assert sent(net, "P1", heartbeat(77)) == set(), "also of one that nobody hears"
    assert net.router.counters[RoutingVerdict.DUPLICATE] == 2
    assert [n.kind for n in net.router.table.notes] == ["echo", "echo"]
    assert net.router.channels_of(77 << 8 | 1) == ()


def test_our_own_id_is_a_conflict_there_as_everywhere(net: RoutedNet) -> None:
    assert sent(net, "P1", message("COMMAND_LONG", 255, 25, target_system=1)) == set()
    assert net.decisions[0].verdict is RoutingVerdict.CONFLICT


# -- programs that are alike


def test_equal_frames_of_alike_programs_are_no_copies(net: RoutedNet) -> None:
    twice = message("COMMAND_LONG", *PROGRAM, 5, target_system=1, command=400)
    assert sent(net, "P1", twice) == {"radio"}
    assert sent(net, "P12", twice) == {"radio"}
    assert sent(net, "qgc", twice) == {"radio"}, "nor is that of one that is not bound"
    assert net.router.counters[RoutingVerdict.DUPLICATE] == 0
    beat = heartbeat(*PROGRAM, 6, gcs=True)
    for name in ("P1", "P3", "P4", "P12", "qgc"):
        net.clear()
        net.datagram(name, beat)
        assert net.decisions[0].local, name
    assert net.router.counters[RoutingVerdict.DUPLICATE] == 0


def test_an_answer_goes_to_the_programs_of_who_answers(net: RoutedNet) -> None:
    answer = {"command": 400, "target_system": PROGRAM[0], "target_component": PROGRAM[1]}
    assert sent(net, "radio", message("COMMAND_ACK", 3, **answer)) == {"P3"}
    assert net.decisions[0].local, "255/0 is our system, and no component of it"
    assert sent(net, "radio", message("COMMAND_ACK", 2, **answer)) == {"P12"}
    assert sent(net, "wire", message("COMMAND_ACK", 4, **answer)) == {"P4"}
    net.datagram("qgc", heartbeat(*PROGRAM, 9, gcs=True))
    assert sent(net, "radio", message("COMMAND_ACK", 3, 1, 1, **answer)) == {"P3", "qgc"}


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
    answer = {"command": 400, "target_system": PROGRAM[0], "target_component": PROGRAM[1]}
    for boot_ms in (900_000, 100):
        net.datagram("P3", message("SYSTEM_TIME", *PROGRAM, time_boot_ms=boot_ms))
    reached = sent(net, "radio", message("COMMAND_ACK", 3, **answer))
    assert "P3" in reached
    assert len(reached & {"qgc", "qgc2"}) == 1, "parallel they stay, whatever a bound one's clock says"


def test_filters_of_a_bound_channel_count_as_well(net: RoutedNet) -> None:
    net.open("quiet", bound(1, filter_out=MessageFilter(block_msgids=frozenset({30}))))
    assert "quiet" not in sent(net, "radio", message("ATTITUDE", 1))
    assert "quiet" in sent(net, "radio", message("HIGHRES_IMU", 1))


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


def test_opening_and_closing_a_bound_channel_changes_who_hears(net: RoutedNet) -> None:
    net.close("P1")
    assert sent(net, "radio", message("ATTITUDE", 1)) == {"qgc", "P12"}
    for name in ("P3", "P4", "P12"):
        net.close(name)
    assert sent(net, "radio", message("ATTITUDE", 1)) == {"qgc"}
    net.open("again", bound(1))
    assert sent(net, "radio", message("ATTITUDE", 1)) == {"qgc", "again"}
