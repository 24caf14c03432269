"""The methods about the air of shared radios: `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.context import Context
from skygcs.rpc.dispatch import Method
from skygcs.rpc.ports import JsonObject, resolve


class SelectParams(m.Params):
    targets: m.Targets | None = Field(None, description="null: none; the selection before this one ends.")


class RadioAir(m.Result):
    """One radio. Rates are bytes per second."""

    link: str
    peer: str
    vehicles: list[dict[str, Any]] = Field(
        description="name, sysid, weight (1, selected 2, flown by setpoints 4), planned_bytes_per_s, "
        "measured_bytes_per_s, loss (0 to 1, last half minute; null: too few frames), round_trip_s, settled, scaled "
        "(it gets less than it would send), streams (planned_hz and measured_hz by message)"
    )
    down: dict[str, Any] = Field(
        description="budget_bytes_per_s, per_vehicle_bytes_per_s (its timeslot), planned_bytes_per_s, "
        "measured_bytes_per_s, factor (below 1 after losses)"
    )
    up: dict[str, Any] = Field(
        description="base_bytes_per_s (from baud and air speed), bytes_per_s (now), paced_by (rates or reports), "
        "round_s, radio (its last report), classes (waiting, sent, sent_bytes, replaced, dropped, refused, wait_p50_s, "
        "wait_p95_s of each class), third_party (what others send: bytes_per_s they may have, param_lists with what is "
        "running and waiting, and of each source sent, sent_bytes and counts by what became of the rest), corrections "
        "(RTCM)"
    )
    poor: list[str] = Field(description="What is degraded now: txbuf, signal, or a vehicle's name for its losses.")
    history: list[dict[str, Any]] = Field(description="The radio's reports of the last minute, oldest first.")


def link_status(context: Context, _: m.NoParams) -> list[JsonObject]:
    """How each radio's air is used: budgets, classes, vehicles, losses, the radio's own reports."""
    return context.daemon.air_status()


def link_select(context: Context, params: SelectParams) -> JsonObject:
    """Give some vehicles twice the others' part of a radio that is too narrow for all, until the next selection."""
    daemon = context.daemon
    chosen = [] if params.targets is None else resolve(daemon, params.targets)
    daemon.select_vehicles({v.sysid << 8 | v.compid for v in chosen})
    return {"selected": [v.name for v in chosen]}


METHODS: tuple[Method[Context], ...] = (
    Method("link.status", m.NoParams, link_status, list[RadioAir]),
    Method("link.select", SelectParams, link_select, dict[str, Any], (dispatch.TARGET_ERROR,)),
)
