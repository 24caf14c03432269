"""`skygcs companion identity|pin|show`: the keys by which a ground station and its companions know each other."""

from __future__ import annotations

import argparse
from pathlib import Path

from skygcs.cli.process import EXIT_OK
from skygcs.errors import SkygcsError

DEFAULT_DIR = Path("keys")


def add_to_program(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The parser of `skygcs companion`."""
    companion = commands.add_parser(
        "companion",
        help="keys of a vehicle's computer and its ground station: identity, pin, show",
        description="Make and exchange the keys by which a ground station gives orders to a vehicle's computer.",
        epilog="Example: skygcs companion identity ground",
    )
    actions = companion.add_subparsers(title="actions", required=True, metavar="ACTION")

    identity = actions.add_parser(
        "identity",
        help="make this computer's key and certificate, once; print its fingerprint",
        epilog="Example: skygcs companion identity ground",
    )
    identity.add_argument("side", choices=("companion", "ground"), help="which of the two this computer is")
    identity.set_defaults(run=_identity)

    pin = actions.add_parser(
        "pin",
        help="store the other side's certificate, the only one that is trusted",
        epilog="Example: skygcs companion pin companion.crt alpha",
    )
    pin.add_argument("file", type=Path, metavar="FILE", help="ground.crt or companion.crt of the other computer")
    pin.add_argument("name", nargs="?", metavar="NAME", help="on the ground: the companion's name in the fleet file")
    pin.add_argument("--force", action="store_true", help="replace another certificate that is pinned")
    pin.set_defaults(run=_pin)

    show = actions.add_parser(
        "show", help="print the fingerprints of all certificates here", epilog="Example: skygcs companion show"
    )
    show.set_defaults(run=_show)

    for action in (identity, pin, show):
        action.add_argument(
            "--dir", type=Path, default=DEFAULT_DIR, help="the folder of key_dir in the fleet file (default: keys)"
        )


def _identity(args: argparse.Namespace) -> int:
    from skygcs.ext.companions.identity import make_identity

    shown, made = make_identity(args.dir, args.side)
    certificate = args.dir / f"{args.side}.crt"
    print(f"{certificate} {'made' if made else 'is there already'}")
    print(f"SHA-256 {shown}")
    if args.side == "companion":
        print(f"next: copy {certificate} to the ground, and there: skygcs companion pin companion.crt NAME")
    else:
        print(f"next: copy {certificate} to each companion, and there: skygcs companion pin ground.crt")
    return EXIT_OK


def _pin(args: argparse.Namespace) -> int:
    from skygcs.ext.companions.identity import pin

    if args.name is not None and (not args.name.isascii() or not args.name.replace("-", "").replace("_", "").isalnum()):
        raise SkygcsError(f"{args.name!r} is not a companion's name: letters, digits, - and _ only")
    target = args.dir / "ground.crt" if args.name is None else args.dir / "companions" / f"{args.name}.crt"
    ours = (args.dir / "ground.key").exists()
    if args.name is None and ours:
        raise SkygcsError(f"{args.dir} holds the ground's key: name the companion, skygcs companion pin FILE NAME")
    shown = pin(args.file, target, force=args.force)
    print(f"{target} pinned")
    print(f"SHA-256 {shown}: compare it with what the other side prints")
    return EXIT_OK


def _show(args: argparse.Namespace) -> int:
    from skygcs.ext.companions.tls import fingerprint

    found = sorted([*args.dir.glob("*.crt"), *args.dir.glob("companions/*.crt")])
    if not found:
        raise SkygcsError(f"no certificate in {args.dir}; skygcs companion identity makes one")
    for path in found:
        print(f"{path.relative_to(args.dir)}  SHA-256 {fingerprint(path)}")
    return EXIT_OK
