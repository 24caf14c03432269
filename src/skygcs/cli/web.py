"""`skygcs web`: the web page as a process of its own, a further address of it (`link`), and `sign-out`."""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import time
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.cli.process import EXIT_OK, configure_logging, run_loop
from skygcs.config.web import DEFAULT_WEB_PORT
from skygcs.errors import SkygcsError
from skygcs.rpc.address import client_address, client_token

if TYPE_CHECKING:
    from skygcs.web.web_process import WebOptions

LINK_WITHIN_S = 15.0
"""A process of Python with aiohttp is up in one second on a quick computer, in five on a slow one."""

NICE = 5
"""A page that is started beside a daemon leaves it the processor when both want it."""


def port_number(text: str) -> int:
    """The value of an option that is a port; 0: a free one. Raises ArgumentTypeError."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"'{text}' is not a port: a number from 0 to 65535")
    return int(text)


def add_web(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The parser of `skygcs web`."""
    web = commands.add_parser(
        "web",
        help="serve the web page of a running daemon",
        description="Serve the ground station as a web page.",
        epilog="Example: skygcs web link --view",
    )
    web.add_argument(
        "action",
        nargs="?",
        choices=("serve", "link", "sign-out"),
        default="serve",
        help="link: print a further address; sign-out: forget all browsers, as when a phone is lost",
    )
    web.add_argument("--socket", help="the daemon's socket, or tcp://HOST:PORT, instead of the default one")
    web.add_argument("--port", type=port_number, help="of the page (default 8750; 0: a free one)")
    web.add_argument("--view", action="store_true", help="with link: an address for looking only")
    web.add_argument("--no-open", action="store_true", help="print the address and open no browser")
    web.add_argument("--host", default="127.0.0.1", help="serve on this address of the machine; needs TLS")
    web.add_argument(
        "--name", action="append", default=[], metavar="NAME", help="with --host: a name that browsers use"
    )
    web.add_argument("--tls-cert", type=Path, metavar="FILE", help="certificate, PEM; with --host")
    web.add_argument("--tls-key", type=Path, metavar="FILE", help="its private key, PEM")
    web.add_argument("--map", type=Path, metavar="IMAGE", help="an image beneath the fleet view, with two --map-point")
    web.add_argument("--map-point", action="append", default=[], metavar="X,Y,LAT,LON", help="pixel and place of it")
    web.add_argument(
        "--tiles", type=Path, metavar="FILE", help="map tiles beneath the fleet view: .mbtiles or .pmtiles"
    )
    web.add_argument("--replay", type=Path, metavar="FILE", help="play a tlog instead; nothing can be ordered then")
    web.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)  # by a daemon
    web.add_argument("-v", "--verbose", action="store_true", help="log more")
    web.set_defaults(run=_web)


def _web(args: argparse.Namespace) -> int:
    return {"serve": _serve, "link": _link, "sign-out": _sign_out}[args.action](args)


def _link(args: argparse.Namespace) -> int:
    from skygcs.web.control_socket import ask_for_link, find_control

    path = find_control(client_address(args.socket), args.port)
    print(ask_for_link(path, "view" if args.view else "command"))
    return EXIT_OK


def _sign_out(args: argparse.Namespace) -> int:
    from skygcs.web.control_socket import ask_to_sign_out, find_control

    count = ask_to_sign_out(find_control(client_address(args.socket), args.port))
    print(f"{count} browser{'' if count == 1 else 's'} signed out; skygcs web link prints a new address")
    return EXIT_OK


def _serve(args: argparse.Namespace) -> int:
    configure_logging(verbose=args.verbose, quiet=args.supervised)  # a daemon logs its start itself
    if args.supervised:
        os.nice(NICE)
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
    from skygcs.web.web_process import WebOptions

    return WebOptions(
        socket=client_address(args.socket),
        token=client_token(),
        host=args.host,
        port=DEFAULT_WEB_PORT if args.port is None else args.port,
        names=tuple(args.name),
        tls_cert=args.tls_cert,
        tls_key=args.tls_key,
        map_image=None if args.map is None else read_map(args.map, parse_points(args.map_point)),
        tiles=args.tiles,
        replay=args.replay,
        supervised=args.supervised,
        print_address=not args.supervised,
        open_browser=not args.no_open and not args.supervised and can_open_browser(),
    )


def can_open_browser() -> bool:
    """True on a terminal with a display."""
    return os.isatty(1) and bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def wait_for_link(rpc_socket: str, port: int, *, own_user: bool = False) -> str:
    """An address of a web process that is starting. Blocking; raises SkygcsError if it does not answer in time.
    ``own_user``: to be opened in a browser of this user."""
    from skygcs.web.control_socket import ask_for_link, find_control

    deadline = time.monotonic() + LINK_WITHIN_S
    while True:
        try:
            return ask_for_link(find_control(rpc_socket, port), "command", own_user=own_user)
        except SkygcsError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def unused_port() -> int:
    """The usual port, or a free one while it is taken."""
    for port in (DEFAULT_WEB_PORT, 0):
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", port))
            return int(probe.getsockname()[1])
    return DEFAULT_WEB_PORT
