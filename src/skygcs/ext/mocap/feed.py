"""Sends the poses of a motion capture system to the vehicles of [mocap], and their own origin to those without one.

A pose is sent on one channel, on which no other vehicle was heard when it began: its message has no target, and every
vehicle that hears it takes it for its own (`ext.mocap.pose_way`). When poses stop, sending stops; the autopilot's own
failsafe acts.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

from skygcs.config.models import OriginConfig
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import TIMESYNC
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.flight_evidence import may_fly
from skygcs.core.vehicle.gate import standing
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.origin import why_no_poses
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.ext.mocap.capture_process import CaptureProcess
from skygcs.ext.mocap.config import MocapConfig
from skygcs.ext.mocap.lost_body import OwnEstimate
from skygcs.ext.mocap.origin_pushes import OriginPushes
from skygcs.ext.mocap.pose import Pose, Vector
from skygcs.ext.mocap.pose_messages import WIRE_BYTES, message_of, rate_that_fits
from skygcs.ext.mocap.pose_stream import PoseStream
from skygcs.ext.mocap.pose_way import PoseWay
from skygcs.ext.mocap.recording import CaptureFrameData
from skygcs.ext.mocap.simulated_capture import SimulatedCapture
from skygcs.links.base import Channel
from skygcs.rpc.context import Services
from skygcs.runtime.preflight_run import Preflight
from skygcs.runtime.vehicle_actor import VehicleActor

POSES = standing("poses")

TICK_S = 0.2

CLOCK_AHEAD_S = 0.01
"""By which a frame's time may be ahead of the loop's, which is taken once a turn; more is another clock."""

LISTEN_S = 3.0
"""A channel is used for poses after it was open for so long: by then every vehicle on it has sent three heartbeats, and
it is known whether there is more than one."""

PRETENDED = frozenset({"simulated", "memory"})
"""Types of links without real vehicles: only there a recording is sent to a vehicle that is armed."""

EAST_DEG = 90.0

ARMING = frozenset({"arm", "takeoff", "mission"})
"""Orders by which a vehicle begins to fly."""

OTHERS_S = 1.0
"""A body that was seen within this time may be the one whose markers are taken for another's."""

MAX_SEEN = 64
"""Names of rigid bodies that are listed beside those of vehicles."""


class Capture(Protocol):
    """`CaptureProcess` or `SimulatedCapture`."""

    async def run(self) -> None: ...
    def tick(self, now: float) -> None: ...
    def close(self) -> None: ...
    def status(self) -> dict[str, Any]: ...


class _Fed:
    """One vehicle of [mocap]: its poses, and where they go."""

    __slots__ = ("actor", "channel", "kept_despite", "name", "rate_hz", "stream", "sysid", "was_problem", "way")

    def __init__(self, name: str, sysid: int, stream: PoseStream) -> None:
        self.name = name
        self.sysid = sysid
        self.stream = stream
        self.actor: VehicleActor | None = None
        self.way = PoseWay()
        self.channel: Channel | None = None
        """Channel over which its poses are sent, by `way`."""
        self.kept_despite: str | None = None
        """Value of ``way.kept_despite`` that was reported last."""
        self.rate_hz = 0.0
        self.was_problem: str | None = None


