"""The methods of RTK corrections, and the extension that has them without the table: it is made when one is called."""

from __future__ import annotations

import base64
from typing import Any, Literal, cast

from pydantic import Field

from skygcs.errors import RefusedError
from skygcs.ext.corrections.correction_feed import CorrectionFeed
from skygcs.extension import Extension
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, Services
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.models import MethodParams, NoParams, Result

MAX_DATA_CHARS = 65536
"""48 kB, a minute of the richest base."""


class CorrectionsParams(MethodParams):
    data: str = Field(
        max_length=MAX_DATA_CHARS,
        description="The next bytes of an RTCM 3 stream, in base64, divided anywhere.",
    )
    source: str = Field(
        "rpc",
        min_length=1,
        max_length=64,
        description="Name of the stream. Another is refused until this one has ended or was silent for 10 s.",
    )
    end: bool = Field(False, description="Its last piece: another source may follow at once.")


class CorrectionsTaken(Result):
    """Fate of the messages that this piece completed."""

    messages: int = Field(description="Handed to links; corrections.status shows what a narrow radio carried of them.")
    bytes: int = Field(description="Of RTCM in them.")
    types: dict[str, int] = Field(description="Messages by RTCM type.")
    refused: int = Field(description="Messages that no link took.")
    too_long: int = Field(description="Messages of more than 720 bytes, which GPS_RTCM_DATA cannot carry.")
    bad_crc: int = Field(description="Starts of messages whose checksum was wrong.")
    skipped_bytes: int = Field(description="Bytes that are part of no valid message.")
    links: int = Field(description="Open channels that may carry vehicles; 0: the message was sent to none.")


class RtkFix(Result):
    name: str
    fix: str | None = Field(description="rtk_fixed, rtk_float, 3d, ...")
    satellites: int | None


class Survey(Result):
    """The position of the own receiver."""

    state: Literal["setting_up", "surveying", "surveyed", "fixed"]
    duration_s: float | None
    minimum_s: float | None
    accuracy_m: float | None
    wanted_m: float | None
    observations: int | None


class OwnSource(Result):
    """The source of [corrections]; also connected (times), failures (attempts since), types (messages by RTCM type),
    gga (from, sent, age_s)."""

    kind: Literal["ntrip", "receiver"]
    name: str
    state: Literal["connecting", "waiting", "streaming", "held_off", "down"]
    text: str = Field(description="The latest trouble.")
    since_s: float
    bytes: int
    bytes_per_s: float
    messages: int
    age_s: float | None = Field(description="Of the last message.")
    survey: Survey | None = None


class CorrectionsStatus(Result):
    """Corrections that went since the daemon began, without what ground stations send by themselves."""

    source: str | None = Field(description="Name of the stream that is being received.")
    age_s: float | None = Field(description="Since the last message; null: none yet.")
    bytes_per_s: float = Field(description="Of RTCM, in the last 10 s.")
    messages: int
    bytes: int
    refused: int
    too_long: int
    bad_crc: int
    skipped_bytes: int
    types: dict[str, Any] = Field(description="By RTCM type: messages, bytes, age_s (of the last one).")
    radios: list[dict[str, Any]] = Field(
        description="Of each radio with a budget: link, peer, bytes_per_s (its share for corrections), source "
        "(sysid/compid), what waits and what was sent, replaced, dropped. Ground stations' included."
    )
    vehicles: list[RtkFix]
    rtk_float: int = Field(description="Vehicles with a float solution.")
    rtk_fixed: int = Field(description="Vehicles with a fixed solution.")
    own_source: OwnSource | None = Field(description="Null: the fleet file has none.")


def corrections_send(context: Context, params: CorrectionsParams) -> JsonObject:
    """Send RTK corrections (RTCM 3) to all vehicles, as GPS_RTCM_DATA."""
    try:
        data = base64.b64decode(params.data, validate=True)
    except ValueError as error:
        raise InvalidParams(("data", f"is not base64: {error}")) from None
    return _part_of(context).feed.send(params.source, data, end=params.end)


def corrections_status(context: Context, _: NoParams) -> JsonObject:
    """Corrections that were sent, and the fix of every vehicle."""
    return _part_of(context).feed.status()


def corrections_survey(context: Context, _: NoParams) -> JsonObject:
    """Have the receiver of [corrections] survey its position in anew, as after its antenna was moved."""
    return _part_of(context).restart_survey()


def _part_of(context: Context) -> Corrections:
    return cast("Corrections", context.services.extensions["corrections"])


_REFUSED = (error_codes.REFUSED,)

METHODS: tuple[Method[Context], ...] = (
    Method("corrections.send", CorrectionsParams, corrections_send, CorrectionsTaken, _REFUSED),
    Method("corrections.status", NoParams, corrections_status, CorrectionsStatus),
    Method("corrections.survey", NoParams, corrections_survey, dict[str, Any], _REFUSED),
)


class Corrections(Extension[Any]):
    """Takes corrections of clients to the vehicles; the table [corrections] adds a source of its own to it."""

    own_methods = METHODS

    def __init__(self, core: Services, config: Any) -> None:
        super().__init__(core, config)
        self.feed = CorrectionFeed(core.hub, core.fleet, core.now)

    def woke(self, why: str) -> None:
        self.feed.woke()

    def restart_survey(self) -> dict[str, Any]:
        """Begin the survey of the own receiver anew; the status of the source. Raises RefusedError."""
        raise RefusedError("the fleet file has no table [corrections]: there is no receiver that could survey")
