"""`skygcs-cli shell`: one line, a pipe and a person, against a daemon's answers made by hand."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.ext.shell import commands
from skygcs.rpc import error_codes
from support.command_line import ran

DONE, FAILED, USAGE = 0, 1, 2


class FakeDaemon:
    """A client whose shell answers each line with what `answers` has, and then its prompt."""

    connected = True

    def __init__(self) -> None:
        self.written: list[str] = []
        self.opened: dict[str, Any] = {}
        self.closed = 0
        self.output: list[str] = []
        self.answers: dict[str, str | None] = {"ver hw": "HW arch: PX4\x07_SIM\n"}
        self.extra: dict[str, Any] = {}

    async def open(self) -> None: ...

    async def close(self) -> None:
        self.closed += 1

    async def call(self, method: str, **params: Any) -> Any:
        match method:
            case "shell.open":
                self.opened, self.output = params, ["\nNuttShell (NSH)\nnsh> \x1b[K"]
                return {"session": "key", "vehicle": params["vehicle"], "note": "on the same link bravo hears"}
            case "shell.write":
                text = params["text"]
                self.written.append(text)
                if "\u00e9" in text:
                    raise RpcError(error_codes.REFUSED, "the text has characters that the shell does not read")
                answer = self.answers.get(text.strip(), "?\n")
                self.output.append(text if answer is None else f"{text}{answer}nsh> \x1b[K")
                return {"waiting_bytes": 0}
            case "shell.read":
                return await self.read(params["wait_s"])
        return {"closed": True}

    async def read(self, wait_s: float) -> dict[str, Any]:
        if not self.output:
            await asyncio.sleep(min(wait_s, 0.05))
        text = self.output.pop(0) if self.output else ""
        more, self.extra = self.extra, {}
        ready = text.endswith("nsh> \x1b[K")
        return {"text": text, "dropped_bytes": 0, "refused": "", "ready": ready, "end": None} | more


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[FakeDaemon]:
    fake = FakeDaemon()
    monkeypatch.setattr(commands, "client", lambda: fake)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    yield fake
    assert fake.closed == 1 or not fake.opened


run = partial(ran, "shell")


def test_one_line_prints_what_it_puts_out_and_nothing_else(daemon: FakeDaemon) -> None:
    result = run("alpha", "ver hw")
    assert result.stdout == "HW arch: PX4\\x07_SIM\n"
    assert "bravo" in result.stderr
    assert daemon.written == ["ver hw\n"] and daemon.opened == {"vehicle": "alpha", "force": False}
    daemon.closed = 0
    run("alpha", "ver hw", "--force")
    assert daemon.opened["force"] is True


def test_lines_of_a_pipe_are_executed_in_order_until_one_is_refused(daemon: FakeDaemon) -> None:
    result = run("alpha", typed="ver hw\r\nnosuch\n\nver hw")
    assert daemon.written == ["ver hw\n", "nosuch\n", "\n", "ver hw\n"]
    assert result.stdout == "HW arch: PX4\\x07_SIM\n?\n?\nHW arch: PX4\\x07_SIM\n"
    daemon.closed, daemon.written = 0, []
    result = run("alpha", typed="caf\u00e9\nreboot\n", code=FAILED)
    assert "does not read" in result.stderr and "reboot\n" not in daemon.written


def test_a_line_without_an_end_is_given_up(daemon: FakeDaemon) -> None:
    daemon.answers["sleep 100"] = None
    result = run("alpha", "sleep 100", "--wait", "0.2", code=FAILED)
    assert "no prompt within 0.2 s after 'sleep 100' (--wait)" in " ".join(result.stderr.split())


def test_losses_refusals_and_the_end_of_the_session_are_said(daemon: FakeDaemon) -> None:
    daemon.extra = {"dropped_bytes": 7}
    assert "7 bytes of output are missing" in run("alpha", "ver hw").stderr
    daemon.closed = 0
    daemon.answers["top"] = None
    daemon.extra = {"end": "the vehicle is gone, or has another system id"}
    assert "the shell has ended: the vehicle is gone" in run("alpha", "top", code=FAILED).stderr


def test_a_line_that_was_taken_and_not_sent_is_a_failure_and_ends_a_pipe(daemon: FakeDaemon) -> None:
    daemon.extra = {"refused": "7 bytes were not sent: alpha is armed"}
    assert "alpha is armed" in run("alpha", "ver hw", code=FAILED).stderr
    daemon.closed, daemon.written = 0, []
    daemon.extra = {"refused": "7 bytes were not sent: alpha is armed"}
    run("alpha", typed="ver hw\nreboot\n", code=FAILED)
    assert "reboot\n" not in daemon.written


def test_bad_options_are_named(daemon: FakeDaemon) -> None:
    run("alpha", "a\nb", code=USAGE)
    run("alpha", "ver hw", "--wait", "0", code=USAGE)
    run("alpha", "ver hw", "--wait", "nan", code=USAGE)
    run(code=USAGE)
    assert not daemon.opened


class Typist:
    """A person at a terminal: lines, Ctrl-C as KeyboardInterrupt, and Ctrl-D."""

    def __init__(self, *lines: str | type[BaseException]) -> None:
        self.lines = [*lines]
        self.prompts: list[str] = []

    def __call__(self, prompt: str) -> str:
        self.prompts.append(prompt)
        line = self.lines.pop(0) if self.lines else EOFError
        if isinstance(line, str):
            return line
        raise line


def test_a_person_sees_the_vehicle_in_the_prompt_and_leaves_by_ctrl_d(
    daemon: FakeDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    typist = Typist("ver hw", KeyboardInterrupt, "caf\u00e9", "ver hw")
    monkeypatch.setattr("builtins.input", typist)
    monkeypatch.setattr(commands.Console, "_is_typed", staticmethod(lambda: True))
    result = run("alpha")
    assert typist.prompts[:2] == ["alpha nsh> ", "alpha nsh> "]
    assert daemon.written == ["ver hw\n", "caf\u00e9\n", "ver hw\n"]
    assert "NuttShell" in result.stdout and result.stdout.count("HW arch") == 2
    assert "does not read" in result.stderr
