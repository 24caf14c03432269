"""`skygcs service`: run the daemon under systemd, for the whole machine or for one user.

`unit_text` and `UDEV_RULES` are what is written; the commands around them install, show and remove it.
"""

from __future__ import annotations

import errno
import os
import pwd
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from skygcs.config.files import make_log_folder, write_named
from skygcs.errors import ConfigError, SkygcsError

NAME = "skygcs.service"
SYSTEM_UNIT = Path("/etc/systemd/system") / NAME
UDEV_FILE = Path("/etc/udev/rules.d/60-skygcs-radios.rules")
SYSTEM_SOCKET = "/run/skygcs/skygcs.sock"

SYSTEMCTL_TIMEOUT_S = 30

COMMON = """\
Type=notify
NotifyAccess=main
ExecReload=/bin/kill -HUP $MAINPID
# the loop reports every 5 s; a daemon that hangs is started again, and its vehicles' own failsafes cover the gap
WatchdogSec=10
Restart=on-failure
RestartSec=0.5
# 3 s to undo, 2 s to hold what flies, 3 s for the log
TimeoutStopSec=15
UMask=0077
NoNewPrivileges=yes
LockPersonality=yes
RestrictSUIDSGID=yes
RestrictNamespaces=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged @resources
SystemCallErrorNumber=EPERM
"""
"""Lines of both kinds of units: they need no privileges."""

SYSTEM_ONLY = """\
# control ticks go before other programs of this machine
Nice=-10
CPUWeight=1000
CapabilityBoundingSet=
AmbientCapabilities=
DevicePolicy=closed
DeviceAllow=char-ttyUSB rw
DeviceAllow=char-ttyACM rw
DeviceAllow=char-ttyS rw
DeviceAllow=char-ttyAMA rw
SupplementaryGroups=dialout
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp=yes
PrivateMounts=yes
ProtectProc=invisible
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
RestrictRealtime=yes
RemoveIPC=yes
KeyringMode=private
RuntimeDirectory=skygcs
CacheDirectory=skygcs
StateDirectory=skygcs
Environment=XDG_CACHE_HOME=/var/cache/skygcs XDG_STATE_HOME=/var/lib/skygcs
"""

UDEV_RULES = """\
# Written by `skygcs service install`. Radios and autopilots on USB: for the group dialout, left alone by ModemManager.
ACTION=="remove", GOTO="skygcs_end"
SUBSYSTEM!="tty", GOTO="skygcs_latency"
# FTDI: RFD900x, SiK radios, XBee adapters
ATTRS{idVendor}=="0403", ATTRS{idProduct}=="6001|6010|6011|6014|6015", ENV{SKYGCS_RADIO}="1"
# Silicon Labs CP210x: SiK and 3DR radios, XBee adapters
ATTRS{idVendor}=="10c4", ATTRS{idProduct}=="ea60|ea61|ea70", ENV{SKYGCS_RADIO}="1"
# autopilots: 3D Robotics and PX4, ArduPilot, CubePilot, Holybro
ATTRS{idVendor}=="26ac|1209|2dae|3162", ENV{SKYGCS_RADIO}="1"
ENV{SKYGCS_RADIO}=="1", GROUP="dialout", MODE="0660", ENV{ID_MM_DEVICE_IGNORE}="1"
LABEL="skygcs_latency"
# an FTDI adapter collects bytes for 16 ms otherwise
SUBSYSTEM=="usb-serial", DRIVERS=="ftdi_sio", ATTR{latency_timer}="1"
LABEL="skygcs_end"
"""


@dataclass(frozen=True, slots=True)
class Installation:
    """Installation that the unit runs. ``user_name`` None: a unit of a user's own service manager."""

    fleet_file: Path
    log_dir: Path
    program: Path
    user_name: str | None


def unit_text(installation: Installation) -> str:
    """The unit file."""
    system = installation.user_name is not None
    socket = f" --socket {SYSTEM_SOCKET}" if system else ""
    lines = [
        "# Written by `skygcs service install`.",
        "[Unit]",
        "Description=skygcs, ground-control daemon for MAVLink vehicles",
        "After=network.target",
        "",
        "[Service]",
        f"ExecStart={_quoted(installation.program)} run {_quoted(installation.fleet_file)}{socket}",
    ]
    if system:
        lines += [f"User={installation.user_name}", f"ReadWritePaths={_quoted(installation.log_dir)}"]
        lines += SYSTEM_ONLY.splitlines()
    lines += COMMON.splitlines()
    lines += ["", "[Install]", f"WantedBy={'multi-user' if system else 'default'}.target", ""]
    return "\n".join(lines)


