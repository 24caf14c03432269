"""The emulated radio network: its rounds, what it carries, loses and reports."""

from __future__ import annotations

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.capacity import SLOT_BYTES, round_s
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.radio_fleet import RadioFleet, slow_down
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import GROUND, RX_BUFFER_BYTES, TX_BUFFER_BYTES, TdmConfig, TdmNetwork
from skygcs.sim.vehicle_group import make_vehicles
from support.table import each

DIALECT = load_dialect("ardupilotmega")
FIELD = LocalFrame(43.78, -79.46, 180.0)


def network(nodes: int = 3, seed: int = 1, **config: object) -> TdmNetwork:
    return TdmNetwork(TdmConfig(nodes, **config), DIALECT, Rng(seed))  # type: ignore[arg-type]


def frame(size: int = 40, mark: int = 1) -> bytes:
    """Not a heartbeat, of so many bytes."""
    return bytes([0xFD, size - 12, 0, 0, mark & 0xFF, 1, 1, 30, 0, 0]) + bytes(size - 10)


def heartbeat() -> bytes:
    return encode(DIALECT.by_name["HEARTBEAT"], {"type": 6}, sysid=255, compid=190, seq=0)


def run(air: TdmNetwork, until: float, start: float = 0.0) -> list[tuple[float, int, bytes]]:
    out, now = [], start
    while now < until:
        out += [(now, node, raw) for node, raw in air.step(now)]
        now = round(now + 0.005, 6)
    return out


@each(("air_kbps", "nodes"), [(64.0, 2), (64.0, 11), (125.0, 11), (250.0, 16)])
def test_a_round_lasts_as_long_as_the_plan_says(air_kbps: float, nodes: int) -> None:
    assert TdmConfig(nodes, air_kbps).round_s == pytest.approx(round_s(air_kbps, nodes))


def test_each_node_is_carried_a_slot_a_round_and_no_more() -> None:
    air = network(nodes=3)
    came: dict[int, int] = {}
    for n in range(6000):
        now = n * 0.01
        for node in (1, 2):
            if air.txbuf_percent(node) > 20:
                air.write(node, frame(36), now)
        for node, raw in air.step(now):
            assert node == GROUND
            came[raw[4]] = came.get(raw[4], 0) + len(raw)
    total = sum(air.stats(n).sent_bytes for n in (1, 2))
    rounds = 60 / air.config.round_s
    assert total == pytest.approx(2 * rounds * SLOT_BYTES, rel=0.02), "7 frames of 36 B fill a packet of 252"


def test_a_frame_waits_for_its_turn_and_a_round_at_most() -> None:
    air = network(nodes=11)
    waits = []
    for n in range(30):
        now = n * 1.37
        air.write(GROUND, frame(), now)
        out = run(air, now + 1.3, now)
        arrivals = [at - now for at, node, _ in out if node == 5]
        assert len(arrivals) == 1
        waits += arrivals
    assert max(waits) <= air.config.round_s + 0.15
    assert max(waits) - min(waits) > 0.5 * air.config.round_s, "when it comes depends on where the round is"


def test_what_the_ground_says_reaches_every_vehicle_and_a_vehicle_the_ground_only() -> None:
    air = network(nodes=4)
    air.write(GROUND, frame(mark=9), 0.0)
    air.write(2, frame(mark=2), 0.0)
    out = run(air, 1.0)
    assert sorted(node for _, node, raw in out if raw[4] == 9) == [1, 2, 3]
    assert [node for _, node, raw in out if raw[4] == 2] == [GROUND]


def test_what_does_not_fit_the_transmit_buffer_is_lost_and_its_frame_cut() -> None:
    air = network(nodes=16)
    for n in range(100):
        air.write(GROUND, frame(100, n), 0.0)
    air.step(0.3)  # 57600 baud bring 1728 bytes in this time
    assert air.stats(GROUND).overflow_bytes == 0 and air.txbuf_percent(GROUND) < 40
    run(air, 6.0, 0.3)
    stats = air.stats(GROUND)
    assert stats.overflow_bytes > 5000
    assert stats.sent_bytes + stats.overflow_bytes + TX_BUFFER_BYTES >= 100 * 100


