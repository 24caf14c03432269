"""`skygcs sim`: simulated vehicles as a process of their own, over UDP, TCP or a pseudo-terminal."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from skygcs.cli.process import run_loop
from skygcs.cli.sim_ports import PtyPort, SimClock, SimPort, TcpPort, UdpPort, XBeePort
from skygcs.config.dialects import load_dialect
from skygcs.config.param_sets import load_param_set
from skygcs.config.radio import EmulatedRadio, EmulatedXBees
from skygcs.core.geo import NOWHERE, is_nowhere
from skygcs.core.mavlink.dialect import Dialect
from skygcs.ending_signals import ending_signals
from skygcs.errors import LinkError
from skygcs.links.simulated import emulated
from skygcs.sim import protocol as m
from skygcs.sim.conditions import CALM, Conditions, conditions_of
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.radio_status import SimRadio
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import make_vehicles
from skygcs.sim.vehicle_state import TICK_S
from skygcs.sim.xbee_mesh import MeshConfig, XBeeMesh

Keys = TypeVar("Keys", bound=BaseModel)

SIM_DIALECT = ("ardupilotmega", "px4-extras")

LEAST_SPEEDUP, MAX_SPEEDUP = 0.01, 100.0

SHORTEST_TICK_S = 0.005
"""Least real time between two ticks: with a speedup the vehicles take several of their ticks in one of the
program's."""


def run_sim(
    *,
    counts: Mapping[str, int],
    first_sysid: int,
    udp: str | None = None,
    tcp: str | None = None,
    pty: str | None = None,
    separate_ports: bool = False,
    home: str = "43.7806,-79.4653,180",
    seed: int = 1,
    speedup: float = 1.0,
    radio: bool = True,
    air: str | None = None,
    xbee: str | None = None,
    conditions: Conditions = CALM,
    params: Sequence[Path] = (),
) -> int:
    """Run simulated vehicles until one of `ending_signals`; the exit code. Says on stdout how to reach each.

    ``counts``: how many of each kind (`vehicle_group.KINDS`).

    ``udp`` HOST:PORT is sent to, from one socket or, with ``separate_ports``, from one for each vehicle.
    ``tcp`` HOST:PORT is listened on, every connection hears all vehicles; with ``separate_ports`` each vehicle has
    its own port, counting up. ``pty`` is where a symlink to a new pseudo-terminal is made: all vehicles behind it, as
    behind a radio, which with ``radio`` reports RADIO_STATUS. ``air`` KBPS[,KEY=VALUE…] puts emulated radios between
    the two instead (keys of `config.radio.EmulatedRadio`), ``xbee`` KBPS[,KEY=VALUE…] an emulated network of XBee
    modules (keys of `config.radio.EmulatedXBees`). ``home`` is LAT,LON,AMSL[,HEADING]. ``conditions`` hold
    for all of them, each with its own noise. ``params``: parameter files, each for the vehicles of its firmware.
    Raises LinkError or ConfigError, one line for a person, for what cannot be understood or opened.
    """
    _check_options(sum(counts.values()), speedup, (udp, tcp, pty), air, xbee)
    emulated_radio = None if air is None else parse_radio(air)
    mesh_config = None if xbee is None else parse_xbee(xbee)
    where, heading_deg = _parse_home(home)
    dialect = load_dialect(SIM_DIALECT)
    try:  # make the vehicles
        vehicles = make_vehicles(
            dialect,
            **counts,
            first_sysid=first_sysid,
            home=where,
            heading_deg=heading_deg,
            seed=seed,
            unix_us=int(time.time() * 1e6),
            conditions=conditions,
            params=[load_param_set(path) for path in params],
        )
    except ValueError as error:
        raise LinkError(str(error)) from None
    clock = SimClock(speedup)
    if pty is None:  # network: a port for all vehicles, or one for each
        groups = [[v] for v in vehicles] if separate_ports else [vehicles]
        return run_loop(_serve(_network_ports(groups, dialect, clock, udp=udp, tcp=tcp), clock, speedup))
    port: PtyPort
    if mesh_config is not None:  # pseudo-terminal: a modem, a radio or a plain line
        port = XBeePort(XBeeMesh(vehicles, dialect, mesh_config, Rng(seed), 0.0), dialect, clock, pty)
    else:
        behind = None if emulated_radio is None else _behind(emulated_radio, vehicles, dialect, seed)
        port = _pty_port(vehicles, dialect, clock, pty, _radio(dialect, seed) if radio else None, behind)
    return run_loop(_serve([port], clock, speedup))


