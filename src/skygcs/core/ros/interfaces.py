"""The one table of ROS interfaces: definitions, CDR and ROS 1 encodings, type names and type hashes.

rosbags has the interfaces of ROS itself; those that it lacks are the texts in `definitions`, one after another:

    MSG: mavros_msgs/RCOut        SRV: mavros_msgs/CommandBool
    std_msgs/Header header        bool value
    uint16[] channels             ---
                                  bool success
                                  uint8 result

A message is a dictionary of its fields by name; what is left out is zero, "" or empty.
"""

from __future__ import annotations

import functools
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from importlib.resources import files
from typing import Any, Literal

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Fields = Mapping[str, Any]

PX4_RELEASES = ("1.14", "1.15", "1.16", "1.17", "1.18")
"""Releases of px4_msgs whose definitions are here: they differ, and a name does not show which one it is."""

Px4Release = Literal["1.14", "1.15", "1.16", "1.17", "1.18"]

EMPTY_MEMBER = "structure_needs_at_least_one_member"
"""The member of a message without fields, as ROS 2's generators write it (uint8)."""

EVENT_INFO = "service_msgs/msg/ServiceEventInfo"

PACKAGES = "skygcs.core.ros"


class InterfaceError(ValueError):
    """A message that its interface does not describe: an unknown field, or bytes of another type."""


