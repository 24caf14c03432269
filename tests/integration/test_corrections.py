"""Corrections of a base, from the socket to the receivers of simulated vehicles behind a plain link."""

from __future__ import annotations

import asyncio
import base64
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RefusedError
from skygcs.ext.corrections.methods import CorrectionsStatus, CorrectionsTaken
from support.flown import Flown
from support.grounded import on_the_ground
from support.rtcm import STANDARD_1005, rtcm_frame

OBSERVATIONS = (1077, 1087, 1097, 1127)


def epoch_of(second: int) -> bytes:
    """What a base sends in one second: 1.4 kB, its position every tenth."""
    return (STANDARD_1005 if second % 10 == 0 else b"") + b"".join(
        rtcm_frame(type_, epoch=second, body_bytes=200 + 100 * n) for n, type_ in enumerate(OBSERVATIONS)
    )


async def send(gcs: Flown, data: bytes, **params: Any) -> dict[str, Any]:
    return dict(await gcs("corrections.send", data=base64.b64encode(data).decode(), **params))


async def base(gcs: Flown, seconds: int) -> None:
    """In pieces as a socket gives them."""
    for second in range(seconds):
        data = epoch_of(second)
        for at in range(0, len(data), 333):
            await send(gcs, data[at : at + 333])
        await asyncio.sleep(1.0)


async def test_the_corrections_of_a_base_make_receivers_fix(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path) as gcs:
        told = await gcs("corrections.status")
        assert (told["source"], told["messages"], told["age_s"]) == (None, 0, None)
        assert [v["fix"] for v in told["vehicles"]] == ["3d", "3d"]
        await base(gcs, 25)
        for sim in gcs.sims:
            assert sim.rtk.types == {1005: 3, **dict.fromkeys(OBSERVATIONS, 25)}
        told = await gcs("corrections.status")
        assert set(told) >= set(CorrectionsStatus.model_fields)
        assert (told["source"], told["messages"], told["refused"], told["skipped_bytes"]) == ("rpc", 103, 0, 0)
        assert told["bytes"] == sum(len(epoch_of(second)) for second in range(25))
        assert told["bytes_per_s"] == pytest.approx(len(epoch_of(1)), rel=0.15)
        assert told["types"]["1077"]["messages"] == 25
        assert [(v["name"], v["fix"]) for v in told["vehicles"]] == [("v1", "rtk_fixed"), ("v2", "rtk_fixed")]
        await asyncio.sleep(15)
        told = await gcs("corrections.status")
        assert (told["source"], told["bytes_per_s"]) == (None, 0.0)
        assert [v["fix"] for v in told["vehicles"]] == ["3d", "3d"]


async def test_a_piece_tells_what_it_completed(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path) as gcs:
        first = await send(gcs, b"noise" + STANDARD_1005 + rtcm_frame(1077)[:10])
        assert set(first) == set(CorrectionsTaken.model_fields)
        assert first == {
            "messages": 1,
            "bytes": len(STANDARD_1005),
            "types": {"1005": 1},
            "refused": 0,
            "too_long": 0,
            "bad_crc": 0,
            "skipped_bytes": 5,
            "links": 1,
        }
        then = await send(gcs, rtcm_frame(1077)[10:] + rtcm_frame(1077, body_bytes=800) + b"\xd3\x00\x00abc")
        assert (then["messages"], then["types"], then["too_long"], then["bad_crc"]) == (1, {"1077": 1}, 1, 1)


@pytest.mark.deep
async def test_two_bases_at_a_time_are_refused(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path) as gcs:
        await send(gcs, STANDARD_1005[:10], source="roof")
        with pytest.raises(RefusedError, match=r"roof sends corrections already .* silent for 10 s"):
            await send(gcs, STANDARD_1005, source="field")
        assert (await send(gcs, STANDARD_1005[10:], source="roof"))["messages"] == 1
        await asyncio.sleep(10.1)
        await send(gcs, STANDARD_1005[:10], source="field")  # the rest of roof's stream would be no part of this one
        assert (await send(gcs, STANDARD_1005[10:], source="field"))["messages"] == 1
        assert (await gcs("corrections.status"))["source"] == "field"
        await send(gcs, b"", source="field", end=True)
        assert (await gcs("corrections.status"))["source"] is None
        assert (await send(gcs, STANDARD_1005, source="roof"))["messages"] == 1


async def test_half_a_message_of_before_a_standstill_is_not_continued(tmp_path: Path) -> None:
    """Without the table the feed is made by the first call; the daemon's standstills reach it all the same."""
    async with on_the_ground(tmp_path) as gcs:
        await send(gcs, STANDARD_1005[:10])
        gcs.daemon.extensions.woke("the process stood still")
        assert (await send(gcs, STANDARD_1005[10:]))["messages"] == 0
        assert (await send(gcs, STANDARD_1005))["messages"] == 1
        with pytest.raises(RefusedError, match=r"no table \[corrections\]"):
            await gcs("corrections.survey")


async def test_what_no_link_takes_is_told(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path) as gcs:
        await gcs.daemon.links.remove("air")
        told = await send(gcs, STANDARD_1005)
        assert (told["links"], told["messages"], told["refused"]) == (0, 0, 1)
        assert (await gcs("corrections.status"))["refused"] == 1
