"""`make test-lab`: names the packages that are missing, then runs what needs those that are there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from support.system_programs import missing_lines


def main(words: list[str]) -> int:
    for line in missing_lines("test-lab"):
        print(f"its tests are left out: {line}")
    beside = "-n", "2", "--dist", "loadfile"  # a file's tests share their servers; most of it is waiting
    return subprocess.call([sys.executable, "-m", "pytest", str(Path(__file__).parent), *beside, *words])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
