"""Tables of the fleet file that belong to extensions: found by their names, checked by the extensions' own models. And
the extensions that have no table.

The entry points of the group `GROUP` name the extensions: the entry point ``metrics = "skygcs.ext.metrics:Metrics"``
owns the table [metrics]. Only the extensions whose tables a file has are imported.

Those of the group `ON_DEMAND` have no table: the entry point names the first word of their methods, or the begin of
their names up to a `_`, and such an extension is imported when one of these is first called.

`installed_points` is the one reader of entry points, for the groups of the shell and of the page as well. Packages are
read one by one: one that names a group of `skygcs` in metadata which cannot be read, or does not follow the format, is
left out and reported, and hides no other. https://packaging.python.org/en/latest/specifications/entry-points/
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, cast

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from skygcs.config.models import FleetConfig
    from skygcs.config.tables import Model, Problem

GROUP = "skygcs.extensions"
ON_DEMAND = "skygcs.on_demand"


OWN_PACKAGE = "skygcs."
"""Modules of the core and of the extensions that come with it begin so."""


class TableOwner(Protocol):
    """The part of an extension that its table needs; `skygcs.extension.Extension` has it."""

    Config: ClassVar[type[Model]]
    control_at: ClassVar[str | None]
    names: ClassVar[tuple[str, ...]]

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        """Everything wrong with its table beside the other tables."""
        ...

    @classmethod
    def applied(cls, config: Any, fleet: FleetConfig) -> FleetConfig:
        """The fleet file as the daemon runs it with this table."""
        ...

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        """Return what is missing and may come before the daemon starts."""
        ...

    @classmethod
    def fleet_notes(cls, config: Any, fleet: FleetConfig) -> list[str]:
        """Return what to look at in the fleet file for this table."""
        ...

    @classmethod
    def summary(cls, config: Any) -> str:
        """One line of `skygcs check`."""
        ...


class Installed(NamedTuple):
    """Entry points of one group by their names, and what is wrong with the packages, each for a person."""

    points: Mapping[str, EntryPoint]
    problems: tuple[str, ...]


def installed_points(group: str) -> Installed:
    """The entry points of a group; reads the packages' metadata (5 to 20 ms). Where two packages give one name,
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


def installed() -> dict[str, EntryPoint]:
    """The extensions that are installed, by the name of their table; reads the packages' metadata (5 to 20 ms)."""
    return dict(installed_points(GROUP).points)


def places_of_control() -> dict[str, str]:
    """Every value of `ControlSettings.at` that an installed extension knows, with the name of its table. It imports all
    extensions: for a file that names a place which its own do not know."""
    owners, _ = find_owners(set(installed()))
    return {owner.control_at: name for name, owner in owners.items() if owner.control_at is not None}


def find_owners(names: set[str]) -> tuple[dict[str, type[TableOwner]], dict[str, str]]:
    """The extensions that own these tables, and what is wrong with each that cannot be imported. Names without an
    extension are left out."""
    owners: dict[str, type[TableOwner]] = {}
    problems: dict[str, str] = {}
    known = installed() if names else {}
    for name in sorted(names & known.keys()):
        try:
            owners[name] = cast("type[TableOwner]", known[name].load())
        except (ImportError, AttributeError) as error:
            problems[name] = f"its extension {known[name].value} cannot be imported: {error}"
    return owners, problems


def word_problems(owners: Mapping[str, type[TableOwner]]) -> list[str]:
    """Which of these extensions take a first word of methods that an extension of skygcs itself has on demand. The
    table of one of ours may have the same name as what is made without it: it then takes its place."""
    ours = {word for word, point in on_demand().items() if point.value.startswith(OWN_PACKAGE)} if owners else set()
    taken = {name: sorted(_words_of(name, owner) & ours) for name, owner in owners.items()}
    return [f"[{name}]: methods that begin with {words[0]} are skygcs' own" for name, words in taken.items() if words]


def _words_of(name: str, owner: type[TableOwner]) -> set[str]:
    return {*owner.names} if owner.__module__.startswith(OWN_PACKAGE) else {name, *owner.names}


@functools.cache
def entry_point_problems() -> list[str]:
    """Faults in the entry points of installed extensions, each for a person."""
    return sorted({*installed_points(GROUP).problems, *installed_points(ON_DEMAND).problems})


@functools.cache
def on_demand() -> Mapping[str, EntryPoint]:
    """The installed extensions without a table, by the first word of their methods; reads the packages' metadata once
    (5 to 20 ms)."""
    return installed_points(ON_DEMAND).points


def demanded_word(name: str, words: Collection[str]) -> str:
    """The one of these words of extensions on demand that has the method ``name``; its first word if none has."""
    begin = name.partition("_")[0]
    return begin if begin in words else name.partition(".")[0]


def find_on_demand(word: str) -> type[TableOwner] | None:
    """The extension without a table whose methods begin with this word; None: none is installed. Raises what its import
    raises."""
    point = on_demand().get(word)
    return None if point is None else cast("type[TableOwner]", point.load())
