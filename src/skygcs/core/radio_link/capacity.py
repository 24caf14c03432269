"""Capacity of one shared radio: arithmetic on wire sizes, serial rate and timeslots, before anything flies.

Downlink: every vehicle sends its profile, all of it comes out of the ground radio's serial port. Uplink: everything for
all vehicles goes through the ground radio's one slot a round. The timeslot model is that of open SiK multipoint (one
slot of two full packets per node and a sync slot). Its figures are measured where there are such (`AirTiming`), else
those of open SiK: RFD900x firmware is closed and may schedule otherwise, so these are an order of magnitude. What
vehicles stream by their own settings is not in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

BITS_PER_BYTE = 10
"""8N1 on the serial port."""

FILL = 0.5
"""Share of a way that the plan uses: commands, acknowledgements, parameters, texts, losses and repeats get the rest
(field-notes 10.2 keeps to it on the serial port, and so does the air here)."""

HALF_DUPLEX_SHARE = 0.5
"""Part of the serial rate for the uplink, where nothing is known of the air, which carries both directions."""

SLOT_SHARE = 0.9
"""Part of the ground's timeslot that is used. Packets are not always full, since frames are not split."""

SETPOINT_SHARE = 0.5
"""Part of the uplink, less what it carries otherwise, for the setpoints of all vehicles: the rest is for commands."""

FLOWN_HZ: Mapping[str, float] = {"position": 5.0, "velocity": 10.0, "attitude": 20.0}
"""Setpoints a second with which each mode is flown unless the fleet file says otherwise (attitude: at least)."""

PACKET_BYTES = 252
SLOT_BYTES = 2 * PACKET_BYTES
"""Bytes that a node sends in its slot: the window holds two full packets."""

SLOT_BITS, SLOT_LATENCY_S = 4602, 0.0093
SYNC_BITS, SYNC_LATENCY_S = 946, 0.0038
"""Slot and sync slot: what is sent at the air speed, and switching over. Fitted to the firmware's own arithmetic at 64
and 250 kbit/s with 2 to 16 nodes (field-notes 8.2); at 125 kbit/s within 2 %."""

MAX_NODES = 16
"""Node ids of RFD900x multipoint firmware."""

OFFBOARD_MIN_HZ = 2.0
OFFBOARD_LOSS_S = 1.0
"""PX4 wants setpoints at this rate, and leaves OFFBOARD when none came for COM_OF_LOSS_T."""

FRAME_BYTES: Mapping[str, int] = {
    "HEARTBEAT": 21,
    "SYS_STATUS": 55,
    "GPS_RAW_INT": 64,
    "ATTITUDE": 40,
    "LOCAL_POSITION_NED": 40,
    "GLOBAL_POSITION_INT": 40,
    "SET_ATTITUDE_TARGET": 51,
    "SET_POSITION_TARGET_LOCAL_NED": 65,
    "COMMAND_INT": 47,
}
"""MAVLink 2, unsigned, nothing trimmed: payload and 12 (field-notes 10.1). Real frames may be shorter."""

PROFILES: Mapping[str, Mapping[str, float]] = {
    "monitor": {"HEARTBEAT": 1, "SYS_STATUS": 0.5, "GPS_RAW_INT": 0.5, "GLOBAL_POSITION_INT": 1},
    "nav": {"HEARTBEAT": 1, "SYS_STATUS": 0.5, "GPS_RAW_INT": 0.5, "GLOBAL_POSITION_INT": 2, "ATTITUDE": 1},
    "control": {"HEARTBEAT": 1, "SYS_STATUS": 0.2, "GPS_RAW_INT": 0.2, "GLOBAL_POSITION_INT": 5},
    "control-10": {"HEARTBEAT": 1, "SYS_STATUS": 0.2, "GPS_RAW_INT": 0.2, "GLOBAL_POSITION_INT": 10},
    "full": {"HEARTBEAT": 1, "SYS_STATUS": 0.2, "GPS_RAW_INT": 0.2, "GLOBAL_POSITION_INT": 10, "ATTITUDE": 10},
}
"""Hz of each message from one vehicle (field-notes 10.2; the position there, LOCAL_POSITION_NED, is as long)."""

SETPOINTS: Mapping[str, str | None] = {
    "none": None,
    "position": "SET_POSITION_TARGET_LOCAL_NED",
    "velocity": "SET_POSITION_TARGET_LOCAL_NED",
    "attitude": "SET_ATTITUDE_TARGET",
}
"""Message that is streamed up to each vehicle, by kind of setpoint; none: single orders such as goto."""

