"""`skygcs`: the daemon, the demo, simulated vehicles, real firmware as simulators, and checks of fleet files.

It uses argparse and late imports: a daemon that restarts in flight must forward its first frame within half a second;
typer and rich would take a third of that.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs import __version__
from skygcs.cli.process import (
    EXIT_FAILED,
    EXIT_OK,
    configure_logging,
    run_loop,
    serve_until_signal,
    without_collections,
)
from skygcs.cli.topics import OF_SKYGCS, extension_programs, of_skygcs, of_skygcs_cli
from skygcs.cli.web import add_web, port_number
from skygcs.errors import SkygcsError
from skygcs.spelling import near_names
from skygcs.terminal_text import visible

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig

HOME = "43.7806,-79.4653,180"
"""Where simulated vehicles stand unless `--home` says otherwise: latitude, longitude, metres above sea level."""

OUTPUT_LOST = frozenset({errno.EPIPE, errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Errors of stdout: a pipe without a reader, a terminal that is gone, a file on a disk that takes no more."""


def main(argv: list[str] | None = None) -> None:
    """Entry point of `skygcs`. Exits 0 done, 1 failed (one line on stderr says why), 2 usage."""
    args = _arguments(sys.argv[1:] if argv is None else argv)
    try:
        code = args.run(args)
        print(end="", flush=True)
    except SkygcsError as error:
        print(f"skygcs: {visible(str(error), lines=True)}", file=sys.stderr)
        code = EXIT_FAILED
    except KeyboardInterrupt:
        code = EXIT_OK
    except OSError as error:
        if error.errno not in OUTPUT_LOST or sys.stdout is None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            print(f"skygcs: {visible(str(error))}", file=sys.stderr)
        code = EXIT_FAILED
    sys.exit(code)


def _arguments(argv: list[str]) -> argparse.Namespace:
    """Parse the line, with a parser that does not stay beside the daemon (0.1 MB). Exits 2 if the line is wrong."""
    first = argv[:1]
    parser = new_parser(whole=not first or first[0] not in OF_SKYGCS)
    if first and not first[0].startswith("-") and not of_skygcs(first[0]):
        if of_skygcs_cli(first[0]):
            parser.error(f"{first[0]} is a command of the other program: skygcs-cli {first[0]}")
        near = near_names(first[0], (*OF_SKYGCS, *extension_programs()), n=1)
        parser.error(
            f"no such command {first[0]!r}; " + (f"did you mean {near[0]!r}?" if near else "see skygcs --help")
        )
    return parser.parse_args(argv)


