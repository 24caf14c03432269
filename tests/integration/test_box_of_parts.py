"""docs/tutorial/box-of-parts.md, step 9, as it is typed: four vehicles behind the radio of step 3, in virtual time.

The commands run in a thread, each as in a shell; what they ask the daemon is awaited on the loop of the daemon.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import queue
import shlex
import threading
import tomllib
from collections.abc import Coroutine
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.core.separation import DOWNWASH_RATIO, separation_m
from skygcs.runtime.preflight_run import Preflight
from skygcs.sim.kinematics import LocalFrame
from support.on_air import FIELD, OnAir, on_air
from support.planned import instant_planning

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial" / "box-of-parts.md"
NAMES = ("alpha", "bravo", "charlie", "delta")
UNIX_S = 1_700_000_000.0


def step_9() -> list[str]:
    """The commands of the step up to the landing; `down` is for companions, which this fleet has not."""
    section = PAGE.read_text(encoding="utf-8").split("## 9. ")[1]
    lines = section.split("```")[1].strip().splitlines()
    assert lines[-1] == "skygcs-cli down", lines
    return lines[:-1]


def fleet_file() -> dict[str, Any]:
    """configs/field-radio.toml, which step 3 has written, with the four vehicles' names."""
    content = tomllib.loads((ROOT / "configs" / "field-radio.toml").read_text(encoding="utf-8"))
    del content["links"], content["daemon"], content["dialect"]
    content["vehicles"] = {name: {"sysid": number} for number, name in enumerate(NAMES, 1)}
    return content


class Shell:
    """``await shell("skygcs-cli …")``: exit code and output."""

    def __init__(self, air: OnAir) -> None:
        self._socket = str(air.daemon.config.daemon.socket)

    async def __call__(self, line: str) -> tuple[int, str]:
        asked: queue.SimpleQueue[Any] = queue.SimpleQueue()
        answers: queue.SimpleQueue[asyncio.Future[Any]] = queue.SimpleQueue()

        def on_the_loop(work: Coroutine[Any, Any, Any], **_: Any) -> Any:
            asked.put(work)
            return answers.get().result()

        def typed() -> None:
            with mock.patch("asyncio.run", on_the_loop), mock.patch.dict("os.environ", SKYGCS_SOCKET=self._socket):
                result = CliRunner().invoke(app, shlex.split(line)[1:])
            asked.put((result.exit_code, result.output))

        threading.Thread(target=typed).start()
        # the loop stands still while the thread works: the same happens at the same virtual time in each run
        while asyncio.iscoroutine(work := asked.get()):
            done = asyncio.ensure_future(work)
            await asyncio.wait([done])
            answers.put(done)
        return work


async def least_distance(air: OnAir, found: list[float]) -> None:
    """For ever: the least true distance of two of which one flies, in the metric of the certificate."""
    frame = LocalFrame(FIELD["lat_deg"], FIELD["lon_deg"], FIELD["alt_amsl_m"])
    while True:
        for a, b in itertools.combinations(air.link.vehicles, 2):
            if a.motion.on_ground and b.motion.on_ground:
                continue
            (ax, ay), (bx, by) = (
                frame.to_local(*sim.where.to_geodetic(sim.motion.east_m, sim.motion.north_m)) for sim in (a, b)
            )
            apart_m = separation_m(ax - bx, ay - by, a.motion.up_m - b.motion.up_m, DOWNWASH_RATIO)
            found[0] = min(found[0], apart_m)
        await asyncio.sleep(0.2)


@pytest.mark.deep
async def test_step_9_flies_with_four_vehicles_on_the_radio_of_step_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "\n".join(f"{name},,0,0,0," for name in NAMES)
    (tmp_path / "fleet.csv").write_text(f"vehicle,t,x,y,z,yaw\n{rows}\n")
    clock = asyncio.get_running_loop().time
    radio = {"radio": {"air_kbps": 64, "loss": 0.02}, "link": {"air_speed_kbps": 64}}
    with mock.patch("time.time", lambda: UNIX_S + clock()):
        async with on_air(tmp_path, px4=2, ardupilot=2, **radio, tables=fleet_file()) as air:
            instant_planning(air.daemon)
            await air.settled(4, 120.0)
            for actor in air.daemon.fleet.vehicles.values():
                actor.part(Preflight).wall_clock = lambda: UNIX_S + clock()
            await asyncio.sleep(30.0)
            least = [math.inf]
            watching = asyncio.create_task(least_distance(air, least), name="distances")
            shell, said = Shell(air), ""
            for line in step_9():
                code, output = await shell(line)
                assert code == 0, f"{line}\n{output}"
                said += output
            assert "by goto: alpha: with 4 vehicles its radio leaves it 134 B/s for setpoints" in said
            await air.until(lambda: not any(sim.armed for sim in air.link.vehicles), 120.0)
            watching.cancel()
            closest = json.loads((tmp_path / "line.json").read_text())["certificate"]["closest"]
            assert least[0] >= closest["margin_m"], (least, closest)
