"""JSON of our sockets: the one reader of what comes, the one encoder of what leaves, and replies to requests. Pure."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
from collections import Counter
from collections.abc import Mapping, Set
from typing import Any

from pydantic_core import from_json, to_json, to_jsonable_python

from skygcs.rpc.error_codes import LIMIT_EXCEEDED, PARSE_ERROR
from skygcs.rpc.json_lines import ANSWER

LEAST_DIGITS = 309
"""A number without an exponent is beyond the range of a float (1.8e308) only with so many digits."""

MOST = {"lists and objects": (b"[{", 50_000), "keys": (b":", 45_000), "values": (b",", 150_000)}
"""Marks outside of texts, and how many of them a request may have. The longest trajectory (2000 pieces of degree 15
with yaw) has 140,000 values, the paths of a plan have a list for each point, and a report of a hundred vehicles with
all their topics of ROS has 41,000 keys. 1 MiB of brackets takes 180 ms to parse, 110,000 keys take 80 ms: the tick of a
vehicle that is flown would wait so long. Within these bounds it is 15 ms for such requests, and at most 45 ms."""

_TO_ZERO = bytes(ord("0") if chr(byte).isdigit() and byte < 128 else byte for byte in range(256))
_LONG_NUMBER = b"0" * LEAST_DIGITS

_STRING = re.compile(rb'"([^"]*)"[ \t\r\n]*(:?)')
"""A string without escapes, and the colon after it if it is a key."""


class TooManyValuesError(ValueError):
    """A request has more values than any that is meant seriously; it is not parsed."""


class NotJsonError(ValueError):
    """A value has no form in JSON: it is of an unknown type, contains itself, or is nested too deeply."""


def encode(value: object, *, serialize_unknown: bool = False) -> bytes:
    """JSON in UTF-8. NaN and Infinity, which JSON lacks, become null; what is no valid Unicode, as in the name of a
    file, becomes a question mark, also in keys and bytes.

    ``serialize_unknown``: a value without a form in JSON becomes text; else NotJsonError is raised, as it is for one
    that contains itself or is nested too deeply. Nothing else is raised.
    """
    try:
        return to_json(value, inf_nan_mode="null", serialize_unknown=serialize_unknown)
    except Exception:  # code of the values' types runs
        pass
    try:
        return to_json(_cleaned(value), inf_nan_mode="null", serialize_unknown=serialize_unknown)
    except Exception as error:
        raise NotJsonError(f"{type(error).__name__}: {str(error)[:200]}") from None


def _cleaned(value: Any) -> Any:
    """The value with valid Unicode only. Raises what its types raise, and RecursionError."""
    match value:
        case str():
            return value.encode(errors="replace").decode()
        case bytes() | bytearray():
            return _cleaned(value.decode(errors="surrogateescape"))
        case Mapping():
            return {_cleaned(key) if isinstance(key, str | bytes) else key: _cleaned(one) for key, one in value.items()}
        case list() | tuple() | Set():
            return [_cleaned(one) for one in value]
        case os.PathLike():
            return _cleaned(os.fspath(value))
        case None | bool() | int() | float():
            return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _cleaned(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if callable(dump := getattr(value, "model_dump", None)):  # a model; without pydantic, which takes long to import
        return _cleaned(dump())
    return _cleaned_plain(value)


def _cleaned_plain(value: Any) -> Any:
    """A value of another type as JSON has it; one that JSON has not stays as it is."""
    try:
        plain = to_jsonable_python(value, inf_nan_mode="constants")
    except ValueError:
        return value
    return value if plain is value else _cleaned(plain)


def reply_of(request_id: object, result: bytes) -> bytes:
    """The reply with a result, which is JSON. Never raises; an id that has no form in JSON is null."""
    return b'%b%b,"result":%b}' % (ANSWER, _encoded_id(request_id), result)


def error_reply(request_id: object, code: int, message: str, data: object = None) -> bytes:
    """The reply with an error (`skygcs.rpc.error_codes`). Never raises; without ``data`` that has no form in JSON."""
    error: dict[str, object] = {"code": code, "message": message}
    body = encode(error)
    if data is not None:
        with contextlib.suppress(NotJsonError):
            body = encode(error | {"data": data}, serialize_unknown=True)
    return b'%b%b,"error":%b}' % (ANSWER, _encoded_id(request_id), body)


def _encoded_id(request_id: object) -> bytes:
    try:
        return encode(request_id)
    except NotJsonError:
        return b"null"


def parse(line: bytes) -> Any:
    """The JSON value of one line. Raises ValueError with a text for a person (also for NaN, too deep nesting, and a
    number that no float can hold, as 1e999, which would be read as infinity)."""
    value = from_json(line, allow_inf_nan=False, cache_strings="keys")
    if _may_overflow(line) and _has_infinity(value):
        raise ValueError("a number in it is too large: 1.79e308 at most")
    return value


def parse_request(line: bytes) -> Any:
    """`parse` of what a client asks. Raises ValueError, TooManyValuesError among them."""
    if len(line) > min(most for _, most in MOST.values()) and (why := _too_many(line)):
        raise TooManyValuesError(why)
    return parse(line)


def unread(error: ValueError) -> tuple[int, str]:
    """The code and the text of the answer to a line that `parse_request` refused."""
    if isinstance(error, TooManyValuesError):
        return LIMIT_EXCEEDED, str(error)
    return PARSE_ERROR, f"not JSON: {error}"


def _too_many(line: bytes) -> str:
    """Which bound of `MOST` a line exceeds; "": none. 1 ms for 1 MiB; what is in texts is left out only where it
    matters, in 2 ms, with 100,000 texts in 16 ms."""
    outside = False
    for what, (marks, most) in MOST.items():
        if _count(line, marks) > most and not outside:
            # a backslash is in texts only: without escapes every second part is outside of them
            line = b"".join(line.replace(rb"\\", b"").replace(rb"\"", b"").split(b'"')[::2])
            outside = True
        if _count(line, marks) > most:
            return f"a line has at most {most} {what}"
    return ""


def _count(line: bytes, marks: bytes) -> int:
    return sum(line.count(mark) for mark in marks)


def _may_overflow(line: bytes) -> bool:
    """False if no number of a line is beyond the range of a float. 2 ms for 1 MiB."""
    return b"e" in line or b"E" in line or _LONG_NUMBER in line.translate(_TO_ZERO)


def _has_infinity(value: object) -> bool:
    """True if a number of the value is infinite. The value is asked, not its text: 2 ms for 1 MiB of text, 20 ms for
    260,000 floats. A text may have the word, too, and has it in either form."""
    word = b"Infinity"
    written = to_json(value, inf_nan_mode="constants")
    return word in written and written.count(word) != to_json(value, inf_nan_mode="null").count(word)


def key_twice(line: bytes) -> str | None:
    """A key that an object of a line has twice, which `parse` does not report. ``line``: what `parse` accepted."""
    found: list[str] = []
    # most large lines are trajectories, in which no key occurs twice anywhere: 0.4 ms and not 34 for 1 MB
    if b"\\" not in line:
        seen = [string for string, colon in _STRING.findall(line) if colon]
        if len(set(seen)) == len(seen):
            return None

    def collect(pairs: list[tuple[str, Any]]) -> None:
        keys = [key for key, _ in pairs]
        if not found and len(set(keys)) < len(keys):
            found.append(Counter(keys).most_common(1)[0][0])

    json.loads(line, object_pairs_hook=collect, parse_int=str)  # str: int() refuses numbers that `parse` accepts
    return found[0] if found else None
