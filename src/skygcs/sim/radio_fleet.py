"""Simulated vehicles, each behind its own radio of an emulated network, and the ground's radio in front of them all."""

from __future__ import annotations

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim import protocol as m
from skygcs.sim.radio_status import RADIO_COMPID, RADIO_SYSID
from skygcs.sim.tdm import GROUND, TdmNetwork
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import SimFleet

UART_BYTES = 512
"""Transmit buffer of an autopilot: a message that finds no room is not sent (ArduPilot: HAVE_PAYLOAD_SPACE; PX4:
get_free_tx_buf)."""

PARAMETERS_FROM_PERCENT = 50
"""Free, of its radio's buffer, from which an autopilot goes on with a list of parameters (ArduPilot:
GCS_MAVLINK::queued_param_send)."""

SLOWEST_S = 2.0
LEAST_FACTOR = 0.01


class RadioFleet:
    """Vehicle i (from 0) is at node i + 1. `uplink` frames of the ground; `step` often, for what comes out there."""

    def __init__(self, vehicles: list[SimVehicle], network: TdmNetwork, dialect: Dialect) -> None:
        self.fleet = SimFleet(vehicles)
        self.network = network
        self.cut_off: frozenset[int] = frozenset()
        """Nodes whose radios have other settings than the ground's: neither hears the other."""
        self.not_sent = 0
        """Frames that an autopilot had no room for."""
        self._parser = FrameParser(dialect)
        self._parsed: tuple[bytes, list[Frame]] = (b"", [])

    def uplink(self, raw: bytes, now: float) -> None:
        """One frame to the ground radio's serial port."""
        self.network.write(GROUND, raw, now)

    def step(self, now: float) -> list[bytes]:
        """Live on until ``now``. A frame that lost bytes on the way comes as what is left of it."""
        for node, vehicle in enumerate(self.fleet.vehicles, 1):
            held: list[int] = []
            if vehicle.param_queue and self.network.txbuf_percent(node) < PARAMETERS_FROM_PERCENT:
                held, vehicle.param_queue = vehicle.param_queue, []
            frames = vehicle.step(now)
            vehicle.param_queue = held + vehicle.param_queue
            for raw in frames:
                self._send(node, raw, now)
        ground = []
        for node, raw in self.network.step(now):
            if node == GROUND:
                ground.append(raw)
            else:
                self._hear(node, raw, now)
        return ground

    def _send(self, node: int, raw: bytes, now: float) -> None:
        network = self.network
        if node in self.cut_off:
            return
        if network.backlog_bytes(node, now) + len(raw) > UART_BYTES or not network.has_room(node, len(raw)):
            self.not_sent += 1
            return
        network.write(node, raw, now)

    def _hear(self, node: int, raw: bytes, now: float) -> None:
        if node > len(self.fleet.vehicles) or node in self.cut_off:
            return  # a spare radio, with nobody behind it, or one of another network
        if raw is not self._parsed[0]:  # what the ground sends comes to one vehicle after the other
            self._parsed = (raw, self._parser.feed_datagram(raw))
        vehicle = self.fleet.vehicles[node - 1]
        for frame in self._parsed[1]:
            if (frame.sysid, frame.compid) == (RADIO_SYSID, RADIO_COMPID):
                slow_down(vehicle, frame.fields()["txbuf"])
            else:
                vehicle.on_frame(frame, now)


def slow_down(vehicle: SimVehicle, txbuf_percent: int) -> None:
    """Do what each firmware makes of its own radio's RADIO_STATUS (GCS_MAVLINK::handle_radio_status;
    Mavlink::update_radio_status)."""
    streams = vehicle.streams
    if vehicle.autopilot == m.MAV_AUTOPILOT_PX4:
        factor = 0.8 if txbuf_percent < 25 else 0.975 if txbuf_percent < 35 else 1.025 if txbuf_percent > 50 else 1.0
        streams.rate_factor = min(1.0, max(LEAST_FACTOR, streams.rate_factor * factor))
        return
    slower_s = streams.slowdown_s
    if txbuf_percent < 20:
        slower_s += 0.06
    elif txbuf_percent < 50:
        slower_s += 0.02
    elif txbuf_percent > 95 and slower_s > 0.2:
        slower_s -= 0.04
    elif txbuf_percent > 90:
        slower_s -= 0.02
    streams.slowdown_s = min(SLOWEST_S, max(0.0, slower_s))
