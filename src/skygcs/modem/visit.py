"""One visit to the radio at a port: find it, read it or change it, and leave it passing data on."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass

from skygcs.errors import RefusedError, SkygcsError
from skygcs.modem.change import Ledger, apply, prepare
from skygcs.modem.dialogue import Reply, Step
from skygcs.modem.reading import LOCAL, Side, connect, leave, read, side_of
from skygcs.modem.settings import RadioState


@dataclass(slots=True)
class Visit:
    """How far a visit has come; for whoever has to end it in the middle."""

    baud: int | None = None
    """The rate at which the radio answered."""
    state: RadioState | None = None
    """What was read of the radio that the visit is about, before any change."""
    ledger: Ledger | None = None
    """Of a change: what was done so far."""
    _command_line: bool = False

    def farewell(self) -> bytes:
        """What to write to the port before it is closed in the middle; nothing once the visit is over."""
        if self.ledger is not None:
            return self.ledger.farewell()
        return b"\rATO\r" if self._command_line else b""


def look(visit: Visit, bauds: Sequence[int], remote: int | None) -> Generator[Step, Reply, RadioState]:
    """What a radio holds. Raises LinkError."""
    _, state = yield from _arrive(visit, bauds, remote)
    yield from leave()
    visit._command_line = False
    return state


def change(
    visit: Visit,
    bauds: Sequence[int],
    remote: int | None,
    wanted: Callable[[RadioState], Mapping[str, int]],
) -> Generator[Step, Reply, Ledger]:
    """Bring a radio to ``wanted``, which may depend on what it is. Raises LinkError or RefusedError as long as nothing
    has been written; from then on the ledger tells everything."""
    side, state = yield from _arrive(visit, bauds, remote)
    try:
        ledger = prepare(state, wanted(state))
        if side != LOCAL and "NODEID" in ledger.wanted:
            raise RefusedError("a node's id cannot be changed over the air, where it is its address; use its own port")
        visit.ledger = ledger
    except SkygcsError:
        yield from leave()
        visit._command_line = False
        raise
    assert visit.baud is not None
    yield from apply(ledger, state, side, visit.baud)
    visit._command_line = False
    return ledger


def _arrive(visit: Visit, bauds: Sequence[int], remote: int | None) -> Generator[Step, Reply, tuple[Side, RadioState]]:
    visit.baud = yield from connect(bauds)
    visit._command_line = True
    try:
        state = yield from read(LOCAL)
        side = side_of(remote, state)
        if side != LOCAL:
            state = yield from read(side)
    except SkygcsError:
        yield from leave()
        visit._command_line = False
        raise
    visit.state = state
    return side, state
