"""The methods of message signing, and the extension that has them: it is made when one of them is first called. No key
is sent over RPC, only its file name."""

from __future__ import annotations

from pathlib import Path
from typing import cast

from pydantic import Field

from skygcs.ext.signing.signing_setup import SigningSetup
from skygcs.extension import Extension, NoTable
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, Services, as_json
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.models import MethodParams, NoParams, Outcomes, Result, TargetsParams


class SigningSetupParams(TargetsParams):
    key_file: str = Field(
        min_length=1, max_length=4096, description="Absolute path of the key file, on the daemon's machine."
    )
    force: bool = Field(False, description="Although others can receive the link: the key is sent in clear text.")


class SigningResetParams(MethodParams):
    key_id: str = Field(min_length=1, max_length=64, description="As signing.status names the key.")
    force: bool = Field(False, description="Although a vehicle is armed.")


class SigningReset(Result):
    message: str


class SigningKeyState(Result):
    """A key in use."""

    key_id: str = Field(description="Distinguishes keys; the key cannot be derived from it.")
    time_unix_s: float = Field(description="The key's clock: the highest of ours and of all that was heard.")
    ahead_s: float = Field(description="Of the system clock.")
    pinned: bool = Field(description="It is farther ahead than any source may move it: see signing.reset_clock.")
    links: list[str]


class SigningChannelState(Result):
    """Frames of one channel since it was opened, by what became of them."""

    peer: str
    signed: int = Field(description="Correctly signed and new.")
    unsigned_allowed: int = Field(description="Not signed, and named in accept_unsigned.")
    unsigned: int = Field(description="Dropped: not signed.")
    bad_signature: int = Field(description="Dropped: signed with another key, or changed.")
    replayed: int = Field(description="Dropped: not newer than the last of its stream.")
    stale: int = Field(description="Dropped: a new stream, and more than a minute behind.")
    ahead: int = Field(description="Dropped: stamped more than max_ahead_s ahead of the system clock.")
    too_many_streams: int = Field(description="Dropped: the table of streams is full.")
    sent_signed: int = Field(description="Our own messages.")


class SigningLinkState(Result):
    """A link with a key."""

    link: str
    key_id: str
    key_file: str
    link_id: int
    sign_outgoing: bool
    accept_unsigned: list[str | int]
    channels: list[SigningChannelState]


class SigningStatus(Result):
    keys: list[SigningKeyState]
    links: list[SigningLinkState]


async def signing_setup(context: Context, params: SigningSetupParams) -> JsonObject:
    """Send vehicles a signing key (SETUP_SIGNING), and wait until they sign with it.

    Refused to an armed vehicle, and over a link that others can receive. skygcs signs by the link's signing table.
    """
    path = Path(params.key_file)
    if "\0" in params.key_file:
        raise InvalidParams(("key_file", "holds a NUL character"))
    if not path.is_absolute():
        raise InvalidParams(("key_file", "must be an absolute path: the daemon runs in another folder"))
    setup = _setup_of(context).setup
    return as_json(await setup(params.targets, path, force=params.force, reports=context.reports))


async def signing_off(context: Context, params: TargetsParams) -> JsonObject:
    """Have vehicles forget their signing key; not while armed."""
    return as_json(await _setup_of(context).off(params.targets, reports=context.reports))


def signing_status(context: Context, _: NoParams) -> JsonObject:
    """Keys in use with their clocks, and what the links accepted and dropped."""
    return context.services.signing.status(context.services.hub.channels.values())


def signing_reset_clock(context: Context, params: SigningResetParams) -> JsonObject:
    """Set a key's clock, which a frame moved far ahead, back to the system clock; not while a vehicle is armed.

    Vehicles that have followed the later time need their key again over a cable (signing.setup).
    """
    return {"message": _setup_of(context).reset_clock(params.key_id, force=params.force)}


def _setup_of(context: Context) -> SigningSetup:
    return cast("SigningMethods", context.services.extensions["signing"]).setup


_REPORTED = (error_codes.TARGET_ERROR, error_codes.REFUSED)


METHODS: tuple[Method[Context], ...] = (
    Method("signing.status", NoParams, signing_status, SigningStatus),
    Method("signing.setup", SigningSetupParams, signing_setup, Outcomes, _REPORTED),
    Method("signing.reset_clock", SigningResetParams, signing_reset_clock, SigningReset, (error_codes.REFUSED,)),
    Method("signing.off", TargetsParams, signing_off, Outcomes, _REPORTED),
)


class SigningMethods(Extension[NoTable]):
    own_methods = METHODS

    def __init__(self, core: Services, config: NoTable) -> None:
        super().__init__(core, config)
        self.setup = SigningSetup(core)