def install(fleet_file: Path, *, user: bool, force: bool) -> int:
    """Check the fleet file, write the unit and, for the machine, the udev rules; enable it. Nothing is started."""
    from skygcs.config.loader import load_fleet

    config = load_fleet(fleet_file)
    log_dir = config.daemon.log_dir
    name = None if user else os.environ.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name
    try:
        _make_log_dir(log_dir, name)
    except OSError as error:
        raise ConfigError(str(fleet_file), [f"daemon.log_dir: {log_dir}: {error.strerror or error}"]) from None
    program = Path(sys.argv[0]).resolve()
    installation = Installation(fleet_file.resolve(), log_dir, program, name)
    _write(unit_path(user=user), unit_text(installation), force=force)
    if not user:
        _write(UDEV_FILE, UDEV_RULES, force=True)
        _systemctl("udevadm", "control", "--reload")
    flag = ["--user"] if user else []
    _systemctl("systemctl", *flag, "daemon-reload")
    _systemctl("systemctl", *flag, "enable", NAME)
    start = " ".join(["systemctl", *flag, "start", "skygcs"])
    print(f"\nit starts with the {'session' if user else 'machine'}; now: {start}")
    print(f"after a change of {fleet_file}: {start.replace('start', 'reload')}")
    if not user:
        print(f"its socket: export SKYGCS_SOCKET={SYSTEM_SOCKET} (for {name})")
    return 0


def status(*, user: bool) -> int:
    """Return what systemd says of it; its exit code."""
    return subprocess.call(["systemctl", *(["--user"] if user else []), "--no-pager", "status", NAME])


def uninstall(*, user: bool) -> int:
    """Stop and disable it, and remove what `install` wrote. Logs and fleet file stay."""
    path = unit_path(user=user)
    flag = ["--user"] if user else []
    if not path.exists():
        raise SkygcsError(f"{path} does not exist: no service is installed there")
    _systemctl("systemctl", *flag, "disable", "--now", NAME)
    for file in [path] if user else [path, UDEV_FILE]:
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise SkygcsError(f"{file}: {error.strerror or error}; sudo?") from None
        print(f"removed {file}")
    _systemctl("systemctl", *flag, "daemon-reload")
    return 0


def unit_path(*, user: bool) -> Path:
    """Where the unit is written."""
    if not user:
        return SYSTEM_UNIT
    base = os.environ.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(base) / "systemd" / "user" / NAME


def _quoted(path: Path) -> str:
    """A path as one word of a unit file."""
    text = str(path).replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if any(c in text for c in " \t\"'\\;") else text


def _make_log_dir(folder: Path, name: str | None) -> None:
    """Make the log folder if it is not there, for the user that the daemon runs as (None: our own). Raises OSError.

    A folder that is there keeps its owner: the fleet file may name any. It must belong to that user already.
    """
    as_root = name is not None and name != "root" and os.getuid() == 0
    if not folder.exists():
        made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        make_log_folder(folder)
        if as_root:
            entry = pwd.getpwnam(name or "")
            for one in made:
                os.chown(one, entry.pw_uid, entry.pw_gid, follow_symlinks=False)
    elif not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    elif as_root and folder.stat().st_uid != pwd.getpwnam(name or "").pw_uid:
        owner = folder.stat().st_uid
        text = f"belongs to another user (uid {owner}), not to {name}: name a folder of {name}'s, or give it to them"
        raise OSError(errno.EPERM, text)


def _write(path: Path, text: str, *, force: bool) -> None:
    if path.exists() and not force and path.read_text(encoding="utf-8") != text:
        raise SkygcsError(f"{path} exists and differs; --force overwrites it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_named(path, text)
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}; sudo, or --user for a service of your own") from None
    print(f"wrote {path}")


def _systemctl(*words: str) -> None:
    """Run it; what it cannot do is shown and is no failure: files can be installed where no manager runs."""
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=SYSTEMCTL_TIMEOUT_S)
        why = done.stderr.strip() if done.returncode else ""
    except (OSError, subprocess.TimeoutExpired) as error:
        why = str(error)
    if why:
        print(f"note: {' '.join(words)}: {why}", file=sys.stderr)
