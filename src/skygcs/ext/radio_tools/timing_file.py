"""The file of `skygcs-cli radio measure`: one measurement for each air speed, as TOML. The fleet file's `timing_file`
and `link plan --timing` read it (`config.radio`)."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from skygcs.ext.radio_tools.network import SHARED
from skygcs.ext.radio_tools.settings import Firmware, RadioState
from skygcs.ext.radio_tools.timing_estimate import Ends, Timing

HEAD = "# Measured timing of radios; written by `skygcs-cli radio measure`. Read by timing_file of a radio link."

RECORDED = (*SHARED, "SERIAL_SPEED", "TXPOWER", "MAVLINK", "RXFRAME", "OPPRESEND", "OP_RESEND", "DUTY_CYCLE", "RTSCTS",
            "ANT_MODE", "NODECOUNT")  # fmt: skip
"""Settings that are written into the file, as the first radio has them."""

WAY_NAMES = ("a_to_b", "b_to_a")

MULTIPOINT = (Firmware.RFD_MULTIPOINT, Firmware.SIK_MULTIPOINT)


def pair_problems(names: tuple[str, str], states: tuple[RadioState, RadioState]) -> list[str]:
    """Return why no frames can go between these radios, one line each, with what to do."""
    (a, b), (one, two) = names, states
    if one.unique_id is not None and one.unique_id == two.unique_id:
        return [f"{a} and {b} are one radio (id {one.unique_id}): connect a second one"]
    found = []
    if one.firmware is not two.firmware:
        found.append(f"firmware differs: {a} has {one.firmware}, {b} has {two.firmware}; load the same into both")
    for name in SHARED:
        left, right = one.values.get(name), two.values.get(name)
        if left is not None and right is not None and left != right:
            found.append(
                f"{name} differs: {a} {left}, {b} {right}; make them alike: skygcs-cli radio set {b} {name}={left}"
            )
    if one.firmware in MULTIPOINT and one.node == two.node:
        found.append(f"both have node id {one.node}; give one of them another at its port: radio set {b} NODEID=…")
    for name, state, other in ((a, one, two), (b, two, one)):
        destination = state.values.get("NODEDESTINATION")
        if destination is not None and destination not in (255, 65535, other.node):
            found.append(
                f"{name} sends to node {destination} only (NODEDESTINATION), and the other is node {other.node}: "
                f"skygcs-cli radio set {name} NODEDESTINATION={other.node}"
            )
    return found


def ends_of(states: tuple[RadioState, RadioState], bauds: tuple[int, int], nodes: int | None) -> Ends:
    """Return what both radios' settings say of their places in the round. ``nodes``: from the command line."""
    first = states[0]
    if first.firmware not in MULTIPOINT:
        return Ends(bauds)
    master = 1 if first.firmware is Firmware.RFD_MULTIPOINT else 0
    places = [(state.node or 0) - master for state in states]
    return Ends(bauds, nodes or first.values.get("NODECOUNT"), (places[0], places[1]))


def measurement(
    timing: Timing, states: tuple[RadioState, RadioState], *, date: str, seconds: float, noise_bytes: tuple[int, int]
) -> dict[str, Any]:
    """One measurement as it stands in the file."""
    state = states[0]
    return {
        "date": date,
        "banner": state.banner,
        "firmware": str(state.firmware),
        "multipoint": state.firmware in MULTIPOINT,
        "air_speed_kbps": state.values.get("AIR_SPEED", 0),
        "seconds": seconds,
        "nodes": timing.nodes,
        "nodes_known": timing.nodes_known,
        "round_s": round(timing.round_s.value, 6),
        "round_low_s": round(timing.round_s.low, 6),
        "round_high_s": round(timing.round_s.high, 6),
        "jitter_s": round(timing.jitter_s, 6),
        "slot_s": round(timing.slot_s, 6),
        "sync_s": round(timing.sync_s, 6),
        "slot_bytes": round(timing.slot_bytes, 1),
        "serial_limited": timing.serial_limited,
        "noise_bytes": list(noise_bytes),
        "remarks": list(timing.remarks),
        "settings": {name: state.values[name] for name in RECORDED if name in state.values},
        "frames": [
            {
                "way": WAY_NAMES[row.way],
                "frame_bytes": row.frame_bytes,
                "throughput_bytes_per_s": _number(row.throughput_bytes_per_s, 1),
                "loss": round(row.loss.value, 4),
                "loss_low": round(row.loss.low, 4),
                "loss_high": round(row.loss.high, 4),
                "stream_loss": round(row.stream_loss, 4),
                "delay_mean_s": _number(row.delay_mean_s, 4),
                "delay_p50_s": _number(row.delay_p50_s, 4),
                "delay_p95_s": _number(row.delay_p95_s, 4),
                "single_frames": row.singles,
            }
            for row in timing.sizes
        ],
    }


