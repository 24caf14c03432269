"""The methods of preflight, and the extension that has them: it is made when one of them is first called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast

from pydantic import Field

from skygcs.extension import Extension, NoTable
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import ParamName, ParamResult, Result, TargetsParams
from skygcs.runtime.preflight_run import Preflight, examine_fleet


class PreflightParams(TargetsParams):
    fix: bool = Field(
        False,
        description="Set the parameters that mend failed checks, and examine again; not on an armed vehicle, and "
        "never a system id.",
    )
    confirmed: dict[str, dict[ParamName, float]] | None = Field(
        None,
        description="With fix: only these values, by vehicle's name, then by parameter's; null: all.",
    )


class PreflightFix(Result):
    """A parameter that would mend a failed check."""

    name: str
    before: float
    value: float


class PreflightFinding(Result):
    """One check's verdict."""

    check: str = Field(description="What was checked; a parameter's name for those of the fleet file.")
    verdict: Literal["pass", "fail", "unknown", "skipped"] = Field(
        description="unknown is no pass; skipped: nothing is expected of it."
    )
    severity: Literal["danger", "fault", "note"] = Field(description="Of a failure.")
    text: str = Field(description="What was found, with the figure and the limit.")
    todo: str = Field(description="What to do about it.")
    fixes: list[PreflightFix]


class PreflightReport(Result):
    """How ready one vehicle is."""

    ok: bool
    summary: str = Field(description="The worst of it in a line.")
    sysid: int
    autopilot: str = Field(description="Empty for a vehicle of the fleet file that was never heard.")
    findings: list[PreflightFinding] = Field(description="In the order of the checks.")
    fixes: list[PreflightFix] = Field(description="All of them, each parameter once.")
    fixed: dict[str, ParamResult] = Field(description="What was set, and how that ended, by name.")
    unfixed: str = Field(description="Why nothing was set although it was asked for; else empty.")


class PreflightAnswer(Result):
    ok: bool = Field(description="Whether every one of them is ready.")
    vehicles: dict[str, PreflightReport] = Field(
        description="By name, also those of the fleet file that have not been heard."
    )


class PreflightStatus(Result):
    """Findings about a vehicle without asking it again."""

    state: Literal["never", "failed", "passed", "expired"] = Field(description="never: not since it started.")
    required: bool = Field(description="Whether it is armed only with a pass (require_preflight).")
    age_s: float | None
    valid_s: float | None = Field(description="How long its pass still lasts; null without one.")
    refusal: str | None = Field(description="Why an order to arm would be refused here now; null: it would not.")
    report: PreflightReport | None


async def preflight_run(context: Context, params: PreflightParams) -> JsonObject:
    """Examine vehicles before a flight (docs/howto/preflight.md); takes a few seconds a vehicle."""
    checks = cast("PreflightChecks", context.services.extensions["preflight"])
    reports = await checks.examine(params.targets, fix=params.fix, confirmed=params.confirmed)
    return {"ok": all(report["ok"] for report in reports.values()), "vehicles": reports}


def preflight_status(context: Context, params: TargetsParams) -> JsonObject:
    """The last preflight of each vehicle since it started, and whether it may be armed."""
    return cast("PreflightChecks", context.services.extensions["preflight"]).status(params.targets)


_TARGET = (error_codes.TARGET_ERROR,)


METHODS: tuple[Method[Context], ...] = (
    Method("preflight.run", PreflightParams, preflight_run, PreflightAnswer, _TARGET),
    Method("preflight.status", TargetsParams, preflight_status, dict[str, PreflightStatus], _TARGET),
)


class PreflightChecks(Extension[NoTable]):
    own_methods = METHODS

    async def examine(
        self,
        targets: str | int | Sequence[str | int],
        *,
        fix: bool,
        confirmed: Mapping[str, Mapping[str, float]] | None,
    ) -> dict[str, Any]:
        """See `examine_fleet`. Raises TargetError."""
        return await examine_fleet(self.core.fleet, targets, fix=fix, confirmed=confirmed)

    def status(self, targets: str | int | Sequence[str | int]) -> dict[str, Any]:
        """See `Preflight.status`. Raises TargetError."""
        return {actor.name: actor.part(Preflight).status() for actor in self.core.fleet.resolve(targets)}
