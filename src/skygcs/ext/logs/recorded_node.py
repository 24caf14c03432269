"""Topics that a live node of ROS would have published of a log's vehicles: names, types and messages of `core.ros`.

the live node                                   here
------------------------------------------      ----------------------------------------------------------
a vehicle is met by its first heartbeat         the same; its first heartbeat is published as well
a vehicle is lost, as the daemon finds          DEFAULT_LOST_S after its last own heartbeat
the fleet's origin                              as it is given, else the first estimator's origin in the log
/diagnostics each second                        the same: connections, not what nodes sent
what a reader gets that comes later             the newest before the selected time, at its beginning
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from skygcs.core.geo import Origin, is_no_place
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import DEFAULT_LOST_S, HeartbeatChecks, heartbeat_fields
from skygcs.core.mavlink.modes import SAFETY_ARMED, family, mode_name
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.ros.condition import disconnected, log_entry
from skygcs.core.ros.interfaces import InterfaceError, Interfaces
from skygcs.core.ros.memory import FrameNames, Sample, VehicleMemory
from skygcs.core.ros.px4_telemetry import PX4_SOURCES, PX4_TELEMETRY, Px4Memory, px4_samples, versioned
from skygcs.core.ros.ros_names import ros_name, vehicle_root
from skygcs.core.ros.shared_topics import SHARED, connection_status, map_transform, mavlink_frames, pose_transform
from skygcs.core.ros.stamps import header
from skygcs.core.ros.topics import LATCHED, SOURCES, TELEMETRY, Topic, samples
from skygcs.tlog.format import LogEntry
from skygcs.tlog.selection import Selection

RADIO = "RADIO_STATUS"
ORIGIN = "GPS_GLOBAL_ORIGIN"

MOST_VEHICLES = 250
"""The live node has as many."""

DIAGNOSE_S = 1.0

FAULTS = (InterfaceError, KeyError, TypeError, ValueError, OverflowError)
"""Raised for fields that are not those of the message in the common dialect."""

Key = tuple[int, int]
"""System and component."""

Write = Callable[[str, Topic, int, Mapping[str, Any]], None]
"""``(complete name, topic, time in nanoseconds since 1970, fields)``. Raises InterfaceError."""


class Naming(NamedTuple):
    """Keys of [ros] in the fleet file that say how topics and frames are called."""

    root: str = "/{name}"
    frame_prefix: str = "{name}/"
    geoid_m: float | None = None
    px4_msgs: str = "none"


class Wanted(NamedTuple):
    """Selection of what is written.

    ``names``: of vehicles by system id. ``origin``: of the fleet's frame. ``frames``: also each frame as
    mavros_msgs/Mavlink.
    """

    selection: Selection = Selection()
    names: Mapping[int, str] = {}
    naming: Naming = Naming()
    origin: Origin | None = None
    frames: bool = False


@dataclass(slots=True)
class RecordedVehicle:
    """One vehicle and the memory of its converters."""

    key: Key
    root: str
    memory: VehicleMemory
    px4: Px4Memory | None = None
    connected: bool = False
    heard_s: float = 0.0
    heard_ns: int = 0
    """Its last own heartbeat: on the log's clock, and since 1970."""
    mode: str = ""
    armed: bool = False
    transform: dict[str, Any] | None = None
    """From the fleet's frame to its own."""
    mavlink_frames: list[dict[str, Any]] = field(default_factory=list)

    @property
    def mavros(self) -> str:
        """Namespace of its topics."""
        return f"{self.root}/mavros"


