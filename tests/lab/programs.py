"""Programs of a lab that these tests run, and the Debian packages that have them."""

from __future__ import annotations

import os
import shutil

import pytest

PROGRAMS = {
    "prometheus": "prometheus",
    "promtool": "prometheus",
    "sshd": "openssh-server",
    "str2str": "rtklib",
    "systemd-analyze": "systemd",
}
"""Program -> package."""


SYSTEM_FOLDERS = "/usr/sbin:/sbin"
"""Of programs for root, which a user's PATH may not have."""


def missing() -> list[str]:
    """The programs that are not there, sorted."""
    return sorted(name for name in PROGRAMS if _path_of(name) is None)


def _path_of(program: str) -> str | None:
    return shutil.which(program) or shutil.which(program, path=SYSTEM_FOLDERS)


def needs(program: str) -> str:
    """The path of a program; the test is skipped without it, and fails in CI, which has to install it."""
    path = _path_of(program)
    if path is None:
        text = f"{program} is not installed (apt-get install {PROGRAMS[program]})"
        if os.environ.get("CI"):
            pytest.fail(text)
        pytest.skip(text)
    return path