class Interfaces:
    """The interfaces of one ROS version. ``type``: as "std_msgs/msg/Header" everywhere, in ROS 1, too.

    A service "mavros_msgs/srv/SetMode" has the types of that name with _Request and _Response.
    """

    def __init__(self, store: Stores, px4_release: Px4Release | None) -> None:
        self.store = get_typestore(store)
        self.ros1 = store is Stores.ROS1_NOETIC
        self._hashes: dict[str, str] = {}
        self._builders: dict[str, Callable[[Fields], Any]] = {}
        for name, text in definitions(px4_release):
            if name not in self.store.types:
                self.store.register(_parsed(text, name))
        if EVENT_INFO in self.store.fielddefs:
            self._correct_char()

    def _correct_char(self) -> None:
        """A "char" of an interface file is a uint8 in IDL, and in the hash; rosbags takes it for IDL's char."""
        constants, fields = self.store.fielddefs[EVENT_INFO]
        octets = (Nodetype.ARRAY, ((Nodetype.BASE, ("uint8", 0)), 16))
        corrected: Any = [(name, octets if name == "client_gid" else description) for name, description in fields]
        self.store.fielddefs[EVENT_INFO] = (constants, corrected)

    # -- messages

    def encode(self, type_: str, fields: Fields) -> bytes:
        """CDR (XCDR1, little endian) with its header of 4 bytes; ROS 1's own encoding in ROS 1. Raises
        InterfaceError."""
        message = self.make(type_, fields)
        write = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        try:
            return bytes(write(message, type_))
        except struct.error as error:  # a number that its field does not take
            raise InterfaceError(f"{type_}: {error}") from None

    def make(self, type_: str, fields: Fields) -> Any:
        """The object that rosbags writes. Raises InterfaceError."""
        build = self._builders.get(type_) or self._builder(type_)
        try:
            return build(fields)
        except (TypeError, ValueError, AttributeError) as error:
            raise InterfaceError(f"{type_}: {error}") from None

    def decode(self, type_: str, data: bytes) -> dict[str, Any]:
        """The fields of bytes that came from anywhere; arrays as lists. Raises InterfaceError."""
        read = self.store.deserialize_ros1 if self.ros1 else self.store.deserialize_cdr
        try:
            message = read(data, type_)
        except Exception as error:  # rosbags raises its own and several of Python's: none is about us
            raise InterfaceError(f"{type_}: {error}") from None
        fields: dict[str, Any] = self._plain(message)
        return fields

    def _plain(self, message: Any) -> Any:
        """Dictionaries and lists in place of rosbags' classes, which have an interface's constants as fields, too."""
        if isinstance(message, np.ndarray):
            return message.tolist()
        if isinstance(message, list):
            return [self._plain(one) for one in message]
        type_ = getattr(message, "__msgtype__", None)
        if type_ is None:
            return message
        return {
            name: self._plain(getattr(message, name))
            for name, _ in self.store.fielddefs[type_][1]
            if name != EMPTY_MEMBER
        }

    def fields_of(self, type_: str) -> tuple[str, ...]:
        """The names of the fields of a type. Raises KeyError."""
        return tuple(name for name, _ in self.store.fielddefs[type_][1])

    def only_known(self, type_: str, fields: Fields) -> dict[str, Any]:
        """Those fields that the type has: px4_msgs' definitions differ between its releases."""
        known = self.fields_of(type_)
        return {name: value for name, value in fields.items() if name in known}

    def constant(self, type_: str, name: str) -> Any:
        """The value of a constant of a message. Raises KeyError."""
        for constant, _, value in self.store.fielddefs[type_][0]:
            if constant == name:
                return value
        raise KeyError(name)

    # -- names

    def type_hash(self, type_: str) -> str:
        """REP 2011's hash of a message or service, "RIHS01_…"."""
        if type_ not in self._hashes:
            if f"{type_}_Request" in self.store.types and type_ not in self.store.types:
                self._register_service(type_)
            self._hashes[type_] = str(self.store.hash_rihs01(type_))
        return self._hashes[type_]

    def _register_service(self, service: str) -> None:
        """The types from which the hash of a service is made."""
        request, response = f"{service}_Request", f"{service}_Response"
        event = f"service_msgs/ServiceEventInfo info\n{request}[<=1] request\n{response}[<=1] response\n"
        self.store.register(_parsed(event, f"{service}_Event"))
        whole = f"{request} request_message\n{response} response_message\n{service}_Event event_message\n"
        self.store.register(_parsed(whole, service))

    def ros1_definition(self, type_: str) -> tuple[str, str]:
        """Text and MD5 sum of a ROS 1 message."""
        text, md5 = self.store.generate_msgdef(type_, ros_version=1)
        return text, md5

    # -- private

    def _builder(self, type_: str) -> Callable[[Fields], Any]:
        cls = self.store.types[type_]
        makers = {name: self._maker(description) for name, description in self.store.fielddefs[type_][1]}
        known = makers.keys()

        def build(fields: Fields) -> Any:
            if not fields.keys() <= known:
                raise ValueError(f"has no field {', '.join(sorted(fields.keys() - known))}")
            return cls(**{name: make(fields.get(name)) for name, make in makers.items()})

        self._builders[type_] = build
        return build

    def _maker(self, description: Any) -> Callable[[Any], Any]:
        kind, what = description
        if kind == Nodetype.BASE:
            return _scalar_maker(what[0])
        if kind == Nodetype.NAME:
            build = self._builders.get(what) or self._builder(what)
            return lambda value: build({} if value is None else value)
        (inner_kind, inner), count = what
        if inner_kind == Nodetype.BASE and inner[0] not in ("string", "wstring"):
            return _array_maker(np.dtype(_DTYPES.get(inner[0], inner[0])), count if kind == Nodetype.ARRAY else None)
        make = self._maker((inner_kind, inner))
        fixed = count if kind == Nodetype.ARRAY else 0
        return lambda value: [make(one) for one in (value or [None] * fixed)]


_DTYPES = {"bool": "bool", "byte": "uint8", "char": "uint8", "octet": "uint8"}

_SCALARS: dict[str, type[Any]] = {
    "string": str,
    "wstring": str,
    "bool": bool,
    "float32": float,
    "float64": float,
}


def _scalar_maker(base: str) -> Callable[[Any], Any]:
    convert: type[Any] = _SCALARS.get(base, int)
    zero = convert()
    return lambda value: zero if value is None else convert(value)


def _array_maker(dtype: np.dtype[Any], length: int | None) -> Callable[[Any], Any]:
    def make(value: Any) -> Any:
        if value is None:
            return np.zeros(length or 0, dtype)
        array = np.asarray(value, dtype)
        if array.ndim != 1 or (length is not None and len(array) != length):
            raise ValueError(f"an array of {length} values has {array.shape}")
        return array

    return make


