"""Write the tables of parameter metadata that skygcs ships, from the files that the autopilots' projects publish.

    python build_param_metadata.py px4 parameters.json 'PX4 1.16'
    python build_param_metadata.py ardupilot apm.pdef.json… metadata_ardupilot.tsv 'ArduPilot 4.7, 4.6'

The newest file first: its descriptions are kept; ranges are the widest of all files. A .tsv is a table that was written
before: names that a newer firmware has given up stay known for the vehicles that have them. What is taken are names,
units, ranges, reboot flags and short labels, no text of the manuals.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from skygcs.core.params.metadata import ParamMetadata, decode, merged, of_ardupilot, of_px4, table

TABLES = Path(__file__).resolve().parent / "src" / "skygcs" / "core" / "params"
READERS = {"px4": of_px4, "ardupilot": of_ardupilot}


def _read(family: str, file: Path) -> Iterable[ParamMetadata]:
    if file.suffix == ".tsv":
        return filter(None, map(decode, file.read_text(encoding="utf-8").splitlines()[1:]))
    return READERS[family](json.loads(file.read_text(encoding="utf-8")))


def main() -> None:
    family, *files, versions = sys.argv[1:]
    known = merged(chain.from_iterable(_read(family, Path(file)) for file in files))
    source = f"{versions}: names, units, ranges and labels of its published parameter metadata"
    data = table(known, source)
    path = TABLES / f"metadata_{family}.tsv"
    path.write_bytes(data)
    print(f"{path}: {len(data.splitlines()) - 1} lines, {len(data)} bytes")


if __name__ == "__main__":
    main()
