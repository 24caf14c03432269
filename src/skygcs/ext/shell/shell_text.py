"""Output of a PX4's shell for a terminal: without its escape sequences, and without what the person has typed. Pure."""

from __future__ import annotations

import re

from skygcs.terminal_text import visible

PROMPTS = ("nsh> ", "pxh> ")

_SEQUENCE = re.compile(r"\x1b\[[0-9;?]*[@-~]")
"""A control sequence (ECMA-48): colours and erasures, which nsh and PX4's messages have."""

_UNFINISHED = re.compile(r"\x1b(?:\[[0-9;?]{0,16})?$")


class ShellOutputText:
    """The output of one session as it is shown. `begin` says that a line was sent, whose echo is left out."""

    def __init__(self) -> None:
        self._escape = ""
        """The beginning of a sequence whose end has not come."""
        self._rest = ""
        """A line whose end has not come and that may be a prompt."""
        self._echo = False

    @property
    def prompt(self) -> str:
        """The prompt that the output ends with; "" if it ends otherwise."""
        return self._rest if self._rest in PROMPTS else ""

    def begin(self) -> None:
        """A line was sent: the next line of the output repeats it, behind the prompt."""
        self._rest = ""
        self._echo = True

    def feed(self, text: str) -> str:
        """Return what is to be shown of further output; what may be a prompt is kept."""
        text = self._escape + text
        found = _UNFINISHED.search(text)
        self._escape = found[0] if found is not None else ""
        text = text.removesuffix(self._escape) if self._escape else text
        text = self._rest + _SEQUENCE.sub("", text).replace("\r", "")
        if self._echo:
            _, newline, after = text.partition("\n")
            if not newline:
                self._rest = text
                return ""
            self._echo, text = False, after
        begun, newline, last = text.rpartition("\n")
        if any(prompt.startswith(last) for prompt in PROMPTS):
            self._rest = last
            return visible(begun + newline, lines=True)
        self._rest = ""
        return visible(text, lines=True)

    def end(self) -> str:
        """Return what was kept and is no prompt: nothing more comes."""
        rest = "" if self._echo or self.prompt else self._rest
        self._rest = ""
        return visible(rest, lines=True)
