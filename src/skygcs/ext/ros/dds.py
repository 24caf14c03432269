"""DDS as ROS 2 uses it: names, qualities of service and user data, over Cyclone DDS. Bytes in, bytes out.

Samples are CDR that `core.ros.interfaces` has encoded: Cyclone gets a type without members, which it neither reads nor
checks, under the name of the ROS type. Its discovery data then matches by that name, as that of ROS 2's own layers.

Everything that comes from the network is bounded: a reader keeps the last samples of its depth, and TAKE of them are
read in one turn of the loop. What a reader that does not acknowledge would hold up is dropped and counted.
"""

from __future__ import annotations

import asyncio
import os
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import DDSException, InstanceState, Policy, Qos, SampleState, ViewState
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from skygcs.core.ros.interfaces import Fields, InterfaceError, Interfaces, dds_type_name
from skygcs.core.ros.topics import DEPTHS, LATCHED, Quality
from skygcs.errors import SkygcsError
from skygcs.ext.ros.dds_reception import Reception
from skygcs.ext.ros.graph import MOST_PENDING, Handler
from skygcs.ext.ros.late_gate import LATE

ServiceQuality = Literal["service", "waiting"]
SERVICE_DEPTHS: dict[ServiceQuality, int] = {"service": 10, "waiting": 100}
"""Requests and replies that are kept; "waiting": of a service whose answers may take long."""

TAKE = 16
"""Samples of one reader in one turn of the loop; the others get their turn, then it goes on."""

ANY = SampleState.Any | ViewState.Any | InstanceState.Any

SERVICE_HEADER = struct.Struct("<QQ")
"""rmw_cyclonedds puts it before a request and its reply: the client, and the number of its request."""

MOST_SAMPLE_BYTES = 1 << 20
"""A longer sample is dropped, of Cyclone before it is put together. The longest that is read here is a request for a
mission: some 80 bytes for each waypoint."""

MOST_UNDER_WAY_S = 5.0
"""A request that its client's computer stamped earlier is late (`late_gate`): a reliable writer sends again what was
lost, after an outage of seconds as well. Clocks of computers with ROS must agree better than this: one that is further
behind orders nothing but ends of flights, and what comes from one that is ahead is never late by its stamp."""

MOST_SEQUENCE = 1 << 40
"""A larger number is no number of a request: another layer of ROS sends requests without this header."""


class Network(NamedTuple):
    """Where ROS is."""

    domain: int
    localhost: bool
    peers: Sequence[str]


def network_config(network: Network) -> str:
    """The configuration of Cyclone DDS."""
    interfaces = '<Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces>'
    peers = "".join(f'<Peer address="{peer}"/>' for peer in ("127.0.0.1", *network.peers))
    multicast = "<AllowMulticast>false</AllowMulticast>" if network.peers else ""
    return (
        '<CycloneDDS><Domain Id="any">'
        f"<General>{interfaces if network.localhost else ''}{multicast}</General>"
        "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>99</MaxAutoParticipantIndex>"
        f"<Peers>{peers}</Peers></Discovery>"
        f"<Internal><MaxSampleSize>{MOST_SAMPLE_BYTES} B</MaxSampleSize></Internal>"
        "</Domain></CycloneDDS>"
    )


class Publication:
    """A topic that is published."""

    def __init__(
        self, node: DdsNode, name: str, type_: str, quality: Quality | ServiceQuality, user_data: bytes
    ) -> None:
        self.name = name.removeprefix("rt")
        self.type = type_
        self.latched = quality in LATCHED
        self.readers = 0
        """Matched now."""
        self.sent = 0
        self.dropped = 0
        """Not sent: a reader that has not acknowledged for long holds its writer up."""
        self._interfaces = node.interfaces
        self._writer = DataWriter(node.participant, node.topic(name, type_), qos=_qos(quality, user_data))

    def count_readers(self) -> None:
        """Look who reads now."""
        self.readers = self._writer.get_publication_matched_status().current_count  # type: ignore[no-untyped-call, unused-ignore]

    @property
    def wanted(self) -> bool:
        """True if anything comes of writing: somebody reads, or may read it later."""
        return self.latched or self.readers > 0

    def acknowledged(self, timeout_s: float) -> bool:
        """Wait until all readers have acknowledged what was written, in a thread."""
        # not the binding's own wait_for_acks: at a timeout that raises AttributeError (cyclonedds 0.10)
        return bool(self._writer._wait_for_acks(self._writer._ref, duration(seconds=timeout_s)) == 0)

    def write(self, fields: Fields) -> None:
        """Send one message. Raises InterfaceError."""
        self.write_bytes(self._interfaces.encode(self.type, fields))

    def write_bytes(self, data: bytes) -> None:
        """Send what is encoded already."""
        if ddspy_write(self._writer._ref, data + b"\0" * (-len(data) % 4)) < 0:
            self.dropped += 1
        else:
            self.sent += 1