def _parsed(text: str, name: str) -> dict[str, Any]:
    """rosbags' description of one type; it would put the types of services and actions into the folder msg."""

    def renamed(part: Any) -> Any:
        if isinstance(part, str):
            return re.sub("/(srv|action)/msg/", r"/\1/", part)
        if isinstance(part, tuple):
            return tuple(map(renamed, part))
        return list(map(renamed, part)) if isinstance(part, list) else part

    return {renamed(key): renamed(value) for key, value in get_types_from_msg(text, name).items()}


def dds_type_name(type_: str) -> str:
    """The name of a type in DDS: "std_msgs::msg::dds_::Header_"."""
    package, kind, name = type_.split("/")
    return f"{package}::{kind}::dds_::{name}_"


@functools.cache
def ros2_interfaces(px4_release: Px4Release = "1.16") -> Interfaces:
    """The interfaces of ROS 2 Jazzy; those that are used here are the same in Humble and Rolling."""
    return Interfaces(Stores.ROS2_JAZZY, px4_release)


@functools.cache
def ros1_interfaces() -> Interfaces:
    """The interfaces of ROS 1 Noetic."""
    return Interfaces(Stores.ROS1_NOETIC, None)


def definitions(px4_release: Px4Release | None) -> Iterator[tuple[str, str]]:
    """Name and text of each message that rosbags lacks; of a service two, of an action those that carry it."""
    names = ["common", "mavros_msgs"]
    if px4_release is not None:
        names.append(f"px4_msgs_{px4_release.replace('.', '_')}")
    for name in names:
        text = (files(PACKAGES) / "definitions" / f"{name}.txt").read_text("utf-8")
        yield from parse_definitions(text)
    for kind in ("msg", "srv", "action"):
        folder = files(PACKAGES) / "skygcs_msgs" / kind
        if folder.is_dir():
            for path in sorted(folder.iterdir(), key=lambda path: path.name):
                head = f"{kind.upper()}: skygcs_msgs/{path.name.rpartition('.')[0]}\n"
                yield from parse_definitions(head + path.read_text("utf-8"))


def parse_definitions(text: str) -> Iterator[tuple[str, str]]:
    """Name and text of each message in a text of definitions. Raises ValueError."""
    for block in re.split(r"^(?=(?:MSG|SRV|ACTION): )", text, flags=re.MULTILINE):
        if not block.strip():
            continue
        head, _, body = block.partition("\n")
        kind, _, name = head.partition(": ")
        package, _, base = name.strip().partition("/")
        parts = re.split(r"^---\s*$", body, flags=re.MULTILINE)
        if kind == "MSG":
            yield f"{package}/msg/{base}", body
        elif kind == "SRV" and len(parts) == 2:
            for part, suffix in zip(parts, ("Request", "Response"), strict=True):
                yield f"{package}/srv/{base}_{suffix}", _not_empty(part)
        elif kind == "ACTION" and len(parts) == 3:
            yield from _action(f"{package}/action/{base}", parts)
        else:
            raise ValueError(f"{head}: its parts are not those of {kind}")


def _action(action: str, parts: list[str]) -> Iterator[tuple[str, str]]:
    """The types that carry an action: of its three own parts, its two services and its feedback message."""
    for part, suffix in zip(parts, ("Goal", "Result", "Feedback"), strict=True):
        yield f"{action}_{suffix}", _not_empty(part)
    goal_id = "unique_identifier_msgs/UUID goal_id\n"
    yield f"{action}_SendGoal_Request", f"{goal_id}{action}_Goal goal\n"
    yield f"{action}_SendGoal_Response", "bool accepted\nbuiltin_interfaces/Time stamp\n"
    yield f"{action}_GetResult_Request", goal_id
    yield f"{action}_GetResult_Response", f"int8 status\n{action}_Result result\n"
    yield f"{action}_FeedbackMessage", f"{goal_id}{action}_Feedback feedback\n"


def _not_empty(text: str) -> str:
    has_fields = any("=" not in line.partition("#")[0] and line.partition("#")[0].strip() for line in text.splitlines())
    return text if has_fields else f"{text}\nuint8 {EMPTY_MEMBER}\n"
