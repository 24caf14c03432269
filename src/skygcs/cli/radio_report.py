"""What `skygcs-cli radio` tells: a radio, what became of a change, a network's plan, a difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import typer

from skygcs.modem.backup import Difference
from skygcs.modem.change import Ledger
from skygcs.modem.network import NetworkPlan
from skygcs.modem.settings import SERIAL_BAUD, Firmware, RadioState, inconsistencies

_MEANING = {"AIR_SPEED": "kbit/s", "TXPOWER": "dBm", "MIN_FREQ": "kHz", "MAX_FREQ": "kHz", "DUTY_CYCLE": "%"}
_WORDS = {"MAVLINK": ("raw", "MAVLink", "low latency"), "RXFRAME": ("raw", "MAVLink", "low latency"),
          "RTSCTS": ("off", "on"), "ECC": ("off", "on")}  # fmt: skip


def show(where: str, baud: int | None, state: RadioState) -> None:
    """One radio, for a person."""
    typer.echo(f"{where}: {state.banner} ({state.firmware})" + (f", answers at {baud} baud" if baud else ""))
    told = [("board", state.board), ("band", state.band), ("id", state.unique_id)]
    if line := ", ".join(f"{key} {value}" for key, value in told if value):
        typer.echo(f"  {line}")
    for register in state.registers.values():
        typer.echo(f"  {register.id:<4} {register.name:<18} {meant(register.name, register.value)}")
    for text in inconsistencies(state.values, state.firmware):
        typer.echo(f"  note: {text}")


def meant(name: str, value: int) -> str:
    """A value and what it stands for."""
    if name == "SERIAL_SPEED" and value in SERIAL_BAUD:
        return f"{value} ({SERIAL_BAUD[value]} baud)"
    if name == "NODEDESTINATION" and value in (255, 65535):
        return f"{value} (all nodes)"
    words = _WORDS.get(name, ())
    if value < len(words):
        return f"{value} ({words[value]})"
    return f"{value} {_MEANING[name]}" if name in _MEANING and value else str(value)


def state_json(where: str, baud: int | None, state: RadioState) -> dict[str, Any]:
    return {
        "radio": where,
        "baud": baud,
        "banner": state.banner,
        "firmware": state.firmware,
        "board": state.board,
        "band": state.band,
        "unique_id": state.unique_id,
        "node": state.node,
        "registers": [{"id": r.id, "name": r.name, "value": r.value} for r in state.registers.values()],
        "notes": inconsistencies(state.values, state.firmware),
    }


def outcome(where: str, ledger: Ledger) -> None:
    """What became of a change, for a person; trouble goes to stderr."""
    was_to_be = "" if ledger.ok else "was to be: "  # nobody is to read a wish for a deed
    for name, value in ledger.wanted.items():
        was = ledger.before.get(name)
        typer.echo(f"{where}: {was_to_be}{name} {was} -> {value}")
    if ledger.node_table is not None:
        typer.echo(f"{where}: {was_to_be}{ledger.node_table} (the master's node table; no firmware tells it back)")
    for i, text in enumerate(ledger.sentences()):
        typer.echo(f"{where}: {'' if ledger.ok else 'FAIL ' if i == 0 else '     '}{text}", err=not ledger.ok)


def outcome_json(where: str, ledger: Ledger) -> dict[str, Any]:
    return {
        "radio": where,
        "ok": ledger.ok,
        "problem": ledger.problem,
        "before": {name: ledger.before[name] for name in ledger.wanted},
        "wanted": ledger.wanted,
        "written": ledger.written,
        "perhaps_written": ledger.unsure,
        "node_table": ledger.node_table,
        "node_table_written": ledger.table_written,
        "saved": ledger.saved,
        "restarted": ledger.restarted,
        "verified": ledger.verified,
        "undone": ledger.undone,
        "differs": ledger.differs,
        "told": ledger.sentences(),
    }


def plan_rows(plan: NetworkPlan, firmware: Firmware) -> list[dict[str, Any]]:
    """Every node of a plan and its settings."""
    return [{"node": plan.settings(i, firmware)["NODEID"], "for": plan.name(i), "settings": plan.settings(i, firmware)}
            for i in range(plan.nodes)]  # fmt: skip


def show_plan(rows: Sequence[Mapping[str, Any]]) -> None:
    """What all have alike once, then what is each node's own."""
    alike = {n: v for n, v in rows[0]["settings"].items() if all(row["settings"].get(n) == v for row in rows)}
    typer.echo("all nodes: " + ", ".join(f"{name} {meant(name, value)}" for name, value in alike.items()))
    for row in rows:
        own = ", ".join(f"{n} {meant(n, v)}" for n, v in row["settings"].items() if n not in alike)
        typer.echo(f"  node {row['node']:<3} {row['for']:<14} {own}")


def show_differences(names: Sequence[str], found: Sequence[Difference]) -> None:
    width = max(14, *(len(name) for name in names))
    typer.echo(f"{'':<18} " + " ".join(f"{name:>{width}}" for name in names))
    for d in found:
        cells = ("-" if value is None else str(value) for value in (d.left, d.right))
        typer.echo(f"{d.name:<18} " + " ".join(f"{cell:>{width}}" for cell in cells))