def test_with_flow_control_who_writes_is_told_to_wait() -> None:
    plain, careful = network(), network(rtscts=True)
    for air in (plain, careful):
        for _ in range(19):
            air.write(GROUND, frame(100), 0.0)
    assert plain.has_room(GROUND, 100)
    assert not careful.has_room(GROUND, 100)


def test_slots_that_bring_more_than_the_serial_port_takes_overflow_the_output() -> None:
    air = network(nodes=16, air_kbps=250.0)
    for n in range(4000):
        now = n * 0.01
        for node in range(1, 16):
            if air.txbuf_percent(node) > 60:
                air.write(node, frame(84), now)
        air.step(now)
    assert air.stats(GROUND).output_overflow_bytes > 0
    assert RX_BUFFER_BYTES < 2 * SLOT_BYTES


def test_the_serial_port_is_the_narrow_place_where_it_is_slower_than_the_air() -> None:
    air = network(nodes=2, baud=9600, air_kbps=250.0)
    sent = 0
    for n in range(2000):
        now = n * 0.01
        if air.txbuf_percent(1) > 80:
            air.write(1, frame(), now)
        sent += sum(len(raw) for _, raw in air.step(now))
    assert sent <= 20 * 960 + SLOT_BYTES


@each(("config", "least", "most"), [({"loss": 0.2}, 0.1, 0.3), ({"burst_loss": 0.2}, 0.05, 0.4)])
def test_so_many_packets_are_lost(config: dict[str, float], least: float, most: float) -> None:
    air = network(nodes=2, **config)
    for n in range(20_000):
        now = n * 0.01
        if n % 10 == 0:
            air.write(1, frame(200), now)
        air.step(now)
    packets = air.stats(1).sent_frames
    assert least < air.stats(1).lost_packets / packets < most


def test_losses_in_bursts_come_one_after_the_other() -> None:
    def longest_gap(**config: float) -> float:
        air, last, longest = network(nodes=2, **config), 0.0, 0.0
        for n in range(20_000):
            now = n * 0.01
            if n % 10 == 0:
                air.write(1, frame(200), now)
            if air.step(now):
                last, longest = now, max(longest, now - last)
        return longest

    assert longest_gap(burst_loss=0.2, burst_s=3.0) > 2 * longest_gap(loss=0.2)


def test_the_same_seed_loses_the_same_packets() -> None:
    def told(seed: int) -> list[tuple[float, int, bytes]]:
        air = network(nodes=3, loss=0.3, seed=seed)
        for n in range(50):
            air.write(1, frame(mark=n), 0.0)
        return run(air, 3.0)

    assert told(4) == told(4) != told(5)


def test_two_nodes_of_one_id_are_heard_by_nobody() -> None:
    air = network(nodes=4, node_ids=(0, 1, 1, 3))
    for node in (1, 2, 3):
        air.write(node, frame(mark=node), 0.0)
    assert {raw[4] for _, _, raw in run(air, 1.0)} == {3}


def test_a_vehicle_too_far_away_is_not_heard() -> None:
    air = network(nodes=3, distances_m=(50.0, 100_000.0))
    assert air.rssi(1) > air.rssi(2)
    for node in (1, 2):
        air.write(node, frame(mark=node), 0.0)
    assert {raw[4] for _, _, raw in run(air, 1.0)} == {1}


def reports(out: list[tuple[float, int, bytes]], node: int = GROUND) -> list[tuple[float, int]]:
    """(when, txbuf) of every RADIO_STATUS out of a node's port."""
    parser = FrameParser(DIALECT)
    found = []
    for at, to, raw in out:
        if to == node:
            for f in parser.feed_datagram(raw):
                if (f.sysid, f.compid, f.name) == (51, 68, "RADIO_STATUS"):
                    found.append((at, int(f.fields()["txbuf"])))
    return found


