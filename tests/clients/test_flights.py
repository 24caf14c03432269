"""A program that fails or hangs is shown with what it said, and leaves nothing behind."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from clients import flights
from support.process import wait_until

pytestmark = pytest.mark.system

PROGRAM = """
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
print('{"step": "connected"}', flush=True)
print(child.pid, file=sys.stderr, flush=True)
if sys.argv[1] == "hang":
    time.sleep(600)
if sys.argv[1] == "fail":
    raise SystemExit("never happened: armed")
if sys.argv[1] == "fly":
    print('{"step": "done"}', flush=True)
"""


@dataclass(frozen=True)
class Kite:
    python: Path = Path(sys.executable)


def gone(folder: Path) -> bool:
    """Whether the program's child has ended; a zombie that nobody waits for has."""
    pid = (folder / "program.log").read_text().split()[0]
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["hang"], 'kite ended with -9:\n{"step": "connected"}'),
        (["fail"], "never happened: armed"),
        (["stop"], 'kite ended with 0:\n{"step": "connected"}'),  # without reaching its own end
        (["fly"], ""),
    ],
)
def test_a_program_is_ended_with_all_it_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.setattr(flights, "CLIENTS", {"kite": Kite()})
    monkeypatch.setattr(flights, "PROGRAMS", tmp_path)
    monkeypatch.setattr(flights, "FLIGHT_LIMIT_S", 3.0 if words == ["hang"] else 600.0)
    (tmp_path / "kite_flight.py").write_text(PROGRAM)
    if said:
        with pytest.raises(AssertionError) as failed:
            flights.fly("kite", words, tmp_path)
        assert said in str(failed.value)
    else:
        assert flights.fly("kite", words, tmp_path).order == ["connected", "done"]
    wait_until(lambda: gone(tmp_path), "its child has ended")
