"""`skygcs-cli link status` against the answers of link.status."""

from __future__ import annotations

import asyncio
import io
import json
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest
from rich.console import Console
from typer.testing import CliRunner

from skygcs.cli.links import drawn, head_lines, look
from skygcs.cli.main import app
from skygcs.core.params.names import SORTS
from skygcs.core.radio_link.capacity import PROFILES, SETPOINTS
from skygcs.rpc.client import Client
from support.command_line import said
from support.table import each


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


# -- `link plan`: what it prints, and its exit code.


DONE, FAILED, USAGE = 0, 1, 2


run = partial(said, "link", "plan")


def test_what_fits_is_shown_with_its_shares() -> None:
    said = run("10")
    assert "a round of 11 nodes: 912 ms" in said
    assert "down, ground serial          2,005     5,760     2,880     35%" in said
    assert "each vehicle gets (Hz): HEARTBEAT 1, SYS_STATUS 0.5, GPS_RAW_INT 0.5, GLOBAL_POSITION_INT 2" in said
    assert "vehicles that fit with these options: 14" in said


def test_what_does_not_fit_is_reported_with_figures_and_a_proposal() -> None:
    said = run("10", "--setpoints", "position", "--setpoint-rate", "2", code=FAILED)
    assert "does not fit: up, the ground's slot carries 553 B/s, of which 259 may be planned with; 1,321 are wa" in said
    for proposal in ("one goto per vehicle", "4 vehicles instead of 10", "air speed 125 kbit/s for up to 5 vehicles"):
        assert f"would fit: {proposal}" in said


def test_json_holds_the_same() -> None:
    answer = json.loads(run("10", "--profile", "control-10", "--json", code=FAILED))
    assert (answer["fits"], answer["most_vehicles"]) == (False, 5)
    assert [one["fits"] for one in answer["directions"]] == [False, True, False, True]
    assert answer["rates_hz"]["GLOBAL_POSITION_INT"] < 10


def test_a_profile_of_ones_own_is_the_sum_of_its_messages() -> None:
    answer = json.loads(run("1", "--profile", "custom", "--rate", "attitude=5", "--air-speed", "none", "--json"))
    assert answer["down_per_vehicle_bytes_per_s"] == 21 + 5 * 40
    assert [one["name"] for one in answer["directions"]] == ["down, ground serial", "up, ground serial"]


@each(
    "args",
    [
        ("0",),
        ("3", "--profile", "racing"),
        ("3", "--rate", "ATTITUDE"),
        ("3", "--rate", "SPEED=1"),
        ("3", "--rate", "ATTITUDE=nan"),
        ("3", "--air-speed", "fast"),
        ("3", "--setpoints", "thrust"),
        ("3", "--setpoints", "position", "--setpoint-rate", "0"),
        ("3", "--fill", "2"),
    ],
)
def test_what_makes_no_sense_is_a_usage_error(args: tuple[str, ...]) -> None:
    run(*args, code=USAGE)


def test_the_help_names_what_there_is() -> None:
    """The lists themselves are imported only by the commands that need them."""
    shown = " ".join(CliRunner().invoke(app, ["link", "plan", "--help"], env={"COLUMNS": "200"}).output.split())
    assert f"{', '.join(PROFILES)}, or custom" in shown
    assert ", ".join(SETPOINTS) in shown
    shown = " ".join(CliRunner().invoke(app, ["param", "diff", "--help"], env={"COLUMNS": "200"}).output.split())
    assert f"{', '.join(SORTS[1:])}, or all" in shown


TIMING = """
kind = "radio timing"
version = 1
[[measurement]]
date = "2026-11-28T10:00:00+00:00"
banner = "RFD SiK 3.00MP"
multipoint = true
air_speed_kbps = 64
slot_s = 0.2
sync_s = 0.1
slot_bytes = 400.0
[[measurement]]
date = "2026-11-29T10:00:00+00:00"
banner = "RFD SiK 3.00MP"
multipoint = true
air_speed_kbps = 125
slot_s = 0.02
sync_s = 0.01
slot_bytes = 400.0
"""


def test_measured_timeslots_take_the_place_of_assumed_ones(tmp_path: Path) -> None:
    """Eleven slots of 0.2 s and a sync slot of 0.1 s are 2.3 s; 400 bytes a slot are 173.9 B/s."""
    file = tmp_path / "timing.toml"
    file.write_text(TIMING)
    answer = json.loads(run("10", "--timing", str(file), "--json", code=FAILED))
    assert answer["round_s"] == pytest.approx(2.3)
    assert answer["directions"][2]["capacity"] == pytest.approx(400 / 2.3)
    assert answer["timing"] == "measured on 2026-11-28 with RFD SiK 3.00MP"
    # a proposal for 125 kbit/s has what was measured there, where a round is 0.23 s
    assert any("air speed 125 kbit/s" in text for text in answer["proposals"])
    said = run("10", "--timing", str(file), "--air-speed", "125")
    assert "a round of 11 nodes: 230 ms (measured on 2026-11-29 with RFD SiK 3.00MP)" in said
    assert "(assumed, as open SiK multipoint)" in run("10")


def test_a_timing_file_that_does_not_go_with_the_options_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "timing.toml"
    said = run("10", "--timing", str(file), code=FAILED)
    assert "cannot be read: No such file" in " ".join(said.split())
    file.write_text(TIMING)
    said = " ".join(run("10", "--timing", str(file), "--air-speed", "250", code=FAILED).split())
    assert "was measured at AIR_SPEED 64, 125, and --air-speed is 250" in said
    assert "needs --air-speed" in run("10", "--timing", str(file), "--air-speed", "none", code=FAILED)
