"""The shell examples of the pages, run in order against a daemon with simulated vehicles; `NOT_RUN` has the others.

A command that ends by itself has to exit 0. An order may also be refused by a vehicle, with a line for each: whether
one takes off depends on what came before it, and flights are flown elsewhere.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.process import ROOT, DaemonProcess, wait_until
from support.shell_examples import PAGES, commands, label

pytestmark = pytest.mark.system

COMMAND_S = 300.0
"""Longest time of one command on a busy machine."""

PAGES_RUN = (
    "docs/explanation/world-frame.md",
    "docs/howto/ground-station.md",
    "docs/howto/metrics.md",
    "docs/howto/radio.md",
)

PAGES_NOT_RUN = {
    "README.md": "flights and the reader's files; its program is flown in test_docs_programs.py",
    "docs/explanation/plans.md": "the reader's goals; tests/unit/cli/test_cli_plan.py",
    "docs/howto/calibration.md": "a person who turns the vehicle",
    "docs/howto/clients.md": "test_docs_programs.py flies its pymavlink program on this link",
    "docs/howto/companion.md": "a vehicle's computer; tests/system/test_companion_process.py",
    "docs/howto/companions-bring-up.md": "companions with SSH; tests/lab/test_companions_up.py",
    "docs/howto/corrections.md": "a source of RTCM corrections; tests/integration/test_corrections.py",
    "docs/howto/fly-plans.md": "a plan of the reader's; tests/integration/test_plan_flight.py",
    "docs/howto/fly-real-firmware.md": "autopilot firmware; make test-firmware",
    "docs/howto/fly-setpoints.md": "a flight; test_docs_programs.py flies by its program",
    "docs/howto/joystick.md": "a joystick; tests/system/test_joystick_process.py",
    "docs/howto/logs.md": "the reader's logs; tests/unit/tlog",
    "docs/howto/mavlink-router.md": "a configuration of mavlink-router",
    "docs/howto/missions.md": "a flight; tests/integration/test_mission_flights.py",
    "docs/howto/motion-capture.md": "cameras; tests/integration/test_mocap.py",
    "docs/howto/own-controller.md": "the reader's own controller",
    "docs/howto/own-message.md": "a vehicle that sends a message of its own",
    "docs/howto/parameters.md": "the reader's parameter files; tests/unit/cli/test_cli_params.py",
    "docs/howto/preflight.md": "vehicles that are ready, which takes time",
    "docs/howto/radio-setup.md": "SiK radios; tests/system/test_radio_setup.py",
    "docs/howto/service.md": "systemd; tests/lab/test_systemd.py",
    "docs/howto/tables.md": "a table of the reader's",
    "docs/howto/trajectories.md": "a trajectory of the reader's; tests/integration/test_trajectory_flight.py",
    "docs/howto/web.md": "a browser; tests/web",
    "docs/howto/xbee.md": "an XBee module; tests/system/test_xbee.py",
    "docs/reference/cli.md": "flights",
    "docs/reference/control-trace.md": "a trace of a flight",
    "docs/reference/gains.md": "no daemon; tests/unit/cli/test_cli_gains.py",
    "docs/tutorial/box-of-parts.md": "the parts",
}
"""Pages of whose commands none is run here, and what they need or where the like is run."""

NOT_RUN = {
    "skygcs sim --pty": "runs until it is ended; tests/system/test_sim_process.py",
    "skygcs-cli events -f": "runs until Ctrl-C",
    "skygcs-cli link select": "a link with a radio",
}
"""First words of a command on the pages that are run -> what it needs."""

ORDERS = ("goto",)
"""What may also exit 1: an order that a vehicle refuses, here because it stands."""

FLEET = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0

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


def reason(command: str) -> str | None:
    """Why it is not run here."""
    return next((why for words, why in NOT_RUN.items() if f"{command} ".startswith(f"{words} ")), None)


def lines(page: str) -> list[str]:
    return [" ".join(words) for words in commands(ROOT / page)]


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[DaemonProcess]:
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


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", PAGES_RUN)
def test_the_commands_of_the_page_do_what_they_do_there(page: str, daemon: DaemonProcess) -> None:
    environment = {**os.environ, "SKYGCS_SOCKET": str(daemon.socket)}
    for words in commands(ROOT / page):
        if reason(" ".join(words)) is not None:
            continue
        done = subprocess.run(
            [str(Path(sys.executable).with_name(words[0])), *words[1:]],
            cwd=daemon.folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=COMMAND_S,
        )
        said = f"{shlex.join(words)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        order = any(" ".join(words[1:]).startswith(first) for first in ORDERS)
        assert done.returncode in ((0, 1) if order else (0,)), said
        assert "Traceback" not in done.stderr, said
        assert not re.search(r"no such method|no method|internal error|failed inside the daemon", said), said
        assert done.returncode == 0 or done.stdout or done.stderr, said
    assert "Traceback" not in daemon.stderr
