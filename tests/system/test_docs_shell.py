"""The shell examples of the pages, run in order against a daemon with simulated vehicles; `NOT_RUN` has the others.

A command that ends by itself has to exit 0. An order may also be refused by a vehicle, with a line for each: whether
one takes off depends on what came before it, and flights are flown elsewhere. The reader's own files are `FILES`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.process import FIELD_TOML, ROOT, DaemonProcess, wait_until
from support.shell_examples import PAGES, commands, label

pytestmark = pytest.mark.system

COMMAND_S = 300.0
"""Longest time of one command on a busy machine."""

PAGES_RUN = (
    "README.md",
    "docs/explanation/world-frame.md",
    "docs/howto/ground-station.md",
    "docs/howto/logs.md",
    "docs/howto/metrics.md",
    "docs/howto/missions.md",
    "docs/howto/parameters.md",
    "docs/howto/preflight.md",
    "docs/howto/radio.md",
    "docs/reference/gains.md",
    "docs/tutorial/first-flight.md",
)

PAGES_NOT_RUN = {
    "docs/explanation/plans.md": "the reader's goals; tests/unit/ext/plans/commands/test_cli_plan.py",
    "docs/howto/calibration.md": "a person who turns the vehicle",
    "docs/howto/clients.md": "test_docs_programs.py flies its pymavlink program on this link",
    "docs/howto/companion.md": "companions with SSH; tests/lab/test_companions_up.py and test_companion_process.py",
    "docs/howto/corrections.md": "a source of RTCM corrections; tests/integration/test_corrections.py",
    "docs/howto/federation.md": "a hub; tests/federation/test_processes.py",
    "docs/howto/fly-real-firmware.md": "autopilot firmware; make test-firmware",
    "docs/howto/fly-several.md": "files of the reader's; tests/integration/test_plan_flight.py",
    "docs/howto/fly-setpoints.md": "a flight; test_docs_programs.py flies by its program",
    "docs/howto/joystick.md": "a joystick; tests/system/test_joystick_process.py",
    "docs/howto/mavlink-router.md": "a configuration of mavlink-router",
    "docs/howto/motion-capture.md": "cameras; tests/integration/test_mocap.py",
    "docs/howto/own-controller.md": "the reader's own controller",
    "docs/howto/own-message.md": "a vehicle that sends a message of its own",
    "docs/howto/service.md": "systemd; tests/lab/test_systemd.py",
    "docs/howto/web.md": "a browser; tests/web",
    "docs/howto/xbee.md": "an XBee module; tests/system/test_xbee.py",
    "docs/reference/control-trace.md": "a trace of a flight",
    "docs/tutorial/box-of-parts.md": "the parts",
    "docs/tutorial/flight-control.md": "a flight of minutes, in wind; tests/system/test_control_process.py",
    "docs/tutorial/plans.md": "a flight of minutes; tests/system/test_plan_process.py",
}
"""Pages of whose commands none is run here, and what they need or where the like is run."""

NOT_RUN = {
    "skygcs demo --stay": "stays until Ctrl-C; make demo flies the same",
    "skygcs run": "runs until it is ended: the daemon of this test is one",
    "skygcs sim --udp": "runs until it is ended; tests/system/test_sim_process.py",
    "skygcs sim --pty": "runs until it is ended; tests/system/test_sim_process.py",
    "skygcs-cli events -f": "runs until Ctrl-C",
    "skygcs-cli fence test": "a person who says that the propellers are off; tests/unit/cli/test_cli_mission_flight.py",
    "skygcs-cli link plan 8 --timing": "the timing file of two radios; tests/system/test_radio_measure.py",
    "skygcs-cli link select": "a link with a radio",
    "skygcs-cli mission watch": "runs until Ctrl-C; tests/unit/cli/test_cli_mission_flight.py",
    "skygcs-cli message watch ATTITUDE": "runs until Ctrl-C",
    "skygcs-cli radio": "SiK radios; tests/system/test_radio_setup.py",
    "skygcs-cli tlog play": "takes as long as the flight did; tests/unit/cli/test_tlog_play.py",
    "skygcs-cli watch": "runs until Ctrl-C",
}
"""First words of a command on the pages that are run -> what it needs."""

ORDERS = (
    *("arm", "disarm", "goto", "land", "mode", "stop", "takeoff"),
    *("control set", "setpoint", "param apply", "mission current", "mission pause", "mission resume", "mission start"),
)
"""What may also exit 1: an order that a vehicle refuses, here because it stands, or has no such mode or parameter."""

FOLLOWED = ("docs/tutorial/first-flight.md",)
"""Pages whose reader has these vehicles and does as they say: no order may be refused, but for those of `REFUSED`."""

REFUSED = ("skygcs-cli goto alpha 0 0 10",)
"""What such a page shows to be refused."""

ANSWERS = ("fence status", "link plan", "param diff", "preflight")
"""What exits 1 for its answer: outside the fence, does not fit, different, not ready."""

FLEET = (
    FIELD_TOML
    + """
[links.field]
type = "simulated"
px4 = 2
ardupilot = 1
dynamics = "kinematic"

