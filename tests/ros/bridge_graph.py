"""Everything that a bridge publishes, reads and serves, from the bridge itself: no second list of topics exists."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ros.idl import cpp_type, lines
from skygcs.core.ros.interfaces import Interfaces
from skygcs.core.ros.topics import LATCHED
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from support.ros_node import KeptNode


class Graph(NamedTuple):
    """Names and types; of published topics also their quality of service."""

    topics: dict[str, tuple[str, str]]
    services: dict[str, str]
    inputs: dict[str, str]


async def graph_of(config: RosConfig, vehicles: Mapping[str, tuple[int, str]]) -> Graph:
    """What the bridge has for vehicles by name: their system id and autopilot."""
    node = KeptNode()
    bridge = Bridge(node, config)
    for name, (sysid, autopilot) in vehicles.items():
        bridge.on_state({"name": name, "sysid": sysid, "compid": 1, "connected": False, "autopilot": autopilot})
    await asyncio.sleep(0)
    return Graph(
        {name: (made.type, made.quality) for name, made in node.publications.items()},
        {name: made.type for name, made in node.services.items()},
        {name: made.type for name, made in node.subscribers.items()},
    )


def table(known: Interfaces, graph: Graph) -> Iterator[str]:
    """The lines that `every_topic_node` reads. Services come first: a bridge that knows the readers of all topics knows
    the clients of all services."""
    types = [type_ for type_, _ in graph.topics.values()] + list(graph.inputs.values())
    yield from lines(known, types, dict.fromkeys(graph.services.values()))
    for name, type_ in graph.services.items():
        yield f"service {name} {cpp_type(f'{type_}_Request')} {cpp_type(f'{type_}_Response')}"
    for name, (type_, quality) in graph.topics.items():
        reliable, latched = quality not in ("sensor", "px4"), quality in LATCHED or quality == "px4"
        yield f"topic {name} {cpp_type(type_)} {reliable:d} {latched:d}"
    for name, type_ in graph.inputs.items():
        yield f"input {name} {cpp_type(type_)}"
