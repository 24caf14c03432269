"""`skygcs-cli companions`: the computers on the vehicles, over SSH. No daemon is needed."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from skygcs.cli.connection import Exit, fail, print_outcomes, run_offline
from skygcs.cli.options import Json, with_groups
from skygcs.cli.render import LiveView, duration, plural, print_json, print_lines, say, screen_width, table, wrapped
from skygcs.errors import CompanionError, RefusedError
from skygcs.ext.companions.bring_up import service_control
from skygcs.ext.companions.bring_up.host_keys import HostKeys, fingerprint
from skygcs.ext.companions.bring_up.inventory import FLEET_VARIABLE, Companion, Inventory, load_inventory
from skygcs.ext.companions.bring_up.probe import MIN_FREE_BYTES, CompanionFacts, probe
from skygcs.ext.companions.bring_up.side_by_side import AT_ONCE, Progress, Work, side_by_side
from skygcs.ext.companions.bring_up.ssh_session import Session, connected, presented_key, quoted, require_asyncssh

if TYPE_CHECKING:
    from rich.console import RenderableType

companions = typer.Typer(
    help="The computers on the vehicles, over SSH: install, start, stop, logs, any command.", no_args_is_help=True
)

STATUS_TIMEOUT_S = 60.0
INSTALL_TIMEOUT_S = 1800.0
"""50 MB over a Wi-Fi of 1 Mbit/s for each, and a minute of pip on a slow board."""

SERVICE_TIMEOUT_S = 90.0
"""systemd gives a unit 90 s to start."""

RUN_TIMEOUT_S = 3600.0
TICK_S = 0.25

_TARGETS = "Companions: a name, a vehicle's name or system id, 1,3, 2-5, a group, all"

SomeCompanions = Annotated[str, typer.Argument(metavar="TARGETS", help=f"{_TARGETS}.", show_default=False)]
AllCompanions = Annotated[str, typer.Argument(metavar="TARGETS", help=f"{_TARGETS}.")]
Force = Annotated[bool, typer.Option("--force", help="Although a vehicle is armed or in the air.")]


@dataclass(frozen=True, slots=True)
class Ssh:
    """Options of all commands that connect."""

    fleet: Annotated[Path, typer.Option("--fleet", metavar="FILE", help="The fleet file.", envvar=FLEET_VARIABLE)] = (
        Path("fleet.toml")
    )
    identity: Annotated[
        Path | None, typer.Option("--identity", metavar="FILE", help="SSH private key, besides agent and usual keys.")
    ] = None
    at_once: Annotated[
        int, typer.Option("--at-once", metavar="N", min=1, max=64, help="How many at the same time.")
    ] = AT_ONCE
    timeout_s: Annotated[
        float | None, typer.Option("--timeout", metavar="S", min=0.1, max=86400, help="For each companion.")
    ] = None


@dataclass(frozen=True, slots=True)
class Connector:
    """Connects to companions of an inventory."""

    inventory: Inventory
    host_keys: HostKeys
    identity: Path | None

    @property
    def folder(self) -> Path:
        """The folder of the fleet file."""
        return self.inventory.path.absolute().parent

    @contextlib.asynccontextmanager
    async def open(self, companion: Companion, progress: Progress) -> AsyncIterator[tuple[Session, CompanionFacts]]:
        """Connect and find out what is there."""
        async with connected(companion, self.host_keys, self.identity) as session:
            progress.step = "looking"
            yield session, await probe(session)


def connector(ssh: Ssh, inventory: Inventory | None = None) -> Connector:
    """From the options. ``inventory``: the fleet file as it is read already. Raises ConfigError, SkygcsError."""
    if inventory is None:
        inventory = load_inventory(ssh.fleet)
    require_asyncssh()
    return Connector(inventory, HostKeys(ssh.fleet.absolute().parent), ssh.identity)


async def watched(
    chosen: Sequence[Companion], work: Work[Companion], ssh: Ssh, timeout_s: float, *, live: bool
) -> dict[str, Progress]:
    """`side_by_side`, shown while it runs: a table on a terminal, otherwise nothing."""
    # how progress is shown
    loop = asyncio.get_running_loop()
    rows = {companion.name: Progress(companion.name) for companion in chosen}

    def draw(_columns: int) -> RenderableType:
        now = loop.time()
        return table(
            ["companion", "", "time"],
            [
                [row.name, row.step if row.ok is None else _mark(row), duration(row.elapsed_s(now))]
                for row in rows.values()
            ],
            right=["time"],
        )

    async def tick(view: LiveView) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            view.refresh()

    def changed(progress: Progress) -> None:
        rows[progress.name] = progress

    # work side by side while the view is redrawn
    with LiveView(draw, enabled=live and sys.stdout.isatty()) as view:
        ticker = asyncio.create_task(tick(view), name="companions view")
        try:
            limit_s = timeout_s if ssh.timeout_s is None else ssh.timeout_s
            return await side_by_side(chosen, work, at_once=ssh.at_once, timeout_s=limit_s, on_change=changed)
        finally:
            ticker.cancel()


def _mark(row: Progress) -> str:
    return "done" if row.ok else "FAILED"


def run_on(
    targets: str, ssh: Ssh, timeout_s: float, json_output: bool, work: Callable[[Connector], Work[Companion]]
) -> None:
    """Run the work on the chosen companions, print one outcome each, and exit 0 if all succeeded."""

    def command() -> int:
        connect = connector(ssh)
        chosen = connect.inventory.chosen(targets)
        done = asyncio.run(watched(chosen, work(connect), ssh, timeout_s, live=not json_output))
        return print_outcomes({name: progress.outcome() for name, progress in done.items()}, json_output)

    run_offline(command)


# --- state ------------------------------------------------------------------------------------------------------------


@companions.command("status")
@with_groups
def status(ssh: Ssh, targets: AllCompanions = "all", json_output: Json = False) -> None:
    """Show version, service, free disk and uptime of each; exit 0 if all are reached and their services run.

    Example: skygcs-cli companions status
    """

    def work(connect: Connector) -> Work[Companion]:
        async def look(companion: Companion, progress: Progress) -> str:
            async with connect.open(companion, progress) as (_, facts):
                progress.data = {"facts": facts.as_dict()}
                problems = status_problems(facts)
                if problems:
                    raise CompanionError("status", ", ".join(problems))
                return status_line(facts)

        return look

    run_on(targets, ssh, STATUS_TIMEOUT_S, json_output, work)


def status_line(facts: CompanionFacts) -> str:
    """CompanionFacts about a companion that is well, for a person."""
    free = "" if facts.free_bytes is None else f", {facts.free_bytes / 1e9:.1f} GB free"
    up = "" if facts.uptime_s is None else f", up {duration(facts.uptime_s)}"
    return f"skygcs {facts.version}, {facts.state}, {facts.machine}, Python {facts.python}{free}{up}"


def status_problems(facts: CompanionFacts) -> list[str]:
    """Problems that keep a companion from being of use."""
    if not facts.program:
        return ["skygcs is not installed there (skygcs-cli companions install)"]
    problems = []
    if facts.unit == "none":
        problems.append(f"skygcs {facts.version} has no service (skygcs-cli companions install)")
    elif facts.state != "active":
        problems.append(
            f"skygcs {facts.version}: its service is {facts.state or 'not known'} (skygcs-cli companions start)"
        )
    if facts.free_bytes is not None and facts.free_bytes < MIN_FREE_BYTES:
        problems.append(f"only {facts.free_bytes / 1e6:.0f} MB of disk free")
    return problems


@companions.command("trust")
@with_groups
def trust(
    ssh: Ssh,
    targets: SomeCompanions,
    expected: Annotated[
        str | None,
        typer.Option("--fingerprint", metavar="SHA256:…", help="Of one companion: store it if this is it."),
    ] = None,
) -> None:
    """Show the SSH host key of each companion; after a yes, or with its fingerprint, store it beside the fleet file.

    Example: skygcs-cli companions trust all
    """

    def command() -> int:
        connect = connector(ssh)
        chosen = connect.inventory.chosen(targets)
        if expected is not None and len(chosen) != 1:
            raise RefusedError(f"{targets} names {len(chosen)} companions: --fingerprint is that of one")
        failed = 0
        for companion in chosen:
            try:
                _trust(connect.host_keys, companion, expected)
            except (CompanionError, RefusedError) as error:
                fail(f"{companion.name}: {error}")
                failed += 1
        return Exit.FAILED if failed else Exit.DONE

    run_offline(command)


def _trust(host_keys: HostKeys, companion: Companion, expected: str | None) -> None:
    key = asyncio.run(presented_key(companion))
    assert companion.host is not None
    known = host_keys.known(companion.host, "", companion.port)
    print_lines([f"{companion.name} ({companion.place}) shows {fingerprint(key)}"])
    if key in known.revoked:
        raise CompanionError("host key", "it is marked as revoked", "do not connect")
    if key in known.keys:
        print_lines([f"which is known ({known.source})"])
        return
    for old in known.keys:
        print_lines([f"CHANGED: {known.source} has {fingerprint(old)}"])
    if not _agreed(key.get_fingerprint(), expected):
        raise RefusedError("nothing was stored")
    host_keys.trust(companion.host, companion.port, key)
    print_lines([f"stored in {host_keys.path}"])


def _agreed(shown: str, expected: str | None) -> bool:
    if expected is not None:
        if expected.strip() != shown:
            raise RefusedError(f"the host key's fingerprint is not {expected} (--fingerprint): nothing was stored")
        return True
    if not sys.stdin.isatty():
        raise RefusedError("nothing was stored: there is no terminal to ask at; --fingerprint SHA256:… stores it")
    return typer.confirm("Is this the fingerprint that the companion itself shows?")


# --- services ---------------------------------------------------------------------------------------------------------


def _service_work(
    action: Callable[[Session, CompanionFacts], Any], doing: str
) -> Callable[[Connector], Work[Companion]]:
    def work(connect: Connector) -> Work[Companion]:
        async def act(companion: Companion, progress: Progress) -> str:
            async with connect.open(companion, progress) as (session, facts):
                progress.step = doing
                return str(await action(session, facts))

        return act

    return work


@companions.command("start")
@with_groups
def start(ssh: Ssh, targets: SomeCompanions, json_output: Json = False) -> None:
    """Start the services, and wait until each reports that it is ready.

    Example: skygcs-cli companions start alpha
    """
    run_on(targets, ssh, SERVICE_TIMEOUT_S, json_output, _service_work(service_control.start, "starting"))


@companions.command("stop")
@with_groups
def stop(ssh: Ssh, targets: SomeCompanions, force: Force = False, json_output: Json = False) -> None:
    """Stop the services; refused where a vehicle is armed or in the air.

    Example: skygcs-cli companions stop alpha
    """

    async def action(session: Session, facts: CompanionFacts) -> str:
        return await service_control.stop(session, facts, force=force)

    run_on(targets, ssh, SERVICE_TIMEOUT_S, json_output, _service_work(action, "stopping"))


@companions.command("restart")
@with_groups
def restart(ssh: Ssh, targets: SomeCompanions, force: Force = False, json_output: Json = False) -> None:
    """Restart the services; refused where a vehicle is armed or in the air.

    Example: skygcs-cli companions restart all
    """

    async def action(session: Session, facts: CompanionFacts) -> str:
        return await service_control.restart(session, facts, force=force)

    run_on(targets, ssh, SERVICE_TIMEOUT_S, json_output, _service_work(action, "restarting"))


# --- installation ----------------------------------------------------------------------------------------------------


@companions.command("bundle")
def bundle(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The bundle.", show_default=False)],
    arch: Annotated[
        str | None, typer.Option("--arch", metavar="ARCH", help="aarch64, armv7l or x86_64; default: the fleet file's.")
    ] = None,
    python: Annotated[str, typer.Option("--python", metavar="X.Y", help="Python of the companions.")] = "3.11",
    wheel: Annotated[
        Path | None, typer.Option("--wheel", metavar="FILE", help="Wheel of skygcs itself; default: built or fetched.")
    ] = None,
    wheels: Annotated[
        list[Path] | None,
        typer.Option("--wheels", metavar="DIR", help="A folder with further wheels; may be repeated."),
    ] = None,
    index_url: Annotated[
        list[str] | None, typer.Option("--index-url", metavar="URL", help="A further package index; may be repeated.")
    ] = None,
    offline: Annotated[bool, typer.Option("--offline", help="Only wheels of --wheels.")] = False,
    fleet: Annotated[Path, typer.Option("--fleet", metavar="FILE", envvar=FLEET_VARIABLE)] = Path("fleet.toml"),
) -> None:
    """Collect all wheels that companions need into one file, for `companions install` without a network there.

    Example: skygcs-cli companions bundle --arch aarch64 -o bundle.tar
    """
    from skygcs.ext.companions.bring_up.bundle import ARCHITECTURES, PYTHONS, Sources, collect

    if arch is not None and arch not in ARCHITECTURES:
        raise typer.BadParameter(f"--arch {arch} is unknown; known are {', '.join(ARCHITECTURES)}")
    if python not in PYTHONS:
        raise typer.BadParameter(f"--python {python} is unknown; known are {', '.join(PYTHONS)}")

    def command() -> int:
        made = collect(
            output,
            arch or _only_arch(load_inventory(fleet)),
            python,
            Sources(wheel, tuple(wheels or ()), tuple(index_url or ()), offline),
        )
        print_lines(
            [f"{output}: skygcs {made.version} for {made.arch}, Python {made.python}, {made.bytes / 1e6:.0f} MB"]
        )
        return Exit.DONE

    run_offline(command)


def _only_arch(inventory: Inventory) -> str:
    known = sorted({companion.arch for companion in inventory.companions if companion.arch})
    if len(known) != 1:
        said = "none is given" if not known else f"there are {', '.join(known)}: one bundle each"
        raise RefusedError(f"--arch is needed: in the companions' `arch` of {inventory.path} {said}")
    return known[0]


ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="For all; default: companions/NAME.toml, companion.toml."),
]


@companions.command("install")
@with_groups
def install(
    ssh: Ssh,
    targets: SomeCompanions,
    bundle_file: Annotated[
        Path, typer.Option("--bundle", metavar="FILE", help="Of `companions bundle`.", show_default=False)
    ],
    config: ConfigFile = None,
    user_service: Annotated[
        bool, typer.Option("--user-service", help="A service of the user there, not of the machine.")
    ] = False,
    repin: Annotated[
        bool, typer.Option("--repin", help="Replace a certificate that is pinned: the companion was set up anew.")
    ] = False,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Install skygcs from a bundle: upload, packages, configuration, keys of both sides, service. It is not started.

    Steps that were done before are skipped, so it can be repeated at any time.

    Example: skygcs-cli companions install all --bundle bundle.tar
    """

    def make(connect: Connector) -> Work[Companion]:
        from skygcs.ext.companions.bring_up.bundle import read_bundle
        from skygcs.ext.companions.bring_up.companion_file import companion_file
        from skygcs.ext.companions.bring_up.installation import InstallationWishes
        from skygcs.ext.companions.bring_up.installation import install as install_on

        checked = read_bundle(bundle_file)
        wishes = InstallationWishes(user_service, force, repin)

        async def work(companion: Companion, progress: Progress) -> str:
            file = companion_file(companion, connect.folder, config)
            async with connected(companion, connect.host_keys, connect.identity) as session:
                return await install_on(session, companion, progress, checked, file, connect.inventory.key_dir, wishes)

        return work

    run_on(targets, ssh, INSTALL_TIMEOUT_S, json_output, make)


