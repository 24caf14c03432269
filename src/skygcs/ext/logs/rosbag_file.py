"""Write a log as a rosbag2: poses, paths, fixes, batteries and texts in ROS 2's own messages, and each frame.

Every good frame is one mavros_msgs/Mavlink of the topic /VEHICLE/mavlink (of its system), so that counts are the log's.
rosbags is an extra (`skygcs[foxglove]`); ROS itself is not needed.
"""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.errors import SkygcsError
from skygcs.ext.logs.foxglove_schemas import MAP_FRAME
from skygcs.ext.logs.motion import BatterySample, Motion, PoseSample, Quaternion, Sample, TextSample
from skygcs.ext.logs.path import FlownPath
from skygcs.tlog.files import PART_SUFFIX, opened_log
from skygcs.tlog.selection import Selection

if TYPE_CHECKING:
    from rosbags.rosbag2 import Writer

BAG_VERSION: Literal[8] = 8
"""Version of metadata.yaml that ROS 2 Humble to Jazzy read."""

MAVLINK_MSG = """
uint8 FRAMING_OK = 1
uint8 FRAMING_BAD_CRC = 2
uint8 FRAMING_BAD_SIGNATURE = 3
uint8 MAVLINK_V10 = 254
uint8 MAVLINK_V20 = 253
std_msgs/Header header
uint8 framing_status
uint8 magic
uint8 len
uint8 incompat_flags
uint8 compat_flags
uint8 seq
uint8 sysid
uint8 compid
uint32 msgid
uint16 checksum
uint64[<=33] payload64
uint8[<=13] signature
"""
"""The interface of mavros_msgs/msg/Mavlink, as MAVROS publishes it."""

LOG_LEVELS = (50, 50, 50, 40, 30, 20, 20, 10)
"""rcl_interfaces/Log's level (10 debug to 50 fatal) of each MAV_SEVERITY."""

PATH_PERIOD_NS = 1_000_000_000


def write_rosbag(
    path: Path, folder: Path, selection: Selection, names: Mapping[int, str], origin: Origin | None, dialect: Dialect
) -> list[str]:
    """Write the bag ``folder``, whole or not at all; returns a line about it. Raises SkygcsError."""
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
    except ImportError:
        raise SkygcsError("rosbag2 needs the library rosbags: pip install 'skygcs[foxglove]'") from None
    if folder.exists():
        raise SkygcsError(f"{folder}: exists; a bag is a folder of its own: remove it, or name another")
    part = folder.with_name(folder.name + PART_SUFFIX)
    with opened_log(path, dialect) as log:
        log.check_times(selection)
        shutil.rmtree(part, ignore_errors=True)
        try:
            # sqlite3, which every ROS 2 reads without further packages
            with Writer(part, version=BAG_VERSION, storage_plugin=StoragePlugin.SQLITE3) as writer:
                export = RosbagExport(writer, names, Motion(dialect, origin))
                for entry in log.entries():
                    unix_ns = entry.unix_ns()
                    taken = selection.takes(entry)
                    for sample in export.motion.samples(entry):  # vehicles are found before the selected time, too
                        if taken and unix_ns is not None:
                            export.write_sample(sample, unix_ns)
                    if taken and unix_ns is not None and entry.frame is not None and entry.frame.info is not None:
                        export.write_frame(entry.frame, unix_ns)
            if not export.frames:
                raise SkygcsError(f"{path}: no message in it; `tlog info` shows what it holds")
            part.rename(folder)
        except OSError as error:
            raise SkygcsError(f"{folder}: {error.strerror or error}") from None
        finally:
            shutil.rmtree(part, ignore_errors=True)
        log.print_faults()
    return [f"{folder}: {export.frames:,} frames; {export.counts['poses']:,} poses, {export.counts['texts']:,} texts"]