UNSCALED = frozenset({"HEARTBEAT"})
"""Kept at its rate however little room there is: without it a vehicle counts as lost."""


ASSUMED = "assumed, as open SiK multipoint"
"""Origin of a timing that was not measured."""


@dataclass(frozen=True, slots=True)
class AirTiming:
    """Timeslots of a multipoint network at one air speed. ``source``: "assumed …", or "measured on …"."""

    slot_s: float
    sync_s: float
    slot_bytes: float = SLOT_BYTES
    source: str = ASSUMED

    def round_s(self, nodes: int) -> float:
        """Until it is a node's turn again."""
        return nodes * self.slot_s + self.sync_s


def slot_s(air_kbps: float) -> float:
    """How long one node's slot is."""
    return SLOT_LATENCY_S + SLOT_BITS / (air_kbps * 1000)


def assumed_timing(air_kbps: float) -> AirTiming:
    """The timeslots of open SiK multipoint at this air speed."""
    return AirTiming(slot_s(air_kbps), SYNC_LATENCY_S + SYNC_BITS / (air_kbps * 1000))


def round_s(air_kbps: float, nodes: int) -> float:
    """Until it is a node's turn again, as assumed."""
    return assumed_timing(air_kbps).round_s(nodes)


def uplink_bytes_per_s(baud: int, timing: AirTiming | None, nodes: int, share: float | None = None) -> float:
    """Return what may go up. ``share``: instead of `HALF_DUPLEX_SHARE` of the serial rate or `SLOT_SHARE` of the
    slot."""
    serial = baud / BITS_PER_BYTE
    if timing is None:
        return serial * (share or HALF_DUPLEX_SHARE)
    return min(serial, timing.slot_bytes / timing.round_s(nodes)) * (share or SLOT_SHARE)


def setpoint_bytes_per_s(uplink: float, taken: float, vehicles: int, share: float = SETPOINT_SHARE) -> float:
    """Return what one of so many vehicles has for its setpoints, of an uplink that carries ``taken`` otherwise: the
    budget of `link plan` and of everything that is flown by setpoints."""
    return share * max(0.0, uplink - taken) / vehicles


def profile_bytes_per_s(rates_hz: Mapping[str, float]) -> float:
    """Bytes a second of one vehicle. Raises KeyError for a message whose size is not known here."""
    return sum(FRAME_BYTES[name] * rate for name, rate in rates_hz.items())


@dataclass(frozen=True, slots=True)
class LinkDemand:
    """Demand that is to be planned."""

    vehicles: int
    baud: int = 57600
    air_kbps: float | None = 64.0
    """None: no timeslots (a cable, a pair of radios for one vehicle, Wi-Fi)."""
    profile: str = "nav"
    rates_hz: Mapping[str, float] = field(default_factory=lambda: PROFILES["nav"])
    setpoint: str = "none"
    setpoint_hz: float = 0.0
    fill: float = FILL
    measured: Mapping[float, AirTiming] = field(default_factory=dict)
    """Measured timing by air speed in kbit/s; at other air speeds it is assumed."""

    @property
    def timing(self) -> AirTiming | None:
        """The timeslots at its air speed, measured or assumed; None for a link without timeslots."""
        if self.air_kbps is None:
            return None
        return self.measured.get(self.air_kbps) or assumed_timing(self.air_kbps)

    @property
    def nodes(self) -> int:
        return self.vehicles + 1

    @property
    def down_per_vehicle_bytes_per_s(self) -> float:
        return profile_bytes_per_s(self.rates_hz)

    @property
    def up_per_vehicle_bytes_per_s(self) -> float:
        message = SETPOINTS[self.setpoint]
        return 0.0 if message is None else FRAME_BYTES[message] * self.setpoint_hz


@dataclass(frozen=True, slots=True)
class Direction:
    """One of the four narrow places, in bytes/s: what is needed, what it has, and how much of that the plan may use."""

    name: str
    needed: float
    capacity: float
    usable: float

    @property
    def share(self) -> float:
        return self.needed / self.capacity

    @property
    def fits(self) -> bool:
        return self.needed <= self.usable + 1e-9