@companions.command("push")
@with_groups
def push(
    ssh: Ssh, targets: SomeCompanions, config: ConfigFile = None, force: Force = False, json_output: Json = False
) -> None:
    """Send their configuration files; services that run are restarted with it if it has changed.

    Example: skygcs-cli companions push all
    """

    def make(connect: Connector) -> Work[Companion]:
        from skygcs.ext.companions.bring_up.companion_file import companion_file
        from skygcs.ext.companions.bring_up.installation import push_config

        async def work(companion: Companion, progress: Progress) -> str:
            file = companion_file(companion, connect.folder, config)
            async with connect.open(companion, progress) as (session, facts):
                if not facts.program:
                    raise CompanionError("push", "skygcs is not installed there", "skygcs-cli companions install")
                if facts.state == "active" and not force:
                    await service_control.require_at_rest(session, facts)
                progress.step = "pushing"
                if not await push_config(session, facts, file, facts.program):
                    return "unchanged"
                if facts.state != "active":
                    return f"pushed; its service is {facts.state or 'not known'}"
                return "pushed, " + await service_control.restart(session, facts, force=force)

        return work

    run_on(targets, ssh, SERVICE_TIMEOUT_S, json_output, make)


# --- what they print --------------------------------------------------------------------------------------------------


@companions.command("logs")
@with_groups
def logs(
    ssh: Ssh,
    targets: AllCompanions = "all",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Print new lines, too, until Ctrl-C.")] = False,
    lines: Annotated[int, typer.Option("--lines", "-n", metavar="N", min=0, max=100000, help="How many of each.")] = 20,
) -> None:
    """Print the newest lines of the services' logs, each with its companion's name.

    Example: skygcs-cli companions logs alpha --follow
    """

    async def command_of(session: Session) -> str:
        return service_control.log_command(await probe(session), lines, follow=follow)

    _printed(targets, ssh, command_of, follow=follow, json_output=False)


