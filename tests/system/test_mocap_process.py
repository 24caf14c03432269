"""The capture process itself: a recording through a pipe, a package that hangs, and the end of its parent."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.events import Event
from skygcs.ext.mocap.capture_process import CaptureProcess
from skygcs.ext.mocap.config import MocapConfig
from skygcs.ext.mocap.recording import CaptureFrameData, frame_lines

pytestmark = pytest.mark.system

BODY = ((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))

FAKE = """
import time
class _Rotation: w, x, y, z = 1.0, 0.0, 0.0, 0.0
class _Body:
    def __init__(self, n): self.name, self.position, self.rotation = "a", [1.0 + n / 1000, 2.0, 0.5], _Rotation()
class _System:
    n = 0
    def waitForNextFrame(self):
        time.sleep(0.01 if self.n < 50 else 3600)  # then it hangs, as a cable that was pulled out
        self.n += 1
        print("library noise on standard output", flush=True)
    @property
    def rigidBodies(self): return {"a": _Body(self.n), "b": _Body(self.n)}
def connect(kind, config):
    if config["hostname"] == "dead": time.sleep(3600)
    if config["hostname"] == "refused": raise RuntimeError("no such host")
    return _System()
"""


class Heard:
    def __init__(self) -> None:
        self.frames: list[CaptureFrameData] = []
        self.delays: list[float] = []
        self.events: list[Event] = []

    def on_frame(self, frame: CaptureFrameData, now: float) -> None:
        self.frames.append(frame)
        self.delays.append(now - frame.at)

    def changes(self) -> list[str]:
        return [event.data["change"] for event in self.events]


@asynccontextmanager
async def child(heard: Heard, command: list[str] | None = None, **mocap: Any) -> AsyncIterator[CaptureProcess]:
    config = MocapConfig.model_validate({"bodies": {"alpha": "a"}, **mocap})
    made = CaptureProcess(config, asyncio.get_running_loop(), heard.on_frame, heard.events.append, command=command)
    running = asyncio.create_task(made.run())
    try:
        yield made
    finally:
        running.cancel()
        made.close()
        await asyncio.gather(running, return_exceptions=True)


async def until(met: Any) -> None:
    for _ in range(5000):  # against hanging for ever
        if met():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("it did not happen")


@pytest.fixture
def fake_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "motioncapture.py").write_text(FAKE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


async def test_a_process_is_waited_for_also_by_a_task_that_is_cancelled_again(fake_package: None) -> None:
    """A second cancellation found it in its `finally`: the loop was closed on a process that nobody had waited for."""
    heard = Heard()
    config = MocapConfig.model_validate({"bodies": {"alpha": "a"}, "type": "vicon", "host": "dead"})
    made = CaptureProcess(config, asyncio.get_running_loop(), heard.on_frame, heard.events.append)
    running = asyncio.create_task(made.run())
    await until(lambda: made.status()["pid"] is not None)
    process = made._process
    assert process is not None
    for _ in range(3):
        running.cancel()
        await asyncio.sleep(0)
    await asyncio.gather(running, return_exceptions=True)
    assert process.returncode == -signal.SIGKILL


async def test_a_recording_comes_through_and_ends(tmp_path: Path) -> None:
    file = tmp_path / "r.jsonl"
    file.write_bytes(b"".join(frame_lines(5.0 + 0.01 * n, {"a": BODY, "other": BODY})[0] for n in range(50)))
    heard = Heard()
    async with child(heard, type="recorded", file=file) as process:
        await until(lambda: process.state == "ended")
        assert len(heard.frames) + process.skipped == 50
        assert all(set(frame.bodies) == {"a"} for frame in heard.frames)  # the others are not named
        assert min(heard.delays) > -0.01  # the clock of the process is that of the loop
        await until(lambda: heard.changes() == ["connected", "ended"])
        assert process.restarts == 0


async def test_a_system_that_stalls_is_killed_and_started_again(fake_package: None) -> None:
    heard = Heard()
    async with child(heard, type="vicon", host="10.0.0.5") as process:
        await until(lambda: len(heard.frames) + process.skipped == 50)
        assert process.bad_lines == 0  # what libraries print goes elsewhere
        first = process.status()["pid"]
        process.tick(asyncio.get_running_loop().time() + 60.0)
        await until(lambda: process.restarts == 1 and process.state == "connected")
        assert process.status()["pid"] != first
        assert heard.changes()[:3] == ["connected", "failed", "connected"]
        assert "sends no frames" in heard.events[1].text


async def test_a_connection_that_hangs_is_killed(fake_package: None) -> None:
    heard = Heard()
    async with child(heard, type="optitrack", host="dead") as process:
        await until(lambda: process.state == "connecting" and "optitrack at dead" in process.text)
        process.tick(asyncio.get_running_loop().time() + 60.0)
        await until(lambda: process.state == "waiting")
        assert "optitrack at dead does not answer" in process.text


async def test_what_the_system_says_is_reported_once(fake_package: None) -> None:
    heard = Heard()
    async with child(heard, type="qualisys", host="refused") as process:
        await until(lambda: process.restarts >= 2)
        assert heard.changes() == ["failed"]
        assert "qualisys at refused: no such host" in heard.events[0].text


async def test_of_a_flood_the_newest_frames_are_taken_and_a_while_later() -> None:
    """Each read of a full pipe had the loop for 40 ms, and all that it brought was too old by then."""
    heard = Heard()
    flood = f"""
        import sys, time
        from skygcs.ext.mocap.recording import frame_lines, state_line
        bodies = {{f"b{{n}}": {BODY} for n in range(120)}}
        sys.stdout.buffer.write(state_line("connected", "a flood"))
        while True:
            sys.stdout.buffer.write(b"".join(frame_lines(time.monotonic(), bodies)))
    """
    async with child(heard, [sys.executable, "-c", textwrap.dedent(flood)], type="vicon", host="h") as process:
        await until(lambda: process.skipped > 1000)
        assert process.state == "connected" and not process.bad_lines
        # 120 bodies are two lines, of which a short read has one only: those of the end have all bodies
        late = heard.frames[len(heard.frames) // 2 :]
        assert {body for frame in late for body in frame.bodies} == {f"b{n}" for n in range(120)}


async def test_a_process_that_writes_nonsense_is_not_believed() -> None:
    heard = Heard()
    noise = [sys.executable, "-c", "import sys; sys.stdout.write('x\\n' * 100 + 'y' * 100_000); sys.stdout.flush()"]
    async with child(heard, noise, type="vicon", host="h") as process:
        await until(lambda: process.restarts >= 1)
        assert process.bad_lines >= 101 and not heard.frames


def test_it_ends_with_its_parent_even_in_a_call_that_does_not_end(tmp_path: Path, fake_package: None) -> None:
    parent = textwrap.dedent("""
        import subprocess, sys, time
        line = [sys.executable, "-m", "skygcs.ext.mocap.worker", "--system", "vicon", "--host", "dead"]
        child = subprocess.Popen(line, stdout=subprocess.PIPE)
        child.stdout.readline()
        print(child.pid, flush=True)
        time.sleep(3600)
    """)
    process = subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE)
    assert process.stdout is not None
    pid = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    while _alive(pid):
        time.sleep(0.02)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False


def test_the_command_line_records_frames(tmp_path: Path, fake_package: None) -> None:
    out = tmp_path / "flight.jsonl"
    line = [
        str(Path(sys.executable).with_name("skygcs-cli")),
        "mocap",
        "record",
        str(out),
        "--type",
        "vrpn",
        "--host",
        "h",
    ]
    run = subprocess.run([*line, "--body", "a", "--seconds", "2"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    lines = out.read_bytes().splitlines()
    assert f"{len(lines)} frames recorded" in run.stdout and len(lines) > 5
    again = subprocess.run([*line, "--seconds", "1"], capture_output=True, text=True)
    assert again.returncode == 1 and "exists already" in again.stderr