[vehicles.alpha]
sysid = 1

[vehicles.bravo]
sysid = 2

[vehicles.charlie]
sysid = 3
"""
)


SITE = [[43.7800, -79.4665], [43.7812, -79.4665], [43.7812, -79.4640], [43.7800, -79.4640]]


def _item(command: int, lat_deg: float, lon_deg: float, height_m: float) -> dict[str, Any]:
    params = [0, 0, 0, None, lat_deg, lon_deg, height_m]
    return {"type": "SimpleItem", "command": command, "frame": 3, "autoContinue": True, "params": params}


PLAN = {
    "fileType": "Plan",
    "version": 1,
    "groundStation": "QGroundControl",
    "mission": {
        "version": 2,
        "firmwareType": 12,
        "vehicleType": 2,
        "cruiseSpeed": 15,
        "hoverSpeed": 3,
        "plannedHomePosition": [43.7806, -79.4653, 180.0],
        "items": [_item(22, 43.7806, -79.4653, 8.0), *(_item(16, 43.7806 + n * 5e-5, -79.4653, 8.0) for n in range(5))],
    },
    "geoFence": {
        "version": 2,
        "circles": [],
        "polygons": [{"inclusion": True, "polygon": SITE, "version": 1}],
    },
    "rallyPoints": {"version": 2, "points": [[43.7805, -79.4653, 15.0]]},
}

TLOG = ROOT / "tests" / "data" / "sitl-3ardupilot-2px4.tlog"

FILES: dict[str, bytes] = {
    "field.plan": json.dumps(PLAN).encode(),
    "survey.plan": json.dumps(PLAN).encode(),
    "configs/survey.plan": (ROOT / "configs" / "survey.plan").read_bytes(),
    "site.plan": json.dumps(PLAN).encode(),
    "bravo.params": b"2\t1\tMPC_XY_CRUISE\t4.0\t9\n",
    "lab.param": b"RTL_RETURN_ALT,20\nRTL_ALT,2000\n",
    **dict.fromkeys(("flight.tlog", "left.tlog", "right.tlog"), TLOG.read_bytes()),
}
"""What the reader of the pages has in the folder; a name with "…" is the newest that matches it."""


NEWEST = re.compile(r"\$\(ls -t (\S+) \| head -1\)")


def as_typed(words: list[str], folder: Path) -> list[str]:
    """The words with the names of files that a page cannot know: `logs/….tlog`, `$(ls -t logs/*.tlog | head -1)`."""
    newest = (NEWEST.sub(r"\1", word).replace("…", "*") for word in words)
    return [str(max(folder.glob(word))) if word.startswith("logs/") and "*" in word else word for word in newest]


def reason(command: str) -> str | None:
    """Why it is not run here."""
    return next((why for words, why in NOT_RUN.items() if f"{command} ".startswith(f"{words} ")), None)


def lines(page: str) -> list[str]:
    return [" ".join(words) for words in commands(ROOT / page)]


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[DaemonProcess]:
    for name, content in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    with DaemonProcess(tmp_path, FLEET, name="lab") as daemon:
        wait_until(lambda: daemon.known() == 3, "three vehicles are known")
        wait_until(
            lambda: all((v["position"] or {}).get("enu_m") for v in daemon.vehicles().values()), "they have positions"
        )
        yield daemon


def test_every_page_of_the_table_has_commands() -> None:
    assert {*PAGES_RUN, *PAGES_NOT_RUN} - {label(page) for page in PAGES if list(commands(page))} == set()


def test_nothing_is_left_out_that_is_not_there() -> None:
    known = [line for page in PAGES_RUN for line in lines(page)]
    assert [words for words in NOT_RUN if not any(f"{line} ".startswith(f"{words} ") for line in known)] == []


@pytest.mark.parametrize("page", PAGES_RUN)
def test_the_commands_of_the_page_do_what_they_do_there(page: str, daemon: DaemonProcess) -> None:
    environment = {**os.environ, "SKYGCS_SOCKET": str(daemon.socket)}
    if "--fleet fleet.toml" in " ".join(lines(page)):
        (daemon.folder / "fleet.toml").write_text(FLEET)
    for words in commands(ROOT / page):
        if reason(" ".join(words)) is not None:
            continue
        done = subprocess.run(
            [str(Path(sys.executable).with_name(words[0])), *as_typed(words[1:], daemon.folder)],
            cwd=daemon.folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=COMMAND_S,
        )
        said = f"{shlex.join(words)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        order = any(f"{' '.join(words[1:])} ".startswith(f"{first} ") for first in (*ORDERS, *ANSWERS))
        expected: tuple[int, ...] = (0, 1) if order else (0,)
        if page in FOLLOWED:
            expected = (1,) if " ".join(words) in REFUSED else (0,)
        assert done.returncode in expected, said
        assert "Traceback" not in done.stderr, said
        assert not re.search(r"no such method|no method|internal error|failed inside the daemon", said), said
        assert done.returncode == 0 or done.stdout or done.stderr, said
    assert "Traceback" not in daemon.stderr
