"""[corrections] in a whole daemon: from a caster or a base receiver to the receivers of simulated vehicles."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from pynmeagps import NMEAReader

from skygcs.cli.corrections import status_lines
from skygcs.errors import RefusedError, RpcError
from skygcs.ext.corrections import receiver
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.methods import CorrectionsStatus
from support.base_receiver import BaseReceiver
from support.caster import Caster, says, streams
from support.flown import FIELD, Flown
from support.grounded import on_the_ground
from support.pymav import PymavPeer
from support.rtcm import STANDARD_1005, rtcm_frame

OBSERVATIONS = (1074, 1084, 1094, 1124)


def epoch_of(second: int) -> bytes:
    """What a base sends in one second, its position every tenth; the longest message takes three GPS_RTCM_DATA."""
    return (STANDARD_1005 if second % 10 == 0 else b"") + b"".join(
        rtcm_frame(type_, epoch=second, body_bytes=100 + 130 * n) for n, type_ in enumerate(OBSERVATIONS)
    )


def table(**keys: Any) -> dict[str, Any]:
    return {"corrections": CorrectionsConfig.model_validate(keys)}


class Listener:
    """What reaches the vehicles, read by pymavlink: the content of all GPS_RTCM_DATA."""

    def __init__(self, gcs: Flown) -> None:
        self._peer = PymavPeer(9, 190)
        self._pass_on = gcs.link.peer.on_bytes
        gcs.link.peer.on_bytes = self._hear

    def _hear(self, data: bytes) -> None:
        self._peer.parse(data)
        assert self._pass_on is not None
        self._pass_on(data)

    @property
    def rtcm(self) -> bytes:
        """Put together: whole messages, or parts of one sequence in their order."""
        whole, parts, sequence = b"", b"", None
        for message in self._peer.seen:
            if message.get_type() != "GPS_RTCM_DATA":
                continue
            content = bytes(message.data[: message.len])
            fragmented, number, of = message.flags & 1, message.flags >> 1 & 3, message.flags >> 3
            if not fragmented:
                whole += content
                continue
            if number == 0:
                parts, sequence = b"", of
            assert sequence == of
            parts += content
            if message.len < 180 or number == 3:
                whole += parts
        return whole


def told(gcs: Flown) -> list[str]:
    return [event.data["change"] for event in gcs.told if event.kind == "corrections"]


async def test_a_casters_stream_makes_vehicles_fix(tmp_path: Path) -> None:
    epochs = [epoch_of(second) for second in range(90)]
    # the first call fails, the next connection ends after a while
    conducts = (says(b""), streams(epochs[:18], revision=1), streams(epochs[18:], revision=2))
    async with Caster(*conducts) as caster:
        keys = {"ntrip": f"ntrip://127.0.0.1:{caster.port}/VRS", "gga_s": 5.0}
        async with on_the_ground(tmp_path, extensions=table(**keys)) as gcs:
            listener = Listener(gcs)
            await asyncio.sleep(25.0)
            assert len(caster.clients) == 3
            # what the caster sent is what reaches the vehicles
            heard = listener.rtcm
            sent = b"".join(epochs)
            assert len(heard) > 22 * len(epochs[1]) and heard in sent
            for sim in gcs.sims:
                assert sim.rtk.types[1074] >= 22 and sim.rtk.types[1005] >= 2
            # and they fix
            status = await gcs("corrections.status")
            assert set(status) == set(CorrectionsStatus.model_fields)
            assert (status["rtk_fixed"], status["rtk_float"], status["own_source"]["state"]) == (2, 0, "streaming")
            assert status["own_source"]["types"]["1124"] > 30 and status["own_source"]["age_s"] < 2.0
            assert status["source"] == f"[corrections] 127.0.0.1:{caster.port}/VRS"
            assert gcs.daemon.info()["corrections"]["state"] == "streaming"
            # the virtual station is where the first vehicle is
            lines = caster.clients[-1].lines
            assert 3 <= len(lines) <= 6
            place: Any = NMEAReader.parse(lines[-1])
            assert (place.lat, place.lon) == pytest.approx((FIELD.lat_deg, FIELD.lon_deg), abs=1e-4)
            assert status["own_source"]["gga"]["from"] == "v1"
            # each change is told once
            assert told(gcs) == ["down", "up", "down", "up"]
            shown = "\n".join(status_lines(status))
            assert f"127.0.0.1:{caster.port}/VRS: streaming" in shown and "position of v1 sent to it" in shown
            assert "2 fixed, 0 float of 2 vehicles" in shown
            with pytest.raises((RpcError, RefusedError), match="there is no receiver"):
                await gcs("corrections.survey")


async def test_a_caster_that_is_lost_leaves_the_vehicles_and_the_daemon_alone(tmp_path: Path) -> None:
    epochs = [epoch_of(second) for second in range(20)]
    async with Caster(streams(epochs), says(b"HTTP/1.1 401 Unauthorized\r\n\r\n")) as caster:
        keys = {"ntrip": f"ntrip://127.0.0.1:{caster.port}/MOUNT"}
        async with on_the_ground(tmp_path, extensions=table(**keys)) as gcs:
            await asyncio.sleep(25.0)
            status = await gcs("corrections.status")
            assert status["own_source"]["state"] == "down" and status["rtk_fixed"] == 0
            assert told(gcs) == ["up", "down"]
            shown = "\n".join(status_lines(status))
            assert "MOUNT: down" in shown and "password_file" in shown
            # another program may send now
            await gcs("corrections.send", data="", source="roof")


async def test_a_base_receiver_surveys_and_makes_vehicles_fix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver()
    monkeypatch.setattr(receiver, "open_port", base.open_port)
    monkeypatch.setattr(receiver, "discard", lambda port: port.close())

    async def live() -> None:
        while True:
            for _ in range(10):
                await asyncio.sleep(0.1)
                base.answer()
            base.second()

    living = asyncio.create_task(live())
    keys = {"serial": "/dev/ttyACM0", "survey_s": 25, "survey_accuracy_m": 2}
    async with on_the_ground(tmp_path, extensions=table(**keys)) as gcs:
        listener = Listener(gcs)
        status = await gcs("corrections.status")
        assert status["own_source"]["survey"]["state"] == "surveying" and status["rtk_fixed"] == 0
        assert any("survey-in running" in line for line in status_lines(status))
        await asyncio.sleep(35.0)
        status = await gcs("corrections.status")
        assert status["own_source"]["survey"]["state"] == "surveyed" and status["rtk_fixed"] == 2
        assert any("survey-in done" in line for line in status_lines(status))
        assert told(gcs)[-1] == "surveyed"
        assert listener.rtcm and listener.rtcm in b"".join(base.sent_rtcm)
        # begun anew, the base's position does not come until it is known again
        answer = await gcs("corrections.survey")
        assert answer["name"] == "/dev/ttyACM0"
        await asyncio.sleep(5.0)
        survey = (await gcs("corrections.status"))["own_source"]["survey"]
        assert survey["state"] == "surveying" and survey["duration_s"] < 6
    living.cancel()
    await asyncio.wait({living})
    base.unplug()
