"""The methods of onboard logs, and the extension that has them: it is made when one of them is first called.

The orders are functions of the vehicle's actor, given with `FleetOrders.command_all`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from skygcs.ext.onboard_logs.vehicle_logs import LogsOutcome, VehicleLogs
from skygcs.extension import Extension, NoTable
from skygcs.rpc.context import Context, order_method
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import Result, TargetsParams
from skygcs.runtime.vehicle_actor import VehicleActor

LogId = Annotated[int, Field(ge=0, le=65535)]


class LogsGetParams(TargetsParams):
    logs: Literal["latest", "all"] | Annotated[list[LogId], Field(min_length=1, max_length=500)] = Field(
        "latest", description='"latest", "all", or ids as logs.list shows them.'
    )
    force: bool = Field(False, description="Over a radio, too: it slows every vehicle on it.")


class LogsOutcomes(Result):
    outcomes: dict[str, dict[str, Any]] = Field(
        description="By vehicle name: an outcome, with logs (id, size_bytes, time_unix_s or null) and files (id, path, "
        "size_bytes, resumed_at: bytes that were there before)."
    )


async def list_logs(actor: VehicleActor) -> LogsOutcome:
    """The logs that vehicles have on board. Refused while armed."""
    return await actor.part(VehicleLogs).list()


async def get_logs(actor: VehicleActor, *, logs: Sequence[int] | str, force: bool = False) -> LogsOutcome:
    """Write onboard logs of vehicles to files of the daemon, in onboard/ of its log_dir.

    Resumes a log that came in part; skips one that is there. Progress comes as events of kind
    onboard_log. Refused while armed, and over a radio without force. It ends with its client.
    """
    return await actor.part(VehicleLogs).get(logs, force=force)


METHODS: tuple[Method[Context], ...] = tuple(
    order_method(name, params, order, order.__doc__ or "", result=LogsOutcomes, shaped=LogsOutcome.without_logs)
    for name, params, order in (("logs.list", TargetsParams, list_logs), ("logs.get", LogsGetParams, get_logs))
)


class OnboardLogs(Extension[NoTable]):
    own_methods = METHODS
