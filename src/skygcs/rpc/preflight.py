"""The methods of preflight: `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.context import Context
from skygcs.rpc.dispatch import Method
from skygcs.rpc.params import Name, ParamOutcome
from skygcs.rpc.ports import JsonObject


class PreflightParams(m.TargetsParams):
    fix: bool = Field(
        False, description="Set the parameters that would put something right, read them back, and examine it again."
    )
    confirmed: dict[str, dict[Name, float]] | None = Field(
        None,
        description="With fix: only these values, by vehicle's name, then by parameter's, as somebody has agreed to "
        "them; null: all.",
    )


class PreflightFix(m.Result):
    """A parameter that would put something right."""

    name: str
    before: float
    value: float


class PreflightFinding(m.Result):
    """One check's verdict."""

    check: str = Field(description="What was checked; a parameter's name for those of the fleet file.")
    verdict: str = Field(description="pass, fail, unknown (which is no pass) or skipped (nothing is expected of it).")
    severity: str = Field(description="Of a failure: danger, fault, note.")
    text: str = Field(description="What is so, with the figure and the limit.")
    todo: str = Field(description="What to do about it.")
    fixes: list[PreflightFix]


class PreflightReport(m.Result):
    """How ready one vehicle is."""

    ok: bool
    summary: str = Field(description="The worst of it in a line.")
    sysid: int
    autopilot: str = Field(description="Empty for a vehicle of the fleet file that was never heard.")
    findings: list[PreflightFinding] = Field(description="In the order of the checks.")
    fixes: list[PreflightFix] = Field(description="All of them, each parameter once.")
    fixed: dict[str, ParamOutcome] = Field(description="What was set, and how that ended, by name.")
    unfixed: str = Field(description="Why nothing was set although it was asked for; else empty.")


class PreflightAnswer(m.Result):
    ok: bool = Field(description="Whether every one of them is ready.")
    vehicles: dict[str, PreflightReport] = Field(
        description="By name, also those of the fleet file that are meant and have not been heard."
    )


class PreflightStatus(m.Result):
    """What is known of a vehicle without asking it again."""

    state: str = Field(description="never (since it started), failed, passed, expired.")
    required: bool = Field(description="Whether it is armed only with a pass (require_preflight).")
    age_s: float | None
    valid_s: float | None = Field(description="How long its pass still lasts; null without one.")
    refusal: str | None = Field(description="Why an order to arm would be refused here now; null: it would not.")
    report: PreflightReport | None


async def preflight_run(context: Context, params: PreflightParams) -> JsonObject:
    """Examine vehicles before a flight: parameters, sensors, estimator, GPS, battery, home, clock, link.

    Asks each for what is not known; some seconds a vehicle. With fix, parameters are set: not on a vehicle that is
    armed, and never its system id. Some take effect only after a reboot.
    """
    told: dict[str, Any] = await context.daemon.fleet.preflight(
        params.targets, fix=params.fix, confirmed=params.confirmed
    )
    return {"ok": all(report["ok"] for report in told.values()), "vehicles": told}


def preflight_status(context: Context, params: m.TargetsParams) -> JsonObject:
    """The last preflight of each vehicle since it started, and whether it may be armed."""
    return context.daemon.fleet.preflight_status(params.targets)


_TARGET = (dispatch.TARGET_ERROR,)

METHODS: tuple[Method[Context], ...] = (
    Method("preflight.run", PreflightParams, preflight_run, PreflightAnswer, _TARGET),
    Method("preflight.status", m.TargetsParams, preflight_status, dict[str, PreflightStatus], _TARGET),
)
