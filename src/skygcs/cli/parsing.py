"""Parsing of what people type: numbers, lists, words, pairs of name and value; and negative numbers, which look like
options."""

from __future__ import annotations

import difflib
import json
import math
from typing import Any

import typer
from typer.core import TyperCommand

NUMBERS = {"ignore_unknown_options": True}
"""Context settings of commands whose arguments may be negative: "-79.2" is a number there, not an option."""


class NumbersCommand(TyperCommand):
    """A command with NUMBERS: one dash may begin a number, two dashes always begin an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        known = [name for param in self.get_params(ctx) for name in (*param.opts, *param.secondary_opts)]
        for arg in args:
            name = arg.partition("=")[0]
            if arg == "--":
                break
            if name.startswith("--") and name not in known:
                close = difflib.get_close_matches(name, [k for k in known if k.startswith("--")], n=1)
                ctx.fail(f"No such option: {name}" + (f" (did you mean {close[0]}?)" if close else ""))
        return super().parse_args(ctx, args)


_WORDS: dict[str, Any] = {"true": True, "false": False, "null": None, "none": None, "nan": None}


def parse_value(text: str) -> Any:
    """A number (also 0x…), true, false, null or nan (both null), a list "1,2,3" or "[1,2,3]", JSON, or the text."""
    word = text.strip()
    if word.lower() in _WORDS:
        return _WORDS[word.lower()]
    for parse in (_integer, float, _json):
        try:
            value = parse(word)
        except ValueError:
            continue
        return None if value != value or value in (float("inf"), float("-inf")) else value
    if "," in word and not word.startswith(("{", "[", '"')):
        parts = [parse_value(part) for part in word.split(",")]
        if not any(isinstance(part, str) for part in parts):
            return parts
    return text


def parse_pairs(pairs: list[str]) -> dict[str, Any]:
    """ "a=1" "b=x" as {"a": 1, "b": "x"}; dots make nested tables. Raises BadParameter."""
    result: dict[str, Any] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise typer.BadParameter(f"{pair!r} is not of the form name=value")
        *tables, last = key.split(".")
        table = result
        for name in tables:
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                raise typer.BadParameter(f"{pair!r}: {name} has a value already")
        if last in table:
            raise typer.BadParameter(f"{key} is given twice")
        table[last] = parse_value(value)
    return result


def parse_link(pairs: list[str]) -> dict[str, Any]:
    """`parse_pairs` for a link: filters and vehicles become lists, also a single value. Raises BadParameter."""
    link = parse_pairs(pairs)
    for key, value in link.items():
        if key.startswith(("allow_", "block_", "vehicles")) and not isinstance(value, list):
            names = value.split(",") if isinstance(value, str) else [value]
            link[key] = [parse_value(n.strip()) if isinstance(n, str) else n for n in names if n != ""]
    return link


def parse_number(text: str | float, what: str = "") -> float:
    """A finite number. Raises BadParameter that names ``what``."""
    prefix = f"{what}: " if what else ""
    try:
        value = float(text)
    except ValueError:
        raise typer.BadParameter(f"{prefix}{text!r} is not a number") from None
    if not math.isfinite(value):
        raise typer.BadParameter(f"{prefix}{text!r} is not a finite number")
    return value


def finite(text: str | float) -> float:
    """Parser of options and arguments that are numbers: typer's own accepts nan and inf, which JSON cannot carry."""
    return parse_number(text)


def within(option: str, value: float | None, least: float, most: float) -> None:
    """Raises BadParameter unless the value is between ``least`` and ``most``, or None."""
    if value is not None and not least <= value <= most:
        raise typer.BadParameter(f"{option}: {value:g} is not between {least:g} and {most:g}")


def parse_json(text: str, *, strict: bool = True) -> Any:
    """JSON in which NaN and Infinity (also as 1e999) are errors if ``strict``, else null. Raises ValueError."""

    def number(literal: str) -> float | None:
        value = float(literal)
        if strict and not math.isfinite(value):
            raise ValueError(f"{literal} is not a finite number")
        return value if math.isfinite(value) else None

    return json.loads(text, parse_constant=number, parse_float=number)


def parse_unset_number(text: str, what: str) -> float | None:
    """A number, or None for "nan", "null" or "-", which mean "not set"."""
    return None if text.lower() in ("nan", "null", "-") else parse_number(text, what)


def name_or_id(text: str) -> str | int:
    """ "33" is an id, everything else a name."""
    return int(text) if text.isdigit() else text


def _integer(text: str) -> int:
    return int(text, 16) if text.lower().startswith("0x") else int(text)


def _json(text: str) -> Any:
    if not text.startswith(("[", "{", '"')):
        raise ValueError
    return parse_json(text, strict=False)


def parse_rates(text: str | None) -> tuple[int, ...]:
    """The rates of --baud; empty if it is not given."""
    rates = []
    for part in text.split(",") if text else ():
        if not part.strip().isdecimal() or not 300 <= int(part) <= 4_000_000:
            raise typer.BadParameter(f"--baud: {part!r} is not a rate between 300 and 4000000")
        rates.append(int(part))
    return tuple(rates)
