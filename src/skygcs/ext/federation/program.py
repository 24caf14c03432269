"""`skygcs federation run|up|keys|hub-config|stores`: a station's bridge to the hub, and the hub itself."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.cli.process import EXIT_OK, configure_logging, run_loop
from skygcs.ending_signals import ending_signals
from skygcs.errors import ConfigError, SkygcsError
from skygcs.rpc.address import client_address, client_token

if TYPE_CHECKING:
    from skygcs.ext.federation.bridge.hub_process import HubProcess
    from skygcs.ext.federation.hub_inventory import HubInventory

INVENTORY = "hub.toml"

ROLES = ("site", "operator", "observer", "keeper")


def add_to_program(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The parser of `skygcs federation`."""
    federation = commands.add_parser(
        "federation",
        help="join several stations over a hub: run, up, keys, hub-config, stores",
        description="Join several stations over a hub (nats-server); see docs/howto/federation.md.",
        epilog="Example: skygcs federation run fleet.toml",
    )
    actions = federation.add_subparsers(title="actions", required=True, metavar="ACTION")

    run = actions.add_parser(
        "run",
        help="connect this station to the hub; `skygcs run` does it for its fleet file",
        epilog="Example: skygcs federation run fleet.toml",
    )
    run.add_argument("file", type=Path, metavar="FLEET.toml", help="with a table [federation]")
    run.add_argument("--socket", help="the daemon's socket instead of the file's or the default one")
    run.add_argument("--no-daemon", action="store_true", help="for role observer or operator: this station has none")
    run.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)  # by a daemon
    run.add_argument("-v", "--verbose", action="store_true", help="log more")
    run.set_defaults(run=_run)

    up = actions.add_parser(
        "up",
        help="run a nats-server as the hub, for try-outs; Ctrl-C ends it",
        epilog="Example: skygcs federation up hub",
    )
    up.add_argument("folder", type=Path, nargs="?", default=Path(), metavar="DIR", help=f"with {INVENTORY}")
    up.set_defaults(run=_up)

    keys = actions.add_parser(
        "keys",
        help="make a station's key; print what the hub's inventory needs",
        epilog="Example: skygcs federation keys north",
    )
    keys.add_argument("name", metavar="NAME", help="of the station; for a site, the site's name")
    keys.add_argument("--role", choices=ROLES, default="site", help="default: site")
    keys.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="for NAME.nk (default: this folder)")
    keys.set_defaults(run=_keys)

    config = actions.add_parser(
        "hub-config",
        help="check an inventory and print the nats-server's configuration",
        epilog="Example: skygcs federation hub-config hub.toml --check",
    )
    config.add_argument("file", type=Path, metavar="INVENTORY")
    config.add_argument("-o", "--output", type=Path, metavar="FILE", help="write it there")
    config.add_argument("--check", action="store_true", help="have nats-server itself check it, too")
    config.set_defaults(run=_hub_config)

    stores = actions.add_parser(
        "stores",
        help="make the stores of a hub that runs, once; needs the keeper's key",
        epilog="Example: skygcs federation stores hub.toml --nkey keeper.nk",
    )
    stores.add_argument("file", type=Path, metavar="INVENTORY")
    stores.add_argument("--nkey", type=Path, required=True, metavar="FILE", help="seed of the user with role keeper")
    stores.set_defaults(run=_stores)


def need_nats() -> None:
    """Raises SkygcsError where the extra is not installed."""
    try:
        import nats  # noqa: F401
        import nkeys  # noqa: F401
    except ModuleNotFoundError as error:
        text = f"skygcs federation needs the package {error.name}: pip install 'skygcs[federation]'"
        raise SkygcsError(text) from None


def _run(args: argparse.Namespace) -> int:
    from skygcs.config.loader import load_fleet
    from skygcs.ext.federation.config import FederationConfig

    configure_logging(verbose=args.verbose)
    fleet = load_fleet(args.file)
    table = fleet.extensions.get("federation")
    if not isinstance(table, FederationConfig):
        raise ConfigError(str(args.file), ["has no table [federation]: see docs/howto/federation.md"])
    if args.no_daemon and table.role == "site":
        raise SkygcsError('--no-daemon is for role "observer" or "operator": a site publishes what its daemon knows')
    need_nats()
    from skygcs.ext.federation.bridge.process import FederationOptions, serve_federation

    options = FederationOptions(
        daemon_address=client_address(args.socket or fleet.daemon.socket),
        daemon_token=client_token(),
        with_daemon=not args.no_daemon,
        supervised=args.supervised,
    )

    async def serve() -> int:
        await serve_federation(fleet, options)
        return EXIT_OK

    return run_loop(serve())


