"""A base receiver at a real port: not there, plugged in, pulled out."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.errors import LinkError
from skygcs.ext.corrections.ubx import output_settings, valset
from support.base_receiver import nav_svin, settings_in
from support.corrections_bench import CorrectionsBench
from support.pseudo_tty import PtyRadio

pytestmark = pytest.mark.system


async def test_a_port_that_is_not_there_and_then_is(tmp_path: Path) -> None:
    device = PtyRadio(tmp_path / "base")
    bench = CorrectionsBench(serial=str(device.path), port="usb")
    task = asyncio.create_task(bench.feeder.run())
    await bench.until(lambda: "no such device" in bench.status["text"], 5.0)
    with pytest.raises(LinkError, match="not connected"):
        bench.source.restart_survey()
    device.plug_in()
    (settings,) = settings_in(await device.read_exactly(len(valset(output_settings("usb", "msm4")))))
    assert settings["CFG_USBOUTPROT_RTCM3X"] == 1
    device.write(nav_svin(5, 3.0))
    await bench.until(lambda: (bench.status["survey"] or {}).get("duration_s") == 5, 5.0)
    device.pull_out()
    await bench.until(lambda: bench.status["state"] == "down", 5.0)
    assert "unplugged" in bench.status["text"]
    task.cancel()
    await asyncio.wait({task})
