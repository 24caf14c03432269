"""The emulated XBee network: its throughput against Digi's figures, losses, hops and full buffers."""

from __future__ import annotations

import pytest

from skygcs.core.xbee import api_frames as api
from skygcs.core.xbee.api_frames import ApiParser, ReceivePacket, TransmitStatus
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle_group import make_vehicles
from skygcs.sim.xbee_mesh import FIRST_SERIAL, GROUND_BUFFERS, MAC_RETRIES, MeshConfig, XBeeMesh
from support.hosts import heartbeat
from support.table import each
from support.vehicles import flight_dialect


def mesh_of(count: int, **keys: object) -> XBeeMesh:
    vehicles = make_vehicles(
        flight_dialect(), px4=count, ardupilot=0, first_sysid=1, home=LocalFrame(43.78, -79.46, 180.0), seed=1
    )
    return XBeeMesh(vehicles, flight_dialect(), MeshConfig(api_mode=1, **keys), Rng(1), 0.0)  # type: ignore[arg-type]


def request(frame_id: int, address: int, payload: bytes) -> bytes:
    return api.encode(api.transmit_request(frame_id, address, payload), escaped=False)


@each(("rf_kbps", "measured_kbps"), [(200.0, 105.5), (10.0, 8.8)])
def test_one_hop_carries_what_digi_measured(rf_kbps: float, measured_kbps: float) -> None:
    config = MeshConfig(rf_kbps=rf_kbps)
    assert 256 * 8 / config.packet_s(256) / 1000 == pytest.approx(measured_kbps, rel=0.01)


def test_telemetry_comes_whole_with_its_senders_address() -> None:
    mesh, parser = mesh_of(3, loss=0.2), ApiParser(api.decode, escaped=False)
    heard: dict[int, int] = {}
    for tick in range(500):
        for frame in parser.feed(mesh.step(tick * 0.02)):
            assert isinstance(frame, ReceivePacket) and len(frame.payload) <= 256
            heard[frame.address] = heard.get(frame.address, 0) + len(frame.payload)
    assert set(heard) == {FIRST_SERIAL + 1, FIRST_SERIAL + 2, FIRST_SERIAL + 3}
    assert mesh.stats.retries > 0 and mesh.stats.lost == 0 and min(heard.values()) > 1000


def test_a_node_without_power_costs_all_retries_and_is_reported() -> None:
    mesh, parser = mesh_of(1), ApiParser(api.decode, escaped=False)
    mesh.unplugged.add(0)
    mesh.hear(request(9, mesh.address(0), heartbeat(255)))
    statuses = [f for tick in range(100) for f in parser.feed(mesh.step(tick * 0.02)) if type(f) is TransmitStatus]
    assert statuses == [TransmitStatus(9, MAC_RETRIES, 0x01)]
    assert mesh.stats.lost == 1


def test_more_requests_than_buffers_are_refused_and_too_long_ones_too() -> None:
    mesh, parser = mesh_of(1), ApiParser(api.decode, escaped=False)
    for n in range(GROUND_BUFFERS + 2):
        mesh.hear(request(n + 1, mesh.address(0), b"x" * 20))
    mesh.hear(request(99, mesh.address(0), b"x" * 257))
    frames = [f for tick in range(50) for f in parser.feed(mesh.step(tick * 0.02)) if type(f) is TransmitStatus]
    refused = {f.frame_id: f.delivery for f in frames if f.delivery}
    assert refused == {GROUND_BUFFERS + 1: 0x32, GROUND_BUFFERS + 2: 0x32, 99: 0x32}
    assert sum(f.delivery == 0 for f in frames) == GROUND_BUFFERS


def test_each_hop_takes_as_long_again() -> None:
    near, far = mesh_of(1), mesh_of(1, hops=(3,))
    for mesh in (near, far):
        for tick in range(500):
            mesh.step(tick * 0.02)
    assert far.stats.busy_s == pytest.approx(3 * near.stats.busy_s, rel=0.2)


def test_a_node_of_another_network_is_out_of_reach_both_ways() -> None:
    mesh, parser = mesh_of(2), ApiParser(api.decode, escaped=False)
    mesh.hear(api.encode(api.remote_at_command(1, mesh.address(1), "ID", b"\x05"), escaped=False))
    heard = set()
    for tick in range(400):
        for frame in parser.feed(mesh.step(tick * 0.02)):
            if isinstance(frame, ReceivePacket) and tick > 100:
                heard.add(frame.address)
    assert heard == {mesh.address(0)}
