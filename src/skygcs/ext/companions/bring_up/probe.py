"""State of a companion and of what is installed there, from one script of the shell there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from skygcs.errors import CompanionError
from skygcs.ext.companions.bring_up.content import REMOTE
from skygcs.ext.companions.bring_up.ssh_session import Session, quoted

FOLDER = "skygcs"
"""In the home of the user there: versions, the link ``current`` to one of them, companion.toml, keys, logs."""

SYSTEM_UNIT = "/etc/systemd/system/skygcs.service"
SYSTEM_SOCKET = "/run/skygcs/skygcs.sock"

MIN_FREE_BYTES = 64 << 20
"""An hour of one vehicle's telemetry over Wi-Fi is a log of 70 MB."""

SCRIPT = f"""
root="$HOME/{FOLDER}"
program="$root/current/bin/skygcs"
[ -x "$program" ] || program=$(command -v skygcs)
user_unit="${{XDG_CONFIG_HOME:-$HOME/.config}}/systemd/user/skygcs.service"
unit=none
[ -f {SYSTEM_UNIT} ] && unit=system
[ -f "$user_unit" ] && unit=user
XDG_RUNTIME_DIR="${{XDG_RUNTIME_DIR:-/run/user/$(id -u)}}"; export XDG_RUNTIME_DIR
flag=; [ $unit = user ] && flag=--user
echo "home=$HOME"
echo "uid=$(id -u)"
echo "machine=$(uname -m)"
echo "python=$(python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)"
echo "bits=$(getconf LONG_BIT 2>/dev/null)"
echo "libc=$(getconf GNU_LIBC_VERSION 2>/dev/null)"
echo "free_kb=$(df -Pk "$HOME" 2>/dev/null | awk 'NR == 2 {{ print $4 }}')"
echo "program=$program"
[ -z "$program" ] || echo "version=$("$program" --version 2>/dev/null)"
python=$(head -n 1 "$program" 2>/dev/null | sed -n 's/^#! *\\([^ ]*python[^ /]*\\)$/\\1/p')
[ -z "$python" ] || echo "content=$("$python" -I - 2>/dev/null <<'PYTHON'
{REMOTE}
PYTHON
)"
echo "installed=$(readlink "$root/current" 2>/dev/null)"
echo "unit=$unit"
echo "state=$(systemctl $flag is-active skygcs 2>/dev/null)"
echo "uptime=$(cut -d ' ' -f 1 /proc/uptime 2>/dev/null)"
echo "unix=$(date +%s.%N)"
"""
"""Prints KEY=VALUE; what cannot be found out is empty."""

Unit = Literal["system", "user", "none"]


@dataclass(frozen=True, slots=True)
class CompanionFacts:
    """Findings of the script."""

    home: str
    uid: int | None
    machine: str
    """The architecture by `uname -m`; armv7l also for 32-bit programs on a 64-bit kernel, as on some Raspberry Pis."""
    python: str
    """ "3.11"; "" without one."""
    libc: str
    """ "glibc 2.36"; "" if it is another one."""
    free_bytes: int | None
    program: str
    """Path of `skygcs` there; "" if it is not installed."""
    version: str
    content: str
    """`content_of` the skygcs that is installed there; "" if its program names no Python."""
    installed: str
    """The folder of the installed bundle, relative to `FOLDER`; "" if it was not installed from one."""
    unit: Unit
    state: str
    """The state in systemd's words: active, inactive, failed, …; "" if it does not answer."""
    uptime_s: float | None
    unix_s: float | None
    """Its clock, when the script ended."""

    @property
    def folder(self) -> str:
        return f"{self.home}/{FOLDER}"

    def as_dict(self) -> dict[str, Any]:
        """JSON-able, for `companions status`."""
        return {
            "machine": self.machine,
            "python": self.python,
            "free_bytes": self.free_bytes,
            "version": self.version or None,
            "content": self.content or None,
            "service": self.unit,
            "state": self.state or None,
            "uptime_s": self.uptime_s,
        }


async def probe(session: Session) -> CompanionFacts:
    """Find out about a companion. Raises CompanionError."""
    ran = await session.run(quoted("sh", "-c", SCRIPT))
    if not ran.ok:
        raise CompanionError("probe", f"a script of the shell there failed: {ran.why}", "it needs a POSIX sh")
    return parsed(ran.stdout)


def parsed(text: str) -> CompanionFacts:
    """The output of `SCRIPT`. Raises CompanionError if it has no home."""
    values = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)

    def value(key: str) -> str:
        return values.get(key, "").strip()[:500]

    home, unit = value("home"), value("unit")
    if not home.startswith("/"):
        raise CompanionError("probe", "the shell there has no $HOME", "log in by hand and see why")
    free_kb = value("free_kb")
    return CompanionFacts(
        home=home,
        uid=int(value("uid")) if value("uid").isdecimal() else None,
        machine="armv7l" if (value("machine"), value("bits")) == ("aarch64", "32") else value("machine"),
        python=value("python"),
        libc=value("libc"),
        free_bytes=int(free_kb) * 1024 if free_kb.isdecimal() else None,
        program=value("program"),
        version=value("version").removeprefix("skygcs").strip(),
        content=value("content"),
        installed=value("installed"),
        unit="system" if unit == "system" else "user" if unit == "user" else "none",
        state=value("state"),
        uptime_s=_number(value("uptime")),
        unix_s=_number(value("unix")),
    )


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def require_room(facts: CompanionFacts, needed_bytes: int = MIN_FREE_BYTES) -> None:
    """Raises CompanionError if the disk has less room; an unknown amount is enough."""
    if facts.free_bytes is not None and facts.free_bytes < needed_bytes:
        raise CompanionError(
            "disk",
            f"{_megabytes(facts.free_bytes)} free in {facts.home}, {_megabytes(needed_bytes)} needed",
            f"remove old logs ({facts.folder}/logs) or other files there",
        )


def _megabytes(count: int) -> str:
    return f"{count / 1e6:.0f} MB"
