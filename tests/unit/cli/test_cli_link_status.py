"""`skygcs-cli link status` against the answers of link.status."""

from __future__ import annotations

import asyncio
import io
from typing import Any, cast

from rich.console import Console

from skygcs.cli.links import drawn, head_lines, look
from skygcs.rpc.client import Client


def radio(**changes: Any) -> dict[str, Any]:
    quiet = dict.fromkeys(("waiting", "sent", "sent_bytes", "replaced", "dropped", "refused"), 0)
    waits = {"wait_p50_s": None, "wait_p95_s": None}
    report = {"age_s": 1.0, "txbuf_percent": 80, "rssi": 180, "remrssi": 170, "noise": 60, "remnoise": 62}
    report |= {"rxerrors": 0, "fixed": 0}
    return {
        "link": "field",
        "peer": "/dev/ttyUSB0",
        "vehicles": [
            {
                "name": "alpha",
                "sysid": 1,
                "weight": 4.0,
                "planned_bytes_per_s": 221.3,
                "measured_bytes_per_s": 190.0,
                "loss": 0.031,
                "round_trip_s": 0.6,
                "settled": True,
                "scaled": True,
                "streams": {"GLOBAL_POSITION_INT": {"planned_hz": 2.0, "measured_hz": 1.9}},
            }
        ],
        "down": {
            "budget_bytes_per_s": 2880.0,
            "per_vehicle_bytes_per_s": 276.4,
            "planned_bytes_per_s": 2213.0,
            "measured_bytes_per_s": 1900.0,
            "factor": 0.75,
        },
        "up": {
            "base_bytes_per_s": 497.5,
            "bytes_per_s": 320.0,
            "paced_by": "reports",
            "round_s": 0.912,
            "radio": report,
            "classes": {
                "command": {**quiet, "sent": 12, "sent_bytes": 540, "wait_p50_s": 0.0, "wait_p95_s": 0.25},
                "setpoint": {**quiet, **waits},
            },
        },
        "poor": ["alpha"],
        "history": [{**report, "txbuf_percent": percent} for percent in (100, 50, 0)],
        **changes,
    }


def shown(radios: list[dict[str, Any]]) -> str:
    out = io.StringIO()
    Console(file=out, width=140, color_system=None).print(drawn(radios))
    return out.getvalue()


def test_it_shows_budget_classes_vehicles_and_what_is_degraded() -> None:
    text = shown([radio()])
    assert "320 of 498 B/s, paced by its reports" in text
    assert "measured 1,900 B/s, planned 2,213, available 2,880, cut to 75% after losses" in text
    assert "a round takes 0.91 s" in text and "buffer 80 % free" in text and "degraded: alpha" in text
    (vehicle,) = [line for line in text.splitlines() if line.strip().startswith("alpha")]
    assert "3.1%" in vehicle and "0.60 s" in vehicle and "less than requested, flown" in vehicle
    assert "command" in text and "0.25 s" in text
    assert "setpoint" not in text, "a class without anything is left out"


def test_history_is_drawn_from_full_to_empty() -> None:
    (line,) = [line for line in head_lines(radio()) if "buffer free" in line]
    assert line.endswith("█▅▁")


def test_a_radio_that_says_nothing_and_has_no_timeslots_is_shown_too() -> None:
    silent = radio()
    silent["up"] |= {"radio": None, "round_s": None, "paced_by": "rates"}
    silent["vehicles"][0] |= {"measured_bytes_per_s": None, "loss": None, "round_trip_s": None, "streams": {}}
    text = shown([silent])
    assert "MAVLink framing" in text and "a round" not in text


def test_it_shows_third_party_traffic_what_became_of_it_and_what_waits() -> None:
    busy = radio()
    counts = {"refused_streams": 420, "slowed": 85, "thinned": 1037}
    sources: list[dict[str, Any]] = [
        {"source": f"1/{n}", "age_s": 0.1, "sent": n, "sent_bytes": 20 * n, "counts": {}} for n in range(9)
    ]
    sources.append({"source": "255/190", "age_s": 61.0, "sent": 264, "sent_bytes": 7497, "counts": counts})
    lists = {"rule": "one", "running": {"sysid": 2, "seen": 34, "count": 900, "age_s": 5.0}, "waiting": [3, 4]}
    busy["up"]["third_party"] = {"bytes_per_s": 248.7, "param_lists": lists, "sources": sources}
    busy["up"]["corrections"] = {"source": 255 << 8 | 190, "bytes_per_s": 199.0, "messages": 15, "bytes": 11460}
    busy["up"]["corrections"] |= {"replaced": 45, "expired": 0, "dropped": 1, "wait_p95_s": 0.9}
    text = shown([busy])
    assert "limit of other programs 249 B/s; parameters of 2 arrive (34 of 900), those of 3, 4 wait" in text
    first = next(line for line in text.splitlines() if "255/190" in line)
    assert "sent 264 (7,497 B), streams refused 420, slowed 85, too often 1,037, silent for 61 s" in first
    assert text.index("255/190") < text.index("1/8"), "who asks for most comes first"
    assert "and 2 more" in text
    assert "corrections of 255/190: 15 messages sent (11,460 B, 199 B/s), 46 replaced by newer ones" in text


def test_without_a_radio_it_says_what_to_do() -> None:
    assert 'role = "radio"' in asyncio.run(why_empty([]))


def test_a_radio_without_limited_airtime_or_that_is_down_is_named() -> None:
    links = [
        {"name": "field", "type": "simulated", "role": "radio", "state": "up"},
        {"name": "usb", "type": "serial", "role": "radio", "state": "down"},
        {"name": "gcs", "type": "udp_client", "role": "gcs", "state": "up"},
    ]
    text = asyncio.run(why_empty(links))
    assert "field is up, but a simulated link" in text and "air_kbps" in text
    assert "usb is down" in text and "gcs is" not in text


async def why_empty(links: list[dict[str, Any]]) -> str:
    class Daemon:
        async def call(self, method: str) -> list[dict[str, Any]]:
            return {"link.status": [], "links.list": links}[method]

    return str(await look(cast(Client, Daemon())))
