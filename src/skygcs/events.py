"""An event: what the log, the operator and RPC subscribers get when something changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Event:
    """One change of state. ``text`` is a sentence for a person, ``data`` (JSON-able) is for programs.

    ``vehicle`` and ``sysid`` are None where it concerns no vehicle. Kinds in use:
    vehicle_discovered vehicle_lost vehicle_back vehicle_forgotten armed disarmed mode landed system_status statustext
    reboot failsafe command control mission fence origin conflict duplicate link_up link_down link_degraded
    link_recovered route signing recorder params third_party undo separation uplink_lost uplink_back
    authority unattended takeoff alarm mocap corrections companion ground_lost federation warning
    fault
    """

    kind: str
    vehicle: str | None
    sysid: int | None
    text: str
    data: Mapping[str, Any] = field(default_factory=dict)
