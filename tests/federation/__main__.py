"""`make test-federation`: names the program that is missing, else runs the tests that need a real nats-server."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from support.system_programs import missing_lines


def main(words: list[str]) -> int:
    if lines := missing_lines("test-federation"):
        print(*lines, sep="\n")
        return 1
    # most of them wait: two at a time on any machine
    side_by_side = ("-n", "2", "--dist", "worksteal")
    return subprocess.call([sys.executable, "-m", "pytest", str(Path(__file__).parent), *side_by_side, *words])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
