"""`make test-firmware`: one run for each firmware that the environment names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from skygcs.config.firmware import ARDUCOPTER_HELP, PX4_HELP, find_arducopter, find_px4
from skygcs.errors import ConfigError
from support.firmware_field import available


def main(words: list[str]) -> int:
    named = available()
    for name, help_text in (("px4", PX4_HELP), ("ardupilot", ARDUCOPTER_HELP)):
        if name not in named:
            print(f"{name} is not flown: {help_text}")
    code = 0
    for name in named:
        try:
            find_px4() if name == "px4" else find_arducopter()
        except ConfigError as error:
            print(error)
            code = 1
            continue
        options = ["--firmware", name, "-p", "no:xdist", "-p", "no:cacheprovider", "--timeout", "900", *words]
        code = max(code, subprocess.call([sys.executable, "-m", "pytest", str(Path(__file__).parent), *options]))
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
