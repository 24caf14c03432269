"""Two real autopilots in simulation, a relay that can cut and delay, and a real `skygcs run`."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pymavlink import mavutil

from skygcs.config.firmware import PROGRAMS, PX4
from skygcs.sim.sitl import KINDS
from support.process import ROOT, DaemonProcess, free_port
from support.udp_relay import Truth, UdpRelay, metres

HOME = (43.7806, -79.4653, 180.0)
SPACING_M = 10.0
START_S = 150.0
"""For an ArduCopter's estimator on a loaded machine; it takes 42 s of its own."""

NEAR_STAND_M = 1.5
"""How far from its place a vehicle may be when a scenario begins: the noise of PX4's simulated GPS is half of it."""

STAND_S = 180.0
"""Until all stand at their places: a wait, and no measurement."""

SENSORS_S = 20.0
"""So long a sensor may be unhealthy before the vehicles are started again."""

FLOWN_BY = ("3d_gyro", "3d_accel", "3d_mag", "absolute_pressure", "gps")
"""Sensors that an autopilot does not arm without."""

TELEMETRY_HZ = 10
RECENTLY_S = 3.5
"""Longer than skygcs takes a vehicle for armed that was armed."""

HEIGHT_M = 10.0

PARAMS = {
    # Without a transmitter PX4 goes to Position mode when setpoints cease, and sinks: hold instead.
    "px4": ("MIS_TKO_LAND_REQ=0", "COM_OBL_RC_ACT=5"),
    # The failsafe that a user with a ground station has switched on, a battery that lasts, thrust by setpoints.
    "ardupilot": ("FS_GCS_ENABLE=1", "BATT_CAPACITY=30000", "GUID_OPTIONS=8"),
}
TRACKING_ERROR_M = {"px4": 1.5, "ardupilot": 0.6}
"""Of plans in position, heights halved. The height of PX4's simulator wanders: 1.05 and 1.5 m were seen in minutes."""

FIRST_SYSID = {"px4": 11, "ardupilot": 21, "px4_plane": 31, "ardupilot_plane": 41, "rover": 51}
FIRST_SYSID |= {"px4_vtol": 61, "quadplane": 71}

OTHERS = ("px4_plane", "px4_vtol", "ardupilot_plane", "quadplane", "rover")
"""Firmware of what is no copter: one vehicle, and scenarios that are marked for it."""
FLOWN = ("px4", "ardupilot", *OTHERS)


def link_table(name: str, port: int, kind: str = "udp_server", role: str = "gcs") -> str:
    """A link of the fleet file, on loopback."""
    return f'[links.{name}]\ntype = "{kind}"\nhost = "127.0.0.1"\nport = {port}\nrole = "{role}"'


class Watcher(threading.Thread):
    """Events and telemetry of the daemon, kept with the time at which they came; connects again and again."""

    def __init__(self, address: Path) -> None:
        super().__init__(name="watcher", daemon=True)
        self._address = address
        self.events: list[tuple[float, dict[str, Any]]] = []
        self.states: list[tuple[float, dict[str, Any]]] = []
        self._ending = threading.Event()

    def stop(self) -> None:
        self._ending.set()

    def run(self) -> None:
        while not self._ending.is_set():
            try:
                self._listen()
            except OSError:
                time.sleep(0.1)

    def _listen(self) -> None:
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(2.0)
            link.connect(str(self._address))
            topics: list[dict[str, Any]] = [
                {"topic": "events"},
                {"topic": "telemetry", "rate_hz": TELEMETRY_HZ, "names": ["position", "attitude", "battery"]},
            ]
            for number, params in enumerate(topics):
                call = {"jsonrpc": "2.0", "id": number, "method": "subscribe", "params": params}
                link.sendall(json.dumps(call).encode() + b"\n")
            buffer = b""
            while not self._ending.is_set():
                try:
                    data = link.recv(65536)
                except TimeoutError:
                    continue
                if not data:
                    raise OSError("closed")
                *lines, buffer = (buffer + data).split(b"\n")
                for line in lines:
                    self._take(json.loads(line), time.monotonic())

    def _take(self, message: Mapping[str, Any], now: float) -> None:
        if message.get("method") == "event":
            self.events.append((now, message["params"]["event"]))
        elif message.get("method") == "telemetry":
            self.states.append((now, message["params"]["state"]))

    def events_since(self, at: float, *kinds: str, vehicle: str | None = None) -> list[dict[str, Any]]:
        return [
            event
            for when, event in list(self.events)
            if when > at and (not kinds or event["kind"] in kinds) and (vehicle is None or event["vehicle"] == vehicle)
        ]


