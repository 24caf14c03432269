"""`python -m skygcs.ext.ros`, started by a daemon with [ros]; `skygcs-cli ros run` starts the same by hand."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass

import structlog

from skygcs.back_off import BackOff
from skygcs.cancellation import ended
from skygcs.core.ros.interfaces import ros1_interfaces, ros2_interfaces
from skygcs.ending_signals import ending_signals
from skygcs.errors import DaemonUnreachable, RpcError, SkygcsError
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.graph import Node
from skygcs.ext.ros.rospy_program import limit_memory
from skygcs.rpc.client import connect

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
"""Between two attempts to reach the daemon."""

FAREWELL_S = 2.5
"""At most, before the node is closed: the results of goals that ended with the connection reach their clients. A client
that is gone and was not missed yet takes it all; the daemon kills this process after 5 s (SupervisedChild), and
the process of rospy takes `rospy_node.END_S` more."""

MOST_MEMORY_BYTES = 1 << 30
"""Limit of this process: DDS keeps something of every endpoint that any participant of the network announces, and of no
more than this. A process that needs more ends, and is started again. With three vehicles it took 70 MB, 81 MB under
a flood of 2,500 writers of another node (tests/ros/test_hostile_participant.py)."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Options:
    """Options that the process was started with. ``supervised``: it ends with the daemon that started it."""

    socket: str | None
    config: RosConfig
    supervised: bool = False
    token: str | None = None


def options_of(arguments: list[str]) -> Options:
    """The options in the arguments of a daemon."""
    parser = argparse.ArgumentParser(prog="python -m skygcs.ext.ros")
    parser.add_argument("--supervised", action="store_true")
    parser.add_argument("--socket")
    parser.add_argument("--config", default="{}")
    args = parser.parse_args(arguments)
    return Options(args.socket, RosConfig.model_validate_json(args.config), args.supervised)


def with_environment(config: RosConfig, environment: Mapping[str, str]) -> RosConfig:
    """The same with what ROS 2's variables say where the file says nothing. Raises SkygcsError."""
    if config.domain is not None or config.version == 1:
        return config
    text = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdigit() or int(text) > 232:
        raise SkygcsError(f"ROS_DOMAIN_ID is {text!r}: a domain is a number from 0 to 232; set [ros] domain")
    return config.model_copy(update={"domain": int(text)})


async def serve_ros(options: Options) -> None:
    """Run until one of `ending_signals`; supervised also until the daemon has gone. Raises SkygcsError."""
    config = with_environment(options.config, os.environ)
    limit_memory(MOST_MEMORY_BYTES)
    loop = asyncio.get_running_loop()
    stopping = asyncio.Event()
    for number in ending_signals():
        loop.add_signal_handler(number, stopping.set)
    if options.supervised:
        loop.add_reader(sys.stdin, _on_input, loop, stopping)
    node, running = _node_of(config, loop)
    try:
        bridge = Bridge(node, config)
        serving = asyncio.create_task(_serve(bridge, options), name="ros bridge")
        stopped = asyncio.create_task(stopping.wait(), name="ros stop")
        watch = asyncio.create_task(bridge.watch(), name="watch of standstills")
        work = {serving, stopped, watch} if running is None else {serving, stopped, watch, running}
        await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
        stopped.cancel()
        for task in work - {stopped}:
            if task.done():
                task.result()
        await ended(watch)
        await ended(serving)
        await node.drained(FAREWELL_S)
    finally:
        node.close()
        if running is not None:
            await ended(running)


def _node_of(config: RosConfig, loop: asyncio.AbstractEventLoop) -> tuple[Node, asyncio.Task[None] | None]:
    """The node, and the task that it runs in, if it has one. Raises SkygcsError."""
    if config.version == 1:
        from skygcs.ext.ros.rospy_node import DEFAULT_MASTER, RospyNode

        master = config.master or os.environ.get("ROS_MASTER_URI") or DEFAULT_MASTER
        ros1 = RospyNode(ros1_interfaces(), master, config.network == "localhost")
        return ros1, loop.create_task(ros1.run(), name="rospy")
    from skygcs.ext.ros.dds import Network, opened

    assert config.domain is not None
    px4 = "1.16" if config.px4_msgs == "none" else config.px4_msgs
    network = Network(config.domain, config.network == "localhost", config.peers)
    return opened(network, ros2_interfaces(px4), loop), None


async def _serve(bridge: Bridge, options: Options) -> None:
    """Connect, and again after the connection was lost: a daemon that restarts finds the same topics."""
    back_off, lost = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S), False
    while True:
        try:
            async with connect(options.socket, token=options.token) as gcs:
                if lost:
                    _log.info("the daemon is there again")
                back_off.reset()
                lost = False
                await bridge.serve(gcs)
        except (DaemonUnreachable, RpcError) as error:
            if not lost:
                _log.warning("no connection to the daemon; it is tried again", reason=str(error))
            lost = True
        await asyncio.sleep(back_off.after())


def _on_input(loop: asyncio.AbstractEventLoop, stopping: asyncio.Event) -> None:
    """Standard input is closed when the daemon ends, also when it is killed: stop."""
    if not os.read(sys.stdin.fileno(), 4096):
        loop.remove_reader(sys.stdin)
        stopping.set()
