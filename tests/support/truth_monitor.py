"""The invariant "no vehicle in the air is unattended", judged by the simulator's truth alone.

It reads what the vehicles do (their legs, the arrival of setpoints) and what passes the link, never what the daemon
thinks. A vehicle is unattended while it follows a target that nobody renews. It has to be attended again:

    who fed it last                             and                                      within
    -----------------------------------------   --------------------------------------   ---------------------------
    the daemon, or it was heard first then      orders reach it                          `PROMISED_S`
    another program                             orders reach it                          its gap, then `PROMISED_S`
    a companion                                 orders reach it                          its silence, then `PROMISED_S`
    any                                         no order reached it meanwhile            `RETRIED_S` after they do again

Time counts while the vehicle is heard: from its first heartbeat that came through on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.unattended import REPEAT_S
from skygcs.core.vehicle.unattended import STREAM_S as PROGRAM_GAP_S
from skygcs.ext.companions.mirrored_control import REPORTS_SILENT_S
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from skygcs.sim.legs import Follow
from skygcs.sim.vehicle import SimVehicle

PROMISED_S = 1.0

RETRIED_S = REPEAT_S + 1.0
"""An order to hold that did not arrive is repeated."""

LOOK_S = 0.05

FED_S = 0.3
"""A stream of setpoints with a longer gap has ended, at the 4 Hz and more that everything here sends."""

ACTS_S = 0.1
"""Between the arrival of an order and its effect: two ticks of the simulator and one look."""

NOTED_S = 0.3
"""Who flies a vehicle is in the journal after a tick of the fleet and a write: what began later dies with a daemon that
is killed. docs/explanation/safety.md says so."""

HEARD_S = 1.3
"""One heartbeat a second, and the way."""

FOLLOWING = frozenset({Px4Mode.OFFBOARD, CopterMode.GUIDED, CopterMode.GUIDED_NOGPS})

SETPOINTS = frozenset({"SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"})


@dataclass(slots=True)
class Breach:
    """One time without anybody."""

    sysid: int
    since: float
    lasted_s: float
    fed_by: str
    text: str = ""


@dataclass
class TruthMonitor:
    """``link_up``: whether what the daemon sends to this system, and what it sends, comes through now."""

    sims: list[SimVehicle]
    daemon_ids: tuple[int, int]
    link_up: Callable[[int], bool]
    one_way_s: Callable[[], float] = lambda: 0.0
    breaches: list[Breach] = field(default_factory=list)
    looked: int = 0
    """Looks at a vehicle that followed setpoints in the air."""
    attended_again: int = 0
    """Times without anybody that ended."""

    def __post_init__(self) -> None:
        self._fed_by: dict[int, str] = {}
        self._fed_at: dict[int, float] = {}
        self._fed_since: dict[int, float] = {}
        self._not_noted: set[int] = set()
        self._dead = False
        self._heard_at: dict[int, float] = {}
        self._heard_since: dict[int, float] = {}
        self._up_since: dict[int, float] = {}
        self._was_up: dict[int, bool] = {}
        self._alone_since: dict[int, float] = {}
        self._reported: set[int] = set()

    # -- what passes

    def on_setpoint(self, frame: Frame, now: float) -> None:
        """A frame arrives at the vehicles."""
        if frame.info is None or frame.info.name not in SETPOINTS:
            return
        sysid = frame.target()[0]
        source = (frame.sysid, frame.compid)
        by = "daemon" if source == self.daemon_ids else "companion" if source[0] == sysid else "other"
        if by != self._fed_by.get(sysid) or now - self._fed_at.get(sysid, -FED_S) > FED_S:
            self._fed_since[sysid] = now
            if self._dead:  # it was on its way when the daemon died
                self._not_noted.add(sysid)
        self._fed_at[sysid], self._fed_by[sysid] = now, by

    def on_heartbeat(self, sysid: int, now: float) -> None:
        """A heartbeat comes to the daemon."""
        if now - self._heard_at.get(sysid, -HEARD_S) > HEARD_S:
            self._heard_since[sysid] = now
        self._heard_at[sysid] = now

    def daemon_died(self, now: float) -> None:
        """It was killed: what had just begun is not noted."""
        self._dead = True
        self._not_noted |= {sysid for sysid, since in self._fed_since.items() if 0.0 <= now - since < NOTED_S}

    def daemon_began(self) -> None:
        """Another daemon: it has heard nothing."""
        self._dead = False
        self._heard_at.clear()
        self._heard_since.clear()

    def begun_again(self) -> None:
        """One of two daemons is back; the other one has heard the vehicle all the while."""
        self._dead = False

    # -- the look

    def look(self, now: float) -> None:
        for sim in self.sims:
            self._look(sim, now)

    def _look(self, sim: SimVehicle, now: float) -> None:
        sysid = sim.sysid
        up = self.link_up(sysid)
        if up and not self._was_up.get(sysid, False):
            self._up_since[sysid] = now
        self._was_up[sysid] = up
        flies = sim.armed and not sim.motion.on_ground and sim.mode in FOLLOWING and isinstance(sim.plan.leg, Follow)
        self.looked += flies
        if not flies or now - self._fed_at.get(sysid, -FED_S) <= FED_S:
            self.attended_again += self._alone_since.pop(sysid, None) is not None
            self._reported.discard(sysid)
            if not flies:
                self._not_noted.discard(sysid)
            return
        since = self._alone_since.setdefault(sysid, self._fed_at.get(sysid, now))
        if now - self._heard_at.get(sysid, -HEARD_S) > HEARD_S or not up or sysid in self._reported | self._not_noted:
            return
        due = self._due(sysid, since)
        if now > due:
            self._reported.add(sysid)
            mode = CopterMode(sim.mode) if sim.mode in set(CopterMode) else Px4Mode(sim.mode)
            text = f"{mode.name}, heard since {self._heard_since[sysid]:.2f}"
            self.breaches.append(Breach(sysid, since, now - since, self._fed_by.get(sysid, "nobody"), text))

    def _due(self, sysid: int, since: float) -> float:
        """When it has to be attended again."""
        fed_by = self._fed_by.get(sysid, "")
        trip_s = 2 * self.one_way_s() + ACTS_S
        known_at = max(since + (PROGRAM_GAP_S if fed_by == "other" else 0.0), self._heard_since.get(sysid, since))
        if fed_by == "companion":
            known_at += REPORTS_SILENT_S  # a ground that begins anew gives it as long to be heard
        due = known_at + PROMISED_S + trip_s
        up_since = self._up_since.get(sysid, -1.0)
        return due if up_since <= since else max(due, up_since + RETRIED_S + trip_s)
