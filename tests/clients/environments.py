"""The environments of the programs that people fly with: one for each, because both MAVSDKs are called `mavsdk`."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from support.process import ROOT

FOLDER = ROOT / "build" / "clients"


@dataclass(frozen=True)
class Client:
    """A program, and the packages that its environment holds."""

    name: str
    packages: tuple[str, ...]

    @property
    def python(self) -> Path:
        return FOLDER / self.name / "bin" / "python"

    @property
    def _stamp(self) -> Path:
        return FOLDER / self.name / ".installed"

    def install(self) -> str:
        """What keeps its environment from being made; empty if it is there."""
        wanted = "\n".join(self.packages)
        if self._stamp.is_file() and self._stamp.read_text() == wanted and self.python.exists():
            return ""
        folder = FOLDER / self.name
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = subprocess.run([sys.executable, "-m", "venv", str(folder)], capture_output=True, text=True, check=False)
        if made.returncode:
            return f"no environment in {folder}: {made.stdout}{made.stderr}"
        pip = [str(self.python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--prefer-binary"]
        done = subprocess.run([*pip, *self.packages], capture_output=True, text=True, check=False)
        if done.returncode:
            return f"{', '.join(self.packages)} could not be installed into {folder}:\n{done.stderr}"
        self._stamp.write_text(wanted)
        return ""


CLIENTS = {
    client.name: client
    for client in (
        Client("pymavlink", ("pymavlink>=2.4.42,<3",)),
        # its last release, of 2019: it imports `past`, which it had through an older pymavlink; `past` wants distutils
        Client("dronekit", ("dronekit==2.9.2", "future>=1", "setuptools<81")),
        Client("mavsdk-grpc", ("mavsdk<4",)),
    )
}


def main() -> int:
    """Make all environments before tests run beside each other; names what is missing."""
    wrong = {name: text for name, client in CLIENTS.items() if (text := client.install())}
    for name, text in wrong.items():
        print(f"{name}: {text}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
