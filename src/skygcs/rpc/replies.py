"""JSON of what leaves a socket of ours: the one encoder, and replies to requests. Pure."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Mapping, Set
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_json, to_jsonable_python

from skygcs.rpc.json_lines import ANSWER


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
        case BaseModel():
            return _cleaned(value.model_dump())
        case os.PathLike():
            return _cleaned(os.fspath(value))
        case None | bool() | int() | float():
            return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _cleaned(getattr(value, field.name)) for field in dataclasses.fields(value)}
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
