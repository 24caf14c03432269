"""[ros] of the fleet file: where ROS is, what vehicles are called there, and what nodes may do."""

from __future__ import annotations

import ipaddress
import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from skygcs.config.tables import Model, Problem
from skygcs.core.ros.ros_names import ROOT_FIELDS, vehicle_root

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig

MESSAGE_NAME = re.compile(r"[A-Z][A-Z0-9_]*")


class RosConfig(Model):
    """[ros]: its presence has `skygcs run` start the process."""

    root: Annotated[str, Field(min_length=2, max_length=80)] = "/{name}"
    """Before the names of a vehicle: /alpha/mavros/state. With {name} or {sysid}."""
    version: Literal[1, 2] = 2
    """ROS 2, or ROS 1 by rospy of the system's Python."""
    master: Annotated[str, Field(min_length=1, max_length=253, pattern=r"^https?://[^\s]+$")] | None = None
    """Address of ROS 1's master; None: ROS_MASTER_URI of the environment, else http://localhost:11311."""
    domain: Annotated[int, Field(ge=0, le=232)] | None = None
    """None: ROS_DOMAIN_ID of the environment, else 0."""
    network: Literal["localhost", "lan"] = "localhost"
    """Programs that may read, and with ``commands`` fly: those on this computer, or those on its networks."""
    peers: tuple[Annotated[str, Field(min_length=1, max_length=253)], ...] = ()
    """Addresses that are asked instead of multicast, which many a Wi-Fi does not carry."""
    commands: Literal["none", "setpoints", "all"] = "none"
    """none: nodes only read. setpoints: also setpoints for vehicles that a person has engaged (control set). all: also
    services and actions, OFFBOARD and GUIDED by set_mode among them."""
    rates: dict[str, Annotated[float, Field(gt=0, le=200)]] = Field(default_factory=dict, max_length=40)
    """Rate in Hz of a MAVLink message that is requested while a topic made of it has a reader."""
    frame_prefix: Annotated[str, Field(max_length=80)] = "{name}/"
    """Before the frames map and base_link in headers; "": plain, as one MAVROS has them, and then without TF."""
    geoid_m: Annotated[float, Field(ge=-150, le=150)] | None = None
    """Height of the geoid above the ellipsoid here; None: as each receiver reports it."""
    px4_msgs: Literal["none", "1.14", "1.15", "1.16", "1.17", "1.18"] = "none"
    """Release of px4_msgs for the topics /alpha/fmu/…; none: no such topics."""

    @model_validator(mode="after")
    def _named(self) -> Self:
        try:
            one, other = (vehicle_root(self.root, f"v{n}", n) for n in (1, 2))
        except ValueError as error:
            raise ValueError(f"root {error}") from None
        if one == other:
            raise ValueError(f"root {self.root!r}: two vehicles would have one name; put {ROOT_FIELDS} in it")
        try:
            frame = self.frame_prefix.format(name="v", sysid=1)
        except (KeyError, IndexError, ValueError, AttributeError):
            frame = " "
        if re.fullmatch(r"[A-Za-z0-9_/]*", frame) is None:
            raise ValueError(f"frame_prefix {self.frame_prefix!r}: letters, digits, _ and /, with {ROOT_FIELDS}")
        if self.version == 1 and (self.px4_msgs != "none" or self.domain is not None or self.peers):
            raise ValueError("version 1: px4_msgs, domain and peers are of ROS 2")
        if self.version == 2 and self.master is not None:
            raise ValueError("master: only ROS 1 has one; set version = 1")
        for name in self.rates:
            if MESSAGE_NAME.fullmatch(name) is None:
                raise ValueError(f"rates: {name!r} is not a MAVLink message; give its name, as ATTITUDE_QUATERNION")
        for peer in self.peers:
            _check_peer(peer)
        return self


def _check_peer(peer: str) -> None:
    """Raises ValueError for anything but an address: it becomes part of an XML text."""
    try:
        ipaddress.ip_address(peer)
    except ValueError:
        if re.fullmatch(r"[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?", peer) is None:
            raise ValueError(f"peers: {peer!r} is neither an address nor a host name") from None


def ros_problems(config: Any, fleet: FleetConfig) -> list[Problem]:
    """Names of vehicles that would be one name in ROS."""
    seen: dict[str, str] = {}
    problems = []
    for name, vehicle in fleet.vehicles.items():
        root = vehicle_root(config.root, name, vehicle.sysid)
        if root in seen:
            text = f"{seen[root]} and {name} would both be {root}; ROS names have letters, digits and underscores"
            problems.append(Problem(("ros", "root"), text))
        seen[root] = name
    return problems
