"""`make test-ros`: names the packages that are missing, then runs what needs those that are there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from ros.programs import missing


def main(words: list[str]) -> int:
    for package in missing():
        print(f"{package} is not installed, and its tests are left out: apt-get install {package}")
    return subprocess.call([sys.executable, "-m", "pytest", str(Path(__file__).parent), *words])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
