"""The methods of authority over vehicles that several sites may command, for the federation's bridge.

The bridge holds a lease and grants the daemon parts of it. The daemon judges by its own clock, at the moment of
sending: `core.routing.send_gates`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from skygcs.errors import RefusedError
from skygcs.ext.federation.authority import CLOCK_ERROR_S, MAX_VALID_S, Authority
from skygcs.rpc import error_codes
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result

if TYPE_CHECKING:  # the bridge reads the table, too, and has no daemon
    from skygcs.rpc.context import Context, JsonObject


class _LeaseParams(MethodParams):
    vehicle: str = Field(min_length=1, max_length=64, description="Its name in [federation.vehicles].")
    token: int = Field(ge=0, description="The lease's revision. An older one than the last is refused.")
    hub: str = Field(max_length=64, description="What numbers the revisions; with another hub they begin anew.")


class GrantParams(_LeaseParams):
    sent_s: float = Field(
        description="CLOCK_BOOTTIME of this machine from which valid_for_s counts: a request that was under way for "
        "long, because a process was stopped, grants nothing."
    )
    valid_for_s: float = Field(gt=0, le=MAX_VALID_S, description="For so long.")


class RevokeParams(_LeaseParams):
    commander: str | None = Field(
        None, max_length=16, description="The site that commands it instead; null: not known, or none."
    )


class AuthorityState(Result):
    """Authority over one vehicle of [federation.vehicles]."""

    held: bool = Field(description="This site may command it now.")
    commander: str | None = Field(description="The site that commands it, as far as known.")
    remaining_s: float = Field(description="Of the grant; 0: none is in force.")
    token: int
    hub: str
    blocked_frames: int = Field(description="Frames that were not sent to it, since the daemon began.")


class GrantResult(AuthorityState):
    result: Literal["granted", "late", "fenced"] = Field(
        description="late: its time was over already; fenced: a newer grant or revocation came before."
    )


class AuthorityStatus(Result):
    site: str | None = Field(description="This site; null: the daemon gates no vehicle.")
    run: str = Field(description="Names this run of the daemon.")
    now_s: float = Field(description="The clock of grants, CLOCK_BOOTTIME.")
    vehicles: dict[str, AuthorityState] = Field(description="The vehicles of [federation.vehicles] by name.")


def _extension(context: Context) -> Any:
    """`skygcs.ext.federation.extension.Federation`, which has imported this."""
    return context.services.extensions["federation"]


def _authority(context: Context, vehicle: str) -> Authority:
    """Raises RefusedError for a vehicle that is not shared."""
    authority: Authority | None = _extension(context).authority
    if authority is None or vehicle not in authority.vehicles:
        raise RefusedError(f"[federation.vehicles] of the daemon's fleet file does not name {vehicle}")
    return authority


def _state(context: Context, authority: Authority, vehicle: str) -> JsonObject:
    state: JsonObject = _extension(context).state_of(authority.vehicles[vehicle])
    return state


def authority_grant(context: Context, params: GrantParams) -> JsonObject:
    """Allow frames to a vehicle until sent_s + valid_for_s."""
    authority = _authority(context, params.vehicle)
    now = context.services.hub.boot_clock()
    if params.sent_s > now + CLOCK_ERROR_S:
        raise RefusedError(
            f"sent_s is {params.sent_s - now:.1f} s ahead of the daemon's clock: the bridge has to run on the daemon's "
            "machine"
        )
    until = params.sent_s + params.valid_for_s
    result = authority.grant(params.vehicle, until, now, token=params.token, hub=params.hub)
    context.services.check_sending()
    return {**_state(context, authority, params.vehicle), "result": result}


def authority_revoke(context: Context, params: RevokeParams) -> JsonObject:
    """Send nothing to a vehicle from now on but vehicles.stop, and refuse grants up to this token."""
    authority = _authority(context, params.vehicle)
    authority.revoke(params.vehicle, token=params.token, hub=params.hub, commander=params.commander)
    context.services.check_sending()
    return _state(context, authority, params.vehicle)


def authority_status(context: Context, _: NoParams) -> JsonObject:
    """Which vehicles this site may command now."""
    extension, now_s = _extension(context), round(context.services.hub.boot_clock(), 4)
    authority: Authority | None = extension.authority
    site, vehicles = None, {}
    if authority is not None:
        site = authority.site
        vehicles = {name: _state(context, authority, name) for name in authority.vehicles}
    return {"site": site, "run": extension.daemon_run, "now_s": now_s, "vehicles": vehicles}


_REFUSED = (error_codes.REFUSED,)

METHODS: tuple[Method[Context], ...] = (
    Method("authority.grant", GrantParams, authority_grant, GrantResult, _REFUSED, while_stopping=True),
    Method("authority.revoke", RevokeParams, authority_revoke, AuthorityState, _REFUSED, while_stopping=True),
    Method("authority.status", NoParams, authority_status, AuthorityStatus, while_stopping=True),
)
