"""The program nats-server on this computer: where it is, and what is wrong with its version."""

from __future__ import annotations

import re
import shutil
import subprocess

from skygcs.errors import SkygcsError

PACKAGE = "nats-server"
SYSTEM_FOLDERS = "/usr/sbin:/sbin:/usr/local/bin"
"""Debian has it in /usr/sbin, which a user's PATH may not have."""

FIXED_VERSION = (2, 9, 23)
"""Earlier versions have CVE-2023-47090: with some configurations of accounts they let in everybody. 2.10.2 for 2.10."""


def find_server() -> str:
    """The path of nats-server. Raises SkygcsError that names the package."""
    path = shutil.which(PACKAGE) or shutil.which(PACKAGE, path=SYSTEM_FOLDERS)
    if path is None:
        raise SkygcsError(f"{PACKAGE} is not installed: apt-get install {PACKAGE}, or see https://nats.io/download")
    return path


def server_version(program: str) -> str:
    """Return what ``nats-server --version`` prints; "" if it does not run."""
    try:
        done = subprocess.run([program, "--version"], capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def parsed_version(text: str) -> tuple[int, int, int] | None:
    """2.9.10 of "nats-server: v2.9.10", or of what a server reports; None for another text."""
    found = re.search(r"(\d{1,5})\.(\d{1,5})\.(\d{1,5})", text)
    return None if found is None else (int(found[1]), int(found[2]), int(found[3]))


def version_warning(text: str) -> str | None:
    """Return what is wrong with this version of nats-server; None: nothing that is known here."""
    version = parsed_version(text)
    if version is None or (version >= FIXED_VERSION and not (2, 10, 0) <= version < (2, 10, 2)):
        return None
    number = ".".join(map(str, version))
    return (
        f"nats-server {number} has CVE-2023-47090 (with some accounts, not ours, anyone is let in): "
        "install 2.9.23, 2.10.2 or later"
    )
