"""Radios on ptys set up by the real command line, in real time; one of them lent by a real daemon."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import serial

from skygcs.sim.at_modem import AtRadio, Faults
from support.at_pty import on_a_pty
from support.hanging import HANG_S
from support.process import DaemonProcess, cli_at, wait_until

pytestmark = pytest.mark.system
"""Guard times and restarts are real: a visit takes four seconds, a change nine."""

CLI = str(Path(sys.executable).with_name("skygcs-cli"))


def cli(folder: Path, *words: str | Path, code: int = 0) -> str:
    """`skygcs-cli radio WORDS`, beside no daemon; what it printed."""
    return cli_at(folder / "nobody.sock", "radio", *words, code=code)


def test_a_radio_is_backed_up_changed_and_restored_at_another_rate(tmp_path: Path) -> None:
    port, file = tmp_path / "ttyRADIO", tmp_path / "radio.toml"
    with on_a_pty(port, AtRadio()) as radio:
        cli(tmp_path, "backup", port, file)
        told = cli(tmp_path, "set", port, "NETID=7", "SERIAL_SPEED=115")
        assert "written, saved, restarted and read back: all as wanted" in told
        assert (radio.saved[3], radio.baud) == (7, 115200)
        cli(tmp_path, "restore", port, file, "--baud", "115200")
        assert (radio.saved[3], radio.baud, radio.command_mode) == (0, 57600, False)


def test_two_radios_are_provisioned_and_the_one_that_fails_is_told_from_the_other(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text("[vehicles.alpha]\nsysid = 1\n")
    ground, air = tmp_path / "ttyGROUND", tmp_path / "ttyAIR"
    bad = AtRadio(faults=Faults(refuses=frozenset({"DUTY_CYCLE"})))
    with on_a_pty(ground, AtRadio()) as master, on_a_pty(air, bad):
        words = ("provision", tmp_path / "fleet.toml", ground, air, "--duty-cycle", "90")
        told = cli(tmp_path, *words, "--json", code=1)
        radios = json.loads(told)["radios"]
        assert [r["ok"] for r in radios] == [True, False]
        assert radios[1]["messages"] == [
            "the radio refused DUTY_CYCLE=90 (S11)",
            "nothing was saved; the radio was restarted and is as it was",
        ]
        assert (master.saved[24], master.node_table) == (1, {0: (0, 2)})
        assert bad.saved[24] == 2


def test_antennas_are_shown_set_and_provisioned(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text("[vehicles.alpha]\nsysid = 1\n")
    ground, air, file = tmp_path / "ttyGROUND", tmp_path / "ttyAIR", tmp_path / "air.toml"
    with on_a_pty(ground, AtRadio()) as master, on_a_pty(air, AtRadio()) as vehicle:
        assert "ANT_MODE           0 (both antennas, the better one)" in cli(tmp_path, "show", air)
        words = ("--antennas", "2", "--ground-antennas", "tx1-rx2")
        cli(tmp_path, "provision", tmp_path / "fleet.toml", ground, air, *words)
        assert (master.saved[20], vehicle.saved[20]) == (3, 2)
        cli(tmp_path, "backup", air, file)
        assert "ANT_MODE" in file.read_text() and "# S20, antenna 2 only" in file.read_text()
        cli(tmp_path, "set", air, "ANT_MODE=both")
        assert vehicle.saved[20] == 0
        shown = json.loads(cli(tmp_path, "show", ground, "--json"))
        (entry,) = (r for r in shown["registers"] if r["name"] == "ANT_MODE")
        assert (entry["value"], entry["meaning"]) == (3, "sends by 1, receives by 2")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_in_the_middle_leaves_the_radio_as_it_was_and_says_how_far_it_came(
    tmp_path: Path, how: signal.Signals
) -> None:
    port = tmp_path / "ttyRADIO"
    with on_a_pty(port, AtRadio()) as radio:
        work = subprocess.Popen(
            [CLI, "radio", "set", str(port), "NETID=7", "AIR_SPEED=125"],
            env={**os.environ, "SKYGCS_SOCKET": str(tmp_path / "nobody.sock")},
            stderr=subprocess.PIPE,
            text=True,
        )
        radio.faults.dies_at = "ATS2="
        wait_until(lambda: "ATS2=125" in radio.commands, "the second setting is being written")
        radio.faults.silent = False
        time.sleep(0.1)
        work.send_signal(how)
        _, told = work.communicate(timeout=HANG_S)
        assert work.returncode == 130
        assert "interrupted" in told
        assert "written: NETID; perhaps written: AIR_SPEED" in " ".join(told.split())
        wait_until(lambda: radio.restarts == 1, "the radio was restarted")
        assert radio.live[3] == 0


def test_a_port_in_use_by_another_program_is_left_alone(tmp_path: Path) -> None:
    port = tmp_path / "ttyRADIO"
    with on_a_pty(port, AtRadio()) as radio, serial.Serial(str(port), 57600, exclusive=True):
        assert "in use by another program" in cli(tmp_path, "set", port, "NETID=7", code=1)
    assert radio.traffic == b""


def test_a_wrong_rate_is_told_with_those_left_to_try(tmp_path: Path) -> None:
    port = tmp_path / "ttyRADIO"
    with on_a_pty(port, AtRadio(saved={1: 115})) as radio:
        told = cli(tmp_path, "set", port, "NETID=7", "--baud", "57600", code=1)
        assert "no answer to +++ (57600 baud: silence)" in told
        assert "another rate? Not tried: 115200, 38400, 230400, 19200, 9600 (--baud)" in told
        assert "nothing was changed" in told
        assert "115200 baud" in cli(tmp_path, "show", port)  # left to itself it finds the rate
    assert radio.saved[3] == 0


def test_a_radio_without_power_is_told_from_a_wrong_rate(tmp_path: Path) -> None:
    port = tmp_path / "ttyRADIO"
    with on_a_pty(port, AtRadio(faults=Faults(silent=True))):
        told = cli(tmp_path, "set", port, "NETID=7", code=1)
    assert all(f"{rate} baud: silence" in told for rate in (57600, 115200, 9600))
    assert "is it powered, is this its port, are TX and RX swapped?" in told
    assert "another rate" not in told
    assert "nothing was changed" in told


@pytest.mark.parametrize(
    ("faults", "said", "then"),
    [
        (
            Faults(restarts_at="ATS2="),
            "stopped answering at AIR_SPEED=125",
            "nothing was saved; the radio was restarted",
        ),
        (Faults(restarts_at="AT&W"), "did not answer to the save", "nothing was saved; the radio was restarted"),
        (Faults(dies_at="ATS2="), "stopped answering at AIR_SPEED=125", "written: NETID; perhaps written: AIR_SPEED"),
    ],
)
def test_a_radio_that_resets_in_the_middle_is_told_with_how_it_stands(
    faults: Faults, said: str, then: str, tmp_path: Path
) -> None:
    port = tmp_path / "ttyRADIO"
    with on_a_pty(port, AtRadio(faults=faults)) as radio:
        told = cli(tmp_path, "set", port, "NETID=7", "AIR_SPEED=125", code=1)
        assert said in told and then in told
        assert "requested: NETID 0 -> 7" in told
        assert radio.saved[3] == 0


def test_a_value_that_the_radio_refuses_leaves_it_as_it_was(tmp_path: Path) -> None:
    port = tmp_path / "ttyRADIO"
    with on_a_pty(port, AtRadio(faults=Faults(refuses=frozenset({"TXPOWER"})))) as radio:
        told = cli(tmp_path, "set", port, "NETID=7", "TXPOWER=20", code=1)
        assert "the radio refused TXPOWER=20 (S4)" in told
        assert "nothing was saved; the radio was restarted and is as it was" in told
        assert (radio.saved[3], radio.live[3]) == (0, 0)


def test_two_nodes_with_one_id_are_told_with_what_to_do(tmp_path: Path) -> None:
    ground, first, second = (tmp_path / name for name in ("ttyGROUND", "ttyONE", "ttyTWO"))
    radios = [AtRadio(unique_id=f"0x{node}") for node in range(3)]
    for radio, node in zip(radios, (1, 2, 2), strict=True):
        radio.renumber(node)
    with on_a_pty(ground, radios[0]), on_a_pty(first, radios[1]), on_a_pty(second, radios[2]):
        told = cli(tmp_path, "diff", ground, first, second, code=1)
        assert f"node id 2 is in 2 radios ({first}, {second}): their frames collide" in told
        assert "skygcs-cli radio set PORT NODEID=N" in told
        told = cli(tmp_path, "set", second, "NODEID=3")
        assert "no other radio of this network may have node id 3" in told
        assert [radio.saved[24] for radio in radios] == [1, 2, 3]


def test_the_radio_before_simulated_vehicles_is_set_up_as_a_real_one(tmp_path: Path) -> None:
    port = tmp_path / "ttyRADIO"
    skygcs = str(Path(CLI).with_name("skygcs"))
    words = ("sim", "--pty", str(port), "--px4", "2", "--ardupilot", "0", "--radio", "64,nodes=5")
    with subprocess.Popen([skygcs, *words], stdout=subprocess.DEVNULL) as sim:
        try:
            wait_until(port.exists, "the port is there")
            told = cli(tmp_path, "show", port, "--remote", "3")
            assert "RFD900x multipoint), answers at 57600 baud" in told
            assert "S24  NODEID             3" in told
        finally:
            sim.terminate()


def test_a_daemon_lends_its_radio_and_has_it_back(tmp_path: Path) -> None:
    port = tmp_path / "ttyRADIO"
    toml = f'heartbeat = false\n[links.radio]\ntype = "serial"\ndevice = "{port}"\nrole = "radio"\n'
    with on_a_pty(port, AtRadio()) as radio, DaemonProcess(tmp_path, toml) as daemon:
        wait_until(lambda: daemon.call("links.list")[0]["state"] == "up", "the link is up")
        done = daemon.cli("radio", "set", str(port), "DUTY_CYCLE=50")
        assert done.returncode == 0, done.stderr
        assert "link radio: closed in the daemon for now" in done.stderr
        assert radio.saved[11] == 50
        wait_until(lambda: daemon.call("links.list")[0]["state"] == "up", "the link is up again")
