"""Every exception skygcs raises on purpose; the class says whose fault it is.

SkygcsError                  base; str() is one line for a person, never a traceback
├── ConfigError              the user's file: fleet TOML (file, key, what to do); carries every problem at once
├── DialectError             the user's message XML (file, line)
├── PlanFileError            a plan, mission or fence file that cannot be used (file, line or item)
├── TrajectoryError          a trajectory that cannot be flown (piece, axis)
├── TraceError               a control trace that cannot be read (line, reason)
├── LinkError                a device or an address: could not be opened, or broke
├── CompanionError           a vehicle's computer: not reached, or a step there failed (step, what, what to do)
├── BusError                 a message for the hub of a federation, or its answer (subject, what)
│   ├── HubAway              not sent: there is no connection to the hub
│   ├── NobodyThere          not carried out: nobody takes messages of this subject
│   ├── NotPermitted         not carried out: the hub does not let this station send it
│   └── ReplyLost            sent, and no answer came: nobody knows whether it was carried out
├── TargetError              a target that names no vehicle ("7", "alpha")
├── RefusedError             an order skygcs itself refuses (unsafe, wrong state); says how to insist if one can
│   ├── KeyFileError         a signing key's file that is not one, or that others can read (file, what to do)
│   └── NotReadyError        the same, but in a moment it may be taken
└── RpcError                 an answer of the JSON-RPC server that is an error (code, message, data)
    └── DaemonUnreachable    no daemon answers on the socket
        └── DaemonForbidden  the socket belongs to another user
"""

from __future__ import annotations

import errno
from typing import Any


class SkygcsError(Exception):
    """Base of all errors raised on purpose."""


class ConfigError(SkygcsError):
    """The fleet file is wrong. ``problems`` holds one line per problem, each with its key path."""

    def __init__(self, source: str, problems: list[str]) -> None:
        self.source = source
        self.problems = problems
        count = f"{len(problems)} problem{'s' if len(problems) != 1 else ''}"
        super().__init__(f"{source}: {count}\n" + "\n".join(f"  {p}" for p in problems))


class DialectError(SkygcsError):
    """A message XML that cannot be used. ``path`` and ``line`` (1-based; None if the file itself is missing)."""

    def __init__(self, path: str, line: int | None, reason: str) -> None:
        self.path = path
        self.line = line
        self.reason = reason
        where = path if line is None else f"{path}:{line}"
        super().__init__(f"{where}: {reason}")


class TraceError(SkygcsError):
    """A control trace that cannot be read. ``line`` (1-based) is the one that is wrong."""

    def __init__(self, line: int, reason: str) -> None:
        self.line = line
        self.reason = reason
        super().__init__(f"line {line}: {reason}")


class PlanFileError(SkygcsError):
    """A plan, mission or fence file that is not one. ``where`` is "line 7", "item 3", or empty for the whole file."""

    def __init__(self, source: str, where: str, reason: str) -> None:
        self.source = source
        self.where = where
        self.reason = reason
        super().__init__(": ".join(part for part in (source, where, reason) if part))


class TrajectoryError(SkygcsError):
    """A trajectory that cannot be flown. ``piece`` counts from 1, ``axis`` is east, north, up or yaw; None: unknown."""

    def __init__(self, reason: str, *, piece: int | None = None, axis: str | None = None) -> None:
        self.reason = reason
        self.piece = piece
        self.axis = axis
        where = ", ".join(part for part in ("" if piece is None else f"piece {piece}", axis or "") if part)
        super().__init__(f"{where}: {reason}" if where else reason)


class LinkError(SkygcsError):
    """A link could not be opened, or broke."""


class CompanionError(SkygcsError):
    """A vehicle's computer could not be reached, or a step there failed. ``todo``: what to do about it, or ""."""

    def __init__(self, step: str, reason: str, todo: str = "") -> None:
        self.step = step
        self.reason = reason
        self.todo = todo
        super().__init__(f"{step}: {reason}" + (f"; {todo}" if todo else ""))


class BusError(SkygcsError):
    """A message over a federation's hub that was not sent, or not answered. ``subject`` of the message."""

    def __init__(self, subject: str, reason: str) -> None:
        self.subject = subject
        self.reason = reason
        super().__init__(f"{subject}: {reason}" if subject else reason)


class HubAway(BusError):
    """Not sent: there is no connection to the hub, or it takes nothing at the moment."""


class NobodyThere(BusError):
    """The hub answered that nobody takes messages of this subject: certainly not carried out."""


class NotPermitted(BusError):
    """The hub refused the message of this station: certainly not carried out."""


class ReplyLost(BusError):
    """Sent, and no answer came in time: whether it was carried out is unknown. Never sent again by itself."""


class TargetError(SkygcsError):
    """A target expression that names no vehicle."""


class RefusedError(SkygcsError):
    """skygcs refuses the order itself; the text says why and, where one can, how to insist."""


class NotReadyError(RefusedError):
    """An order that is refused now and may be accepted soon: the vehicle has not reported something yet."""


class KeyFileError(RefusedError):
    """A file that cannot be used as a signing key. Never holds anything of what is in it."""

    def __init__(self, path: str, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"key file {path}: {reason}")


class RpcError(SkygcsError):
    """The server answered a request with an error object (JSON-RPC 2.0, section 5.1)."""

    def __init__(self, code: int, message: str, data: Any = None) -> None:
        self.code = code
        self.message = message
        self.data = data
        super().__init__(message)


class DaemonUnreachable(RpcError):
    """No daemon answers on the socket."""

    def __init__(self, address: str, reason: str) -> None:
        self.address = address
        self.reason = reason
        super().__init__(-32000, f"no skygcs daemon at {address} ({reason}); start one with: skygcs run FLEET.toml")


class DaemonForbidden(DaemonUnreachable):
    """The socket is there and belongs to another user (or lies in a folder of another user)."""

    def __init__(self, address: str, owner: str) -> None:
        self.address = address
        self.reason = f"it belongs to {owner}"
        RpcError.__init__(
            self,
            -32000,
            f"the socket {address} belongs to {owner}, and no other user may use it; run this as {owner} "
            f"(sudo -u {owner} …), or run a daemon of your own and name its socket (--socket)",
        )


def explain_address_error(error: OSError, host: str, port: int) -> str:
    """One line for the user: why a bind or connect failed, and what to do."""
    match error.errno:
        case errno.EADDRINUSE:
            return f"port {port} is in use by another program; stop that one or choose another port"
        case errno.EADDRNOTAVAIL:
            return f"this machine has no address {host}; take 0.0.0.0 for all it has, or bring the network up"
        case errno.EACCES | errno.EPERM:
            return f"not permitted to use {host} port {port}; ports below 1024 need root"
        case errno.ECONNREFUSED:
            return "connection refused: no program listens there (yet)"
        case errno.EHOSTUNREACH | errno.ENETUNREACH:
            return "no route to it: is the network up?"
        case errno.EMFILE | errno.ENFILE:
            return "too many open files: raise the limit (ulimit -n)"
        case _:
            return (error.strerror or str(error)).lower()