@dataclass(frozen=True, slots=True)
class LinkPlan:
    """The answer: fits or not and why, how many would, what each gets, and what else to do."""

    demand: LinkDemand
    directions: tuple[Direction, ...]
    round_s: float | None
    most_vehicles: int
    """That this profile and these setpoints leave room for."""
    most_streamed: int
    """Vehicles that `plan run` flies by position setpoints over it; more are flown by goto."""
    rates_hz: Mapping[str, float]
    """Rate that each vehicle gets of each wanted message; less than wanted where it does not fit."""
    setpoint_hz: float
    problems: tuple[str, ...]
    proposals: tuple[str, ...]

    @property
    def fits(self) -> bool:
        return not self.problems


def plan_link(demand: LinkDemand) -> LinkPlan:
    """Work it out. ``demand.vehicles`` is at least 1, rates are not negative."""
    directions = _ways(demand)
    problems = [_tight(direction) for direction in directions if not direction.fits]
    if demand.air_kbps is not None and demand.nodes > MAX_NODES:
        problems.append(f"{demand.nodes} nodes: RFD900x multipoint has {MAX_NODES} node ids, one of them the ground's")
    problems += _too_slow_for_setpoints(demand)
    down = min((w.usable / w.needed for w in directions if w.name.startswith("down") and w.needed), default=1.0)
    up = min((w.usable / w.needed for w in directions if w.name.startswith("up") and w.needed), default=1.0)
    return LinkPlan(
        demand,
        directions,
        None if (timing := demand.timing) is None else timing.round_s(demand.nodes),
        _most_vehicles(demand),
        _most_vehicles(replace(demand, setpoint="position", setpoint_hz=FLOWN_HZ["position"], fill=SETPOINT_SHARE)),
        _scaled(demand, min(1.0, down)),
        demand.setpoint_hz * min(1.0, up) if SETPOINTS[demand.setpoint] else 0.0,
        tuple(problems),
        tuple(_proposals(demand)) if problems else (),
    )


def _ways(demand: LinkDemand) -> tuple[Direction, ...]:
    serial = demand.baud / BITS_PER_BYTE
    down, up = demand.down_per_vehicle_bytes_per_s, demand.up_per_vehicle_bytes_per_s
    heartbeat = FRAME_BYTES["HEARTBEAT"]  # one a second from the ground, for all
    all_up = up * demand.vehicles + heartbeat

    def usable_up(timing: AirTiming | None) -> float:
        uplink = uplink_bytes_per_s(demand.baud, timing, demand.nodes)
        return heartbeat + demand.vehicles * setpoint_bytes_per_s(uplink, heartbeat, demand.vehicles, demand.fill)

    directions = [
        Direction("down, ground serial", down * demand.vehicles, serial, serial * demand.fill),
        Direction("up, ground serial", all_up, serial, usable_up(None)),
    ]
    if (timing := demand.timing) is not None:
        slot = timing.slot_bytes / timing.round_s(demand.nodes)
        directions += [
            Direction("down, a vehicle's slot", down, slot, slot * demand.fill),
            Direction("up, the ground's slot", all_up, slot, usable_up(timing)),
        ]
    return tuple(directions)


def _tight(direction: Direction) -> str:
    return (
        f"{direction.name} carries {direction.capacity:,.0f} B/s, of which {direction.usable:,.0f} may be planned "
        f"with; {direction.needed:,.0f} are wanted"
    )


def _too_slow_for_setpoints(demand: LinkDemand) -> list[str]:
    if (timing := demand.timing) is None or SETPOINTS[demand.setpoint] is None:
        return []
    duration = timing.round_s(demand.nodes)
    if duration > 1 / OFFBOARD_MIN_HZ:
        return [
            f"setpoints: the ground sends once a round, every {duration:.2f} s; PX4 wants {OFFBOARD_MIN_HZ:g} Hz, and "
            f"leaves OFFBOARD after {OFFBOARD_LOSS_S:g} s without: "
            + ("a round is longer" if duration > OFFBOARD_LOSS_S else f"one lost slot makes {2 * duration:.2f} s")
        ]
    return []


def _most_vehicles(demand: LinkDemand) -> int:
    most = 0
    limit = MAX_NODES - 1 if demand.air_kbps is not None else 254
    for vehicles in range(1, limit + 1):
        trial = replace(demand, vehicles=vehicles)
        if not all(direction.fits for direction in _ways(trial)) or _too_slow_for_setpoints(trial):
            break
        most = vehicles
    return most


