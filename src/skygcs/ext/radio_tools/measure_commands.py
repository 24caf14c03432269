"""`skygcs-cli radio measure`: the timing of radios, measured with two of them at serial ports of this computer."""

from __future__ import annotations

import asyncio
import os
import secrets
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, run_offline, waiting
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, parse_rates, within
from skygcs.cli.render import print_json, print_lines, say
from skygcs.cli.serial_ports import lent
from skygcs.core.radio_link.capacity import MAX_NODES, assumed_timing
from skygcs.errors import ConfigError, LinkError, RefusedError
from skygcs.ext.radio_tools.change import Visit, look
from skygcs.ext.radio_tools.link_probe import LinkProbe
from skygcs.ext.radio_tools.port import RadioPort, carry
from skygcs.ext.radio_tools.reading import LIKELY_BAUD
from skygcs.ext.radio_tools.settings import RadioState
from skygcs.ext.radio_tools.timing_estimate import estimate
from skygcs.ext.radio_tools.timing_file import ends_of, joined, measurement, pair_problems, spoils, summary, to_text

FILE_MODE = 0o644


def measure(
    port_a: Annotated[str, typer.Argument(metavar="PORT_A", help="One radio's serial port.", show_default=False)],
    port_b: Annotated[str, typer.Argument(metavar="PORT_B", help="The other one's.", show_default=False)],
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", parser=finite, help="How long frames are sent.")
    ] = 120.0,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Write it; other air speeds in FILE stay."),
    ] = None,
    nodes: Annotated[
        int | None, typer.Option("--nodes", metavar="N", min=2, max=64, help="Nodes that the network is set up for.")
    ] = None,
    baud: Annotated[
        str | None, typer.Option("--baud", metavar="RATE[,RATE…]", help="Rates to try. [default: the usual ones]")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Although vehicles of the running daemon are armed.")] = False,
    json_output: Json = False,
) -> None:
    """Measure round, slot, throughput, delay and loss between two radios at this computer; nothing in them is changed.

    The network is busy meanwhile: switch the vehicles off. The fleet file's `timing_file` and `link plan --timing` plan
    with the result.

    Example: skygcs-cli radio measure /dev/ttyUSB0 /dev/ttyUSB1 -o timing.toml
    """
    within("--seconds", seconds, 5, 3600)
    rates = parse_rates(baud) or LIKELY_BAUD

    def command() -> int:
        if os.path.realpath(port_a) == os.path.realpath(port_b):
            raise RefusedError(f"{port_a} and {port_b} are one port: two radios at two ports are needed")
        if output is not None:
            _existing(output)  # refused now, not after minutes
        row = asyncio.run(_measured((port_a, port_b), rates, seconds=seconds, nodes=nodes, force=force))
        if json_output:
            print_json(row)
        else:
            print_lines(summary(row))
        if output is None:
            say("not written; to plan with it: -o FILE", err=True)
        else:
            _write(output, row)
            say(f"AIR_SPEED {row['air_speed_kbps']} -> {output}", err=True)
        return Exit.DONE

    run_offline(command)


def _existing(file: Path) -> dict[str, Any] | None:
    """The timing file that is there; None: there is none. Raises RefusedError for what cannot be written."""
    from skygcs.config.radio import read_timing_document

    if not os.path.lexists(file):
        if not file.parent.is_dir() or not os.access(file.parent, os.W_OK):
            raise RefusedError(f"{file} cannot be written: {file.parent} is not a folder, or not yours to write to")
        return None
    try:
        return read_timing_document(file)
    except ConfigError as error:
        raise RefusedError(
            f"{file} exists and is not a timing file ({'; '.join(error.problems)}); it stays as it is; name another"
        ) from None


def _write(file: Path, row: dict[str, Any]) -> None:
    """Write the file whole or not at all."""
    from skygcs.config.files import write_whole
    from skygcs.config.radio import TIMING_KIND, TIMING_VERSION

    document = _existing(file)
    if (why := spoils(document, row)) is not None:
        raise RefusedError(f"{file} stays as it is: {why}; give another name")
    text = to_text(joined(document, row), TIMING_KIND, TIMING_VERSION)
    try:
        write_whole(file, text.encode(), FILE_MODE)
    except OSError as error:
        raise RefusedError(f"{file} cannot be written: {error.strerror}") from None


async def _measured(
    names: tuple[str, str], rates: tuple[int, ...], *, seconds: float, nodes: int | None, force: bool
) -> dict[str, Any]:
    """Read both radios, send frames between them, and return what came of it."""
    from skygcs.config.dialects import load_dialect

    async with lent(names, changes=True, force=force):
        with RadioPort(names[0]) as port_a, RadioPort(names[1]) as port_b:
            ports = (port_a, port_b)
            a, b = [await _look(port, rates) for port in ports]
            states, bauds = (a[1], b[1]), (a[0], b[0])
            if problems := pair_problems(names, states):
                raise RefusedError("; ".join(problems))
            for port, state in zip(ports, states, strict=True):
                port.set_flow_control(bool(state.values.get("RTSCTS")))
            ends = ends_of(states, bauds, nodes)
            loop = asyncio.get_running_loop()
            probe = LinkProbe(
                load_dialect("common"),
                seconds=seconds,
                session=secrets.randbelow(0xFFFF) + 1,
                lost_after_s=_longest_delay_s(states[0], ends.nodes),
                now=loop.time(),
            )
            begin = loop.time()
            async with waiting(lambda: f"measuring, {loop.time() - begin:.0f} s of some {seconds * 1.2:.0f}"):
                await carry(ports, probe)
    if probe.silent:
        raise LinkError(_silence(names, probe))
    timing = estimate(probe.frames, ends)
    date = datetime.now(UTC).isoformat(timespec="seconds")
    return measurement(timing, states, date=date, seconds=seconds, noise_bytes=probe.noise_bytes)


async def _look(port: RadioPort, rates: tuple[int, ...]) -> tuple[int, RadioState]:
    """The rate of the port and the state of its radio, which passes on data again. Raises LinkError."""
    visit = Visit()
    try:
        async with waiting(f"{port.device}: reading"):
            state = await port.run(look(visit, rates, None), visit)
    except LinkError as error:
        raise LinkError(f"{port.device}: {str(error).removeprefix(f'{port.device}: ')}") from None
    assert visit.baud is not None
    return visit.baud, state


def _longest_delay_s(state: RadioState, nodes: int | None) -> float:
    """After which a frame is taken for lost before anything is known of the rounds."""
    air_kbps = max(state.values.get("AIR_SPEED", 64), 2)
    return min(30.0, 2.0 + 3 * assumed_timing(air_kbps).round_s(nodes or MAX_NODES))


def _silence(names: tuple[str, str], probe: LinkProbe) -> str:
    """Return which ways were silent and what to do."""
    ways = [f"from {names[way]} to {names[1 - way]}" for way in probe.silent]
    noise = sum(probe.noise_bytes)
    heard = f"; {noise} bytes came that are no frames: is RAW or another program in between?" if noise else ""
    return (
        f"nothing arrives {' and '.join(ways)}: are both antennas on, the master (node 1, of open SiK 0) powered, "
        f"and NODEDESTINATION and encryption keys right? skygcs-cli radio diff {' '.join(names)}{heard}"
    )