class RosbagExport:
    """Writes samples and frames in ROS 2 Humble's messages."""

    def __init__(self, writer: Writer, names: Mapping[int, str], motion: Motion) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.motion = motion
        self.frames = 0
        self.counts: Counter[str] = Counter()
        self._writer = writer
        self._names = names
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._store.register(get_types_from_msg(MAVLINK_MSG, "mavros_msgs/msg/Mavlink"))
        self._connections: dict[str, Any] = {}
        self._paths: dict[tuple[int, int], FlownPath] = {}
        self._path_written_ns: dict[tuple[int, int], int] = {}

    def write_frame(self, frame: Frame, unix_ns: int) -> None:
        import numpy as np

        raw, payload = frame.raw, frame.payload
        v2 = raw[0] == 0xFD
        end = (10 if v2 else 6) + raw[1]
        words = np.frombuffer(payload.ljust(-(-len(payload) // 8) * 8, b"\0"), dtype="<u8")
        self._put(
            f"/{self._name((frame.sysid, 1))}/mavlink",
            "mavros_msgs/msg/Mavlink",
            unix_ns,
            header=self._header(unix_ns),
            framing_status=1,
            magic=253 if v2 else 254,
            len=len(payload),
            incompat_flags=raw[2] if v2 else 0,
            compat_flags=raw[3] if v2 else 0,
            seq=frame.seq,
            sysid=frame.sysid,
            compid=frame.compid,
            msgid=frame.msgid,
            checksum=int.from_bytes(raw[end : end + 2], "little"),
            payload64=words,
            signature=np.frombuffer(raw[end + 2 :], dtype=np.uint8),
        )
        self.frames += 1

    def write_sample(self, sample: Sample, unix_ns: int) -> None:
        name = self._name(sample.vehicle)
        match sample:
            case PoseSample():
                self._write_pose(sample, name, unix_ns)
            case BatterySample():
                self._write_battery(sample, name, unix_ns)
            case TextSample():
                self.counts["texts"] += 1
                self._put(
                    "/rosout",
                    "rcl_interfaces/msg/Log",
                    unix_ns,
                    stamp=self._time(unix_ns),
                    level=LOG_LEVELS[min(max(sample.severity, 0), len(LOG_LEVELS) - 1)],
                    name=name,
                    msg=sample.text,
                    file="",
                    function="",
                    line=0,
                )

    def _write_pose(self, sample: PoseSample, name: str, unix_ns: int) -> None:
        import numpy as np

        # pose and velocity in the map frame
        header, pose = self._header(unix_ns, MAP_FRAME), self._pose(sample.pos_enu_m, sample.orientation)
        self.counts["poses"] += 1
        self._put(f"/{name}/pose", "geometry_msgs/msg/PoseStamped", unix_ns, header=header, pose=pose)
        twist = self._make("geometry_msgs/msg/Twist", linear=self._vector(sample.vel_enu_mps), angular=self._vector())
        self._put(f"/{name}/velocity", "geometry_msgs/msg/TwistStamped", unix_ns, header=header, twist=twist)
        # transform from the map to the vehicle
        transform = self._make(
            "geometry_msgs/msg/TransformStamped",
            header=header,
            child_frame_id=name,
            transform=self._make(
                "geometry_msgs/msg/Transform", translation=self._vector(sample.pos_enu_m), rotation=pose.orientation
            ),
        )
        self._put("/tf", "tf2_msgs/msg/TFMessage", unix_ns, transforms=[transform])
        # geodetic position
        self._put(
            f"/{name}/fix",
            "sensor_msgs/msg/NavSatFix",
            unix_ns,
            header=self._header(unix_ns, name),
            status=self._make("sensor_msgs/msg/NavSatStatus", status=0 if sample.fix else -1, service=1),
            latitude=sample.lat_deg,
            longitude=sample.lon_deg,
            altitude=sample.alt_amsl_m,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )
        # path flown so far, at a lower rate
        path = self._paths.setdefault(sample.vehicle, FlownPath())
        path.add(sample.pos_enu_m, sample.orientation)
        if unix_ns - self._path_written_ns.get(sample.vehicle, -PATH_PERIOD_NS) >= PATH_PERIOD_NS:
            self._path_written_ns[sample.vehicle] = unix_ns
            poses = [
                self._make("geometry_msgs/msg/PoseStamped", header=header, pose=self._pose(*point))
                for point in path.points
            ]
            self._put(f"/{name}/path", "nav_msgs/msg/Path", unix_ns, header=header, poses=poses)

    def _write_battery(self, sample: BatterySample, name: str, unix_ns: int) -> None:
        import numpy as np

        nan = float("nan")
        self._put(
            f"/{name}/battery",
            "sensor_msgs/msg/BatteryState",
            unix_ns,
            header=self._header(unix_ns, name),
            voltage=nan if sample.volts is None else sample.volts,
            temperature=nan,
            current=nan if sample.amps is None else -sample.amps,  # negative when discharging
            charge=nan,
            capacity=nan,
            design_capacity=nan,
            percentage=nan if sample.percent is None else sample.percent / 100,
            power_supply_status=0,
            power_supply_health=0,
            power_supply_technology=0,
            present=True,
            cell_voltage=np.zeros(0, dtype=np.float32),
            cell_temperature=np.zeros(0, dtype=np.float32),
            location="",
            serial_number="",
        )

    # -- messages

    def _name(self, vehicle: tuple[int, int]) -> str:
        """A name that ROS takes: letters, digits and underscores, a letter first."""
        sysid, compid = vehicle
        name = self._names.get(sysid, f"v{sysid}") + ("" if compid == 1 else f"_{compid}")
        name = re.sub(r"[^A-Za-z0-9_]", "_", name)
        return name if name[:1].isalpha() else f"v_{name}"

    def _put(self, topic: str, msgtype: str, unix_ns: int, **fields: Any) -> None:
        connection = self._connections.get(topic)
        if connection is None:
            connection = self._writer.add_connection(topic, msgtype, typestore=self._store)
            self._connections[topic] = connection
        data = self._store.serialize_cdr(self._make(msgtype, **fields), msgtype)
        self._writer.write(connection, unix_ns, data)

    def _make(self, msgtype: str, **fields: Any) -> Any:
        return self._store.types[msgtype](**fields)

    def _time(self, unix_ns: int) -> Any:
        return self._make("builtin_interfaces/msg/Time", sec=unix_ns // 10**9, nanosec=unix_ns % 10**9)

    def _header(self, unix_ns: int, frame_id: str = "") -> Any:
        return self._make("std_msgs/msg/Header", stamp=self._time(unix_ns), frame_id=frame_id)

    def _vector(self, vector: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
        return self._make("geometry_msgs/msg/Vector3", **dict(zip("xyz", vector, strict=True)))

    def _pose(self, pos_enu_m: tuple[float, float, float], orientation: Quaternion) -> Any:
        x, y, z, w = orientation
        return self._make(
            "geometry_msgs/msg/Pose",
            position=self._make("geometry_msgs/msg/Point", **dict(zip("xyz", pos_enu_m, strict=True))),
            orientation=self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
