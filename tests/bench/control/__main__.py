"""`make bench-control`: what flight control does and what it costs. Tables on stdout, all in build/bench/control.json.

python -m bench.control [--only steps|moving|fleet|hundred] [--write-docs] [--profile] [--realtime]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.control.docs_tables import ON_THE_PAGE, differences, write_tables
from bench.control.figures import Section, virtual_sections
from bench.control.fleet import ROOT, Load, carry
from bench.control.moving_figures import moving_sections
from bench.results import OUT, keep

LOADS = (Load(10, 50.0, 0.1), Load(50, 20.0, 0.5))
"""The second with a guard that bears the delays of a machine which also has to simulate fifty vehicles: it is about
what fifty cost."""
HUNDRED = Load(100, 50.0, 0.1, stand_ins=True)
DOCS = ROOT / "docs" / "developers" / "control-figures.md"
WHAT = (
    "steps, moving: virtual time; fleet: processes and sockets; hundred: that with 100 vehicles that are not simulated"
)


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.control", description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=("steps", "moving", "fleet", "hundred"), help=WHAT)
    parser.add_argument("--write-docs", action="store_true", help="put the tables of moving references into the docs")
    parser.add_argument("--profile", action="store_true", help="the daemon under cProfile, which makes it slower")
    parser.add_argument("--realtime", action="store_true", help="daemon and simulator before all others; needs root")
    options = parser.parse_args()
    began = time.monotonic()
    told: dict[str, Any] = {"cpus": os.cpu_count(), "python": sys.version.split()[0]}
    missed: list[str] = []
    OUT.mkdir(parents=True, exist_ok=True)
    if options.only in (None, "steps"):
        for section in virtual_sections():
            _show(section, told, missed)
    if options.only in (None, "moving"):
        moving = []
        for section in moving_sections():
            _show(section, told, missed)
            if section.key in ON_THE_PAGE:
                moving.append(section)
        if options.write_docs:
            write_tables(DOCS, moving)
        else:
            for note in differences(DOCS, moving):
                print(f"  docs: {note}")
    loads = {None: (*LOADS, HUNDRED), "steps": (), "moving": (), "fleet": LOADS, "hundred": (HUNDRED,)}[options.only]
    for load in loads:
        profile = OUT / f"control-profile-{load.vehicles}.txt" if options.profile else None
        with tempfile.TemporaryDirectory() as folder:
            section = carry(replace(load, realtime=options.realtime), Path(folder), profile)
        _show(section, told, missed)
    told["missed"] = missed
    told["seconds"] = round(time.monotonic() - began, 1)
    print(f"\n{told['seconds']:.0f} s; all of it in {keep('control', told)}")
    for what in missed:
        print(f"MISSED: {what}")
    return 1 if missed else 0


def _show(section: Section, told: dict[str, Any], missed: list[str]) -> None:
    print(f"\n{section.title}\n{section.text()}", flush=True)
    told[section.key] = section.data()
    missed += section.missed


if __name__ == "__main__":
    sys.exit(main())
