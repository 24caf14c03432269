"""Program of the process that has rospy: it runs under the system's Python (3.8 or newer), and needs nothing of skygcs.

Messages are bytes here, encoded by the process that started it (`rospy_node`). Each frame on standard input and output
is the lengths of its two parts (HEAD), JSON, and bytes:

    in     {"do": "publish", "id", "name", "type", "md5", "text", "keep", "queue"}     keep: messages for later readers
           {"do": "subscribe", "id", "name", "type", "md5", "text", "queue"}
           {"do": "serve", "id", "name", "type", "md5", "request", "response"}
           {"do": "send", "id"} message            {"do": "answer", "call"} response
    out    {"is": "up"}                            the node is registered at the master
           {"is": "readers", "id", "count"}        each time that it changes
           {"is": "message", "id"} message         {"is": "call", "id", "call", "late"} request

"late": it may have waited while this process stood still. Messages of then are dropped here: they are setpoints.

It ends when its input does. It also ends when the master has gone or was started anew, which knows no nodes then: the
other process starts it again.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import struct
import sys
import threading
import time
from collections import deque
from importlib import import_module
from typing import Any, BinaryIO

HEAD = struct.Struct("<II")

MOST_BYTES = 1 << 20
"""A longer message from the network is dropped; the longest of MAVROS' interfaces that is read here has some 100 kB."""

MOST_CALLS = 64
"""Requests of all services that wait for their answers; further ones fail at once."""

ANSWER_S = 600.0
"""All parameters over a slow radio take minutes."""

ROSPY_MEMORY_BYTES = 512 << 20
"""Limit of this process: rospy collects a message of any length that a peer names before it is seen here."""

COUNT_S = 0.25
MASTER_S = 3.0
"""From one look at the readers, and at the master, to the next."""

SLEEPS_COUNT = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""The clock that counts sleeps of the computer as well."""

BEAT_S = 0.1
LATE_S = 1.0
"""A pause of this process that is this much longer than a beat is one in which what came waited for too long."""

CATCH_UP_S = 1.0
"""After such a pause what is read within this time has waited."""

MOST_FAULTS = 10
"""Printed; further ones are the same again."""

NO_ROSPY, NO_MASTER = 4, 5
"""Exit codes."""


def packed(head: dict[str, Any], body: bytes = b"") -> bytes:
    """A frame."""
    text = json.dumps(head, separators=(",", ":")).encode()
    return HEAD.pack(len(text), len(body)) + text + body


def read_frame(file: BinaryIO) -> tuple[dict[str, Any], bytes] | None:
    """The next frame; None at the end."""
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    text_size, body_size = HEAD.unpack(head)
    text, body = file.read(text_size), file.read(body_size)
    return None if len(body) < body_size else (json.loads(text), body)


class Beat:
    """Notices that this process did not run: what came meanwhile has waited in sockets."""

    def __init__(self, clock: Any = lambda: time.clock_gettime(SLEEPS_COUNT)) -> None:
        self._clock = clock
        self._at = clock()
        self._late_until = self._at

    def run(self) -> None:
        """Watch, in a thread of its own."""
        while True:
            self.is_late()
            time.sleep(BEAT_S)

    def is_late(self) -> bool:
        """True if what is read now may have waited."""
        now = self._clock()
        if now - self._at > BEAT_S + LATE_S:
            self._late_until = now + CATCH_UP_S
        self._at = now
        return bool(now < self._late_until)


class Program:
    """Publishers, subscribers and services of one node of rospy."""

    def __init__(self, rospy: Any, out: BinaryIO) -> None:
        self._rospy = rospy
        self._out = out
        self._lock = threading.Lock()
        self._publishers: dict[int, tuple[Any, Any, Kept | None]] = {}
        self._counts: dict[int, int] = {}
        self._kept: list[Any] = []
        self._calls: dict[int, Call] = {}
        self._last_call = 0
        self.beat = Beat()

    def say(self, head: dict[str, Any], body: bytes = b"") -> None:
        """Write a frame, from any thread; it waits while the other process does not read."""
        with self._lock:
            self._out.write(packed(head, body))
            self._out.flush()

    def on_frame(self, head: dict[str, Any], body: bytes) -> None:
        """Do what a frame says."""
        what = head["do"]
        if what == "send":
            publisher, cls, kept = self._publishers[head["id"]]
            message = _filled(cls, body)
            if kept is not None:
                kept.messages.append(message)
            publisher.publish(message)
        elif what == "answer":
            call = self._calls.get(head["call"])
            if call is not None:
                call.end(body)
        elif what == "publish":
            cls = self._message_class(head["type"], head["md5"], head["text"])
            kept = Kept(head["keep"]) if head["keep"] > 1 else None
            latch = head["keep"] == 1
            publisher = self._rospy.Publisher(
                head["name"], cls, subscriber_listener=kept, latch=latch, queue_size=head["queue"]
            )
            self._publishers[head["id"]] = publisher, cls, kept
        elif what == "subscribe":
            cls = self._message_class(head["type"], head["md5"], head["text"])
            self._kept.append(
                self._rospy.Subscriber(
                    head["name"], cls, self._on_message, head["id"], queue_size=head["queue"], tcp_nodelay=True
                )
            )
        elif what == "serve":
            self._serve(head)

    def count_readers(self) -> None:
        """Report topics whose number of readers has changed."""
        for number, (publisher, _, _) in list(self._publishers.items()):
            count = publisher.get_num_connections()
            if count != self._counts.get(number, 0):
                self._counts[number] = count
                self.say({"is": "readers", "id": number, "count": count})

    def _message_class(self, type_: str, md5: str, text: str) -> Any:
        members = {"_type": type_, "_md5sum": md5, "_full_text": text, "__slots__": ()}
        return type(type_.rpartition("/")[2], (self._rospy.AnyMsg,), members)

    def _on_message(self, message: Any, number: int) -> None:
        if len(message._buff) <= MOST_BYTES and not self.beat.is_late():
            self.say({"is": "message", "id": number}, message._buff)

    def _serve(self, head: dict[str, Any]) -> None:
        request = self._message_class(head["type"] + "Request", *head["request"])
        response = self._message_class(head["type"] + "Response", *head["response"])
        members = {
            "_type": head["type"],
            "_md5sum": head["md5"],
            "_request_class": request,
            "_response_class": response,
        }
        service = type(head["type"].rpartition("/")[2], (), members)

        def handle(asked: Any) -> Any:
            return _filled(response, self._answer(head["id"], asked._buff))

        self._kept.append(self._rospy.Service(head["name"], service, handle))

    def _answer(self, service: int, request: bytes) -> bytes:
        """Bytes of the response; in a thread of rospy. Raises ServiceException."""
        is_late = self.beat.is_late()
        with self._lock:
            if len(self._calls) >= MOST_CALLS or len(request) > MOST_BYTES:
                raise self._rospy.ServiceException("too many requests wait")
            self._last_call += 1
            number = self._last_call
            call = self._calls[number] = Call()
        try:
            self.say({"is": "call", "id": service, "call": number, "late": is_late}, request)
            response = call.wait()
        finally:
            del self._calls[number]
        if response is None:
            raise self._rospy.ServiceException("no answer")
        return response


class Kept:
    """The last messages of a topic, which every later reader gets: rospy's latch has the newest only."""

    def __init__(self, most: int) -> None:
        self.messages: deque[Any] = deque(maxlen=most)

    def peer_subscribe(self, topic_name: str, topic_publish: Any, peer_publish: Any) -> None:
        """Called by rospy when a reader is there. It may get the newest twice, if that goes out meanwhile."""
        for message in list(self.messages):
            peer_publish(message)

    def peer_unsubscribe(self, topic_name: str, num_peers: int) -> None:
        """Called by rospy when a reader has gone."""