def spoils(document: Mapping[str, Any] | None, new: Mapping[str, Any]) -> str | None:
    """Why ``new`` must not be written into this file; None: it may. One measurement that no link can use has a daemon
    refuse the whole file."""
    rows = [] if document is None else document.get("measurement")
    held = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    if held and any(row.get("multipoint") is not new["multipoint"] for row in held):
        kind = "a network" if new["multipoint"] else "a pair"
        return f"it holds measurements of another kind of radios than {kind}"
    if held and not new["air_speed_kbps"]:
        return "the radios do not report AIR_SPEED, by which its measurements are told apart"
    return None


def joined(document: Mapping[str, Any] | None, new: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The measurements of a file, ``new`` in the place of the one with its air speed; by air speed."""
    rows = [] if document is None else document.get("measurement")
    kept = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    kept = [row for row in kept if row.get("air_speed_kbps") != new["air_speed_kbps"]]
    return sorted([*kept, new], key=lambda row: _sortable(row.get("air_speed_kbps")))


def to_text(measurements: Sequence[Mapping[str, Any]], kind: str, version: int) -> str:
    """The whole file."""
    lines = [HEAD, f"kind = {_value(kind)}", f"version = {version}"]
    for row in measurements:
        lines += ["", "[[measurement]]", *_table("measurement", row)]
    return "\n".join(lines) + "\n"


def summary(row: Mapping[str, Any]) -> Iterator[str]:
    """One measurement for a screen."""
    yield f"{row['banner']}, AIR_SPEED {row['air_speed_kbps']}, {row['seconds']:g} s"
    known = "" if row["nodes_known"] else " (counted from round and slot; --nodes says it)"
    half_s = (row["round_high_s"] - row["round_low_s"]) / 2
    yield f"round      {row['round_s'] * 1000:.1f} ms ± {half_s * 1000:.2f} of {row['nodes']} nodes{known}"
    least = " or more" if row["serial_limited"] else ""
    yield f"slot       {row['slot_s'] * 1000:.1f} ms, {row['slot_bytes']:.0f} bytes{least}"
    yield f"sync slot  {row['sync_s'] * 1000:.1f} ms; arrivals spread by {row['jitter_s'] * 1000:.1f} ms"
    yield f"\n{'way':<8}{'frame B':>8}{'B/s':>8}{'loss':>7}{'of 95 %':>14}{'delay':>9}{'p95':>9}"
    for one in row["frames"]:
        bounds = f"{one['loss_low']:.1%}-{one['loss_high']:.1%}"
        delays = "".join(f"{'-' if (d := one[k]) < 0 else f'{d:.3f} s':>9}" for k in ("delay_mean_s", "delay_p95_s"))
        rate = "-" if one["throughput_bytes_per_s"] < 0 else f"{one['throughput_bytes_per_s']:,.0f}"
        yield f"{one['way']:<8}{one['frame_bytes']:>8}{rate:>8}{one['loss']:>7.1%}{bounds:>14}{delays}"
    for text in row["remarks"]:
        yield f"note: {text}"


def _table(name: str, row: Mapping[str, Any]) -> Iterator[str]:
    """The keys of a table, then its inner tables."""
    inner = {key: value for key, value in row.items() if isinstance(value, dict) or _is_tables(value)}
    for key, value in row.items():
        if key not in inner:
            yield f"{_key(key)} = {_value(value)}"
    for key, value in inner.items():
        if isinstance(value, dict):
            yield from ("", f"[{name}.{_key(key)}]", *_table(f"{name}.{_key(key)}", value))
        else:
            for one in value:
                yield from ("", f"[[{name}.{_key(key)}]]", *_table(f"{name}.{_key(key)}", one))


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, dict) for item in value)


def _key(key: str) -> str:
    return key if key.replace("_", "").isalnum() and key.isascii() else _value(key)


def _value(value: Any) -> str:
    """A TOML value; what the file never has, dates for instance, is written as text."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    text = json.dumps("".join(c for c in str(value) if c.isprintable() and ord(c) < 0x10000), ensure_ascii=True)
    return text


def _number(value: float | None, digits: int) -> float:
    """A number for the file; -1 where there is none."""
    return -1.0 if value is None or value == float("inf") else round(value, digits)


def _sortable(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else 0.0
