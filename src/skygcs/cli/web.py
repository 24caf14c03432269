"""`skygcs web`: the web page as a process of its own, and `skygcs web link`: a further address of it."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.cli.process import EXIT_OK, configure_logging, run_loop
from skygcs.errors import SkygcsError
from skygcs.rpc.address import client_address

if TYPE_CHECKING:
    from skygcs.web.web_process import WebOptions


def add_web(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The parser of `skygcs web`."""
    web = commands.add_parser(
        "web", help="serve the web page of a running daemon", description="Serve the ground station as a web page."
    )
    web.add_argument(
        "action", nargs="?", choices=("serve", "link"), default="serve", help="link: print a further address"
    )
    web.add_argument("--socket", help="the daemon's socket, or tcp://HOST:PORT, instead of the default one")
    web.add_argument("--port", type=int, help="of the page (default 8750; 0: a free one)")
    web.add_argument("--view", action="store_true", help="with link: an address for looking only")
    web.add_argument("--no-open", action="store_true", help="print the address and open no browser")
    web.add_argument("--host", default="127.0.0.1", help="serve on this address of the machine; needs TLS")
    web.add_argument(
        "--name", action="append", default=[], metavar="NAME", help="with --host: a name that browsers use"
    )
    web.add_argument("--tls-cert", type=Path, metavar="FILE")
    web.add_argument("--tls-key", type=Path, metavar="FILE")
    web.add_argument("--map", type=Path, metavar="IMAGE", help="an image beneath the fleet view, with two --map-point")
    web.add_argument("--map-point", action="append", default=[], metavar="X,Y,LAT,LON", help="pixel and place of it")
    web.add_argument("--replay", type=Path, metavar="FILE", help="play a tlog instead; nothing can be ordered then")
    web.add_argument("--no-token", action="store_true", help=argparse.SUPPRESS)
    web.add_argument("-v", "--verbose", action="store_true", help="log more")
    web.set_defaults(run=_web)


def _web(args: argparse.Namespace) -> int:
    return _link(args) if args.action == "link" else _serve(args)


def _link(args: argparse.Namespace) -> int:
    from skygcs.web.control_socket import ask_for_link, find_control

    path = find_control(client_address(args.socket), args.port)
    print(ask_for_link(path, "view" if args.view else "command"))
    return EXIT_OK


def _serve(args: argparse.Namespace) -> int:
    configure_logging(verbose=args.verbose)
    try:
        from skygcs.web.web_process import serve_web
    except ModuleNotFoundError as error:
        raise SkygcsError(f"skygcs web needs the package {error.name}: pip install 'skygcs[web]'") from None
    options = _options(args)

    async def serve() -> int:
        await serve_web(options)
        return EXIT_OK

    return run_loop(serve())


def _options(args: argparse.Namespace) -> WebOptions:
    from skygcs.web.map_image import parse_points, read_map
    from skygcs.web.web_process import DEFAULT_PORT, WebOptions

    return WebOptions(
        socket=client_address(args.socket),
        host=args.host,
        port=DEFAULT_PORT if args.port is None else args.port,
        names=tuple(args.name),
        tls_cert=args.tls_cert,
        tls_key=args.tls_key,
        map_image=None if args.map is None else read_map(args.map, parse_points(args.map_point)),
        replay=args.replay,
        print_address=not args.no_token,
        open_browser=not args.no_open and not args.no_token and can_open_browser(),
    )


def can_open_browser() -> bool:
    """True on a terminal with a display."""
    return os.isatty(1) and bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
