"""The methods about RTK corrections: `METHODS` is their part of the table."""

from __future__ import annotations

import base64
from typing import Any

from pydantic import Field

from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.context import Context
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.ports import JsonObject

MAX_DATA_CHARS = 65536
"""48 kB, a minute of the richest base."""


class CorrectionsParams(m.Params):
    data: str = Field(
        max_length=MAX_DATA_CHARS,
        description="The next bytes of an RTCM 3 stream, in base64; they may begin and end anywhere in a message.",
    )
    source: str = Field(
        "rpc",
        min_length=1,
        max_length=64,
        description="Whose stream it is. Another one is refused until this one has ended or was silent for 10 s.",
    )
    end: bool = Field(False, description="This is its last piece: another source may follow at once.")


class CorrectionsTaken(m.Result):
    """What became of the messages that this piece completed."""

    messages: int = Field(description="Handed to links; what a narrow radio carries of it tells corrections.status.")
    bytes: int = Field(description="Of RTCM in them.")
    types: dict[str, int] = Field(description="Messages by RTCM type.")
    refused: int = Field(description="Messages that no link took.")
    too_long: int = Field(description="Messages of more than 720 bytes, which GPS_RTCM_DATA cannot carry.")
    bad_crc: int = Field(description="Starts of messages whose checksum was wrong.")
    skipped_bytes: int = Field(description="Bytes that belong to no sound message.")
    links: int = Field(description="Open channels that may carry vehicles. 0: nobody to send to.")


class CorrectionsStatus(m.Result):
    """What went since the daemon began, without what ground stations send by themselves."""

    source: str | None = Field(description="Whose stream comes now.")
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
    vehicles: list[dict[str, Any]] = Field(description="name, fix (rtk_fixed, rtk_float, 3d, ...), satellites.")


def corrections_send(context: Context, params: CorrectionsParams) -> JsonObject:
    """Send RTK corrections (RTCM 3) to all vehicles, as GPS_RTCM_DATA."""
    try:
        data = base64.b64decode(params.data, validate=True)
    except ValueError as error:
        raise InvalidParams(("data", f"is not base64: {error}")) from None
    return context.daemon.send_corrections(params.source, data, end=params.end)


def corrections_status(context: Context, _: m.NoParams) -> JsonObject:
    """What corrections went, what each radio made of them, and the fix of every vehicle."""
    return context.daemon.corrections_status()


METHODS: tuple[Method[Context], ...] = (
    Method("corrections.send", CorrectionsParams, corrections_send, CorrectionsTaken, (dispatch.REFUSED,)),
    Method("corrections.status", m.NoParams, corrections_status, CorrectionsStatus),
)
