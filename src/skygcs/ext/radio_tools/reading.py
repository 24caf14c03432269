"""Procedures that change nothing: find the radio's rate, get to its command line and off it, read what it holds.

           silence, "+++", silence -> OK                  ATO
passing on ------------------------------> command line ---------> passing on
    ^                                           |
    +------------- restarted <------------------+  ATZ (settings not saved are gone)
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

from skygcs.errors import LinkError
from skygcs.ext.radio_tools.dialogue import Quiet, Reply, Say, Speak, Status, Step, Until
from skygcs.ext.radio_tools.settings import Firmware, RadioState, firmware_of, missing_registers, parse_registers

GUARD_S = 1.1
"""Silence that the firmware wants before and after "+++": 100 ticks of its 100 Hz timer (at.c, ATP_COUNT_1S), and a
reserve for its clock and for bytes still on their way through a USB adapter."""

ENTER_S = 2.5
"""The OK comes one guard time after "+++"; on top the transfer of what the radio was passing on."""

REMOTE_ANSWER_S = 6.0
"""An answer of a remote radio takes two rounds of the network (sixteen nodes at 64 kbit/s: 1.3 s each), and once more
for a lost packet."""

REMOTE_IDLE_S = 3.0
"""Between two lines of a remote's list: multipoint firmware sends one a round."""

REMOTE_TRIES = 3
"""How often a command to a remote radio is said: either way the air may lose it. Saying it again changes nothing."""

LIST_TRIES = 3
"""How often a list with gaps is asked for again."""

LIKELY_BAUD = (57600, 115200, 38400, 230400, 19200, 9600)
"""Tried in this order where the rate is not known; a try takes four seconds."""


@dataclass(frozen=True, slots=True)
class Side:
    """Which radio is spoken to: the one at the port, or a remote one over its air."""

    remote: int | None = None
    """Node id of the remote one; of a pair the other one, whatever the number."""
    addressed: bool = False
    """Multipoint: the node is named in each command."""

    def say(self, command: str, until: Until = Until.STATUS) -> Say:
        """``command`` without its "AT": "S3=25", "I5", "&W"."""
        if self.remote is None:
            return Say(f"AT{command}\r".encode(), until)
        node = f",{self.remote}" if self.addressed else ""
        return Say(f"RT{command}{node}\r".encode(), until, REMOTE_ANSWER_S, REMOTE_IDLE_S)

    @property
    def tries(self) -> int:
        return 1 if self.remote is None else REMOTE_TRIES

    def __str__(self) -> str:
        return (
            "the radio"
            if self.remote is None
            else f"remote node {self.remote}"
            if self.addressed
            else "the remote radio"
        )


LOCAL = Side()


def ask(side: Side, command: str, until: Until = Until.STATUS) -> Generator[Step, Reply, Reply]:
    """One command and its answer, said again to a remote radio that does not answer."""
    reply = Reply()
    for _ in range(side.tries):
        reply = yield side.say(command, until)
        if reply.status is not Status.SILENCE:
            return reply
    return reply


def enter() -> Generator[Step, Reply, Reply]:
    """Get to the command line; a reply without OK says that it was not reached.

    A radio that somebody left there takes "+++" for a command and says nothing: then it is asked whether it is there.
    """
    yield Quiet(GUARD_S)
    reply = yield Say(b"+++", Until.STATUS, ENTER_S, amid_noise=True)
    heard = reply.heard_bytes
    if reply.status is not Status.OK:
        yield Say(b"\r", Until.SENT)
    for _ in range(2):  # the first one may end a line of noise
        reply = yield Say(b"AT\r")
        if reply.status is Status.OK:
            break
        heard += reply.heard_bytes
    return Reply(reply.status, reply.lines, reply.node, heard)


def connect(bauds: Sequence[int]) -> Generator[Step, Reply, int]:
    """Reach the command line at one of the rates; which one it was. Raises LinkError that says what was heard."""
    tried = []
    for baud in bauds:
        yield Speak(baud)
        reply = yield from enter()
        if reply.status is Status.OK:
            return baud
        heard = "silence" if not reply.heard_bytes else f"{reply.heard_bytes} bytes that are not an answer"
        tried.append(f"{baud} baud: {heard}")
    left = [str(baud) for baud in LIKELY_BAUD if baud not in bauds]
    rates = f" Or has it another rate? Not tried: {', '.join(left)} (--baud)." if left else ""
    if not all(text.endswith("silence") for text in tried):
        cause = "does another program talk to it, or is it no SiK or RFD900x radio?" + rates
    else:
        cause = "is it powered, is this its port, are TX and RX swapped?" + rates
    raise LinkError(f"no answer to +++ ({'; '.join(tried)}); {cause}")


def leave() -> Generator[Step, Reply, None]:
    """Back to passing on data, settings as they are."""
    yield LOCAL.say("O", Until.SENT)
    yield Quiet(0.1)


def read(side: Side) -> Generator[Step, Reply, RadioState]:
    """Everything a radio reports about itself; the local one must be at its command line. Raises LinkError."""
    banner = yield from _line(side, "I")
    if banner is None:
        raise LinkError(_no_answer(side))
    registers = {}
    for _ in range(LIST_TRIES):
        reply = yield from ask(side, "I5", Until.IDLE)
        registers.update(parse_registers(reply.lines))
        if registers and not missing_registers(registers):
            break
    if not registers:
        raise LinkError(f"{side} answers ({banner}) but lists no settings (ATI5); is its firmware SiK or RFD900x?")
    registers = dict(sorted(registers.items(), key=lambda item: (item[1].id[0] != "S", int(item[1].id[1:]))))
    firmware = firmware_of(banner, registers)
    board = yield from _line(side, "I2")
    band = yield from _line(side, "I3")
    unique_id = None
    if banner.startswith("RFD") or firmware is not Firmware.SIK:
        unique_id = yield from _line(side, "I8")
    return RadioState(banner, firmware, registers, board, band, unique_id)


def read_value(side: Side, register: str) -> Generator[Step, Reply, int | None]:
    """One register by its id; None without a number for an answer."""
    line = yield from _line(side, f"{register}?")
    return int(line) if line is not None and line.isdecimal() and len(line) <= 10 else None


def side_of(remote: int | None, local: RadioState) -> Side:
    """How to speak to a remote node through this radio. Raises LinkError where it is the local node itself."""
    if remote is None:
        return LOCAL
    addressed = local.node is not None
    if addressed and remote == local.node:
        raise LinkError(f"node {remote} is the radio at this port; leave --remote out")
    return Side(remote, addressed)


def _line(side: Side, command: str) -> Generator[Step, Reply, str | None]:
    reply = yield from ask(side, command, Until.LINE)
    return reply.lines[0] if reply.status is Status.LINES and reply.lines else None


def _no_answer(side: Side) -> str:
    if side.remote is None:
        return "the radio stopped answering; power it off and on"
    return (
        f"{side} does not answer over the air; is it powered and in range, with the same NETID and AIR_SPEED, "
        "and does its firmware know RT commands?"
    )
