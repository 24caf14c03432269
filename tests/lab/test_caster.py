"""RTKLIB's str2str: its caster serves [corrections], and its client reads the caster of our tests."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from support.caster import Caster, streams
from support.corrections_bench import CorrectionsBench
from support.needed import needs
from support.process import free_port
from support.rtcm import STANDARD_1005, rtcm_frame

OBSERVATIONS = (1074, 1084, 1094, 1124)


def epoch_of(second: int) -> bytes:
    return STANDARD_1005 + b"".join(rtcm_frame(t, epoch=second, body_bytes=300) for t in OBSERVATIONS)


EPOCHS = [epoch_of(second) for second in range(60)]


@contextlib.asynccontextmanager
async def str2str(*words: str) -> AsyncIterator[None]:
    program = await asyncio.create_subprocess_exec(
        needs("test-lab", "str2str"), *words, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL
    )
    try:
        yield
    finally:
        program.kill()
        await program.wait()


@contextlib.asynccontextmanager
async def rtklibs_caster(port: int) -> AsyncIterator[None]:
    """RTKLIB's caster, which has its stream from ours."""
    async with Caster(streams(EPOCHS)) as ours:
        source = f"ntrip://x:y@127.0.0.1:{ours.port}/SOURCE"
        async with str2str("-in", source, "-out", f"ntripc://ada:secret@:{port}/MOUNT"):
            yield


@contextlib.asynccontextmanager
async def at_work(
    port: int, mountpoint: str, monkeypatch: pytest.MonkeyPatch, password: str = "secret"
) -> AsyncIterator[CorrectionsBench]:
    monkeypatch.setenv("CASTER_PASSWORD", password)
    bench = CorrectionsBench(ntrip=f"ntrip://ada@127.0.0.1:{port}/{mountpoint}", password_env="CASTER_PASSWORD")
    task = asyncio.create_task(bench.feeder.run())
    try:
        yield bench
    finally:
        task.cancel()
        await asyncio.wait({task})


async def test_the_stream_of_rtklibs_caster_is_taken_to_the_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    port = free_port()
    async with rtklibs_caster(port), at_work(port, "MOUNT", monkeypatch) as bench:
        await bench.until(lambda: bench.status["messages"] >= 15, 30.0)
        assert bytes(bench.sent) in b"".join(EPOCHS)
        assert bench.status["state"] == "streaming" and bench.feed.totals["bad_crc"] == 0


@pytest.mark.parametrize(
    ("mountpoint", "password", "why"),
    [("MOUNT", "wrong", "user or password is wrong"), ("OTHER", "secret", "the table of its 1: MOUNT")],
)
async def test_its_refusals_are_understood(
    monkeypatch: pytest.MonkeyPatch, mountpoint: str, password: str, why: str
) -> None:
    port = free_port()
    async with rtklibs_caster(port), at_work(port, mountpoint, monkeypatch, password) as bench:
        await bench.until(lambda: why in bench.status["text"], 30.0)
        assert bench.sent == b""


async def test_rtklibs_client_reads_the_caster_of_our_tests(tmp_path: Path) -> None:
    file = tmp_path / "received.rtcm3"
    whole = b"".join(EPOCHS[:4])

    async def received() -> None:
        while True:
            # RTKLIB takes the empty line after "ICY 200 OK" as a part of the stream
            if await asyncio.to_thread(lambda: file.exists() and file.read_bytes().removeprefix(b"\r\n") == whole):
                return
            await asyncio.sleep(0.2)

    async with Caster(streams(EPOCHS[:4], then_s=30.0)) as caster:
        async with str2str("-in", f"ntrip://ada:secret@127.0.0.1:{caster.port}/MOUNT", "-out", f"file://{file}"):
            await asyncio.wait_for(received(), 30.0)
        assert caster.clients[0].request.startswith(b"GET /MOUNT HTTP/1.0\r\n")