class Stream(threading.Thread):
    """Setpoints from a function of the time since the start, until `end`."""

    def __init__(
        self, address: Path, target: str, reference: Callable[[float], dict[str, Any]], rate_hz: float
    ) -> None:
        super().__init__(name="setpoints", daemon=True)
        self._address = address
        self._target = target
        self._reference = reference
        self._period_s = 1 / rate_hz
        self._ending = threading.Event()
        self.refused: list[Any] = []
        self.sent: list[tuple[float, dict[str, Any]]] = []

    def __enter__(self) -> Stream:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self.join(5)

    def run(self) -> None:
        began = time.monotonic()
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(5.0)
            try:
                link.connect(str(self._address))
                with link.makefile("rb") as answers:
                    while not self._ending.wait(self._period_s):
                        t = time.monotonic() - began
                        params = {"targets": self._target, **self._reference(t)}
                        call = {"jsonrpc": "2.0", "id": 1, "method": "control.setpoint", "params": params}
                        link.sendall(json.dumps(call).encode() + b"\n")
                        answer = json.loads(answers.readline() or b"{}")
                        self.sent.append((time.monotonic(), params))
                        outcomes = answer.get("result", {}).get("outcomes", {})
                        if "error" in answer or not all(o["ok"] for o in outcomes.values()):
                            self.refused.append(answer)
            except (OSError, ValueError) as error:
                self.refused.append(str(error))


