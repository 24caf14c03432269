"""The outcome of each vehicle while the order is still under way, for a client that asks for it.

A request with the member `REPORT` ("report": true, beside "id") gets notifications with its id before its reply:

    order.begun     at the beginning           params: request, vehicles (the names that will have an outcome); at a
                                               station with several sites once for ours and once for the others
    order.outcome   once for each vehicle      params: request, vehicle, outcome (as in the reply)

The reply is the same as without it, and has every outcome: a notification may be left out for a client that does not
read. A request without the member gets no notification.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol, TypeGuard

JsonObject = dict[str, Any]
RequestId = str | int | float

REPORT = "report"
"""The member of a request that asks for the outcomes as they come."""

BEGUN = "order.begun"
OUTCOME = "order.outcome"


class Notified(Protocol):
    """The client of a request."""

    def notify(self, method: str, params: JsonObject) -> None: ...


class Outcome(Protocol):
    """The outcome of an order for one vehicle."""

    def as_dict(self) -> JsonObject: ...


class OrderReports:
    """The notifications of one request."""

    def __init__(self, client: Notified, request_id: str | float) -> None:
        self._client = client
        self.request_id = request_id

    def begun(self, vehicles: Iterable[str]) -> None:
        """The order goes to these vehicles."""
        self._client.notify(BEGUN, {"request": self.request_id, "vehicles": list(vehicles)})

    def ended(self, vehicle: str, outcome: Outcome) -> None:
        """The order has ended for one vehicle."""
        self.ended_with(vehicle, outcome.as_dict())

    def ended_with(self, vehicle: str, outcome: JsonObject) -> None:
        """`ended` with an outcome as the reply has it."""
        self._client.notify(OUTCOME, {"request": self.request_id, "vehicle": vehicle, "outcome": outcome})


def is_request_id(value: object) -> TypeGuard[RequestId]:
    """True for text or a number."""
    return isinstance(value, str | int | float) and not isinstance(value, bool)


def wants_reports(request: dict[str, Any]) -> str | float | None:
    """The id under which a request asks for reports; None: it does not, or has no id to report under."""
    request_id = request.get("id")
    return request_id if request.get(REPORT) is True and is_request_id(request_id) else None
