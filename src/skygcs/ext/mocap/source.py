"""Where the capture process gets its frames: a system by the package `motioncapture`, or a recording.

`motioncapture` 1.1 has connect(type, {"hostname": ...}), which blocks until a Vicon or OptiTrack answers, raises
RuntimeError where a Qualisys does not, and returns at once for VRPN; waitForNextFrame(), which blocks without a limit;
and rigidBodies, a dictionary from names to bodies with position (3 floats) and rotation (w, x, y, z). It passes on
neither the frame's own time nor whether a body is occluded: a Vicon's occluded body is left out, one of VRPN keeps its
last pose. So the time of a frame is when it arrived here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from skygcs.errors import SkygcsError
from skygcs.ext.mocap.recording import MAX_BODIES, MAX_LINE_BYTES, MAX_NAME, Body, frames_of

SYSTEMS = ("vicon", "optitrack", "qualisys", "vrpn")
"""Types of `motioncapture` 1.1; its "mock" has no bodies."""

PORT_KEYS: Mapping[str, str] = {"qualisys": "port", "optitrack": "port_command"}
"""The key of `motioncapture.connect` for another port than the system's own; the other systems have none."""

IDLE_S = 0.001
"""Pause after a VRPN frame: its waitForNextFrame returns at once, with or without news, and would take a core."""

Frame = tuple[float, Mapping[str, Body | None]]
"""Monotonic seconds, and the bodies by name."""


class CaptureError(SkygcsError):
    """The system cannot be read; the text says why and what to do."""


class _Package(Protocol):
    def connect(self, kind: str, config: dict[str, str], /) -> Any: ...


@dataclass(frozen=True, slots=True)
class SystemSource:
    """A capture system. ``package``: `motioncapture`, which is imported if it is None."""

    kind: str
    host: str
    port: int | None = None
    clock: Callable[[], float] = time.monotonic
    package: _Package | None = None

    @property
    def label(self) -> str:
        return f"{self.kind} at {self.host}" + ("" if self.port is None else f":{self.port}")

    def frames(self) -> Iterator[Frame]:
        """Every frame from now on. Blocks; raises CaptureError."""
        package = self.package or _motioncapture()
        config = {"hostname": self.host}
        if self.port is not None:
            config[PORT_KEYS[self.kind]] = str(self.port)
        try:
            system = package.connect(self.kind, config)
            while True:
                system.waitForNextFrame()
                yield self.clock(), bodies_of(system.rigidBodies)
                if self.kind == "vrpn":
                    time.sleep(IDLE_S)
        except (RuntimeError, OSError, ValueError, TypeError, AttributeError) as error:
            raise CaptureError(f"{self.label}: {error}") from None


@dataclass(frozen=True, slots=True)
class RecordedSource:
    """A recording, played as fast as it was recorded, from its begin; once, or over and over again."""

    file: Path
    loop: bool = False
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep

    @property
    def label(self) -> str:
        return f"recording {self.file.name}"

    def frames(self) -> Iterator[Frame]:
        """Every frame at its time. Raises CaptureError."""
        try:
            while True:
                began, first = self.clock(), None
                with self.file.open("rb") as file:
                    for frame in frames_of(iter(lambda: file.readline(MAX_LINE_BYTES + 1), b"")):
                        first = frame.at if first is None else first
                        at = began + frame.at - first
                        if (wait_s := at - self.clock()) > 0.0:
                            self.sleep(wait_s)
                        yield (
                            at,
                            {n: None if pose is None else (pose.pos_m, pose.q) for n, pose in frame.bodies.items()},
                        )
                if first is None:
                    raise CaptureError(f"{self.file}: has no frames")
                if not self.loop:
                    return
        except OSError as error:
            raise CaptureError(f"{self.file}: {error.strerror or error}") from None
        except ValueError as error:
            raise CaptureError(f"{self.file}: {error}") from None


def bodies_of(bodies: Mapping[str, Any]) -> dict[str, Body | None]:
    """The rigid bodies of `motioncapture`; None for one whose pose cannot be read."""
    found: dict[str, Body | None] = {}
    for name, body in list(bodies.items())[:MAX_BODIES]:
        if len(name) > MAX_NAME:
            continue
        try:
            x, y, z = (float(value) for value in body.position)
            q = body.rotation
            found[name] = (x, y, z), (float(q.w), float(q.x), float(q.y), float(q.z))
        except (TypeError, ValueError, AttributeError):
            found[name] = None
    return found


def only(bodies: Mapping[str, Body | None], names: Collection[str]) -> dict[str, Body | None]:
    """The named ones of these bodies; all without names."""
    return {name: body for name, body in bodies.items() if not names or name in names}


def _motioncapture() -> _Package:
    try:
        import motioncapture
    except ImportError as error:
        raise CaptureError(
            f"the package motioncapture cannot be imported ({error}): pip install 'skygcs[mocap]' (CPython on Linux, "
            "Windows or macOS)"
        ) from None
    package: _Package = motioncapture
    return package