def _keys(args: argparse.Namespace) -> int:
    need_nats()
    from skygcs.ext.federation.bridge.nkeys_files import write_new_seed
    from skygcs.ext.federation.hub_inventory import inventory_of

    placeholder = "U" + "A" * 55
    inventory_of({"users": {args.name: {"role": args.role, "nkey": placeholder}}}, f"station {args.name}")
    path = args.out / f"{args.name}.nk"
    public_key = write_new_seed(path)
    print(f"{path} is the secret key: it stays on the station's computer (federation.nkey), mode 0600", file=sys.stderr)
    print("for the hub's inventory:", file=sys.stderr)
    print(f'[users.{args.name}]\nrole = "{args.role}"\nnkey = "{public_key}"')
    return EXIT_OK


def _hub_config(args: argparse.Namespace) -> int:
    from skygcs.config.files import write_whole
    from skygcs.ext.federation.bridge.hub_config import hub_config

    text = hub_config(_inventory(args.file, make=False))
    if args.check:
        _check(text)
    if args.output is None:
        print(text, end="")
        return EXIT_OK
    try:
        write_whole(args.output, text.encode(), 0o644)  # it holds public keys and paths only
    except OSError as error:
        raise SkygcsError(f"{args.output} cannot be written: {error.strerror}") from None
    return EXIT_OK


def _inventory(path: Path, *, make: bool) -> HubInventory:
    """With public keys only."""
    from skygcs.ext.federation.hub_inventory import load_inventory

    inventory = load_inventory(path)
    if any(user.nkey_file is not None for user in inventory.users.values()):
        need_nats()
        from skygcs.ext.federation.bridge.hub_process import with_public_keys

        inventory = with_public_keys(inventory, make=make)
    return inventory


def _check(text: str) -> None:
    """Raises SkygcsError with what nats-server finds wrong; warns of its version."""
    import subprocess

    from skygcs.ext.federation.server_program import find_server

    program = find_server()
    _warn_of_version(program)
    with tempfile.NamedTemporaryFile("w", suffix=".conf", prefix="skygcs-hub-") as file:
        file.write(text)
        file.flush()
        done = subprocess.run([program, "--config", file.name, "-t"], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SkygcsError(f"nats-server refuses the configuration: {(done.stderr or done.stdout).strip()}")


def _warn_of_version(program: str) -> None:
    from skygcs.ext.federation.server_program import server_version, version_warning

    if (warning := version_warning(server_version(program))) is not None:
        print(f"warning: {warning}", file=sys.stderr)


def _up(args: argparse.Namespace) -> int:
    need_nats()
    from skygcs.ext.federation.bridge.hub_process import HubProcess
    from skygcs.ext.federation.server_program import find_server

    path = args.folder / INVENTORY
    if not path.exists():
        text = "does not exist; configs/federation has one for a try-out (skygcs init federation)"
        raise ConfigError(str(path), [text])
    program = find_server()
    _warn_of_version(program)
    inventory = _inventory(path, make=True)
    with tempfile.TemporaryDirectory(prefix="skygcs-hub-") as folder:
        hub = HubProcess(inventory, Path(folder))
        try:
            return run_loop(_serve_hub(hub))
        finally:
            hub.stop()


async def _serve_hub(hub: HubProcess) -> int:
    """Run the hub until one of `ending_signals`. Raises SkygcsError if it ends by itself."""
    from skygcs.ext.federation.bridge.hub_process import make_stores, own_tls

    loop = asyncio.get_running_loop()
    stopping = asyncio.Event()
    for number in ending_signals():
        loop.add_signal_handler(number, stopping.set)
    hub.start()
    await asyncio.to_thread(hub.wait)
    inventory = hub.inventory
    await make_stores(inventory.local_url, hub.keeper, own_tls(inventory))
    stations = ", ".join(name for name, user in inventory.users.items() if user.role != "keeper")
    print(f"the hub is up at {inventory.local_url}, store {inventory.store}; stations: {stations}", flush=True)
    while not stopping.is_set():
        process = hub.process
        if process is None or process.poll() is not None:
            raise SkygcsError(f"nats-server has ended: {hub.last_lines()}")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                await stopping.wait()
    return EXIT_OK


def _stores(args: argparse.Namespace) -> int:
    need_nats()
    from skygcs.ext.federation.bridge.hub_process import make_stores, own_tls
    from skygcs.ext.federation.bridge.nkeys_files import read_seed
    from skygcs.ext.federation.hub_inventory import load_inventory

    inventory = load_inventory(args.file)
    asyncio.run(make_stores(inventory.local_url, read_seed(args.nkey), own_tls(inventory)))
    print("the hub has its stores")
    return EXIT_OK
