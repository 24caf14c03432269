"""The orders and methods of the fence of parameters, and the extension that has them: it is made when one of them is
first called."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from pydantic import Field

from skygcs.core.vehicle.fence_params import FenceAction
from skygcs.extension import Extension, NoTable
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, command
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.models import ListParams, OutcomeResult, Result, TargetsParams
from skygcs.runtime.fence_orders import FenceOutcome, VehicleFence
from skygcs.runtime.order_runner import duplicate_refusal
from skygcs.runtime.vehicle_actor import VehicleActor

# -- orders


async def set_fence(
    actor: VehicleActor,
    *,
    radius_m: float | None = None,
    height_m: float | None = None,
    action: str | None = None,
    force: bool = False,
) -> FenceOutcome:
    """See `VehicleFence.set`."""
    work = lambda: actor.part(VehicleFence).set(radius_m=radius_m, height_m=height_m, action=action, force=force)  # noqa: E731
    return await _report_fence(actor, "fence", work)


async def read_fence(actor: VehicleActor) -> FenceOutcome:
    """See `VehicleFence.status`."""
    return await actor.part(VehicleFence).status()


async def test_fence(actor: VehicleActor, *, radius_m: float, action: str, timeout_s: float) -> FenceOutcome:
    """See `VehicleFence.test`."""
    work = lambda: actor.part(VehicleFence).test(radius_m=radius_m, action=action, timeout_s=timeout_s)  # noqa: E731
    return await _report_fence(actor, "fence test", work)


async def _report_fence(
    actor: VehicleActor, order: str, work: Callable[[], Coroutine[None, None, FenceOutcome]]
) -> FenceOutcome:
    """Report its outcome like that of any order; a cancelled test reports itself."""
    if actor.vehicle.duplicate:
        return FenceOutcome(actor.outcomes.finish(order, duplicate_refusal(actor.vehicle)))
    outcome = await work()
    actor.outcomes.finish(order, outcome.outcome)
    return outcome


# -- methods


class FenceSetParams(TargetsParams):
    radius_m: float | None = Field(None, ge=0, le=100_000, description="Around home; 0 removes it; null leaves it.")
    height_m: float | None = Field(None, ge=0, le=10_000, description="Above home; 0 removes it; null leaves it.")
    action: FenceAction | None = Field(
        None, description="What it does outside the fence; none: no fence; null: leaves it."
    )
    force: bool = Field(False, description="Although it flies and would be outside of that fence at once.")


class FenceTestParams(TargetsParams):
    radius_m: float = Field(2.0, ge=1, le=50, description="Radius of the test fence around home.")
    action: FenceAction = Field("return", description="What it must do outside it.")
    timeout_s: float = Field(120.0, ge=5, le=1800, description="Time for the walk.")


class HomeFence(Result):
    """The fence about home; of fence.status also breached, breaches, from_home_m, last_text."""

    enabled: bool | None
    action: str | None
    radius_m: float | None
    height_m: float | None
    follows_list: bool | None = Field(description="Whether polygons and circles are watched.")


class FenceResult(OutcomeResult):
    fence: HomeFence | None
    record: dict[str, Any] | None = Field(description="Of fence.test: what was seen, and the file that holds it.")


class FenceResults(Result):
    outcomes: dict[str, FenceResult] = Field(description="By vehicle name.")


async def fence_set(context: Context, params: FenceSetParams) -> JsonObject:
    """Set the fence about home by the autopilot's parameters (PX4 GF_*, ArduCopter FENCE_*), and read it back."""
    if params.radius_m is None and params.height_m is None and params.action is None:
        raise InvalidParams(("radius_m", "give a radius, a height or an action"))
    return await command(context, params.targets, set_fence, shaped=FenceOutcome, **params.arguments())


async def fence_status(context: Context, params: ListParams) -> JsonObject:
    """The fence of each vehicle, read now, and what it reports of breaches."""
    return await command(context, params.targets, read_fence, shaped=FenceOutcome)


async def fence_test(context: Context, params: FenceTestParams) -> JsonObject:
    """Test the fence on foot, propellers off (docs/howto/missions.md): a small one is set, and the old one put back.

    Progress comes as events of kind fence. ok: it reported the breach and, if armed, took its action.
    """
    return await command(context, params.targets, test_fence, shaped=FenceOutcome, **params.arguments())


_TARGET = (error_codes.TARGET_ERROR,)


METHODS: tuple[Method[Context], ...] = (
    Method("fence.set", FenceSetParams, fence_set, FenceResults, _TARGET),
    Method("fence.status", ListParams, fence_status, FenceResults, _TARGET),
    Method("fence.test", FenceTestParams, fence_test, FenceResults, _TARGET),
)


class Fence(Extension[NoTable]):
    own_methods = METHODS
