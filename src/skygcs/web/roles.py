"""What each role may call: explicit lists of the daemon's methods. Pure.

A method of the daemon that stands in none of the lists is refused to the role view; a test compares the lists with the
daemon's table, so that each new method is sorted in here.
"""

from __future__ import annotations

from typing import Literal

from skygcs.web.sign_in import Role

Access = Literal["read", "order", "ends flight", "refused"]

READ = frozenset(
    {
        "daemon.info",
        "vehicles.list",
        "vehicles.get",
        "components.list",
        "messages.latest",
        "messages.list",
        "commands.list",
        "links.list",
        "router.stats",
        "events.recent",
        "recorder.status",
        "origin.get",
        "params.status",
        "control.status",
        "trajectory.status",
        "monitor.status",
        "missions.status",
        "link.status",
        "corrections.status",
        "signing.status",
        "preflight.status",
        "undo.list",
        "rpc.discover",
    }
)
"""They ask the daemon and no vehicle: nothing is sent because of them."""

ENDS_FLIGHT = frozenset({"vehicles.stop", "vehicles.hold", "vehicles.land", "vehicles.rtl", "vehicles.disarm"})
"""Orders that have a connection of their own, so that nothing is in front of them."""

NOT_PASSED_ON = frozenset({"subscribe", "unsubscribe", "auth", "operator.relay", "corrections.send"})
"""The web process subscribes once for all pages; corrections are a stream of bytes that no page has."""


def access(method: str) -> Access:
    """How a method of the daemon is treated."""
    if method in READ:
        return "read"
    if method in ENDS_FLIGHT:
        return "ends flight"
    return "refused" if method in NOT_PASSED_ON else "order"


def may(role: Role, method: str) -> bool:
    """True if the role may call this method of the daemon."""
    kind = access(method)
    return kind == "read" or (kind != "refused" and role == "command")