class Subscriber:
    """A topic that is read: ``on_bytes(data, sent_ns)`` on the loop for each sample, with Unix time of its writer."""

    def __init__(
        self,
        node: DdsNode,
        name: str,
        type_: str,
        quality: Quality | ServiceQuality,
        on_bytes: Callable[[bytes, int], None],
        user_data: bytes,
    ) -> None:
        self.name = name.removeprefix("rt")
        self.received = 0
        self.rejected = 0
        self._on_bytes = on_bytes
        self._closed = False
        self._reader = DataReader(node.participant, node.topic(name, type_), qos=_qos(quality, user_data))
        node.reception.watch(self._reader, ANY, self._take)

    def _take(self) -> None:
        """Some samples: after those of the other readers comes the rest."""
        taken = [] if self._closed else ddspy_take(self._reader._ref, ANY, TAKE)
        for data, info in taken if isinstance(taken, list) else ():
            if not info.valid_data:
                continue
            self.received += 1
            try:
                if len(data) > MOST_SAMPLE_BYTES:  # with a configuration of the user's own
                    raise InterfaceError(f"{self.name}: {len(data)} bytes")
                self._on_bytes(bytes(data), info.source_timestamp)
            except InterfaceError:
                self.rejected += 1

    def close(self) -> None:
        """End reading."""
        self._closed = True


class Service:
    """A service as rmw_cyclonedds serves it."""

    def __init__(self, node: DdsNode, name: str, type_: str, handler: Handler, most_pending: int) -> None:
        self.name = name
        self.calls = 0
        self.overflown = 0
        """Requests that were dropped, and whose clients time out: ``most_pending`` were being carried out."""
        self._most_pending = most_pending
        self._type = type_
        self._handler = handler
        self._node = node
        self.tasks: set[asyncio.Task[None]] = set()
        """Each answers one request."""
        data = f"serviceid={os.urandom(16).hex()};".encode() + node.type_data(type_)
        quality: ServiceQuality = "service" if most_pending <= MOST_PENDING else "waiting"
        self.replies = Publication(node, f"rr{name}Reply", f"{type_}_Response", quality, data)
        self.requests = Subscriber(node, f"rq{name}Request", f"{type_}_Request", quality, self._on_request, data)

    @property
    def rejected(self) -> int:
        """Number of malformed requests."""
        return self.requests.rejected

    def _on_request(self, data: bytes, sent_ns: int) -> None:
        """Raises InterfaceError for bytes that are not a request of this service."""
        if len(data) < 4 + SERVICE_HEADER.size:
            raise InterfaceError(f"{self.name}: {len(data)} bytes are not a request")
        client, sequence = SERVICE_HEADER.unpack_from(data, 4)
        if not 0 < sequence < MOST_SEQUENCE:
            raise InterfaceError(f"{self.name}: a request of another layer of ROS than rmw_cyclonedds")
        request = self._node.interfaces.decode(f"{self._type}_Request", data[:4] + data[4 + SERVICE_HEADER.size :])
        if len(self.tasks) >= self._most_pending:
            self.overflown += 1
            return
        self.calls += 1
        age_s = (self._node.unix_ns() - sent_ns) / 1e9
        answering = self._answer(client, sequence, request, age_s)
        task = self._node.loop.create_task(answering, name=f"service {self.name}")
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def _answer(self, client: int, sequence: int, request: dict[str, Any], age_s: float) -> None:
        if age_s > MOST_UNDER_WAY_S:  # for this task alone
            LATE.set(f"sent {age_s:.1f} s ago by its computer's clock: late, or that clock is behind")
        response = await self._handler(request)
        data = self._node.interfaces.encode(f"{self._type}_Response", response)
        self.replies.write_bytes(data[:4] + SERVICE_HEADER.pack(client, sequence) + data[4:])

    def close(self) -> None:
        self.requests.close()
        for task in self.tasks:
            task.cancel()