def new_parser(*, whole: bool = True) -> argparse.ArgumentParser:
    """The parser of all commands; not ``whole``: of those of the core, without a look for extensions (5 to 20 ms)."""
    parser = argparse.ArgumentParser(
        prog="skygcs",
        description="Ground-control daemon for fleets of MAVLink vehicles. skygcs-cli sends commands to it.",
        epilog="Example: skygcs init sim && skygcs run fleet.toml",
    )
    parser.add_argument("--version", action="version", version=f"skygcs {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_fleet_files(commands)
    _add_beside_daemon(commands)
    _add_demo(commands)
    _add_sim(commands)
    _add_sitl(commands)
    add_web(commands)
    if whole:
        for module in extension_programs().values():
            importlib.import_module(module).add_to_program(commands)
    return parser


def _add_fleet_files(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The commands about fleet files: run, init, check, import-router."""
    run = commands.add_parser("run", help="run the daemon with a fleet file", epilog="Example: skygcs run fleet.toml")
    run.add_argument("file", type=Path, metavar="FLEET.toml", help="skygcs init writes one to begin with")
    run.add_argument("--socket", type=Path, help="JSON-RPC socket instead of the file's or the default one")
    run.add_argument("--log-dir", type=Path, help="where tlogs go instead of the file's daemon.log_dir")
    run.add_argument("-v", "--verbose", action="store_true", help="log routes, commands and status texts too")
    run.add_argument("-q", "--quiet", action="store_true", help="log warnings and errors only")
    run.set_defaults(run=_run)

    init = commands.add_parser(
        "init", help="write a commented fleet file to begin with", epilog="Example: skygcs init field-radio lab"
    )
    init.add_argument("scenario", nargs="?", metavar="SCENARIO", help="without one: list them")
    init.add_argument("folder", nargs="?", type=Path, default=Path(), metavar="DIR", help="default: this folder")
    init.add_argument("--force", action="store_true", help="overwrite a fleet.toml that is there")
    init.set_defaults(run=_init)

    check = commands.add_parser(
        "check",
        help="check a fleet file and print everything that is wrong with it",
        epilog="Example: skygcs check fleet.toml",
    )
    check.add_argument("file", type=Path, metavar="FLEET.toml")
    check.set_defaults(run=_check)

    router = commands.add_parser(
        "import-router",
        help="convert a mavlink-router configuration into a fleet file",
        epilog="Example: skygcs import-router main.conf -o fleet.toml",
    )
    router.add_argument("file", type=Path, metavar="MAIN.conf")
    router.add_argument("-o", "--output", type=Path, metavar="FLEET.toml", help="default: standard output")
    router.add_argument("--force", action="store_true", help="overwrite the output")
    router.set_defaults(run=_import_router)


def _add_beside_daemon(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The commands about what belongs to a daemon on its machine: metrics, service, completion."""
    metrics = commands.add_parser(
        "metrics",
        help="print the Grafana dashboard or the alert rules for Prometheus",
        epilog="Example: skygcs metrics rules",
    )
    metrics.add_argument("what", choices=("dashboard", "rules"))
    metrics.set_defaults(run=_metrics)

    service = commands.add_parser(
        "service",
        help="run the daemon under systemd: install, status, uninstall",
        epilog="Example: skygcs service install fleet.toml --user",
    )
    service.add_argument("what", choices=("install", "status", "uninstall"))
    service.add_argument("file", type=Path, nargs="?", metavar="FLEET.toml", help="install: the fleet file to run")
    service.add_argument("--user", action="store_true", help="a service of your own, instead of the machine's")
    service.add_argument("--force", action="store_true", help="install: overwrite a unit that differs")
    service.set_defaults(run=_service)

    completion = commands.add_parser(
        "completion",
        help='print a shell\'s completion: eval "$(skygcs completion bash)"',
        epilog="Example: skygcs completion bash",
    )
    completion.add_argument("shell", nargs="?", choices=("bash", "zsh", "fish"))
    completion.set_defaults(run=_completion)


def _add_demo(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    demo = commands.add_parser(
        "demo", help="fly three simulated vehicles; needs no hardware and no file", epilog="Example: skygcs demo --stay"
    )
    demo.add_argument(
        "--stay", action="store_true", help="keep daemon and vehicles running for skygcs-cli; Ctrl-C ends it"
    )
    demo.add_argument("--socket", type=Path, help="JSON-RPC socket instead of the default one")
    demo.add_argument("--log-dir", type=Path, default=Path("logs"), help="where the tlog goes (default: logs)")
    demo.set_defaults(run=_demo)


def _add_sim(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    sim = commands.add_parser(
        "sim", help="run simulated vehicles as a separate process", epilog="Example: skygcs sim --px4 2 --ardupilot 1"
    )
    sim.add_argument("--px4", type=int, default=1, metavar="N", help="number of PX4 quadrotors (default 1)")
    sim.add_argument("--ardupilot", type=int, default=1, metavar="N", help="number of ArduCopters (default 1)")
    sim.add_argument("--px4-plane", type=int, default=0, metavar="N", help="number of PX4 planes (default 0)")
    sim.add_argument("--ardupilot-plane", type=int, default=0, metavar="N", help="number of ArduPlanes (default 0)")
    sim.add_argument("--rover", type=int, default=0, metavar="N", help="number of ArduPilot rovers (default 0)")
    sim.add_argument("--first-sysid", type=int, default=1, metavar="ID", help="ids from this one on (default 1)")
    # how the vehicles are reached
    where = sim.add_mutually_exclusive_group()
    where.add_argument("--udp", metavar="HOST:PORT", help="send to this address (default 127.0.0.1:14550)")
    where.add_argument("--tcp", metavar="HOST:PORT", help="listen there; every connection receives all vehicles")
    where.add_argument("--pty", metavar="PATH", help="a pseudo-terminal, like a radio with all vehicles behind it")
    sim.add_argument(
        "--radio",
        metavar="KBPS[,KEY=VALUE…]",
        help="with --pty: emulated multipoint radios of this air speed; loss=0.02, burst_loss, nodes, baud, rtscts",
    )
    sim.add_argument(
        "--xbee",
        metavar="KBPS[,KEY=VALUE…]",
        help="with --pty: XBee modules with this rate on air; loss=0.02, hops=1:2:3, payload_bytes, baud, api_mode",
    )
    sim.add_argument("--separate-ports", action="store_true", help="with --udp: one socket per vehicle")
    # where they are, and how they fly
    sim.add_argument("--home", default=HOME, metavar="LAT,LON,AMSL", help=f"their position (default {HOME})")
    sim.add_argument("--seed", type=int, default=1, help="of noise and losses (default 1)")
    sim.add_argument("--speedup", type=float, default=1.0, help="simulated seconds per second, at most 100")
    sim.add_argument(
        "--dynamics", choices=("rigid", "kinematic"), default="rigid", help="kinematic: exact, without wind, cheaper"
    )
    sim.add_argument(
        "--airframe",
        choices=("f450", "ideal", "sih"),
        default="f450",
        help="ideal: no lags, no drag, no sag; sih: as in PX4's own simulator",
    )
    sim.add_argument("--attitude-lag", type=float, metavar="S", help="instead of the airframe's (0.15)")
    sim.add_argument("--wind", default="0", metavar="MPS[,FROM[,GUST]]", help="speed, compass degrees, gusts in m/s")
    sim.add_argument("--gps-noise", type=float, default=0.1, metavar="M", help="standard deviation (default 0.1)")
    sim.add_argument("--attitude-noise", type=float, default=0.2, metavar="DEG", help="the same (default 0.2)")
    sim.add_argument("--sensor-latency", type=float, default=0.0, metavar="S", help="age of the reported telemetry")
    sim.add_argument(
        "--params",
        action="append",
        type=Path,
        default=[],
        metavar="FILE",
        help="a .params, .param or .parm file, for the vehicles of its firmware; may be repeated",
    )
    sim.set_defaults(run=_sim)


def _add_sitl(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    sitl = commands.add_parser(
        "sitl",
        help="run real autopilot firmware as simulators",
        description="Run the autopilot binaries named by SKYGCS_PX4, SKYGCS_ARDUCOPTER, SKYGCS_ARDUPLANE and "
        "SKYGCS_ROVER as simulated vehicles.",
        epilog="Example: skygcs sitl --px4 2 --ardupilot 1",
    )
    sitl.add_argument("--px4", type=int, default=0, metavar="N", help="number of PX4 quadrotors (SIH)")
    sitl.add_argument("--ardupilot", type=int, default=0, metavar="N", help="number of ArduCopters")
    sitl.add_argument("--px4-plane", type=int, default=0, metavar="N", help="number of PX4 planes (SIH)")
    sitl.add_argument("--px4-vtol", type=int, default=0, metavar="N", help="number of PX4 VTOLs (SIH)")
    sitl.add_argument("--ardupilot-plane", type=int, default=0, metavar="N", help="number of ArduPlanes")
    sitl.add_argument("--quadplane", type=int, default=0, metavar="N", help="number of ArduPlanes with rotors")
    sitl.add_argument("--rover", type=int, default=0, metavar="N", help="number of ArduPilot rovers")
    sitl.add_argument("--first-sysid", type=int, default=1, metavar="ID", help="ids from this one on (default 1)")
    sitl.add_argument(
        "--home", default=HOME, metavar="LAT,LON,AMSL[,HEADING]", help=f"position of the first (default {HOME})"
    )
    sitl.add_argument(
        "--spacing", type=float, default=10.0, metavar="M", help="between homes, to the east (default 10)"
    )
    sitl.add_argument(
        "--port", type=port_number, default=0, metavar="PORT", help="UDP port of the daemon (default: a free one)"
    )
    sitl.add_argument(
        "--second-port",
        type=port_number,
        default=0,
        metavar="PORT",
        help="a second link of each vehicle, to this UDP port",
    )
    sitl.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="[px4:|ardupilot:]NAME=VALUE",
        help="a parameter to begin with; may be repeated",
    )
    sitl.add_argument(
        "--params", action="append", type=Path, default=[], metavar="FILE", help="a parameter file; may be repeated"
    )
    sitl.add_argument("--folder", type=Path, help="working folders, kept; default: temporary ones")
    sitl.add_argument("--speedup", type=float, default=1.0, help="simulated seconds per second, 0.1 to 20")
    sitl.set_defaults(run=_sitl)


def _run(args: argparse.Namespace) -> int:
    os.environ.setdefault(
        "PYDANTIC_DISABLE_PLUGINS", "__all__"
    )  # looking for plugins would read the metadata of every package
    with without_collections():
        from skygcs.config.loader import load_fleet_and_dialect

        config, dialect = load_fleet_and_dialect(args.file)
    changes = {"socket": args.socket, "log_dir": args.log_dir}

    def with_options(config: FleetConfig) -> FleetConfig:
        own = config.daemon.model_copy(update={k: v for k, v in changes.items() if v is not None})
        return config.model_copy(update={"daemon": own})

    config = with_options(config)
    configure_logging(verbose=args.verbose, quiet=args.quiet)

    async def serve() -> int:
        with without_collections():
            from skygcs.daemon import Daemon

        daemon = Daemon(config, dialect, source=str(args.file.resolve()))
        await serve_until_signal(daemon, load=lambda: with_options(load_fleet_and_dialect(args.file)[0]))
        return EXIT_OK

    return run_loop(serve())


def _init(args: argparse.Namespace) -> int:
    from skygcs.cli.fleet_files import write_example

    return write_example(args.scenario, args.folder, force=args.force)


def _completion(args: argparse.Namespace) -> int:
    from skygcs.cli.completion import script, this_shell

    print(script(new_parser(), args.shell or this_shell()), end="")
    return EXIT_OK


def _check(args: argparse.Namespace) -> int:
    from skygcs.cli.fleet_files import check

    return check(args.file)


def _import_router(args: argparse.Namespace) -> int:
    from skygcs.cli.fleet_files import import_router_file

    return import_router_file(args.file, args.output, force=args.force)


def _service(args: argparse.Namespace) -> int:
    from skygcs.cli import service

    if args.what == "install":
        if args.file is None:
            raise SkygcsError("service install FLEET.toml: which fleet file is it to run?")
        return service.install(args.file, user=args.user, force=args.force)
    return service.status(user=args.user) if args.what == "status" else service.uninstall(user=args.user)


def _metrics(args: argparse.Namespace) -> int:
    from importlib.resources import files

    name = {"dashboard": "dashboard.json", "rules": "alerts.yml"}[args.what]
    print(files("skygcs.ext.metrics").joinpath(name).read_text(encoding="utf-8"), end="")
    return EXIT_OK


def _demo(args: argparse.Namespace) -> int:
    from skygcs.cli.demo import demo

    configure_logging(quiet=True)
    return run_loop(demo(stay=args.stay, socket=args.socket, log_dir=args.log_dir.resolve()))


def _sim(args: argparse.Namespace) -> int:
    from skygcs.cli.sim import parse_conditions, run_sim
    from skygcs.sim.vehicle_group import KINDS

    udp = args.udp
    if udp is None and args.tcp is None and args.pty is None:
        udp = "127.0.0.1:14550"
    return run_sim(
        counts={kind: getattr(args, kind) for kind in KINDS},
        first_sysid=args.first_sysid,
        udp=udp,
        tcp=args.tcp,
        pty=args.pty,
        air=args.radio,
        xbee=args.xbee,
        separate_ports=args.separate_ports,
        home=args.home,
        seed=args.seed,
        speedup=args.speedup,
        conditions=parse_conditions(
            args.wind,
            dynamics=args.dynamics,
            airframe=args.airframe,
            attitude_lag_s=args.attitude_lag,
            gps_noise_m=args.gps_noise,
            attitude_noise_deg=args.attitude_noise,
            sensor_latency_s=args.sensor_latency,
        ),
        params=args.params,
    )


def _sitl(args: argparse.Namespace) -> int:
    from skygcs.cli.sitl import SitlOptions, parse_home, run_sitl
    from skygcs.sim.sitl import KINDS

    return run_sitl(
        SitlOptions(
            counts={kind: getattr(args, kind) for kind in KINDS},
            first_sysid=args.first_sysid,
            home=parse_home(args.home),
            spacing_m=args.spacing,
            port=args.port,
            second_port=args.second_port,
            params=args.param,
            param_files=args.params,
            folder=args.folder,
            speedup=args.speedup,
        )
    )
