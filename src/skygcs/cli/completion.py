"""Completion of `skygcs` for bash, zsh and fish, made from its parser; that of `skygcs-cli` is typer's."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

SHELLS = ("bash", "zsh", "fish")

BASH = """\
_skygcs() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" words
    case "${{COMP_WORDS[1]:-}}" in
{cases}
        *) words="{commands}" ;;
    esac
    [ "$COMP_CWORD" -eq 1 ] && words="{commands}"
    COMPREPLY=($(compgen -W "$words" -- "$word"))
    [ ${{#COMPREPLY[@]}} -eq 0 ] && COMPREPLY=($(compgen -f -- "$word"))
}}
complete -o filenames -F _skygcs skygcs
"""

ZSH = "autoload -U +X bashcompinit && bashcompinit\n"


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script that a shell has to read: `eval "$(skygcs completion bash)"`."""
    commands = dict(_commands(parser))
    if shell == "fish":
        return "".join(f"{line}\n" for line in _fish(commands))
    cases = "\n".join(f'        {name}) words="{" ".join(words)}" ;;' for name, words in commands.items())
    bash = BASH.format(cases=cases, commands=" ".join([*commands, "--help", "--version"]))
    return (ZSH if shell == "zsh" else "") + bash


def this_shell() -> str:
    """The shell of the user, bash if it is another one."""
    name = Path(os.environ.get("SHELL", "")).name
    return name if name in SHELLS else "bash"


def _commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, list[str]]]:
    """Each command with the words that may follow it: options, choices, and commands of its own."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield name, list(_words(inner))


def _words(parser: argparse.ArgumentParser) -> Iterator[str]:
    for action in parser._actions:
        if action.help is not argparse.SUPPRESS:
            yield from (option for option in action.option_strings if option.startswith("--"))
        if action.choices is not None and not action.option_strings:
            yield from map(str, action.choices)


def _fish(commands: dict[str, list[str]]) -> Iterator[str]:
    yield f"complete -c skygcs -n __fish_use_subcommand -a '{' '.join(commands)}'"
    for name, words in commands.items():
        for word in words:
            what = f"-l {word[2:]}" if word.startswith("--") else f"-a {word}"
            yield f"complete -c skygcs -n '__fish_seen_subcommand_from {name}' {what}"
