"""What the radio benchmark measured: a table with both columns side by side, and its targets judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from skygcs.core.radio_link.capacity import PROFILES, LinkDemand, plan_link

AGE_S = 2.5
ACK_SPARE_S = 0.5
EMERGENCY_REPEAT_S = 0.5
"""The targets: position age at p95; acknowledgements within two rounds and this; a stop within two rounds and its
first repeats."""

CARRIES = {64.0: 10, 125.0: 15}
"""Vehicles that are to be carried, by air speed."""

COLLAPSES_ABOVE = 4
"""Vehicles. Said of the plain way: "single or two drones works well, three occasionally, more than four terrible"."""


Row = dict[str, Any]


class Verdict(NamedTuple):
    """One target on one cell."""

    where: str
    target: str
    got: str
    met: bool
    why: str = ""
    """Of one that was missed: what the arithmetic of the radio says of it."""

    def line(self) -> str:
        why = f"; {self.why}" if self.why else ""
        return f"{'met   ' if self.met else 'MISSED'}  {self.where}: {self.target}: {self.got}{why}"


# -- the table


def _s(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


LINES: Sequence[tuple[str, Callable[[Row], str]]] = (
    ("vehicles heard", lambda r: str(r["heard"])),
    ("position age p50 (s)", lambda r: _s(r["age_p50_s"])),
    ("position age p95 (s)", lambda r: _s(r["age_p95_s"])),
    ("positions per vehicle (Hz)", lambda r: f"{r['positions_per_vehicle_per_s']:.2f}"),
    ("frames lost", lambda r: f"{r['loss']:.1%}"),
    ("command ACK p50 (s)", lambda r: _s(r["ack_p50_s"])),
    ("command ACK p95 (s)", lambda r: _s(r["ack_p95_s"])),
    ("commands lost", lambda r: f"{r['lost_commands']}/{r['commands']}"),
    ("all usable after (s)", lambda r: "never" if r["usable_s"] is None else f"{r['usable_s']:.1f}"),
    ("stop heard by", lambda r: f"{r['emergency_reached']}/{r['vehicles']}"),
    ("stop heard by the last (s)", lambda r: _s(r["emergency_max_s"])),
)


def table(rows: Sequence[Row]) -> str:
    """One block for each air speed; a pair of columns, plain and skygcs, for each number of vehicles."""
    out: list[str] = []
    for air in sorted({r["air_kbps"] for r in rows}):
        cells = {(r["vehicles"], r["column"]): r for r in rows if r["air_kbps"] == air}
        numbers = sorted({vehicles for vehicles, _ in cells})
        out += [
            f"{f'{air:g} kbit/s':<28}" + "".join(f"{f'{n} vehicles':>18}" for n in numbers),
            f"{'':<28}" + "".join(f"{'plain':>10}{'skygcs':>8}" for _ in numbers),
        ]
        for label, reported in LINES:
            pairs = (f"{reported(cells[n, 'plain']):>10}{reported(cells[n, 'skygcs']):>8}" for n in numbers)
            out.append(f"{label:<28}" + "".join(pairs))
        out.append("")
    return "\n".join(out)


# -- the targets


def verdicts(rows: Sequence[Row]) -> list[Verdict]:
    """Every target on every cell of the skygcs column in which it is to be met."""
    return [v for r in rows if r["column"] == "skygcs" and r["vehicles"] <= CARRIES[r["air_kbps"]] for v in judged(r)]


def judged(row: Row) -> list[Verdict]:
    """All targets on one cell."""
    two_rounds = 2 * row["round_s"]
    where = f"{row['vehicles']} vehicles at {row['air_kbps']:g} kbit/s"
    age, ack, stop = row["age_p95_s"], row["ack_p95_s"], row["emergency_max_s"]
    reached = row["emergency_reached"]
    limits = (two_rounds + ACK_SPARE_S, two_rounds + EMERGENCY_REPEAT_S)
    reported = (
        (f"position age p95 <= {AGE_S:g} s", f"{_s(age)} s", age is not None and age <= AGE_S),
        (
            f"command ACK p95 <= {limits[0]:.2f} s (two rounds + {ACK_SPARE_S:g} s)",
            f"{_s(ack)} s",
            ack is not None and ack <= limits[0],
        ),
        (
            "no command lost after its repeats",
            f"{row['lost_commands']} of {row['commands']}",
            row["lost_commands"] == 0,
        ),
        (
            f"an emergency stop on the flooded link reaches all within {limits[1]:.2f} s (two rounds + its repeats)",
            f"{reached} of {row['vehicles']}, the last after {_s(stop)} s",
            reached == row["vehicles"] and stop is not None and stop <= limits[1],
        ),
    )
    return [Verdict(where, target, got, met, "" if met else _arithmetic(row)) for target, got, met in reported]


def summary(reported: Sequence[Verdict]) -> str:
    """How many were met, those of the largest cell of each air speed, and every one that was missed."""
    largest = {where.split(" at ")[1]: where for where, *_ in reported}  # of each air speed the last
    shown = [v.line() for v in reported if v.where in largest.values() or not v.met]
    return "\n".join(
        [f"{sum(v.met for v in reported)} of {len(reported)} targets of the skygcs column are met", *shown]
    )


def collapse(rows: Sequence[Row]) -> list[Verdict]:
    """Whether the plain column fails where it is told to have failed; if not, the emulated radio is too kind."""
    found = []
    for row in rows:
        if row["column"] == "plain" and row["vehicles"] > COLLAPSES_ABOVE:
            missed = [v for v in judged(row) if not v.met]
            where = f"{row['vehicles']} vehicles at {row['air_kbps']:g} kbit/s"
            got = "misses " + "; ".join(f"{v.target}: {v.got}" for v in missed) if missed else "meets every target"
            found.append(Verdict(where, "plain is to collapse", got, bool(missed)))
    return found


def _arithmetic(row: Row) -> str:
    plan = plan_link(LinkDemand(row["vehicles"], 57600, row["air_kbps"], "nav", PROFILES["nav"]))
    ways = ", ".join(f"{w.name} {w.needed:,.0f} of {w.capacity:,.0f} B/s" for w in plan.directions)
    fits = "which fits: no reason there" if plan.fits else "; ".join(plan.problems)
    return f"a round takes {row['round_s']:.2f} s; {ways}; {fits}"
