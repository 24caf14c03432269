"""The console of a simulated PX4, message by message as its source handles them."""

from __future__ import annotations

from typing import Any

from skygcs.sim.px4_shell import PROMPT, REPLY, RESPOND, SHELL, Px4Shell
from support.vehicles import flight_dialect


class Wire:
    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []

    def send(self, name: str, fields: dict[str, Any], tail: bytes = b"") -> None:
        assert name == "SERIAL_CONTROL"
        self.sent.append(fields)


def console() -> tuple[Px4Shell, Wire]:
    wire: Any = Wire()
    return Px4Shell(wire, flight_dialect(), lambda: False), wire


def say(shell: Px4Shell, data: bytes, *, flags: int = RESPOND, device: int = SHELL, count: int | None = None) -> None:
    fields = {"device": device, "flags": flags, "count": len(data) if count is None else count, "data": list(data)}
    shell.hear(fields, (255, 25))


def output(shell: Px4Shell, wire: Wire, *, begin: int = 0, ticks: int = 200) -> bytes:
    for n in range(ticks):
        shell.step((begin + n) * 0.02)
    sent, wire.sent = wire.sent, []
    assert all(0 < fields["count"] <= 70 and fields["flags"] == REPLY for fields in sent)
    return b"".join(fields["data"] for fields in sent)


def test_it_greets_echoes_executes_and_asks_for_more() -> None:
    shell, wire = console()
    say(shell, b"")
    assert output(shell, wire).endswith(PROMPT)
    say(shell, b"echo hello\n")
    assert output(shell, wire) == b"echo hello\nhello\n" + PROMPT
    say(shell, b"nosuch\n")
    assert b"command not found" in output(shell, wire)
    assert shell.lines == ["echo hello", "nosuch"]


def test_what_is_not_for_the_shell_starts_none() -> None:
    shell, wire = console()
    say(shell, b"ver all\n", device=0)
    say(shell, b"ver all\n", flags=RESPOND | REPLY)
    assert not shell.running and output(shell, wire) == b""
    say(shell, b"x" * 70, count=71)
    assert output(shell, wire).endswith(PROMPT) and shell.lines == []


def test_without_respond_it_ends_and_a_line_that_was_begun_is_forgotten() -> None:
    shell, wire = console()
    say(shell, b"rebo")
    output(shell, wire)
    say(shell, b"", flags=0)
    assert not shell.running
    say(shell, b"ver all\n")
    output(shell, wire)
    assert shell.lines == ["ver all"]


def test_while_a_command_runs_nothing_is_read_and_the_pipe_holds_70_bytes() -> None:
    shell, wire = console()
    say(shell, b"sleep 2\n")
    output(shell, wire, ticks=50)
    say(shell, b"y" * 70)
    assert shell.overfull == 0
    say(shell, b"zz")
    assert shell.overfull == 2
    assert output(shell, wire, begin=50, ticks=20) == b""
    assert output(shell, wire, begin=101, ticks=20).startswith(PROMPT + b"yyy")
