"""The methods that a ground calls at a companion: control relayed."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from skygcs.ext.companions.ground_orders import GroundOrders
from skygcs.ext.companions.order_book import MAX_NUMBER
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, Result

RunId = Annotated[str, Field(min_length=1, max_length=32)]
Number = Annotated[int, Field(ge=1, le=MAX_NUMBER)]


Order = (
    Literal["engage", "hand_over", "taken_over", "keep", "release", "goto"]
    | Literal["gains", "record", "origin", "pieces", "start", "clock"]
)


class ContactParams(MethodParams):
    ground: RunId = Field(description="The run of the ground's daemon: another one begins with new numbers.")
    sysid: int = Field(ge=1, le=255, description="Of the ground's heartbeats, which count as contact, too.")
    compid: int = Field(ge=1, le=255)


class RelayedParams(MethodParams):
    ground: RunId = Field(description="As in companion.contact.")
    session: RunId = Field(description="The run of the companion's daemon, from its report.")
    number: Number = Field(description="Of the order, growing: a number is carried out once, however often it comes.")


class RelayedOrderParams(RelayedParams):
    until_s: float = Field(description="Carried out only if it comes by then, on the companion's clock (clock.read).")
    order: Order
    given: dict[str, Any] = Field(description="Arguments of the order; see docs/explanation/companion-control.md.")


class RelayedSetpointParams(RelayedParams):
    at_s: float = Field(description="When it was given, on the companion's clock: it is moved on from then.")
    valid_s: Annotated[float, Field(ge=0.1, le=5)] = Field(description="From its arrival on; a raw one from at_s on.")
    setpoint: dict[str, Any] = Field(description="Geodetic place and velocities along true ENU, or raw.")


class ControlReport(Result):
    session: str = Field(description="The run of the companion's daemon.")
    now_s: float = Field(description="The companion's clock when this was made.")
    newest: int = Field(description="The newest order that moves the vehicle and was carried out.")
    ground_lost: str = Field(description="idle, watched, finishing, waiting or acted: see companion.ground_lost.")
    origin: dict[str, float] | None = Field(description="The companion's world frame.")
    control: dict[str, Any] | None = Field(description="As control.status; null: its autopilot is not heard.")
    refused: str | None = Field(None, description="Why this ground does not have the companion.")
    flight: int | None = Field(None, description="The number of the order whose trajectory it follows.")
    gains: dict[str, Any] | None = Field(None, description="As control.gains.")
    guard_falls: dict[str, int] | None = Field(None, description="How often its guard fell back, by where to.")
    tracking: dict[str, float | None] | None = Field(None, description="What was measured of its tracking.")


class RelayedAnswer(Result):
    outcome: dict[str, Any] = Field(description="As every order's outcome.")
    report: ControlReport


def companion_contact(context: Context, params: ContactParams) -> JsonObject:
    """The ground's sign of life at a companion; the report of the control there."""
    return _orders(context).contact(params.ground, (params.sysid, params.compid))


async def companion_order(context: Context, params: RelayedOrderParams) -> JsonObject:
    """Carry out one order of the ground about control, once; a number that came before gets its outcome again."""
    return await _orders(context).order(
        params.ground, params.session, params.number, params.until_s, params.order, params.given
    )


def companion_setpoint(context: Context, params: RelayedSetpointParams) -> JsonObject:
    """One setpoint of a stream that the ground relays; the newest number wins."""
    return _orders(context).setpoint(
        params.ground, params.session, params.number, params.at_s, params.valid_s, params.setpoint
    )


def _orders(context: Context) -> GroundOrders:
    orders: GroundOrders = context.services.extensions["companion"].orders
    return orders


METHODS: tuple[Method[Context], ...] = (
    Method("companion.contact", ContactParams, companion_contact, ControlReport, (error_codes.REFUSED,), always=True),
    Method(
        "companion.order",
        RelayedOrderParams,
        companion_order,
        RelayedAnswer,
        (error_codes.REFUSED,),
        outlives_client=True,
        always=True,
        reach="nothing",  # the ground counts it, and each is another one: `GroundOrders` knows repeats by their numbers
    ),
    Method("companion.setpoint", RelayedSetpointParams, companion_setpoint, RelayedAnswer, (error_codes.REFUSED,)),
)
