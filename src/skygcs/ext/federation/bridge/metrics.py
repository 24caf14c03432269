"""Metrics of the bridge for Prometheus: the hub, every other site, orders, leases and conflicts.

The daemon's own metrics are scraped at the daemon. Labels have a bounded set of values: sites (`MAX_SITES`), vehicles
of [federation.vehicles], and constants of the code.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from typing import Any

from prometheus_client.process_collector import ProcessCollector

from skygcs import __version__
from skygcs.config.files import read_token
from skygcs.ext.federation.bridge.station import Part, Station
from skygcs.ext.federation.config import FederationMetricsConfig
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from skygcs.metrics.endpoint import MetricsEndpoint
from skygcs.metrics.exposition import Samples, exposed
from skygcs.metrics.metric_info import MetricInfo, metrics_with

TABLE = "federation.metrics"

METRICS: dict[str, MetricInfo] = {
    metric.name: metric
    for metric in (
        *metrics_with("version station role", ("federation_info", "1; version, station and role.")),
        *metrics_with(
            "",
            ("federation_hub_connected", "1 while the bridge is connected to the hub."),
            ("federation_hub_round_trip_seconds", "Round trip of the last ping to the hub."),
            ("federation_hub_connections_total", "Connections made to the hub."),
            ("federation_hub_sent_total", "Messages published to the hub."),
            ("federation_hub_received_total", "Messages that came from the hub."),
            ("federation_hub_not_sent_total", "Messages dropped as the hub was away or took nothing."),
            ("federation_hub_dropped_total", "Messages dropped as they came too fast."),
            ("federation_hub_denied_total", "Subjects the hub denies to this station."),
            ("federation_faults_total", "Messages whose handling failed."),
            ("federation_daemon_connected", "1 while the bridge is connected to the station's daemon."),
            ("federation_shared_vehicles", "Vehicles of this site that are published."),
            ("federation_batch_bytes", "Size of the last published batch of states."),
            ("federation_batches_dropped_total", "Batches not published as the hub was away."),
            ("federation_clients", "Clients of the station socket now."),
            ("federation_sites", "Other sites that were heard."),
            ("federation_conflicts", "Pairs of own and other vehicles about to come too close."),
            ("federation_conflicts_watched_vehicles", "Other sites' vehicles watched against ours."),
            ("federation_conflicts_evaluation_seconds", "CPU time of the last evaluation."),
            ("federation_order_records_lost_total", "Records of orders that did not reach the hub."),
        ),
        *metrics_with(
            "site",
            ("federation_site_silent", "1 if its states are too old, or of unknown age."),
            ("federation_site_contested", "1 if two bridges send under its name."),
            ("federation_site_daemon_connected", "1 while its bridge is connected to its daemon."),
            ("federation_site_age_seconds", "Time since its newest batch was sent."),
            ("federation_site_oldest_age_seconds", "Total age of its oldest vehicle state."),
            ("federation_site_clock_error_seconds", "Bound of the error of these ages."),
            ("federation_site_vehicles", "Vehicles of its newest batch."),
            ("federation_site_vehicles_heard", "Those of them that are heard, from here."),
            ("federation_site_vehicles_armed", "Those of them that are armed."),
            ("federation_site_vehicles_in_air", "Those of them that are in the air."),
            ("federation_site_problems", "Those of them in a failsafe, or not heard."),
            ("federation_site_batches_taken_total", "Batches taken."),
            ("federation_site_batches_lost_total", "Batches missing in its sequence."),
            ("federation_site_batches_late_total", "Batches that came after a newer one."),
            ("federation_site_restarts_total", "Restarts of its bridge that were seen."),
        ),
        *metrics_with("series", ("federation_batches_sent_total", "Batches of states that were published.")),
        *metrics_with("status", ("federation_orders_sent_total", "Orders to other sites, by what became of them.")),
        *metrics_with("status", ("federation_orders_taken_total", "Orders of other stations, by decision.")),
        *metrics_with(
            "vehicle",
            ("federation_lease_held", "1 while this site may command the vehicle."),
            ("federation_lease_remaining_seconds", "Time until it must be renewed."),
        ),
        *metrics_with(
            "",
            ("series", "Time series of this answer."),
            ("series_dropped", "Time series left out as too many."),
        ),
    )
}
"""By name. docs/reference/metrics.md is compared with it by a test."""

HUB_COUNTERS = {
    "connections": "skygcs_federation_hub_connections_total",
    "sent": "skygcs_federation_hub_sent_total",
    "received": "skygcs_federation_hub_received_total",
    "not_sent": "skygcs_federation_hub_not_sent_total",
    "dropped": "skygcs_federation_hub_dropped_total",
    "denied": "skygcs_federation_hub_denied_total",
    "faults": "skygcs_federation_faults_total",
}

ORDERS_SENT, ORDERS_TAKEN = "orders to other sites", "orders of other stations"
"""Names of parts, as `process.make_parts` has them."""


class FederationMetrics:
    """A part of the bridge: serves the metrics. Run `run` in a task."""

    def __init__(
        self, config: FederationMetricsConfig, station: Station, sites: RemoteSites, parts: Mapping[str, Part]
    ) -> None:
        """``parts``: all parts of the bridge; their status is read at each scrape."""
        self._config = config
        self._station = station
        self._sites = sites
        self._parts = parts
        self._address: tuple[str, int] | None = None
        self._process = ProcessCollector(registry=None)
        self._scrapes = 0

    async def run(self) -> None:
        """Serve until it is cancelled. Raises LinkError if the address cannot be used."""
        endpoint = MetricsEndpoint(self._config, read_token(TABLE, self._config.token_file), self._station.now, TABLE)
        try:
            endpoint.claim()
            self._address = endpoint.address
            await endpoint.start(self)
            await asyncio.Event().wait()
        finally:
            self._address = None
            await endpoint.close()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {"address": None if self._address is None else list(self._address), "scrapes": self._scrapes}

    async def render(self) -> bytes:
        """All metrics as text, written in short turns of the loop."""
        self._scrapes += 1
        pieces = []
        for piece in self._turns():
            pieces.append(piece)
            await asyncio.sleep(0)
        return b"".join(pieces)

    def _turns(self) -> Iterator[bytes]:
        samples = Samples()
        self._read_station(samples)
        for site in self._sites.sites(self._station.clock.now_s()):
            self._read_site(samples, site)
        yield b""
        self._read_parts(samples)
        yield from exposed(samples, METRICS, self._process)

    def _read_station(self, samples: Samples) -> None:
        station, put = self._station, samples.put
        put("skygcs_federation_info", 1, __version__, station.name, station.config.role)
        hub = station.bus.status()
        put("skygcs_federation_hub_connected", hub["connected"])
        put("skygcs_federation_hub_round_trip_seconds", hub["round_trip_s"])
        for counter, metric in HUB_COUNTERS.items():
            put(metric, hub[counter])
        put("skygcs_federation_sites", len(self._sites.names))

    def _read_site(self, samples: Samples, site: Mapping[str, Any]) -> None:
        name, vehicles, clock = site["site"], site["vehicles"], site["clock"]

        def put(metric: str, value: float | None) -> None:
            samples.put(f"skygcs_federation_site_{metric}", value, name)

        put("silent", site["silent"])
        put("contested", site["contested"])
        put("daemon_connected", site["daemon"])
        put("age_seconds", site["age_s"])
        put("oldest_age_seconds", vehicles["oldest_age_s"])
        put("clock_error_seconds", None if clock is None else clock["error_s"])
        put("vehicles", vehicles["count"])
        put("vehicles_heard", vehicles["heard"])
        put("vehicles_armed", vehicles["armed"])
        put("vehicles_in_air", vehicles["in_the_air"])
        put("problems", vehicles["problems"])
        for counter in ("taken", "lost", "late"):
            put(f"batches_{counter}_total", site["batches"][counter])
        put("restarts_total", site["restarts"])

    def _read_parts(self, samples: Samples) -> None:
        """Read the parts that this station has; an observer has only the station socket and the orders."""
        status = {name: part.status() for name, part in self._parts.items() if part is not self}
        put, publisher = samples.put, status.get("publisher")
        if publisher is not None:
            put("skygcs_federation_daemon_connected", publisher["daemon"])
            put("skygcs_federation_shared_vehicles", publisher["shared"])
            put("skygcs_federation_batch_bytes", publisher["bytes"])
            put("skygcs_federation_batches_dropped_total", publisher.get("batches_dropped", 0))
            for series in ("fast", "slow"):
                put("skygcs_federation_batches_sent_total", publisher.get(f"batches_{series}", 0), series)
        put("skygcs_federation_clients", status["station socket"]["clients"])
        conflicts = status.get("conflicts")
        if conflicts is not None:
            put("skygcs_federation_conflicts", conflicts["conflicts"])
            put("skygcs_federation_conflicts_watched_vehicles", conflicts["watched"])
            put("skygcs_federation_conflicts_evaluation_seconds", conflicts["evaluation_s"])
        for ended, count in status.get(ORDERS_SENT, {}).items():
            if ended != "sent":
                put("skygcs_federation_orders_sent_total", count, ended)
        taken = status.get(ORDERS_TAKEN)
        if taken is not None:
            put("skygcs_federation_order_records_lost_total", taken["records_lost"])
            for decided, count in taken["decided"].items():
                put("skygcs_federation_orders_taken_total", count, decided)
        for lease in status.get("leases", {}).get("leases", ()):
            put("skygcs_federation_lease_held", lease["held"], lease["vehicle"])
            put("skygcs_federation_lease_remaining_seconds", lease["remaining_s"], lease["vehicle"])
