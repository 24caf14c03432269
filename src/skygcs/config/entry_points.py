"""Entry points of the installed packages: the one reader of all groups of `skygcs`.

Packages are read one by one: one that names a group of `skygcs` in metadata which cannot be read, or does not follow
the format, is left out and reported, and hides no other. https://packaging.python.org/en/latest/specifications/entry-points/
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

OWN_PACKAGE = "skygcs."
"""Modules of the core and of the extensions that come with it begin so."""


class Installed(NamedTuple):
    """Entry points of one group by their names, and what is wrong with the packages, each for a person."""

    points: Mapping[str, EntryPoint]
    problems: tuple[str, ...]


@functools.cache
def installed_points(group: str) -> Installed:
    """The entry points of a group; reads the packages' metadata once (5 to 20 ms). Where two packages give one name,
    that of skygcs itself counts, else the first by its value. Never raises for what a package has written."""
    found: dict[str, EntryPoint] = {}
    problems: list[str] = []
    points, unreadable = _all_points()
    for point in sorted((p for p in points if p.group == group), key=_precedence):
        if point.name not in found:
            found[point.name] = point
        elif found[point.name].value != point.value:
            first = found[point.name].value
            problems.append(f"{group}: {point.name} is {first}; another package's {point.value} is not used")
    return Installed(found, (*unreadable, *problems))


def _precedence(point: EntryPoint) -> tuple[str, bool, str]:
    return point.name, not point.value.startswith(OWN_PACKAGE), point.value


@functools.cache
def _all_points() -> tuple[list[EntryPoint], tuple[str, ...]]:
    from importlib.metadata import distributions  # with it come email and zipfile, which a plain daemon never uses

    points: list[EntryPoint] = []
    problems: list[str] = []
    seen: set[str] = set()
    for package in distributions():
        name = "a package"
        try:
            if "[skygcs." not in (package.read_text("entry_points.txt") or ""):
                continue
            name = str(package.metadata["Name"])  # it takes long: of those that have something for us
            if name in seen:  # another version of it, which an import does not find
                continue
            seen.add(name)
            points += [point for point in package.entry_points if point.group.startswith(OWN_PACKAGE)]
        except Exception as error:  # whatever a package has written
            problems.append(f"the entry points of {name} cannot be read, and are not used: {error!r}"[:300])
    return points, tuple(problems)
