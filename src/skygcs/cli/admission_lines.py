"""What others send into a radio, for `skygcs-cli link status`: a few lines."""

from __future__ import annotations

from typing import Any

SHOWN_SOURCES = 8
"""Of the most who send; the rest is counted."""

WORDS = {
    "corrections": "corrections",
    "slowed": "slowed",
    "thinned": "too often",
    "repeated": "repeated",
    "held": "lists held",
    "refused_streams": "streams refused",
    "refused_logs": "logs refused",
    "refused_param_lists": "lists refused",
    "refused_files": "files refused",
    "refused_turn": "files of others' turn",
    "refused_rate": "rate 0",
    "dropped": "dropped",
    "malformed": "malformed",
    "needless": "needless heartbeats",
}


def third_party_lines(up: dict[str, Any]) -> list[str]:
    """Nothing where nobody else has sent anything."""
    third_party, corrections = up.get("third_party"), up.get("corrections")
    lines = []
    if third_party is not None and third_party["sources"]:
        lines.append(f"  others may have {third_party['bytes_per_s']:,.0f} B/s{_lists(third_party['param_lists'])}")
        sources = sorted(third_party["sources"], key=lambda s: -(s["sent"] + sum(s["counts"].values())))
        lines += [_source(source) for source in sources[:SHOWN_SOURCES]]
        if len(sources) > SHOWN_SOURCES:
            lines.append(f"    and {len(sources) - SHOWN_SOURCES} more")
    if corrections is not None and corrections["source"] is not None:
        lines.append(_corrections(corrections))
    return lines


def _lists(told: dict[str, Any]) -> str:
    running, waiting = told["running"], told["waiting"]
    if running is None:
        return ""
    waits = f", those of {', '.join(map(str, waiting))} wait" if waiting else ""
    return f"; parameters of {running['sysid']} come ({running['seen']} of {running['count'] or '?'}){waits}"


def _source(told: dict[str, Any]) -> str:
    parts = [f"sent {told['sent']:,} ({told['sent_bytes']:,} B)"]
    if told["waiting"]:
        parts.append(f"{told['waiting']} wait")
    parts += [f"{WORDS.get(name, name)} {count:,}" for name, count in told["counts"].items()]
    silent = f", silent for {told['age_s']:.0f} s" if told["age_s"] > 5 else ""
    return f"    {told['source']:<9} {', '.join(parts)}{silent}"


def _corrections(told: dict[str, Any]) -> str:
    source = told["source"]
    wait = "" if told["wait_p95_s"] is None else f", waited up to {told['wait_p95_s']:.1f} s"
    old = told["replaced"] + told["expired"] + told["dropped"]
    return (
        f"  corrections of {source >> 8}/{source & 0xFF}: {told['messages']:,} messages sent ({told['bytes']:,} B of "
        f"{told['bytes_per_s']:,.0f} B/s), {old:,} left out for newer ones{wait}"
    )
