"""The methods of changes left to be undone, and the extension that has them: it is made when one of them is first
called."""

from __future__ import annotations

from typing import cast

from pydantic import Field

from skygcs.ext.undo.undo_orders import UndoOrders
from skygcs.extension import Extension, NoTable
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, Services
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Outcomes, Result


class UndoParams(MethodParams):
    id: str = Field(min_length=1, max_length=128, description="Of undo.list.")


class UndoRunParams(UndoParams):
    force: bool = Field(False, description="Although it is armed, or a parameter holds another value.")


class UndoChange(Result):
    """Parameters that a daemon changed temporarily and did not restore."""

    id: str
    vehicle: str
    sysid: int
    autopilot: str
    what: str = Field(description="The order that changed them.")
    began: str = Field(description="UTC.")
    before: dict[str, float] = Field(description="Their values before, in the order in which they are restored.")
    changed: dict[str, float] = Field(description="What they were set to.")


class UndoLeft(Result):
    changes: list[UndoChange]
    problems: list[str] = Field(description="Files in the journal that cannot be read.")


async def undo_list(context: Context, _: NoParams) -> JsonObject:
    """Changes of parameters that could not be undone."""
    return await _orders_of(context).left()


async def undo_run(context: Context, params: UndoRunParams) -> JsonObject:
    """Undo one of them, and read the parameters back.

    Without force refused while armed, and where a parameter holds neither the old nor the changed value.
    """
    outcome = await _orders_of(context).run(params.id, force=params.force)
    return {"outcomes": {params.id: outcome.as_dict()}}


async def undo_drop(context: Context, params: UndoParams) -> JsonObject:
    """Forget one of these changes; the parameters stay as they are."""
    await _orders_of(context).drop(params.id)
    return {"dropped": params.id}


def _orders_of(context: Context) -> UndoOrders:
    return cast("Undo", context.services.extensions["undo"]).orders


METHODS: tuple[Method[Context], ...] = (
    Method("undo.list", NoParams, undo_list, UndoLeft, reach="nothing"),
    Method("undo.run", UndoRunParams, undo_run, Outcomes, (error_codes.REFUSED,), reach="fleet"),
    Method("undo.drop", UndoParams, undo_drop, dict[str, str], (error_codes.REFUSED,), reach="nothing"),
)


class Undo(Extension[NoTable]):
    own_methods = METHODS

    def __init__(self, core: Services, config: NoTable) -> None:
        super().__init__(core, config)
        fleet = core.fleet
        self.orders = UndoOrders(fleet.journal, fleet.vehicles, core.now, fleet.disk, core.event_log.publish)
