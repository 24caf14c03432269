"""A fleet of simulated vehicles on one channel, and the radio in front of it."""

from __future__ import annotations

from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.ardupilot import CopterVehicle
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.radio_status import SimRadio
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle_group import make_vehicles
from support.sim_pilot import FIELD, Pilot, sim_dialect
from support.table import each


def test_px4s_come_first_and_sysids_count_up() -> None:
    vehicles = make_vehicles(sim_dialect(), px4=2, ardupilot=3, first_sysid=11, home=FIELD)
    assert [v.sysid for v in vehicles] == [11, 12, 13, 14, 15]
    assert [type(v) for v in vehicles] == [Px4Vehicle] * 2 + [CopterVehicle] * 3


def test_no_two_stand_closer_than_five_metres() -> None:
    vehicles = make_vehicles(sim_dialect(), px4=12, ardupilot=0, first_sysid=1, home=FIELD, heading_deg=30)
    spots = [FIELD.to_local(v.where.lat_deg, v.where.lon_deg) for v in vehicles]
    for i, (e1, n1) in enumerate(spots):
        for e2, n2 in spots[i + 1 :]:
            assert (e1 - e2) ** 2 + (n1 - n2) ** 2 > 4.99**2
    assert all(v.motion.heading_deg == pytest.approx(30) for v in vehicles)
    assert spots[0] == pytest.approx((0, 0), abs=1e-6)


@each(("first", "count"), [(0, 1), (250, 7)])
def test_system_ids_beyond_the_protocol_are_refused(first: int, count: int) -> None:
    with pytest.raises(ValueError, match=r"do not fit in 1\.\.255"):
        make_vehicles(sim_dialect(), px4=count, ardupilot=0, first_sysid=first, home=FIELD)


def test_a_mixed_fleet_flies_and_lands_together() -> None:
    pilot = Pilot(*make_vehicles(sim_dialect(), px4=2, ardupilot=2, first_sysid=1, home=FIELD))
    pilot.hovering(6)
    for sysid in (1, 2, 3, 4):
        pilot.command(mav.MAV_CMD_NAV_LAND, to=sysid)
    pilot.run(25)
    assert not any(v.armed for v in pilot.vehicles)
    assert {x.get_srcSystem() for x in pilot.heard} == {1, 2, 3, 4}


def test_vehicles_powered_together_do_not_send_together() -> None:
    pilot = Pilot(*make_vehicles(sim_dialect(), px4=10, ardupilot=0, first_sysid=1, home=FIELD))
    pilot.run(10)
    largest = 0
    for _ in range(250):
        largest = max(largest, len(pilot.run(0.02, 0.02)))
    assert largest < 15, "of some 130 frames a second"


def heartbeat(parser: FrameParser) -> list[Frame]:
    packer = mav.MAVLink(None, 255, 190)
    return parser.feed(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(packer))


def test_the_radio_reports_only_while_heartbeats_go_through_it() -> None:
    dialect = sim_dialect()
    radio, parser, client = SimRadio(dialect, Rng(1)), FrameParser(dialect), mav.MAVLink(None)
    reports: list[tuple[float, mav.MAVLink_radio_status_message]] = []

    def run(start: float, end: float, heartbeats: bool) -> None:
        for i in range(round((end - start) / 0.1)):
            now = start + (i + 1) * 0.1
            if heartbeats and i % 10 == 0:
                for frame in heartbeat(parser):
                    radio.on_frame(frame, now)
            for raw in radio.step(now):
                reports.append((now, client.parse_buffer(raw)[0]))

    run(0, 20, heartbeats=False)
    assert reports == []
    run(20, 40, heartbeats=True)
    assert len(reports) == 20
    assert all(b - a == pytest.approx(1.0, abs=0.11) for (a, _), (b, _) in pairwise(reports))
    assert {(m.get_srcSystem(), m.get_srcComponent(), m.txbuf) for _, m in reports} == {(51, 68, 100)}
    assert [m.get_seq() for _, m in reports] == list(range(20))
    run(40, 60, heartbeats=False)
    assert 20 < len(reports) <= 26