class RecordedNode:
    """`on_entry` with every entry of a log in order, also with those before the selected time: vehicles and values
    that others need are found there."""

    def __init__(self, write: Write, known: Interfaces, wanted: Wanted) -> None:
        self.vehicles: dict[Key, RecordedVehicle] = {}
        self.refused: dict[Key, str] = {}
        """Vehicles without topics, and why."""
        self.faults = 0
        """Messages that could not be converted."""
        self._put = write
        self._known = known
        self._selection = wanted.selection
        self._names, self._naming = wanted.names, wanted.naming
        self._origin = wanted.origin
        self._heartbeats = HeartbeatChecks()
        self._began = False
        """True from the first entry of the selected time on."""
        self._kept: dict[str, tuple[Topic, Mapping[str, Any]]] = {}
        """Newest messages before it, of topics whose later readers get them."""
        self._timed = self._chosen = False
        """True while an entry is handled of the selected time, or of a vehicle and a message that are selected."""
        self._diagnosed_s = -math.inf

    def on_entry(self, entry: LogEntry) -> None:
        """Write what was published when this came."""
        frame, unix_ns = entry.frame, entry.unix_ns()
        if frame is None or frame.info is None or unix_ns is None:
            return
        self._timed = self._selection.in_time(entry)
        if self._timed and not self._began:
            self._begin(unix_ns)
        try:
            if entry.at_s - self._diagnosed_s >= DIAGNOSE_S:
                self._diagnosed_s = entry.at_s
                self._each_second(entry.at_s, unix_ns)
            if self._heartbeats.own(frame, entry.at_s):
                self._on_own_heartbeat(frame, entry.at_s, unix_ns)
        except FAULTS:  # a time near the last that ROS can write
            self.faults += 1
        name = frame.info.name
        if name not in SOURCES and name not in PX4_SOURCES:
            return
        fields: dict[str, Any] | None = None
        for vehicle in self._readers(frame, name):
            self._chosen = self._chooses(frame.msgid, vehicle.key)
            fields = fields or _numbers(frame.fields())
            try:
                self._on_message(vehicle, name, fields, unix_ns)
            except FAULTS:
                self.faults += 1

    def _readers(self, frame: Frame, name: str) -> list[RecordedVehicle]:
        """The vehicles of which this message is: the ground's radio is every vehicle's."""
        if name == RADIO:
            return list(self.vehicles.values())
        vehicle = self.vehicles.get((frame.sysid, frame.compid))
        return [] if vehicle is None else [vehicle]

    def _on_message(self, vehicle: RecordedVehicle, name: str, fields: dict[str, Any], unix_ns: int) -> None:
        """Raises FAULTS."""
        for sample in samples(name, fields, unix_ns, vehicle.memory):
            self._publish(vehicle, sample, unix_ns)
        if name == "STATUSTEXT":
            logger = vehicle.mavros.strip("/").replace("/", ".")
            text = log_entry(logger, fields["severity"], f"FCU: {fields['text']}", unix_ns)
            self._write("/rosout", SHARED["/rosout"], unix_ns, text)
        elif name == ORIGIN:
            self._on_origin(vehicle, fields, unix_ns)
        if vehicle.px4 is not None:
            for sample in px4_samples(name, fields, unix_ns, vehicle.px4):
                type_ = PX4_TELEMETRY[sample.topic]
                topic = f"{vehicle.root}/fmu/out/{versioned(self._known, sample.topic, type_)}"
                self._write(topic, Topic(type_, "px4"), unix_ns, self._known.only_known(type_, sample.fields))

    def _publish(self, vehicle: RecordedVehicle, sample: Sample, unix_ns: int) -> None:
        self._write(f"{vehicle.mavros}/{sample.topic}", TELEMETRY[sample.topic], unix_ns, sample.fields)
        if sample.topic == "local_position/pose" and self._naming.frame_prefix:
            transform = pose_transform(sample.fields, vehicle.memory.frames.base_link)
            self._write("/tf", SHARED["/tf"], unix_ns, {"transforms": [transform]})

    # -- vehicles

    def _on_own_heartbeat(self, frame: Frame, at_s: float, unix_ns: int) -> None:
        vehicle = self.vehicles.get((frame.sysid, frame.compid)) or self._add(frame, unix_ns)
        if vehicle is None:
            return
        if at_s - vehicle.heard_s > DEFAULT_LOST_S:
            self._lose(vehicle)
        custom_mode, kind, autopilot, base_mode = heartbeat_fields(frame)
        if self._naming.px4_msgs != "none" and vehicle.px4 is None and family(autopilot) == "px4":
            vehicle.px4 = Px4Memory(frame.sysid)
        vehicle.connected, vehicle.heard_s, vehicle.heard_ns = True, at_s, unix_ns
        vehicle.mode = mode_name(autopilot, kind, base_mode, custom_mode)
        vehicle.armed = bool(base_mode & SAFETY_ARMED)

    def _add(self, frame: Frame, unix_ns: int) -> RecordedVehicle | None:
        key = frame.sysid, frame.compid
        if key in self.refused or len(self.vehicles) >= MOST_VEHICLES:
            return None
        name = self._names.get(frame.sysid, f"v{frame.sysid}")
        if any(sysid == frame.sysid for sysid, _ in self.vehicles):
            name = f"{name}-{frame.compid}"
        root = vehicle_root(self._naming.root, name, frame.sysid)
        taken = [vehicle.key for vehicle in self.vehicles.values() if vehicle.root == root]
        if taken:
            self.refused[key] = f"{root} are the topics of {'/'.join(map(str, taken[0]))}"
            return None
        prefix = self._naming.frame_prefix.format(name=ros_name(name), sysid=frame.sysid)
        memory = VehicleMemory(FrameNames(f"{prefix}map", f"{prefix}base_link"), self._naming.geoid_m)
        vehicle = self.vehicles[key] = RecordedVehicle(key, root, memory)
        self._chosen = self._chooses(HEARTBEAT, key)
        self._publish(vehicle, disconnected(unix_ns), unix_ns)
        if prefix:
            vehicle.mavlink_frames = mavlink_frames(memory.frames, unix_ns)
            self._chosen = self._selection.has(*key) and not self._selection.messages  # they are made of no message
            self._fix_transforms(unix_ns)
        return vehicle

    def _lose(self, vehicle: RecordedVehicle) -> None:
        if not vehicle.connected:
            return
        vehicle.connected = False
        vehicle.memory = vehicle.memory.after_loss()
        if vehicle.px4 is not None:
            vehicle.px4 = vehicle.px4.after_loss()
        lost_ns = vehicle.heard_ns + round(DEFAULT_LOST_S * 1e9)
        self._chosen = self._chooses(HEARTBEAT, vehicle.key)
        self._publish(vehicle, disconnected(lost_ns), lost_ns)

    # -- the fleet

    def _on_origin(self, vehicle: RecordedVehicle, fields: Mapping[str, Any], unix_ns: int) -> None:
        lat, lon = fields["latitude"], fields["longitude"]
        if is_no_place(lat, lon) or not self._naming.frame_prefix:
            return
        place = {"lat_deg": lat / 1e7, "lon_deg": lon / 1e7, "alt_amsl_m": fields["altitude"] / 1000}
        if self._origin is None:
            self._origin = Origin(**place)
        before = vehicle.transform
        made = map_transform(place, self._origin, vehicle.memory.frames.map, unix_ns)
        if before is None or before["transform"] != made["transform"]:
            vehicle.transform = made
            self._fix_transforms(unix_ns)

    def _fix_transforms(self, unix_ns: int) -> None:
        """Write all transforms that stay, as the live node does when one is added."""
        known = [
            transform
            for one in self.vehicles.values()
            if self._selection.has(*one.key)
            for transform in (*([one.transform] if one.transform else []), *one.mavlink_frames)
        ]
        self._write("/tf_static", SHARED["/tf_static"], unix_ns, {"transforms": known})

    def _each_second(self, at_s: float, unix_ns: int) -> None:
        """Find lost vehicles, and write the state of all."""
        for vehicle in self.vehicles.values():
            if at_s - vehicle.heard_s > DEFAULT_LOST_S:
                self._lose(vehicle)
        shown = [vehicle for key, vehicle in self.vehicles.items() if self._selection.has(*key)]
        self._chosen = bool(shown) and not self._selection.messages
        status = [connection_status(v.mavros, v.connected, v.mode, v.armed) for v in shown]
        self._write("/diagnostics", SHARED["/diagnostics"], unix_ns, {"header": header(unix_ns), "status": status})

    # -- what is selected

    def _begin(self, unix_ns: int) -> None:
        """The selected time begins: what a reader that comes then gets first."""
        self._began = True
        for name, (topic, fields) in self._kept.items():
            try:
                self._put(name, topic, unix_ns, fields)
            except FAULTS:
                self.faults += 1
        self._kept.clear()

    def _chooses(self, msgid: int, vehicle: Key) -> bool:
        """True for a message and a vehicle that are selected."""
        chosen = self._selection
        named = not chosen.messages or msgid in chosen.messages
        return named and msgid not in chosen.without and chosen.has(*vehicle)

    def _write(self, name: str, topic: Topic, unix_ns: int, fields: Mapping[str, Any]) -> None:
        if self._chosen and self._timed:
            self._put(name, topic, unix_ns, fields)
        elif (
            self._chosen
            and not self._began
            and (topic.quality in LATCHED or topic.quality == "px4")
            and name != "/rosout"
        ):
            self._kept[name] = topic, fields


def _numbers(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields as the live node gets them: JSON has no infinity, which comes there as a number that is unknown."""
    return {
        name: [_finite(one) for one in value] if isinstance(value, list) else _finite(value)
        for name, value in fields.items()
    }


def _finite(value: Any) -> Any:
    return math.nan if isinstance(value, float) and math.isinf(value) else value
