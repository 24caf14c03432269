"""The methods of links, of the router and of radios. `METHODS` and `AIR` are their parts of the table."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, resolve
from skygcs.rpc.dispatch import Method
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
