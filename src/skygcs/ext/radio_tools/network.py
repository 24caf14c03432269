"""A multipoint network as a whole: what each of its radios must hold, and what is wrong with radios as they are.

One master owns the timeslots: node 1 of an RFD900x network, node 0 of an open SiK one. It stays on the ground, at the
radio that skygcs uses. Node ids have nothing to do with MAVLink system ids; vehicles get them in the order of theirs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from skygcs.errors import RefusedError
from skygcs.ext.radio_tools.settings import RFD_LAST_NODE, SERIAL_BAUD, Firmware, RadioState, inconsistencies

SHARED = ("NETID", "AIR_SPEED", "ECC", "MIN_FREQ", "MAX_FREQ", "NUM_CHANNELS", "MANCHESTER", "LBT_RSSI", "MAX_WINDOW",
          "ENCRYPTION_LEVEL", "RATE/FREQBAND")  # fmt: skip
"""Settings that all radios of a network must have alike to hear each other in time."""

GROUND = "ground"


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Settings that all radios of a network have alike."""

    net_id: int = 0
    air_speed_kbps: int = 64
    serial_baud: int = 57600
    rtscts: bool = True
    duty_cycle_percent: int = 100
    to_ground_only: bool = False
    """Vehicles send to the master alone: other vehicles' serial ports stay quiet."""
    antennas: int | None = None
    """ANT_MODE of the vehicles' radios; None: it stays as it is."""
    ground_antennas: int | None = None
    """ANT_MODE of the ground's radio."""
    extra: Mapping[str, int] = field(default_factory=dict)
    """Further settings, by the radios' names."""


@dataclass(frozen=True, slots=True)
class NetworkPlan:
    """A network to be: ``members`` in the order of their node ids, the ground first."""

    members: tuple[str, ...]
    nodes: int
    """Slots in a round, those without a member as well."""
    common: NetworkSettings = NetworkSettings()

    def settings(self, position: int, firmware: Firmware) -> dict[str, int]:
        """Return what the radio of the member at ``position`` (0: ground) must hold. NODECOUNT stands for the node
        table where that is no register. Raises RefusedError for firmware that makes no such network."""
        if firmware not in (Firmware.RFD_MULTIPOINT, Firmware.SIK_MULTIPOINT):
            raise RefusedError(
                f"its firmware is {firmware}, which makes no network of several nodes; load multipoint firmware first "
                "(RFD Modem Tools), then run this again"
            )
        master = 1 if firmware is Firmware.RFD_MULTIPOINT else 0
        everyone = 255 if firmware is Firmware.RFD_MULTIPOINT else 65535
        settings = {
            "NODEID": master + position,
            "NODEDESTINATION": master if self.common.to_ground_only and position else everyone,
            "NETID": self.common.net_id,
            "AIR_SPEED": self.common.air_speed_kbps,
            "SERIAL_SPEED": next(code for code, baud in SERIAL_BAUD.items() if baud == self.common.serial_baud),
            "MAVLINK": 1,
            "RTSCTS": int(self.common.rtscts),
            "DUTY_CYCLE": self.common.duty_cycle_percent,
        }
        if firmware is Firmware.SIK_MULTIPOINT:
            settings["NODECOUNT"] = self.nodes
        elif position == 0:
            settings |= {"NETCOUNT": 1, "NODECOUNT": self.nodes}
        return settings | self._antennas(position, firmware) | dict(self.common.extra)

    def _antennas(self, position: int, firmware: Firmware) -> dict[str, int]:
        """ANT_MODE of the member at ``position``, if one is given. Raises RefusedError for firmware without it."""
        mode = self.common.antennas if position else self.common.ground_antennas
        if mode is None:
            return {}
        if firmware is not Firmware.RFD_MULTIPOINT:
            raise RefusedError(f"its firmware is {firmware}, which has no ANT_MODE: leave the antennas out")
        return {"ANT_MODE": mode}

    def name(self, position: int) -> str:
        return self.members[position] if position < len(self.members) else "spare"


def plan_network(
    vehicles: Sequence[str], nodes: int | None, common: NetworkSettings = NetworkSettings()
) -> NetworkPlan:
    """The network of the ground and these vehicles (by system id). ``nodes`` counts all radios, spare ones as well;
    None: as many as needed. Raises RefusedError with what does not go together."""
    members = (GROUND, *vehicles)
    count = len(members) if nodes is None else nodes
    plan = NetworkPlan(members, count, common)
    problems = []
    if count < 2:
        problems.append("a network has at least two nodes; are there vehicles in the fleet file?")
    if count < len(members):
        problems.append(
            f"{count} nodes are too few for {len(vehicles)} vehicles and the ground: give --nodes {len(members)}"
        )
    if count > RFD_LAST_NODE:
        problems.append(
            f"RFD900x multipoint has {RFD_LAST_NODE} node ids, {count} are wanted; use two networks, or Wi-Fi"
        )
    if common.serial_baud not in SERIAL_BAUD.values():
        problems.append(f"a radio's serial port has no rate of {common.serial_baud} baud")
    followed = {"NODEID", "NODECOUNT", "FORMAT"}
    if common.antennas is not None or common.ground_antennas is not None:
        followed.add("ANT_MODE")
    taken = sorted(followed & {name.upper() for name in common.extra})
    if taken:
        problems.append(f"{', '.join(taken)} follows from the plan and cannot be given")
    if problems:
        raise RefusedError("; ".join(problems))
    return plan


def check_network(radios: Mapping[str, RadioState]) -> list[str]:
    """Return what is wrong with these radios as one network, one line each; by the name of each radio."""
    found = [f"{where}: {text}" for where, r in radios.items() for text in inconsistencies(r.values, r.firmware)]
    if len(kinds := {r.firmware for r in radios.values()}) > 1:
        found.append("radios with different firmware do not hear each other: " + ", ".join(sorted(kinds)))
    for name in SHARED:
        held = {where: r.values[name] for where, r in radios.items() if name in r.values}
        if len(set(held.values())) > 1:
            found.append(f"{name} differs: " + ", ".join(f"{where} {value}" for where, value in held.items()))
    return found + _check_nodes(radios)


def _check_nodes(radios: Mapping[str, RadioState]) -> list[str]:
    nodes = {where: r.node for where, r in radios.items() if r.node is not None}
    if not nodes:
        return []
    found = []
    for node, times in Counter(nodes.values()).items():
        if times > 1:
            where_used = ", ".join(where for where, n in nodes.items() if n == node)
            found.append(
                f"node id {node} is in {times} radios ({where_used}): their frames collide; give "
                "each an id of its own, at its own port: skygcs-cli radio set PORT NODEID=N"
            )
    first = next(iter(radios.values())).firmware
    master = 1 if first is Firmware.RFD_MULTIPOINT else 0
    if len(radios) > 1 and master not in nodes.values():
        found.append(f"none of them is the master (node {master}): without it nobody sends")
    counts = {r.values["NODECOUNT"] for r in radios.values() if "NODECOUNT" in r.values}
    if len(counts) > 1:
        found.append(f"NODECOUNT differs: {', '.join(map(str, sorted(counts)))}")
    return found
