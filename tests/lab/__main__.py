"""`make test-lab`: names the programs that are missing, then runs what needs those that are there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from lab.programs import PROGRAMS, missing


def main(words: list[str]) -> int:
    for program in missing():
        print(f"{program} is not installed, and its tests are left out: apt-get install {PROGRAMS[program]}")
    return subprocess.call([sys.executable, "-m", "pytest", str(Path(__file__).parent), *words])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
