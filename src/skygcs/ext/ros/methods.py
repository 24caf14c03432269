"""ros.status; ros.report, by which the process reports what it measured, and ros.settings, which it reads."""

from __future__ import annotations

from typing import Annotated, Any, Protocol

from pydantic import Field

from skygcs.core.geo import Origin
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result

MOST_TOPICS = 20_000
"""In a report: a hundred vehicles with all their topics have 8,000."""

Text = Annotated[str, Field(max_length=300)]


class RosTopic(MethodParams):
    """A topic or service that somebody uses."""

    name: Text
    readers: int = Field(description="Matched readers; of a setpoint or a service: 0.")
    rate_hz: float = Field(description="Messages that were sent or came, or calls, over the last report.")
    count: int = Field(description="Since the process began.")
    refused: int = Field(description="Messages or calls that were not taken or not sent.")


class RosVehicle(MethodParams):
    """A vehicle in ROS."""

    name: Text
    root: Text
    setpoints: Text = Field(description="What becomes of its setpoints.")
    setpoints_sent: int = Field(description="Setpoints that the daemon took, since the process began.")
    setpoints_refused: int = Field(description="Setpoints that were refused, by the process or by the daemon.")
    commands_rejected: int = Field(description="Commands of vehicle_command that were dropped: too many waited.")


class RosReport(MethodParams):
    """Report that the process sends once in a few seconds."""

    domain: int
    network: Text
    commands: Text
    vehicles: list[RosVehicle] = Field(max_length=1000)
    topics: list[RosTopic] = Field(max_length=MOST_TOPICS)
    rejected: int = Field(description="Samples that were no message of their topic's interface.")


class RosVehicleSettings(Result):
    takeoff_height_m: float
    fence: dict[str, list[float]] = Field(description="x_m, y_m, up_m: the box of flight control about the origin.")


class RosSettings(Result):
    vehicles: dict[str, RosVehicleSettings] = Field(description="By name.")


class RosStatus(Result):
    running: bool
    pid: int | None
    restarts: int
    age_s: float | None = Field(description="Of the report; null: none has come.")
    report: dict[str, Any] | None = Field(description="What the process reported last.")


def ros_report(context: Context, params: RosReport) -> JsonObject:
    """Take what the process of ROS has measured, for ros.status."""
    _extension(context).take(params)
    return {}


def ros_settings(context: Context, params: NoParams) -> JsonObject:
    """Return what the process of ROS needs of the fleet file: take-off height and control fence of each vehicle."""
    about = Origin(0.0, 0.0, 0.0)
    settings = {}
    for actor in context.services.fleet.vehicles.values():
        fence = actor.config.control.fence_at(about)
        box = {"x_m": list(fence.x_m), "y_m": list(fence.y_m), "up_m": list(fence.up_m)}
        settings[actor.name] = {"takeoff_height_m": actor.config.takeoff_height_m, "fence": box}
    return {"vehicles": settings}


def ros_status(context: Context, params: NoParams) -> JsonObject:
    """Vehicles in ROS, and each topic that is read: measured rate, readers, refused messages."""
    ros = _extension(context)
    child = ros.info()
    age_s = None if ros.report is None else context.services.now() - ros.reported_at
    report = None if ros.report is None else ros.report.model_dump()
    return {"age_s": age_s, "report": report, **{name: child[name] for name in ("running", "pid", "restarts")}}


class ReportKeeper(Protocol):
    """The extension, as its methods see it."""

    report: RosReport | None
    reported_at: float

    def take(self, report: RosReport) -> None: ...
    def info(self) -> dict[str, Any]: ...


def _extension(context: Context) -> ReportKeeper:
    keeper: ReportKeeper = context.services.extensions["ros"]
    return keeper


METHODS: tuple[Method[Context], ...] = (
    Method("ros.report", RosReport, ros_report, dict[str, Any]),
    Method("ros.settings", NoParams, ros_settings, RosSettings),
    Method("ros.status", NoParams, ros_status, RosStatus),
)
