"""Services of companions: an armed vehicle's is never stopped unless insisted on."""

from __future__ import annotations

import pytest

from skygcs.errors import CompanionError
from skygcs.ext.companions.bring_up import service_control
from skygcs.ext.companions.bring_up.probe import CompanionFacts, probe
from support.fake_companion import ARMED, FakeSession
from support.table import each


async def running(session: FakeSession, **facts: str) -> CompanionFacts:
    session.facts |= {"state": "active", **facts}
    return await probe(session)


UNKNOWN = '[{"name": "alpha"}]'
FLYING = '[{"name": "alpha", "armed": false, "landed": "in_air"}]'


@each("there", [ARMED, UNKNOWN, FLYING])
async def test_the_service_of_an_active_vehicle_is_not_stopped(there: str) -> None:
    session = FakeSession()
    session.answer("status", 0, there)
    facts = await running(session)
    for action in (service_control.stop, service_control.restart):
        with pytest.raises(CompanionError, match="armed or in the air"):
            await action(session, facts, force=False)
    assert not session.ran("systemctl")
    await service_control.stop(session, facts, force=True)
    assert session.ran("systemctl --user stop skygcs")


@each("answer", [(3, "", "no daemon"), (0, "not JSON", ""), (0, "{}", "")])
async def test_a_vehicle_whose_state_is_not_known_counts_as_active(answer: tuple[int, str, str]) -> None:
    session = FakeSession()
    session.answer("status", *answer)
    with pytest.raises(CompanionError, match="--force insists"):
        await service_control.stop(session, await running(session), force=False)
    assert not session.ran("systemctl")


async def test_a_vehicle_at_rest_may_lose_its_service() -> None:
    session = FakeSession()
    assert await service_control.stop(session, await running(session), force=False) == "stopped"
    assert await service_control.restart(session, await running(session), force=False) == "restarted"


async def test_a_vehicle_that_is_heard_over_the_ground_alone_is_not_its_own() -> None:
    session = FakeSession()
    session.answer("status", 0, '[{"name": "v2", "armed": true, "links": {"ground": {}}}]')
    facts = await running(session)
    assert await service_control.stop(session, facts, force=False) == "stopped"
    session.answer("status", 0, '[{"name": "v2", "armed": true, "links": {"ground": {}, "autopilot": {}}}]')
    with pytest.raises(CompanionError, match="v2 is armed"):
        await service_control.stop(session, facts, force=False)


async def test_the_machine_s_service_is_reached_by_root_alone() -> None:
    session = FakeSession()
    session.answer("sudo -n systemctl", 1, stderr="sudo: a password is required\n")
    with pytest.raises(CompanionError, match="needs root; allow"):
        await service_control.start(session, await running(session, unit="system", state="inactive"))
    root = FakeSession()
    await service_control.start(root, await running(root, unit="system", state="inactive", uid="0"))
    assert root.ran("; systemctl start skygcs")
