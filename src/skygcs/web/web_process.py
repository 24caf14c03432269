"""`skygcs web`: composition of the web process, its life and its signals."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import secrets
import socket
import ssl
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from skygcs import __version__
from skygcs.cancellation import ended
from skygcs.config.allow_list import allow_list, check_address
from skygcs.config.dialects import load_dialect
from skygcs.config.extension_tables import installed_points
from skygcs.config.files import boot_id, boot_s
from skygcs.config.models import FleetConfig
from skygcs.config.web import DEFAULT_WEB_PORT, LOOPBACK
from skygcs.ending_signals import ending_signals
from skygcs.errors import LinkError, RpcError, SkygcsError
from skygcs.rpc.error_codes import INVALID_PARAMS
from skygcs.spelling import is_number
from skygcs.web.check_process import CheckRunner
from skygcs.web.control_socket import ControlSocket, control_path
from skygcs.web.daemon_connection import DaemonConnection
from skygcs.web.file_checks import CHECKS, EXTENSION_CHECKS, extension_checks
from skygcs.web.fleet_digest import view_of
from skygcs.web.http_server import HttpServer
from skygcs.web.map_image import MapImage
from skygcs.web.map_tiles import MapTiles
from skygcs.web.page_clients import (
    DEFAULT_RATE_HZ,
    LEAST_RATE_HZ,
    MAX_RATE_HZ,
    OwnMethod,
    PageClient,
    PageClients,
)
from skygcs.web.replay_source import ReplaySource
from skygcs.web.request_limits import DEADLINE_MAX_S, MAX_MESSAGE_BYTES
from skygcs.web.roles import ENDS_FLIGHT, NOT_PASSED_ON, READ
from skygcs.web.sign_in import Role, SignIn
from skygcs.web.state_batches import LatestStates
from skygcs.web.tile_set import TileFileError

SECRET_BYTES = 32

SAVE_COOKIES_S = 3600.0
"""When each browser was used last is saved so often, and whenever one signs in or out."""

REPLAY_COOKIE = "skygcs_replay"
"""Cookie of all replays that a daemon starts, one after the other and each on another port. With a cookie for each, a
browser would send more of them to the station's page than a request may hold."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class WebOptions:
    """How the process was asked to run."""

    socket: str
    """Address of the daemon."""
    token: str | None = None
    """Token of a daemon on TCP."""
    host: str = "127.0.0.1"
    port: int = DEFAULT_WEB_PORT
    """0: a free one."""
    names: tuple[str, ...] = ()
    tls_cert: Path | None = None
    tls_key: Path | None = None
    map_image: MapImage | None = None
    tiles: Path | None = None
    """A file of map tiles. A supervised process serves the page without those that cannot be used."""
    replay: Path | None = None
    """A recording in place of the daemon."""
    print_address: bool = True
    open_browser: bool = False
    supervised: bool = False
    """Started by a daemon: it ends when its standard input ends."""


