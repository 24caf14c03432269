"""The methods federation.* as a table: what the station socket checks and `rpc.discover` describes.

Each part of the bridge puts its methods into `Station.methods`; what a part says of their parameters and results is put
together here. A method of which nothing is said takes any object.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Literal

from pydantic import ConfigDict, Field

from skygcs.rpc import error_codes
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, OutcomeResult, Result

SITES = "federation.sites"
OUTCOME = "federation.outcome"

Answer = Callable[[dict[str, Any]], Awaitable[Any]]


class AnyParams(MethodParams):
    """Whatever is given; the method checks it."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class ClockStatus(Result):
    """How well the site's clock is known here."""

    ahead_s: float = Field(description="Of the site's clock against the wall clock of this computer.")
    error_s: float = Field(description="Bound of the error of every total age.")
    round_trip_s: float = Field(description="Of the ping that says so.")


class SiteVehicles(Result):
    """Counts of a site's vehicles."""

    count: int
    heard: int = Field(description="Connected, from here: 0 of a silent site.")
    armed: int
    in_the_air: int
    problems: int = Field(description="In a failsafe, or not heard; all of a silent site.")
    oldest_age_s: float | None = Field(description="Largest total age.")


class OtherSite(Result):
    """Another site as this station knows it."""

    site: str
    silent: bool = Field(description="Its states are too old to act on, or of an age that is not known.")
    age_s: float | None = Field(description="Since its newest batch was sent; null: not known, no ping was answered.")
    daemon: bool = Field(description="Whether its bridge has its daemon.")
    contested: bool = Field(description="Two bridges send under this name: end one of them.")
    run: str
    restarts: int = Field(description="Of its bridge, since this one began.")
    rate_hz: float
    batches: dict[str, int] = Field(description="taken, lost on the way, late (older than one that was taken).")
    clock: ClockStatus | None
    origin: dict[str, float] | None
    vehicles: SiteVehicles


class SitesResult(Result):
    """This station, its connection to the hub, and the other sites: total ages, vehicles, clocks."""

    station: str
    site: str | None = Field(description="null: this station is not a site.")
    role: str
    hub: dict[str, Any] = Field(description="connected, text, since_s, round_trip_s and counters.")
    contested: bool = Field(description="Another bridge sends under this site's name.")
    bridge: dict[str, Any] | None = Field(
        description="state of this bridge: asking, active or standby (another one acts as this site), and the other "
        "bridge of the site if one is heard: state, host, pid. null: this station is not a site."
    )
    sites: list[OtherSite]
    conflicts: list[dict[str, Any]] = Field(
        description="Of our vehicles with those of other sites, the most urgent first: vehicles, site, level, "
        "distance_m, closest_m, closest_in_s, enters_in_s, margin_m, balls_m, ages_s (of both positions)."
    )


class OutcomeParams(MethodParams):
    id: str = Field(
        min_length=1, max_length=64, description='As it was shown: "site/" and 32 hexadecimal digits; or these alone.'
    )


class OrderOutcome(Result):
    """Outcome of an order to a vehicle of another site."""

    id: str
    vehicle: str | None = Field(description="null: another station, or an earlier run of this one, gave the order.")
    method: str | None
    status: Literal["done", "failed", "refused", "late", "running", "unknown", "never came"] = Field(
        description="done, failed: it was given to the vehicle; refused, late, never came: it was not, and never will "
        "be; unknown: the site cannot say, or did not answer."
    )
    text: str
    outcome: OutcomeResult | None = Field(description="Of the vehicle, if the site's daemon answered.")
    answered: bool = Field(description="Whether the site answered now; if not, this is what was known here.")


class LeaseParams(MethodParams):
    vehicle: str = Field(min_length=1, max_length=80, description="Its name in [federation.vehicles].")


class TakeParams(LeaseParams):
    force: bool = Field(
        False, description="Although its holder is busy with it, or its home may go on commanding it without the hub."
    )
    without_hub: bool = Field(False, description="At its home, with force, while the hub is away.")


class LeaseStatus(Result):
    """The lease of a vehicle, as this site sees it."""

    vehicle: str
    home: str
    state: Literal["observed", "wanted", "held", "late", "alone", "releasing"] = Field(
        description="late: held, the last renewal had no answer; alone: held by its home without the hub."
    )
    holder: str | None = Field(description="The site that commands it; null: not known, or none.")
    held: bool = Field(description="By this site, now.")
    revision: int
    remaining_s: float
    without_hub: Literal["continue", "stop"]


DESCRIBED: Mapping[str, tuple[type[MethodParams], Any]] = {
    SITES: (NoParams, SitesResult),
    OUTCOME: (OutcomeParams, OrderOutcome),
    "federation.take": (TakeParams, LeaseStatus),
    "federation.release": (LeaseParams, LeaseStatus),
    "federation.leases": (NoParams, list[LeaseStatus]),
    "federation.status": (NoParams, dict[str, Any]),
}
"""Parameters and result by method."""


def station_methods(answers: Mapping[str, Answer]) -> dict[str, Method[Any]]:
    """The table of these methods. The docstring of each is its description."""
    return {name: _method(name, answer) for name, answer in sorted(answers.items())}


def _method(name: str, answer: Answer) -> Method[Any]:
    params, result = DESCRIBED.get(name, (AnyParams, dict[str, Any]))

    async def handler(_: Any, given: MethodParams) -> Any:
        return await answer(given.model_dump(exclude_unset=True))

    handler.__doc__ = answer.__doc__ or f"{name}."
    return Method(name, params, handler, result, (error_codes.LINK_ERROR,))
