"""`skygcs-cli foxglove`: the fleet, live, for Foxglove and Lichtblick. A client of the daemon in a process of its own.

Topics and schemas are those of `tlog export --mcap`: a layout made for a recording shows the live fleet.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cancellation import together
from skygcs.cli.connection import run
from skygcs.cli.options import OptionalTargets
from skygcs.cli.parsing import finite
from skygcs.cli.render import say
from skygcs.core.geo import EnuFrame, Origin
from skygcs.errors import SkygcsError
from skygcs.ext.logs import foxglove_schemas as schemas
from skygcs.ext.logs.foxglove_schemas import SCHEMAS
from skygcs.ext.logs.motion import LEVEL, BatterySample, PoseSample, orientation_of
from skygcs.ext.logs.path import FlownPath
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from foxglove import Channel, Context

PATH_PERIOD_S = 1.0

GROUPS = ("position", "attitude", "battery")

MAX_VEHICLES = 300
"""Vehicles that the daemon keeps at most: each has six channels."""


class LiveFleet:
    """Gives vehicles' states and texts to the channels of a Foxglove server, which are made as they are needed."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._channels: dict[str, Channel] = {}
        self._frame: EnuFrame | None = None
        self._paths: dict[str, FlownPath] = {}
        self._path_at_s: dict[str, float] = {}

    def on_state(self, state: dict[str, Any], unix_ns: int) -> None:
        """One vehicle's state, as `vehicles.get` answers it."""
        name, position, attitude = state["name"], state.get("position"), state.get("attitude")
        if name not in self._paths and len(self._paths) >= MAX_VEHICLES:
            return
        path = self._paths.setdefault(name, FlownPath())
        if battery := state.get("battery"):
            sample = BatterySample((0, 0), battery["volts"], battery["amps"], battery["percent"])
            self._put(f"/{name}/battery", "vehicle.Battery", schemas.battery_json(unix_ns, sample), unix_ns)
        if position is None or position["lat_deg"] is None or position["alt_amsl_m"] is None:
            return
        place = position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]
        if self._frame is None:
            self._frame = EnuFrame(Origin(*place))
        turned = LEVEL
        if attitude is not None:
            turned = orientation_of(attitude["roll_deg"], attitude["pitch_deg"], attitude["yaw_deg"])
        east, north, up = position["vel_enu_mps"]
        pose = PoseSample((0, 0), *place, self._frame.from_geodetic(*place), (east, north, up), turned, True)
        at = pose.pos_enu_m
        self._put(f"/{name}/pose", "foxglove.PoseInFrame", schemas.pose_in_frame(unix_ns, at, turned), unix_ns)
        self._put("/tf", "foxglove.FrameTransforms", schemas.frame_transforms(unix_ns, name, at, turned), unix_ns)
        self._put(f"/{name}/location", "foxglove.LocationFix", schemas.location_fix(unix_ns, name, *place), unix_ns)
        self._put(f"/{name}/velocity", "vehicle.Velocity", schemas.velocity_json(unix_ns, pose), unix_ns)
        path.add(at, schemas.encoded(schemas.pose_json(at, turned)))
        if unix_ns / 1e9 - self._path_at_s.get(name, 0.0) >= PATH_PERIOD_S:
            self._path_at_s[name] = unix_ns / 1e9
            poses = (pose for _, pose in path.points)
            self._put(f"/{name}/path", "foxglove.PosesInFrame", schemas.poses_in_frame(unix_ns, poses), unix_ns)

    def on_event(self, event: dict[str, Any], unix_ns: int) -> None:
        """An event of the daemon; those of vehicles go to their log, all others to /log."""
        name = event["vehicle"] or "skygcs"
        severity = event["data"].get("level", 4 if event["kind"] == "warning" else 6)
        text = event["text"] if event["kind"] == "statustext" else f"{event['kind']}: {event['text']}"
        topic = f"/{name}/log" if name in self._paths else "/log"
        level = severity if isinstance(severity, int) else 6
        self._put(topic, "foxglove.Log", schemas.log_message(unix_ns, name, level, text), unix_ns)

    def _put(self, topic: str, schema: str, message: dict[str, Any] | str, unix_ns: int) -> None:
        import json

        from foxglove import Channel, Schema

        channel = self._channels.get(topic)
        if channel is None:
            described = Schema(name=schema, encoding="jsonschema", data=json.dumps(SCHEMAS[schema]).encode())
            channel = Channel(topic, schema=described, message_encoding="json", context=self._context)
            self._channels[topic] = channel
        text = message if isinstance(message, str) else schemas.encoded(message)
        channel.log(text.encode(), log_time=unix_ns)


async def serve(gcs: Client, targets: str, host: str, port: int, rate_hz: float, on_ready: Any = None) -> None:
    """Serve until cancelled, or until the daemon ends. Raises SkygcsError."""
    try:
        import foxglove
    except ImportError:
        raise SkygcsError("this needs foxglove-sdk: pip install 'skygcs[foxglove]'") from None
    context = foxglove.Context()
    try:
        server = foxglove.start_server(name="skygcs", host=host, port=port, context=context, capabilities=[])
    except (OSError, RuntimeError) as error:
        raise SkygcsError(f"cannot listen on {host}:{port}: {error}") from None
    live = LiveFleet(context)
    try:
        if on_ready is not None:
            on_ready(server.port)
        await together(states=_states(gcs, live, targets, rate_hz), events=_events(gcs, live, targets))
    finally:
        server.stop()


async def _states(gcs: Client, live: LiveFleet, targets: str, rate_hz: float) -> None:
    async for state in gcs.telemetry(targets, rate_hz=rate_hz, groups=GROUPS):
        live.on_state(state, time.time_ns())


async def _events(gcs: Client, live: LiveFleet, targets: str) -> None:
    async for event in gcs.events(targets):
        live.on_event(event, time.time_ns())


def foxglove(
    targets: OptionalTargets = "all",
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="Others can then see the fleet.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", metavar="PORT", min=0, max=65535)] = 8765,
    rate_hz: Annotated[float, typer.Option("--rate", metavar="HZ", parser=finite, help="Up to 20.")] = 5.0,
) -> None:
    """Show the fleet live in Foxglove or Lichtblick: open connection, Foxglove WebSocket, ws://localhost:8765.

    Poses, paths, map positions, batteries, texts and events; nothing can be ordered over it. Ctrl-C ends it.

    Example: skygcs-cli foxglove all --port 8765
    """
    if not 0 < rate_hz <= 20:
        raise typer.BadParameter("--rate: more than 0 and at most 20")

    def ready(bound: int) -> None:
        say(f"ws://{host}:{bound}", err=True)

    async def command(gcs: Client) -> None:
        await serve(gcs, targets, host, port, rate_hz, ready)

    run(command)


def add_to(app: typer.Typer) -> None:
    app.command()(foxglove)
