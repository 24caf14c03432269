"""The service of a companion: start, stop, its log; and what forbids to stop it, a vehicle that is armed or flies."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from skygcs.core.vehicle.state import AIRBORNE
from skygcs.errors import CompanionError
from skygcs.ext.companions.bring_up.probe import FOLDER, SYSTEM_SOCKET, CompanionFacts
from skygcs.ext.companions.bring_up.ssh_session import Session, printable, quoted
from skygcs.ext.companions.ground_contact import GROUND_LINK

UNIT = "skygcs"

INSIST = "--force insists"


async def start(session: Session, facts: CompanionFacts) -> str:
    """Start the service and wait until it reports that it is ready. Raises CompanionError with its last log line."""
    require_service(facts)
    if facts.state == "active":
        return "was running"
    await _systemctl(session, facts, "start")
    return "started"


async def stop(session: Session, facts: CompanionFacts, *, force: bool) -> str:
    """Stop the service. Raises CompanionError, also if its vehicle is armed or in the air and ``force`` is not set."""
    require_service(facts)
    if facts.state not in ("active", "activating", "reloading"):
        return "was not running"
    if not force:
        await require_at_rest(session, facts)
    await _systemctl(session, facts, "stop")
    return "stopped"


async def restart(session: Session, facts: CompanionFacts, *, force: bool) -> str:
    """Restart it, or start it if it does not run. Raises CompanionError as `stop`."""
    require_service(facts)
    if facts.state == "active" and not force:
        await require_at_rest(session, facts)
    await _systemctl(session, facts, "restart")
    return "restarted" if facts.state == "active" else "started"


def require_service(facts: CompanionFacts) -> None:
    """Raises CompanionError if there is no unit."""
    if facts.unit == "none":
        raise CompanionError("service", "is not installed there", "skygcs-cli companions install")


async def require_at_rest(session: Session, facts: CompanionFacts) -> None:
    """Raises CompanionError if a vehicle of a running service is armed or in the air, or if its state is not known."""
    flying = await active_vehicles(session, facts)
    if flying:
        reason = f"{', '.join(flying)} is armed or in the air"
        raise CompanionError("refused", reason, f"land and disarm first; {INSIST}")


async def active_vehicles(session: Session, facts: CompanionFacts) -> list[str]:
    """Vehicles of a companion's daemon that are armed or in the air; none if it does not run. Raises CompanionError.

    A vehicle that it hears by way of the ground alone is another companion's.
    """
    if facts.state != "active":
        return []
    vehicles = await ask(session, facts, "status")
    if not isinstance(vehicles, list):
        raise CompanionError("status", "the daemon there gives no list of vehicles", INSIST)
    own = [v for v in vehicles if isinstance(v, Mapping) and not _heard_only_over(v, GROUND_LINK)]
    return [str(v.get("name")) for v in own if is_active(v)]


def _heard_only_over(vehicle: Mapping[str, Any], link: str) -> bool:
    """True if the vehicle is heard, and over channels of this link alone."""
    channels = vehicle.get("links")
    if not isinstance(channels, Mapping) or not channels:
        return False
    return all(channel == link or str(channel).startswith(f"{link}:") for channel in channels)


def is_active(vehicle: Mapping[str, Any]) -> bool:
    """True if a vehicle of `vehicles.list` is armed, or not known to be disarmed, or in the air."""
    return vehicle.get("armed") is not False or vehicle.get("landed") in AIRBORNE


async def ask(session: Session, facts: CompanionFacts, *words: str) -> Any:
    """The output of `skygcs-cli … --json` on the companion. Raises CompanionError."""
    socket = ["--socket", SYSTEM_SOCKET] if facts.unit == "system" else []
    ran = await session.run(in_session(quoted(f"{facts.program}-cli", *socket, *words, "--json")))
    if not ran.ok:
        raise CompanionError(words[0], f"the daemon there does not answer: {printable(ran.why)}", INSIST)
    try:
        return json.loads(ran.stdout)
    except ValueError:
        raise CompanionError(words[0], "the daemon there answers no JSON", INSIST) from None


def log_command(facts: CompanionFacts, lines: int, *, follow: bool) -> str:
    """Print the newest lines of the service's log: of a file in its folder if there is one, else the journal."""
    journal = ["journalctl", *_flag(facts), "-u", UNIT, "-n", str(lines), "-o", "short-iso", "--no-pager"]
    if facts.unit == "system" and facts.uid != 0:
        journal = ["sudo", "-n", *journal]
    file = f"{facts.home}/{FOLDER}/skygcs.log"
    tail = ["tail", "-n", str(lines), *(["-F"] if follow else []), file]
    return in_session(
        f"if [ -f {quoted(file)} ]; then exec {quoted(*tail)}; else "
        f"exec {quoted(*journal, *(['-f'] if follow else []))}; fi"
    )


async def _systemctl(session: Session, facts: CompanionFacts, verb: str) -> None:
    ran = await session.run(in_session(quoted(*systemctl(facts), verb, UNIT)))
    if ran.ok:
        return
    if "password is required" in ran.stderr:
        raise _needs_root(verb)
    log = await session.run(log_command(facts, 1, follow=False))
    last = printable(log.why) if log.ok and log.stdout.strip() else ""
    reason = f"{verb} failed: {printable(ran.why)}" + (f"; its log: {last}" if last else "")
    raise CompanionError("service", reason, "skygcs-cli companions logs shows more")


def _needs_root(verb: str) -> CompanionError:
    todo = "allow `sudo -n systemctl` there, log in as root, or install with --user-service"
    return CompanionError("service", f"to {verb} the machine's service needs root", todo)


def systemctl(facts: CompanionFacts) -> list[str]:
    """The words before the verb."""
    if facts.unit == "system" and facts.uid != 0:
        return ["sudo", "-n", "systemctl"]
    return ["systemctl", *_flag(facts)]


def _flag(facts: CompanionFacts) -> list[str]:
    return ["--user"] if facts.unit == "user" else []


def in_session(command: str) -> str:
    """A command with the place of a user's own service manager, which a login without PAM does not set."""
    return f"XDG_RUNTIME_DIR=${{XDG_RUNTIME_DIR:-/run/user/$(id -u)}}; export XDG_RUNTIME_DIR; {command}"
