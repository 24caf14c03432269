"""A whole daemon in virtual time with the bridge of ROS beside it, whose node keeps what is published."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any
from unittest import mock

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from skygcs.rpc.client import connect
from support.flown import UNIX_S, Flown, aloft
from support.ros_node import KeptNode

_numbers = itertools.count(1)


class NoChild:
    """In place of the supervised process: the bridge is in the test."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    async def run(self) -> None:
        await asyncio.Event().wait()

    def status(self) -> dict[str, Any]:
        return {"running": True, "pid": None, "restarts": 0}

    def close(self) -> None: ...

    async def ended(self) -> None: ...


class Bridged:
    """``gcs`` as in `support.flown`; ``node`` has the topics, services and actions."""

    def __init__(self, gcs: Flown, node: KeptNode, bridge: Bridge) -> None:
        self.gcs, self.node, self.bridge = gcs, node, bridge

    async def send(self, action: str, vehicle: str = "v1", **goal: Any) -> Goal:
        """Send a goal, and wait for the answer."""
        sent = Goal(self.node, f"/{vehicle}/skygcs/{action}")
        answer = await sent.service("send_goal").call(goal_id=sent.id, goal=goal)
        sent.accepted = answer["accepted"]
        return sent

    def texts(self) -> list[str]:
        """What was logged."""
        return [entry["msg"] for entry in self.node.publications["/rosout"].messages]


class Goal:
    """A goal as its client sees it."""

    def __init__(self, node: KeptNode, name: str) -> None:
        self.node, self.name = node, name
        self.accepted = False
        self.id = {"uuid": [*next(_numbers).to_bytes(15, "big"), 1]}

    def service(self, part: str) -> Any:
        return self.node.services[f"{self.name}/_action/{part}"]

    async def result(self) -> dict[str, Any]:
        answer: dict[str, Any] = await self.service("get_result").call(goal_id=self.id)
        return answer

    async def cancel(self) -> dict[str, Any]:
        answer: dict[str, Any] = await self.service("cancel_goal").call(goal_info={"goal_id": self.id})
        return answer

    def status(self) -> int:
        """By the newest message of the topic."""
        listed = self.node.last(f"{self.name}/_action/status")["status_list"]
        return next((one["status"] for one in listed if one["goal_info"]["goal_id"] == self.id), 0)

    def feedback(self) -> list[dict[str, Any]]:
        messages = self.node.publications[f"{self.name}/_action/feedback"].messages
        return [message["feedback"] for message in messages if message["goal_id"] == self.id]


@contextlib.asynccontextmanager
async def bridged(tmp_path: Path, commands: str = "all", **more: Any) -> AsyncIterator[Bridged]:
    """``more`` as for `flown`."""
    config = RosConfig(commands=commands)  # type: ignore[arg-type]
    with mock.patch("skygcs.ext.ros.extension.SupervisedChild", NoChild):
        prepared = lambda fleet: fleet.model_copy(update={"extensions": {"ros": config}})  # noqa: E731
        async with aloft(tmp_path, prepared=prepared, **more) as gcs:
            loop, node = asyncio.get_running_loop(), KeptNode()
            bridge = Bridge(node, config, lambda: round((UNIX_S + loop.time()) * 1e9), loop.time)
            serving = asyncio.create_task(_serve(bridge, tmp_path / "s"), name="the bridge")
            try:
                await gcs.until(lambda: len(bridge.vehicles) == len(gcs.sims) and bridge.fleet.fences)
                for name, publication in node.publications.items():
                    publication.readers = int("/_action/" in name or name.startswith("/skygcs/"))
                await asyncio.sleep(1)
                yield Bridged(gcs, node, bridge)
            finally:
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)


async def _serve(bridge: Bridge, socket: Path) -> None:
    with contextlib.suppress(DaemonUnreachable, RpcError):
        async with connect(socket) as gcs:
            await bridge.serve(gcs)


async def soon(condition: Callable[[], object]) -> None:
    """Within a second."""
    for _ in range(100):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("never happened")
