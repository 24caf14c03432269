"""Vehicles behind one emulated radio, and a daemon that has them stream what it carries; all in virtual time."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.core.mavlink.frame import encode
from skygcs.core.protocols.command import RETRY_TIMERS_S
from skygcs.core.radio_link.stream_rates import POSITION
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.runtime.air_planner import ANSWER_S, RETRY_ROUNDS
from skygcs.runtime.link_view import LinkView
from skygcs.runtime.vehicle_actor import VehicleActor
from support.daemons import first_heard
from support.on_air import OnAir, on_air

NAV = {"link": {"stream_profile": "nav"}}
FLOODED = {"stream_profile": "nav", "third_party": {"bytes_per_s": 100_000, "rates": {"PARAM_REQUEST_READ": 1000}}}
"""Nobody is slowed down: what others send fills whatever is left."""


def flood(air: OnAir, of_each: int = 3) -> None:
    """Send as another program may, to every vehicle: twenty messages each fill the queue, three are more than leave
    in a tenth of a second."""
    info = air.daemon.dialect.by_name["PARAM_REQUEST_READ"]
    for index in range(of_each):
        for sim in air.link.vehicles:
            values = {"target_system": sim.sysid, "target_component": 1, "param_id": b"X", "param_index": index}
            air.channel.send(encode(info, values, sysid=250, compid=190, seq=0), Priority.FORWARDED)


async def test_no_more_goes_up_than_the_slot_of_the_ground_carries(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=5, ardupilot=5, link=FLOODED) as air:
        await air.settled(10)
        flood(air, 20)
        before, began = air.channel.tx_bytes, air.daemon.now()
        for _ in range(100):
            flood(air)
            await asyncio.sleep(0.1)
        assert air.channel.air is not None and air.channel.air.queue.budget is not None
        rate = (air.channel.tx_bytes - before) / (air.daemon.now() - began)
        assert 0.7 * air.channel.air.pacer.base < rate <= 1.1 * air.channel.air.pacer.base
        assert air.radio.network.stats(0).overflow_bytes == 0
        assert air.radio.network.txbuf_percent(0) > 40


@pytest.mark.deep
@pytest.mark.parametrize("phase_s", [0.0, 0.3, 0.6, 0.85])
async def test_a_stop_reaches_all_ten_through_a_flooded_link_within_two_rounds(tmp_path: Path, phase_s: float) -> None:
    async with on_air(tmp_path, px4=5, ardupilot=5, link=FLOODED) as air:
        await air.settled(10)
        heard = first_heard(air.link.vehicles, 21, 176)
        flood(air, 20)
        for _ in range(50):
            flood(air)
            await asyncio.sleep(0.1)
        await asyncio.sleep(phase_s)  # wherever the round of 0.91 s is
        flood(air)
        ordered = air.daemon.now()
        stop = asyncio.create_task(air.daemon.fleet.orders.command_all("all", VehicleActor.stop, action="land"))
        for _ in range(30):
            flood(air)
            await asyncio.sleep(0.1)
        stop.cancel()
        await asyncio.gather(stop, return_exceptions=True)
        assert heard.keys() == set(range(1, 11))
        assert max(heard.values()) - ordered <= 2 * air.air()["up"]["round_s"] + 0.2


@pytest.mark.deep
async def test_commands_are_answered_within_two_rounds_while_the_fleet_streams(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=5, ardupilot=5, radio={"loss": 0.02}, **NAV) as air:
        await air.settled(10)
        actors = air.daemon.fleet.resolve("all")
        told = [await actor.command(510, (33.0,)) for _ in range(3) for actor in actors]
        assert all(outcome.ok for outcome in told)
        round_s = air.air()["up"]["round_s"]
        waits_s = [max(wait_s, RETRY_ROUNDS * round_s + ANSWER_S) for wait_s in RETRY_TIMERS_S]
        for outcome in told:  # whichever are lost: one that is sent again has waited for an answer before
            assert outcome.elapsed_s - sum(waits_s[: outcome.attempts - 1]) <= 2 * round_s + 0.5, outcome
        assert sum(outcome.attempts for outcome in told) / len(told) < 1.3, "and seldom sent twice"


@pytest.mark.deep  # ten vehicles on one radio
async def test_a_vehicle_that_leaves_gives_its_room_to_the_others_and_takes_it_back(tmp_path: Path) -> None:
    link = {"stream_profile": "full", "downlink_share": 0.12}
    async with on_air(tmp_path, px4=3, ardupilot=0, link=link) as air:
        await air.settled(3)
        narrow = air.vehicle(1)["streams"][POSITION]["planned_hz"]
        assert air.vehicle(1)["scaled"]
        air.sim(3).faults.mute = True
        await asyncio.sleep(10)
        assert len(air.air()["vehicles"]) == 3, "a short silence changes nothing"
        await air.until(lambda: len(air.air()["vehicles"]) == 2)
        wider = air.vehicle(1)["streams"][POSITION]["planned_hz"]
        assert wider > narrow
        air.sim(3).faults.mute = False
        await air.until(lambda: len(air.air()["vehicles"]) == 3)
        assert air.vehicle(1)["streams"][POSITION]["planned_hz"] == narrow


async def test_who_is_selected_gets_more(tmp_path: Path) -> None:
    link = {"stream_profile": "full", "downlink_share": 0.12}
    async with on_air(tmp_path, px4=3, ardupilot=0, radio={"air_kbps": 250}, link=link) as air:
        await air.settled(3)
        alike = {v["planned_bytes_per_s"] for v in air.air()["vehicles"]}
        air.daemon.air.select({2 << 8 | 1})
        await asyncio.sleep(2)
        assert len(alike) == 1
        assert air.vehicle(2)["planned_bytes_per_s"] > max(alike) > air.vehicle(1)["planned_bytes_per_s"]


@pytest.mark.deep  # ten vehicles on one radio
async def test_flight_control_gets_its_position_as_fast_as_the_plan_has_room(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=5, ardupilot=5, **NAV) as air:
        await air.settled(10)
        actor = air.daemon.fleet.find("1")
        assert actor.streams.want_position(50.0)
        await asyncio.sleep(20)
        told = air.air()
        assert told["down"]["planned_bytes_per_s"] <= told["down"]["budget_bytes_per_s"]
        mine = air.vehicle(1)
        assert mine["weight"] == 4.0 and mine["planned_bytes_per_s"] <= told["down"]["per_vehicle_bytes_per_s"]
        assert 2.0 < air.rates(1)[POSITION] < 10.0
        assert actor.streams.want_position(None)
        await asyncio.sleep(20)
        assert air.rates(1)[POSITION] == 2.0


async def test_the_state_tells_planned_rates_beside_measured_ones(tmp_path: Path) -> None:
    async with on_air(tmp_path, **NAV) as air:
        await air.settled(2)
        messages = air.daemon.fleet.find("2").state(air.daemon.now())["messages"]
        assert messages[POSITION]["planned_hz"] == 2.0 and messages["HEARTBEAT"]["planned_hz"] == 0.0


@pytest.mark.deep  # ten vehicles on one radio
async def test_a_vehicle_that_is_heard_badly_is_told_of_once_and_again_when_it_is_well(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=2, ardupilot=0, **NAV) as air:
        await air.settled(2)
        rng = air.radio.network._is_lost
        air.radio.network._is_lost = lambda node, now: node == 1 and now % 1.0 < 0.5  # type: ignore[method-assign]
        await air.until(lambda: air.events("link_degraded"), 60)
        await asyncio.sleep(20)
        (text,) = air.events("link_degraded")
        assert "frames are lost" in text and "radio air" in text
        assert air.air()["poor"] == ["v1"]
        air.radio.network._is_lost = rng  # type: ignore[method-assign]
        await air.until(lambda: air.events("link_recovered"), 120)
        assert air.air()["poor"] == []


async def test_a_link_that_is_no_radio_is_neither_planned_nor_paced(tmp_path: Path) -> None:
    async with on_air(tmp_path, link={"role": "vehicle"}) as air:
        await asyncio.sleep(30)
        assert air.daemon.air.status(air.daemon.now()) == [] and air.channel.air is None
        assert "VFR_HUD" in air.rates(1), "what comes by itself goes on"
        assert not air.daemon.fleet.find("1").streams.planned


async def test_a_stream_that_will_not_stop_is_told_with_what_to_do(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=1, ardupilot=0, **NAV) as air:
        sim = air.sim(1)
        set_interval = sim.streams.set_interval
        sim.streams.set_interval = (  # type: ignore[method-assign]
            lambda name, s, now: True if name == "VFR_HUD" else set_interval(name, s, now)
        )
        await air.until(lambda: air.events("warning"), 200)
        (text,) = air.events("warning")
        assert "VFR_HUD" in text and "MAV_0_MODE" in text


@pytest.mark.deep
async def test_what_is_lost_while_vehicles_still_flood_does_not_count_against_the_plan(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=7, ardupilot=8, radio={"air_kbps": 125}, **NAV) as air:
        for sim in air.link.vehicles[7:]:
            for group in ("EXTRA1", "EXTRA2", "EXTRA3", "EXT_STAT", "POSITION", "RAW_SENS", "RC_CHAN"):
                sim.params.set(f"SR1_{group}", 10)
                sim.on_param(f"SR1_{group}", air.daemon.now())
        await air.settled(15)
        assert air.radio.network.stats(0).output_overflow_bytes > 0, "the port was too narrow at first"
        await asyncio.sleep(60)
        assert air.air()["down"]["factor"] == 1.0
        assert all(air.rates(n)[POSITION] == 2.0 for n in range(1, 16))


async def test_what_the_radio_cannot_carry_is_refused_with_the_figures_and_what_can(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=5, ardupilot=5, **NAV) as air:
        await air.settled(10)
        (told,) = (
            await air.daemon.fleet.orders.command_all("1", VehicleActor.takeoff, height_m=5.0, wait_s=60.0)
        ).values()
        assert told.ok
        await air.until(lambda: air.sim(1).motion.up_m > 4.5)
        await asyncio.sleep(5)
        (told,) = (await air.daemon.fleet.orders.command_all("1", VehicleActor.control, mode="position")).values()
        assert told.result == "refused"
        assert "every 0.91 s; PX4 wants setpoints at 2 Hz" in told.message and "goto" in told.message
        assert not air.daemon.fleet.find("1").streams.position_hz


async def test_how_many_are_flown_decides_whether_a_further_one_can_be(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=0, ardupilot=10, **NAV) as air:
        await air.settled(10)
        view = LinkView(air.daemon.hub, air.daemon.links, air.daemon.link_watch)
        first, *others = [actor.vehicle for actor in air.daemon.fleet.resolve("all")]

        def why(count: int) -> str | None:
            return view.stream_refusal(first, lambda: others[:count])

        assert why(0) is None and why(2) is None
        assert "leaves 62 B/s to setpoints for it, and 1 Hz of 65 bytes are 65" in (why(3) or "")


async def test_measured_timeslots_are_what_is_planned_with(tmp_path: Path) -> None:
    """Three slots of 0.1 s and a sync slot of 30 ms are 0.33 s, in which a node sends 480 bytes; half of it is planned,
    and 90 % of the ground's slot go up."""
    (tmp_path / "timing.toml").write_text(
        'kind = "radio timing"\nversion = 1\n[[measurement]]\ndate = "2026-11-28"\nbanner = "RFD SiK 3.00MP"\n'
        "multipoint = true\nair_speed_kbps = 64\nslot_s = 0.1\nsync_s = 0.03\nslot_bytes = 480\n"
    )
    link = {"stream_profile": "nav", "air_speed_kbps": 64, "timing_file": str(tmp_path / "timing.toml")}
    async with on_air(tmp_path, px4=1, ardupilot=1, radio={"air_kbps": 64}, link=link) as air:
        await air.settled(2)
        told = air.air()
        assert told["up"]["timing"] == "measured on 2026-11-28 with RFD SiK 3.00MP"
        assert told["up"]["round_s"] == 0.33
        assert told["up"]["base_bytes_per_s"] == pytest.approx(0.9 * 480 / 0.33, rel=1e-3)
        assert told["down"]["per_vehicle_bytes_per_s"] == pytest.approx(0.5 * 480 / 0.33, rel=1e-3)
