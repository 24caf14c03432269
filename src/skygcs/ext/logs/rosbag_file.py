"""Write a log as a rosbag2: the topics of the live node of ROS 2 (`recorded_node`), and each frame if it is wanted.

Frames are mavros_msgs/Mavlink of the topic /VEHICLE/mavlink (of their system), so that counts are the log's. rosbags is
an extra (`skygcs[foxglove]`); ROS itself is not needed.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.ros.interfaces import Interfaces, ros2_interfaces
from skygcs.core.ros.ros_names import vehicle_root
from skygcs.core.ros.stamps import header
from skygcs.core.ros.topics import DEPTHS, LATCHED, Quality, Topic
from skygcs.errors import SkygcsError
from skygcs.ext.logs.recorded_node import RecordedNode, Wanted
from skygcs.tlog.files import PART_SUFFIX, note, opened_log
from skygcs.tlog.format import LogEntry

BAG_VERSION: Literal[8] = 8
"""Version of metadata.yaml that ROS 2 Humble to Jazzy read."""

FRAMES = Topic("mavros_msgs/msg/Mavlink", "default")

FOREVER = QosTime(9_223_372_036, 854_775_807)
"""An infinite duration, as rmw writes it."""


def write_rosbag(path: Path, folder: Path, wanted: Wanted, dialect: Dialect) -> list[str]:
    """Write the bag ``folder``, whole or not at all; returns lines about it. Raises SkygcsError."""
    if folder.exists():
        raise SkygcsError(f"{folder}: exists; a bag is a folder of its own: remove it, or name another")
    release: Any = wanted.naming.px4_msgs
    known = ros2_interfaces("1.16" if release == "none" else release)
    part = folder.with_name(folder.name + PART_SUFFIX)
    with opened_log(path, dialect) as log:
        log.check_times(wanted.selection)
        shutil.rmtree(part, ignore_errors=True)
        try:
            # sqlite3, which every ROS 2 reads without further packages; its file has the name of the folder
            with Writer(part / folder.name, version=BAG_VERSION, storage_plugin=StoragePlugin.SQLITE3) as writer:
                bag = Bag(writer, known)
                node = write_topics(log.entries(), bag, wanted)
            if not bag.written:
                raise SkygcsError(f"{path}: no message of a vehicle in it; `tlog info` shows what it holds")
            (part / folder.name).rename(folder)
        except (OSError, sqlite3.Error) as error:
            raise SkygcsError(f"{folder}: {getattr(error, 'strerror', None) or error}") from None
        finally:
            shutil.rmtree(part, ignore_errors=True)
        log.print_faults()
    for key, reason in node.refused.items():
        note(f"{path}: {'/'.join(map(str, key))} has no topics: {reason}")
    if node.faults:
        note(f"{path}: {node.faults:,} messages could not be converted")
    vehicles = len(node.vehicles)
    return [f"{folder}: {bag.written:,} messages of {bag.topics} topics; {vehicles} vehicle{'s'[: vehicles != 1]}"]


def write_topics(entries: Iterable[LogEntry], bag: Bag, wanted: Wanted) -> RecordedNode:
    """Write everything that these entries lead to."""
    node = RecordedNode(bag.write, bag.known, wanted)
    for entry in entries:
        node.on_entry(entry)
        frame, unix_ns = entry.frame, entry.unix_ns()
        if wanted.frames and frame is not None and unix_ns is not None and wanted.selection.takes(entry):
            bag.write_frame(frame, unix_ns, wanted)
    return node


class Bag:
    """Messages by topic; a topic is in the bag from its first message on."""

    def __init__(self, writer: Writer, known: Interfaces) -> None:
        self.known = known
        self.written = 0
        self._writer = writer
        self._connections: dict[str, Connection] = {}
        self._definitions: dict[str, str] = {}
        """Text of each type."""

    @property
    def topics(self) -> int:
        """Number of topics."""
        return len(self._connections)

    def write(self, name: str, topic: Topic, unix_ns: int, fields: Mapping[str, Any]) -> None:
        """One message. Raises InterfaceError."""
        data = self.known.encode(topic.type, fields)
        connection = self._connections.get(name)
        if connection is None:
            connection = self._connections[name] = self._connected(name, topic)
        self._writer.write(connection, unix_ns, data)
        self.written += 1

    def _connected(self, name: str, topic: Topic) -> Connection:
        text = self._definitions.get(topic.type)
        if text is None:
            text, _ = self.known.store.generate_msgdef(topic.type, ros_version=2)
            self._definitions[topic.type] = text
        return self._writer.add_connection(
            name,
            topic.type,
            msgdef=text,
            rihs01=self.known.type_hash(topic.type),
            offered_qos_profiles=[offered(topic.quality)],
        )

    def write_frame(self, frame: Frame, unix_ns: int, wanted: Wanted) -> None:
        """A frame as mavros_msgs/Mavlink of the vehicle with its system id."""
        if frame.info is None:  # its payload has no end that is known
            return
        raw, payload = frame.raw, frame.payload
        v2 = raw[0] == 0xFD
        end = (10 if v2 else 6) + raw[1]
        padded = payload.ljust(-(-len(payload) // 8) * 8, b"\0")
        fields = {
            "header": header(unix_ns),
            "framing_status": 1,
            "magic": 253 if v2 else 254,
            "len": len(payload),
            "incompat_flags": raw[2] if v2 else 0,
            "compat_flags": raw[3] if v2 else 0,
            "seq": frame.seq,
            "sysid": frame.sysid,
            "compid": frame.compid,
            "msgid": frame.msgid,
            "checksum": int.from_bytes(raw[end : end + 2], "little"),
            "payload64": [int.from_bytes(padded[at : at + 8], "little") for at in range(0, len(padded), 8)],
            "signature": list(raw[end + 2 :]),
        }
        name = wanted.names.get(frame.sysid, f"v{frame.sysid}")
        root = vehicle_root(wanted.naming.root, name, frame.sysid)
        self.write(f"{root}/mavlink", FRAMES, unix_ns, fields)


def offered(quality: Quality) -> Qos:
    """The quality of service that the live node offers, as a bag has it."""
    best_effort, lasting = quality in ("sensor", "px4"), quality in LATCHED or quality == "px4"
    return Qos(
        QosHistory.KEEP_LAST,
        DEPTHS[quality],
        QosReliability.BEST_EFFORT if best_effort else QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if lasting else QosDurability.VOLATILE,
        FOREVER,
        FOREVER,
        QosLiveliness.AUTOMATIC,
        FOREVER,
        False,
    )
