"""A node of ROS 2 that calls services and reads topics, on Cyclone DDS as rmw_cyclonedds does."""

from __future__ import annotations

import asyncio
import os
from typing import Any

from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.ext.ros.dds import SERVICE_HEADER, DdsNode, Network, Publication, Subscriber


class RosClient:
    """On the loopback of a domain; `close` it."""

    def __init__(self, domain: int) -> None:
        self.known = ros2_interfaces()
        self.node = DdsNode(Network(domain, True, ()), self.known, asyncio.get_running_loop())
        self._id = int.from_bytes(os.urandom(8), "little")
        self._callers: dict[str, tuple[Publication, dict[int, asyncio.Future[bytes]]]] = {}
        self._sequence = 0

    async def call(self, name: str, type_: str, timeout_s: float = 60.0, **request: Any) -> dict[str, Any]:
        """The response of a service, once it is there."""
        requests, pending = self._caller(name, type_)
        async with asyncio.timeout(timeout_s):
            while not requests.readers:
                requests.count_readers()
                await asyncio.sleep(0.05)
            await asyncio.sleep(0.2)  # and its replies are matched with us
            self._sequence += 1
            future = pending[self._sequence] = asyncio.get_running_loop().create_future()
            data = self.known.encode(f"{type_}_Request", request)
            requests.write_bytes(data[:4] + SERVICE_HEADER.pack(self._id, self._sequence) + data[4:])
            reply = await future
        return self.known.decode(f"{type_}_Response", reply)

    def _caller(self, name: str, type_: str) -> tuple[Publication, dict[int, asyncio.Future[bytes]]]:
        if name not in self._callers:
            pending: dict[int, asyncio.Future[bytes]] = {}

            def on_reply(data: bytes) -> None:
                client, sequence = SERVICE_HEADER.unpack_from(data, 4)
                future = pending.pop(sequence, None) if client == self._id else None
                if future is not None and not future.done():
                    future.set_result(data[:4] + data[4 + SERVICE_HEADER.size :])

            requests = Publication(self.node, f"rq{name}Request", f"{type_}_Request", "service", b"")
            Subscriber(self.node, f"rr{name}Reply", f"{type_}_Response", "service", on_reply, b"")
            self._callers[name] = (requests, pending)
        return self._callers[name]

    def close(self) -> None:
        self.node.close()
