"""`skygcs sitl`: real autopilot firmware as simulators. Starts the user's binaries, reports when they are ready, and
stops them.

Each instance has a folder of its own (parameters, mission, console.log), a process group of its own, and a life that
ends with this process, however this process ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import fcntl
import os
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from skygcs.child_process import start_process
from skygcs.cli.process import EXIT_FAILED, EXIT_OK, run_loop
from skygcs.config.dialects import load_dialect
from skygcs.config.files import read_named
from skygcs.config.firmware import PROGRAMS, ArduPilot, Px4, find_ardupilot, find_px4
from skygcs.core.geo import NOWHERE, is_nowhere
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.params.param_file import parse
from skygcs.ending_signals import ending_signals
from skygcs.errors import ConfigError, LinkError
from skygcs.sim.sitl import (
    KINDS,
    Autopilot,
    Home,
    Instance,
    Kind,
    Launch,
    Ports,
    Readiness,
    ardupilot_launch,
    fleet_text,
    homes,
    last_lines,
    px4_launch,
    refused_params,
)
from skygcs.terminal_text import visible

DIALECT = "ardupilotmega"
LOOPBACK = "127.0.0.1"
AUTOPILOT_COMPID = 1

MOST_INSTANCES = 32
"""A PX4 takes 14 % of a core, an ArduCopter 5 %; what starts more does so by mistake."""

PX4_NUMBERS = 200
"""Instance numbers that are tried. PX4 has one lock for each on the whole machine."""

STOP_S = 5.0
"""From SIGTERM to SIGKILL; both firmwares end within one second."""

SLOW_START_S = 90.0
"""Then what is missing is reported once. ArduCopter's estimator takes 40 s, PX4's 5 s."""

MAX_SOURCES = 4 * MOST_INSTANCES
"""Addresses listened to; further ones are not read."""

LOG_TAIL_BYTES = 65536
PR_SET_PDEATHSIG = 1
"""linux/prctl.h."""


@dataclass(frozen=True, slots=True)
class SitlOptions:
    """Options of the command line; see `skygcs sitl --help`."""

    counts: Mapping[Kind, int]
    """How many of each kind."""
    first_sysid: int
    home: Home
    spacing_m: float
    port: int = 0
    second_port: int = 0
    params: Sequence[str] = ()
    param_files: Sequence[Path] = ()
    folder: Path | None = None
    speedup: float = 1.0


def run_sitl(options: SitlOptions) -> int:
    """Run until one of `ending_signals`; 1 if an instance died. Raises ConfigError or LinkError with a line to show."""
    count = sum(options.counts.values())
    if not 1 <= count <= MOST_INSTANCES:
        words = ", ".join(f"--{kind.replace('_', '-')}" for kind in KINDS)
        raise LinkError(f"{words}: {count} vehicles; 1 to {MOST_INSTANCES} can be started")
    if not (options.first_sysid >= 1 and options.first_sysid + count - 1 <= 250):
        raise LinkError(f"--first-sysid {options.first_sysid}: {count} vehicles need system ids from 1 to 250")
    if not 0.1 <= options.speedup <= 20:
        raise LinkError(f"--speedup {options.speedup:g}: must be 0.1 to 20")
    wanted = [kind for kind in KINDS if options.counts.get(kind)]
    px4 = find_px4() if any(KINDS[kind].autopilot == "px4" for kind in wanted) else None
    programs = {kind: find_ardupilot(kind) for kind in wanted if kind in PROGRAMS}
    params = _params(options)
    try:
        places = homes(options.home, count, options.spacing_m)
    except ValueError as error:
        raise LinkError(str(error)) from None
    return run_loop(_Sitl(options, px4, programs, places, params).serve())


def parse_home(text: str) -> Home:
    """LAT,LON,AMSL[,HEADING]. Raises LinkError."""
    try:
        numbers = [float(part) for part in text.split(",")]
        home = Home(*numbers)
    except (ValueError, TypeError):
        raise LinkError(f"--home {text!r}: write LAT,LON,AMSL or LAT,LON,AMSL,HEADING") from None
    if not (abs(home.lat_deg) < 90 and abs(home.lon_deg) <= 180 and -500 <= home.alt_amsl_m < 9000):
        raise LinkError(f"--home {text!r}: not a place on Earth (degrees, degrees, metres)")
    if is_nowhere(home.lat_deg, home.lon_deg):
        raise LinkError(f"--home {text!r}: {NOWHERE}")
    return home


def _params(options: SitlOptions) -> dict[Autopilot, dict[str, str]]:
    """Name and value as text for each firmware. A value without a firmware's name before it goes to both."""
    found: dict[Autopilot, dict[str, str]] = {"px4": {}, "ardupilot": {}}
    for path in options.param_files:
        for family, values in _params_of_file(path).items():
            found[family].update(values)
    for text in options.params:
        name, equals, value = text.partition("=")
        before, colon, after = name.rpartition(":")
        families: tuple[Autopilot, ...] = ("px4", "ardupilot")
        if colon:
            families = tuple(family for family in families if family == before)
        number = value.strip()
        with contextlib.suppress(ValueError):
            float(number)
            if equals and families and after.isidentifier() and after.isascii():
                for family in families:
                    found[family][after.upper()] = number
                continue
        raise LinkError(f"--param {text!r}: write NAME=VALUE, px4:NAME=VALUE or ardupilot:NAME=VALUE")
    return found


