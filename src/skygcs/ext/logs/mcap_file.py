"""Write a log as MCAP: poses, paths, map positions, batteries and texts for Foxglove and Lichtblick, and every message.

Each good frame of a known message is one JSON message of the topic /mavlink/SYSID.COMPID/NAME, so that counts are the
log's. mcap is an extra (`skygcs[foxglove]`).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.errors import SkygcsError
from skygcs.ext.logs import foxglove_schemas as schemas
from skygcs.ext.logs.foxglove_schemas import SCHEMAS, Json
from skygcs.ext.logs.motion import BatterySample, Motion, PoseSample, Sample, TextSample
from skygcs.ext.logs.path import FlownPath
from skygcs.tlog.files import Outputs, opened_log
from skygcs.tlog.selection import Selection

if TYPE_CHECKING:
    from mcap.writer import Writer

PATH_PERIOD_NS = 1_000_000_000
"""A path is written whole each time."""

MOST_CHANNELS = 65_535
"""MCAP's channel ids have 16 bits; a log with more topics (sources times messages) is an attack."""

NamesOf = Mapping[int, str]
"""Names of vehicles by system id."""


def write_mcap(
    path: Path, output: Path, selection: Selection, names: NamesOf, origin: Origin | None, dialect: Dialect, force: bool
) -> list[str]:
    """Write ``output``; returns a line about it. Raises SkygcsError."""
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError:
        raise SkygcsError("MCAP needs the library mcap: pip install 'skygcs[foxglove]'") from None
    with opened_log(path, dialect) as log, Outputs(force) as outputs:
        log.check_times(selection)
        file = outputs.open_bytes(output)
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="skygcs")
        export = McapExport(writer, names, Motion(dialect, origin))
        for entry in log.entries():
            unix_ns = entry.unix_ns()
            samples = export.motion.samples(entry)  # vehicles are found before the selected time, too
            if not selection.takes(entry) or unix_ns is None:
                for _ in samples:
                    pass
                continue
            for sample in samples:
                export.write_sample(sample, unix_ns)
            if entry.frame is not None and entry.frame.info is not None:
                export.write_message(entry.frame, entry.frame.info, unix_ns)
        export.write_origin()
        writer.finish()  # type: ignore[no-untyped-call]
        if not export.messages:
            raise SkygcsError(f"{path}: no message in it; `tlog info` shows what it holds")
        log.print_faults()
    counts = ", ".join(f"{count:,} {kind}" for kind, count in sorted(export.counts.items()))
    return [f"{output}: {export.messages:,} messages{f'; {counts}' if counts else ''}"]


class McapExport:
    """Writes samples and messages; makes channels and schemas as they are needed."""

    def __init__(self, writer: Writer, names: NamesOf, motion: Motion) -> None:
        self.motion = motion
        self.messages = 0
        self.counts: Counter[str] = Counter()
        self._writer = writer
        self._names = names
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._paths: dict[tuple[int, int], FlownPath] = {}
        self._path_written_ns: dict[tuple[int, int], int] = {}

    def write_message(self, frame: Frame, info: MessageInfo, unix_ns: int) -> None:
        topic = f"/mavlink/{frame.sysid}.{frame.compid}/{info.name}"
        name = f"mavlink.{info.name}"
        self.messages += self._write(
            topic, name, lambda: schemas.message_schema(info), schemas.message_json(frame, info), unix_ns
        )

    def write_sample(self, sample: Sample, unix_ns: int) -> None:
        name = self._name(sample.vehicle)
        match sample:
            case PoseSample():
                self._write_pose(sample, name, unix_ns)
            case BatterySample():
                self._put(f"/{name}/battery", "vehicle.Battery", schemas.battery_json(unix_ns, sample), unix_ns)
            case TextSample():
                text = schemas.log_message(unix_ns, name, sample.severity, sample.text)
                self._put(f"/{name}/log", "foxglove.Log", text, unix_ns)
                self.counts["texts"] += 1

    def write_origin(self) -> None:
        """Where (0, 0, 0) of the map is."""
        origin = self.motion.origin
        if origin is not None:
            place = {"lat_deg": origin.lat_deg, "lon_deg": origin.lon_deg, "alt_amsl_m": origin.alt_amsl_m}
            self._writer.add_metadata("origin", {key: repr(value) for key, value in place.items()})

    def _write_pose(self, pose: PoseSample, name: str, unix_ns: int) -> None:
        place, orientation = pose.pos_enu_m, pose.orientation
        in_frame = schemas.pose_in_frame(unix_ns, place, orientation)
        self._put(f"/{name}/pose", "foxglove.PoseInFrame", in_frame, unix_ns)
        transforms = schemas.frame_transforms(unix_ns, name, place, orientation)
        self._put("/tf", "foxglove.FrameTransforms", transforms, unix_ns)
        self._put(f"/{name}/velocity", "vehicle.Velocity", schemas.velocity_json(unix_ns, pose), unix_ns)
        self.counts["poses"] += 1
        if pose.fix:
            fix = schemas.location_fix(unix_ns, name, pose.lat_deg, pose.lon_deg, pose.alt_amsl_m)
            self._put(f"/{name}/location", "foxglove.LocationFix", fix, unix_ns)
        path = self._paths.setdefault(pose.vehicle, FlownPath())
        path.add(place, schemas.encoded(in_frame["pose"]))
        if unix_ns - self._path_written_ns.get(pose.vehicle, -PATH_PERIOD_NS) >= PATH_PERIOD_NS:
            self._path_written_ns[pose.vehicle] = unix_ns
            poses = (pose for _, pose in path.points)
            self._put(f"/{name}/path", "foxglove.PosesInFrame", schemas.poses_in_frame(unix_ns, poses), unix_ns)

    def _name(self, vehicle: tuple[int, int]) -> str:
        sysid, compid = vehicle
        name = self._names.get(sysid, f"v{sysid}")
        return name if compid == 1 else f"{name}.{compid}"

    def _put(self, topic: str, schema: str, message: Json | str, unix_ns: int) -> None:
        self._write(topic, schema, lambda: SCHEMAS[schema], message, unix_ns)

    def _write(self, topic: str, schema: str, schema_of: Callable[[], Any], message: Json | str, unix_ns: int) -> bool:
        channel = self._channels.get(topic)
        if channel is None:
            if len(self._channels) >= MOST_CHANNELS:
                return False
            if schema not in self._schemas:
                data = json.dumps(schema_of()).encode()
                self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", data)
            channel = self._writer.register_channel(topic, "json", self._schemas[schema])
            self._channels[topic] = channel
        text = message if isinstance(message, str) else schemas.encoded(message)
        self._writer.add_message(channel, log_time=unix_ns, publish_time=unix_ns, data=text.encode())
        return True
