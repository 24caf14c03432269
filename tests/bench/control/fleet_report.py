"""The table of one load in real time, and whether it met its targets."""

from __future__ import annotations

import math

from bench.control.figures import Section
from bench.control.fleet import Carried

LATENESS_P99_MS = 5.0
GROWTH_MB = 3.0
"""In the second half of a run: 10 s. The recorder's buffers and the allocator's own steps are less."""
BUSY_PERCENT = 5.0
"""Of the time waited for a CPU: above this lateness is the machine's as much as the daemon's, and is not judged."""
MOST_CPU_PERCENT = {10: 60.0, 100: 100.0}
"""By the number of vehicles, at 50 Hz each: the loads that have targets, of lateness as well."""


def fleet_section(carried: Carried) -> Section:
    """Missed are only targets that the daemon, and not its neighbours on the machine, missed."""
    c = carried
    section = Section(
        f"fleet_{c.vehicles}_at_{c.rate_hz:g}_hz",
        f"{c.vehicles} vehicles at {c.rate_hz:g} Hz of attitude each, UDP, real time "
        f"(attitude_delay_s {c.attitude_delay_s:g})",
    )
    section.rows = [
        ("flown by attitude at the end", f"{c.flown_by_attitude} of {c.vehicles}"),
        ("ticks per second", f"{c.ticks_per_s:g} of {c.vehicles * c.rate_hz:g}, {c.skipped} skipped, {c.late} late"),
        ("lateness p50 / p99 / max, ms", f"{c.lateness_p50_ms} / {c.lateness_p99_ms} / {c.lateness_max_ms}"),
        ("p99, median of 4 s windows, ms", f"{c.lateness_p99_median_ms}"),
        ("a tick takes p50 / p99, µs", f"{c.tick_us} / {c.tick_p99_us}"),
        ("p99 by the loop's clock, ms", f"{c.loop_lateness_p99_ms}"),
        ("delay p95, ms", f"{c.delay_p95_ms}"),
        ("daemon's CPU, % of one core", f"{c.cpu_percent} (median {c.cpu_percent_median})"),
        ("simulator's CPU", f"{c.simulator_cpu_percent}"),
        (
            "daemon waited for a CPU, % of time",
            f"{c.waited_percent} (load average {c.load_average}, {'real-time' if c.realtime else 'usual'} priority)",
        ),
        ("memory, MB", f"{c.rss_begin_mb} -> {c.rss_middle_mb} -> {c.rss_end_mb}"),
    ]
    section.data = c.as_dict()
    section.missed = list(_missed(c))
    if c.waited_percent > BUSY_PERCENT:
        section.remarks.append("The machine is busy with other things: lateness is shown, not judged.")
    return section


def _missed(c: Carried) -> list[str]:
    load = f"{c.vehicles} vehicles at {c.rate_hz:g} Hz"
    found = []
    quiet = c.waited_percent <= BUSY_PERCENT
    if quiet and c.flown_by_attitude < c.vehicles:
        found.append(f"{load}: only {c.flown_by_attitude} flown by attitude at the end: {c.otherwise}")
    if c.vehicles in MOST_CPU_PERCENT and quiet and c.lateness_p99_median_ms > LATENESS_P99_MS:
        found.append(f"{load}: lateness p99 {c.lateness_p99_median_ms} ms, wanted {LATENESS_P99_MS:g}")
    most_percent = MOST_CPU_PERCENT.get(c.vehicles, math.inf)
    if c.cpu_percent > most_percent:
        found.append(f"{load}: {c.cpu_percent} % of a core, wanted {most_percent:g}")
    if c.rss_end_mb - c.rss_middle_mb > GROWTH_MB:
        found.append(f"{load}: memory grew from {c.rss_middle_mb} to {c.rss_end_mb} MB")
    return found
