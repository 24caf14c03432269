"""The asyncio side of preflight: what it asks for, sets and remembers, and the gate before the motors."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from skygcs.core.protocols.command import Outcome
from skygcs.core.routing.source_statistics import LinkFacts
from skygcs.runtime import onboard_orders
from skygcs.runtime.preflight_run import Preflight, examine_fleet
from skygcs.runtime.vehicle_actor import VehicleActor
from support.preflight_field import PreflightField

pytestmark = pytest.mark.looptime

STRICT: dict[str, Any] = {
    "preflight": {
        "transmitter": False,
        "params": {
            "MPC_XY_VEL_MAX": {"max": 5, "optional": True},
            "MAV_SYS_ID": {"in": [1, 2], "optional": True},
            "WPNAV_SPEED": {"max": 500, "optional": True},
        },
    }
}
GATE = {"daemon": {"require_preflight": True, "preflight_valid_minutes": 10}}


async def test_only_what_is_needed_is_read() -> None:
    async with PreflightField() as field:
        field.asked.clear()
        await field.complaints("papa")
        assert set(field.names_asked()) == {
            "MAV_SYS_ID", "RTL_RETURN_ALT", "RTL_TYPE", "RTL_LAND_DELAY", "GF_ACTION", "GF_MAX_HOR_DIST",
            "MPC_XY_CRUISE", "MPC_XY_VEL_MAX", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN", "MPC_TILTMAX_AIR",
            "MPC_LAND_SPEED", "GF_MAX_VER_DIST",
        }  # fmt: skip


async def test_a_value_outside_the_range_of_its_metadata_is_a_fault_unless_the_file_asks_for_it() -> None:
    """MPC_XY_CRUISE 500 passed."""
    values = {"MPC_XY_VEL_MAX": 600.0, "MPC_XY_CRUISE": 500.0}
    async with PreflightField() as field:
        await field.fleet.resolve("papa")[0].params.set(values)
        found = (await field.complaints("papa"))["parameter ranges"]
        assert "MPC_XY_CRUISE: 500 is outside its range of 3 to 20 m/s" in found
    meant = {"preflight": {"params": {name: {"max": 1000} for name in values}}}
    async with PreflightField(defaults=meant) as field:
        await field.fleet.resolve("papa")[0].params.set(values)
        assert "parameter ranges" not in await field.complaints("papa")


async def test_a_message_that_does_not_come_is_asked_for() -> None:
    async with PreflightField(defaults={"streams": {}}) as field:
        vehicle = field.vehicle("papa")
        for message in ("ESTIMATOR_STATUS", "SYSTEM_TIME", "GPS_RAW_INT"):
            vehicle.streams.set_interval(message, float("inf"), field.loop.time())
        await asyncio.sleep(30)
        assert field.actor("papa").vehicle.slot("ESTIMATOR_STATUS") is not None
        assert await field.complaints("papa") == {}


async def test_a_message_that_was_lost_on_the_radio_is_asked_for_once_more() -> None:
    async with PreflightField(defaults={"streams": {}}) as field:
        field.vehicle("papa").streams.set_interval("ESTIMATOR_STATUS", float("inf"), field.loop.time())
        await asyncio.sleep(30)
        actor, asked = field.actor("papa"), []
        ask = actor.request

        async def lossy(message: str) -> Outcome:
            asked.append(message)
            if asked.count(message) == 1:
                return Outcome(False, "timeout", f"timeout: accepted, but no {message} came")
            return await ask(message)

        actor.request = lossy
        assert await field.complaints("papa") == {}
        assert asked and {asked.count(message) for message in asked} == {2}


async def test_a_name_it_has_not_is_asked_for_once_if_it_may_be_so() -> None:
    async with PreflightField(defaults=STRICT) as field:
        await field.complaints("echo")
        assert "MPC_XY_VEL_MAX" in field.names_asked()
        field.asked.clear()
        await field.complaints("echo")
        assert "MPC_XY_VEL_MAX" not in field.names_asked() and "WPNAV_SPEED" in field.names_asked()


async def test_a_parameter_it_must_have_is_a_failure() -> None:
    params = {"papa": {"sysid": 1, "preflight": {"params": {"MPC_NO_SUCH": 1}}}, "echo": {"sysid": 2}}
    async with PreflightField(vehicles=params) as field:
        assert await field.complaints("papa") == {"MPC_NO_SUCH": "it has no parameter MPC_NO_SUCH"}


async def test_fixing_sets_what_was_agreed_to_and_reads_it_back() -> None:
    async with PreflightField(defaults=STRICT) as field:
        first = (await examine_fleet(field.fleet, "all"))["papa"]
        assert {f["name"]: (f["before"], f["value"]) for f in first["fixes"]} == {
            "COM_RC_IN_MODE": (1, 4),
            "MPC_XY_VEL_MAX": (12.0, 5),
        }
        agreed = {"papa": {"COM_RC_IN_MODE": 4, "MPC_XY_VEL_MAX": 4.0}}
        reported = await examine_fleet(field.fleet, "all", fix=True, confirmed=agreed)
        assert {name: o["value"] for name, o in reported["papa"]["fixed"].items()} == {"COM_RC_IN_MODE": 4}
        assert not reported["papa"]["ok"] and reported["echo"]["fixed"] == {}
        assert field.vehicle("papa").params["MPC_XY_VEL_MAX"] == 12.0
        reported = await examine_fleet(field.fleet, "papa", fix=True)
        assert reported["papa"]["ok"] and field.vehicle("papa").params["MPC_XY_VEL_MAX"] == 5.0


async def test_an_id_is_never_set() -> None:
    ids = {"preflight": {"params": {"MAV_SYS_ID": 3}}}
    async with PreflightField(vehicles={"papa": {"sysid": 1, **ids}, "echo": {"sysid": 2}}) as field:
        reported = (await examine_fleet(field.fleet, "papa", fix=True))["papa"]
        assert not reported["ok"] and reported["fixes"] == [] and field.vehicle("papa").params["MAV_SYS_ID"] == 1


async def test_nothing_is_set_on_a_vehicle_that_is_armed() -> None:
    async with PreflightField(defaults=STRICT) as field:
        assert (await field.actor("papa").arm()).ok
        reported = (await examine_fleet(field.fleet, "papa", fix=True))["papa"]
        assert "it is armed" in reported["unfixed"] and field.vehicle("papa").params["COM_RC_IN_MODE"] == 1


async def test_without_a_pass_nothing_arms() -> None:
    async with PreflightField(**GATE) as field:
        actor = field.actor("papa")
        for order in (VehicleActor.arm, VehicleActor.takeoff, onboard_orders.start_mission):
            outcome = await order(actor)
            assert outcome.result == "refused" and outcome.attempts == 0
            assert "has not passed preflight since it started; run skygcs-cli preflight papa" in outcome.message
        assert await field.complaints("papa") == {}
        assert (await actor.arm()).ok


async def test_what_failed_is_the_reason_and_force_insists() -> None:
    async with PreflightField(**GATE) as field:
        actor = field.actor("papa")
        field.heard["radio"] = LinkFacts(0.5, 300)
        await field.complaints("papa")
        assert "preflight failed: 50 % of its frames are lost on radio" in (await actor.takeoff()).message
        assert (await actor.takeoff(force=True)).ok
        assert "preflight" not in (await actor.takeoff(3.0)).message  # what is armed has passed the gate


async def test_a_pass_lasts_so_long_and_no_longer() -> None:
    async with PreflightField(daemon={"require_preflight": True, "preflight_valid_minutes": 1}) as field:
        actor = field.actor("papa")
        await field.complaints("papa")
        await asyncio.sleep(40)
        assert actor.arming_refusal(force=False) is None and actor.part(Preflight).status()["valid_s"] == pytest.approx(
            20, abs=2
        )
        await asyncio.sleep(50)
        assert "passed 2 min ago (valid for 1 min)" in (await actor.arm()).message
        assert actor.part(Preflight).status()["state"] == "expired"


async def test_a_reboot_ends_a_pass_also_amid_it() -> None:
    async with PreflightField(**GATE) as field:
        actor = field.actor("papa")
        await field.complaints("papa")
        field.vehicle("papa").faults.reboot = True
        await asyncio.sleep(10)
        assert actor.part(Preflight).status()["state"] == "never"
        running = asyncio.create_task(actor.part(Preflight).run())
        await asyncio.sleep(0.05)
        actor.part(Preflight).on_reboot()
        await running
        assert actor.part(Preflight).status()["state"] == "never"


async def test_one_vehicle_may_require_what_others_do_not() -> None:
    named = {"papa": {"sysid": 1, "require_preflight": True}, "echo": {"sysid": 2}}
    async with PreflightField(vehicles=named) as field:
        assert field.actor("papa").arming_refusal(force=False) is not None
        assert field.actor("echo").arming_refusal(force=False) is None
