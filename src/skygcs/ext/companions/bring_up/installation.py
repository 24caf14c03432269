"""Installs skygcs on a companion that has no network, step by step; each step that was done before is skipped.

| step | what it does | skipped if |
|---|---|---|
| check | architecture, Python, free disk, vehicle at rest | |
| upload | the bundle, continued where it was broken off, its SHA-256 compared there | this version is installed |
| install | a virtual environment of its own, wheels from the bundle alone | this version is installed |
| configure | companion.toml, checked by the new version, put in place as a whole | it is the same |
| switch | ``current`` leads to the new version | it does already |
| keys | the companion's key is made there; both sides pin each other's certificate | they are pinned |
| service | the systemd unit; a service that was running is restarted | |

Everything is below `probe.FOLDER` in the home of the user there. A step that fails leaves the version before in use.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from skygcs.errors import CompanionError, SkygcsError
from skygcs.ext.companions.bring_up import service_control
from skygcs.ext.companions.bring_up.bundle import EXTRA, Bundle
from skygcs.ext.companions.bring_up.companion_file import CompanionFile
from skygcs.ext.companions.bring_up.inventory import Companion
from skygcs.ext.companions.bring_up.probe import CompanionFacts, probe, require_room
from skygcs.ext.companions.bring_up.side_by_side import Progress
from skygcs.ext.companions.bring_up.ssh_session import UPLOAD_BYTES, Ran, Session, printable, quoted
from skygcs.ext.companions.identity import make_identity, pin

CONFIG_NAME = "companion.toml"

SPARE_BYTES = 32 << 20
"""Room that is left after the installation."""

MAX_CERTIFICATE_BYTES = 64 << 10

INSTALL_SCRIPT = """
set -e
cd {folder}
rm -rf {version} {unpacked}
mkdir -p {unpacked}
tar -xf {tar} -C {unpacked}
python3 -m venv --without-pip {version}
{version}/bin/python {unpacked}/wheels/{pip_wheel}/pip --disable-pip-version-check install --quiet --no-index \
    --no-warn-script-location --find-links {unpacked}/wheels {requirement}
{version}/bin/skygcs --version > /dev/null
touch {version}/.complete
rm -rf {unpacked} {tar}
"""
"""pip runs from its wheel: Debian's Python has none without further packages."""

SWITCH_SCRIPT = """
set -e
cd {folder}
ln -sfn {version} current.new
mv -Tf current.new current
for old in versions/*; do
    [ "$old" = {version} ] || [ "$old" = {before} ] || rm -rf "$old"
done
"""
"""The version before is kept, as somebody may want to go back to it."""

UnitKind = Literal["system", "user"]


@dataclass(frozen=True, slots=True)
class InstallationWishes:
    """Further wishes for an installation."""

    user_service: bool
    """A service of the user there, also where the machine's could be installed."""
    force: bool
    """Although its vehicle is armed or in the air."""
    repin: bool
    """Replace certificates that are pinned already."""


async def install(
    session: Session,
    companion: Companion,
    progress: Progress,
    bundle: Bundle,
    config: CompanionFile,
    key_dir: Path,
    wishes: InstallationWishes,
) -> str:
    """All steps. ``key_dir`` has the ground's certificate. Raises CompanionError: the step, what failed, what to do."""
    # the target: facts, and whether the version is there
    progress.step = "checking"
    facts = await probe(session)
    version = f"versions/{bundle.identifier}"
    complete = await _exists(session, f"{facts.folder}/{version}/.complete")
    await _check(session, facts, bundle, complete=complete, force=wishes.force)
    # upload and install the version
    if not complete:
        tar = await _upload(session, facts, bundle, progress)
        progress.step = "installing"
        await _install(session, facts, bundle, version, tar)
    # configure, and switch to the version
    progress.step = "configuring"
    program = f"{facts.folder}/{version}/bin/skygcs"
    changed = await push_config(session, facts, config, program)
    switched = facts.installed != version
    if switched:
        await _run(
            session,
            "switch",
            SWITCH_SCRIPT.format(folder=quoted(facts.folder), version=quoted(version), before=quoted(facts.installed)),
        )
    # keys and service
    progress.step = "exchanging keys"
    await exchange_keys(session, facts, companion, config, key_dir, repin=wishes.repin)
    progress.step = "installing the service"
    kind = await _install_service(session, facts, program, wishes)
    # restart only where something changed
    if facts.state == "active" and (switched or changed):
        progress.step = "restarting"
        await service_control.restart(session, await probe(session), force=wishes.force)
    what = f"skygcs {bundle.version} " + ("was installed" if complete else "installed")
    return f"{what}, {kind} service" + (", restarted" if facts.state == "active" and (switched or changed) else "")


async def _check(session: Session, facts: CompanionFacts, bundle: Bundle, *, complete: bool, force: bool) -> None:
    again = "skygcs-cli companions bundle"
    if facts.machine != bundle.arch:
        reason = f"the bundle is for {bundle.arch}, this computer is {facts.machine or 'unknown'}"
        raise CompanionError("check", reason, f"{again} --arch {facts.machine}")
    if facts.python != bundle.python:
        reason = f"the bundle is for Python {bundle.python}, this computer has {facts.python or 'none'}"
        raise CompanionError("check", reason, f"{again} --python {facts.python or bundle.python}")
    if facts.state == "active" and not force:
        await service_control.require_at_rest(session, facts)
    if not complete:
        require_room(facts, bundle.needed_bytes + SPARE_BYTES)


