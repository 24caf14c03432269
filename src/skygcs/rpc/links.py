"""The methods of links, of the router, of radios and of what is sent to all of them (RTK corrections).

`METHODS`, `AIR` and `CORRECTIONS` are their parts of the table.
"""

from __future__ import annotations

import base64
import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, resolve
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.models import MethodParams, NoParams, Result, Targets

LinkName = Annotated[str, Field(min_length=1, max_length=64, description="The link's name.")]


def _new_link_name(name: str) -> str:
    if not re.fullmatch(r"[\w.:-]+", name, re.ASCII):
        raise ValueError("a link's name is made of letters, digits, _ - . and :")
    return name


class LinkParams(MethodParams):
    name: LinkName
    link: dict[str, Any] = Field(description="Its table as in the fleet file, with its type.")


class LinkAddParams(LinkParams):
    name: Annotated[LinkName, AfterValidator(_new_link_name)]


class LinkNameParams(MethodParams):
    name: LinkName


class SelectParams(MethodParams):
    targets: Targets | None = Field(None, description="null: none; the selection before this one ends.")


class StreamRates(Result):
    planned_hz: float
    measured_hz: float


class RadioVehicle(Result):
    """Share of one vehicle in a radio's air."""

    name: str
    sysid: int
    weight: float = Field(description="1, selected 2, flown by setpoints 4.")
    planned_bytes_per_s: float
    measured_bytes_per_s: float | None
    loss: float | None = Field(description="0 to 1, last half minute; null: too few frames.")
    round_trip_s: float | None
    settled: bool
    scaled: bool = Field(description="It gets less than it would send.")
    streams: dict[str, StreamRates] = Field(description="By message.")


class RadioDown(Result):
    """Traffic from all vehicles of a radio."""

    budget_bytes_per_s: float
    per_vehicle_bytes_per_s: float = Field(description="Its timeslot.")
    planned_bytes_per_s: float
    measured_bytes_per_s: float
    factor: float = Field(description="Below 1 after losses.")


class RadioReport(Result):
    """One RADIO_STATUS."""

    age_s: float
    txbuf_percent: float
    rssi: float
    noise: float
    remrssi: float
    remnoise: float


class ClassCounters(Result):
    """Frames of one class of traffic."""

    waiting: int
    sent: int
    sent_bytes: int
    replaced: int
    dropped: int
    refused: int
    wait_p50_s: float | None
    wait_p95_s: float | None


class ThirdPartySource(Result):
    """Frames of one other ground station."""

    source: str
    age_s: float
    sent: int
    sent_bytes: int
    counts: dict[str, int] = Field(description="By what became of the rest.")


class ThirdPartyShare(Result):
    bytes_per_s: float = Field(description="What others may have.")
    sources: list[ThirdPartySource]


class RadioUp(Result):
    """Traffic from this station to a radio; also timing (assumed or measured timeslots), corrections (RTCM)."""

    base_bytes_per_s: float = Field(description="From baud and air speed.")
    bytes_per_s: float = Field(description="Now.")
    paced_by: Literal["rates", "reports"]
    round_s: float | None
    radio: RadioReport | None = Field(description="Its last report.")
    classes: dict[str, ClassCounters]
    third_party: ThirdPartyShare | None


class RadioAir(Result):
    """One radio. Rates are bytes per second."""

    link: str
    peer: str
    vehicles: list[RadioVehicle]
    down: RadioDown
    up: RadioUp
    poor: list[str] = Field(description="What is degraded now: txbuf, signal, or a vehicle's name for its losses.")
    history: list[RadioReport] = Field(description="The radio's reports of the last minute, oldest first.")


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


class ChannelState(Result):
    """One peer of a link; more counters with it."""

    peer: str
    rx_bytes: int = Field(0, description="Of frames.")
    skipped_bytes: int = Field(0, description="In no frame.")
    good: int = 0
    unknown: int = Field(0, description="Frames of messages that the dialect does not have.")
    sources: dict[str, Any] = Field(default_factory=dict)
    counters: dict[str, int] = Field(default_factory=dict)


class LinkState(Result):
    name: str
    type: str
    role: str
    state: str
    last_error: str | None
    ignored_datagrams: int = Field(0, description="UDP: they had no frame in them.")
    peers_refused: int = 0
    not_allowed: int = Field(0, description="From addresses that allow_from leaves out.")
    channels: list[ChannelState]


def links_list(context: Context, _: NoParams) -> list[JsonObject]:
    """Every link, with its channels and counters."""
    return context.services.links.status()


async def links_add(context: Context, params: LinkAddParams) -> list[JsonObject]:
    """Add a link until the daemon ends."""
    await context.services.links.add(params.name, params.link)
    return context.services.links.status()


async def links_change(context: Context, params: LinkParams) -> list[JsonObject]:
    """Close a link and open it again with a new configuration."""
    await context.services.links.change(params.name, params.link)
    return context.services.links.status()


async def links_remove(context: Context, params: LinkNameParams) -> list[JsonObject]:
    """Close a link and forget it."""
    await context.services.links.remove(params.name)
    return context.services.links.status()


def router_stats(context: Context, _: NoParams) -> JsonObject:
    """Routes, and counters of what was forwarded, filtered and dropped."""
    return context.services.hub.statistics.router_stats()


def link_status(context: Context, _: NoParams) -> list[JsonObject]:
    """Each radio's budgets, classes, vehicles, losses and own reports."""
    return context.services.air.status(context.services.now())


def link_select(context: Context, params: SelectParams) -> JsonObject:
    """Give some vehicles twice the others' part of a radio."""
    chosen = [] if params.targets is None else resolve(context.services, params.targets)
    context.services.air.select({v.sysid << 8 | v.compid for v in chosen})
    return {"selected": [v.name for v in chosen]}


def corrections_send(context: Context, params: CorrectionsParams) -> JsonObject:
    """Send RTK corrections (RTCM 3) to all vehicles, as GPS_RTCM_DATA."""
    try:
        data = base64.b64decode(params.data, validate=True)
    except ValueError as error:
        raise InvalidParams(("data", f"is not base64: {error}")) from None
    return context.services.corrections.send(params.source, data, end=params.end)


def corrections_status(context: Context, _: NoParams) -> JsonObject:
    """Corrections that were sent, and the fix of every vehicle."""
    return context.services.corrections.status()


_LINK = (error_codes.LINK_ERROR, error_codes.REFUSED)

METHODS: tuple[Method[Context], ...] = (
    Method("links.list", NoParams, links_list, list[LinkState], always=True),
    Method("links.add", LinkAddParams, links_add, list[dict[str, Any]], _LINK, reach="nothing"),
    Method("links.change", LinkParams, links_change, list[dict[str, Any]], _LINK, reach="nothing"),
    Method("links.remove", LinkNameParams, links_remove, list[dict[str, Any]], _LINK, reach="nothing"),
    Method("router.stats", NoParams, router_stats),
)


AIR: tuple[Method[Context], ...] = (
    Method("link.status", NoParams, link_status, list[RadioAir]),
    Method("link.select", SelectParams, link_select, dict[str, Any], (error_codes.TARGET_ERROR,)),
)


CORRECTIONS: tuple[Method[Context], ...] = (
    Method("corrections.send", CorrectionsParams, corrections_send, CorrectionsTaken, (error_codes.REFUSED,)),
    Method("corrections.status", NoParams, corrections_status, CorrectionsStatus),
)
