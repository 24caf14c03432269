"""The table of all metrics: name, type, labels, meaning. Names and units by Prometheus's conventions.

A label has a bounded set of values: links of the fleet, vehicles that are kept (`MAX_VEHICLES`), and constants of the
code. Peers of a link, sources of frames and texts are no labels: others can make up as many as they like.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Kind = Literal["counter", "gauge"]


class MetricInfo(NamedTuple):
    """One metric. ``name`` of a counter ends in _total, as it is scraped."""

    name: str
    kind: Kind
    labels: tuple[str, ...]
    help: str


def metrics_with(labels: str, *rows: tuple[str, str]) -> list[MetricInfo]:
    """Metrics with the same labels; a counter is recognised by its name."""
    return [
        MetricInfo(f"skygcs_{name}", "counter" if name.endswith("_total") else "gauge", tuple(labels.split()), text)
        for name, text in rows
    ]


METRICS: dict[str, MetricInfo] = {
    metric.name: metric
    for metric in (
        *metrics_with(
            "",
            ("internal_faults_total", "Exceptions that were contained in a frame or a tick; each kind is an event."),
            ("router_routes", "Routes: sources on the channels they are heard on."),
            ("router_routes_refused_total", "Sources for which the route table had no room."),
            ("router_routes_evicted_total", "Routes that made room for others."),
            ("rpc_sessions", "Clients of the JSON-RPC socket now."),
            ("rpc_requests_total", "Lines that clients sent."),
            ("vehicles", "Vehicles that are kept, connected or not."),
            ("vehicles_connected", "Vehicles whose heartbeat is heard."),
            ("vehicles_refused_total", "Vehicles for which there was no room."),
            ("recorder_up", "1 while frames are recorded; 0 while the disk fails or recording is off."),
            ("recorder_records_total", "Frames written to tlogs."),
            ("recorder_written_bytes_total", "Bytes written to tlogs."),
            ("recorder_lost_records_total", "Frames that could not be recorded."),
            ("recorder_buffered_bytes", "Bytes that wait for the disk."),
            ("separation_watched_vehicles", "Vehicles whose distances are watched."),
            ("separation_conflicts", "Pairs of vehicles that are about to come too close."),
            ("separation_evaluation_seconds", "CPU time of the last evaluation of all pairs."),
            ("corrections_messages_total", "RTCM messages handed to links."),
            ("corrections_bytes_total", "Bytes of RTCM handed to links."),
            ("corrections_age_seconds", "Time since the last RTCM message; absent before the first."),
            ("scrapes_total", "Times that these numbers were collected."),
            ("scrape_cpu_seconds", "CPU time of the loop's thread for the collection before this one."),
            ("scrape_longest_turn_seconds", "The longest time for which that collection kept the loop."),
            ("series", "Time series of this answer."),
            ("series_dropped", "Time series left out of this answer because there were too many."),
        ),
        *metrics_with("version dialect", ("build_info", "1; the version of skygcs and its dialect.")),
        *metrics_with("kind", ("events_total", "Events by kind, those that were not logged included.")),
        *metrics_with(
            "order result", ("orders_total", "Orders of vehicles that ended, by their result (accepted, refused, …).")
        ),
        *metrics_with("verdict", ("router_frames_total", "Frames by the router's verdict.")),
        *metrics_with("reason", ("rpc_errors_total", "Requests of clients that were not carried out, by reason.")),
        *metrics_with("link type role", ("link_info", "1; the type and the role of a link.")),
        *metrics_with(
            "link",
            ("link_up", "1 while the link is open."),
            ("link_failures_total", "Times that the link failed or could not be opened."),
            ("link_opened_total", "Times that the link was opened."),
            ("link_channels", "Open channels: peers, clients, the serial port."),
            ("link_silence_seconds", "Time since anything valid came on any channel of the link."),
            ("link_received_frames_total", "Frames received."),
            ("link_received_bytes_total", "Bytes of frames received."),
            ("link_sent_frames_total", "Frames sent."),
            ("link_sent_bytes_total", "Bytes of frames sent."),
            ("link_dropped_frames_total", "Frames that were to be sent and were dropped."),
            ("link_crc_errors_total", "Frames with a wrong CRC."),
            ("link_unknown_messages_total", "Frames whose message the dialect does not have."),
            ("link_skipped_bytes_total", "Bytes that belong to no frame."),
        ),
        *metrics_with(
            "link direction",
            ("radio_budget_bytes_per_second", "What the radio is taken to carry: up from the ground, down to it."),
        ),
        *metrics_with(
            "link",
            ("radio_planned_bytes_per_second", "What the vehicles were asked to send."),
            ("radio_measured_bytes_per_second", "What comes from all sources behind the radio."),
            ("radio_vehicles", "Vehicles in the radio's plan."),
            ("radio_degraded", "How much is degraded now: its buffer, its signal, vehicles with high losses."),
            ("radio_report_age_seconds", "Time since the radio's last RADIO_STATUS."),
            ("radio_transmit_buffer_free_ratio", "Free part of the radio's transmit buffer."),
            ("radio_rssi", "Received signal at the ground, in the radio's own scale."),
            ("radio_remote_rssi", "Received signal at the other end, in the radio's own scale."),
            ("radio_noise", "Noise at the ground, in the radio's own scale."),
            ("radio_remote_noise", "Noise at the other end, in the radio's own scale."),
            ("radio_receive_errors_total", "Receive errors that the radio reports; a counter of 16 bits."),
        ),
        *metrics_with(
            "link class",
            ("queue_waiting", "Messages of a class that wait for a radio."),
            ("queue_sent_total", "Messages of a class that a radio was given."),
            ("queue_sent_bytes_total", "Bytes of them."),
            ("queue_replaced_total", "Messages that a newer one replaced while they waited."),
            ("queue_dropped_total", "Messages dropped because the queue was full."),
            ("queue_refused_total", "Messages refused because the queue was full; their senders try again."),
            ("queue_wait_p95_seconds", "95th percentile of the time that the last messages waited."),
        ),
        *metrics_with("vehicle sysid autopilot", ("vehicle_info", "1; the system id and the autopilot of a vehicle.")),
        *metrics_with(
            "vehicle",
            ("vehicle_connected", "1 while the vehicle's heartbeat is heard."),
            ("vehicle_armed", "1 while the vehicle is armed."),
            ("vehicle_heartbeat_age_seconds", "Time since the vehicle's last heartbeat."),
            ("vehicle_position_age_seconds", "Time since the vehicle's last position."),
            ("vehicle_battery_ratio", "Remaining part of the vehicle's battery, as it reports it."),
            ("vehicle_uplink_up", "0 while the vehicle answers none of our probes."),
            ("vehicle_uplink_round_trip_seconds", "Smoothed round trip of our probes."),
        ),
        *metrics_with(
            "vehicle link",
            ("vehicle_received_frames_total", "Frames of the vehicle's autopilot that came."),
            ("vehicle_lost_frames_total", "Frames that are missing in the autopilot's sequence numbers."),
            ("vehicle_loss_ratio", "Lost part of the frames of the last half minute."),
        ),
        *metrics_with(
            "vehicle",
            ("control_active", "1 while the vehicle is flown by setpoints of skygcs."),
            ("control_ticks_total", "Ticks of the vehicle's control loop."),
            ("control_late_ticks_total", "Ticks that came more than 5 ms after their deadline."),
            ("control_skipped_ticks_total", "Ticks that did not take place because they were too late."),
            ("control_lateness_p99_seconds", "99th percentile of the lateness of the last ticks."),
        ),
        *metrics_with(
            "vehicle to",
            ("guard_falls_total", "Falls of the guard: to velocity or position setpoints, hold, or release."),
        ),
    )
}
"""By name. docs/reference/metrics.md is compared with it by a test."""
