"""What the extensions of this package add: the tests hold documents, roles and snapshots against all of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import import_module
from importlib.util import find_spec
from typing import Any, get_type_hints

from pydantic import BaseModel

from skygcs.config.extension_tables import find_owners, installed, on_demand
from skygcs.rpc.dispatch import Method
from skygcs.rpc.methods import METHODS

OWN = {name: point.value for name, point in sorted(installed().items()) if point.value.startswith("skygcs.ext.")}
"""The tables of our own extensions, and their classes."""

ON_DEMAND = {word: point.value for word, point in on_demand().items() if point.value.startswith("skygcs.ext.")}
"""Our own extensions without a table: the first word of their methods, and their classes."""


def _rooms_of(classes: Iterable[str]) -> list[str]:
    return sorted({".".join(value.partition(":")[0].split(".")[:3]) for value in classes})


ROOMS = _rooms_of((*OWN.values(), *ON_DEMAND.values()))
"""Their folders."""


def _methods_of(rooms: Iterable[str]) -> dict[str, Method[Any]]:
    return {
        method.name: method
        for room in rooms
        if find_spec(f"{room}.methods") is not None
        for method in import_module(f"{room}.methods").METHODS
    }


PLAIN_METHODS: dict[str, Method[Any]] = dict(METHODS) | _methods_of(_rooms_of(ON_DEMAND.values()))
"""Those of a daemon whose fleet file has no extension's table, by name."""

ALL_METHODS: dict[str, Method[Any]] = PLAIN_METHODS | _methods_of(_rooms_of(OWN.values()))
"""Those of the core and of our own extensions, by name."""


def extension_tables() -> Iterator[type[BaseModel]]:
    """The models of our own extensions' tables, and of the tables in them."""
    owners, problems = find_owners(set(OWN))
    assert not problems
    left: list[Any] = [owner.Config for owner in owners.values()]
    while left:
        annotation = left.pop()
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            yield annotation
            left += [field.annotation for field in annotation.model_fields.values()]
            if annotation.model_config.get("extra") == "allow":  # its further tables, by name
                left.append(get_type_hints(annotation)["__pydantic_extra__"])
        else:
            left += getattr(annotation, "__args__", ())
