"""The methods for what was left changed in a vehicle: `METHODS` is their part of the table."""

from __future__ import annotations

from pydantic import Field

from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.context import Context
from skygcs.rpc.dispatch import Method
from skygcs.rpc.ports import JsonObject


class UndoParams(m.Params):
    id: str = Field(min_length=1, max_length=128, description="Of undo.list.")


class UndoRunParams(UndoParams):
    force: bool = Field(False, description="Although it is armed, or somebody else has changed the parameters since.")


class UndoChange(m.Result):
    """Parameters that a daemon changed for a while and did not put back."""

    id: str
    vehicle: str
    sysid: int
    autopilot: str
    what: str = Field(description="The order that changed them.")
    began: str = Field(description="UTC.")
    before: dict[str, float] = Field(description="What they were, in the order in which they are put back.")
    changed: dict[str, float] = Field(description="What they were set to.")


class UndoLeft(m.Result):
    changes: list[UndoChange]
    problems: list[str] = Field(description="Files in the journal that cannot be read.")


def undo_list(context: Context, _: m.NoParams) -> JsonObject:
    """What was changed in vehicles for a while and could not be put back: the daemon was killed, or the vehicle was out
    of reach."""
    return context.daemon.fleet.undo.left()


async def undo_run(context: Context, params: UndoRunParams) -> JsonObject:
    """Put back what one of them changed, and read it back.

    Refused to an armed vehicle, and where a parameter holds neither the value of before nor that of the change, unless
    forced.
    """
    outcome = await context.daemon.fleet.undo.run(params.id, force=params.force)
    return {"outcomes": {params.id: outcome.as_dict()}}


def undo_drop(context: Context, params: UndoParams) -> JsonObject:
    """Forget one of them: it stays as it is."""
    context.daemon.fleet.undo.drop(params.id)
    return {"dropped": params.id}


METHODS: tuple[Method[Context], ...] = (
    Method("undo.list", m.NoParams, undo_list, UndoLeft),
    Method("undo.run", UndoRunParams, undo_run, m.Outcomes, (dispatch.REFUSED,)),
    Method("undo.drop", UndoParams, undo_drop, dict[str, str], (dispatch.REFUSED,)),
)
