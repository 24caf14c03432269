"""Changing a radio so that it ends up either as wanted or as it was, and what became of it is known at every moment.

The order: read; check; write each setting and read it back; node table; save (AT&W); restart (ATZ); read again and
compare. Until the save everything is in the radio's RAM only, so a failure before it is undone by a restart. What the
radio silently makes of a value (TXPOWER between two steps, DUTY_CYCLE, LBT_RSSI) is a failure, too.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from skygcs.errors import LinkError, RefusedError, SkygcsError
from skygcs.ext.radio_tools.dialogue import Quiet, Reply, Speak, Status, Step, Until
from skygcs.ext.radio_tools.reading import LOCAL, Side, ask, connect, enter, leave, read, read_value, side_of
from skygcs.ext.radio_tools.settings import SERIAL_BAUD, RadioState, resolve_name, why_not

RESTART_S = 2.0
"""A SiK radio passes data on again after about a second; the RFD900x boots through its boot loader."""

REMOTE_RESTART_S = 8.0
"""A remote radio has to find the network again; the field's reports speak of a few seconds."""

TRIES_AFTER_RESTART = 3

FIRST = ("NODECOUNT", "NODEID")
"""Written before the others: open SiK multipoint takes a node id only below the node count, and a destination other
than itself."""

LINK_SETTINGS = frozenset(
    {"NETID", "AIR_SPEED", "MIN_FREQ", "MAX_FREQ", "NUM_CHANNELS", "ECC", "MANCHESTER", "NODECOUNT"}
)
"""Settings that both ends must share: a remote radio that is set to others is out of reach from then on."""

NODE_COUNT_KEY = "NODECOUNT"
"""Also the name a person uses for the node table of RFD900x firmware, which is no register."""


class Fact(StrEnum):
    """Truth of an event, as far as it can be known."""

    NO = "no"
    YES = "yes"
    UNKNOWN = "unknown"


@dataclass(slots=True)
class Ledger:
    """Record of what was done to one radio so far; complete at every moment, also when the conversation breaks off."""

    wanted: dict[str, int] = field(default_factory=dict)
    """Settings that had to change, by the radio's names; those that were right already are left out."""
    node_table: str | None = None
    """"AT&M0=0,9" where it is wanted; it is acknowledged, but no firmware reports it back."""
    before: dict[str, int] = field(default_factory=dict)
    written: list[str] = field(default_factory=list)
    """Accepted by the radio and read back."""
    unsure: str | None = None
    """Sent last, and not known whether the radio holds it."""
    table_written: bool = False
    saved: Fact = Fact.NO
    restarted: Fact = Fact.NO
    verified: Fact = Fact.NO
    """Read after the restart, and all as wanted."""
    undone: Fact = Fact.NO
    """Restarted without saving, and found as before."""
    differs: dict[str, int] = field(default_factory=dict)
    """Values that the last reading shows of the wanted settings where they differ."""
    problem: str | None = None
    finished: bool = False
    remote: bool = False
    """It is about a radio behind the one at the port."""
    command_line: bool = False
    """The radio at the port is at its command line and passes nothing on."""

    @property
    def ok(self) -> bool:
        return self.finished and self.problem is None and (self.verified is Fact.YES or not self.has_work)

    @property
    def has_work(self) -> bool:
        return bool(self.wanted) or self.node_table is not None

    def farewell(self) -> bytes:
        """Return what to write before the port is closed in mid-conversation: the radio at it passes data on again, and
        what was not saved there is undone. A remote radio keeps what it has until it is powered off."""
        if not self.command_line:
            return b""
        unsaved = not self.remote and (self.written or self.unsure or self.table_written) and self.saved is Fact.NO
        return b"\rATZ\r" if unsaved else b"\rATO\r"

    def sentences(self) -> list[str]:
        """Return what a person must know, in order: the trouble first, then how the radio stands."""
        lines = [] if self.problem is None else [self.problem]
        if not self.has_work:
            return [*lines, "nothing was to be changed"] if self.finished else [*lines, "nothing was changed"]
        if self.ok:
            return [*lines, "written, saved, restarted and read back: all as wanted"]
        if not self.written and self.unsure is None and not self.table_written and self.saved is Fact.NO:
            return [*lines, "nothing was written: the radio is as it was"]
        if self.undone is Fact.YES:
            return [*lines, "nothing was saved; the radio was restarted and is as it was"]
        todo = [name for name in self.wanted if name not in self.written and name != self.unsure]
        lines.append(
            f"written: {', '.join(self.written) or 'none'}"
            + (f"; perhaps written: {self.unsure}" if self.unsure is not None else "")
            + (f"; not written: {', '.join(todo)}" if todo else "")
            + ("" if self.node_table is None else f"; {self.node_table}: {'yes' if self.table_written else 'no'}")
        )
        lines.append(f"saved: {self.saved}; restarted: {self.restarted}; verified: {self.verified}")
        if self.differs:
            lines.append(
                "it now holds " + ", ".join(f"{n}={v} (wanted {self.wanted[n]})" for n, v in self.differs.items())
            )
        if self.saved is Fact.NO:
            lines.append("what is not saved is gone once the radio is powered off and on")
        elif self.verified is not Fact.YES:
            first = "give the radio at this port the same settings" if self.remote else "power it off and on"
            lines.append(f"{first}, then look with: skygcs-cli radio show")
        return lines