def _check_options(
    count: int, speedup: float, ports: tuple[str | None, str | None, str | None], air: str | None, xbee: str | None
) -> None:
    """Raises LinkError for options that exclude each other; ``ports``: --udp, --tcp, --pty."""
    if count == 0:
        raise LinkError("no vehicles: --px4, --ardupilot, --px4-plane, --ardupilot-plane and --rover are all 0")
    if not LEAST_SPEEDUP <= speedup <= MAX_SPEEDUP:
        raise LinkError(f"speedup {speedup:g}: must be {LEAST_SPEEDUP:g} to {MAX_SPEEDUP:g}")
    if sum(port is not None for port in ports) != 1:
        raise LinkError("one of --udp, --tcp and --pty is needed")
    if air is not None and ports[2] is None:
        raise LinkError("--radio needs --pty")
    if xbee is not None and (ports[2] is None or air is not None):
        raise LinkError("--xbee needs --pty, and excludes --radio")


def _network_ports(
    groups: list[list[SimVehicle]], dialect: Dialect, clock: SimClock, *, udp: str | None, tcp: str | None
) -> list[SimPort]:
    """A UDP or TCP port for each group of vehicles; TCP ports count up from the first."""
    if udp is not None:
        return [UdpPort(group, dialect, clock, _parse_address("--udp", udp)) for group in groups]
    host, number = _parse_address("--tcp", tcp or "")
    return [TcpPort(group, dialect, clock, (host, number + i if number else 0)) for i, group in enumerate(groups)]


def _pty_port(
    vehicles: list[SimVehicle],
    dialect: Dialect,
    clock: SimClock,
    path: str,
    radio: SimRadio | None,
    behind: RadioFleet | None,
) -> PtyPort:
    try:
        return PtyPort(vehicles, dialect, clock, path, radio, behind)
    except ValueError as error:
        raise LinkError(f"--radio: {error}") from None


def parse_radio(text: str) -> EmulatedRadio:
    """Parse KBPS[,KEY=VALUE…]. Raises LinkError for a person."""
    return _parse_pairs("--radio", text, "air_kbps", EmulatedRadio)


def parse_xbee(text: str) -> MeshConfig:
    """Parse KBPS[,KEY=VALUE…]; ``hops`` are separated by colons. Raises LinkError for a person."""
    keys = _parse_pairs("--xbee", text, "rf_kbps", EmulatedXBees)
    return MeshConfig(**keys.model_dump())


def _parse_pairs(option: str, text: str, first_key: str, model: type[Keys]) -> Keys:
    first, *pairs = text.split(",")
    table: dict[str, object] = {first_key: first}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise LinkError(f"{option} {text!r}: {pair!r} is not of the form KEY=VALUE")
        table[key.strip()] = value.strip()
    try:
        return model.model_validate(table)
    except ValidationError as error:
        wrong = error.errors()[0]
        raise LinkError(f"{option} {text!r}: {'.'.join(map(str, wrong['loc']))}: {wrong['msg'].lower()}") from None


def _behind(radio: EmulatedRadio, vehicles: list[SimVehicle], dialect: Dialect, seed: int) -> RadioFleet:
    try:
        return emulated(radio, vehicles, dialect, seed=seed, now=0.0)
    except ValueError as error:
        raise LinkError(f"--radio: {error}") from None