class Field:
    """``names`` are the vehicles, ``one`` the first of them."""

    heading_deg = 0.0
    """Where ArduCopters look at their start."""

    def __init__(self, firmware: str, folder: Path) -> None:
        self.firmware = firmware
        self.folder = folder
        self.px4 = KINDS[firmware].autopilot == "px4"  # type: ignore[index]
        self.sysids = [FIRST_SYSID[firmware] + i for i in range(1 if firmware in OTHERS else 2)]
        self.names = [f"{KINDS[firmware].prefix}{sysid}" for sysid in self.sysids]  # type: ignore[index]
        self.one, self.two = self.names[0], self.names[-1]
        self.daemon_port, self.gcs_port, self.bound_port = free_port(), free_port(), free_port()
        self.bound_tcp_port, self.program_port = free_port(socket.SOCK_STREAM), free_port()
        self.relay = UdpRelay(self.daemon_port)
        self.second_port = free_port()
        """Where the vehicles' second links send to: a scenario of two ways listens there, usually nobody does."""
        self.sitl_log = folder / "sitl.log"
        self.sitl: subprocess.Popen[bytes] | None = None
        self.relaunched: list[str] = []
        """Why the vehicles were started again, each time."""
        self.daemon = DaemonProcess(folder, self.toml())
        self.watcher = Watcher(self.daemon.socket)

    def toml(self, *, link: str = "", control: str = "") -> str:
        autopilot = "px4" if self.px4 else "ardupilot"
        expected = {"px4": "RTL_RETURN_ALT = 25", "ardupilot": "FENCE_MARGIN = 2"}.get(self.firmware, "")
        bound = f'vehicles = ["{self.one}"]\ntranslated_sysid = 1'
        text = f"""
record_max_mb = 500

[origin]
lat_deg = {HOME[0]}
lon_deg = {HOME[1]}
alt_amsl_m = {HOME[2]}

{link_table("vehicles", self.daemon_port, role="vehicle")}
{link}
{link_table("gcs", self.gcs_port)}
{link_table("bound", self.bound_port)}
{bound}
{link_table("bound_tcp", self.bound_tcp_port, "tcp_server")}
{bound}
{link_table("bound_out", self.program_port, "udp_client")}
{bound}
[defaults.control]
fence = {{ x_m = [-30, 30], y_m = [-30, 30], up_m = [0, 25] }}
{control}
[defaults.preflight.params]
{expected}
"""
        for name, sysid in zip(self.names, self.sysids, strict=True):
            text += f'\n[vehicles.{name}]\nsysid = {sysid}\nautopilot = "{autopilot}"\n'
            text += f"separation = {{ tracking_error_m = {TRACKING_ERROR_M.get(self.firmware, 2.0)} }}\n"
        return text

    # -- life

    def start(self) -> None:
        self.relay.start()
        self.launch()
        self.daemon.start()
        self.watcher.start()
        self.wait(lambda: self.said("all are ready"), START_S, "every vehicle is ready")
        self.wait(lambda: self.daemon.known() == len(self.names) and self.connected(), 30, "the daemon knows all")

    def launch(self) -> None:
        """Start the firmware; returns at once."""
        words = [sys.executable, "-m", "skygcs", "sitl", *self.kinds()]
        words += ["--first-sysid", str(self.sysids[0]), "--port", str(self.relay.port)]
        words += ["--second-port", str(self.second_port)]
        words += ["--home", ",".join(map(str, (*HOME, self.heading_deg))), "--spacing", str(SPACING_M)]
        words += ["--folder", str(self.folder / "vehicles")]
        words += [word for param in self.params() for word in ("--param", param)]
        with self.sitl_log.open("wb") as log:
            self.sitl = subprocess.Popen(words, stdout=log, stderr=log, cwd=ROOT)

    def kinds(self) -> list[str]:
        """How many vehicles of which firmware, as options of `skygcs sitl`."""
        return [f"--{self.firmware.replace('_', '-')}", str(len(self.sysids))]

    def params(self) -> list[str]:
        return list(PARAMS.get(self.firmware, ()))

    def said(self, text: str) -> bool:
        assert self.sitl is not None
        assert self.sitl.poll() is None, self.sitl_log.read_text()
        return text in self.sitl_log.read_text()

    def relaunch(self) -> None:
        """A power cut: the vehicles begin again with their parameters; until both are heard, not ready."""
        began = time.monotonic()
        self._end_firmware()
        self.wait(lambda: not any(v["connected"] for v in self.daemon.vehicles().values()), 30, "both are lost")
        self.launch()
        self.wait(lambda: all(self.truth(n).heartbeat_at > began for n in self.names), 30, "both send")
        self.wait(self.connected, 30, "the daemon hears both")

    def _end_firmware(self) -> None:
        if self.sitl is not None and self.sitl.poll() is None:
            self.sitl.send_signal(signal.SIGTERM)
            self.sitl.wait(20)

    def stop(self) -> None:
        self.watcher.stop()
        self.daemon.stop()
        self._end_firmware()
        self.relay.stop()

    def restart_daemon(self, toml: str | None = None) -> None:
        """End it, and start it with the same or another fleet file."""
        self.daemon.stop()
        if toml is not None:
            head = f'[daemon]\nsocket = "{self.daemon.socket}"\nlog_dir = "{self.daemon.logs}"\n'
            self.daemon.file.write_text(head + toml)
        self.daemon.start()
        self.wait(lambda: self.daemon.known() == len(self.names) and self.connected(), 60, "the daemon knows both")

    def firmware_pids(self) -> list[int]:
        return [int(pid) for pid in re.findall(r"pid (\d+)", self.sitl_log.read_text())]

    # -- looking

    def truth(self, name: str) -> Truth:
        """What the vehicle says of itself before the relay."""
        return self.relay.truths[self.sysids[self.names.index(name)]]

    def state(self, name: str) -> dict[str, Any]:
        state: dict[str, Any] = self.daemon.call("vehicles.get", target=name)
        return state

    def has_position(self, name: str) -> bool:
        """True if the daemon knows where it is now. After the daemon's start that takes a moment; after a silence it is
        from the next heartbeat on, and until then the vehicle is an obstacle that was lost in the air."""
        state = self.state(name)
        position = state["position"]
        return bool(state["connected"]) and position is not None and position["age_s"] < 2

    def connected(self) -> bool:
        return all(v["connected"] for v in self.daemon.vehicles().values())

    def control(self, name: str) -> dict[str, Any]:
        status: list[dict[str, Any]] = self.daemon.call("control.status", targets=name)
        return status[0]

    def fell_back(self, since: float) -> str | None:
        """Why the guard has not flown the first vehicle in the mode that was ordered since then; None: it has. Unless
        the test itself asks for that, the computer is too busy."""
        reports = [e["text"] for e in self.watcher.events_since(since, "control", vehicle=self.one)]
        return next((text for text in reports if text.startswith(("flown by", "holding")) and "limit" in text), None)

    def enu(self, name: str) -> tuple[float, float, float]:
        """Where the vehicle says it is, about `HOME`, from its own frames."""
        truth = self.truth(name)
        east = (truth.lon_deg - HOME[1]) * math.cos(math.radians(HOME[0])) * 111_319.5
        north = (truth.lat_deg - HOME[0]) * 111_132.0
        return east, north, truth.alt_rel_m

    def wait(self, condition: Callable[[], Any], limit_s: float, what: str) -> float:
        """Seconds until the condition held; fails with ``what`` after the limit."""
        began = time.monotonic()
        while time.monotonic() - began < limit_s:
            if condition():
                return time.monotonic() - began
            time.sleep(0.05)
        raise AssertionError(f"not within {limit_s:g} s: {what}; {self.summary()}")

    def summary(self) -> str:
        parts = []
        for name in self.names:
            truth = self.relay.truths.get(self.sysids[self.names.index(name)])
            if truth is not None:
                armed = "armed" if truth.armed else "disarmed"
                parts.append(f"{name} {truth.mode} {armed} {truth.alt_rel_m:.1f} m {truth.texts[-1:]}")
        return "; ".join(parts)

    def holds(self, condition: Callable[[], Any], seconds: float, what: str) -> None:
        """Fails if the condition ceases to hold within this time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            assert condition(), f"{what}; {self.summary()}"
            time.sleep(0.05)

    # -- orders

    def order(self, method: str, targets: str | Sequence[str], **params: Any) -> dict[str, Any]:
        """The outcomes; fails unless all are ok."""
        answer = self.daemon.call(method, targets=targets if isinstance(targets, str) else list(targets), **params)
        outcomes: dict[str, Any] = answer["outcomes"]
        flat = {n: o for n, o in outcomes.items() if "ok" in o}
        flat |= {f"{n} {p}": o for n, params in outcomes.items() if n not in flat for p, o in params.items()}
        failed = {name: o["message"] for name, o in flat.items() if not o["ok"]}
        assert not failed, f"{method}: {failed}; {self.summary()}"
        return outcomes

    @contextmanager
    def controlled(self, mode: str, reference: Callable[[float], dict[str, Any]] | None = None) -> Iterator[Stream]:
        """The first vehicle under control by a stream of setpoints, its place unless there is another reference (of
        the seconds since the start); off again at the end."""
        place = {"pos_enu_m": [*self.stand(self.one), HEIGHT_M]}
        self.order("control.set", self.one, mode=mode, force=True)
        try:
            with Stream(self.daemon.socket, self.one, reference or (lambda t: place), 20.0) as stream:
                self.wait(lambda: self._stands(near_place=reference is None), 20, "it stands under control")
                yield stream
        finally:
            self.relay.clear()
            if self.daemon.process is not None and self.daemon.process.poll() is None:
                self.daemon.call("control.set", targets=self.one, mode="off")

    def _stands(self, *, near_place: bool) -> bool:
        far_m = math.dist(self.enu(self.one), (*self.stand(self.one), HEIGHT_M))
        return self.truth(self.one).speed_mps < 0.5 and (far_m < 1.0 or not near_place)

    def steady(self, name: str, seconds: float = 1.0) -> bool:
        """Whether it has not moved by more than half a metre for so long, by its own positions."""
        now = time.monotonic()
        recent = [p for p in self.truth(name).track[-int(60 * seconds) :] if p[0] > now - seconds]
        return len(recent) > 1 and all(
            metres(p[1], p[2], recent[-1][1], recent[-1][2]) < 0.5 and abs(p[3] - recent[-1][3]) < 0.7 for p in recent
        )

    def takeoff(self, targets: str = "all", height_m: float = HEIGHT_M) -> float:
        """Seconds until all of them are up; those that are in the air already are only sent to the height."""
        names = self.names if targets == "all" else [targets]
        self.wait(lambda: not any(self.state(n)["duplicate_sysid"] for n in names), 20, "no duplicate is reported")
        self.wait(lambda: all(self.has_position(n) for n in names), 30, "the daemon knows where they are")
        # a vehicle that was silent is an obstacle that was lost in the air until the monitor has looked again
        self.wait(lambda: self.daemon.call("monitor.status")["watched"] >= len(self.names), 10, "all are watched")
        for name in names:
            if self.truth(name).armed and self.truth(name).alt_rel_m > 2:
                self.order("vehicles.hold", name)  # also takes it over from a failsafe of its own
                if not self.px4:
                    self.order("vehicles.mode", name, mode="GUIDED")
                self.wait(lambda n=name: not self.state(n)["failsafe"], 20, f"{name}'s failsafe is over")  # type: ignore[misc]
                self.order("vehicles.goto", name, enu_m=[*self.stand(name), height_m])
            else:
                if self.truth(name).armed:  # an end of its own, as after a failsafe: it lands just now
                    self.wait(lambda n=name: not self.truth(n).armed, 60, f"{name} has landed")  # type: ignore[misc]
                    self.wait_idle(name)
                self._mend_sensors()
                self.order("vehicles.takeoff", name, height_m=height_m, wait_s=60)
        up_s = self.wait(lambda: all(self._is_up(n, height_m) for n in names), STAND_S, f"{names} are up")
        for name in names:
            if math.dist(self.enu(name)[:2], self.stand(name)) > NEAR_STAND_M:  # a takeoff elsewhere
                self.order("vehicles.goto", name, enu_m=[*self.stand(name), height_m])
        self.wait(
            lambda: all(self._at_stand(name, height_m) for name in names), STAND_S, f"{names} stand at their places"
        )
        return up_s

    def _is_up(self, name: str, height_m: float) -> bool:
        """A PX4 goes from TAKEOFF to LOITER by itself."""
        truth = self.truth(name)
        return abs(truth.alt_rel_m - height_m) < 1.5 and truth.mode != "TAKEOFF"

    def _at_stand(self, name: str, height_m: float) -> bool:
        near = self._is_up(name, height_m) and math.dist(self.enu(name)[:2], self.stand(name)) < NEAR_STAND_M
        return near and self.steady(name)

    def stand(self, name: str) -> tuple[float, float]:
        """Where it took off from, in metres east and north."""
        return self.names.index(name) * SPACING_M, 0.0

    def land(self) -> float:
        """Seconds until all are on the ground and disarmed; where they are."""
        self.relay.clear()
        flying = [name for name in self.names if self.truth(name).armed]
        for name in flying:
            self.order("vehicles.land", name)
        landed_s = self.wait(lambda: not any(self.truth(n).armed for n in self.names), 120, "all have landed")
        self.wait_idle()
        return landed_s

    def wait_idle(self, *names: str) -> None:
        """Until the daemon takes them (all, unless some are named) for disarmed and on the ground: before that it does
        nothing to them that would be dangerous in the air."""
        which = names or tuple(self.names)
        self.wait(lambda: not any(self.state(n)["armed"] for n in which), 20, f"{which} are seen disarmed")
        self.wait(
            lambda: all(self.state(n)["landed"] in ("on_ground", None) for n in which), 20, f"{which} are seen landed"
        )
        self.wait(lambda: all(self.truth(n).armed_at < time.monotonic() - RECENTLY_S for n in which), 10, "idle")

    def ready_on_ground(self) -> None:
        """All disarmed, in a mode that arms, and near where they began."""
        self.relay.clear()
        if any(self.truth(n).armed for n in self.names):
            self.land()
        self._mend_sensors()
        self.wait(lambda: not any(self.state(n)["duplicate_sysid"] for n in self.names), 20, "no duplicate is reported")
        self.wait_idle()
        for name in self.names:
            mode = "AUTO.LOITER" if self.px4 else "GUIDED"
            if self.state(name)["mode"] != mode:
                self.order("vehicles.mode", name, mode=mode)

    def _mend_sensors(self) -> None:
        """Start the vehicles again if a simulated sensor is silent: on a loaded machine one that was late for too long
        is given up by its autopilot until the next start (PX4: "Compass … missing"). All are on the ground."""
        if any(self.truth(n).armed for n in self.names) or not self._unhealthy():
            return
        if not self._wait_for(lambda: not self._unhealthy(), SENSORS_S):
            self.relaunched.append(", ".join(self._unhealthy()))
            self.relaunch()
            self.wait(lambda: self.said("all are ready"), START_S, "every vehicle is ready again")
            self.wait(lambda: not self._unhealthy(), START_S, "every sensor is healthy")

    def _unhealthy(self) -> list[str]:
        """Vehicles and their sensors that are switched on and not healthy."""
        found = []
        for name in self.names:
            sensors = self.state(name)["sensors"] or {"unhealthy": ()}
            found += [f"{name} {sensor}" for sensor in sensors["unhealthy"] if sensor in FLOWN_BY]
        return found

    def _wait_for(self, condition: Callable[[], Any], limit_s: float) -> bool:
        try:
            self.wait(condition, limit_s, "")
        except AssertionError:
            return False
        return True

    # -- others

    @contextmanager
    def ground_station(self, port: int | None = None, sysid: int = 250) -> Iterator[Any]:
        """Another program: a pymavlink connection to a link of the daemon; its first heartbeat is sent."""
        connection = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port or self.gcs_port}",
            source_system=sysid,
            source_component=190,
            dialect="ardupilotmega",
        )
        connection.mav.heartbeat_send(6, 8, 0, 0, 4)
        try:
            yield connection
        finally:
            connection.close()

    @contextmanager
    def peer(self, sysid: int, compid: int = 1) -> Iterator[Any]:
        """Somebody at the vehicles' link who is no vehicle; MAVLink of pymavlink."""
        connection = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{self.daemon_port}",
            source_system=sysid,
            source_component=compid,
            dialect="ardupilotmega",
        )
        try:
            yield connection
        finally:
            connection.close()