def _params_of_file(path: Path) -> dict[Autopilot, dict[str, str]]:
    """A .params file with types is PX4's or ArduPilot's as its header says, a plain one is ArduPilot's."""
    try:
        file = parse(read_named(path).decode("utf-8-sig"), str(path))
    except OSError as error:
        raise ConfigError(str(path), [error.strerror or str(error)]) from None
    except UnicodeDecodeError:
        raise ConfigError(str(path), ["is not text in UTF-8"]) from None
    own = {"SYSID_THISMAV", "MAV_SYSID", "MAV_SYS_ID", "SYS_AUTOSTART"}
    values = {entry.name: str(entry.value) for entry in file.entries if entry.name not in own}
    stack = file.about.get("Stack", "PX4" if file.kind == "qgc" else "ArduPilot")
    family: Autopilot = "px4" if stack.upper().startswith("PX4") else "ardupilot"
    return {family: values}


@dataclass(slots=True)
class _Process:
    """One running firmware."""

    instance: Instance
    folder: Path
    launch: Launch
    started: float
    readiness: Readiness
    child: asyncio.subprocess.Process | None = None
    died: bool = False
    announced: bool = False
    locks: list[IO[bytes]] = field(default_factory=list)

    @property
    def log(self) -> Path:
        return self.folder / "console.log"

    def log_text(self) -> str:
        try:
            with self.log.open("rb") as file:
                file.seek(max(0, self.log.stat().st_size - LOG_TAIL_BYTES))
                return file.read().decode("utf-8", "replace")
        except OSError:
            return ""


class _Listener(asyncio.DatagramProtocol):
    """Listener to what the vehicles say on the launcher's link. Nothing is ever sent there."""

    def __init__(self, dialect: Dialect, on_message: Any) -> None:
        self._dialect = dialect
        self._on_message = on_message
        self._parsers: dict[Any, FrameParser] = {}

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        parser = self._parsers.get(addr)
        if parser is None:
            if len(self._parsers) >= MAX_SOURCES:
                return
            parser = self._parsers[addr] = FrameParser(self._dialect)
        for frame in parser.feed(data):
            if frame.compid == AUTOPILOT_COMPID and frame.info is not None:
                self._on_message(frame.sysid, frame.name, frame.fields())


