"""The environments of the programs that people fly with: one for each, because both MAVSDKs are called `mavsdk`."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from support.process import ROOT

FOLDER = ROOT / "build" / "clients"


@dataclass(frozen=True)
class Client:
    """A program, and the packages that its environment holds; those ``alone`` come without what they depend on."""

    name: str
    packages: tuple[str, ...]
    alone: tuple[str, ...] = ()

    @property
    def python(self) -> Path:
        return FOLDER / self.name / "bin" / "python"

    @property
    def _stamp(self) -> Path:
        return FOLDER / self.name / ".installed"

    @property
    def _wanted(self) -> str:
        return "\n".join((*self.packages, *self.alone))

    @property
    def is_installed(self) -> bool:
        return self._stamp.is_file() and self._stamp.read_text() == self._wanted and self.python.exists()

    def install(self) -> str:
        """Make the environment. Returns what keeps it from being made; empty if it is there."""
        if self.is_installed:
            return ""
        folder = FOLDER / self.name
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = _run(sys.executable, "-m", "venv", "--clear", "--without-pip", str(folder))
        if made.returncode:
            return f"no environment in {folder}: {made.stdout}{made.stderr}"
        pip = sys.executable, "-m", "pip", "--python", str(self.python), "--quiet", "--disable-pip-version-check"
        for option, packages in (("--prefer-binary", self.packages), ("--no-deps", self.alone)):
            # not compiled: most of it is never imported
            done = _run(*pip, "install", "--no-compile", option, *packages) if packages else made
            if done.returncode:
                return f"{self.name}: of {', '.join(packages)} not all could be installed into {folder}:\n{done.stderr}"
        self._stamp.write_text(self._wanted)
        return ""


def _run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)


CLIENTS = {
    client.name: client
    for client in (
        Client("pymavlink", ("pymavlink>=2.4.42,<3",)),
        # its last release, of 2019: it imports `past`, which it had through an older pymavlink; `past` wants distutils
        Client("dronekit", ("setuptools<81", "future>=1", "dronekit==2.9.2")),
        Client("mavsdk-grpc", ("mavsdk<4",)),
        Client("mavsdk", ("mavsdk>=4,<5",)),
        # what its console needs; with the 3D map's VTK and OpenCV it would be a gigabyte
        Client(
            "mavproxy",
            ("pymavlink>=2.4.42,<3", "defusedxml", "pyserial", "numpy", "pynmeagps", "pillow"),
            ("MAVProxy>=1.8.75,<2",),
        ),
    )
}


def main() -> int:
    """Make all environments before tests run beside each other; names what is missing."""
    clients = list(CLIENTS.values())
    with ThreadPoolExecutor(2) as two:
        wrong = [text for text in two.map(Client.install, clients) if text]
    for text in wrong:
        print(text, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
