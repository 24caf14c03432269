"""A node of ROS 1: the process of rospy under the system's Python, as the bridge sees any node.

rospy needs packages of the system's Python, and skygcs others that this one has not. So rospy runs in a process of its
own (`rospy_program`), to which messages go as bytes. It is started again when it ends, as it does when the master is
not there or was started anew; what is published, read and served is then declared anew, and what is latched sent again.

    to the process      MOST_WAITING_BYTES at most wait; a message more is dropped and counted
    from the process    it waits while nothing is read here; MOST_PENDING requests of a service are carried out at once
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import structlog

from skygcs.back_off import BackOff
from skygcs.core.ros import ros1
from skygcs.core.ros.interfaces import Fields, InterfaceError, Interfaces
from skygcs.core.ros.topics import DEPTHS, LATCHED, Quality
from skygcs.errors import SkygcsError
from skygcs.ext.ros.graph import MOST_PENDING, Handler
from skygcs.ext.ros.late_gate import LATE, WAITED
from skygcs.ext.ros.rospy_program import HEAD, NO_MASTER, NO_ROSPY, packed

PYTHON = "/usr/bin/python3"
PROGRAM = Path(__file__).with_name("rospy_program.py")
NOETIC = "/opt/ros/noetic/lib/python3/dist-packages"
"""Where packages of ROS' own repository have rospy."""

DEFAULT_MASTER = "http://localhost:11311"

MOST_WAITING_BYTES = 1 << 20
MOST_FRAME_BYTES = 4 << 20
TURN = 16
"""Frames that are taken before others of the loop have their turn."""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
END_S = 1.5
"""How long the process may take to take its names from the master: with `process.FAREWELL_S` less than the time after
which the daemon kills both (SupervisedChild), which would leave the names there."""

SENDING_S = 1.0
"""Time for the last answers on their way through the process: with 0.2 s a computer with a load of 12 lost one."""

_log = structlog.get_logger(__name__)


def kept_messages(quality: Quality) -> int:
    """Number of messages that a later reader gets: of a latched topic the newest, as of MAVROS 1; of events all."""
    return (DEPTHS[quality] if quality == "events" else 1) if quality in LATCHED else 0


class RospyPublication:
    """A topic that is published."""

    def __init__(self, node: RospyNode, number: int, name: str, type_: str, quality: Quality) -> None:
        self.name = name
        self.type = type_
        self.latched = quality in LATCHED
        self.readers = 0
        self.sent = 0
        self.dropped = 0
        self.kept: deque[bytes] = deque(maxlen=kept_messages(quality))
        """Messages for later readers, and for a process that is started again."""
        self._node = node
        self._number = number

    @property
    def wanted(self) -> bool:
        """True if anything comes of writing: somebody reads, or may read it later."""
        return self.latched or self.readers > 0

    def write(self, fields: Fields) -> None:
        """Send one message. Raises InterfaceError."""
        data = ros1.encode(self._node.interfaces, self.type, fields, self.sent)
        self.kept.append(data)
        if self._node.send({"do": "send", "id": self._number}, data):
            self.sent += 1
        else:
            self.dropped += 1


class RospySubscriber:
    """A topic that is read."""

    def __init__(self, node: RospyNode, name: str, type_: str, on_message: Callable[[dict[str, Any]], None]) -> None:
        self.name = name
        self.received = 0
        self.rejected = 0
        self._interfaces = node.interfaces
        self._type = type_
        self._on_message = on_message

    def take(self, data: bytes) -> None:
        """One message that came."""
        self.received += 1
        try:
            self._on_message(ros1.decode(self._interfaces, self._type, data))
        except InterfaceError:
            self.rejected += 1