def _radio(dialect: Dialect, seed: int) -> SimRadio:
    return SimRadio(dialect, Rng(seed))


def parse_conditions(
    wind: str,
    *,
    dynamics: str,
    airframe: str,
    attitude_lag_s: float | None,
    gps_noise_m: float,
    attitude_noise_deg: float,
    sensor_latency_s: float,
) -> Conditions:
    """Conditions from the command line; ``wind`` is MPS[,FROM_DEG[,GUST_MPS]]. Raises LinkError for a person."""
    try:
        numbers = [float(part) for part in wind.split(",")]  # the wind: speed, direction, gusts
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 3:
        raise LinkError(f"--wind {wind!r}: write MPS or MPS,FROM_DEG or MPS,FROM_DEG,GUST_MPS")
    speed_mps, from_deg, gust_mps = (numbers + [270.0, 0.0][len(numbers) - 1 :])[:3]
    try:
        return conditions_of(
            dynamics=dynamics,
            airframe=airframe,
            attitude_lag_s=attitude_lag_s,
            wind_mps=speed_mps,
            wind_from_deg=from_deg,
            gust_mps=gust_mps,
            gps_noise_m=gps_noise_m,
            attitude_noise_deg=attitude_noise_deg,
            sensor_latency_s=sensor_latency_s,
        )
    except ValueError as error:
        raise LinkError(str(error)) from None


def _parse_home(text: str) -> tuple[LocalFrame, float]:
    try:
        numbers = [float(part) for part in text.split(",")]
        lat_deg, lon_deg, alt_amsl_m = numbers[:3]
        heading_deg = numbers[3] if len(numbers) == 4 else 0.0
    except ValueError:
        raise LinkError(f"--home {text!r}: write LAT,LON,AMSL or LAT,LON,AMSL,HEADING") from None
    if len(numbers) > 4 or not (abs(lat_deg) < 90 and abs(lon_deg) <= 180 and abs(alt_amsl_m) < 10_000):
        raise LinkError(f"--home {text!r}: not a place on Earth (degrees, degrees, metres)")
    if is_nowhere(lat_deg, lon_deg):
        raise LinkError(f"--home {text!r}: {NOWHERE}")
    return LocalFrame(lat_deg, lon_deg, alt_amsl_m), heading_deg


def _parse_address(option: str, text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdigit() or int(port) > 65535:
        raise LinkError(f"{option} {text!r}: write HOST:PORT")
    return host.strip("[]") or "127.0.0.1", int(port)


def describe(vehicle: SimVehicle) -> str:
    firmware = "PX4" if vehicle.autopilot == m.MAV_AUTOPILOT_PX4 else vehicle.firmware.name
    return f"vehicle {vehicle.sysid}: {firmware} {vehicle.looks}"


async def _serve(ports: Sequence[SimPort], clock: SimClock, speedup: float) -> int:
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in ending_signals():
        loop.add_signal_handler(number, stop.set)
    clock.start()
    try:
        for port in ports:
            reach = await port.open()
            for vehicle in port.fleet.vehicles:
                print(f"{describe(vehicle)}, {reach}", flush=True)
        await _tick_until(stop, ports, max(TICK_S / speedup, SHORTEST_TICK_S))
    finally:
        for port in ports:
            port.close()
    return 0


async def _tick_until(stop: asyncio.Event, ports: Sequence[SimPort], period_s: float) -> None:
    loop = asyncio.get_running_loop()
    deadline = loop.time()
    timer: asyncio.Handle | None = None

    def tick() -> None:
        nonlocal deadline, timer
        for port in ports:
            port.pump()
        deadline = max(deadline + period_s, loop.time())
        timer = loop.call_at(deadline, tick)

    timer = loop.call_soon(tick)
    try:
        await stop.wait()
    finally:
        if timer is not None:
            timer.cancel()
