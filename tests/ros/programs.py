"""Programs of ROS and DDS that these tests run, and the Debian packages that have them."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

PROGRAMS = {
    "g++": "g++",
    "fastddsgen": "fastddsgen",
    "/usr/include/fastdds/dds/domain/DomainParticipant.hpp": "libfastrtps-dev",
}
"""Program or file -> package."""


def missing() -> list[str]:
    """The packages that are not there, sorted."""
    return sorted({package for name, package in PROGRAMS.items() if not _is_there(name)})


def _is_there(name: str) -> bool:
    return Path(name).exists() if name.startswith("/") else shutil.which(name) is not None


def needs(*packages: str) -> None:
    """The test is skipped without these packages, and fails in CI, which has to install them."""
    absent = sorted(set(packages) & set(missing()))
    if absent:
        text = f"not installed: apt-get install {' '.join(absent)}"
        if os.environ.get("CI"):
            pytest.fail(text)
        pytest.skip(text)