class WebProcess:
    """Everything of the process. `run` until `stop`."""

    def __init__(self, options: WebOptions) -> None:
        check_address(options.host, options.names, tls=options.tls_cert is not None)
        self.options = options
        self.loop = asyncio.get_running_loop()
        self.states = LatestStates()
        cookie = REPLAY_COOKIE if options.supervised and options.replay is not None else None
        self.sign_in = SignIn(lambda: secrets.token_urlsafe(SECRET_BYTES), cookie)
        self.source: DaemonConnection | ReplaySource
        if options.replay is None:
            self.source = DaemonConnection(options.socket, options.token, self.states)
        else:
            self.source = ReplaySource(options.replay, load_dialect(FleetConfig().dialect), self.states)
        self.checks = CheckRunner()
        self.pages = PageClients(self.states, self.source, self._own_methods())
        self.port = 0
        self.tiles: MapTiles | None = None
        self.tiles_problem = ""
        self._stopping = asyncio.Event()
        self._cookies: Path | None = None
        """The file that keeps who is signed in over a restart."""

    # -- methods of its own

    def _own_methods(self) -> dict[str, OwnMethod]:
        methods: dict[str, OwnMethod] = {
            "web.hello": self._hello,
            "web.subscribe": self._subscribe,
            "web.view": self._show,
            "web.ping": self._ping,
        }
        if isinstance(self.source, ReplaySource):
            methods |= self.source.own_methods()
        for problem in installed_points(EXTENSION_CHECKS).problems:
            _log.warning("installed checks of files", problem=problem)
        return methods | {name: self._check(name) for name in (*CHECKS, *extension_checks())}

    def _check(self, name: str) -> OwnMethod:
        async def run(page: PageClient, params: dict[str, Any]) -> Any:
            return await self.checks.run(name, params, page.role)

        return run

    async def _hello(self, page: PageClient, _: dict[str, Any]) -> dict[str, Any]:
        image = self.options.map_image
        return {
            "role": page.role,
            "version": __version__,
            "fleet": self.source.info.get("fleet_file"),
            "replay": isinstance(self.source, ReplaySource),
            "now_s": round(self.loop.time(), 4),
            "seq": 0 if page.page_states is None else page.page_states.seq,
            "daemon": self.pages.daemon_status(),
            "map": None if image is None else image.as_dict(),
            "tiles": None if self.tiles is None else self.tiles.as_dict(),
            "tiles_problem": self.tiles_problem,
            "methods": {
                "read": sorted(READ),
                "ends_flight": sorted(ENDS_FLIGHT),
                "refused": sorted(NOT_PASSED_ON),
            },
            "limits": {"message_bytes": MAX_MESSAGE_BYTES, "deadline_s": DEADLINE_MAX_S},
            "operator_timeout_s": self.source.info.get("operator_timeout_s"),
        }

    async def _subscribe(self, page: PageClient, params: dict[str, Any]) -> dict[str, Any]:
        rate_hz = params.get("rate_hz", DEFAULT_RATE_HZ)
        if not is_number(rate_hz) or not LEAST_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
            raise RpcError(INVALID_PARAMS, f"rate_hz must be a number from {LEAST_RATE_HZ:g} to {MAX_RATE_HZ:g}")
        return {"seq": page.subscribe(float(rate_hz))}

    async def _show(self, page: PageClient, params: dict[str, Any]) -> None:
        page.show(view_of(params))

    async def _ping(self, _: PageClient, __: dict[str, Any]) -> dict[str, Any]:
        return {"now_s": round(self.loop.time(), 4)}

    # -- life

    def link(self, role: Role, own_user: bool = False) -> str:
        """A further address with its token. ``own_user``: to be opened in a browser of this user."""
        return f"{self.base}/?token={self.sign_in.issue(role, boot_s(), own_user=own_user)}"

    @property
    def base(self) -> str:
        scheme = "http" if self.options.tls_cert is None else "https"
        host = self.options.host if self.options.host in LOOPBACK else (*self.options.names, self.options.host)[0]
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}"

    async def run(self, on_ready: Callable[[WebProcess], None] | None = None) -> None:
        """Serve until `stop`. Raises SkygcsError before it serves."""
        options = self.options
        await self._open_tiles()
        # the port and who is signed in, before anything is served
        tls = _tls(options.tls_cert, options.tls_key)
        sock = _bound(options.host, options.port)
        self.port = sock.getsockname()[1]
        self._restore_cookies()
        http = HttpServer(
            self.pages,
            self.sign_in,
            allow_list(options.host, self.port, options.names, tls=tls is not None),
            clock=boot_s,
            on_sign_in=self._save_cookies,
            map_image=options.map_image,
            map_tiles=self.tiles,
        )

        def sign_out() -> int:
            count = self.sign_in.sign_out()
            self.pages.close_pages()
            self._save_cookies()
            return count

        # the control socket first: a second process of the same port ends there
        control = ControlSocket(control_path(_local_base(options.socket), self.port), self.link, sign_out)
        feeding = saving = None
        try:
            await control.start()
            await http.start(sock, tls)
            feeding = asyncio.create_task(self.source.run(self.pages), name="source of states")
            saving = asyncio.create_task(self._save_cookies_often(), name="saving of cookies")
            if on_ready is not None:
                on_ready(self)
            # until somebody stops it, or the source of states fails
            stopping = asyncio.create_task(self._stopping.wait(), name="stop")
            await asyncio.wait({stopping, feeding}, return_when=asyncio.FIRST_COMPLETED)
            stopping.cancel()
            if feeding.done():
                feeding.result()
        finally:
            if saving is not None:
                saving.cancel()
            if feeding is not None:
                self.source.stopping = True
                await ended(feeding)
            await self.pages.close()
            await http.close()
            await control.close()
            if self.tiles is not None:
                self.tiles.close()
            self._save_cookies()
            sock.close()

    def _restore_cookies(self) -> None:
        if self.options.port:  # a free port is another one next time
            self._cookies = Path(f"{control_path(_local_base(self.options.socket), self.port)}.cookies")
            self.sign_in.restore(*_read_cookies(self._cookies))

    def _save_cookies(self) -> None:
        if self._cookies is not None:
            _write_cookies(self._cookies, self.sign_in.saved(boot_s()))

    async def _save_cookies_often(self) -> None:
        """After a crash a browser that was used all the time must not count as unused since it signed in."""
        while True:
            await asyncio.sleep(SAVE_COOKIES_S)
            self._save_cookies()

    async def _open_tiles(self) -> None:
        """Open the map's tiles, if there are some. Raises TileFileError where a person started the process by hand."""
        path = self.options.tiles
        if path is None:
            return
        try:
            self.tiles = await MapTiles.opened(path)
        except TileFileError as error:
            # a page without its map is worth more than none
            if not self.options.supervised:
                raise
            self.tiles_problem = str(error)
            _log.error("the page has no map", reason=str(error))

    def stop(self) -> None:
        """End `run`. Idempotent; safe as a signal handler of the loop."""
        self._stopping.set()


