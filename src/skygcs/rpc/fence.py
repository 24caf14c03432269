"""The methods of the fence that a vehicle's parameters make: `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from skygcs.core.vehicle.fence_params import FenceAction
from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.context import Context, order, outcomes
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.ports import JsonObject
from skygcs.runtime.vehicle_actor import VehicleActor


class FenceSetParams(m.TargetsParams):
    radius_m: float | None = Field(None, ge=0, le=100_000, description="About home; 0 takes it away; null leaves it.")
    height_m: float | None = Field(None, ge=0, le=10_000, description="Above home; 0 takes it away; null leaves it.")
    action: FenceAction | None = Field(None, description="What it does beyond the fence; none: no fence. null: as is.")


class FenceTestParams(m.TargetsParams):
    radius_m: float = Field(2.0, ge=1, le=50, description="Of the test's fence, about home.")
    action: FenceAction = Field("return", description="What it is to do beyond it.")
    timeout_s: float = Field(120.0, ge=5, le=1800, description="For the walk.")


class FenceOutcome(m.Outcome):
    fence: dict[str, Any] | None = Field(
        description="enabled, action, radius_m, height_m, follows_list (whether polygons and circles are watched); "
        "of fence.status also breached, breaches, from_home_m, last_text."
    )
    record: dict[str, Any] | None = Field(description="Of fence.test: what was seen, and the file that holds it.")


class FenceOutcomes(m.Result):
    outcomes: dict[str, FenceOutcome] = Field(description="By vehicle name.")


async def fence_set(context: Context, params: FenceSetParams) -> JsonObject:
    """Set the fence about home by the autopilot's parameters (PX4 GF_*, ArduCopter FENCE_*), and read it back."""
    if params.radius_m is None and params.height_m is None and params.action is None:
        raise InvalidParams(("radius_m", "give a radius, a height or an action"))
    return await order(context, VehicleActor.set_fence, params)


async def fence_status(context: Context, params: m.ListParams) -> JsonObject:
    """The fence of each vehicle, read now, and what it tells of breaches."""
    return await outcomes(context, params.targets, VehicleActor.read_fence)


async def fence_test(context: Context, params: FenceTestParams) -> JsonObject:
    """Test the fence on foot, propellers off: a small one is set, the vehicle is carried out of it, and what it says
    and does is recorded to a file in the log directory; then its fence is put back, also when the caller goes away.

    Progress comes as events of kind fence. Ok: it told of the breach, and did what it is to do if it was armed.
    """
    return await order(context, VehicleActor.test_fence, params)


_TARGET = (dispatch.TARGET_ERROR,)

METHODS: tuple[Method[Context], ...] = (
    Method("fence.set", FenceSetParams, fence_set, FenceOutcomes, _TARGET),
    Method("fence.status", m.ListParams, fence_status, FenceOutcomes, _TARGET),
    Method("fence.test", FenceTestParams, fence_test, FenceOutcomes, _TARGET),
)