def _scaled(demand: LinkDemand, factor: float) -> dict[str, float]:
    """The rates that fit: all by one factor, but those that must be kept."""
    kept = {name: rate for name, rate in demand.rates_hz.items() if name in UNSCALED}
    room = demand.down_per_vehicle_bytes_per_s * factor - profile_bytes_per_s(kept)
    others = demand.down_per_vehicle_bytes_per_s - profile_bytes_per_s(kept)
    scale = min(1.0, max(0.0, room / others)) if others else 0.0
    return {name: rate if name in kept else rate * scale for name, rate in demand.rates_hz.items()}


GOTO = "one goto per vehicle (47 B each; land and rtl for all of them in one frame) instead of streaming setpoints"
"""A goto is a COMMAND_INT; what all get alike goes out as one broadcast COMMAND_LONG (`runtime.fleet`)."""


def _proposals(demand: LinkDemand) -> list[str]:
    """Return what makes it fit, the one that costs least first; then how many vehicles fit as it is, and what gets more
    in."""
    reach = {text: _most_vehicles(trial) for text, trial in _changes(demand)}
    found = [text for text, most in reach.items() if most >= demand.vehicles]
    if not found and demand.setpoint != "none":
        singly = replace(demand, setpoint="none", setpoint_hz=0.0)
        both = (text for text, trial in _changes(singly) if _most_vehicles(trial) >= demand.vehicles)
        found = [f"{GOTO}, and {text}" for text in both]
    best = _most_vehicles(demand)
    if best:
        found.append(f"{_vehicles(best)} instead of {demand.vehicles}, the others on a second radio or on Wi-Fi")
    for text, most in reach.items():
        if best < most < demand.vehicles:
            found.append(f"{text} for up to {_vehicles(most)}")
            best = most
    return found or ["another way than this radio: Wi-Fi"]


def _changes(demand: LinkDemand) -> list[tuple[str, LinkDemand]]:
    """Changes of one thing."""
    tried: list[tuple[str, LinkDemand]] = []
    if demand.setpoint != "none":
        tried.append((GOTO, replace(demand, setpoint="none", setpoint_hz=0.0)))
    for name, rates in sorted(PROFILES.items(), key=lambda item: -profile_bytes_per_s(item[1])):
        if profile_bytes_per_s(rates) < demand.down_per_vehicle_bytes_per_s:
            tried.append((f"profile {name}", replace(demand, profile=name, rates_hz=rates)))
    if demand.air_kbps is not None:
        faster = (125.0, 250.0)
        tried += [(f"air speed {a:g} kbit/s", replace(demand, air_kbps=a)) for a in faster if a > demand.air_kbps]
    return tried + [(f"{baud} baud", replace(demand, baud=baud)) for baud in (115200, 230400) if baud > demand.baud]


def _vehicles(count: int) -> str:
    return f"{count} vehicle{'s' if count > 1 else ''}"


@dataclass(frozen=True, slots=True)
class RadioRates:
    """Rates of a radio known beforehand. ``air_kbps`` None: nothing of its air, so no timeslots are counted."""

    baud: int = 57600
    air_kbps: float | None = None
    nodes: int | None = None
    """Nodes of a multipoint network with the ground's; None: the vehicles that are heard, and the ground."""
    duty_cycle: float = 1.0
    """Part of its time in which the radio may send."""
    uplink_share: float | None = None
    """Instead of HALF_DUPLEX_SHARE of the serial rate or SLOT_SHARE of the slot."""
    measured: AirTiming | None = None
    """Measured timing at this air speed; None: it is assumed."""

    @property
    def timing(self) -> AirTiming | None:
        """Timeslots of the air, measured if they were; None: nothing is known of it."""
        return None if self.air_kbps is None else self.measured or assumed_timing(self.air_kbps)

    @property
    def slot_bytes(self) -> float:
        """Bytes that a node sends in its slot."""
        return SLOT_BYTES if (timing := self.timing) is None else timing.slot_bytes

    def base_bytes_per_s(self, vehicles: int) -> float:
        """Return what may go up with so many vehicles behind it while the radio reports nothing else."""
        nodes = self.node_count(vehicles)
        return uplink_bytes_per_s(self.baud, self.timing, nodes, self.uplink_share) * self.duty_cycle

    def node_count(self, vehicles: int) -> int:
        """Nodes of the network, never fewer than are heard."""
        return max(self.nodes or 2, vehicles + 1, 2)

    def round_s(self, vehicles: int) -> float | None:
        """Until the ground may send again; None without timeslots."""
        return None if (timing := self.timing) is None else timing.round_s(self.node_count(vehicles))