def test_a_radio_reports_only_after_our_heartbeat_and_while_heartbeats_go_on() -> None:
    air = network()
    assert reports(run(air, 5.0)) == []
    air.write(GROUND, heartbeat(), 5.0)
    told = reports(run(air, 20.0, 5.0))
    assert 4 <= len(told) <= 7 and told[0][0] == pytest.approx(5.0, abs=0.05)
    assert told[-1][0] < 10.5


def test_it_tells_how_much_of_its_buffer_is_free() -> None:
    air = network(nodes=16)
    air.write(GROUND, heartbeat(), 0.0)
    for n in range(60):
        air.write(GROUND, frame(100, n), n * 0.05)
    told = reports(run(air, 3.0))
    assert told[0][1] >= 95
    assert told[-1][1] < 40


@each("bad", [{"nodes": 1}, {"air_kbps": 0.0}, {"baud": 0}])
def test_a_network_that_cannot_be_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"nodes|rates"):
        network(**{"nodes": 2, **bad})  # type: ignore[arg-type]


def vehicles(px4: int, ardupilot: int, spare: int = 0) -> RadioFleet:
    sims = make_vehicles(DIALECT, px4=px4, ardupilot=ardupilot, first_sysid=1, home=FIELD)
    return RadioFleet(sims, network(nodes=len(sims) + 1 + spare), DIALECT)


@each("spare", [0, 3])
def test_vehicles_are_commanded_and_heard_over_their_radios(spare: int) -> None:
    fleet = vehicles(1, 1, spare)
    parser, acks = FrameParser(DIALECT), set()
    command = {"target_system": 2, "target_component": 1, "command": 176, "param1": 1, "param2": 0}
    for n in range(500):
        now = n * 0.02
        if n == 100:
            raw = encode(DIALECT.by_name["COMMAND_LONG"], command, sysid=255, compid=25, seq=0)
            fleet.uplink(raw, now)
        for raw in fleet.step(now):
            for f in parser.feed_datagram(raw):
                if f.name == "COMMAND_ACK":
                    acks.add((f.sysid, f.fields()["command"]))
    assert acks == {(2, 176)}
    assert fleet.fleet.vehicles[1].mode == CopterMode.STABILIZE


def test_each_firmware_slows_its_streams_down_by_its_own_radio() -> None:
    px4, copter = vehicles(1, 1).fleet.vehicles
    for vehicle in (px4, copter):
        for _ in range(30):
            slow_down(vehicle, 10)
    assert px4.streams.rate_factor == 0.01 or px4.streams.rate_factor < 0.02
    assert copter.streams.slowdown_s == pytest.approx(1.8)
    for vehicle in (px4, copter):
        for _ in range(400):
            slow_down(vehicle, 100)
    assert px4.streams.rate_factor == 1.0
    assert copter.streams.slowdown_s == pytest.approx(0.0, abs=1e-9)


def test_slowed_streams_come_more_rarely_and_heartbeats_do_not() -> None:
    fleet = vehicles(1, 0)
    (vehicle,) = fleet.fleet.vehicles

    def counts(start: float) -> dict[str, int]:
        found: dict[str, int] = {}
        parser = FrameParser(DIALECT)
        for n in range(1000):
            for raw in vehicle.step(start + n * 0.02):
                for f in parser.feed_datagram(raw):
                    found[f.name or ""] = found.get(f.name or "", 0) + 1
        return found

    before = counts(0.0)
    vehicle.streams.rate_factor = 0.25
    after = counts(20.0)
    assert after["ATTITUDE"] == pytest.approx(before["ATTITUDE"] / 4, rel=0.15)
    assert after["HEARTBEAT"] == pytest.approx(before["HEARTBEAT"], abs=1)