class _Sitl:
    """The instances of one command."""

    def __init__(
        self,
        options: SitlOptions,
        px4: Px4 | None,
        programs: Mapping[Kind, ArduPilot],
        places: Sequence[Home],
        params: dict[Autopilot, dict[str, str]],
    ) -> None:
        self._options = options
        self._px4 = px4
        self._programs = programs
        self._places = places
        self._params = params
        self._temporary = options.folder is None
        self._folder = Path()
        self._processes: dict[int, _Process] = {}
        self._stop = asyncio.Event()
        self._stopping = False
        self._watching: list[asyncio.Task[None]] = []

    async def serve(self) -> int:
        loop = asyncio.get_running_loop()
        for number in ending_signals():
            loop.add_signal_handler(number, self._stop.set)
        try:
            listener, _ = await loop.create_datagram_endpoint(
                lambda: _Listener(load_dialect(DIALECT), self._on_message), local_addr=(LOOPBACK, 0)
            )
        except OSError as error:
            raise LinkError(f"udp {LOOPBACK}: {error.strerror or error}") from None
        listen_port = int(listener.get_extra_info("sockname")[1])
        try:
            self._folder = self._make_folder()
            gcs_port = self._options.port or _free_port()
            self._prepare(Ports(gcs_port, listen_port, self._options.second_port))
            fleet = self._write_fleet(gcs_port)
            for process in self._processes.values():
                await self._start(process)
            print(f"skygcs run {fleet}", flush=True)
            slow = loop.call_later(SLOW_START_S, self._report_missing)
            await self._stop.wait()
            slow.cancel()
        finally:
            await self._end()
            listener.close()
        failed = any(process.died for process in self._processes.values())
        self._clean_up(keep=failed)
        return EXIT_FAILED if failed else EXIT_OK

    # -- before the start

    def _make_folder(self) -> Path:
        try:
            if self._options.folder is None:
                return Path(tempfile.mkdtemp(prefix="skygcs-sitl-"))
            self._options.folder.mkdir(parents=True, exist_ok=True)
            return self._options.folder.resolve()
        except OSError as error:
            raise LinkError(f"--folder {self._options.folder}: {error.strerror or error}") from None

    def _prepare(self, ports: Ports) -> None:
        options = self._options
        kinds = [kind for kind in KINDS for _ in range(options.counts.get(kind, 0))]
        for index, (kind, home) in enumerate(zip(kinds, self._places, strict=True)):
            family = KINDS[kind].autopilot
            locks: list[IO[bytes]] = []
            number = _px4_number(locks) if family == "px4" else index
            sysid, own = options.first_sysid + index, (_free_port(), _free_port(), _free_port())
            instance = Instance(kind, sysid, number, home, *own, self._params[family])
            folder = self._folder / instance.name
            launch = self._launch(instance, folder, ports)
            try:
                folder.mkdir(exist_ok=True)
                for name, text in launch.files.items():
                    path = folder / name
                    path.parent.mkdir(exist_ok=True)
                    path.write_text(text, encoding="utf-8")
            except OSError as error:
                raise LinkError(f"{folder}: {error.strerror or error}") from None
            self._processes[instance.sysid] = _Process(
                instance, folder, launch, time.monotonic(), Readiness(family), locks=locks
            )

    def _launch(self, instance: Instance, folder: Path, ports: Ports) -> Launch:
        speedup = self._options.speedup
        if instance.autopilot == "px4":
            assert self._px4 is not None
            return px4_launch(
                instance,
                binary=str(self._px4.binary),
                etc=str(self._px4.etc),
                folder=str(folder),
                ports=ports,
                speedup=speedup,
            )
        program = self._programs[instance.kind]
        return ardupilot_launch(
            instance,
            binary=str(program.binary),
            defaults=str(program.defaults),
            folder=str(folder),
            ports=ports,
            rc_port=_free_port(),
            speedup=speedup,
        )

    def _write_fleet(self, gcs_port: int) -> Path:
        path = self._folder / "fleet.toml"
        try:
            instances = [p.instance for p in self._processes.values()]
            path.write_text(fleet_text(instances, port=gcs_port, second_port=self._options.second_port), "utf-8")
        except OSError as error:
            raise LinkError(f"{path}: {error.strerror or error}") from None
        return path

    # -- running

    async def _start(self, process: _Process) -> None:
        instance, launch = process.instance, process.launch
        environment = {**os.environ, **launch.environment}
        if "PATH" in launch.environment:
            environment["PATH"] = f"{launch.environment['PATH']}:{os.environ.get('PATH', os.defpath)}"
        process.started = time.monotonic()
        try:
            with process.log.open("ab") as log:
                process.child = await start_process(
                    *launch.argv,
                    cwd=process.folder,
                    env=environment,
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    preexec_fn=_die_with_parent,
                )
        except OSError as error:
            raise LinkError(f"{launch.argv[0]}: {error.strerror or error}") from None
        self._watching.append(asyncio.create_task(self._watch(process), name=f"sitl {instance.name}"))
        print(
            f"{instance.name}: {KINDS[instance.kind].firmware}, system id {instance.sysid}, pid {process.child.pid}, "
            f"at {instance.home.lat_deg:.7f},{instance.home.lon_deg:.7f},{instance.home.alt_amsl_m:g}, "
            f"in {process.folder}",
            flush=True,
        )

    async def _watch(self, process: _Process) -> None:
        """Report the end of an instance that nobody ordered."""
        assert process.child is not None
        code = await process.child.wait()
        if self._stopping:
            return
        process.died = True
        how = f"ended by signal {-code}" if code < 0 else f"exited with {code}"
        print(f"skygcs: {process.instance.name} {how}; the end of {process.log}:", file=sys.stderr)
        for line in last_lines(process.log_text()):
            print(f"  {visible(line, lines=True)}", file=sys.stderr)
        sys.stderr.flush()
        if all(p.died for p in self._processes.values()):
            self._stop.set()

    def _on_message(self, sysid: int, name: str, fields: dict[str, Any]) -> None:
        process = self._processes.get(sysid)
        if process is None or process.announced:
            return
        process.readiness.on_message(name, fields)
        if not process.readiness.ready:
            return
        process.announced = True
        print(f"{process.instance.name} is ready ({time.monotonic() - process.started:.1f} s)", flush=True)
        unknown = refused_params(process.log_text(), process.instance.params)
        if unknown:
            text = f"{process.instance.name} has no parameter {', '.join(unknown)}"
            print(f"skygcs: {text}", file=sys.stderr, flush=True)
        if all(p.announced for p in self._processes.values()):
            print("all are ready", flush=True)

    def _report_missing(self) -> None:
        for process in self._processes.values():
            if not process.announced and not process.died:
                missing = ", ".join(process.readiness.missing)
                text = (
                    f"{process.instance.name} is not ready after {SLOW_START_S:g} s: no {missing} yet ({process.log})"
                )
                print(f"skygcs: {text}", file=sys.stderr, flush=True)

    # -- the end

    async def _end(self) -> None:
        """SIGTERM, and SIGKILL to what is still there after `STOP_S`: to each whole process group."""
        self._stopping = True
        for number in (signal.SIGTERM, signal.SIGKILL):
            alive = [p for p in self._processes.values() if p.child is not None and p.child.returncode is None]
            for process in alive:
                assert process.child is not None
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.child.pid, number)
            if self._watching:
                await asyncio.wait(self._watching, timeout=STOP_S)
        for process in self._processes.values():
            for lock in process.locks:
                lock.close()

    def _clean_up(self, *, keep: bool) -> None:
        """Remove a temporary folder, but not what the daemon recorded there and not the traces of a death."""
        if not self._temporary:
            return
        if keep:
            print(f"kept: {self._folder}", flush=True)
            return
        for process in self._processes.values():
            shutil.rmtree(process.folder, ignore_errors=True)
        (self._folder / "fleet.toml").unlink(missing_ok=True)
        try:
            self._folder.rmdir()
        except OSError:
            print(f"kept: {self._folder} (recordings)", flush=True)


def _free_port() -> int:
    """A UDP port of loopback that was free a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def _px4_number(locks: list[IO[bytes]]) -> int:
    """An instance number that no PX4 on this machine has (it keeps a lock on /tmp/px4_lock-N), reserved until the file
    that is added to ``locks`` is closed. Raises LinkError."""
    for number in range(PX4_NUMBERS):
        try:
            # closed by `_Sitl._end`
            reserved = open(f"{tempfile.gettempdir()}/skygcs-sitl-px4-{number}.lock", "wb")  # noqa: SIM115
        except OSError:
            continue  # another user's
        try:
            fcntl.flock(reserved, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not _px4_runs(number):
                locks.append(reserved)
                return number
        except OSError:
            pass
        reserved.close()
    raise LinkError(f"PX4 has no free instance number below {PX4_NUMBERS} on this machine")


def _px4_runs(number: int) -> bool:
    """True if a PX4 holds the lock of this instance number."""
    try:
        with open(f"/tmp/px4_lock-{number}", "r+b") as lock:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return False
    except FileNotFoundError:
        return False
    except OSError:
        return True  # locked, or another user's


def _die_with_parent() -> None:
    """In the child before exec: it is killed when its parent ends without having stopped it (Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