class RospyService:
    """A service that is answered."""

    def __init__(self, node: RospyNode, name: str, type_: str, handler: Handler, most_pending: int) -> None:
        self.name = name
        self.calls = 0
        self.overflown = 0
        self.rejected = 0
        self._node = node
        self._request, self._response = ros1.service_parts(type_)
        self._handler = handler
        self._most_pending = most_pending
        self.tasks: set[asyncio.Task[None]] = set()
        """Each answers one call."""

    def take(self, call: int, data: bytes, is_late: bool = False) -> None:
        """One request that came; of one that is not carried out the response is empty: its success is false.
        ``is_late``: it waited while the process of rospy stood still."""
        try:
            request = ros1.decode(self._node.interfaces, self._request, data)
        except InterfaceError:
            self.rejected += 1
            self._answer(call, {})
            return
        if len(self.tasks) >= self._most_pending:
            self.overflown += 1
            self._answer(call, {})
            return
        self.calls += 1
        task = asyncio.get_running_loop().create_task(
            self._carry_out(call, request, is_late), name=f"service {self.name}"
        )
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def _carry_out(self, call: int, request: dict[str, Any], is_late: bool) -> None:
        if is_late:  # for this task alone
            LATE.set(WAITED)
        run = self._node.run_number
        response = await self._handler(request)
        if self._node.run_number == run:  # calls of another process have the same numbers
            self._answer(call, response)

    def _answer(self, call: int, response: Fields) -> None:
        data = ros1.encode(self._node.interfaces, self._response, response)
        self._node.send({"do": "answer", "call": call}, data, drop=False)

    def close(self) -> None:
        """Stop carrying out requests."""
        for task in self.tasks:
            task.cancel()


