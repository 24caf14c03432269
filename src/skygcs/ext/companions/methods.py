"""The methods of companions: `METHODS` of a daemon that is one, of which the ground has `STATUS`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from skygcs.ext.companions import relayed_control
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams, Result


class ClockDifference(Result):
    """The companion's clocks against ours: add the offset to our time to get the companion's."""

    wall_offset_s: float = Field(description="Of the wall clocks.")
    offset_s: float = Field(description="Of the monotonic clocks.")
    error_s: float = Field(description="Both are right within this: half of the round trip, more with its age.")
    round_trip_s: float
    age_s: float


class CompanionState(Result):
    """The connection to one companion."""

    name: str
    vehicle: str
    state: Literal["connecting", "up", "down"]
    since_s: float
    last_error: str | None = Field(description="The latest reason, also after recovery.")
    failures: int = Field(description="Attempts since it was up last.")
    connected: int = Field(description="Connections so far.")
    version: str | None = Field(description="Of the skygcs that answers there.")
    clock: ClockDifference | None = Field(description="null: nothing was measured in the last minute.")


class MdnsState(Result):
    name: str | None = Field(description="The ground station it sends to.")
    found: list[str] = Field(description="All that are announced.")
    ignored: int = Field(description="Announcements that were of no use or too many.")
    problem: str | None


class DoorState(Result):
    """Where a companion takes orders over TLS."""

    listen: str | None = Field(description="null: it does not, see problem.")
    problem: str | None
    pinned: str | None = Field(description="SHA-256 of the ground's certificate.")
    accepted: int
    refused_by_limit: int = Field(description="Connections beyond the limits.")
    handshakes_failed: int = Field(description="No or a wrong certificate, no TLS, or too slow.")
    wrong_certificate: int = Field(description="One that the pinned certificate has issued.")
    unpinned: int = Field(description="Connections closed as the pinned certificate was removed or replaced.")


class OwnState(Result):
    """This daemon, if it is a companion."""

    vehicle: str
    sysid: int
    compid: int
    ground: str = Field(description="As in the fleet file.")
    ground_peer: str | None = Field(description="Where MAVLink goes now.")
    ground_age_s: float | None = Field(description="Since a frame came from there; null: none has come.")
    mdns: MdnsState | None
    rpc: DoorState | None


class CompanionsStatus(Result):
    companions: list[CompanionState]
    announced: str | None = Field(description="What mDNS announces of this ground station.")
    problem: str | None = Field(description="Why it announces nothing.")
    companion: OwnState | None = Field(description="null: this daemon is not a companion.")


def companions_status(context: Context, _: NoParams) -> JsonObject:
    """The ground's connections to its companions; on a companion, its link to the ground."""
    services = context.services
    table = "companion" if "companion" in services.config.extensions else "companions"
    answer: JsonObject = services.extensions[table].status()
    return answer


STATUS: Method[Context] = Method(
    "companions.status", NoParams, companions_status, CompanionsStatus, while_stopping=True
)
METHODS: tuple[Method[Context], ...] = (*relayed_control.METHODS, STATUS)
