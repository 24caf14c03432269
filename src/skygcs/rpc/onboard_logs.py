"""The methods of the autopilots' onboard logs. `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, order_method
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import Result, TargetsParams
from skygcs.runtime import (
    onboard_logs,  # noqa: F401 - a vehicle uses it, and must not wait for its import
    onboard_orders,
)

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


METHODS: tuple[Method[Context], ...] = (
    order_method(
        "logs.list",
        TargetsParams,
        onboard_orders.list_logs,
        "The logs that vehicles have on board. Refused while armed.",
        result=LogsOutcomes,
        errors=(error_codes.TARGET_ERROR,),
    ),
    order_method(
        "logs.get",
        LogsGetParams,
        onboard_orders.get_logs,
        """Write onboard logs of vehicles to files of the daemon, in onboard/ of its log_dir.

        A log that came in part is resumed; one that is there is not read again. Progress comes as events of kind
        onboard_log. Refused while armed, and over a radio without force. It ends with its client.
        """,
        result=LogsOutcomes,
        errors=(error_codes.TARGET_ERROR,),
    ),
)