class MocapFeed:
    """Run `run` in a task, and `tick` every `TICK_S`; `close` when the daemon ends."""

    def __init__(self, core: Services, config: MocapConfig, place: OriginConfig) -> None:
        """``place``: [origin] of the fleet file."""
        self._config = config
        self._hub = hub = core.hub
        self._fleet = core.fleet
        self._loop = loop = asyncio.get_running_loop()
        self._on_event = on_event = core.event_log.publish
        self._origin = Origin(**place.model_dump())
        self._enu = EnuFrame(replace(self._origin, x_heading_deg=EAST_DEG))  # the frame of poses
        self._frame = config.frame()
        self._fed = {
            body: _Fed(name, core.config.vehicles[name].sysid, PoseStream(body, config.limits()))
            for name, body in config.bodies.items()
        }
        by_sysid = {fed.sysid: body for body, fed in self._fed.items()}
        self.capture: Capture
        if config.type == "simulated":
            self.capture = SimulatedCapture(config, by_sysid, self._origin, core.links, loop, self.on_frame)
        else:
            self.capture = CaptureProcess(config, loop, self.on_frame, on_event)
        self._origins = OriginPushes(self._origin, loop, on_event) if config.set_origin else None
        self._seen: dict[str, float] = {}
        self._last_seen: dict[str, Pose] = {}
        """The last pose of each body, in the frame of the capture system."""
        self._open_since: dict[int, float] = {}
        self.frames = 0
        self.bad_times = 0
        self.timesync_answers = 0
        self._timesync = hub.dialect.by_name.get("TIMESYNC")
        if self._timesync is not None:
            keys = {fed.sysid << 8 for fed in self._fed.values()}
            hub.observers.add({TIMESYNC}, keys, self._on_timesync)

    async def run(self) -> None:
        """Work until the task is cancelled, or a recording has ended."""
        try:
            await self.capture.run()
        finally:
            self.capture.close()

    def close(self) -> None:
        """Stop sending."""
        self.capture.close()
        if self._origins is not None:
            self._origins.close()
        for fed in self._fed.values():
            fed.channel = None
            fed.way = PoseWay()

    def order_refusal(self, vehicle: Vehicle, plan: Plan) -> str | None:
        """Why this vehicle must not be armed now: poses of another one, which flies by them, reach it, too. None: it
        may."""
        if plan.order not in ARMING:
            return None
        channels = self._hub.router.channels_of(vehicle.key)
        for fed in self._fed.values():
            if fed.actor is None or fed.channel is None or fed.actor.vehicle.key == vehicle.key:
                continue
            if fed.channel.id in channels and may_fly(fed.actor.vehicle, self._loop.time()):
                return (
                    f"the poses of {fed.name}, which flies, go over its link {fed.channel.link.name}: a pose has no "
                    f"address, and it would take them for its own; land {fed.name} first, or give it a link of its own"
                )
        return None

    # -- frames

    def on_frame(self, frame: CaptureFrameData, now: float) -> None:
        """One frame of the capture system. Never raises."""
        self.frames += 1
        if frame.at > now + CLOCK_AHEAD_S:
            self.bad_times += 1
            return
        for name, seen in frame.bodies.items():
            if name in self._fed or name in self._seen or len(self._seen) < MAX_SEEN:
                self._seen[name] = now
                if seen is not None:
                    self._last_seen[name] = seen
        for body, fed in self._fed.items():
            raw = frame.bodies.get(body)
            vehicle = None if fed.actor is None else fed.actor.vehicle
            pose = None if raw is None else self._frame.to_enu(raw, self._origin)
            accepted = fed.stream.offer(
                pose,
                now,
                armed=vehicle is not None and vehicle.armed,
                own=None if vehicle is None else self._own_estimate(vehicle),
                others=partial(self._others, body, now),
            )
            if accepted is None or fed.channel is None or fed.actor is None:
                continue
            if fed.stream.due(accepted, fed.rate_hz):
                self._send(fed, fed.actor, fed.channel, *self._message(fed, accepted))

    def _own_estimate(self, vehicle: Vehicle) -> OwnEstimate | None:
        """A vehicle's own position about [origin], by its estimator, and when it came."""
        position, at = vehicle.timed_telemetry("position")
        if position is None or at is None or position["lat_deg"] is None:
            return None
        east, north, up = self._enu.from_geodetic(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])
        return (east, north, up), at

    def _others(self, body: str, now: float) -> list[Vector]:
        """Where the other bodies are, or were not long ago."""
        found = []
        for name, raw in self._last_seen.items():
            if name != body and now - raw.at <= OTHERS_S:
                pose = self._frame.to_enu(raw, self._origin)
                if pose is not None:
                    found.append(pose.pos_m)
        return found

    def _message(self, fed: _Fed, pose: Any) -> tuple[str, dict[str, Any]]:
        assert fed.actor is not None
        config = self._config
        family = fed.actor.vehicle.family
        return message_of(config.message, pose, family, fed.stream.filter.reset_counter, config.latency_s)

    def _send(self, fed: _Fed, actor: VehicleActor, channel: Channel, name: str, values: dict[str, Any]) -> None:
        if channel.id not in self._hub.channels:
            return
        info = self._hub.dialect.by_name[name]
        if self._hub.send_on((channel.id,), info, values, Priority.POSE, ("pose", actor.sysid), clearance=POSES):
            fed.stream.statistics.sent(self._loop.time())

    def _on_timesync(self, frame: Frame, channel: Channel, now: float) -> None:
        """Answer a PX4's request by the clock of the poses' time stamps. Over a radio the answer would be too late for
        it (10 ms), and cost air."""
        fields = frame.fields()
        if fields["tc1"] != 0 or channel.air is not None or self._timesync is None:
            return
        fed = next((fed for fed in self._fed.values() if fed.sysid == frame.sysid), None)
        if fed is None or fed.actor is None or fed.actor.compid != frame.compid or fed.actor.vehicle.family != "px4":
            return
        values = {"tc1": max(1, round(now * 1e9)), "ts1": fields["ts1"]}
        known = {field.name for field in self._timesync.fields}
        target = {"target_system": frame.sysid, "target_component": frame.compid}
        values |= {key: value for key, value in target.items() if key in known}
        self.timesync_answers += self._hub.send_on((channel.id,), self._timesync, values, Priority.PROTOCOL)

    # -- time

    def tick(self, now: float) -> None:
        """Look where poses go, and report what changed."""
        self.capture.tick(now)
        self.refresh()
        for fed in self._fed.values():
            if fed.stream.lost(now) and fed.was_problem != "lost":  # a body that comes and goes is reported once
                text = f"poses of rigid body {fed.stream.body} have stopped; nothing is sent to it"
                self._report(fed, "lost", text)
            elif fed.stream.filter.tracking and fed.was_problem == "lost":
                self._report(fed, "back", f"poses of rigid body {fed.stream.body} come again")
            if self._origins is not None and fed.actor is not None and fed.stream.fresh(now):
                self._origins.look(fed.actor, now)

    def refresh(self) -> None:
        """Find each vehicle and the channel for its poses."""
        now = self._loop.time()
        self._open_since = {number: self._open_since.get(number, now) for number in self._hub.channels}
        heard: dict[int, set[int]] = {}
        for key, actor in self._fleet.vehicles.items():
            if not actor.vehicle.replayed:
                for channel_id in self._hub.router.channels_of(key):
                    heard.setdefault(channel_id, set()).add(key)
        for fed in self._fed.values():
            fed.actor = self._actor_of(fed)
            if fed.actor is not None:
                fed.actor.part(Preflight).fly_by_poses(fed.stream.problem)
            self._choose_way(fed, heard, now)
            fed.rate_hz = 0.0 if fed.channel is None else self._rate_hz(fed.channel)
            fed.stream.rate_hz = fed.rate_hz

    def _actor_of(self, fed: _Fed) -> VehicleActor | None:
        """The autopilot with this system id and the lowest component id; while one flies, that one."""
        if fed.actor is not None and self._fleet.may_fly(fed.actor.vehicle.key):
            return self._fleet.vehicles[fed.actor.vehicle.key]  # after a standstill another one than before
        found = [actor for key, actor in self._fleet.vehicles.items() if key >> 8 == fed.sysid]
        return min(found, key=lambda actor: actor.compid, default=None)

    def _choose_way(self, fed: _Fed, heard: dict[int, set[int]], now: float) -> None:
        """Where its poses go now; one that flies keeps its channel, which is reported."""
        way = fed.way
        ordinary, why_not = self._channel_of(fed.actor, heard)
        flies = fed.actor is not None and may_fly(fed.actor.vehicle, now)
        still_open = way.channel_id is not None and way.channel_id in self._hub.channels
        way.choose(None if ordinary is None else ordinary.id, why_not, flies=flies, still_open=still_open)
        fed.channel = None if way.channel_id is None else self._hub.channels.get(way.channel_id)
        fed.stream.why = way.why_none
        if way.kept_despite != fed.kept_despite:
            fed.kept_despite = way.kept_despite
            if way.kept_despite is not None:
                text = f"{way.kept_despite}; it flies by its poses, so they go on"
                self._report(fed, "kept", text, problem=False)

    def _channel_of(self, actor: VehicleActor | None, heard: dict[int, set[int]]) -> tuple[Channel | None, str]:
        """The channel for its poses, or why there is none."""
        if actor is None:
            return None, "the vehicle has not been heard"
        vehicle = actor.vehicle
        if vehicle.replayed:
            return None, "it exists only in a recording"
        if not vehicle.connected:
            return None, "it is not connected"
        if vehicle.duplicate:
            return None, "two vehicles have its system id"
        if not vehicle.armed and (why := why_no_poses(vehicle)) is not None:
            return None, why  # one that flies already needs its poses
        # the first channel that nobody else is heard on, and has been open for long enough to know that
        best = self._hub.channels_to(vehicle.sysid, vehicle.compid)
        others = self._hub.channels_to(vehicle.sysid, vehicle.compid, everywhere=True)
        shared_with: set[int] = set()
        listening = False
        for channel_id in dict.fromkeys((*best, *others)):
            channel = self._hub.channels.get(channel_id)
            if channel is None or channel.translator is not None:
                continue
            beside = heard.get(channel_id, set()) - {vehicle.key}
            if not beside and self._loop.time() - self._open_since.get(channel_id, math.inf) >= LISTEN_S:
                if self._config.type == "recorded" and vehicle.armed and channel.config.type not in PRETENDED:
                    return None, "it is armed: it would follow the poses of a recording"
                return channel, ""
            listening |= not beside
            shared_with |= beside
        # no channel: why
        if listening:
            return None, "its link was opened just now: whether it shares it with other vehicles is not known yet"
        if not shared_with:
            return None, "no link leads to it"
        names = ", ".join(self._fleet.vehicles[key].name for key in sorted(shared_with)[:5])
        return None, (
            f"it shares its link with {names}: a pose has no address, and all of them would take it for their own; "
            "give each vehicle a link of its own (a UDP port or a radio pair)"
        )

    def _rate_hz(self, channel: Channel) -> float:
        air = channel.air
        budget = None if air is None or air.queue.budget is None else air.queue.budget.rate
        config = self._config
        return rate_that_fits(config.message, config.rate_hz, budget, signed=channel.signing is not None)

    def bytes_per_s(self, channel_id: int) -> float:
        """Return what the poses take of this channel."""
        size = WIRE_BYTES[self._config.message]
        return sum(
            fed.rate_hz * size for fed in self._fed.values() if fed.channel is not None and fed.channel.id == channel_id
        )

    def on_reboot(self, event: Event) -> None:
        """Its estimator has begun anew, and may want its origin again."""
        if self._origins is not None and event.sysid is not None:
            self._origins.forget(event.sysid)

    def _report(self, fed: _Fed, change: str, text: str, *, problem: bool = True) -> None:
        if problem:
            fed.was_problem = change
        self._on_event(Event("mocap", fed.name, fed.sysid, text, {"change": change, "body": fed.stream.body}))

    # -- status

    def status_of(self, sysid: int, now: float) -> dict[str, Any] | None:
        """The state group "mocap" of a vehicle; None: [mocap] does not name it."""
        return next((fed.stream.status(now) for fed in self._fed.values() if fed.sysid == sysid), None)

    def status(self) -> dict[str, Any]:
        """JSON-able, for mocap.status."""
        now = self._loop.time()
        config = self._config
        return {
            "type": config.type,
            **self.capture.status(),
            "message": config.message,
            "rate_hz": config.rate_hz,
            "frames": self.frames,
            "bad_times": self.bad_times,
            "timesync_answers": self.timesync_answers,
            "bodies_seen": {body: round(now - at, 1) for body, at in sorted(self._seen.items())},
            "vehicles": [
                {
                    "vehicle": fed.name,
                    "link": None if fed.channel is None else fed.channel.link.name,
                    **fed.stream.status(now),
                }
                for fed in self._fed.values()
            ],
        }
