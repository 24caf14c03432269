"""`make mutants ROOM=routing`: one-line changes of a room's modules, and which of them its unit tests notice.

    python -m mutants [ROOM or MODULE]… [--sample 100 | --all] [--save FILE] [--against FILE]

A mutant is chosen by the hash of what it changes, so the sample stays the same while other lines move.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from mutants.changes import Mutant, mutants
from mutants.rooms import ROOMS, SRC, UNIT
from mutants.run import MISSED, UNREACHED, MutantRun, Task

EQUIVALENT = Path(__file__).parent / "equivalent.toml"


def sampled(path: Path, count: int | None) -> list[Mutant]:
    """So many mutants of a file in its order; all with None."""
    found = mutants(path.read_text())
    chosen = sorted(found, key=lambda mutant: hashlib.sha256(mutant.key.encode()).digest())[:count]
    return sorted(chosen, key=lambda mutant: mutant.index)


def equivalent() -> dict[str, dict[str, str]]:
    """Module -> key of mutants, as a pattern -> why they change nothing."""
    return tomllib.loads(EQUIVALENT.read_text())


def measure(modules: dict[str, tuple[str, ...]], count: int | None) -> dict[str, str]:
    """What became of each mutant, by module and key; after Ctrl-C of those measured by then. Raises SystemExit
    where a test fails without a mutant, and where one was not measured."""
    known = equivalent()
    tasks = [Task(SRC / name, None) for name in modules]
    tasks += [
        Task(SRC / name, mutant)
        for name in modules
        for mutant in sampled(SRC / name, count)
        if not any(fnmatchcase(mutant.key, pattern) for pattern in known.get(name, {}))
    ]
    tests = dict.fromkeys(str(UNIT / test) for files in modules.values() for test in files)
    run = MutantRun(tasks)
    # no time limits of wall time: a fork has one of CPU time, and tracing on a busy machine takes long
    plugins = ["-p", "no:cacheprovider", "-p", "no:benchmark", "--hypothesis-profile", "mutants", "-o", "timeout=0"]
    code = pytest.main(["-q", "--no-header", *plugins, *tests], plugins=[run])
    if run.errors:
        raise SystemExit("\n".join(run.errors))
    if code == pytest.ExitCode.INTERRUPTED and run.results:
        print(f"ended by Ctrl-C: {len(run.results)} of {len(tasks)} were measured")
    elif code or len(run.results) < len(tasks):
        raise SystemExit("the tests do not pass without a mutant")
    return {
        f"{_module(task)} {task.mutant.key}": run.results[number]
        for number, task in enumerate(tasks)
        if task.mutant is not None and number in run.results
    }


def _module(task: Task) -> str:
    return task.path.relative_to(SRC).as_posix()


def report(name: str, results: dict[str, str]) -> None:
    """Prints a module's mutants that no test noticed, and how many of all were."""
    lines = {f"{name} {mutant.key}": mutant for mutant in mutants((SRC / name).read_text())}
    keys = [key for key in results if key in lines]
    missed = [key for key in keys if results[key] in (MISSED, UNREACHED)]
    for key in missed:
        mutant = lines[key]
        print(f"{results[key]}: {name}:{mutant.line} in {mutant.function}")
        print(f"  - {mutant.before}\n  + {mutant.after}")
    found = len(keys) - len(missed)
    print(f"== {name}: {found} of {len(keys)} killed ({100 * found / max(1, len(keys)):.0f} %)")


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=", ".join(ROOMS))
    parser.add_argument("--sample", type=int, default=100, help="mutants of each module (100)")
    parser.add_argument("--all", action="store_true", help="every mutant of each module")
    parser.add_argument("--save", type=Path, help="write what became of each mutant, as JSON")
    parser.add_argument("--against", type=Path, help="a file of --save: name what was killed then and is not now")
    asked = parser.parse_args(words)
    chosen = {
        name: tests
        for room, modules in ROOMS.items()
        for name, tests in modules.items()
        if not asked.rooms or room in asked.rooms or name in asked.rooms
    }
    if unknown := set(asked.rooms) - ROOMS.keys() - chosen.keys():
        parser.error(f"no room {', '.join(sorted(unknown))}; there are {', '.join(ROOMS)}, and their modules")

    results = measure(chosen, None if asked.all else asked.sample)
    for name in chosen:
        report(name, results)

    if asked.save is not None:
        asked.save.write_text(json.dumps(results, indent=1))
    if asked.against is None:
        return 0
    before = json.loads(asked.against.read_text())
    missed = (MISSED, UNREACHED)
    lost = [key for key, result in results.items() if result in missed and before.get(key, MISSED) not in missed]
    for key in lost:
        print(f"killed before, not now: {key}")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
