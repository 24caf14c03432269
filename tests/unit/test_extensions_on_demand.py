"""Extensions that are made when one of their methods is called: one that fails is closed, reported and left out."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs import extension
from skygcs.errors import RefusedError
from skygcs.extension import MADE_AGAIN_S, Extension, Extensions, NoTable
from skygcs.rpc.dispatch import Method, MethodTable
from skygcs.rpc.models import NoParams
from support.table import each


class Kite(Extension[NoTable]):
    """Fails in the part that ``fails`` names."""

    fails = ""
    name = "kite.fly"
    done: list[str]

    def __init__(self, core: Any, config: NoTable) -> None:
        super().__init__(core, config)
        self._do("make")

    def _do(self, what: str) -> None:
        self.done.append(what)
        if what == self.fails:
            raise OSError(f"no {what}")

    def methods(self) -> Iterable[Method[Any]]:
        return (Method(self.name, NoParams, lambda context, _: None),)

    def registered(self) -> None:
        self._do("registered")

    def close(self) -> None:
        self._do("close")


class Rig:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.faults = 100.0, list[Exception]()
        self.kite = type("Kite", (Kite,), {"done": []})
        monkeypatch.setattr(extension, "find_on_demand", lambda word: self.kite if word == "kite" else None)
        core: Any = SimpleNamespace(now=lambda: self.now)
        self.extensions = Extensions({}, self.faults.append, core)
        self.table: MethodTable[Any] = MethodTable((Method("here.fly", NoParams, lambda context, _: None),))

    def demand(self) -> Any:
        return self.extensions.demand("kite", self.table.require_free)


@each(
    ("fails", "done"),
    [("make", ["make"]), ("registered", ["make", "registered", "close"]), ("name", ["make", "close"])],
)
def test_one_that_fails_is_closed_reported_once_and_tried_again_later(
    monkeypatch: pytest.MonkeyPatch, fails: str, done: list[str]
) -> None:
    rig = Rig(monkeypatch)
    rig.kite.fails = fails
    if fails == "name":
        rig.kite.name = "dragon.fly"  # not its own
    for _ in range(3):
        with pytest.raises(RefusedError, match="kite cannot be made"):
            rig.demand()
    assert (rig.kite.done, len(rig.faults), list(rig.extensions)) == (done, 1, [])
    rig.now += MADE_AGAIN_S
    rig.kite.fails, rig.kite.name = "", "kite.fly"
    assert [method.name for method in rig.demand()] == ["kite.fly"]
    assert len(rig.faults) == 1 and len(list(rig.extensions)) == 1


def test_one_whose_methods_the_table_has_never_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch)
    rig.table.add(list(rig.kite(SimpleNamespace(), NoTable()).methods()))
    rig.kite.done.clear()
    with pytest.raises(RefusedError, match=r"two methods are called kite\.fly"):
        rig.demand()
    assert rig.kite.done == ["make", "close"] and list(rig.extensions) == [] and len(rig.faults) == 1
