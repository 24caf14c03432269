"""What is recorded while it flies runs again bit for bit, and a disk that is full ends the recording only."""

from __future__ import annotations

import asyncio
import errno
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.control.trace import Trace, TraceEntry, decode, rerun
from skygcs.runtime.trace_file import TraceFile
from support.flown import KINDS, aloft


def read(path: Path) -> tuple[Trace, list[TraceEntry]]:
    with path.open(encoding="ascii") as lines:
        trace = decode(lines)
        return trace, list(trace)


@KINDS
async def test_a_flight_with_everything_in_it_runs_again_alike(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs("control.record", targets="v1", on=True)
        await gcs.fly("attitude")
        path = gcs.control()["recording"]
        await gcs.step(3.0, 2.0, 1.0)
        await asyncio.sleep(5)
        await gcs.done("control.gains", xy={"vel_p": 0.11}, hover_thrust=0.47, force=True)
        await asyncio.sleep(3)
        for _ in range(60):
            await gcs.done("control.setpoint", vel_enu_mps=[0.5, -0.5, None], pos_enu_m=[None, None, 10.0], yaw_deg=30)
            await asyncio.sleep(0.05)
        gcs.sim().faults.mute = True
        await asyncio.sleep(1.0)
        gcs.sim().faults.mute = False
        await asyncio.sleep(4)
        await gcs.fly("velocity")
        await gcs.fly("attitude")
        await asyncio.sleep(3)
        ticks = gcs.control()["ticks"]
        await gcs.done("control.set", mode="off")
        files = (await gcs("control.record", targets="v1", on=False))["files"]
        assert files["v1"] is None or files["v1"] == path
    trace, entries = read(Path(path))
    assert trace.cut_line is None and trace.head.vehicle == "v1"
    assert not list(rerun(entries))
    assert len(entries) >= ticks - 20 and {e.row.control_mode for e in entries} == {"attitude", "velocity", "position"}


@pytest.mark.deep
async def test_a_full_disk_is_told_once_and_control_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = []
    before = TraceFile.write

    def write(self: TraceFile, *args: Any) -> None:
        written.append(args)
        if len(written) > 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        before(self, *args)

    monkeypatch.setattr(TraceFile, "write", write)
    async with aloft(tmp_path) as gcs:
        await gcs("control.record", targets="v1", on=True)
        await gcs.fly("attitude")
        start, since = gcs.place(), gcs.now
        await gcs.step(3.0, 0.0, 0.0)
        await asyncio.sleep(15)
        told = [t for t in gcs.texts(0.0, "warning") if "control trace" in t]
        assert told == ["its control trace has ended: No space left on device"]
        assert len(written) == 6 and gcs.control()["recording"] is None
        assert gcs.control()["state"] == "flying"
        assert gcs.place() == pytest.approx((start[0] + 3.0, start[1], start[2]), abs=0.4)
        assert gcs.farthest_m(since) < 4.0
        (cut,) = (await gcs("control.record", targets="v1", on=False))["files"].values()
        assert str(tmp_path) in cut
        assert (await gcs("control.record", targets="v1", on=False))["files"] == {"v1": None}


async def test_a_log_directory_that_cannot_be_written_is_told_and_control_begins(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("a file where a directory is wanted")
    async with aloft(tmp_path) as gcs:
        await gcs("control.record", targets="v1", on=True)
        await gcs.fly("velocity")
        (told,) = gcs.texts(0.0, "warning")
        assert told.startswith("its control trace has ended")
        assert gcs.control()["state"] == "flying"
