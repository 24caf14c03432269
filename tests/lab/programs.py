"""Programs of a lab that these tests run, and the Debian packages that have them."""

from __future__ import annotations

import os
import shutil

import pytest

PROGRAMS = {"prometheus": "prometheus", "promtool": "prometheus", "systemd-analyze": "systemd"}
"""Program -> package."""


def missing() -> list[str]:
    """The programs that are not there, sorted."""
    return sorted(name for name in PROGRAMS if shutil.which(name) is None)


def needs(program: str) -> str:
    """The path of a program; the test is skipped without it, and fails in CI, which has to install it."""
    path = shutil.which(program)
    if path is None:
        text = f"{program} is not installed (apt-get install {PROGRAMS[program]})"
        if os.environ.get("CI"):
            pytest.fail(text)
        pytest.skip(text)
    return path
