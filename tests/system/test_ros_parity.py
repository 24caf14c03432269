"""docs/reference/ros-parity.md, run as it is written: every command of its tables, in their order, is one flight."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from support.process import ROOT, DaemonProcess, wait_until

pytestmark = pytest.mark.system

PAGE = (ROOT / "docs" / "reference" / "ros-parity.md").read_text(encoding="utf-8")
ITEM = re.compile(
    r"- (?P<experiment>.*?): (?P<commands>(?:(?: and )?`skygcs[^`]*`)+)(?: → (?P<then>(?:[^`.]|`[^`]*`)*))?\."
)
"""One line of the list: an experiment, the commands for it, and what shows that they did the same."""
VEHICLES = ("alpha", "bravo", "charlie")
SHOWN_PATIENCE_S = 90.0
"""How long a vehicle may take to show what it was ordered: most of it is its landing from 3 m."""

EXPERIMENT = re.findall(
    r"\S+",
    """
/mavlink/from /mavros/state /mavros/imu/data /mavros/gpsstatus/gps1/raw /mavros/global_position/local
/mavros/global_position/raw/fix /mavros/setpoint_raw/local /mavros/setpoint_raw/attitude /mavros/global_position/home
/mavros/cmd/arming set_mode /mavros/cmd/command /mavros/cmd/set_home cmd/takeoff mavros.cpp tgt_system tgt_component
roslaunch rostopic AUTO.TAKEOFF AUTO.LAND AUTO.RTL AUTO.LOITER OFFBOARD
connect( wait_ready rate=4 SYSID_THISMAV SYSID_MYGCS fix_type satellites_visible attitude.roll location.global_frame
vehicle.velocity vehicle.heading system_status.state
mavlink_connection wait_heartbeat target_system request_data_stream_send x25crc start_time uptime flightmode sysid_state
waypoint_request_list_send waypoint_request_send MISSION_COUNT MISSION_ITEM SYSTEM_TIME ATTITUDE GPS_RAW_INT
GLOBAL_POSITION_INT HEARTBEAT BATTERY_STATUS HL_FAILURE_FLAG STATUSTEXT MISSION_CURRENT MISSION_ACK COMMAND_ACK
POSITION_TARGET_GLOBAL_INT POSITION_TARGET_LOCAL_NED SERVO_OUTPUT_RAW LOCAL_POSITION_NED DO_SET_MODE arducopter_arm
arducopter_disarm MAVWPLoader waypoint_clear_all_send waypoint_count_send MISSION_REQUEST NAV_TAKEOFF MISSION_START
0b10011111000 0b010111000000 0b110000111111 write_csv
DigiMeshDevice read_data send_data_broadcast tmux
COM_RC_IN_MODE NAV_RCL_ACT Odroid AT&M0 SiK SERIAL2_PROTOCOL set_stream_rate Autotune calibration
K_Px K_Pv K_Iv px4_sitl_default multi_uav_mavros_sitl.launch px4_multidrone_pos_controller_outdoor
utias.xml mavgenerate uORB mavlink_messages.cpp
""",
)
"""What the experiment's sections 2, 3, 4.1, 4.5, 5.1, 6 and 7.1 to 7.5 call, publish, subscribe to, set and read."""


@dataclass(frozen=True)
class Check:
    """`position.alt_rel_m > 2`: what a vehicle's state tells."""

    path: str
    operator: str
    wanted: Any
    tolerance: float

    @classmethod
    def of(cls, text: str) -> Check:
        match = re.fullmatch(r"([\w.]+) (=|!=|<|>) (.+?)(?: ± ([\d.]+))?", text)
        assert match is not None, f"not a check of the state: {text}"
        return cls(match[1], match[2], json.loads(match[3]), float(match[4] or 0))

    def holds(self, state: Any) -> bool:
        for key in self.path.split("."):
            if state is None:
                break
            state = state[int(key)] if isinstance(state, list) else state.get(key)
        if self.operator == "=":
            return self._same(state, self.wanted)
        if self.operator == "!=":
            return bool(state != self.wanted)
        return state is not None and bool(state < self.wanted if self.operator == "<" else state > self.wanted)

    def _same(self, reported: Any, wanted: Any) -> bool:
        if isinstance(wanted, list):
            return isinstance(reported, list) and all(self._same(t, w) for t, w in zip(reported, wanted, strict=True))
        if self.tolerance:
            return reported is not None and abs(reported - wanted) <= self.tolerance
        return bool(reported == wanted)


@dataclass(frozen=True)
class Row:
    """One item of the page's lists, taken apart."""

    experiment: str
    commands: list[str]
    checks: list[Check]
    prints: str
    refused: str

    @classmethod
    def of(cls, line: str) -> Row:
        match = ITEM.match(line)
        assert match is not None, line
        then = match["then"] or ""
        prints, refused = (re.search(rf"{word} `([^`]+)`", then) for word in ("prints", "refused:"))
        state = re.sub(r"(prints|refused:) `[^`]+`", "", then)
        return cls(
            match["experiment"],
            re.findall(r"`([^`]+)`", match["commands"]),
            [Check.of(text) for text in re.findall(r"`([^`]+)`", state)],
            prints[1] if prints else "",
            refused[1] if refused else "",
        )

    @property
    def vehicles(self) -> list[str]:
        """Whose state tells: those the commands name, or else all of them."""
        named = [name for name in VEHICLES if re.search(rf"\b{name}\b", " ".join(self.commands))]
        return named or list(VEHICLES)


FLOWN, OTHERWISE = (
    re.findall(r"^- .*$", part, re.M) for part in PAGE.replace("\n  ", " ").split("\n## Done otherwise")
)
ROWS = [Row.of(item) for item in FLOWN]


def write_examples(folder: Path) -> None:
    """The files that the page's commands read, from the page and the checkout."""
    for name in ("configs", "dialects"):
        (folder / name).symlink_to(ROOT / name)
    for name, content in re.findall(r"`([\w.]+)` of the example.*?```\w+\n(.*?)```", PAGE, re.DOTALL):
        (folder / name).write_text(content, encoding="utf-8")


def simulated_fleet() -> str:
    """configs/sim.toml without its ports and folders."""
    parts = (ROOT / "configs" / "sim.toml").read_text(encoding="utf-8").split("\n\n")
    kept = [part for part in parts if re.search(r"^\[(origin|links\.field|vehicles\.\w+)\]", part, re.MULTILINE)]
    assert len(kept) == 2 + len(VEHICLES)
    return "\n\n".join(kept)


def run(command: str) -> tuple[int, str]:
    """Exit code and all that it printed. In this process where that is the same: interpreters that start would be most
    of the test's time."""
    words = shlex.split(command)
    if words[0] == "skygcs-cli" and "<" not in words:
        result = CliRunner().invoke(app, words[1:])
        assert result.exception is None or isinstance(result.exception, SystemExit), repr(result.exception)
        return result.exit_code, result.output
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(["bash", "-c", command], env=os.environ | {"PATH": path}, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def wait_for(check: Check, vehicle: str, daemon: DaemonProcess, label: str) -> None:
    deadline = time.monotonic() + SHOWN_PATIENCE_S
    while not check.holds(state := daemon.call("vehicles.get", target=vehicle)):
        section = state.get(check.path.split(".")[0])
        assert time.monotonic() < deadline, f"{label}: {vehicle} never showed {check}; it told {section}"
        time.sleep(0.05)


def test_every_command_of_the_page_does_what_the_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_examples(tmp_path)
    with DaemonProcess(tmp_path, simulated_fleet()) as daemon:
        wait_until(
            lambda: (
                {n: v["position"] and v["position"]["alt_rel_m"] is not None for n, v in daemon.vehicles().items()}
                == dict.fromkeys(VEHICLES, True)
            ),
            "all vehicles know where they are",
        )
        monkeypatch.chdir(tmp_path)
        monkeypatch.setenv("SKYGCS_SOCKET", str(daemon.socket))
        for row in ROWS:
            fly(row, daemon)


def fly(row: Row, daemon: DaemonProcess) -> None:
    """Run a row's commands, and look whether what it says came true."""
    label = f"{row.experiment}: {row.commands}"
    reported = ""
    for command in row.commands:
        code, output = run(command)
        reported += output
        assert code == (1 if row.refused else 0), f"{command}: exit {code}: {reported}"
        assert "Traceback" not in reported, reported
    assert row.prints in reported and row.refused in reported, f"{label} told {reported}"
    for vehicle in row.vehicles:
        for check in row.checks:
            wait_for(check, vehicle, daemon, label)


def test_every_row_has_a_command_and_something_to_see_it_by() -> None:
    assert len(ROWS) > 50
    assert [row.experiment for row in ROWS if not row.commands] == []
    dumb = [row.commands[0] for row in ROWS if not (row.checks or row.prints or row.refused)]
    assert len(dumb) <= 2, dumb


@pytest.mark.parametrize("name", EXPERIMENT)
def test_everything_the_experiment_called_is_on_the_page(name: str) -> None:
    assert any(name in text for text in (*(row.experiment for row in ROWS), *OTHERWISE))
