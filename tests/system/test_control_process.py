"""`skygcs-cli` as a process: pipes, signals, completion, and a daemon that dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from skygcs.cli.options import WAIT_VARIABLE
from support.hanging import HANG_S

pytestmark = pytest.mark.system

TESTS = Path(__file__).parents[1]
CLI = [sys.executable, "-c", "from skygcs.cli.main import main; main()"]


class Served:
    """A fake daemon in a process of its own."""

    def __init__(self, folder: Path) -> None:
        own = {"SKYGCS_SOCKET": str(folder / "s.sock"), "COLUMNS": "120", WAIT_VARIABLE: "60"}
        self.environment = {**os.environ, **own}
        command = [sys.executable, "-m", "support.fake_daemon", self.environment["SKYGCS_SOCKET"]]
        self.daemon = subprocess.Popen(command, cwd=TESTS, stdout=subprocess.PIPE, text=True)
        assert self.daemon.stdout is not None
        while self.daemon.stdout.readline().strip() != "ready":
            assert self.daemon.poll() is None

    def start(self, *args: str, **environment: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*CLI, *args],
            env={**self.environment, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *args: str, **environment: str) -> tuple[int, str, str]:
        process = self.start(*args, **environment)
        out, err = process.communicate(timeout=HANG_S)
        return process.returncode, out, err

    def stop(self) -> None:
        self.daemon.kill()
        self.daemon.wait()
        assert self.daemon.stdout is not None
        self.daemon.stdout.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(tmp_path_factory.mktemp("cli"))
    yield served
    served.stop()


def test_results_go_to_stdout_and_errors_to_stderr(served: Served) -> None:
    code, out, err = served.run("arm", "all")
    assert (code, err) == (1, "") and "FAIL carol" in out
    code, out, err = served.run("arm", "nobody")
    assert (code, out) == (1, "") and err.startswith("skygcs-cli: no vehicle 'nobody'")


@pytest.mark.parametrize(
    "args", [("message", "list"), ("watch", "--rate", "20"), ("message", "watch"), ("events", "-f")]
)
def test_a_reader_that_leaves_ends_it_quietly(served: Served, args: tuple[str, ...]) -> None:
    process = served.start(*args)
    assert process.stdout is not None and process.stderr is not None
    assert process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    assert process.wait(HANG_S) == 0


@pytest.mark.parametrize("args", [("watch",), ("message", "watch"), ("events", "-f")])
def test_ctrl_c_ends_it_quietly(served: Served, args: tuple[str, ...]) -> None:
    process = served.start(*args)
    assert process.stdout is not None
    assert process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=HANG_S)
    assert (process.returncode, err) == (130, "")


def test_a_daemon_that_dies_is_said(tmp_path: Path) -> None:
    served = Served(tmp_path)
    process = served.start("watch")
    assert process.stdout is not None
    process.stdout.readline()
    served.stop()
    _, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 3 and "no skygcs daemon" in err and "Traceback" not in err
    assert served.run("status")[0] == 3  # the dead daemon's socket is still there


@pytest.mark.parametrize(
    ("words", "proposed"),
    [
        ("arm ", {"all", "alpha", "bravo", "carol", "red"}),
        ("arm alpha,b", {"alpha,bravo"}),
        ("message watch HEARTB", {"HEARTBEAT"}),
        ("mode alpha AUTO.R", {"AUTO.RTL"}),
        ("command alpha DO_SET_SERV", {"DO_SET_SERVO"}),
        ("links remove r", {"radio"}),
        ("call vehicles.l", {"vehicles.land", "vehicles.list"}),
    ],
)
def test_the_shell_is_told_what_may_come_next(served: Served, words: str, proposed: set[str]) -> None:
    line = f"skygcs-cli {words}"
    count = str(len(line.split()) - (not line.endswith(" ")))
    _, out, err = served.run(_SKYGCS_CLI_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=count)
    assert set(out.split()) == proposed, err


def test_completion_is_silent_without_a_daemon(served: Served, tmp_path: Path) -> None:
    code, out, err = served.run(
        _SKYGCS_CLI_COMPLETE="complete_bash",
        COMP_WORDS="skygcs-cli arm a",
        COMP_CWORD="2",
        SKYGCS_SOCKET=str(tmp_path / "nobody"),
    )
    assert (out.split(), err) == (["all"], "") and code == 0


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_has_a_completion_script(served: Served, shell: str) -> None:
    _, out, _ = served.run(_SKYGCS_CLI_COMPLETE=f"source_{shell}")
    assert "skygcs-cli" in out and "_SKYGCS_CLI_COMPLETE" in out


def test_status_needs_no_numpy_and_json_no_rich(served: Served) -> None:
    code = (
        "import sys; sys.argv = ['skygcs-cli', 'status', '--json']\n"
        "from skygcs.cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print([m for m in ('numpy', 'rich', 'structlog', 'pymavlink', 'uvloop') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=served.environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"