async def serve_web(options: WebOptions) -> None:
    """Run the process until one of `ending_signals`."""
    web = WebProcess(options)
    loop = asyncio.get_running_loop()
    for number in ending_signals():
        loop.add_signal_handler(number, web.stop)

    if options.supervised:
        loop.add_reader(sys.stdin, _on_input, loop, web)

    def announce(web: WebProcess) -> None:
        # the modules' objects stay until the end: a full collection would visit them for 25 ms, before a page's stop
        gc.collect()
        gc.freeze()
        if options.print_address:
            print(web.link("command"), flush=True)
        else:
            _log.info("web page is up; skygcs web link prints an address", page=f"{web.base}/")
        if options.open_browser:
            import webbrowser

            loop.run_in_executor(None, webbrowser.open, web.link("command", own_user=True))

    await web.run(announce)


def _on_input(loop: asyncio.AbstractEventLoop, web: WebProcess) -> None:
    """Standard input is closed when the daemon ends, also when it is killed: stop."""
    if not os.read(sys.stdin.fileno(), 4096):
        loop.remove_reader(sys.stdin)
        web.stop()


def _local_base(address: str) -> str:
    """The path that the control socket's path is made from: the daemon's socket, or a file for a daemon on TCP."""
    from skygcs.rpc.address import default_socket_path

    return str(default_socket_path()) if "://" in address else address


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise LinkError(
            f"web page on {host} port {port}: {error.strerror or error}; choose another with --port"
        ) from None
    sock.setblocking(False)
    return sock


def _tls(cert: Path | None, key: Path | None) -> ssl.SSLContext | None:
    if cert is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(cert, key)
    except (OSError, ssl.SSLError) as error:
        raise SkygcsError(f"web.tls_cert {cert}: {error}") from None
    return context


def _read_cookies(path: Path) -> tuple[dict[str, Any], float, float]:
    """Return what an earlier process on this port saved, the time now, and how long ago it was saved; {} if nothing was
    saved or other users could have written it."""
    now, nothing = boot_s(), dict[str, Any]()
    try:
        stat = path.stat(follow_symlinks=False)
        if stat.st_uid != os.geteuid() or stat.st_mode & 0o077 or stat.st_size > 1 << 20:
            return nothing, now, 0.0
        saved = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return nothing, now, 0.0
    match saved:
        case {"boot_id": boot, "saved_at_s": saved_at_s, "browsers": dict(browsers)} if is_number(saved_at_s):
            if boot and boot == boot_id():
                return browsers, now, now - saved_at_s
            # only here the wall clock counts: two starts of the computer have no other one in common
            return browsers, now, time.time() - stat.st_mtime
        case _:
            return nothing, now, 0.0


def _write_cookies(path: Path, browsers: dict[str, Any]) -> None:
    """Whole or not at all, 0600. Without a disk for it, browsers sign in again after a restart."""
    temporary = path.with_name(path.name + ".new")
    try:
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        with open(handle, "w") as file:
            json.dump({"boot_id": boot_id(), "saved_at_s": boot_s(), "browsers": browsers}, file)
        temporary.replace(path)
    except OSError as error:
        if path.parent.exists():  # else the folder of the socket is gone, as after a demo: no process will look here
            _log.warning("browsers will have to sign in again after a restart", reason=str(error))
