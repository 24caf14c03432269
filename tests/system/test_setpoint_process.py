"""`skygcs-cli setpoint`, `track` and `table` as processes: standard input, Ctrl-C, and what they import."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.hanging import HANG_S

pytestmark = pytest.mark.system

TESTS = Path(__file__).parents[1]
CLI = [sys.executable, "-c", "from skygcs.cli.main import main; main()"]


class Served:
    """A fake daemon in a process of its own, which says what it is told."""

    def __init__(self, folder: Path) -> None:
        self.environment = {**os.environ, "SKYGCS_SOCKET": str(folder / "s.sock"), "COLUMNS": "120"}
        command = [sys.executable, "-m", "support.controlled", self.environment["SKYGCS_SOCKET"]]
        self._process = subprocess.Popen(command, cwd=TESTS, stdout=subprocess.PIPE, text=True)
        self.wait_for("ready")

    def wait_for(self, words: str) -> None:
        assert self._process.stdout is not None
        while self._process.stdout.readline().strip() != words:
            assert self._process.poll() is None

    def start(self, *args: str) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        return subprocess.Popen([*CLI, *args], env=self.environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def stop(self) -> None:
        self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    served = Served(tmp_path)
    yield served
    served.stop()


def test_a_program_piped_in_is_flown_to_its_end(served: Served) -> None:
    process = served.start("setpoint", "alpha", "--stdin", "--rate", "50")
    out, err = process.communicate('{"pos": [1, 2, 5]}\nnonsense\n{"pos": [1, 3, 5]}', timeout=HANG_S)
    assert process.returncode == 1
    assert out.startswith("2 setpoints in 0.") and "wrong lines: 1" in out
    assert "alpha stays where it is from 0.5 s after the last setpoint on" in out
    assert err.startswith("skygcs-cli: line 2: ")


def test_a_file_is_flown_at_a_rate(served: Served, tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text("x,y,z\n" + "".join(f"{i},0,5\n" for i in range(300)))
    with path.open("rb") as file:
        done = subprocess.run(
            [*CLI, "setpoint", "alpha", "--stdin", "--rate", "100", "--json"],
            env=served.environment,
            stdin=file,
            capture_output=True,
            text=True,
            timeout=HANG_S,
        )
    assert done.returncode == 0, done.stderr
    assert '"sent": 300,' in done.stdout


@pytest.mark.parametrize("args", [("--vel", "1", "0", "0"), ("--stdin",)])
def test_ctrl_c_ends_the_stream_and_says_what_the_vehicle_does(served: Served, args: tuple[str, ...]) -> None:
    process = served.start("setpoint", "alpha", *args, "--rate", "20")
    assert process.stdin is not None
    if args == ("--stdin",):
        process.stdin.write("1,2,5\n1,3,5\n")
        process.stdin.flush()
    served.wait_for("alpha setpoint")
    served.wait_for("alpha setpoint")  # sent once the first was answered
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 130
    assert "Traceback" not in err and "setpoint" in out
    assert "alpha stays where it is" in out


def test_ctrl_c_during_a_table_says_that_they_fly_on(served: Served, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("vehicle,final_x,final_y,final_z\nalpha,10,30,5\n")
    process = served.start("table", str(path), "final", "--arrive", "1e-9")
    served.wait_for("alpha goto")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 130 and "the vehicles fly on to their positions" in err


def test_registering_the_commands_imports_nothing_that_they_need() -> None:
    script = (
        "import sys\n"
        "import skygcs.cli.main\n"
        "heavy = ('numpy', 'matplotlib', 'csv', 'tomllib', 'skygcs.core', 'skygcs.cli.control',\n"
        "         'skygcs.cli.setpoint', 'skygcs.ext.plans.commands.table', 'skygcs.ext.logs.trace_plot')\n"
        "print([m for m in heavy if m in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=HANG_S, check=True)
    assert done.stdout.strip() == "[]"
