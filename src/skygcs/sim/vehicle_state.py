"""State of a simulated vehicle: its state, and what PX4 and ArduCopter fill in. `vehicle` lets it live.

The parts that work on a vehicle (`failsafe`, `flight`, `requests`, `telemetry`) see this class and not `vehicle`, which
calls them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from math import hypot, inf, radians
from typing import Any, Final

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols import ftp
from skygcs.sim import protocol as m
from skygcs.sim.battery import Battery
from skygcs.sim.behaviours import Firmware, Reaction
from skygcs.sim.body import Body, Vector
from skygcs.sim.command_message import Calibration, Command
from skygcs.sim.conditions import CALM, Conditions, body_of
from skygcs.sim.external_vision import ExternalVision
from skygcs.sim.failsafe_timers import Failsafes
from skygcs.sim.faults import Faults
from skygcs.sim.firmware_modes import ModeRule
from skygcs.sim.kinematics import Home, Limits, LocalFrame, Motion, stopping_distance
from skygcs.sim.legs import GoTo, Land, Plan
from skygcs.sim.mission_lists import MissionLists
from skygcs.sim.mission_run import MissionRun
from skygcs.sim.onboard_logs import OnboardLogs
from skygcs.sim.onboard_signing import BoardSigning
from skygcs.sim.param_table import Param, Params
from skygcs.sim.position_control import ControlGains, PositionControl
from skygcs.sim.px4_shell import Px4Shell
from skygcs.sim.quad import Quad
from skygcs.sim.rng import Rng
from skygcs.sim.rtk import RtkReceiver
from skygcs.sim.sensors import Sensors
from skygcs.sim.stream_schedule import Streams
from skygcs.sim.transmitter import Transmitter
from skygcs.sim.wings_and_wheels import Rover, Wing

TICK_S = 0.02
"""50 Hz: the fastest stream a ground station asks a radio link for, and 2 cm of flight at 1 m/s."""

REBOOT_S = 2.0
"""Silence of a rebooting autopilot."""


class VehicleState(ABC):
    """Everything that a vehicle knows and is, the hooks its firmware fills in, and the orders both carry out alike."""

    autopilot: int
    firmware: Firmware
    """Behaviour of the firmware, as data."""
    vtol_state: int = m.MAV_VTOL_STATE_UNDEFINED
    mav_type: int = m.MAV_TYPE_QUADROTOR
    looks: str = "quadrotor"
    """Kind of the vehicle, for people."""
    flies: bool = True
    """False: it drives, and has landed while it is disarmed only."""
    default_rates_hz: Mapping[str, float]
    sysid_param: str
    named_param_index: int | None
    """param_index of an answer to a request by name; None: the parameter's own."""
    can_sign: bool = False
    """True if SETUP_SIGNING does anything; PX4 1.16 takes no notice."""
    hears_broadcast_commands: bool = True
    """True if a command for system 0 is taken; PX4 takes those for its own id only (and asks for capabilities)."""
    mode: int
    """HEARTBEAT.custom_mode."""
    lists: MissionLists
    """Mission, fence and rally points on board."""
    run: MissionRun
    """The mission as it is flown."""
    fence_breach: int
    """FENCE_BREACH: which side of its fence it is beyond, flying or not."""
    fence_breaches: int
    """Since boot."""
    home_fixed: bool
    """A ground station has set home: arming leaves it."""
    _home_moved_at: float
    failsafe: bool
    """A failsafe has chosen the mode."""
    setpoint_at: float
    """When the last setpoint came."""
    shell: Px4Shell | None = None
    """Console over MAVLink; None: not available."""

    def __init__(
        self,
        dialect: Dialect,
        sysid: int,
        where: LocalFrame,
        *,
        rng: Rng,
        now: float = 0.0,
        unix_us: int = 0,
        heading_deg: float = 0.0,
        conditions: Conditions = CALM,
    ) -> None:
        # identity, parameters and transmitter
        self.dialect = dialect
        self.compid: Final = m.MAV_COMP_ID_AUTOPILOT1
        self.where = where
        self.params = self.factory_params(sysid)
        self.rng = rng
        self.faults = Faults()
        self.signing = BoardSigning()
        self.tx = Transmitter(dialect, rng, self.faults, self.signing)
        # body and sensors
        self.motion = self.make_body(conditions, radians(heading_deg), rng.child_seed())
        self.sensors = Sensors(self.motion, conditions, TICK_S, rng.child_seed())
        self.battery = Battery()
        # plan, control and lists
        self.plan = self.make_plan()
        self.position_control = self.make_position_control(self.control_gains())
        self.lists, self.run = self.make_lists()
        # clock and home
        self._unix_offset_us = unix_us - now * 1e6
        self._clock = now
        self.home: Home | None = None
        self.local_zero: Home | None = None
        px4 = self.autopilot == m.MAV_AUTOPILOT_PX4
        self.logs = OnboardLogs(self.tx, sysid, px4=px4, unix_s=unix_us // 1_000_000)
        self._boot(now)

    # -- what differs between the firmwares

    @staticmethod
    @abstractmethod
    def factory_params(sysid: int) -> Params:
        """The parameters of a new vehicle."""

    @staticmethod
    @abstractmethod
    def make_position_control(gains: ControlGains) -> PositionControl:
        """Return what follows its targets in OFFBOARD or GUIDED."""

    @staticmethod
    def make_body(conditions: Conditions, yaw_rad: float, seed: int) -> Motion | Quad | Wing | Rover:
        """Return what moves, at rest on the ground."""
        return body_of(conditions, yaw_rad, seed)

    def make_plan(self) -> Plan:
        """Return what makes legs of its orders."""
        return Plan()

    @property
    @abstractmethod
    def base_mode(self) -> int: ...

    @property
    @abstractmethod
    def system_status(self) -> int: ...

    @property
    @abstractmethod
    def version(self) -> dict[str, Any]:
        """Fields of AUTOPILOT_VERSION."""

    @property
    @abstractmethod
    def fence_flags(self) -> tuple[bool, bool, bool]:
        """The fence in SYS_STATUS: present, enabled, healthy."""

    @abstractmethod
    def make_lists(self) -> tuple[MissionLists, MissionRun]: ...

    @property
    @abstractmethod
    def by_vision(self) -> bool:
        """True if the parameters select motion capture instead of GPS."""

    @property
    @abstractmethod
    def low_battery_percent(self) -> float: ...

    @abstractmethod
    def battery_levels(self) -> tuple[bool, bool, bool]:
        """Return whether the charge is low, critical, an emergency."""

    @property
    @abstractmethod
    def setpoints_expected(self) -> bool:
        """A stream of setpoints that ceases is a failsafe in this mode."""

    @property
    @abstractmethod
    def needs_position(self) -> bool:
        """True if what it does now needs a position estimate."""

    @abstractmethod
    def breach(self, east_m: float, north_m: float, up_m: float) -> str:
        """Which side of its fence this place is beyond: "distance", "height", "polygon" or ""."""

    @abstractmethod
    def too_far_beyond(self, breach: str) -> bool:
        """True if the vehicle is so far outside that it lands instead of returning."""

    @abstractmethod
    def carry_out(self, reaction: Reaction, now: float) -> None:
        """Do what a failsafe wants; the vehicle is armed."""

    @abstractmethod
    def switch_off(self, reason: str) -> None:
        """Disarm for this reason and report it."""

    @abstractmethod
    def say_failsafe(self, reason: str, reaction: Reaction) -> None: ...

    @abstractmethod
    def say_battery(self, level: str) -> None: ...

    @abstractmethod
    def say_breach(self, breach: str) -> None: ...

    @abstractmethod
    def say_gcs_is_back(self) -> None: ...

    @abstractmethod
    def limits(self) -> Limits:
        """Speeds as the parameters say."""

    @abstractmethod
    def arming_refusal(self) -> str | None:
        """Why it would not arm now, None if it would."""

    @abstractmethod
    def command(self, c: Command, now: float) -> int | None:
        """Carry out a command; its MAV_RESULT, or None if it was answered already."""

    @abstractmethod
    def on_boot(self, now: float) -> None:
        """Set the first mode and schedule the boot texts."""

    @abstractmethod
    def on_ready(self, now: float) -> None:
        """The position estimate has become good."""

    @abstractmethod
    def on_tick(self, now: float) -> None:
        """Mode logic and failsafes of one tick, before the vehicle moves."""

    @abstractmethod
    def on_takeoff(self, now: float) -> None: ...

    @abstractmethod
    def on_landed(self, now: float) -> None: ...

    @abstractmethod
    def on_gcs_heartbeat(self, sender: tuple[int, int], now: float) -> None:
        """A HEARTBEAT of a ground station."""

    @abstractmethod
    def on_setpoint(self, name: str, fields: dict[str, Any], now: float) -> None:
        """A SET_POSITION_TARGET_* or SET_ATTITUDE_TARGET for us."""

    @abstractmethod
    def on_set_mode_message(self, custom_mode: int, sender: tuple[int, int], now: float) -> None:
        """The deprecated SET_MODE (11)."""

    @abstractmethod
    def on_data_stream(self, stream: int, rate_hz: float, now: float) -> None:
        """REQUEST_DATA_STREAM."""

    @abstractmethod
    def on_param(self, name: str, now: float) -> None:
        """A parameter was set."""

    def on_file_transfer(self, payload: bytes, sender: tuple[int, int], now: float) -> None:
        """FILE_TRANSFER_PROTOCOL's payload. A vehicle without files ends sessions and has no such file, as PX4 answers
        for what is not there (mavlink_ftp.cpp: ENOENT becomes kErrFileNotFound); silence would make a client wait."""
        request = ftp.decode(b"\0\0\0" + payload)
        if request is None or request.opcode in (ftp.Op.ACK, ftp.Op.NAK):
            return
        ends = request.opcode in (0, ftp.Op.TERMINATE_SESSION, ftp.Op.RESET_SESSIONS)
        known = request.opcode <= ftp.Op.BURST_READ_FILE
        error = ftp.Error.FILE_NOT_FOUND if known else ftp.Error.UNKNOWN_COMMAND
        reply = ftp.Packet(
            request.seq + 1 & 0xFFFF,
            request.session,
            ftp.Op.ACK if ends else ftp.Op.NAK,
            b"" if ends else bytes([error]),
            req_opcode=request.opcode,
            offset=request.offset,
        )
        fields = {"target_system": sender[0], "target_component": sender[1]}
        self.tx.send(ftp.MESSAGE, {**fields, "payload": ftp.encode(reply)})

    @abstractmethod
    def begin_telemetry(self) -> Iterable[str]:
        """Boot: the names of the messages that this firmware has."""

    @abstractmethod
    def send_message(self, name: str, now: float) -> bool:
        """Send a telemetry message built from the present state; False if this vehicle has none of this name."""

    def tail_of(self, name: str) -> bytes:
        """Return what its firmware sends behind the fields that the dialect knows."""
        return b""

    def send_soon(self, name: str) -> None:
        """Send this message after the answer that is being worked out."""
        self._requested.append(name)

    def later(self, at: float, what: Callable[[], None]) -> None:
        """Do this at that time, unless the vehicle reboots before."""
        self._later.append((at, what))
        self._later.sort(key=lambda entry: entry[0])

    def begin_with(self, sets: Iterable[Mapping[str, Param]]) -> None:
        """Take these parameters in and boot with them, as if it had always had them."""
        reported = list(sets)
        for params in reported:
            self.params.take_in(params)
        if reported:
            self._boot(self._clock)

    # -- state others read

    @property
    def estimated(self) -> Body:
        """State as the autopilot estimates it; ``motion`` is the true one."""
        return self.sensors.estimated

    @property
    def reported(self) -> Body:
        """Return what telemetry says: what was believed a latency ago."""
        return self.sensors.reported

    @property
    def boot_ms(self) -> int:
        return max(0, round((self._clock - self.boot_at) * 1000))

    @property
    def unix_us(self) -> int:
        return max(0, round(self._unix_offset_us + self._clock * 1e6))

    @property
    def position_ok(self) -> bool:
        """GPS is there and the estimator has converged on it; by vision: poses come, and it was given an origin."""
        if self._clock - self.boot_at < self._ready_s:
            return False
        if self.by_vision:
            return self.vision.usable(self._clock) and self.local_zero is not None
        return not self.faults.gps_lost

    @property
    def gps_ok(self) -> bool:
        """A fix comes at half the time the estimator needs; a vehicle that flies by vision has no GPS."""
        return not self.by_vision and not self.faults.gps_lost and self._clock - self.boot_at >= self._ready_s / 2

    @property
    def current_item(self) -> int:
        """Item of the mission, counted from 0."""
        return self.run.seq

    @property
    def mode_rule(self) -> ModeRule:
        return self.firmware.modes.simulated.get(self.mode) or ModeRule(self.mode)

    @property
    def attitude_error_deg(self) -> float:
        """Between where it lies and what its controllers want; in flight the loop is taken as closed."""
        return self.motion.lean_deg if self.motion.crashed else 0.0

    @property
    def landed_state(self) -> int:
        if self.landed:
            return m.MAV_LANDED_STATE_ON_GROUND
        if self.plan.landing:
            return m.MAV_LANDED_STATE_LANDING
        return m.MAV_LANDED_STATE_TAKEOFF if self.taking_off else m.MAV_LANDED_STATE_IN_AIR

    @property
    def local_origin(self) -> Home:
        """Return what its local frame is about: what a ground station set, else where it was first powered."""
        return self.local_zero or Home(0.0, 0.0, 0.0)

    def true_position(self) -> tuple[float, float, float]:
        """True position, (lat_deg, lon_deg, alt_amsl_m), independent of the estimate."""
        lat_deg, lon_deg = self.where.to_geodetic(self.motion.east_m, self.motion.north_m)
        return lat_deg, lon_deg, self.where.alt_amsl_m + self.motion.up_m

    def sysid_of_params(self) -> int:
        """Return what the parameter says; 1 if that is no system id."""
        sysid = int(self.params[self.sysid_param])
        return sysid if 1 <= sysid <= 255 else 1

    def control_gains(self) -> ControlGains:
        """Gains as the parameters say, within what can be flown."""
        p, names = self.params, self.firmware.control_gains.simulated
        jerk_xy, jerk_z = names.jerk_xy, names.jerk_z
        return ControlGains(
            xy_p=max(0.1, p[names.xy_p]),
            xy_vel_p=max(0.1, p[names.xy_vel_p]),
            xy_vel_i=max(0.0, p[names.xy_vel_i]),
            xy_vel_d=max(0.0, p[names.xy_vel_d]),
            z_p=max(0.1, p[names.z_p]),
            z_vel_p=max(0.1, p[names.z_vel_p]),
            z_vel_i=max(0.0, p[names.z_vel_i]) if names.z_vel_i else 0.0,
            tilt_max_rad=radians(max(10.0, min(80.0, p[names.tilt_max] * names.tilt_unit_deg))),
            jerk_xy_mps3=max(1.0, p[jerk_xy]) if jerk_xy else inf,
            jerk_z_mps3=max(1.0, p[jerk_z]) if jerk_z else inf,
        )

    def height_m(self) -> float:
        """Above home."""
        return self.reported.up_m - (self.home.up_m if self.home else 0.0)

    # -- orders both firmwares carry out alike

    def arm(self, now: float) -> None:
        self.armed = True
        self.armed_at = now
        self.flown_since_arming = False
        if not self.home_fixed:
            self.set_home_here()

    def disarm(self) -> None:
        self.armed = False
        self.taking_off = False
        self.plan.fly()

    def reported_target_enu_m(self) -> Vector | None:
        """The place it reports as its target (POSITION_TARGET_GLOBAL_INT, which only ArduCopter has here)."""
        return None

    def hold_here(self) -> None:
        """Stop and stay where it comes to a stop; on the ground: stay there."""
        if self.landed:
            self.plan.fly()
            return
        body = self.estimated
        speed = body.groundspeed_mps
        slide_s = stopping_distance(speed, *self.firmware.brake.simulated) / speed if speed > 0.0 else 0.0
        self.plan.fly(GoTo(body.east_m + body.vel_e_mps * slide_s, body.north_m + body.vel_n_mps * slide_s, body.up_m))

    def land_at(self, east_m: float, north_m: float, speed_mps: float, *, not_before: float = 0.0) -> Land:
        """A landing there as the firmware flies it."""
        firmware = self.firmware
        fast, slow = firmware.land_fast_above_m.simulated, firmware.land_slow_below_m.simulated
        home_up = self.home.up_m if self.home else 0.0
        return Land(east_m, north_m, speed_mps, home_up + fast, home_up + slow, not_before)

    def set_home_here(self) -> None:
        if self.position_ok:
            self.set_home(Home(*self.estimated.pos_enu_m))

    def _follow_home(self, now: float) -> None:
        """Move home to where it stands disarmed, as its firmware does."""
        follows, home = self.firmware.home_follows.simulated, self.home
        if self.armed or follows is None or home is None or self.home_fixed:
            return
        if not self.landed or not self.position_ok or now < self._home_moved_at + follows.period_s:
            return
        here = self.estimated
        away_m, beside_m = abs(here.up_m - home.up_m), hypot(here.east_m - home.east_m, here.north_m - home.north_m)
        if away_m > follows.in_height_m or beside_m > follows.over_ground_m:
            self._home_moved_at = now
            self.set_home_here()

    def set_home(self, home: Home) -> None:
        self.home = home
        self.send_soon("HOME_POSITION")

    def set_local_origin(self, east_m: float, north_m: float, up_m: float) -> None:
        """Set the origin of the local frame, a point of `where`."""
        self.local_zero = Home(east_m, north_m, up_m)
        self.send_soon("GPS_GLOBAL_ORIGIN")

    def reboot(self, now: float) -> None:
        """Off at once, back after REBOOT_S; the parameters stay. In the air the motors stop and it falls."""
        self._flush()
        self.disarm()
        self._later.clear()
        self.boot_at = now + REBOOT_S
        self._rebooting = True

    # -- the inside

    def _boot(self, now: float) -> None:
        # clock, ids and pending output
        self.boot_at = now
        self._rebooting = False
        self.sysid = self.sysid_of_params()
        self.tx.restart(self.sysid)
        self._requested: list[str] = []
        self._later: list[tuple[float, Callable[[], None]]] = []
        # safety: readiness, failsafes, fence
        self._ready_s = self.firmware.ready_after_s.simulated * (1 + self.rng.spread(0.2))
        self._was_ready = False
        self.failsafes = Failsafes()
        self.fence_breach = m.FENCE_BREACH_NONE
        self.fence_breaches = 0
        # transfers and the mission are interrupted
        self.lists.forget_transfers()
        self.logs.reboot()
        self.run.leave()
        # state of flight
        self.armed = False
        self.armed_at = now
        self.landed = self.motion.on_ground
        self.taking_off = False
        self.touched_at: float | None = None
        self.landed_at = now
        self.flown_since_arming = False
        # estimator and calibration
        self.home = None
        self.home_fixed = False
        self._home_moved_at = now
        self.local_zero = None
        self.vision = ExternalVision(self.autopilot)
        self.calibration: Calibration | None = None
        self.side_down = "down"
        """Orientation on the ground, by PX4's name."""
        self.turned_by_hand = True
        """Somebody turns it as its calibration asks."""
        # telemetry, and control by the firmware's settings
        self.param_queue: list[int] = []
        self.streams = Streams(
            (n for n in self.begin_telemetry() if n in self.dialect.by_name), self.default_rates_hz, self.rng, now
        )
        self.rtk = RtkReceiver(whole_messages=self.autopilot != m.MAV_AUTOPILOT_PX4)
        self.plan.fly()
        self.position_control.gains = self.control_gains()
        self.on_boot(now)

    def _watch_position(self, now: float) -> None:
        if not self._was_ready and self.position_ok:
            self._was_ready = True
            self.set_home_here()
            self.on_ready(now)

    def _flush(self) -> None:
        self.tx.flush()
        requested, self._requested = self._requested, []
        for name in requested:
            self.send_message(name, self._clock)
