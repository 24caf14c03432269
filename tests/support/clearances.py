"""Clearances of the outgoing gate for tests of what lies below it: a hub, a command client."""

from __future__ import annotations

from skygcs.core.vehicle import gate
from skygcs.core.vehicle.gate import Clearance


def cleared(order: str) -> Clearance:
    """That of an order, as if its checks had passed."""
    return gate._row_clearance(order)
