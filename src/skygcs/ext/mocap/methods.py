"""mocap.status: the capture system, and the poses of each vehicle."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams, Result


class PoseRejections(Result):
    """Frames whose pose was not sent, by reason."""

    occluded: int = Field(description="The body was not seen.")
    old: int = Field(description="Older than max_age_s, or than the pose before.")
    repeated: int = Field(description="Bit for bit the pose before.")
    searching: int = Field(description="The body was found again and was not steady yet.")
    out_of_reach: int = Field(description="Found again too far away, while the vehicle was armed.")
    jump: int = Field(description="Farther from the pose before than motion explains.")


class PoseState(Result):
    """The poses of one vehicle."""

    vehicle: str
    link: str | None = Field(description="Where its poses go; null: nowhere, see problem.")
    body: str
    tracking: bool
    problem: str | None = Field(description="Why it cannot fly by its poses now; null: it can.")
    age_s: float | None = Field(description="Of the last good pose; null: none has come.")
    rate_hz: float = Field(description="Good poses that come.")
    sent_hz: float
    sent: int
    limit_hz: float = Field(description="The rate that the fleet file and its link allow.")
    latency_p50_s: float | None = Field(description="From the capture process to here, over 5 s.")
    latency_max_s: float | None
    dropouts: int = Field(description="Times the body was lost.")
    longest_dropout_s: float
    reset_counter: int
    rejected: PoseRejections


class MocapStatus(Result):
    type: str
    state: Literal["waiting", "connecting", "connected", "failed", "ended"]
    text: str
    pid: int | None = Field(description="Of the capture process.")
    restarts: int
    bad_lines: int = Field(description="Lines of the capture process that were not understood.")
    skipped_lines: int = Field(description="Lines that were not taken, as newer frames had come.")
    message: str
    rate_hz: float
    frames: int
    bad_times: int = Field(description="Frames with a time in the future, which were dropped.")
    timesync_answers: int = Field(description="Requests for our clock by PX4s that were answered.")
    bodies_seen: dict[str, float] = Field(description="Rigid bodies that were seen, and for how long not any more.")
    vehicles: list[PoseState]


def mocap_status(context: Context, _: NoParams) -> JsonObject:
    """The motion capture system, and the poses of each vehicle."""
    answer: JsonObject = context.services.extensions["mocap"].feed.status()
    return answer


METHODS: tuple[Method[Context], ...] = (
    Method("mocap.status", NoParams, mocap_status, MocapStatus, while_stopping=True),
)
