"""Tables of the fleet file that belong to extensions: found by their names, checked by the extensions' own models. And
the extensions that have no table.

The entry points of the group `GROUP` name the extensions: the entry point ``metrics = "skygcs.ext.metrics:Metrics"``
owns the table [metrics]. Only the extensions whose tables a file has are imported.

Those of the group `ON_DEMAND` have no table: the entry point names the first word of their methods, and such an
extension is imported when one of these is first called.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, cast

from skygcs.config.entry_points import installed_points
from skygcs.config.tables import Model, Problem

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from skygcs.config.models import FleetConfig

GROUP = "skygcs.extensions"
ON_DEMAND = "skygcs.on_demand"


class TableOwner(Protocol):
    """The part of an extension that its table needs; `skygcs.extension.Extension` has it."""

    Config: ClassVar[type[Model]]
    control_at: ClassVar[str | None]

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


def installed() -> dict[str, EntryPoint]:
    """The extensions that are installed, by the name of their table; reads the packages' metadata (5 to 20 ms)."""
    return dict(installed_points(GROUP).points)


def places_of_control() -> dict[str, str]:
    """Every value of `ControlSettings.at` that an installed extension knows, with the name of its table. It imports all
    extensions: for a file that names a place which its own do not know."""
    owners, _ = find_owners(set(installed()))
    return {owner.control_at: name for name, owner in owners.items() if owner.control_at is not None}


def find_owners(names: set[str]) -> tuple[dict[str, type[TableOwner]], list[Problem]]:
    """The extensions that own these tables, and a problem for each that cannot be imported. Names without an extension
    are left out."""
    owners: dict[str, type[TableOwner]] = {}
    problems: list[Problem] = []
    known = installed() if names else {}
    for name in sorted(names & known.keys()):
        try:
            owners[name] = cast("type[TableOwner]", known[name].load())
        except (ImportError, AttributeError) as error:
            problems.append(Problem((name,), f"its extension {known[name].value} cannot be imported: {error}"))
    return owners, problems


def entry_point_problems() -> list[str]:
    """What is wrong with the entry points of installed extensions, each for a person."""
    return sorted({*installed_points(GROUP).problems, *installed_points(ON_DEMAND).problems})


def on_demand() -> Mapping[str, EntryPoint]:
    """The installed extensions without a table, by the first word of their methods; reads the packages' metadata once
    (5 to 20 ms)."""
    return installed_points(ON_DEMAND).points


def find_on_demand(word: str) -> type[TableOwner] | None:
    """The extension without a table whose methods begin with this word; None: none is installed. Raises what its import
    raises."""
    point = on_demand().get(word)
    return None if point is None else cast("type[TableOwner]", point.load())
