"""One channel in the routing table, and the rules between two channels (see the table in `core.routing.router`)."""

from __future__ import annotations

from skygcs.core.routing.decision import Decision
from skygcs.core.routing.filters import ChannelPolicy

# Kinds of broadcast, as bits: each has its own cached list of destinations per channel.
TELEMETRY = 1
UNKNOWN_ID = 2
OF_RADIO = 4
KIND_BITS = 3


class Port:
    """One channel in the routing table."""

    __slots__ = (
        "boot_ms",
        "bound",
        "broadcast",
        "conflict_at",
        "echoes",
        "filter_in",
        "filter_out",
        "filtered_in",
        "filtered_out",
        "heard",
        "id",
        "limited",
        "limiter_in",
        "limiter_out",
        "of_system",
        "out_of_bounds",
        "policy",
        "refused",
        "routes_evicted",
        "routes_refused",
        "vehicles",
    )

    def __init__(self, channel_id: int, policy: ChannelPolicy) -> None:
        self.id = channel_id
        self.policy = policy
        self.bound = policy.vehicles
        self.filter_in = policy.filter_in or None
        self.filter_out = policy.filter_out or None
        self.limiter_in = policy.limiter_in() or None
        self.limiter_out = policy.limiter_out() or None
        self.heard: dict[int, float] = {}
        self.of_system: dict[int, set[int]] = {}
        """The sources in ``heard`` by system."""
        self.echoes: set[int] = set()
        self.boot_ms: dict[int, int] = {}
        self.vehicles: set[int] = set()
        self.broadcast: dict[int, tuple[Decision, tuple[Port, ...]]] = {}
        self.conflict_at = float("-inf")
        self.routes_refused = 0
        self.routes_evicted = 0
        self.filtered_in = 0
        self.filtered_out = 0
        self.limited = 0
        self.out_of_bounds = 0
        self.refused: set[int] = set()
        """Targets out of bounds that were reported."""

    def may_hear(self, sysid: int) -> bool:
        """True if frames of this system may be sent there."""
        return not self.bound or sysid in self.bound

    @property
    def restricts_out(self) -> bool:
        """True if each frame to it must be checked."""
        return self.filter_out is not None or self.limiter_out is not None

    def may_forward(self, port: Port) -> bool:
        """True if frames from here may go there."""
        if port is self or port.policy.replayed or (self.policy.replayed and port.policy.role != "gcs"):
            return False
        return self.policy.group is None or self.policy.group != port.policy.group

    def takes_broadcast(self, port: Port, kind: int) -> bool:
        """True if a frame without a target from here goes there; ``kind``: the bits above."""
        if not self.may_forward(port):
            return False
        if kind & TELEMETRY and port.policy.carries_vehicles:
            return False
        if kind & UNKNOWN_ID and not port.policy.forward_unknown:
            return False
        if self.bound and not self._speaks_of_its_own_to(port):
            return False
        return not (kind & OF_RADIO and (port.policy.carries_vehicles or port.vehicles or port.bound))

    def _speaks_of_its_own_to(self, port: Port) -> bool:
        """True if a broadcast of a bound channel reaches only its own vehicles on this one."""
        if port.bound or any(autopilot >> 8 not in self.bound for autopilot in port.vehicles):
            return False
        return bool(port.vehicles) or not port.policy.carries_vehicles
