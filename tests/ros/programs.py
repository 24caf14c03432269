"""Programs of ROS and DDS that these tests run, and the Debian packages that have them."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

SYSTEM_PACKAGES = "/usr/lib/python3/dist-packages"
ROSPY = ("rospy", "geometry_msgs", "sensor_msgs", "nav_msgs", "std_srvs", "tf2_msgs")
"""Packages of the system's Python."""

ROS1 = ("python3-rosmaster", "python3-rostopic", *(f"python3-{name.replace('_', '-')}" for name in ROSPY))

PROGRAMS = {
    "g++": "g++",
    "fastddsgen": "fastddsgen",
    "/usr/include/fastdds/dds/domain/DomainParticipant.hpp": "libfastrtps-dev",
    "rosmaster": "python3-rosmaster",
    "rostopic": "python3-rostopic",
    **{f"{SYSTEM_PACKAGES}/{name}": f"python3-{name.replace('_', '-')}" for name in ROSPY},
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
