"""Methods that each role may call: explicit lists of the daemon's methods. Pure.

A method that stands in none of the lists is refused. A test compares them with the table of the daemon, so that each
new method is sorted in here.
"""

from __future__ import annotations

from typing import Literal

from skygcs.web.sign_in import Role

Access = Literal["read", "order", "ends flight", "refused"]

READ = frozenset(
    {
        "alarms.list",
        "authority.status",
        "clock.read",
        "commands.list",
        "companions.status",
        "components.list",
        "control.status",
        "corrections.status",
        "daemon.info",
        "drills.status",
        "events.recent",
        "link.status",
        "links.list",
        "messages.latest",
        "messages.list",
        "missions.status",
        "formation.status",
        "mocap.status",
        "monitor.status",
        "origin.get",
        "params.status",
        "plan.jobs",
        "plan.status",
        "preflight.status",
        "recorder.status",
        "recordings.list",
        "ros.settings",
        "ros.status",
        "router.stats",
        "rpc.discover",
        "shell.status",
        "signing.status",
        "trajectory.paths",
        "trajectory.status",
        "undo.list",
        "vehicles.get",
        "vehicles.list",
    }
)
"""They ask the daemon and no vehicle: nothing is sent because of them."""

ENDS_FLIGHT = frozenset(
    {
        "formation.stop",
        "missions.end_turns",
        "missions.pause",
        "plan.abort",
        "plan.land",
        "plan.pause",
        "trajectory.abort",
        "trajectory.pause",
        "vehicles.disarm",
        "vehicles.hold",
        "vehicles.land",
        "vehicles.rtl",
        "vehicles.stop",
    }
)
"""Orders that end or stop a flight. They have a connection of their own, so that nothing is in front of them."""

ORDERS = frozenset(
    {
        "alarms.acknowledge",
        "control.gains",
        "control.record",
        "control.set",
        "control.setpoint",
        "corrections.survey",
        "drills.begin",
        "drills.end",
        "fence.set",
        "fence.status",
        "fence.test",
        "formation.guide",
        "formation.move",
        "formation.scale",
        "formation.start",
        "formation.turn",
        "link.select",
        "links.add",
        "links.change",
        "links.remove",
        "logs.get",
        "logs.list",
        "messages.send",
        "missions.clear",
        "missions.download",
        "missions.resume",
        "missions.set_current",
        "missions.start",
        "missions.upload",
        "origin.from_vehicle",
        "origin.push",
        "origin.set",
        "params.cancel",
        "params.get",
        "params.list",
        "params.metadata",
        "params.set",
        "plan.cancel",
        "plan.certify",
        "plan.check",
        "plan.load",
        "plan.make",
        "plan.resume",
        "plan.run",
        "plan.speed",
        "plan.unload",
        "plan.upload",
        "preflight.run",
        "recordings.end",
        "recordings.replay",
        "signing.off",
        "signing.reset_clock",
        "signing.setup",
        "trajectory.load",
        "trajectory.resume",
        "trajectory.speed",
        "trajectory.start",
        "trajectory.unload",
        "undo.drop",
        "undo.run",
        "vehicles.arm",
        "vehicles.command",
        "vehicles.forget",
        "vehicles.goto",
        "vehicles.interval",
        "vehicles.mode",
        "vehicles.calibrate",
        "vehicles.calibrate_cancel",
        "vehicles.calibrate_confirm",
        "vehicles.reboot",
        "vehicles.renumber",
        "vehicles.request",
        "vehicles.set_home",
        "vehicles.stream",
        "vehicles.takeoff",
    }
)
"""Methods that change something, send something to a vehicle or occupy the daemon for long."""

STATION_ORDERS = frozenset({"federation.outcome"})
"""Orders among the station socket's own methods. Asking for the outcome of an order that has not come to its site
refuses that order there, so a client that may only look must not ask."""

NOT_PASSED_ON = frozenset(
    {
        *("auth", "corrections.send", "operator.active", "operator.relay", "subscribe", "unsubscribe"),
        *("companion.contact", "companion.order", "companion.setpoint"),
        *("authority.grant", "authority.revoke", "ros.report"),
        *("shell.close", "shell.open", "shell.read", "shell.write"),
    }
)
"""The web process subscribes once for all pages; corrections are a stream of bytes that no page has; a
companion is called by its ground, which keeps the numbers; authority is granted by the holder of a lease;
the process of ROS reports about itself; a shell is its client's, and all pages are one client."""


def access(method: str) -> Access:
    """How a method of the daemon is treated; one that is not listed is passed on for nobody."""
    if method in READ:
        return "read"
    if method in ENDS_FLIGHT:
        return "ends flight"
    return "order" if method in ORDERS or method in STATION_ORDERS else "refused"


def may(role: Role, method: str) -> bool:
    """True if the role may call this method of the daemon."""
    kind = access(method)
    return kind == "read" or (kind != "refused" and role == "command")
