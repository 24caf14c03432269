"""The program that reads every topic and calls every service by Fast DDS alone, and what it found."""

from __future__ import annotations

import contextlib
import json
import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ros.bridge_graph import Graph, table
from ros.fast_dds import built_alone
from skygcs.core.ros.interfaces import EMPTY_MEMBER, Interfaces
from skygcs.ext.ros.dds import SERVICE_HEADER
from support.process import DaemonProcess, wait_until

Fields = dict[str, Any]


class Message(NamedTuple):
    """A sample: its bytes as they came, and the fields that Fast DDS read in them."""

    data: bytes
    fields: Fields


class EveryTopicNode:
    """The program, running; a context manager."""

    def __init__(self, folder: Path, domain: int, known: Interfaces, graph: Graph) -> None:
        self.known, self.graph = known, graph
        self._table = folder / "every_topic.table"
        self._table.write_text("\n".join(table(known, graph)) + "\n")
        self._domain = domain
        self._said: list[str] = []
        self._replies: dict[int, str] = {}
        self._messages: list[str] = []
        self._dumped: list[list[str]] = []
        self._number = 0

    def __enter__(self) -> EveryTopicNode:
        line = [str(built_alone("every_topic_node")), str(self._domain), str(self._table)]
        self.process = subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()
        wait_until(lambda: "ready" in self._said, "the program of Fast DDS is ready")
        return self

    def wait_for_the_bridge(self, fleet: DaemonProcess) -> None:
        """Until the bridge knows all readers: a reply to a client that it does not know would be lost."""

        def read() -> bool:
            topics = {topic["name"] for topic in fleet.call("ros.status")["report"]["topics"] if topic["readers"]}
            return topics >= self.graph.topics.keys()

        wait_until(read, "the bridge knows the readers of every topic")

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self._reading.join()
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdout.close()
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            word, _, rest = line.rstrip("\n").partition(" ")
            if word == "reply":
                number, _, text = rest.partition(" ")
                self._replies[int(number)] = text
            elif word == "message":
                self._messages.append(rest)
            elif word == "done":
                self._dumped, self._messages = [self._messages], []
            elif word != "topic":
                self._said.append(f"{word} {rest}".strip())

    def _say(self, line: str) -> None:
        assert self.process.stdin is not None
        assert self.process.poll() is None, (self.process.returncode, line)
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def begin(self, service: str, request: Mapping[str, Any]) -> int:
        """Send a request, and return its number. ``request``: values by path, as "waypoints.0.frame"."""
        self._number += 1
        self._say(f"call {self._number} {service} {_words(request)}")
        return self._number

    def write(self, topic: str, message: Mapping[str, Any]) -> None:
        self._say(f"write {topic} {_words(message)}")

    def reply(self, number: int, service: str) -> Fields:
        """The response, once it is there: rosbags reads the same in its bytes."""
        line = wait_until(lambda: self._replies.get(number), f"{service} answers; {self._said}")
        text, _, rest = line.partition(" ")
        data, fields = bytes.fromhex(text), json.loads(rest)
        assert SERVICE_HEADER.unpack_from(data, 4) == (fields.pop("client_guid"), fields.pop("sequence_number"))
        message = Message(data[:4] + data[4 + SERVICE_HEADER.size :], fields)
        return self.checked(f"{self.graph.services[service]}_Response", message)

    def call(self, service: str, **request: Any) -> Fields:
        return self.reply(self.begin(service, request), service)

    def dump(self, start: str = "/") -> dict[str, list[Message]]:
        """The last messages of every topic whose name begins so."""
        self._dumped = []
        self._say(f"dump {start}")
        wait_until(lambda: self._dumped, f"the program of Fast DDS has shown what came; {self._said}")
        found: dict[str, list[Message]] = {name: [] for name in self.graph.topics if name.startswith(start)}
        for line in self._dumped[0]:
            name, text, fields = line.split(" ", 2)
            found[name].append(Message(bytes.fromhex(text), json.loads(fields)))
        return found

    def checked(self, type_: str, message: Message) -> Fields:
        """The fields that Fast DDS read, which are those that rosbags reads in the same bytes."""
        fields = {name: value for name, value in message.fields.items() if name != EMPTY_MEMBER}
        assert same(fields, self.known.decode(type_, message.data)), (type_, fields)
        return fields


def same(one: Any, other: Any) -> bool:
    """Equality in which NaN is NaN."""
    if isinstance(one, dict):
        keys = one.keys() - {EMPTY_MEMBER}
        return keys == other.keys() and all(same(one[key], other[key]) for key in keys)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other or (one != one and other != other))


def _words(values: Mapping[str, Any]) -> str:
    words = []
    for path, value in values.items():
        text = ",".join(map(str, value)) if isinstance(value, (list, tuple, bytes)) else str(value)
        words.append(f"{path}={text.lower() if isinstance(value, bool) else text}")
    return " ".join(words)
