"""What the commands of `skygcs-cli radio` do, once their options are understood."""

from __future__ import annotations

import asyncio
import json
import os
import stat
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from skygcs.cli import radio_report as report
from skygcs.cli.connection import Exit, fail, waiting
from skygcs.cli.radio_daemon import lent
from skygcs.cli.radio_port import RadioPort
from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig, SerialLink
from skygcs.errors import ConfigError, LinkError, RefusedError, SkygcsError
from skygcs.modem.backup import MAX_BYTES, differences, from_toml, restorable, to_toml
from skygcs.modem.change import Ledger
from skygcs.modem.network import NetworkPlan, NetworkSettings, check_network, plan_network
from skygcs.modem.reading import LIKELY_BAUD
from skygcs.modem.settings import Firmware, RadioState
from skygcs.modem.visit import Visit, change, look

NODE_OWN = frozenset({"NODEID", "NODEDESTINATION", "NETCOUNT"})
"""Differ in a network as they must."""

Wanted = Callable[[RadioState], Mapping[str, int]]


def show_radio(port: str, remote: int | None, rates: Sequence[int], force: bool, as_json: bool) -> int:
    baud, state = asyncio.run(_lent_look(port, remote, rates, force))
    where = _named(port, remote)
    if as_json:
        typer.echo(json.dumps(report.state_json(where, baud, state), indent=2))
    else:
        report.show(where, baud, state)
    return Exit.DONE


def set_radio(
    port: str, remote: int | None, rates: Sequence[int], values: Mapping[str, int], force: bool, as_json: bool
) -> int:
    return _change_one(port, remote, rates, lambda _: values, force, as_json)


def backup(port: str, file: Path | None, remote: int | None, rates: Sequence[int], force: bool, overwrite: bool) -> int:
    if file is not None and file.exists() and not overwrite:
        raise RefusedError(f"{file} exists; --overwrite replaces it")
    _, state = asyncio.run(_lent_look(port, remote, rates, force))
    text = to_toml(state, f"Read from {_named(port, remote)}.")
    if file is None:
        typer.echo(text, nl=False)
    else:
        file.write_text(text, encoding="utf-8")
        typer.echo(f"{len(state.registers)} settings of {_named(port, remote)} -> {file}")
    return Exit.DONE


def restore(port: str, file: Path, remote: int | None, rates: Sequence[int], force: bool, as_json: bool) -> int:
    saved = _backup_of(file)

    def wanted(state: RadioState) -> Mapping[str, int]:
        if state.firmware is not saved.firmware:
            raise RefusedError(
                f"{file} is of {saved.firmware} ({saved.banner}), this radio has {state.firmware} ({state.banner}): "
                "their settings are not each other's; set single ones with: skygcs-cli radio set"
            )
        return restorable(saved)

    return _change_one(port, remote, rates, wanted, force, as_json)


def diff(sources: Sequence[str], rates: Sequence[int], force: bool, as_json: bool) -> int:
    radios = asyncio.run(_read_all(sources, rates, force))
    (first, left), *others = radios.items()
    found = {name: differences(left.values, right.values) for name, right in others}
    ids = [state.unique_id for state in radios.values()]
    one_twice = any(told is not None and ids.count(told) > 1 for told in ids)  # a radio and its own backup
    multipoint = all(state.node is not None for state in radios.values()) and not one_twice
    wrong = check_network(radios) if multipoint else []
    if as_json:
        pairs = {name: [{"name": d.name, first: d.left, name: d.right} for d in rows] for name, rows in found.items()}
        typer.echo(json.dumps({"first": first, "differences": pairs, "problems": wrong}, indent=2))
    else:
        for name, rows in found.items():
            if rows:
                report.show_differences((first, name), rows)
            else:
                typer.echo(f"{first} and {name} hold the same")
        for text in wrong:
            typer.echo(f"network: {text}")
        if multipoint and not wrong:
            typer.echo("as one network they go together")
    different = any(d.name not in NODE_OWN or not multipoint for rows in found.values() for d in rows)
    return Exit.FAILED if different or wrong else Exit.DONE


def provision(
    fleet: Path,
    ports: Sequence[str],
    nodes: int | None,
    first: int,
    common: NetworkSettings,
    rates: Sequence[int],
    force: bool,
    as_json: bool,
) -> int:
    twice = [port for port, times in Counter(os.path.realpath(port) for port in ports).items() if times > 1]
    if twice:
        raise RefusedError(f"{', '.join(twice)} is given twice: each radio of the network is set up once, at its port")
    config = load_fleet(fleet)
    link = _radio_link(config)
    vehicles = [name for name, _ in sorted(config.vehicles.items(), key=lambda item: item[1].sysid)]
    if link is not None:
        common = replace(common, serial_baud=_first_rate(link), rtscts=link.rtscts)
    plan = plan_network(vehicles, nodes, common)
    if first + len(ports) - 1 > plan.nodes:
        raise RefusedError(f"{len(ports)} ports from node {first} on are more than the plan's {plan.nodes} radios")
    rows = report.plan_rows(plan, Firmware.RFD_MULTIPOINT)
    if not ports:
        if as_json:
            typer.echo(json.dumps({"nodes": plan.nodes, "plan": rows, "radios": []}, indent=2))
        else:
            report.show_plan(rows)
            typer.echo(
                f"set them up: skygcs-cli radio provision {fleet} PORT … [--node K]; all powered at the same time"
            )
        return Exit.DONE
    if not as_json:
        report.show_plan(rows)
    bauds = rates or tuple(dict.fromkeys((common.serial_baud, *LIKELY_BAUD)))
    done = asyncio.run(_provision(plan, ports, first - 1, bauds, force, as_json))
    if as_json:
        radios = [report.outcome_json(port, ledger) for port, ledger in done.items()]
        typer.echo(json.dumps({"nodes": plan.nodes, "plan": rows, "radios": radios}, indent=2))
    good = sum(ledger.ok for ledger in done.values())
    if not as_json:
        last = first + len(ports) - 1
        left = [str(i) for i in range(1, plan.nodes + 1) if not first <= i <= last]
        typer.echo(
            f"{good} of {len(ports)} radios are set up" + (f"; still to do: radio {', '.join(left)}" if left else "")
        )
    return Exit.DONE if good == len(ports) else Exit.FAILED


