"""JSON of what leaves a socket of ours: the one encoder, and replies to requests. Pure."""

from __future__ import annotations

import json

from pydantic_core import PydanticSerializationError, to_json, to_jsonable_python

from skygcs.rpc.json_lines import ANSWER


def encode(value: object, *, serialize_unknown: bool = False) -> bytes:
    """JSON in UTF-8. NaN and Infinity, which JSON lacks, become null; what is no valid Unicode, as in the name of a
    file, becomes a question mark.

    ``serialize_unknown``: a value without a form in JSON becomes text; else PydanticSerializationError is raised.
    """
    try:
        return to_json(value, inf_nan_mode="null", serialize_unknown=serialize_unknown)
    except PydanticSerializationError:
        plain = to_jsonable_python(value, inf_nan_mode="null", serialize_unknown=serialize_unknown)
        return json.dumps(plain, ensure_ascii=False, separators=(",", ":")).encode(errors="replace")


def reply_of(request_id: object, result: bytes) -> bytes:
    """The reply with a result, which is JSON."""
    return b'%b%b,"result":%b}' % (ANSWER, encode(request_id), result)


def error_reply(request_id: object, code: int, message: str, data: object = None) -> bytes:
    """The reply with an error (`skygcs.rpc.error_codes`)."""
    error: dict[str, object] = {"code": code, "message": message}
    if data is not None:
        error["data"] = data
    return b'%b%b,"error":%b}' % (ANSWER, encode(request_id), encode(error, serialize_unknown=True))
