"""A Containerfile as stages of instructions: as much of the format as ours uses, and an error for the rest."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import dataclass, field

KNOWN = frozenset({"RUN", "COPY", "WORKDIR", "ENV", "USER", "ENTRYPOINT", "CMD"})


@dataclass(slots=True)
class Stage:
    """One FROM, and what is done in it."""

    base: str
    name: str
    steps: list[tuple[str, str]] = field(default_factory=list)
    """Instruction and its text, without comments and line breaks."""


def stages_of(text: str) -> list[Stage]:
    """Raises ValueError for an instruction that is not carried out by `rooms.Root`."""
    stages: list[Stage] = []
    for line in logical_lines(text):
        word, _, rest = line.partition(" ")
        instruction, rest = word.upper(), rest.strip()
        if instruction == "FROM":
            found = re.fullmatch(r"(\S+)(?:\s+AS\s+(\S+))?", rest, re.I)
            if found is None:
                raise ValueError(f"not understood: {line}")
            stages.append(Stage(found[1], found[2] or str(len(stages))))
        elif instruction in KNOWN and stages:
            stages[-1].steps.append((instruction, rest))
        else:
            raise ValueError(f"not understood: {line}")
    return stages


def logical_lines(text: str) -> list[str]:
    """Lines with their continuations, as one line each; comments and empty lines are left out."""
    kept = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    return [" ".join(line.split()) for line in "\n".join(kept).replace("\\\n", " ").splitlines()]


def copied(text: str) -> tuple[str | None, list[str], str]:
    """The stage, the sources and the destination of a COPY."""
    words = shlex.split(text)
    stage = None
    while words[0].startswith("--"):
        option, _, value = words.pop(0).partition("=")
        if option != "--from":
            raise ValueError(f"not understood: COPY {text}")
        stage = value
    return stage, words[:-1], words[-1]


def arguments(text: str) -> list[str]:
    """The words of an ENTRYPOINT or CMD, which are written as a JSON list."""
    words = json.loads(text)
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise ValueError(f"not a list of words: {text}")
    return words
