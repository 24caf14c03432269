"""The connection to a caster over loopback sockets: what it makes of sound casters, and of others."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import LinkError
from skygcs.ext.corrections.caster import ANSWER_S, READ_BYTES, read_password
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.feeder import (
    BURST_BYTES,
    BYTES_PER_S,
    FIRST_BACK_OFF_S,
    LONGEST_BACK_OFF_S,
    REFUSED_AGAIN_S,
)
from skygcs.ext.corrections.gga import GgaPosition
from support.caster import HTTP, ICY, TABLE, Caster, Client, Conduct, never_stops, says, streams
from support.certificates import Authority
from support.corrections_bench import CorrectionsBench
from support.rtcm import STANDARD_1005, rtcm_frame
from support.table import each

pytestmark = pytest.mark.looptime

EPOCHS = [STANDARD_1005 + rtcm_frame(1077, epoch=n, body_bytes=250) for n in range(60)]
HOME = GgaPosition("alpha", 43.78, -79.46, 180.0)


def bench_of(port: int, *, place: GgaPosition | None = HOME, scheme: str = "ntrip", **keys: Any) -> CorrectionsBench:
    return CorrectionsBench(lambda last: place, **{"ntrip": f"{scheme}://ada@127.0.0.1:{port}/MOUNT", **keys})


@contextlib.asynccontextmanager
async def at_work(
    *conducts: Conduct, tls: ssl.SSLContext | None = None, **keys: Any
) -> AsyncIterator[tuple[CorrectionsBench, Caster]]:
    async with Caster(*conducts, tls=tls) as caster:
        bench = bench_of(caster.port, **keys)
        task = asyncio.create_task(bench.feeder.run())
        try:
            yield bench, caster
        finally:
            task.cancel()
            await asyncio.wait({task})
            assert task.cancelled()


@pytest.mark.parametrize("revision", [1, 2])
@pytest.mark.parametrize("piece", [0, 1, 100])
async def test_a_stream_reaches_the_vehicles_to_the_byte(revision: int, piece: int) -> None:
    async with at_work(streams(EPOCHS[:10], revision=revision, piece=piece, then_s=5.0)) as (bench, caster):
        await asyncio.sleep(12.0)
        assert bytes(bench.sent) == b"".join(EPOCHS[:10])
        status = bench.status
        assert (status["state"], status["messages"], status["types"]) == ("streaming", 20, {"1005": 10, "1077": 10})
        assert bench.source.revision == revision
        assert status["name"] == f"127.0.0.1:{caster.port}/MOUNT"
        assert 0 < status["age_s"] < 5 and status["bytes_per_s"] > 0
        assert bench.changes() == ["up"]


async def test_the_position_of_a_vehicle_goes_with_the_request_and_then_again() -> None:
    async with at_work(streams(EPOCHS, revision=2), gga_s=5) as (bench, caster):
        await asyncio.sleep(12.0)
        (client,) = caster.clients
        assert b"Ntrip-GGA: $GPGGA," in client.request
        assert len(client.lines) == 3 and all(line.startswith(b"$GPGGA,") for line in client.lines)
        gga = bench.status["gga"]
        assert (gga["from"], gga["sent"]) == ("alpha", 4)


async def test_no_position_is_sent_where_none_is_wanted_or_known() -> None:
    async with at_work(streams(EPOCHS), gga_s=0) as (bench, caster):
        await asyncio.sleep(5.0)
        assert bench.status["gga"] is None
        assert caster.clients[0].lines == [] and b"GGA" not in caster.clients[0].request
    async with at_work(says(ICY, then_s=100.0), place=None, silent_s=5) as (bench, caster):
        await asyncio.sleep(6.0)
        assert "waits for a position" in bench.status["text"]
        assert caster.clients[0].lines == []


async def test_a_position_that_comes_later_is_sent_then() -> None:
    places: list[GgaPosition | None] = [None]
    async with Caster(streams(EPOCHS)) as caster:
        bench = CorrectionsBench(lambda last: places[0], ntrip=f"ntrip://127.0.0.1:{caster.port}/MOUNT")
        task = asyncio.create_task(bench.feeder.run())
        await asyncio.sleep(5.5)
        assert caster.clients[0].lines == []
        places[0] = HOME
        await asyncio.sleep(1.5)
        assert len(caster.clients[0].lines) == 1
        task.cancel()
        await asyncio.wait({task})


async def test_a_caster_that_is_lost_is_called_again_ever_more_slowly() -> None:
    async with at_work(says(b"")) as (bench, caster):
        await asyncio.sleep(200.0)
        calls = [client.at for client in caster.clients]
        pauses = [round(b - a, 1) for a, b in itertools.pairwise(calls)]
        assert pauses[:6] == [FIRST_BACK_OFF_S, 2.0, 4.0, 8.0, 16.0, LONGEST_BACK_OFF_S]
        assert set(pauses[6:]) == {LONGEST_BACK_OFF_S}
        assert bench.changes() == ["down"]  # once, not at each attempt
        assert "without an answer" in bench.status["text"]


async def test_a_stream_that_breaks_and_comes_back_is_told() -> None:
    broken = streams([*EPOCHS[:8], EPOCHS[8][:100]])
    async with at_work(broken, streams(EPOCHS[10:20], revision=2, then_s=9.0)) as (bench, caster):
        await asyncio.sleep(22.0)
        assert bench.changes() == ["up", "down", "up"]
        assert bench.events[-1].text.endswith("come again")
        assert round(caster.clients[1].at - caster.clients[0].at, 1) == 9.0 + FIRST_BACK_OFF_S
        # the message that was cut is not joined with the new stream
        assert bytes(bench.sent) == b"".join(EPOCHS[:8]) + STANDARD_1005 + b"".join(EPOCHS[10:20])
        assert bench.feed.totals["bad_crc"] == 0
        assert bench.status["connected"] == 2


@pytest.mark.parametrize(
    ("conduct", "why", "again_s"),
    [
        (says(b"HTTP/1.1 401 Unauthorized\r\n\r\n"), "needs a password", REFUSED_AGAIN_S),
        (says(b"HTTP/1.1 404 Not Found\r\n\r\n"), "no mountpoint MOUNT", REFUSED_AGAIN_S),
        (says(b"SOURCETABLE 200 OK\r\n\r\n" + TABLE), "MOUNT1, and 1 more", REFUSED_AGAIN_S),
        (says(b"SOURCETABLE 200 OK\r\n\r\n" + TABLE[:-16], then_s=99.0), "MOUNT1, and 1 more", REFUSED_AGAIN_S),
        (never_stops(b"HTTP/1.1 200 OK\r\n", b"X: " + b"y" * 500 + b"\r\n"), "head of its answer", REFUSED_AGAIN_S),
        (never_stops(b"", b"\x00\xff" * 200), "not an NTRIP caster", REFUSED_AGAIN_S),
        (never_stops(b"SOURCETABLE 200 OK\r\n", b"STR;M;x\r\n" * 4000), "it has no mountpoint", REFUSED_AGAIN_S),
        (says(HTTP + b"Transfer-Encoding: chunked\r\n\r\nFFFFFFFFFFFF\r\n", then_s=9.0), "a chunk of 2814", 1.0),
        (says(HTTP + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", then_s=9.0), "ended the stream", 1.0),
        (says(b"HTTP/1.1 503 Busy\r\n\r\n"), "reports an internal error", 1.0),
    ],
)
async def test_what_is_no_stream_is_named_and_asked_for_again_later(conduct: Conduct, why: str, again_s: float) -> None:
    async with at_work(conduct) as (bench, caster):
        await bench.until(lambda: bench.status["state"] == "down", 15.0)
        assert why in bench.status["text"]
        ended = bench.clock()
        await bench.until(lambda: len(caster.clients) == 2, 70.0)
        assert bench.clock() - ended == pytest.approx(again_s, abs=0.3)
        assert bench.sent == b""
        assert bench.changes() == ["down"]


async def test_a_caster_that_says_nothing_is_given_up() -> None:
    async with at_work(says(b"", then_s=999.0)) as (bench, _):
        await asyncio.sleep(ANSWER_S - 0.5)
        assert bench.status["state"] == "connecting"
        await asyncio.sleep(1.0)
        assert "no answer within 10 s" in bench.status["text"]


async def test_one_byte_at_a_time_does_not_hold_the_answer_off_for_ever() -> None:
    async def drips(client: Client) -> None:
        while True:
            await client.send(b"H")
            await asyncio.sleep(1.0)

    async with at_work(drips) as (bench, _):
        await asyncio.sleep(ANSWER_S + 0.5)
        assert bench.status["state"] == "down"


async def test_a_stream_that_falls_silent_is_called_again() -> None:
    async with at_work(streams(EPOCHS[:3], then_s=999.0), streams(EPOCHS), silent_s=7) as (bench, caster):
        await asyncio.sleep(8.5)
        assert bench.status["state"] == "streaming"
        await asyncio.sleep(1.0)
        assert bench.changes() == ["up", "down"] and "silent for 7 s" in bench.status["text"]
        await asyncio.sleep(3.0)
        assert (len(caster.clients), bench.status["state"]) == (2, "streaming")


async def test_bytes_without_a_message_are_named() -> None:
    async with at_work(never_stops(ICY, bytes([0x55, 0xD3, 0x00]) * 20)) as (bench, _):
        await asyncio.sleep(40.0)
        assert bench.status["failures"] >= 1 and "no RTCM 3 message" in bench.events[0].text
        assert bench.sent == b""


@pytest.mark.parametrize("first", ["told", "asks"])
async def test_what_a_caster_sent_before_a_standstill_goes_to_no_vehicle(first: str) -> None:
    """All of it went out as new, up to a megabyte."""
    async with at_work(streams(EPOCHS[:10], then_s=60.0), streams(EPOCHS[10:12], then_s=60.0)) as (bench, _):
        await bench.until(lambda: bench.status["messages"] >= 4, 20.0)
        sent, connected = len(bench.sent), bench.status["connected"]
        if first == "told":
            bench.feeder.woke("skygcs stood still for 60 s")
        else:
            answers = [True]
            bench.asleep = lambda: bool(answers) and answers.pop()
        await bench.until(lambda: bench.status["connected"] == connected + 1, 20.0)
        await bench.until(lambda: bytes(bench.sent[sent:]) == b"".join(EPOCHS[10:12]), 20.0)
        (down,) = [event.text for event in bench.events if event.data["change"] == "down"]
        assert "stood still" in down and "connected anew" in down


async def test_a_caster_that_floods_is_read_from_at_a_bounded_rate() -> None:
    async def floods(client: Client) -> None:
        await client.send(ICY)
        while True:
            await client.send(rtcm_frame(1077, body_bytes=1000) * 64)

    async with at_work(floods) as (bench, _):
        await asyncio.sleep(5.0)
        first = bench.status["bytes"]
        await asyncio.sleep(10.0)
        assert 0 < bench.status["bytes"] - first <= 10.0 * BYTES_PER_S + 2 * READ_BYTES
        assert first <= BURST_BYTES + 5.0 * BYTES_PER_S + 2 * READ_BYTES


async def test_another_programs_corrections_go_first() -> None:
    async with at_work(streams(EPOCHS)) as (bench, _):
        bench.feed.send("roof", STANDARD_1005)
        await asyncio.sleep(3.0)
        assert bench.status["state"] == "held_off" and "roof sends corrections already" in bench.status["text"]
        assert bytes(bench.sent) == STANDARD_1005
        await asyncio.sleep(10.0)
        assert bench.status["state"] == "streaming" and bench.status["text"] == ""
        assert bench.changes() == ["held_off", "up"]


async def test_a_source_whose_turn_has_come_must_bring_messages_and_locks_nobody_out() -> None:
    async with at_work(never_stops(ICY, bytes([0x55, 0xD3, 0x00]) * 20)) as (bench, _):
        bench.feed.send("roof", STANDARD_1005)
        await asyncio.sleep(3.0)
        assert bench.status["state"] == "held_off"
        await asyncio.sleep(60.0)  # the other one is silent, and what we get is no RTCM
        assert bench.status["failures"] >= 1
        assert any("no RTCM 3 message" in event.text for event in bench.events)
        assert "sends corrections already" not in bench.status["text"]


async def test_a_password_that_is_no_text_is_named_and_never_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CASTER_PASSWORD", "gr\udcfcn")
    with pytest.raises(LinkError, match=r"CASTER_PASSWORD \(password_env\) holds no password") as raised:
        read_password(CorrectionsConfig(ntrip="ntrip://u@127.0.0.1:1/M", password_env="CASTER_PASSWORD"))
    assert "gr" not in str(raised.value).split("CASTER_PASSWORD")[1]


async def test_when_it_ends_another_programs_may_follow_at_once() -> None:
    async with at_work(streams(EPOCHS)) as (bench, _):
        await asyncio.sleep(3.0)
    assert bench.feed.send("roof", STANDARD_1005)["messages"] == 1


async def test_no_caster_at_all() -> None:
    bench = bench_of(1)
    task = asyncio.create_task(bench.feeder.run())
    await asyncio.sleep(0.5)
    assert "connection refused" in bench.status["text"]
    task.cancel()
    await asyncio.wait({task})


# -- TLS


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path, "authority")


def server_context(authority: Authority, address: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*authority.issue("caster", address))
    return context


@pytest.mark.parametrize("wrong", [None, "name", "authority", "system"])
async def test_only_a_certificate_of_the_caster_is_accepted(
    tmp_path: Path, authority: Authority, wrong: str | None
) -> None:
    trusted = Authority(tmp_path, "other").file if wrong == "authority" else authority.file
    tls = server_context(authority, "127.0.0.2" if wrong == "name" else "127.0.0.1")
    ca_file = None if wrong == "system" else trusted
    conduct = streams(EPOCHS[:5], revision=2, then_s=5.0)
    async with at_work(conduct, tls=tls, scheme="ntrips", ca_file=ca_file) as (bench, caster):
        await asyncio.sleep(1.0 if wrong else 7.0)
        if wrong is None:
            assert bytes(bench.sent) == b"".join(EPOCHS[:5])
            return
        assert bench.status["state"] == "down" and "certificate is not accepted" in bench.status["text"]
        assert all(client.request == b"" for client in caster.clients)  # the password was not sent


async def test_a_caster_without_tls_is_named(authority: Authority) -> None:
    async with at_work(says(ICY), scheme="ntrips", ca_file=authority.file) as (bench, _):
        await asyncio.sleep(11.0)
        assert bench.status["state"] == "down" and bench.sent == b""


async def test_a_file_without_certificates_is_named(tmp_path: Path) -> None:
    file = tmp_path / "ca.pem"
    for text, why in (("nothing", "no certificates"), (None, "No such file")):
        file.unlink(missing_ok=True)
        if text is not None:
            file.write_text(text)
        async with at_work(says(ICY), scheme="ntrips", ca_file=file) as (bench, _):
            await asyncio.sleep(0.5)
            assert why in bench.status["text"]


# -- passwords


async def test_the_password_is_sent_and_shown_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CASTER_PASSWORD", "tops3cret")
    file = tmp_path / "password"
    file.write_text("tops3cret\n")
    file.chmod(0o600)
    for keys in ({"password_env": "CASTER_PASSWORD"}, {"password_file": file}):
        refusal = says(b"HTTP/1.1 401 Unauthorized\r\n\r\n")
        async with at_work(refusal, streams(EPOCHS), **keys) as (bench, caster):
            await asyncio.sleep(62.0)
            sent = [b"Authorization: Basic YWRhOnRvcHMzY3JldA==" in client.request for client in caster.clients]
            assert sent == [True, True]
            shown = f"{bench.status} {bench.events} {bench.config} {bench.source.name}"
            assert "tops3cret" not in shown and "YWRhOnRvcHMzY3JldA" not in shown
            assert "user or password is wrong" in bench.events[0].text


@each(
    ("content", "mode", "why"),
    [
        (b"secret\n", 0o644, "others can read it"),
        (b"", 0o600, "one line"),
        (b"\n\n", 0o600, "one line"),
        (b"a\nb\n", 0o600, "one line"),
        (b"x" * 2000, 0o600, "one line"),
        (b"\xff\xfe", 0o600, "not text"),
        (None, 0o600, "No such file"),
    ],
)
def test_a_password_file_that_is_none_is_named(tmp_path: Path, content: bytes | None, mode: int, why: str) -> None:
    file = tmp_path / "password"
    if content is not None:
        file.write_bytes(content)
        file.chmod(mode)
    config = CorrectionsConfig.model_validate({"ntrip": "ntrip://ada@h/M", "password_file": file})
    with pytest.raises(LinkError, match=why) as wrong:
        read_password(config)
    assert "secret" not in str(wrong.value)


def test_a_variable_that_is_not_set_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CASTER_PASSWORD", raising=False)
    config = CorrectionsConfig.model_validate({"ntrip": "ntrip://ada@h/M", "password_env": "CASTER_PASSWORD"})
    with pytest.raises(LinkError, match="CASTER_PASSWORD"):
        read_password(config)
    assert read_password(CorrectionsConfig.model_validate({"ntrip": "ntrip://ada@h/M"})) == ""


# -- a caster that is not ours


async def test_aiohttps_chunks_are_read(authority: Authority) -> None:
    from aiohttp import web

    requests: list[Any] = []

    async def serve(request: web.Request) -> web.StreamResponse:
        requests.append(request.headers.copy())
        answer = web.StreamResponse(headers={"Ntrip-Version": "Ntrip/2.0", "Content-Type": "gnss/data"})
        answer.enable_chunked_encoding()
        await answer.prepare(request)
        for epoch in EPOCHS[:5]:
            await answer.write(epoch)
            await asyncio.sleep(1.0)
        return answer

    app = web.Application()
    app.router.add_get("/MOUNT", serve)
    runner = web.AppRunner(app)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0, ssl_context=server_context(authority, "127.0.0.1"))
    await site.start()
    bench = bench_of(runner.addresses[0][1], scheme="ntrips", ca_file=authority.file)
    task = asyncio.create_task(bench.feeder.run())
    await asyncio.sleep(5.5)
    task.cancel()
    await asyncio.wait({task})
    await runner.cleanup()
    assert bytes(bench.sent) == b"".join(EPOCHS[:5])
    assert requests[0]["Ntrip-Version"] == "Ntrip/2.0" and requests[0]["Ntrip-GGA"].startswith("$GPGGA,")