def prepare(state: RadioState, changes: Mapping[str, int]) -> Ledger:
    """Return what has to be written for ``changes``. Raises RefusedError with every change that cannot be right."""
    ledger = Ledger(before=state.values)
    problems = []
    for name, value in changes.items():
        if name.upper() == NODE_COUNT_KEY and NODE_COUNT_KEY not in state.registers and state.node is not None:
            net_id = changes.get("NETID", state.values.get("NETID", 0))
            ledger.node_table = f"AT&M0={net_id},{value}"
            if not 2 <= value <= 16:
                problems.append(f"{NODE_COUNT_KEY} takes 2 to 16 with this firmware, not {value}")
            continue
        try:
            own = resolve_name(name, state.registers)
        except KeyError as error:
            problems.append(str(error.args[0]))
            continue
        why = why_not(own, value, state.firmware)
        if why is not None and state.values[own] != value:
            problems.append(why)
        elif state.values[own] != value:
            ledger.wanted[own] = value
    if problems:
        raise RefusedError("; ".join(problems))
    return ledger


def apply(ledger: Ledger, state: RadioState, side: Side, baud: int) -> Generator[Step, Reply, None]:
    """Bring the radio to what the ledger wants; the radio at the port is at its command line, and is not afterwards.

    Never raises: whatever happens stands in the ledger. ``baud`` is the present rate of the port.
    """
    ledger.command_line = True
    ledger.remote = side.remote is not None
    if not ledger.has_work:
        yield from _leave(ledger)
        ledger.finished = True
        return
    trouble = yield from _write_all(ledger, state, side)
    if trouble is None:
        trouble = yield from _save(ledger, side)
    if trouble is None:
        yield from _restart_and_verify(ledger, side, baud)
    else:
        ledger.problem = trouble
        yield from _undo(ledger, side)
    ledger.finished = True


def _write_all(ledger: Ledger, state: RadioState, side: Side) -> Generator[Step, Reply, str | None]:
    """The trouble, or None."""
    for name in sorted(ledger.wanted, key=lambda n: FIRST.index(n) if n in FIRST else len(FIRST)):
        value, register = ledger.wanted[name], state.registers[name].id
        ledger.unsure = name
        reply = yield from ask(side, f"{register}={value}")
        if reply.status is Status.ERROR:
            ledger.unsure = None
            return f"{side} refused {name}={value} ({register})"
        if reply.status is not Status.OK:
            return f"{side} stopped answering at {name}={value}: did it restart, or lose its power or cable?"
        held = yield from read_value(side, register)
        if held is None:
            return f"{side} took {name}={value} but does not report what it holds now"
        if held != value:
            return f"{side} made {held} of {name}={value}; set a value that it has"
        ledger.unsure = None
        ledger.written.append(name)
    if ledger.node_table is not None:
        reply = yield from ask(side, ledger.node_table.removeprefix("AT"))
        if reply.status is not Status.OK:
            how = "refused" if reply.status is Status.ERROR else "did not answer to"
            return f"{side} {how} {ledger.node_table} (the master's node table)"
        ledger.table_written = True
    return None


