"""`make test-firmware`: one run for each firmware that the environment names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from skygcs.config.firmware import PROGRAMS, PX4_HELP, find_ardupilot, find_px4
from skygcs.errors import ConfigError
from support.firmware_field import available


def main(words: list[str]) -> int:
    named = available()
    helps = {"px4": PX4_HELP, **{kind: program.help for kind, program in PROGRAMS.items()}}
    for name, help_text in helps.items():
        if name not in named:
            print(f"{name} is not flown: {help_text}")
    code = 0
    for name in named:
        try:
            find_ardupilot(name) if name in PROGRAMS else find_px4()
        except ConfigError as error:
            print(error)
            code = 1
            continue
        options = ["--firmware", name, "-p", "no:xdist", "-p", "no:cacheprovider", "--timeout", "900", *words]
        code = max(code, subprocess.call([sys.executable, "-m", "pytest", str(Path(__file__).parent), *options]))
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
