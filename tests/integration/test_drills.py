"""Faults of simulated vehicles by the methods of drills: begun, shown, ended; and in no other vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig
from skygcs.daemon import Daemon
from skygcs.errors import ConfigError
from skygcs.ext.drills.extension import Drills, DrillsConfig
from skygcs.sim.quad import Quad
from skygcs.sim.vehicle import SimVehicle
from support.called import call
from support.daemons import made_daemon, simulated_link, started
from support.flown import Ordering, flown


def with_drills(config: FleetConfig) -> FleetConfig:
    """The fleet with its table [drills]."""
    return config.model_copy(update={"extensions": {"drills": DrillsConfig()}})


class Station(Ordering):
    """A daemon that simulates vehicles: PX4s first."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.events: list[dict[str, Any]] = []
        daemon.event_log.subscribe(self.events.append)

    async def __call__(self, method_name: str, /, **params: Any) -> Any:
        return await call(self.daemon, method_name, **params)

    def sim(self, name: str = "v1") -> SimVehicle:
        link = simulated_link(self.daemon, "sim")
        return next(vehicle for vehicle in link.vehicles if vehicle.sysid == int(name[1:]))

    async def state(self, name: str = "v1") -> dict[str, Any]:
        found: dict[str, Any] = await self("vehicles.get", target=name)
        return found


@asynccontextmanager
async def station(tmp_path: Path, *, drills: bool = True, dynamics: str = "rigid") -> AsyncIterator[Station]:
    links = {"sim": {"type": "simulated", "px4": 1, "ardupilot": 1, "dynamics": dynamics}}
    async with started(made_daemon(tmp_path, links=links, prepared=with_drills if drills else None)) as daemon:
        lab = Station(daemon)
        await asyncio.sleep(10.0)  # both are heard, and their estimators have converged
        assert len(daemon.fleet.vehicles) == 2
        yield lab
        assert not [event for event in lab.events if event["kind"] == "fault"]


async def test_a_lost_gps_is_seen_shown_and_ended(tmp_path: Path) -> None:
    async with station(tmp_path) as lab:
        assert (await lab.state())["drills"] is None
        assert (await lab.outcome("drills.begin", fault="gps"))["message"] == "GPS lost, until it is ended"
        await asyncio.sleep(5.0)
        state = await lab.state()
        assert state["gps"]["fix"] in ("no_gps", "no_fix"), state["gps"]
        (fault,) = state["drills"]["faults"]
        assert (fault["fault"], fault["text"], fault["lasts_s"]) == ("gps", "GPS lost", pytest.approx(5.0, abs=0.2))
        (active,) = (await lab("drills.status"))["active"]
        assert active["vehicle"] == "v1" and lab.sim().faults.gps_lost and not lab.sim("v2").faults.gps_lost
        assert (await lab.outcome("drills.end", fault="gps"))["ok"]
        assert not lab.sim().faults.gps_lost and (await lab.state())["drills"] is None
        texts = [event["text"] for event in lab.events if event["kind"] == "drill"]
        assert texts == ["drill: GPS lost begins", "drill: GPS lost has ended"]


async def test_a_deaf_vehicle_takes_no_order_until_the_fault_has_ended(tmp_path: Path) -> None:
    async with station(tmp_path) as lab:
        await lab.outcome("drills.begin", fault="deaf")
        deaf = await lab.outcome("vehicles.arm")
        assert deaf["result"] == "timeout", deaf
        assert (await lab.outcome("vehicles.arm", "v2"))["ok"], "the other one hears"
        await lab.outcome("drills.end", fault="deaf")
        assert (await lab.outcome("vehicles.arm"))["ok"]


async def test_a_low_battery_is_a_failsafe_and_ends_with_the_charge_that_was_lost(tmp_path: Path) -> None:
    async with station(tmp_path) as lab:
        before = lab.sim().battery.percent
        assert (await lab.outcome("drills.begin", fault="battery", value=6))["ok"]
        await asyncio.sleep(5.0)
        assert (await lab.state())["battery"]["percent"] in (5, 6)
        again = await lab.outcome("drills.begin", fault="battery", value=20)
        assert again["message"] == "battery low, 20 %, until it is ended"
        assert len((await lab("drills.status"))["active"]) == 1
        await lab.outcome("drills.end", fault="battery")
        assert lab.sim().battery.percent in (before, before - 1)