class RospyNode:
    """A node of ROS 1; `run` it in a task. Names are complete: "/alpha/mavros/state"."""

    def __init__(self, interfaces: Interfaces, master: str, localhost: bool, python: str = PYTHON) -> None:
        """``localhost``: only programs of this computer reach the node."""
        self.interfaces = interfaces
        self.master = master
        self.localhost = localhost
        self.up = False
        self.run_number = 0
        """Number of the process that runs; calls are counted anew by each."""
        self.publications: dict[str, RospyPublication] = {}
        self.subscribers: dict[str, RospySubscriber] = {}
        self.services: dict[str, RospyService] = {}
        self._python = python
        self._declared: list[dict[str, Any]] = []
        self._by_number: dict[int, Any] = {}
        self._input: asyncio.StreamWriter | None = None

    def publish(self, name: str, type_: str, quality: Quality) -> RospyPublication:
        """A publication of this topic."""
        made = RospyPublication(self, len(self._declared), name, type_, quality)
        self.publications[name] = made
        more = {"keep": kept_messages(quality), "queue": DEPTHS[quality]}
        self._declare(made, {"do": "publish", "name": name, **self._described(ros1.ros1_type(type_)), **more})
        return made

    def subscribe(
        self, name: str, type_: str, quality: Quality, on_message: Callable[[dict[str, Any]], None]
    ) -> RospySubscriber:
        """Call ``on_message(fields)`` for each message from now on."""
        made = self.subscribers[name] = RospySubscriber(self, name, type_, on_message)
        self._declare(made, {"do": "subscribe", "name": name, **self._described(type_), "queue": DEPTHS[quality]})
        return made

    def serve(self, name: str, type_: str, handler: Handler, most_pending: int = MOST_PENDING) -> RospyService:
        """Answer requests of this service by a coroutine function, ``most_pending`` at the same time."""
        made = self.services[name] = RospyService(self, name, type_, handler, most_pending)
        parts = [self._described(part) for part in ros1.service_parts(type_)]
        request, response = ([part["md5"], part["text"]] for part in parts)
        sums = {"type": ros1.ros1_name(type_), "md5": ros1.service_md5(self.interfaces, type_)}
        self._declare(made, {"do": "serve", "name": name, **sums, "request": request, "response": response})
        return made

    def count_readers(self) -> None:
        """Nothing: the process reports each change."""

    def send(self, head: Mapping[str, Any], body: bytes = b"", *, drop: bool = True) -> bool:
        """Give the process a frame; False: it is not there, or reads too slowly. ``drop``: False for what it must
        get."""
        to = self._input
        if to is None or not self.up or to.is_closing():
            return False
        if drop and to.transport.get_write_buffer_size() > MOST_WAITING_BYTES:
            return False
        to.write(packed(dict(head), body))
        return True

    async def run(self) -> None:
        """Keep the process running until the task is cancelled. Raises SkygcsError when rospy is not installed."""
        back_off, reported = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S), False
        while True:
            began = asyncio.get_running_loop().time()
            code = await self._run_once()
            if code == NO_ROSPY:
                raise SkygcsError(f"ROS 1 needs rospy for {self._python}: apt-get install python3-rospy")
            if asyncio.get_running_loop().time() - began > LONGEST_PAUSE_S:
                back_off.reset()
                reported = False
            if not reported:
                reported = True
                reason = f"no master at {self.master}" if code == NO_MASTER else f"exit code {code}"
                _log.warning("ROS 1 is not there; it is tried again", reason=reason)
            await asyncio.sleep(back_off.after())

    async def drained(self, timeout_s: float) -> None:
        """Wait until requests are answered, and then for the process, which does not report what went out."""
        if tasks := [task for service in self.services.values() for task in service.tasks]:
            await asyncio.wait(tasks, timeout=max(0.0, timeout_s - SENDING_S))
        await asyncio.sleep(min(timeout_s, SENDING_S))

    def close(self) -> None:
        """End answering; the process ends with `run`."""
        for service in self.services.values():
            service.close()

    # -- private

    def _described(self, type_: str) -> dict[str, Any]:
        text, md5 = self.interfaces.ros1_definition(type_)
        return {"type": ros1.ros1_name(type_), "md5": md5, "text": text}

    def _declare(self, made: Any, head: dict[str, Any]) -> None:
        number = len(self._declared)
        self._declared.append({**head, "id": number})
        self._by_number[number] = made
        self.send(self._declared[-1], drop=False)

    async def _run_once(self) -> int:
        """The exit code of the process."""
        process = await asyncio.create_subprocess_exec(
            self._python,
            str(PROGRAM),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env=_environment(self.master, self.localhost),
        )
        assert process.stdin is not None and process.stdout is not None
        self._input = process.stdin
        try:
            with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
                await self._read(process.stdout)
                process.kill()  # it does not keep to its frames
            return await process.wait()
        finally:
            self._input, self.up = None, False
            for publication in self.publications.values():
                publication.readers = 0
            process.stdin.close()
            try:
                async with asyncio.timeout(END_S):
                    await process.wait()
            except TimeoutError:
                process.kill()

    async def _read(self, file: asyncio.StreamReader) -> None:
        """Take its frames. Raises IncompleteReadError at the end."""
        while True:
            for _ in range(TURN):
                sizes = HEAD.unpack(await file.readexactly(HEAD.size))
                if sum(sizes) > MOST_FRAME_BYTES:
                    return
                head = json.loads(await file.readexactly(sizes[0]))
                self._on_frame(head, await file.readexactly(sizes[1]))
            await asyncio.sleep(0)

    def _on_frame(self, head: dict[str, Any], body: bytes) -> None:
        kind = head["is"]
        if kind == "up":
            self.up = True
            self.run_number += 1
            for declared in self._declared:
                self.send(declared, drop=False)
            for number, made in self._by_number.items():
                for data in made.kept if isinstance(made, RospyPublication) else ():
                    self.send({"do": "send", "id": number}, data, drop=False)
            return
        made = self._by_number[head["id"]]
        if kind == "message":
            made.take(body)
        elif kind == "call":
            made.take(head["call"], body, head["late"])
        elif kind == "readers":
            made.readers = head["count"]


def _environment(master: str, localhost: bool) -> dict[str, str]:
    """Variables of the process: those of this one, which a user has set for ROS, and where the master is."""
    found = dict(os.environ)
    found["ROS_MASTER_URI"] = master
    if localhost:
        found.pop("ROS_HOSTNAME", None)
        found["ROS_IP"] = "127.0.0.1"
    paths = [path for path in found.get("PYTHONPATH", "").split(os.pathsep) if path and path not in sys.path]
    if Path(NOETIC).is_dir():
        paths.append(NOETIC)
    found["PYTHONPATH"] = os.pathsep.join(paths)
    return found
