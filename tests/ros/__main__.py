"""`make test-ros`: names the packages that are missing, then runs what needs those that are there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from support.system_programs import missing_lines


def main(words: list[str]) -> int:
    for line in missing_lines("test-ros"):
        print(f"its tests are left out: {line}")
    return subprocess.call([sys.executable, "-m", "pytest", str(Path(__file__).parent), *words])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