async def test_wind_moves_what_has_a_body_and_nothing_else_takes_it(tmp_path: Path) -> None:
    async with station(tmp_path) as lab:
        assert (await lab.outcome("drills.begin", "v2", fault="wind", value=9))["ok"]
        motion = lab.sim("v2").motion
        assert isinstance(motion, Quad) and motion.wind.mean_enu_mps == pytest.approx((9.0, 0.0, 0.0), abs=1e-9)
        assert not (await lab.outcome("drills.begin", fault="wind", value=200))["ok"]
        await lab.outcome("drills.end", "v2")
        assert motion.wind.mean_enu_mps == (0.0, 0.0, 0.0)
    async with station(tmp_path, dynamics="kinematic") as lab:
        refused = await lab.outcome("drills.begin", fault="wind")
        assert refused["result"] == "refused" and "kinematic" in refused["message"]


@pytest.mark.parametrize("fault", ["deaf", "link", "gps"])
async def test_a_fault_without_a_value_takes_none_and_one_that_does_not_last_cannot_be_ended(
    tmp_path: Path, fault: str
) -> None:
    async with station(tmp_path) as lab:
        assert "has no value" in (await lab.outcome("drills.begin", fault=fault, value=1))["message"]
        assert "no fault of a drill lasts" in (await lab.outcome("drills.end"))["message"]
        assert (await lab.outcome("drills.end", fault=fault))["result"] == "refused"


async def test_a_vehicle_that_is_not_simulated_here_is_refused_and_nothing_is_sent_to_it(tmp_path: Path) -> None:
    """Its system id is that of no simulated one."""
    links = {"sim": {"type": "simulated", "px4": 1, "ardupilot": 0, "first_sysid": 9}}
    async with flown(tmp_path, px4=2, takeoff=False, links=links, prepared=with_drills) as gcs:
        sent = len(gcs.sent)
        for fault in ("deaf", "link", "gps", "battery", "wind"):
            outcomes = (await gcs("drills.begin", targets="v1,v2", fault=fault))["outcomes"]
            assert all(
                o["result"] == "refused" and "not simulated by this daemon" in o["message"] for o in outcomes.values()
            )
        assert not [s for s in gcs.sent[sent:] if s.sysid in (1, 2) and s.name.startswith("COMMAND")]
        assert all(sim.faults.gps_lost is False and not sim.faults.deaf for sim in gcs.sims)
        assert (await gcs("drills.status"))["simulated"] == ["v9"]


async def test_a_vehicle_with_the_id_of_a_simulated_one_is_refused_and_not_shown_as_under_a_drill(
    tmp_path: Path,
) -> None:
    links = {"sim": {"type": "simulated", "px4": 2, "ardupilot": 0, "first_sysid": 1}}
    async with flown(tmp_path, px4=1, takeoff=False, links=links, prepared=with_drills) as gcs:
        await gcs.until(lambda: len(gcs.daemon.fleet.vehicles) == 2)
        begun = (await gcs("drills.begin", targets="v1,v2", fault="gps"))["outcomes"]
        assert begun["v1"]["result"] == "refused" and "heard on air" in begun["v1"]["message"]
        assert begun["v2"]["ok"], "the other one is simulated alone"
        assert (await gcs("drills.status"))["simulated"] == ["v2"]
        assert (await gcs("vehicles.get", target="v1"))["drills"] is None
        assert (await gcs("vehicles.get", target="v2"))["drills"] is not None


async def test_faults_end_when_a_real_vehicle_with_its_id_is_heard(tmp_path: Path) -> None:
    async with station(tmp_path) as lab:
        assert (await lab.outcome("drills.begin", fault="gps"))["ok"]
        quality = lab.daemon.hub.statistics.link_quality
        lab.daemon.hub.statistics.link_quality = lambda key: quality(key) | {"radio": {}}  # type: ignore[method-assign]
        assert (await lab.state())["drills"] is None
        assert (await lab("drills.status"))["active"] == []
        assert not lab.sim().faults.gps_lost


def test_check_notes_other_links_beside_those_with_drills(tmp_path: Path) -> None:
    links = {"sim": {"type": "simulated", "px4": 1}, "radio": {"type": "udp_server", "port": 14550}}
    fleet = FleetConfig.model_validate({"links": links})
    (note,) = Drills.fleet_notes(DrillsConfig(), fleet)
    assert note.startswith("beside radio: ") and "first_sysid" in note
    del fleet.links["radio"]
    assert Drills.fleet_notes(DrillsConfig(), fleet) == []


async def test_without_its_table_there_is_no_method_and_without_simulated_links_no_table(tmp_path: Path) -> None:
    async with station(tmp_path, drills=False) as lab:
        with pytest.raises(Exception, match="drills"):
            await lab("drills.begin", targets="v1", fault="gps")
    file = tmp_path / "fleet.toml"
    file.write_text('[links.radio]\ntype = "udp_server"\nport = 14550\n[drills]\n')
    with pytest.raises(ConfigError, match="needs a link of type simulated"):
        load_fleet(file)