class Call:
    """One request that waits for its answer."""

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._response: bytes | None = None

    def end(self, response: bytes) -> None:
        """End the wait for the answer."""
        self._response = response
        self._ended.set()

    def wait(self) -> bytes | None:
        """The answer; None: it has not come."""
        self._ended.wait(ANSWER_S)
        return self._response


def _filled(cls: Any, data: bytes) -> Any:
    message = cls()
    message._buff = data
    return message


def _watch(program: Program, master: Any, name: str) -> None:
    """Count readers, and end with the master; in a thread of its own."""
    looked_at = time.monotonic()
    while True:
        time.sleep(COUNT_S)
        program.count_readers()
        if time.monotonic() - looked_at >= MASTER_S:
            looked_at = time.monotonic()
            try:
                master.lookupNode(name)
            except Exception:  # it is not there, or does not know this node: rospy and XML-RPC raise many
                os._exit(NO_MASTER)


def _confine() -> None:
    """Read only programs of this computer: rospy itself connects to whatever publisher the master names."""
    handler = import_module("rospy.impl.tcpros_pubsub").TCPROSHandler
    create = handler.create_transport

    def own(self: Any, resolved_name: str, pub_uri: str, protocol_params: Any) -> Any:
        address = protocol_params[1] if isinstance(protocol_params, list) and len(protocol_params) == 3 else ""
        if not _is_here(address):
            return 0, "not of this computer", 0
        return create(self, resolved_name, pub_uri, protocol_params)

    handler.create_transport = own


def _is_here(host: Any) -> bool:
    """True if a name or address is one of this computer: a socket can be bound to it."""
    try:
        found = socket.getaddrinfo(str(host), 0, type=socket.SOCK_STREAM)
        for family, kind, _, _, address in found:
            with socket.socket(family, kind) as tried:
                tried.bind(address)
    except (OSError, UnicodeError):
        return False
    return bool(found) and bool(str(host))


def limit_memory(most_bytes: int) -> None:
    """Limit the data of this process, or leave it at a lower limit that it has, of the two that a system knows."""
    limits = [one for one in resource.getrlimit(resource.RLIMIT_DATA) if one != resource.RLIM_INFINITY]
    most = min([most_bytes, *limits])
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def main() -> int:
    """Run until the input ends; the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process ends this one
    limit_memory(ROSPY_MEMORY_BYTES)
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # rospy prints
    try:
        rospy, rosgraph = import_module("rospy"), import_module("rosgraph")
    except ImportError as error:
        print(f"skygcs ros: {error}", file=sys.stderr)
        return NO_ROSPY
    if not rosgraph.is_master_online():
        return NO_MASTER
    if os.environ.get("ROS_IP") == "127.0.0.1":
        _confine()
    rospy.init_node("skygcs", anonymous=True, disable_signals=True, disable_rosout=True, disable_rostime=True)
    program = Program(rospy, out)
    program.say({"is": "up"})
    master = rosgraph.Master(rospy.get_name())
    threading.Thread(target=program.beat.run, daemon=True).start()
    threading.Thread(target=_watch, args=(program, master, rospy.get_name()), daemon=True).start()
    faults = 0
    while True:
        frame = read_frame(sys.stdin.buffer)
        if frame is None:
            break
        try:
            program.on_frame(*frame)
        except Exception as error:  # of one topic: rospy raises its own and several of Python's
            faults += 1
            if faults <= MOST_FAULTS:
                print(f"skygcs ros: {type(error).__name__}: {error}", file=sys.stderr)
    rospy.signal_shutdown("skygcs ends")
    out.close()
    os._exit(0)  # threads of rospy wait for answers


if __name__ == "__main__":
    sys.exit(main())
