"""Compares two sets of parameters, and plans the changes by which a file is applied to a vehicle. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from skygcs.core.mavlink.param_encoding import Param, Value, equal, held_as, value_text
from skygcs.core.params.names import Sort, other_name, sort_of, turns_on
from skygcs.core.params.param_file import Entry, ParamFile, Rounding

THIRD_PARTY_RATIO = 0.2
"""If the vehicle does not know more than this share of a file, the file is of another firmware or vehicle type."""

FRAME_NAMES = ("FRAME_CLASS", "SYS_AUTOSTART", "MAV_TYPE", "CA_AIRFRAME")
"""Parameters of the airframe's type: a file that differs here is most likely of another vehicle."""

DEFAULT_SORTS: tuple[Sort, ...] = ("settings",)
"""The sorts that are applied; others belong to one vehicle only."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A parameter in which two sets differ; None for a set that does not have it.

    ``other``: its name in the second set, if that differs.
    """

    name: str
    first: Value | None
    second: Value | None
    other: str | None = None
    sort: Sort = "settings"

    @property
    def kind(self) -> Literal["changed", "only_first", "only_second"]:
        if self.second is None:
            return "only_first"
        return "only_second" if self.first is None else "changed"


@dataclass(frozen=True, slots=True)
class ParamChange:
    """One parameter to set: the vehicle's own name for it, old value (None: not known) and new value."""

    name: str
    value: Value
    before: Value | None
    sort: Sort = "settings"


@dataclass(frozen=True, slots=True)
class ApplyPlan:
    """The changes of applying a file, in this order.

    ``skipped``: names and why they are not applied. ``unknown``: the vehicle has no such parameter. ``problems``:
    values that the vehicle's types cannot hold. ``warnings``: signs that the file is of another vehicle.
    """

    changes: tuple[ParamChange, ...]
    same: int
    skipped: tuple[tuple[str, str], ...]
    unknown: tuple[str, ...]
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    rounding: Rounding = "exact"
    """Rounding of the file's values: smaller differences do not count."""


def diff(first: Iterable[Entry], second: Iterable[Entry]) -> list[Difference]:
    """The differences of two sets, by name; a parameter's names in two generations are one."""
    left, right = {e.name: e for e in first}, {e.name: e for e in second}
    found = []
    matched: set[str] = set()
    for name, entry in left.items():
        there = _name_in(name, right)
        if there is None:
            found.append(Difference(name, entry.value, None, sort=sort_of(name)))
            continue
        matched.add(there)
        other = right[there]
        if not equal(entry.value, other.value, entry.slack + other.slack):
            renamed = there if there != name else None
            found.append(Difference(name, entry.value, other.value, renamed, sort_of(name)))
    found += [Difference(n, None, e.value, sort=sort_of(n)) for n, e in right.items() if n not in matched]
    return sorted(found, key=lambda d: d.name)


def plan(
    file: ParamFile,
    held: Mapping[str, Param],
    *,
    sysid: int,
    compid: int,
    stack: str,
    include: Collection[Sort] = DEFAULT_SORTS,
) -> ApplyPlan:
    """The changes of applying ``file`` to a vehicle with the parameters ``held``. ``stack``: px4, ardupilot or generic.

    ``include``: sorts of parameters to apply (`sort_of`). Switches of features come first, because a vehicle may show a
    feature's parameters only then; the system id comes last, because the vehicle does not answer to the old one
    afterwards.
    """
    changes: list[ParamChange] = []
    skipped: list[tuple[str, str]] = []
    unknown: list[str] = []
    problems: list[str] = []
    same = 0
    entries = file.of_component(compid)
    for entry in entries:
        # leave out what is not to be applied, or not known to the vehicle
        sort = sort_of(entry.name)
        if sort not in include:
            skipped.append((entry.name, sort))
            continue
        name = _name_in(entry.name, held)
        if name is None:
            unknown.append(entry.name)
            continue
        # change what differs
        present = held[name]
        if equal(present.value, entry.value, entry.slack):
            same += 1
            continue
        try:
            wanted = held_as(entry.value, present.type)
        except ValueError as error:
            problems.append(f"line {entry.line}: {entry.name}: {error}")
            continue
        changes.append(ParamChange(name, wanted, present.value, sort))
    # in an order in which every change takes effect
    changes.sort(key=_turn)
    skipped += [(e.name, f"component {e.compid}") for e in file.entries if e.compid not in (None, compid)]
    warnings = _warnings(file, held, unknown, len(entries), sysid, stack)
    return ApplyPlan(tuple(changes), same, tuple(skipped), tuple(unknown), tuple(problems), warnings, file.rounding)


def _turn(change: ParamChange) -> int:
    if change.sort == "identity":
        return 2
    return 0 if turns_on(change.name) and change.value else 1


def _name_in(name: str, names: Mapping[str, object]) -> str | None:
    if name in names:
        return name
    other = other_name(name)
    return other if other in names else None


def _warnings(
    file: ParamFile, held: Mapping[str, Param], unknown: list[str], total: int, sysid: int, stack: str
) -> tuple[str, ...]:
    warnings = []
    if file.sysids and sysid not in file.sysids:
        warnings.append(f"the file is of vehicle {', '.join(map(str, sorted(file.sysids)))}; this is vehicle {sysid}")
    says = file.about.get("Stack", "").lower()
    for family in ("px4", "ardupilot"):
        if says.startswith(family) and stack != family:
            warnings.append(f"the file is of {file.about['Stack']}; this vehicle runs {stack}")
    if total and len(unknown) / total > THIRD_PARTY_RATIO:
        warnings.append(
            f"the vehicle has none of {len(unknown)} of the file's {total} parameters: "
            "the file is of another firmware, version or type of vehicle"
        )
    for entry in file.entries:
        present = held.get(entry.name)
        if entry.name in FRAME_NAMES and present is not None and not equal(present.value, entry.value, entry.slack):
            here = value_text(present.value)
            warnings.append(f"{entry.name} is {value_text(entry.value)} in the file and {here} here: another airframe")
    return tuple(warnings)