async def _upload(session: Session, facts: CompanionFacts, bundle: Bundle, progress: Progress) -> str:
    """The bundle's path there, whole and compared."""
    folder = f"{facts.folder}/incoming"
    tar, part = f"{folder}/{bundle.sha256}.tar", f"{folder}/{bundle.sha256}.part"
    ran = await session.run(quoted("sh", "-c", f'mkdir -p "{folder}" && cd "{folder}" && wc -c < "{part}" 2>/dev/null'))
    offset = int(ran.stdout) if ran.ok and ran.stdout.strip().isdecimal() else 0
    # the last piece may have holes: its parts are written in any order
    offset = max(0, offset - 1) // UPLOAD_BYTES * UPLOAD_BYTES if offset <= bundle.bytes else 0

    def on_bytes(count: int) -> None:
        progress.step = f"uploading {100 * count // bundle.bytes} %"

    if not await _exists(session, tar):
        try:
            await session.upload(bundle.path, part, offset=offset, on_bytes=on_bytes)
        except CompanionError as error:
            left = (await probe(session)).free_bytes if error.step == "files" else None
            if left is not None and left < SPARE_BYTES:
                require_room(await probe(session), SPARE_BYTES)
            raise CompanionError("upload", error.reason, "again: it continues where it was broken off") from None
        await _run(session, "upload", f"mv {quoted(part, tar)}")
    progress.step = "comparing"
    ran = await session.run(quoted("sha256sum", tar))
    if ran.stdout.split()[:1] != [bundle.sha256]:
        await session.run(quoted("rm", "-f", tar))
        raise CompanionError("upload", "the bundle arrived damaged and was removed there", "again; then see its disk")
    return tar


async def _install(session: Session, facts: CompanionFacts, bundle: Bundle, version: str, tar: str) -> None:
    script = INSTALL_SCRIPT.format(
        folder=quoted(facts.folder),
        version=quoted(version),
        unpacked=quoted(f"incoming/{bundle.identifier}"),
        tar=quoted(tar),
        pip_wheel=bundle.pip_wheel,
        requirement=quoted(f"skygcs[{EXTRA}]=={bundle.version}"),
    )
    await _run(session, "install", script)


async def push_config(session: Session, facts: CompanionFacts, config: CompanionFile, program: str) -> bool:
    """Write companion.toml unless it is the same, after the program there has checked it; True if it was written."""
    place = f"{facts.folder}/{CONFIG_NAME}"
    ran = await session.run(quoted("cat", place))
    if ran.ok and ran.stdout == config.text:
        return False
    draft = f"{facts.folder}/.{CONFIG_NAME}.new.toml"
    await session.write(draft, config.text.encode())
    checked = await session.run(quoted(program, "check", draft))
    if not checked.ok:
        await session.run(quoted("rm", "-f", draft))
        lines = [line.strip() for line in (checked.stderr or checked.stdout).splitlines() if line.strip()]
        reason = printable("; ".join(lines)[:400]) or f"exit code {checked.status}"
        raise CompanionError("configure", f"{config.source} is refused there: {reason}", "correct it and push again")
    await _run(session, "configure", f"mv -f {quoted(draft, place)}")
    return True


async def exchange_keys(
    session: Session, facts: CompanionFacts, companion: Companion, config: CompanionFile, key_dir: Path, *, repin: bool
) -> None:
    """Make both keys where they are missing, and pin each side's certificate on the other. Raises CompanionError."""
    there = config.key_dir(facts.home, facts.folder)
    program = f"{facts.folder}/current/bin/skygcs"
    await _run(session, "keys", quoted(program, "companion", "identity", "companion", "--dir", there))
    certificate = await session.read(f"{there}/companion.crt", most_bytes=MAX_CERTIFICATE_BYTES)
    force = ["--force"] if repin else []
    try:
        make_identity(key_dir, "ground")
        with tempfile.NamedTemporaryFile(suffix=".crt") as file:
            file.write(certificate)
            file.flush()
            pin(Path(file.name), key_dir / "companions" / f"{companion.name}.crt", force=repin)
    except (SkygcsError, OSError) as error:
        raise CompanionError("keys", str(error), "--repin replaces it, if the companion was set up anew") from None
    offered = f"{facts.folder}/.ground.crt"
    await session.write(offered, (key_dir / "ground.crt").read_bytes())
    await _run(session, "keys", quoted(program, "companion", "pin", offered, "--dir", there, *force))
    await session.run(quoted("rm", "-f", offered))


async def _install_service(
    session: Session, facts: CompanionFacts, program: str, wishes: InstallationWishes
) -> UnitKind:
    words = [program, "service", "install", f"{facts.folder}/{CONFIG_NAME}", "--force"]
    root = facts.uid == 0 or (not wishes.user_service and (await session.run("sudo -n true")).ok)
    kind: UnitKind = "system" if root and not wishes.user_service else "user"
    if kind == "user":
        words.append("--user")
        await session.run(service_control.in_session("loginctl enable-linger"))  # it starts with the machine
    elif facts.uid != 0:
        words = ["sudo", "-n", *words]
    ran = await session.run(service_control.in_session(quoted(*words)))
    notes = [line for line in ran.stderr.splitlines() if line.startswith("note:")]
    if not ran.ok or notes:
        reason = printable(notes[0] if ran.ok else ran.why)
        raise CompanionError("service", reason, "see `skygcs service install` there by hand")
    return kind


async def _exists(session: Session, path: str) -> bool:
    return (await session.run(quoted("test", "-e", path))).ok


async def _run(session: Session, step: str, script: str) -> Ran:
    ran = await session.run(quoted("sh", "-c", script))
    if not ran.ok:
        full = "No space left" in ran.stderr
        todo = "remove old logs or other files there, then again" if full else "again with what is wrong corrected"
        raise CompanionError(step, printable(ran.why), todo)
    return ran