async def _provision(
    plan: NetworkPlan, ports: Sequence[str], position: int, bauds: Sequence[int], force: bool, quiet: bool
) -> dict[str, Ledger]:
    """One after the other, every one of them also after a failure of another."""
    done: dict[str, Ledger] = {}
    async with lent(ports, changes=True, force=force):
        for i, port in enumerate(ports, position):
            if not quiet:
                typer.echo(f"{port}: radio {i + 1} of {plan.nodes}, {plan.name(i)} …")

            def wanted(state: RadioState, i: int = i) -> Mapping[str, int]:
                return plan.settings(i, state.firmware)

            ledger = await _change(port, None, bauds, wanted)
            done[port] = ledger
            if not quiet:
                report.outcome(port, ledger)
    return done


def _change_one(port: str, remote: int | None, rates: Sequence[int], wanted: Wanted, force: bool, as_json: bool) -> int:
    async def work() -> Ledger:
        async with lent([port], changes=True, force=force):
            return await _change(port, remote, rates or LIKELY_BAUD, wanted)

    ledger = asyncio.run(work())
    where = _named(port, remote)
    if as_json:
        typer.echo(json.dumps(report.outcome_json(where, ledger), indent=2))
    else:
        report.outcome(where, ledger)
    if "SERIAL_SPEED" in ledger.written and remote is None:
        typer.echo("the fleet file's baud of this link, and of the autopilot's port, must be the same", err=True)
    if "NODEID" in ledger.written:
        typer.echo(
            f"no other radio of this network may have node id {ledger.wanted['NODEID']}; to compare them: "
            "skygcs-cli radio diff PORT PORT …",
            err=True,
        )
    return Exit.DONE if ledger.ok else Exit.FAILED


async def _change(port: str, remote: int | None, bauds: Sequence[int], wanted: Wanted) -> Ledger:
    """A ledger whatever happens, once the port is open; Ctrl-C comes out after what was done is told."""
    visit = Visit()
    try:
        with RadioPort(port) as radio:
            async with waiting(f"{_named(port, remote)}: looking, writing, restarting"):
                return await radio.run(change(visit, bauds, remote, wanted), visit)
    except SkygcsError as error:
        ledger = visit.ledger or Ledger()
        ledger.problem = str(error).removeprefix(f"{port}: ")
        return ledger
    except BaseException:
        if visit.ledger is not None:
            visit.ledger.problem = "interrupted"
            for text in visit.ledger.sentences():
                fail(f"{_named(port, remote)}: {text}")
        raise


async def _lent_look(port: str, remote: int | None, rates: Sequence[int], force: bool) -> tuple[int | None, RadioState]:
    async with lent([port], changes=False, force=force):
        return await _look(port, remote, rates)


async def _look(port: str, remote: int | None, rates: Sequence[int]) -> tuple[int | None, RadioState]:
    visit = Visit()
    with RadioPort(port) as radio:
        try:
            async with waiting(f"{_named(port, remote)}: looking"):
                state = await radio.run(look(visit, rates or LIKELY_BAUD, remote), visit)
        except LinkError as error:
            raise LinkError(str(error) if str(error).startswith(port) else f"{port}: {error}") from None
    return visit.baud, state


async def _read_all(sources: Sequence[str], rates: Sequence[int], force: bool) -> dict[str, RadioState]:
    ports = [s for s in sources if _is_port(s)]
    async with lent(ports, changes=False, force=force):
        radios = {}
        for source in sources:
            if source in ports:
                _, radios[source] = await _look(source, None, rates)
            else:
                radios[source] = _backup_of(Path(source))
    if len(radios) < 2:
        raise RefusedError(f"{sources[0]} is one radio; give two different ones")
    return radios


def _is_port(source: str) -> bool:
    try:
        return stat.S_ISCHR(Path(source).stat().st_mode)
    except OSError:
        return source.startswith("/dev/")


def _backup_of(file: Path) -> RadioState:
    try:
        with file.open("rb") as source:
            text = source.read(MAX_BYTES + 1).decode("utf-8")
    except UnicodeDecodeError:
        raise ConfigError(str(file), ["this is no text; is it a backup of `skygcs-cli radio backup`?"]) from None
    return from_toml(text, str(file))


def _radio_link(config: FleetConfig) -> SerialLink | None:
    serial: list[Any] = [link for link in config.links.values() if isinstance(link, SerialLink)]
    return next((link for link in serial if link.role == "radio"), serial[0] if serial else None)


def _first_rate(link: SerialLink) -> int:
    return link.baud if isinstance(link.baud, int) else link.baud[0]


def _named(port: str, remote: int | None) -> str:
    return port if remote is None else f"{port} remote {remote}"