class DdsNode:
    """One participant of a domain. Names are those of ROS: "/alpha/mavros/state"."""

    def __init__(
        self,
        network: Network,
        interfaces: Interfaces,
        loop: asyncio.AbstractEventLoop,
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Raises DDSException, when no interface of the network can be used."""
        self.unix_ns = unix_ns
        self.interfaces = interfaces
        self.loop = loop
        # with CYCLONEDDS_URI a user has described the network; it is Cyclone's own way, and ROS 2's
        self._domain = None if os.environ.get("CYCLONEDDS_URI") else Domain(network.domain, network_config(network))
        self.participant = DomainParticipant(network.domain)
        self.reception = Reception(self.participant, loop)
        self.publications: dict[str, Publication] = {}
        self.subscribers: dict[str, Subscriber] = {}
        self.services: dict[str, Service] = {}
        self._topics: dict[str, Topic[Any]] = {}
        self._classes: dict[str, type[IdlStruct]] = {}

    def publish(self, name: str, type_: str, quality: Quality) -> Publication:
        """A publication of this topic."""
        made = Publication(self, f"rt{name}", type_, quality, self.type_data(type_))
        self.publications[name] = made
        return made

    def subscribe(
        self, name: str, type_: str, quality: Quality, on_message: Callable[[dict[str, Any]], None]
    ) -> Subscriber:
        """Call ``on_message(fields)`` for each message from now on."""

        def on_bytes(data: bytes, sent_ns: int) -> None:
            on_message(self.interfaces.decode(type_, data))

        made = Subscriber(self, f"rt{name}", type_, quality, on_bytes, self.type_data(type_))
        self.subscribers[name] = made
        return made

    def serve(self, name: str, type_: str, handler: Handler, most_pending: int = MOST_PENDING) -> Service:
        """Answer requests of this service by a coroutine function, ``most_pending`` at the same time."""
        made = Service(self, name, type_, handler, most_pending)
        self.services[name] = made
        return made

    def count_readers(self) -> None:
        """Look who reads each topic now; to be called a few times a second."""
        for publication in self.publications.values():
            publication.count_readers()

    async def drained(self, timeout_s: float) -> None:
        """Wait until requests are answered and all reliable readers have what was sent, at most ``timeout_s``."""
        end_s = self.loop.time() + timeout_s
        tasks = [task for service in self.services.values() for task in service.tasks]
        if tasks:
            await asyncio.wait(tasks, timeout=timeout_s)
        writers = [*self.publications.values(), *(service.replies for service in self.services.values())]

        def wait() -> None:
            for writer in writers:
                writer.acknowledged(max(0.0, end_s - self.loop.time()))

        await asyncio.to_thread(wait)

    def close(self) -> None:
        """End reading and answering."""
        self.reception.close()
        for subscriber in self.subscribers.values():
            subscriber.close()
        for service in self.services.values():
            service.close()

    # -- for the parts

    def topic(self, dds_name: str, type_: str) -> Topic[Any]:
        """The topic entity of this name."""
        if dds_name not in self._topics:
            cls = self._classes.get(type_)
            if cls is None:  # Cyclone works out a class anew for each topic: once for each type is enough
                cls = self._classes[type_] = type("Raw", (IdlStruct,), {"__idl_typename__": dds_type_name(type_)})
            self._topics[dds_name] = Topic(self.participant, dds_name, cls)
        return self._topics[dds_name]

    def type_data(self, type_: str) -> bytes:
        """The part of an endpoint's user data that names the type's hash (REP 2016)."""
        return f"typehash={self.interfaces.type_hash(type_)};".encode()


def opened(network: Network, interfaces: Interfaces, loop: asyncio.AbstractEventLoop) -> DdsNode:
    """A node. Raises SkygcsError if there is no network to be on."""
    try:
        return DdsNode(network, interfaces, loop)
    except DDSException as error:
        where = "this computer's loopback" if network.localhost else "the network"
        raise SkygcsError(f"no DDS on {where} (domain {network.domain}): {error.msg}") from None


def _qos(quality: Quality | ServiceQuality, user_data: bytes) -> Qos:
    depth = SERVICE_DEPTHS[quality] if quality == "service" or quality == "waiting" else DEPTHS[quality]
    parts: list[Any] = [Policy.History.KeepLast(depth), Policy.Userdata(user_data)]
    if quality in ("sensor", "px4"):
        parts.append(Policy.Reliability.BestEffort)
    else:
        parts.append(Policy.Reliability.Reliable(duration(seconds=0)))  # never wait for a reader that does not answer
    if quality == "px4" or quality in LATCHED:
        parts.append(Policy.Durability.TransientLocal)
        parts.append(Policy.DurabilityService(0, Policy.History.KeepLast(depth), depth, 1, depth))
    return Qos(*parts)