MIXED_SYSID = 31
"""Of the first of `MixedField`."""


class MixedField(Field):
    """Two PX4s and two ArduCopters in one fleet: the PX4s first, `SPACING_M` apart to the east."""

    def __init__(self, folder: Path) -> None:
        super().__init__("px4", folder)
        self.sysids = [MIXED_SYSID + i for i in range(4)]
        self.names = [f"{'px' if i < 2 else 'copter'}{sysid}" for i, sysid in enumerate(self.sysids)]
        self.one, self.two = self.names[:2]
        self.daemon.file.write_text(self.daemon.file.read_text().split("[origin]")[0] + self.mixed_toml())

    def mixed_toml(self) -> str:
        text = f"""
[origin]
lat_deg = {HOME[0]}
lon_deg = {HOME[1]}
alt_amsl_m = {HOME[2]}

[formation]

{link_table("vehicles", self.daemon_port, role="vehicle")}

[defaults.control]
fence = {{ x_m = [-40, 60], y_m = [-40, 60], up_m = [0, 60] }}
"""
        for i, (name, sysid) in enumerate(zip(self.names, self.sysids, strict=True)):
            family = "px4" if i < 2 else "ardupilot"
            text += f'\n[vehicles.{name}]\nsysid = {sysid}\nautopilot = "{family}"\n'
            text += f"separation = {{ tracking_error_m = {TRACKING_ERROR_M[family]} }}\n"
        return text

    def kinds(self) -> list[str]:
        return ["--px4", "2", "--ardupilot", "2"]

    def params(self) -> list[str]:
        return [f"{family}:{param}" for family, params in PARAMS.items() for param in params]


def available() -> list[str]:
    """Firmwares that the environment names."""
    variables = {"px4": PX4, "px4_plane": PX4, "px4_vtol": PX4} | {
        kind: program.variable for kind, program in PROGRAMS.items()
    }
    return [firmware for firmware in FLOWN if os.environ.get(variables[firmware])]
