"""Settings of a module that are written, and put back when one of them fails."""

from __future__ import annotations

import pytest

from skygcs.core.xbee.registers import parse_setting
from skygcs.errors import LinkError, RefusedError
from skygcs.ext.xbee.commands import _write
from skygcs.ext.xbee.port import baud_of


class Module:
    """An `XBeePort` and its module, which answers only at its own rate and in its own mode."""

    device, mode = "/dev/ttyX", "API"

    def __init__(self, refuses: str) -> None:
        self.held = {"NI": b"ground", "RR": b"\x0a", "BD": b"\x07", "AP": b"\x02"}
        self.refuses = refuses
        self.reopen(115200)

    def reopen(self, baud: int) -> None:
        if baud != baud_of(self.held["BD"]):
            raise LinkError("no XBee module answers")
        self.baud, self.escaped = baud, self.held["AP"] == b"\x02"

    def get(self, name: str, node: int | None = None) -> bytes | None:
        if (self.baud, self.escaped) != (baud_of(self.held["BD"]), self.held["AP"] == b"\x02"):
            raise LinkError(f"no answer to {name}")
        return self.held.get(name)

    def put(self, name: str, value: bytes, node: int | None = None) -> None:
        self.get(name)
        if name == self.refuses:
            raise RefusedError(f"{name}: bad value")
        self.held[name] = value


@pytest.mark.parametrize("refuses", ["RR", "BD", "AP", "WR"])
def test_all_is_put_back_over_the_rate_and_mode_that_the_module_has_then(refuses: str) -> None:
    module = Module(refuses)
    before = dict(module.held)
    wanted = {"NI": "base", "RR": "3", "BD": "57600", "AP": "1"}
    with pytest.raises(RefusedError, match="bad value; nothing was saved, what was written was put back"):
        _write(module, {name: parse_setting(name, text) for name, text in wanted.items()}, None)  # type: ignore[arg-type]
    assert module.held == before
