"""`skygcs-cli corrections`: send the RTK corrections of a base (RTCM 3) to all vehicles, and show how many arrived."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import os
import socket
import stat
import sys
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any

import typer

from skygcs.cancellation import ended
from skygcs.cli.connection import Exit, bytes_of, fail, run, run_show, show
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, within
from skygcs.cli.render import cut, plural, print_json, say, screen_width
from skygcs.errors import RpcError
from skygcs.rpc.client import Client
from skygcs.terminal_text import visible

corrections = typer.Typer(help="RTK corrections for all vehicles: send them, see what became of them.")

FILE_BYTES_PER_S = 1000.0
"""Rate of a recorded file without --rate: a base with four constellations sends about as much."""

TERMINAL_EVERY_S = 1.0
ELSEWHERE_EVERY_S = 60.0
"""Between two lines of a log that may run for days."""

PIECE_BYTES = 32768
"""Bytes per call; as base64 they fit into what corrections.send accepts."""

STEPS_PER_S = 10
"""Pieces per second of a recorded file."""

DOUBTFUL_BYTES = 2000
"""After so many bytes without a message it is no RTCM: a message has at most 1,029 bytes."""

MAX_SOURCE_CHARS = 64

NO_LINK = "no link to vehicles is open: corrections are lost until one is"
LINK_AGAIN = "a link to vehicles is open again"
NOT_TAKEN = "no link accepted a message: the vehicles' link is full or down (skygcs-cli links)"
TOO_LONG = (
    "a message of more than 720 bytes does not fit into GPS_RTCM_DATA and is left out: set the base to MSM4 instead of "
    "MSM7, or to fewer constellations"
)
NO_RTCM = "no RTCM 3 message so far: is the input RTCM 3 (and not RTCM 2, NMEA, UBX or an error message of the caster)?"


@corrections.command("send")
def send(
    file: Annotated[str, typer.Argument(metavar="FILE", help="RTCM 3; -: standard input.")] = "-",
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            metavar="B/S",
            parser=finite,
            help="Largest rate. [default: 1000 for a recorded file]",
            show_default=False,
        ),
    ] = None,
    every_s: Annotated[
        float | None,
        typer.Option(
            "--every",
            metavar="S",
            parser=finite,
            help="Period of the report. [default: 1; 60 if not on a terminal]",
            show_default=False,
        ),
    ] = None,
    json_output: Json = False,
) -> None:
    """Send corrections to all vehicles until they end: `str2str -in ntrip://… | skygcs-cli corrections send`.

    Example: skygcs-cli corrections send base.rtcm3
    """
    # check the input and its rate
    within("--rate", rate, 10, 1e6)
    within("--every", every_s, 0.1, 3600)
    descriptor = sys.stdin.fileno() if file == "-" else _opened(file)
    if os.isatty(descriptor):
        raise typer.BadParameter(
            "the input is a terminal, not RTCM: give a FILE, or pipe in a program that fetches corrections: "
            "str2str -in ntrip://USER:PASSWORD@CASTER/MOUNTPOINT | skygcs-cli corrections send"
        )
    if rate is None and stat.S_ISREG(os.fstat(descriptor).st_mode):
        rate = FILE_BYTES_PER_S

    async def command(gcs: Client) -> int:
        # forward the input
        report = _Report(json_output)
        stream = CorrectionStream(gcs, report.problem)
        source: AsyncIterator[bytes] = bytes_of(descriptor)
        limited = source if rate is None else at_rate(source, rate)
        period_s = every_s or (TERMINAL_EVERY_S if sys.stdout.isatty() else ELSEWHERE_EVERY_S)
        try:
            await forward(stream, limited, report.progress, period_s)
        finally:
            await stream.end()
            report.end(stream.tally)
        # report
        if not stream.tally.read_bytes:
            fail("no input: the program that fetches the corrections ended without a byte")
        return Exit.DONE if stream.tally.counts["messages"] else Exit.FAILED

    run(command)


class _Report:
    """Prints what was sent: one line that is overwritten on a terminal, else a line or a JSON object each time."""

    def __init__(self, json_output: bool) -> None:
        self._json = json_output
        self._live = sys.stdout.isatty() and not json_output

    def progress(self, tally: CorrectionTally, bytes_per_s: float) -> None:
        line = line_of(tally, bytes_per_s)
        if self._json:
            print_json({**tally.as_dict(), "bytes_per_s": round(bytes_per_s, 1)}, line=True)
        elif self._live:
            width = screen_width(sys.stdout)
            say(line if width is None else cut(line, width - 1), nl=False, over=True)
        else:
            say(line)
        sys.stdout.flush()

    def problem(self, text: str) -> None:
        if self._live:
            say("", nl=False, over=True)
        fail(text)

    def end(self, tally: CorrectionTally) -> None:
        if self._json:
            print_json(tally.as_dict(), line=True)
        else:
            say(f"sent {line_of(tally, None)}", over=self._live)


def _opened(file: str) -> int:
    try:
        return os.open(file, os.O_RDONLY | os.O_NOCTTY)
    except OSError as error:
        fail(f"cannot read {file}: {os.strerror(error.errno) if error.errno else error}")
        raise typer.Exit(Exit.FAILED) from None


@corrections.command("status")
def status(json_output: Json = False) -> None:
    """Show what was sent since the daemon started, what each radio did with it, and the fix of every vehicle.

    Example: skygcs-cli corrections status
    """
    run_show("corrections.status", json_output, status_lines)


def status_lines(status: dict[str, Any]) -> Iterator[str]:
    """The answer of corrections.status for a person."""
    # the source that the daemon asks itself
    if (own := status.get("own_source")) is not None:
        yield from own_source_lines(own)
    # what came in
    if status["age_s"] is None:
        yield "nothing was sent yet" if own else "nothing was sent yet through this daemon's socket"
    else:
        source = f"from {status['source']}" if status["source"] else "no source at present"
        yield (
            f"{source}: {status['messages']:,} messages, {status['bytes']:,} B, {status['bytes_per_s']:,.0f} B/s, "
            f"the last {status['age_s']:,.0f} s ago"
        )
    for type_, of in status["types"].items():
        yield f"  {type_:<5} {of['messages']:>7,} messages {of['bytes']:>10,} B, the last {of['age_s']:,.0f} s ago"
    flaws = (("not accepted by any link", "refused"), ("too long", "too_long"), ("damaged", "bad_crc"))
    for what, name in flaws:
        if status[name]:
            yield f"  {what}: {status[name]:,} messages"
    # what each radio did with it
    for radio in status["radios"]:
        of_source = "" if radio["source"] is None else f" of {radio['source']}"
        wait = "" if radio.get("wait_p95_s") is None else f", wait p95 {radio['wait_p95_s']:.1f} s"
        yield (
            f"{radio['link']} ({radio['peer']}): {radio['bytes_per_s']:,.0f} B/s for corrections, "
            f"{radio['messages']:,} messages{of_source} sent, {radio['waiting']:,} fragments waiting{wait}"
        )
        causes = ("replaced", "expired", "dropped", "too_long")
        lost = [f"{radio[name]:,} {name.replace('_', ' ')}" for name in causes if radio[name]]
        if radio["other_source"]:
            lost.append(f"{radio['other_source']:,} fragments of a second base refused")
        if lost:
            yield f"  {', '.join(lost)}"
    # what the vehicles got from it
    if status.get("rtk_fixed") or status.get("rtk_float"):
        of = plural(len(status["vehicles"]), "vehicle")
        yield f"{status['rtk_fixed']} fixed, {status['rtk_float']} float of {of}"
    for vehicle in status["vehicles"]:
        satellites = "" if vehicle["satellites"] is None else f", {vehicle['satellites']} satellites"
        yield f"{vehicle['name']}: {vehicle['fix'] or 'no GPS reported'}{satellites}"


def own_source_lines(own: dict[str, Any]) -> Iterator[str]:
    """The source of [corrections] for a person."""
    rate = f", {own['bytes_per_s']:,.0f} B/s" if own["state"] in ("streaming", "held_off") else ""
    age = "" if own["age_s"] is None else f", the last message {own['age_s']:,.0f} s ago"
    yield f"{own['name']}: {own['state'].replace('_', ' ')} for {own['since_s']:,.0f} s{rate}{age}"
    if own["text"]:
        yield f"  {visible(own['text'])}"
    if own["types"]:
        yield "  " + " ".join(f"{type_}:{count:,}" for type_, count in own["types"].items())
    if (gga := own["gga"]) is not None:
        if gga["age_s"] is None:
            connected = own["state"] in ("waiting", "streaming", "held_off")
            yield f"  no position sent to it yet{': no vehicle has a fix' if connected else ''}"
        else:
            yield f"  position of {visible(gga['from'])} sent to it {plural(gga['sent'], 'time')}"
    if (survey := own["survey"]) is not None:
        yield f"  {_survey_line(survey)}"


def _survey_line(survey: dict[str, Any]) -> str:
    if survey["state"] == "setting_up":
        return "the receiver is being set up"
    if survey["state"] == "fixed":
        return "position: from the fleet file"
    if survey["duration_s"] is None:
        return "survey-in: begun"
    done = "done" if survey["state"] == "surveyed" else "running"
    return (
        f"survey-in {done}: {survey['duration_s']:,} s of at least {survey['minimum_s']:,.0f} s, "
        f"{survey['accuracy_m']:.2f} m of {survey['wanted_m']:g} m, {survey['observations']:,} observations"
    )


@corrections.command("survey")
def survey(json_output: Json = False) -> None:
    """Have the base receiver of [corrections] survey its position in anew, as after its antenna was moved.

    Example: skygcs-cli corrections survey
    """

    async def command(gcs: Client) -> int:
        if (await gcs.call("corrections.status")).get("own_source") is None:
            fail("the daemon has no receiver of its own: its fleet file has no table [corrections]")
            return Exit.FAILED
        show(await gcs.call("corrections.survey"), json_output, own_source_lines)
        return Exit.DONE

    run(command)


# --- the stream -------------------------------------------------------------------------------------------------------


@dataclass
class CorrectionTally:
    """Counts of what was read and of what happened to it."""

    read_bytes: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    """Counts by kind, as the answer of corrections.send: messages, bytes, refused, too_long, bad_crc, skipped_bytes."""
    types: Counter[str] = field(default_factory=Counter)

    def as_dict(self) -> dict[str, Any]:
        names = ("messages", "bytes", "refused", "too_long", "bad_crc", "skipped_bytes")
        types = {type_: self.types[type_] for type_ in sorted(self.types, key=int)}
        return {"read_bytes": self.read_bytes, **{name: self.counts[name] for name in names}, "types": types}


class CorrectionStream:
    """Sends pieces to the daemon one after the other. ``report(text)`` gets the problems that a person can solve."""

    def __init__(self, gcs: Client, report: Callable[[str], None]) -> None:
        self.tally = CorrectionTally()
        self._gcs = gcs
        self._report = report
        self._source = f"skygcs-cli {os.getpid()} on {socket.gethostname()}"[:MAX_SOURCE_CHARS]
        self._reported: set[str] = set()
        self._linked = True

    async def send(self, data: bytes) -> None:
        """Raises RpcError while another source sends."""
        for at in range(0, len(data), PIECE_BYTES):
            piece = data[at : at + PIECE_BYTES]
            text = base64.b64encode(piece).decode("ascii")
            self.tally.read_bytes += len(piece)  # before the answer: an interrupted wait counts as read, too
            taken = await self._gcs.call("corrections.send", data=text, source=self._source)
            self.tally.types.update(taken.pop("types"))
            links = taken.pop("links")
            self.tally.counts.update(taken)
            self._report_news(taken, links)

    async def end(self) -> None:
        """Allow another source at once. If this call fails, the daemon notices by the silence of this one."""
        with contextlib.suppress(RpcError):
            await self._gcs.call("corrections.send", data="", source=self._source, end=True)

    def _report_news(self, taken: dict[str, int], links: int) -> None:
        if (links > 0) != self._linked:
            self._linked = links > 0
            self._report(LINK_AGAIN if links else NO_LINK)
        elif taken["refused"] and links:
            self._once(NOT_TAKEN)
        if taken["too_long"]:
            self._once(TOO_LONG)
        counts = self.tally.counts
        if self.tally.read_bytes >= DOUBTFUL_BYTES and not any(counts[n] for n in ("messages", "refused", "too_long")):
            self._once(NO_RTCM)

    def _once(self, text: str) -> None:
        if text not in self._reported:
            self._reported.add(text)
            self._report(text)


async def forward(
    stream: CorrectionStream,
    source: AsyncIterator[bytes],
    show: Callable[[CorrectionTally, float], None],
    every_s: float,
) -> None:
    """Send all that ``source`` yields; every ``every_s`` ``show`` gets the counts and the RTCM bytes per second."""

    async def watch() -> None:
        before = 0
        while True:
            await asyncio.sleep(every_s)
            now = stream.tally.counts["bytes"]
            show(stream.tally, (now - before) / every_s)
            before = now

    watching = asyncio.create_task(watch(), name="corrections report")
    try:
        async for data in source:
            await stream.send(data)
    finally:
        await ended(watching)


async def at_rate(source: AsyncIterator[bytes], bytes_per_s: float) -> AsyncIterator[bytes]:
    """The same bytes, at this rate at most."""
    clock = asyncio.get_running_loop().time
    size = max(1, round(bytes_per_s / STEPS_PER_S))
    due = clock()
    async for data in source:
        for at in range(0, len(data), size):
            piece = data[at : at + size]
            yield piece
            due += len(piece) / bytes_per_s
            await asyncio.sleep(max(0.0, due - clock()))


def line_of(tally: CorrectionTally, bytes_per_s: float | None) -> str:
    """Return what was sent, in one line."""
    counts = tally.counts
    rate = "" if bytes_per_s is None else f", {bytes_per_s:,.0f} B/s"
    types = " ".join(f"{type_}:{tally.types[type_]:,}" for type_ in sorted(tally.types, key=int))
    flaws = (
        ("not accepted", counts["refused"]),
        ("too long", counts["too_long"]),
        ("damaged", counts["bad_crc"]),
        ("bytes skipped", counts["skipped_bytes"]),
    )
    lost = "".join(f", {count:,} {what}" for what, count in flaws if count)
    messages = plural(counts["messages"], "message")
    return f"{messages}, {counts['bytes']:,} B{rate}{lost}{'  ' if types else ''}{types}"


def add_to(app: typer.Typer) -> None:
    app.add_typer(corrections, name="corrections")
