"""Reads the counters of a running daemon and writes them in Prometheus's text format, in short turns of the loop.

Nothing counts for metrics alone on the path of a frame: all numbers are counters that exist for `status` and events. A
collection yields to the loop after each slice of vehicles and after each slice of lines, so that no tick waits for more
than one slice.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol

from prometheus_client.process_collector import ProcessCollector

from skygcs import __version__
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.ext.metrics.table import METRICS
from skygcs.links.base import CHANNEL_TOTALS
from skygcs.metrics.exposition import Labels, Samples, exposed
from skygcs.rpc.context import Services
from skygcs.rpc.server import RpcServer
from skygcs.runtime.link_view import LinkWatch
from skygcs.runtime.vehicle_actor import VehicleActor

SLICE_VEHICLES = 10
"""Vehicles that are read in one turn: 0.3 ms."""

MAX_COUNTED = 2048
"""Sources on channels that are remembered, closed ones included: as many as the hub keeps of closed channels."""

FALLS = ("velocity", "position", "hold", "release")
"""Modes to which the guard falls; each is there from the start, so that the first fall is an increase."""

RPC_ERRORS = {
    "requests_refused": "refused",
    "parse_errors": "parse_error",
    "lines_too_long": "line_too_long",
    "auth_failures": "auth_failure",
}
"""Counters of `RpcServer.stats` -> label."""

LINK_TOTALS = {
    "rx_frames": "skygcs_link_received_frames_total",
    "rx_bytes": "skygcs_link_received_bytes_total",
    "tx_frames": "skygcs_link_sent_frames_total",
    "tx_bytes": "skygcs_link_sent_bytes_total",
    "tx_dropped": "skygcs_link_dropped_frames_total",
    "bad_crc": "skygcs_link_crc_errors_total",
    "unknown": "skygcs_link_unknown_messages_total",
    "skipped_bytes": "skygcs_link_skipped_bytes_total",
}

RADIO_FIELDS = {
    "rssi": "skygcs_radio_rssi",
    "remrssi": "skygcs_radio_remote_rssi",
    "noise": "skygcs_radio_noise",
    "remnoise": "skygcs_radio_remote_noise",
    "rxerrors": "skygcs_radio_receive_errors_total",
}

QUEUE_FIELDS = {
    "waiting": "skygcs_queue_waiting",
    "sent": "skygcs_queue_sent_total",
    "sent_bytes": "skygcs_queue_sent_bytes_total",
    "replaced": "skygcs_queue_replaced_total",
    "dropped": "skygcs_queue_dropped_total",
    "refused": "skygcs_queue_refused_total",
    "wait_p95_s": "skygcs_queue_wait_p95_seconds",
}


class Measured(Services, Protocol):
    """The parts of a running daemon that are measured; `skygcs.daemon.Daemon` has all of them."""

    link_watch: LinkWatch
    rpc: RpcServer


class _GrowingSums:
    """Sums of counters of objects that come and go: a source's counters on a channel end with the channel. What an
    object counted between the last collection and its end is not in the sum, which never decreases."""

    def __init__(self) -> None:
        self._sums: dict[Labels, list[int]] = {}
        self._last: dict[int, tuple[object, tuple[int, ...]]] = {}
        """By id: the object, which is kept so that its id is not used again, and what it had counted."""

    def update(self, counted: Iterable[tuple[Labels, object, tuple[int, ...]]]) -> dict[Labels, list[int]]:
        """``counted``: of every object its labels, itself and its counters. Sums of labels that have no object any more
        are forgotten; objects are remembered for a while, because a peer that comes back has its old counters."""
        last = self._last
        sums: dict[Labels, list[int]] = {}
        for labels, item, counters in counted:
            before = last.pop(id(item), (item, (0,) * len(counters)))[1]
            last[id(item)] = (item, counters)
            total = sums.get(labels)
            if total is None:
                total = sums[labels] = self._sums.get(labels, [0] * len(counters))
            for i, (old, new) in enumerate(zip(before, counters, strict=True)):
                total[i] += new - old if new >= old else new
        while len(last) > MAX_COUNTED:
            del last[next(iter(last))]
        self._sums = sums
        return sums


class MetricsCollector:
    """The metrics of one daemon."""

    def __init__(self, services: Measured, orders: Mapping[tuple[str, str], int]) -> None:
        """``orders``: how many ended, by order and result."""
        self._services = services
        self._orders = orders
        self._process = ProcessCollector(registry=None)
        self._sources = _GrowingSums()
        self._scrapes = 0
        self._cpu_s = 0.0
        self._longest_turn_s = 0.0

    async def render(self) -> bytes:
        """All metrics as text. The loop runs between its slices; nothing of it is longer than a slice."""
        pieces: list[bytes] = []
        cpu_s = longest_s = 0.0
        turns = self._turns()
        while True:
            begun = time.thread_time()
            piece = next(turns, None)
            turn_s = time.thread_time() - begun
            cpu_s, longest_s = cpu_s + turn_s, max(longest_s, turn_s)
            if piece is None:
                break
            pieces.append(piece)
            await asyncio.sleep(0)
        self._cpu_s, self._longest_turn_s = cpu_s, longest_s
        return b"".join(pieces)

    # -- slices

    def _turns(self) -> Iterator[bytes]:
        """The text in pieces; b"" where there is only a pause."""
        samples = Samples()
        self._scrapes += 1
        self._read_daemon(samples)
        yield b""
        self._read_router(samples)
        yield b""
        yield from self._read_links(samples)
        for radio in self._services.air.radios(self._services.now()):
            self._read_radio(samples, radio)
        yield b""
        yield from self._read_vehicles(samples)
        yield from exposed(samples, METRICS, self._process)

    def _read_daemon(self, samples: Samples) -> None:
        services, put = self._services, samples.put
        # the daemon, its events and orders
        put("skygcs_build_info", 1, __version__, services.dialect.name)
        put("skygcs_internal_faults_total", services.hub.faults)
        for kind, count in services.event_log.counts.items():
            put("skygcs_events_total", count, kind)
        for (order, result), count in self._orders.items():
            put("skygcs_orders_total", count, order, result)
        # JSON-RPC
        clients = services.rpc.stats()
        put("skygcs_rpc_sessions", clients.get("sessions", 0))
        put("skygcs_rpc_requests_total", clients.get("lines", 0))
        for counter, reason in RPC_ERRORS.items():
            put("skygcs_rpc_errors_total", clients.get(counter, 0), reason)
        # recorder
        recorder = services.recorder
        written = {} if recorder is None else recorder.status()
        put("skygcs_recorder_up", written.get("state") == "recording")
        put("skygcs_recorder_records_total", written.get("records"))
        put("skygcs_recorder_written_bytes_total", written.get("bytes"))
        put("skygcs_recorder_lost_records_total", written.get("lost_records"))
        put("skygcs_recorder_buffered_bytes", written.get("buffered_bytes"))
        # separation monitor
        monitor = services.fleet.monitor
        put("skygcs_separation_watched_vehicles", len(monitor.monitor.tracks.tracks))
        put("skygcs_separation_conflicts", sum(1 for _ in monitor.monitor.conflicts()))
        put("skygcs_separation_evaluation_seconds", monitor.took_s)
        # corrections
        try:
            feed = services.extensions["corrections"].feed
        except KeyError:  # nobody has sent any
            feed = None
        put("skygcs_corrections_messages_total", 0 if feed is None else feed.totals["messages"])
        put("skygcs_corrections_bytes_total", 0 if feed is None else feed.totals["bytes"])
        put("skygcs_corrections_age_seconds", None if feed is None else feed.age_s())
        # the collector itself
        put("skygcs_scrapes_total", self._scrapes)
        put("skygcs_scrape_cpu_seconds", self._cpu_s)
        put("skygcs_scrape_longest_turn_seconds", self._longest_turn_s)

    def _read_router(self, samples: Samples) -> None:
        hub = self._services.hub
        hub.flows.take()
        for verdict, count in hub.router.counters.items():
            samples.put("skygcs_router_frames_total", count, verdict.value)
        samples.put("skygcs_router_routes", sum(1 for _ in hub.router.table.routes()))
        samples.put("skygcs_router_routes_refused_total", hub.router.table.room.refused)
        samples.put("skygcs_router_routes_evicted_total", hub.router.table.room.evicted)

    def _read_links(self, samples: Samples) -> Iterator[bytes]:
        services, put = self._services, samples.put
        supervisors = services.links.supervisors()
        for name, config in services.links.configs.items():
            put("skygcs_link_info", 1, name, config.type, config.role)
            supervisor = supervisors.get(name)
            if supervisor is not None:
                now = services.now()
                channels = supervisor.link.channels
                put("skygcs_link_up", supervisor.state == "up", name)
                put("skygcs_link_failures_total", supervisor.failures, name)
                put("skygcs_link_opened_total", supervisor.opened, name)
                put("skygcs_link_channels", len(channels), name)
                put("skygcs_link_silence_seconds", min((now - c.last_rx_at for c in channels), default=None), name)
            totals = services.hub.statistics.link_totals(name)
            for counter in CHANNEL_TOTALS:
                put(LINK_TOTALS[counter], totals[counter], name)
            yield b""

    def _read_radio(self, samples: Samples, radio: dict[str, Any]) -> None:
        """Further channels of one link (an emulated radio has one for each end) are left out: a link is one radio."""
        put, name, down, up = samples.put, radio["link"], radio["down"], radio["up"]
        if (name,) in samples.by_metric.get("skygcs_radio_vehicles", {}):
            return
        put("skygcs_radio_vehicles", radio["vehicles"], name)
        put("skygcs_radio_budget_bytes_per_second", down["budget_bytes_per_s"], name, "down")
        put("skygcs_radio_budget_bytes_per_second", up["bytes_per_s"], name, "up")
        put("skygcs_radio_planned_bytes_per_second", down["planned_bytes_per_s"], name)
        put("skygcs_radio_measured_bytes_per_second", down["measured_bytes_per_s"], name)
        put("skygcs_radio_degraded", radio["poor"], name)
        report = up["radio"]
        if report is not None:
            put("skygcs_radio_report_age_seconds", report["age_s"], name)
            put("skygcs_radio_transmit_buffer_free_ratio", report["txbuf_percent"] / 100, name)
            for field, metric in RADIO_FIELDS.items():
                put(metric, report[field], name)
        for of_class, counters in radio["classes"].items():
            for field, metric in QUEUE_FIELDS.items():
                put(metric, counters[field], name, of_class)

    # -- vehicles

    def _read_vehicles(self, samples: Samples) -> Iterator[bytes]:
        fleet = self._services.fleet
        actors = sorted(fleet.vehicles.items())
        samples.put("skygcs_vehicles", len(actors))
        samples.put("skygcs_vehicles_connected", sum(actor.vehicle.connected for _, actor in actors))
        samples.put("skygcs_vehicles_refused_total", fleet.refused_vehicles)
        counted: list[tuple[Labels, object, tuple[int, ...]]] = []
        for begin in range(0, len(actors), SLICE_VEHICLES):
            for key, actor in actors[begin : begin + SLICE_VEHICLES]:
                self._read_vehicle(samples, key, actor)
                self._read_control(samples, actor)
                counted += self._sources_of(key, actor.name)
            yield b""
        for labels, (frames, lost) in self._sources.update(counted).items():
            samples.put("skygcs_vehicle_received_frames_total", frames, *labels)
            samples.put("skygcs_vehicle_lost_frames_total", lost, *labels)
        yield b""

    def _read_vehicle(self, samples: Samples, key: int, actor: VehicleActor) -> None:
        put, name, vehicle, now = samples.put, actor.name, actor.vehicle, self._services.now()
        put("skygcs_vehicle_info", 1, name, str(actor.sysid), vehicle.family)
        put("skygcs_vehicle_connected", vehicle.connected, name)
        put("skygcs_vehicle_armed", vehicle.armed, name)
        put("skygcs_vehicle_heartbeat_age_seconds", vehicle.silence_s(now), name)
        position_at = vehicle.telemetry_at("position")
        put("skygcs_vehicle_position_age_seconds", None if position_at is None else now - position_at, name)
        battery = vehicle.telemetry("battery")
        percent = None if battery is None else battery["percent"]
        put("skygcs_vehicle_battery_ratio", None if percent is None else percent / 100, name)
        if actor.uplink.answered_at is not None:
            put("skygcs_vehicle_uplink_up", not actor.uplink.lost, name)
            put("skygcs_vehicle_uplink_round_trip_seconds", actor.uplink.trip_s, name)
        for link, facts in self._services.link_watch.of(key, now).items():
            put("skygcs_vehicle_loss_ratio", facts.loss, name, link)

    def _read_control(self, samples: Samples, actor: VehicleActor) -> None:
        """Only of vehicles that are, or are to be, flown by setpoints."""
        clock, controller = actor.offboard.clock, actor.offboard.controller
        if not (clock.ticks or actor.config.control_planned):
            return
        put, name = samples.put, actor.name
        put("skygcs_control_active", controller.state is not OffboardState.OFF, name)
        put("skygcs_control_ticks_total", clock.ticks, name)
        put("skygcs_control_late_ticks_total", clock.late, name)
        put("skygcs_control_skipped_ticks_total", clock.skipped, name)
        put("skygcs_control_lateness_p99_seconds", clock.lateness_p99_s(), name)
        for to in FALLS:
            put("skygcs_guard_falls_total", controller.guard_falls[to], name, to)

    def _sources_of(self, key: int, name: str) -> Iterator[tuple[Labels, object, tuple[int, ...]]]:
        hub = self._services.hub
        for channel_id in hub.router.channels_of(key):
            channel = hub.channels[channel_id]
            stats = channel.sources.get(key)
            if stats is not None:
                yield (name, channel.link.name), stats, (stats.frames, stats.lost)