class _CommandAfterDashes(TyperCommand):
    """Keeps what stands after "--" as it is."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if "--" in args:
            at = args.index("--")
            ctx.meta["words"] = args[at + 1 :]
            args = args[:at]
        return super().parse_args(ctx, args)


@companions.command("run", cls=_CommandAfterDashes)
@with_groups
def run_command(ctx: typer.Context, ssh: Ssh, targets: AllCompanions = "all", json_output: Json = False) -> None:
    """Run a command on each: `companions run 2-5 -- df -h /`; every line has its companion's name.

    One word is a line for the shell there: `companions run all -- 'cd skygcs && ls | wc -l'`.

    Example: skygcs-cli companions run 2-5 -- df -h /
    """
    words = ctx.meta.get("words") or []
    if not words:
        raise typer.BadParameter("no command: companions run [TARGETS] -- CMD …")
    command = words[0] if len(words) == 1 else quoted(*words)

    async def command_of(_: Session) -> str:
        return command

    _printed(targets, ssh, command_of, follow=False, json_output=json_output)


def _printed(targets: str, ssh: Ssh, command_of: Callable[[Session], Any], *, follow: bool, json_output: bool) -> None:
    """Run a command on each and print its lines as they come; exit 1 if any failed."""

    def command() -> int:
        connect = connector(ssh)
        chosen = connect.inventory.chosen(targets)
        width = max(len(companion.name) for companion in chosen)
        at_once = len(chosen) if follow else ssh.at_once

        # run the command on one companion
        async def work(companion: Companion, progress: Progress) -> str:
            kept: list[list[str]] = []

            def on_line(kind: str, line: str) -> None:
                if json_output:
                    kept.append([kind, line])
                    del kept[:-MAX_JSON_LINES]
                else:
                    say(f"{companion.name:<{width}}  {line}", err=kind == "err")

            async with connected(companion, connect.host_keys, connect.identity) as session:
                progress.step = "running"
                code = await session.follow(await command_of(session), on_line)
            progress.data = {"exit_code": code, "lines": kept} if json_output else {"exit_code": code}
            if code != 0:
                raise CompanionError("run", "was ended by a signal" if code is None else f"exit code {code}")
            return "done"

        # run it on all, and report
        timeout_s = ssh.timeout_s or (86400.0 if follow else RUN_TIMEOUT_S)
        done = asyncio.run(side_by_side(chosen, work, at_once=at_once, timeout_s=timeout_s))
        return _report(done, json_output)

    run_offline(command)


MAX_JSON_LINES = 10_000
"""Newest lines kept of each companion: they are held until all have ended."""


def _report(done: dict[str, Progress], json_output: bool) -> Exit:
    """The failures, one line each; with --json everything."""
    failed = [progress for progress in done.values() if not progress.ok]
    if json_output:
        print_json({"outcomes": {name: progress.outcome() for name, progress in done.items()}})
    else:
        _print_errors(f"FAIL {progress.name}  {progress.message}" for progress in failed)
        if failed:
            _print_errors([f"{plural(len(failed), 'companion')} of {len(done)} failed"])
    return Exit.FAILED if failed else Exit.DONE


def _print_errors(lines: Iterable[str]) -> None:
    for line in lines:
        say(wrapped(line, screen_width(sys.stderr), indent=5), err=True)


def add_to(app: typer.Typer) -> None:
    app.add_typer(companions, name="companions")
