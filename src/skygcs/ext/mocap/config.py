"""[mocap] of the fleet file: poses of a motion capture system for vehicles without GPS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from skygcs.config.models import FleetConfig
from skygcs.config.tables import KeyPath, Model, Problem
from skygcs.ext.mocap.pose import CaptureFrame
from skygcs.ext.mocap.pose_filter import FilterLimits
from skygcs.ext.mocap.pose_messages import LEAST_HZ, PoseMessage
from skygcs.ext.mocap.source import SYSTEMS

MocapType = Literal["vicon", "optitrack", "qualisys", "vrpn", "recorded", "simulated"]

WITH_PORT = ("qualisys", "optitrack")

BodyName = Annotated[str, Field(min_length=1, max_length=128)]
Probability = Annotated[float, Field(ge=0, le=1)]


class SimulatedMocapConfig(Model):
    """[mocap.simulated]: what the cameras of type "simulated" do to the true poses."""

    frames_hz: Annotated[float, Field(ge=1, le=500)] = 100.0
    noise_m: Annotated[float, Field(ge=0, le=1)] = 0.0005
    noise_rad: Annotated[float, Field(ge=0, le=1)] = 0.002
    latency_s: Annotated[float, Field(ge=0, le=2)] = 0.01
    occluded: Probability = 0.0
    """Share of frames in which a body is not seen."""
    repeated: Probability = 0.0
    """Share of frames that repeat the pose before."""
    jumps: Probability = 0.0
    """Share of frames with a pose a metre and more away."""
    seed: int = 1


class MocapConfig(Model):
    """[mocap]: its presence has the daemon read the system, and send poses to the vehicles of ``bodies``."""

    type: MocapType
    host: Annotated[str, Field(min_length=1, max_length=253)] | None = None
    """Address of the computer with the capture software; for vicon, optitrack, qualisys and vrpn."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """If it is not the system's own; for qualisys and optitrack (command port)."""
    file: Path | None = None
    """The recording, for type "recorded"; relative to the fleet file."""
    loop: bool = False
    """Play the recording over and over again."""
    bodies: Annotated[dict[str, BodyName], Field(min_length=1)]
    """The rigid body of each vehicle, by the vehicle's name."""
    up: Literal["z", "y"] = "z"
    """The axis of the capture frame that points up."""
    rotation_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Yaw of the capture frame's x axis, counter-clockwise from the x axis of the fleet's world frame."""
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The capture frame's origin in the fleet's world frame, whose origin is [origin]."""
    message: PoseMessage = "vision_position_estimate"
    rate_hz: Annotated[float, Field(ge=LEAST_HZ, le=200)] = 30.0
    """Poses a second to each vehicle; fewer where a radio carries fewer."""
    latency_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """From the exposure of the cameras to the arrival of the frame here; the time stamp is set back by it."""
    max_age_s: Annotated[float, Field(ge=0.05, le=1)] = 0.2
    """Older poses are not sent; a body without a good pose for so long is lost."""
    max_jump_m: Annotated[float, Field(gt=0, le=10)] = 0.3
    """A pose farther than this from the last one, beyond what motion explains, is not sent."""
    max_jump_rad: Annotated[float, Field(gt=0, le=math.pi)] = 0.5
    set_origin: bool = True
    """Send [origin] once to a disarmed vehicle whose estimator reports none."""
    simulated: SimulatedMocapConfig | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.type in SYSTEMS and self.host is None:
            raise ValueError(f"host is missing: type {self.type} needs the address of the capture software")
        if self.type not in SYSTEMS and self.host is not None:
            raise ValueError(f'host has no meaning for type "{self.type}"')
        if self.port is not None and self.type not in WITH_PORT:
            raise ValueError(f'port has no meaning for type "{self.type}"')
        if (self.type == "recorded") != (self.file is not None):
            raise ValueError('file is for type "recorded", which needs it')
        if self.simulated is not None and self.type != "simulated":
            raise ValueError('simulated is for type "simulated"')
        return self

    def frame(self) -> CaptureFrame:
        """The same as `pose.CaptureFrame`."""
        return CaptureFrame(self.up, math.radians(self.rotation_deg), self.offset_m)

    def limits(self) -> FilterLimits:
        """The same as `pose_filter.FilterLimits`."""
        return FilterLimits(self.max_jump_m, self.max_jump_rad, self.max_age_s)


def mocap_problems(mocap: MocapConfig, fleet: FleetConfig) -> list[Problem]:
    """Everything that contradicts the rest of the fleet file."""
    problems: list[Problem] = []
    at: KeyPath = ("mocap", "bodies")
    owner: dict[str, str] = {}
    for vehicle, body in mocap.bodies.items():
        if vehicle not in fleet.vehicles:
            known = ", ".join(sorted(fleet.vehicles)) or "none"
            problems.append(Problem((*at, vehicle), f"is not a vehicle of this file; vehicles: {known}"))
        if body in owner:
            problems.append(Problem((*at, vehicle), f'rigid body "{body}" is that of {owner[body]} already'))
        owner.setdefault(body, vehicle)
    if fleet.origin is None:
        text = "needs a table [origin]: the place on earth of the world frame, which vehicles without GPS are given"
        problems.append(Problem(("mocap",), text))
    simulated = any(link.enabled and link.type == "simulated" for link in fleet.links.values())
    if mocap.type == "simulated" and not simulated:
        problems.append(Problem(("mocap", "type"), 'is "simulated", and the file has no link of type "simulated"'))
    if not fleet.daemon.keep_vehicles:
        problems.append(Problem(("mocap",), "needs vehicles to send poses to: set daemon.keep_vehicles = true"))
    return problems