def _save(ledger: Ledger, side: Side) -> Generator[Step, Reply, str | None]:
    reply = yield from ask(side, "&W")
    if reply.status is Status.OK:
        ledger.saved = Fact.YES
        return None
    if reply.status is Status.ERROR:
        return f"{side} refused to save (AT&W)"
    ledger.saved = Fact.UNKNOWN
    return f"{side} did not answer to the save (AT&W): it may have saved or not"


def _undo(ledger: Ledger, side: Side) -> Generator[Step, Reply, None]:
    """Restart without saving, so that nothing written stays; after a save without an answer: see what came of it."""
    after = yield from _restart(ledger, side, None)
    if after is None:
        ledger.undone = Fact.UNKNOWN
        return
    ledger.undone = Fact.YES if after.values == ledger.before else Fact.NO
    if ledger.undone is Fact.YES:
        ledger.saved = Fact.NO
    ledger.differs = _differences(ledger, after)


def _restart_and_verify(ledger: Ledger, side: Side, baud: int) -> Generator[Step, Reply, None]:
    code = ledger.wanted.get("SERIAL_SPEED") if side.remote is None else None
    after = yield from _restart(ledger, side, None if code is None else (SERIAL_BAUD[code], baud))
    if after is None:
        ledger.verified = Fact.UNKNOWN
        if side.remote is not None and LINK_SETTINGS & ledger.wanted.keys():
            ledger.problem = (
                f"{side} is not reachable any more, as it must be: its settings of the air differ from this radio's now"
            )
        else:
            ledger.problem = f"{side} did not answer after its restart"
        return
    ledger.differs = _differences(ledger, after)
    ledger.verified = Fact.NO if ledger.differs else Fact.YES
    if ledger.differs:
        ledger.problem = f"{side} does not hold what it was to save"


def _restart(ledger: Ledger, side: Side, bauds: tuple[int, int] | None) -> Generator[Step, Reply, RadioState | None]:
    """Restart and read; None if it cannot be read. The port's radio passes data on afterwards."""
    yield side.say("Z", Until.SENT)
    ledger.restarted = Fact.UNKNOWN
    # a remote radio: our own stays at its command line meanwhile
    if side.remote is not None:
        yield Quiet(REMOTE_RESTART_S)
        try:
            after = yield from read(side)
        except LinkError:
            yield from _leave(ledger)
            return None
        ledger.restarted = Fact.YES
        yield from _leave(ledger)
        return after
    # our own: at the new rate of its port or, if that was not saved, at the old one
    ledger.command_line = False
    for attempt in range(TRIES_AFTER_RESTART):
        yield Quiet(RESTART_S)
        if bauds is not None:
            yield Speak(bauds[attempt % 2])
        reply = yield from enter()
        if reply.status is not Status.OK:
            continue
        ledger.command_line = True
        ledger.restarted = Fact.YES
        try:
            after = yield from read(LOCAL)
        except LinkError:
            continue
        yield from _leave(ledger)
        return after
    return None


def _leave(ledger: Ledger) -> Generator[Step, Reply, None]:
    yield from leave()
    ledger.command_line = False


def _differences(ledger: Ledger, after: RadioState) -> dict[str, int]:
    return {n: after.values[n] for n, v in ledger.wanted.items() if n in after.values and after.values[n] != v}


# -- one visit to the radio at a port: find it, read it or change it, and leave it passing data on


@dataclass(slots=True)
class Visit:
    """The progress of a visit, for the code that has to end it early."""

    baud: int | None = None
    """The rate at which the radio answered."""
    state: RadioState | None = None
    """Reading of the visited radio before any change."""
    ledger: Ledger | None = None
    """Record of a change so far."""
    _command_line: bool = False

    def farewell(self) -> bytes:
        """Return what to write to the port before it is closed in the middle; nothing once the visit is over."""
        if self.ledger is not None:
            return self.ledger.farewell()
        return b"\rATO\r" if self._command_line else b""


def look(visit: Visit, bauds: Sequence[int], remote: int | None) -> Generator[Step, Reply, RadioState]:
    """Return what a radio holds. Raises LinkError."""
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
    has been written; from then on the ledger says everything."""
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
