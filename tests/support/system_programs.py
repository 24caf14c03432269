"""Programs and files of the system that tests need, by the target that runs them, and their Debian packages.

`.ci/packages` runs this file by a bare Python, before anything is installed: `python3 -I FILE TARGET...` prints the
packages that are missing. It imports the standard library only.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

ROSPY = {
    f"/usr/lib/python3/dist-packages/{name}": f"python3-{name.replace('_', '-')}"
    for name in ("rospy", "geometry_msgs", "sensor_msgs", "nav_msgs", "std_srvs", "tf2_msgs")
}
"""Packages of the system's Python."""

ROS1 = {"rosmaster": "python3-rosmaster", "rostopic": "python3-rostopic", "rosservice": "python3-rosservice", **ROSPY}
FAST_DDS = {
    "g++": "g++",
    "fastddsgen": "fastddsgen",
    "/usr/include/fastdds/dds/domain/DomainParticipant.hpp": "libfastrtps-dev",
}

PROGRAMS: dict[str, dict[str, str]] = {
    "test-system": {"openssl": "openssl"},
    "test-web": {"chromium|chromium-browser|google-chrome": "chromium"},
    "test-lab": {
        "prometheus": "prometheus",
        "promtool": "prometheus",
        "ssh": "openssh-client",
        "ssh-keygen": "openssh-client",
        "sshd": "openssh-server",
        "str2str": "rtklib",
        "systemd-analyze": "systemd",
    },
    "test-federation": {"nats-server": "nats-server"},
    "test-ros": FAST_DDS | ROS1,
    "test-container": {"debootstrap": "debootstrap", "unshare": "util-linux", "chroot": "coreutils"},
}
"""Target -> program, names of which one is enough, or file -> package."""

SYSTEM_FOLDERS = "/usr/sbin:/sbin"
"""Folders of programs for root, which a user's PATH may lack."""


def path_of(name: str) -> str | None:
    """The path of a key of `PROGRAMS`; None: it is not there."""
    if name.startswith("/"):
        return name if Path(name).exists() else None
    folders = f"{os.environ.get('PATH', os.defpath)}:{SYSTEM_FOLDERS}"
    return next((path for one in name.split("|") if (path := shutil.which(one, path=folders))), None)


def missing(target: str) -> dict[str, str]:
    """The programs of a target that are not there: program or file -> package, sorted by the name of the package."""
    absent = {name: package for name, package in PROGRAMS[target].items() if path_of(name) is None}
    return dict(sorted(absent.items(), key=lambda item: item[1]))


def missing_lines(target: str) -> list[str]:
    """A line for each package of a target that is not installed, with what to do."""
    packages = dict.fromkeys(missing(target).values())
    return [f"{name} is not installed: apt-get install {name}" for name in packages]


if __name__ == "__main__":
    print(*sorted({package for target in sys.argv[1:] for package in missing(target).values()}), sep="\n")
