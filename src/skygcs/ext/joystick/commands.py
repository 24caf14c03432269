"""`skygcs-cli joystick`: fly one vehicle by velocities from a Linux joystick, while its dead-man button is held.

What flies when is `ext.joystick.stick_session`; here are the device, the signals and the calls to the daemon. Each
setpoint is valid for VALID_S: when this program or its connection dies, the daemon stops the vehicle.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import math
import os
import signal
import stat
from collections.abc import Awaitable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, run
from skygcs.cli.options import Json, OneVehicle
from skygcs.cli.parsing import finite, within
from skygcs.cli.render import print_json
from skygcs.errors import DaemonUnreachable, LinkError, RpcError
from skygcs.ext.joystick.device_events import EventReader, JoystickEvent
from skygcs.ext.joystick.stick_mapping import STILL, AxisChoice, StickAxes, StickDemand, StickLimits, turned
from skygcs.ext.joystick.stick_session import Effect, Engage, Finish, Send, SessionReport, StickSession, Stop
from skygcs.rpc.client import Client

PERIOD_S = 0.05
VALID_S = 0.3
"""Six periods: a busy computer does not make the flight jerk, and a dead one has flown on by 0.6 m at 2 m/s."""

ANSWER_WITHIN_S = 0.5
"""The daemon answers a setpoint within milliseconds; one that does not within twice this is as good as gone."""

STOP_WITHIN_S = 15.0
"""`hold` is repeated until the vehicle shows it, or has failed, within about 10 s."""

HEADING_VALID_S = 1.0
"""Turning at 45 degrees/s, a heading so old makes the vehicle go 45 degrees beside the stick."""

READ_BYTES = 8 * 64
JSIOCGNAME_128 = 0x80806A13
"""linux/joystick.h: _IOC(_IOC_READ, 'j', 0x13, 128)."""

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def joystick(
    vehicle: OneVehicle,
    device: Annotated[Path, typer.Option("--device", metavar="FILE", help="The joystick.")] = Path("/dev/input/js0"),
    button: Annotated[int, typer.Option("--button", help="The dead-man button: flown only while it is held.")] = 5,
    axes: Annotated[
        str,
        typer.Option("--axes", metavar="FORWARD,LEFT,UP,YAW", help="Numbers of the axes; -4: inverted."),
    ] = "-4,-3,-1,-0",
    engage: Annotated[
        bool, typer.Option("--engage", help="Pressing the button takes the vehicle under velocity control.")
    ] = False,
    speed: Annotated[float, typer.Option("--speed", metavar="MPS", help="At full stick.", parser=finite)] = 2.0,
    climb: Annotated[float, typer.Option("--climb", metavar="MPS", help="At full stick.", parser=finite)] = 1.0,
    yaw_rate: Annotated[
        float, typer.Option("--yaw-rate", metavar="DPS", help="At full stick, degrees/s.", parser=finite)
    ] = 45.0,
    dead_zone: Annotated[
        float, typer.Option("--dead-zone", help="Share of the stick's travel, 0 to 0.5.", parser=finite)
    ] = 0.1,
    expo: Annotated[float, typer.Option("--expo", help="0: linear, 1: finest middle.", parser=finite)] = 0.3,
    fleet_frame: Annotated[
        bool, typer.Option("--fleet-frame", help="Forward is the fleet's x axis, not the vehicle's nose.")
    ] = False,
    take_over: Annotated[
        bool,
        typer.Option("--take-over", help="Although it follows the setpoints of another client, which loses it."),
    ] = False,
    json_output: Json = False,
) -> None:
    """Fly one vehicle by joystick: velocities, only while the dead-man button is held.

    Releasing it, unplugging the joystick, Ctrl-C or a closed terminal: zero velocity, then hold. Sticks must be centred
    and the button released at the start. Guard, fence and speed limits of the daemon apply as to every setpoint.

    Example: skygcs-cli joystick alpha --engage
    """
    # check the options
    for option, value, low, high in (
        ("--speed", speed, 0.1, 10.0),
        ("--climb", climb, 0.1, 3.0),
        ("--yaw-rate", yaw_rate, 0.0, 120.0),
        ("--dead-zone", dead_zone, 0.0, 0.5),
        ("--expo", expo, 0.0, 1.0),
        ("--button", button, 0, 255),
    ):
        within(option, value, low, high)
    limits = StickLimits(speed, climb, yaw_rate, dead_zone=dead_zone, expo=expo)
    chosen = parse_axes(axes)

    # fly until the pilot or the daemon ends it
    async def command(gcs: Client) -> int:
        name = str((await gcs.vehicle(vehicle))["name"])
        with opened(device) as descriptor:
            flight = JoystickFlight(gcs, name, engage=engage, fleet_frame=fleet_frame, take_over=take_over)
            code = await flight.fly(descriptor, chosen, limits, button)
        if json_output:
            print_json({"vehicle": name, **flight.counts, "end": flight.end})
        return code

    run(command)


def parse_axes(text: str) -> StickAxes:
    """ "-4,-3,-1,-0" as axes for forward, left, up and yaw. Raises BadParameter."""

    def choice(part: str) -> AxisChoice:
        digits = part.removeprefix("-")
        if not (digits.isascii() and digits.isdigit() and len(digits) <= 3 and int(digits) <= 255):
            raise typer.BadParameter(f"--axes: {part!r} is not the number of an axis")
        return AxisChoice(int(digits), -1 if part.startswith("-") else 1)

    parts = [choice(part.strip()) for part in text.split(",")]
    if len(parts) != 4 or len({part.number for part in parts}) != 4:
        raise typer.BadParameter("--axes: give four different axes, FORWARD,LEFT,UP,YAW")
    return StickAxes(*parts)


@contextlib.contextmanager
def opened(device: Path) -> Iterator[int]:
    """A descriptor of the joystick that does not block; also a pipe that brings js_events. Raises LinkError."""
    try:
        descriptor = os.open(device, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        advice = {
            errno.ENOENT: ": plug it in, or name it with --device (ls /dev/input/js*)",
            errno.EACCES: ": its owner is the group input (usermod -aG input USER, then log in again)",
        }.get(error.errno or 0, "")
        raise LinkError(f"{device}: {os.strerror(error.errno or 0)}{advice}") from None
    try:
        if not stat.S_ISFIFO(os.fstat(descriptor).st_mode):
            try:
                fcntl.ioctl(descriptor, JSIOCGNAME_128, bytes(128))
            except OSError:
                raise LinkError(f"{device} is not a joystick: give --device /dev/input/jsN") from None
        yield descriptor
    finally:
        os.close(descriptor)


class JoystickFlight:
    """The flight of one vehicle by one joystick. Made for one call of `fly`."""

    def __init__(self, gcs: Client, name: str, *, engage: bool, fleet_frame: bool, take_over: bool = False) -> None:
        self._gcs = gcs
        self._name = name
        self._engage = engage
        self._fleet_frame = fleet_frame
        self._way = {"take_over": True} if take_over else {}
        self._taken = False
        """The vehicle follows another client, or an order, instead."""
        self._wake = asyncio.Event()
        self._session: StickSession
        self._pending: list[Effect] = []
        self._engaging: asyncio.Task[tuple[bool, str]] | None = None
        self._heading: tuple[float, float] | None = None
        """When it came, and the nose from the fleet's x axis in radians, counter-clockwise."""
        self._complaint = ""
        self._signal: signal.Signals | None = None
        self._code: int | None = None
        self.end = ""
        self.counts = {"sent": 0, "refused": 0, "stops": 0, "unknown_events": 0}

    async def fly(self, descriptor: int, axes: StickAxes, limits: StickLimits, button: int) -> int:
        """Until the joystick, the vehicle, or a signal ends it; the exit code. Raises DaemonUnreachable, RpcError."""
        loop = asyncio.get_running_loop()
        self._session = StickSession(axes, limits, button, loop.time())
        reader = EventReader()
        for number in SIGNALS:
            loop.add_signal_handler(number, self._on_signal, number)
        loop.add_reader(descriptor, self._on_readable, descriptor, reader)
        following = asyncio.create_task(self._follow_heading(), name="joystick heading")
        try:
            return await self._ticks(loop, following)
        except DaemonUnreachable:
            self._say(f"{self._name}: the connection is gone; the daemon, if it runs, stops it within {VALID_S:g} s")
            raise
        finally:
            loop.remove_reader(descriptor)
            tasks = [task for task in (following, self._engaging) if task is not None]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            for number in SIGNALS:
                loop.remove_signal_handler(number)
            self.counts["unknown_events"] = reader.unknown

    async def _ticks(self, loop: asyncio.AbstractEventLoop, following: asyncio.Task[None]) -> int:
        due = loop.time()
        while self._code is None:
            if following.done():
                following.result()  # raises why no states come: the daemon is gone
            # events and signals at once, ticks on absolute times
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(due):
                    await self._wake.wait()
            self._wake.clear()
            await self._carry_out()
            if loop.time() >= due and self._code is None:
                self._pending += self._session.tick(loop.time())
                await self._carry_out()
                due = max(due + PERIOD_S, loop.time())
        return self._code

    # -- what comes in

    def _on_readable(self, descriptor: int, reader: Any) -> None:
        loop = asyncio.get_running_loop()
        try:
            data = os.read(descriptor, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(descriptor, os.strerror(error.errno or errno.EIO))
            return
        if not data:
            self._lose(descriptor, "it was closed")
            return
        events: list[JoystickEvent] = list(reader.feed(data))
        self._pending += self._session.on_events(events, loop.time())
        self._wake.set()

    def _lose(self, descriptor: int, reason: str) -> None:
        asyncio.get_running_loop().remove_reader(descriptor)
        self._pending += self._session.on_device_lost(reason)
        self._wake.set()

    def _on_signal(self, number: signal.Signals) -> None:
        self._signal = self._signal or number
        self._pending += self._session.on_exit_asked("stopped" if number is signal.SIGINT else number.name)
        self._wake.set()

    async def _follow_heading(self) -> None:
        """Keep the newest heading. Raises DaemonUnreachable when the connection ends."""
        loop = asyncio.get_running_loop()
        async for state in self._gcs.telemetry(self._name, rate_hz=20, groups=["position"]):
            position = state["position"]
            if position is not None and position.get("yaw_world_deg") is not None:
                self._heading = loop.time() - float(position["age_s"]), math.radians(position["yaw_world_deg"])
        raise DaemonUnreachable(self._gcs.address, "no states come any more")

    # -- what is to be done

    async def _carry_out(self) -> None:
        while self._pending:
            match self._pending.pop(0):
                case SessionReport(text):
                    self._say(f"{self._name}: {text}")
                case Engage():
                    self._engaging = asyncio.create_task(self._take_over(), name="joystick engage")
                    self._engaging.add_done_callback(self._on_engaged)
                case Send(demand):
                    await self._send(demand)
                case Stop(flying):
                    await self._stop(flying)
                case Finish(text, ok):
                    self.end = text
                    self._say(f"{self._name}: {text}")
                    code = Exit.DONE if ok else Exit.FAILED
                    self._code = code if self._signal is None or not ok else 128 + self._signal

    async def _take_over(self) -> tuple[bool, str]:
        if self._engage:
            outcomes = (await self._gcs.call("control.set", targets=self._name, mode="velocity"))["outcomes"]
            outcome = next(iter(outcomes.values()))
            return bool(outcome["ok"]), str(outcome["message"])
        if (await self._flown())[0]:
            return True, ""
        return False, f"it is not: skygcs-cli control set {self._name} velocity, or --engage"

    def _on_engaged(self, task: asyncio.Task[tuple[bool, str]]) -> None:
        if task.cancelled() or task is not self._engaging:
            return
        self._engaging = None
        self._pending += self._session.on_engaged(*_answered(task), asyncio.get_running_loop().time())
        self._wake.set()

    async def _flown(self) -> tuple[bool, str]:
        """Return whether setpoints of velocity are flown now, and why not."""
        status = (await self._answer(self._gcs.call("control.status", targets=self._name)))[0]
        reasons = "; ".join(status["reasons"]) or f"control is {status['state']}"
        ours = status["state"] == "flying" and status["successor"] is None
        return ours and status["mode"] != "raw", reasons

    async def _send(self, demand: StickDemand) -> None:
        """One setpoint. Refused: zero velocity instead, or the end if the vehicle is not flown by us any more."""
        loop = asyncio.get_running_loop()
        vel_mps, complaint = demand.vel_mps, ""
        if not self._fleet_frame:
            if self._heading is None or loop.time() - self._heading[0] > HEADING_VALID_S:
                vel_mps, complaint = STILL.vel_mps, "its heading is not known: no velocity (see --fleet-frame)"
            else:
                vel_mps = turned(vel_mps, self._heading[1])
        ok, message = await self._setpoint(vel_mps, demand.yaw_rate_dps)
        if not ok:
            self.counts["refused"] += 1
            complaint = message
            if self._taken:
                self._pending += self._session.on_taken_away(message)
                return
            flown, reasons = await self._flown()
            if not flown:
                self._pending += self._session.on_taken_away(f"{message} ({reasons})")
                return
            self._session.on_refused_setpoint()
            await self._setpoint(STILL.vel_mps, 0.0)
        if complaint != self._complaint:
            self._say(f"{self._name}: {complaint or 'follows the sticks again'}")
        self._complaint = complaint

    async def _setpoint(self, vel_enu_mps: tuple[float, float, float], yaw_rate_dps: float) -> tuple[bool, str]:
        turning = {"yaw_rate_dps": yaw_rate_dps} if yaw_rate_dps else {}
        call = self._gcs.setpoint(self._name, vel_enu_mps=list(vel_enu_mps), valid_s=VALID_S, **turning, **self._way)
        outcome = next(iter((await self._answer(call)).values()))
        self._taken = outcome.get("taken") is True
        self.counts["sent"] += 1
        return bool(outcome["ok"]), str(outcome["message"])

    async def _stop(self, flying: bool) -> None:
        """Zero velocity, then hold. A vehicle that somebody else has, or that was not taken, is left alone."""
        if (why := await self._not_taken(flying)) is not None:
            self._pending += self._session.on_stopped(True, f"{why}: nothing is ordered")
            return
        self.counts["stops"] += 1
        ok, message = True, ""
        if flying:
            ok, message = await self._setpoint((0.0, 0.0, 0.0), 0.0)
            if not ok and (self._taken or not (await self._flown())[0]):
                self._pending += self._session.on_stopped(True, f"somebody else has it: {message}")
                return
        try:
            async with asyncio.timeout(STOP_WITHIN_S):
                outcome = next(iter((await self._gcs.hold(self._name)).values()))
            ok, message = bool(outcome["ok"]), f"holds ({outcome['message']})"
        except TimeoutError:
            ok, message = False, f"hold was not answered within {STOP_WITHIN_S:g} s"
        except RpcError as error:
            if isinstance(error, DaemonUnreachable):
                raise
            ok, message = False, f"hold: {error}"
        self._pending += self._session.on_stopped(ok, message if ok else f"HOLD FAILED: {message}")

    async def _not_taken(self, flying: bool) -> str | None:
        """Why a vehicle that is not flown yet is not to be stopped: it was refused, and others may fly it;
        None: it is, or may be, ours. Waits until that is answered, setpoints begin, or the daemon does not answer,
        STOP_WITHIN_S at most."""
        engaging, self._engaging = self._engaging, None
        if flying or not self._engage or engaging is None:
            if engaging is not None:
                engaging.cancel()
            return None if flying or self._engage else "it was not flown yet"  # it only asked whether it is flown
        ends = asyncio.get_running_loop().time() + STOP_WITHIN_S
        try:
            while asyncio.get_running_loop().time() < ends:
                await asyncio.wait([engaging], timeout=PERIOD_S)
                if engaging.done():
                    if isinstance(error := engaging.exception(), DaemonUnreachable):
                        raise error
                    ok, message = _answered(engaging)
                    return None if ok else f"not taken under control ({message})"
                status = (await self._answer(self._gcs.call("control.status", targets=self._name)))[0]
                if status["state"] == "engaging":
                    return None
        except RpcError:
            return None
        finally:
            engaging.cancel()
        return None

    async def _answer(self, call: Awaitable[Any]) -> Any:
        """Raises DaemonUnreachable if it does not come in time."""
        task = asyncio.ensure_future(call)
        try:
            for _ in range(2):  # after a standstill of this program the first limit is over before anything is read
                await asyncio.wait([task], timeout=ANSWER_WITHIN_S)
                if task.done():
                    return task.result()
        finally:
            task.cancel()
        raise DaemonUnreachable(self._gcs.address, f"no answer within {2 * ANSWER_WITHIN_S:g} s")

    def _say(self, text: str) -> None:
        """On stderr; a terminal that was closed does not keep the vehicle from being stopped."""
        with contextlib.suppress(OSError):
            fail(text)


def _answered(engagement: asyncio.Task[tuple[bool, str]]) -> tuple[bool, str]:
    """The outcome of an engagement that is over: whether it is ours, and a message."""
    if (error := engagement.exception()) is not None:
        return False, str(error)
    return engagement.result()


def add_to(app: typer.Typer) -> None:
    app.command()(joystick)
