"""JSON-RPC 2.0 without I/O: one parsed request in, one encoded reply out. https://www.jsonrpc.org/specification

Why not a library: docs/decisions/0002-json-rpc-dispatch.md.
"""

from __future__ import annotations

import asyncio
import functools
import importlib
import inspect
import json
import math
import re
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import structlog
from pydantic import ValidationError
from pydantic_core import PydanticSerializationError, from_json, to_json, to_jsonable_python

from skygcs.cancellation import end_if_cancelled
from skygcs.errors import (
    BusError,
    ConfigError,
    DialectError,
    LinkError,
    RefusedError,
    RpcError,
    SkygcsError,
    TargetError,
)
from skygcs.number_text import is_number
from skygcs.rpc.error_codes import (
    INTERNAL_ERROR,
    INVALID_PARAMS,
    INVALID_REQUEST,
    LIMIT_EXCEEDED,
    LINK_ERROR,
    METHOD_NOT_FOUND,
    REFUSED,
    TARGET_ERROR,
)
from skygcs.rpc.models import MethodParams
from skygcs.rpc.order_reports import is_request_id
from skygcs.spelling import near_names

MAX_ECHO_CHARS = 80
"""Most characters of a client's input that an error text repeats."""

_STRING = re.compile(rb'"([^"]*)"[ \t\r\n]*(:?)')
"""A string without escapes, and the colon after it if it is a key."""

_MAYBE_INFINITE = re.compile(rb"[0-9][eE]\+?[0-9]{3}|(?<![0-9])[0-9]{200}")
"""In each line with a number beyond the range of a float: with fewer digits and a shorter exponent it is within."""

_log = structlog.get_logger(__name__)
C = TypeVar("C")


class InvalidParams(SkygcsError):
    """Parameters of the right types that still do not fit; ``problems`` is (parameter, what is wrong with it)."""

    def __init__(self, *problems: tuple[str, str]) -> None:
        self.problems = problems
        super().__init__("; ".join(f"{p}: {text}" if p else text for p, text in problems))


class LimitExceeded(SkygcsError):
    """A client has reached a limit per client; the text names it."""


@dataclass(frozen=True)
class Method(Generic[C]):
    """One method: its handler gets the session's context and checked parameters, and answers.

    A handler that is a plain function runs at once, without a task; the first line of its docstring is the summary.
    ``outlives_client``: once asked for it is carried out to its end, whether or not the client stays for the answer.
    ``always``: it is answered to a client that came when all places were taken, and while the daemon shuts down: what
    ends a flight or shows what flies. ``while_stopping``: it is answered while the daemon shuts down (5 s at most).
    ``unique_keys``: a request in which an object has a key twice is refused, as the last one would silently win.
    """

    name: str
    params: type[MethodParams]
    handler: Callable[[C, Any], Any]
    result: Any = dict
    errors: tuple[int, ...] = ()
    outlives_client: bool = False
    always: bool = False
    while_stopping: bool = False
    unique_keys: bool = False


class Later(NamedTuple):
    """Methods of a module that is imported when one of them is first called: ``part`` of it, a tuple of methods.

    The call that has it imported does not outlive its client. Which methods are `Method.always` or
    `Method.while_stopping` is said here, too: whether a client is let in must not wait for an import.
    """

    module: str
    part: str
    names: tuple[str, ...]
    always: tuple[str, ...] = ()
    while_stopping: tuple[str, ...] = ()


class MethodTable(Mapping[str, Method[C]]):
    """Methods by name, in the order in which they are documented. To read one of a `Later` part imports its module."""

    def __init__(self, *parts: Iterable[Method[C]] | Later) -> None:
        self._parts = parts
        self.later = tuple(part for part in parts if isinstance(part, Later))
        self._methods: dict[str, Method[C] | Later] = {}
        self.always: set[str] = set()
        self.while_stopping: set[str] = set()
        """With those that are always answered."""
        self.coroutines: set[str] = set()
        """Names of the imported methods whose handlers are coroutines."""
        for part in parts:
            if isinstance(part, Later):
                self._methods |= dict.fromkeys(part.names, part)
                self.always.update(part.always)
                self.while_stopping.update(part.always, part.while_stopping)
            else:
                self._take(part)

    def extended(self, methods: Collection[Method[C]]) -> MethodTable[C]:
        """A new table of these and further methods. Raises ValueError if one of them has the name of another."""
        table: MethodTable[C] = MethodTable(*self._parts)
        table.add(methods)
        return table

    def add(self, methods: Collection[Method[C]]) -> None:
        """Take further methods. Raises ValueError if one of them has the name of another."""
        self.require_free(methods)
        self._take(methods)

    def require_free(self, methods: Collection[Method[C]]) -> None:
        """Raises ValueError if one of these has the name of another."""
        twice = sorted(method.name for method in methods if method.name in self._methods)
        if twice:
            raise ValueError(f"two methods are called {', '.join(twice)}")

    def __getitem__(self, name: str) -> Method[C]:
        found = self._methods[name]
        if isinstance(found, Later):
            self.load(found)
            found = self._methods[name]
            assert isinstance(found, Method), f"{name} is no method of its module"
        return found

    def __contains__(self, name: object) -> bool:
        """True if it has this method; nothing is imported for it."""
        return name in self._methods

    def __iter__(self) -> Iterator[str]:
        return iter(self._methods)

    def __len__(self) -> int:
        return len(self._methods)

    def missing(self, name: str) -> Later | None:
        """Return what has to be imported before this method can be called."""
        found = self._methods.get(name)
        if not isinstance(found, Later):
            return None
        if hasattr(sys.modules.get(found.module), found.part):  # somebody else has imported it, to its end
            self.load(found)
            return None
        return found

    def load(self, part: Later) -> None:
        """Take the methods of a part; its module is imported if it was not."""
        self._take(getattr(importlib.import_module(part.module), part.part))

    def _take(self, methods: Iterable[Method[C]]) -> None:
        for method in methods:
            self._methods[method.name] = method
            if method.always:
                self.always.add(method.name)
            if method.always or method.while_stopping:
                self.while_stopping.add(method.name)
            if inspect.iscoroutinefunction(method.handler):
                self.coroutines.add(method.name)


@dataclass(frozen=True, slots=True)
class Encoded:
    """A result that is JSON already: another process made it, and nothing of it is decoded here."""

    body: bytes


class OnDemand(Protocol):
    """Methods that come into the table when one of them is first called."""

    def may_have(self, name: str) -> bool:
        """True if a method that is not in the table may come into it."""
        ...

    async def add(self, name: str) -> None:
        """Add it, if it exists. Raises what adding it raises."""
        ...


Admit = Callable[[Mapping[str, Any]], bytes | None]
"""The encoded refusal of a request that is not to be carried out now; None: it is."""

Reply = bytes | Coroutine[Any, Any, bytes] | None
"""Encoded reply without newline; or a coroutine that makes it; or None (a notification that is done)."""


class Dispatcher(Generic[C]):
    """Finds the method, checks its parameters, runs it, encodes the reply. Never raises for what a client sent."""

    def __init__(
        self,
        methods: Mapping[str, Method[C]],
        import_beside: Callable[[str], Awaitable[None]] | None = None,
        on_demand: OnDemand | None = None,
    ) -> None:
        """``import_beside`` imports a module while the loop goes on; None: `MethodTable.load` does it at once.
        ``on_demand`` adds to ``methods``."""
        self._methods = methods if isinstance(methods, MethodTable) else MethodTable(methods.values())
        self._import_beside = import_beside
        self._on_demand = on_demand
        self.always = self._methods.always
        self.while_stopping = self._methods.while_stopping

    def start(
        self,
        context: C,
        request: object,
        key_twice: Callable[[], str | None] = lambda: None,
        admit: Admit = lambda request: None,
    ) -> Reply:
        """Answer one request. A coroutine must be awaited or closed by the caller; its b"" is not to be sent.

        ``key_twice``: `key_twice` of the line that the request came in; called where the method needs it. ``admit`` is
        asked before an import, and again before the handler: much time may pass between.
        """
        if type(request) is not dict:
            return error_reply(None, INVALID_REQUEST, "a request is a JSON object")
        request_id = request.get("id")
        if request_id is not None and not is_request_id(request_id):
            return error_reply(None, INVALID_REQUEST, "id must be a string or a number")
        name = request.get("method")
        if request.get("jsonrpc") != "2.0" or type(name) is not str:
            return error_reply(request_id, INVALID_REQUEST, 'a request has "jsonrpc": "2.0" and a method name')
        notification = "id" not in request
        if (refusal := admit(request)) is not None:
            return None if notification else refusal
        if (prepare := self._preparation(name)) is not None:
            return self._start_later(prepare, context, request, key_twice, admit)
        try:
            method = self._methods.get(name)
            if method is None:
                raise _MethodNotFound(name, self._methods)
            if method.unique_keys and (twice := key_twice()) is not None:
                raise InvalidParams(("", f"the key {_clip(twice)!r} is there twice in one object"))
            params = _check(method.params, request.get("params"))
            if name in self._methods.coroutines:
                return self._finish(method, context, params, request_id, notification)
            result = method.handler(context, params)
        except Exception as error:
            return None if notification else failure_reply(request_id, name, error)
        return None if notification else result_reply(request_id, name, result)

    def outlives_client(self, request: object) -> bool:
        """True if a request that `start` answered with a coroutine is to be finished without its client, too."""
        if not isinstance(request, dict):
            return False
        name = request["method"]
        return name in self._methods and self._methods.missing(name) is None and self._methods[name].outlives_client

    def _preparation(self, name: str) -> Callable[[], Awaitable[None]] | None:
        """Return what has to be awaited before this method can be called; None: nothing."""
        if self._import_beside is not None and (part := self._methods.missing(name)) is not None:
            return functools.partial(self._import, self._import_beside, part)
        if self._on_demand is not None and self._on_demand.may_have(name):
            return functools.partial(self._on_demand.add, name)
        return None

    async def _import(self, import_beside: Callable[[str], Awaitable[None]], part: Later) -> None:
        await import_beside(part.module)
        self._methods.load(part)

    async def _start_later(
        self,
        prepare: Callable[[], Awaitable[None]],
        context: C,
        request: dict[str, Any],
        key_twice: Callable[[], str | None],
        admit: Admit,
    ) -> bytes:
        """The first calls of methods that are imported for them, beside the loop, in their order."""
        try:
            await prepare()
        except Exception as error:
            return failure_reply(request["id"], request["method"], error) if "id" in request else b""
        reply = self.start(context, request, key_twice, admit)
        return await reply if isinstance(reply, Coroutine) else reply or b""

    async def _finish(
        self, method: Method[C], context: C, params: MethodParams, request_id: object, notification: bool
    ) -> bytes:
        try:
            result = await method.handler(context, params)
        except asyncio.CancelledError:
            end_if_cancelled()  # its client is gone, or the daemon ends
            # what it waited for was cancelled by something else: the client is there and waits for an answer
            cancelled = RefusedError(f"{method.name} was cancelled: a vehicle of it is gone or renumbered; ask again")
            return b"" if notification else failure_reply(request_id, method.name, cancelled)
        except Exception as error:
            return b"" if notification else failure_reply(request_id, method.name, error)
        return b"" if notification else result_reply(request_id, method.name, result)


class _MethodNotFound(SkygcsError):
    def __init__(self, name: str, known: Mapping[str, object]) -> None:
        close = near_names(name[:MAX_ECHO_CHARS], known, n=3)
        hint = f"; did you mean {', '.join(close)}?" if close else "; rpc.discover lists the methods"
        table, dot, _ = name[:MAX_ECHO_CHARS].partition(".")
        if dot and not any(one.startswith(f"{table}.") for one in known):
            hint = f"; rpc.discover lists the methods; an extension's need its table in the fleet file, as [{table}]"
        super().__init__(f"no method {_clip(name)}{hint}")


def parse(line: bytes) -> Any:
    """The JSON value of one line. Raises ValueError with a text for a person (also for NaN, too deep nesting, and a
    number that no float can hold, as 1e999, which would be read as infinity)."""
    value = from_json(line, allow_inf_nan=False, cache_strings="keys")
    if _MAYBE_INFINITE.search(line) is not None:
        json.loads(line, parse_float=_finite, parse_int=str)  # str: int() refuses numbers that `from_json` accepts
    return value


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:20]} is too large")
    return value


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


def key_twice(line: bytes) -> str | None:
    """A key that an object of a line has twice, which `parse` does not report. ``line``: what `parse` accepted."""
    found: list[str] = []
    if (
        b"\\" not in line
    ):  # most large lines are trajectories, in which no key occurs twice anywhere: 0.4 ms and not 34 for 1 MB
        seen = [string for string, colon in _STRING.findall(line) if colon]
        if len(set(seen)) == len(seen):
            return None

    def collect(pairs: list[tuple[str, Any]]) -> None:
        keys = [key for key, _ in pairs]
        if not found and len(set(keys)) < len(keys):
            found.append(Counter(keys).most_common(1)[0][0])

    json.loads(line, object_pairs_hook=collect, parse_int=str)  # str: int() refuses numbers that `parse` accepts
    return found[0] if found else None


def deadline_refusal(request: Mapping[str, Any], now: float) -> bytes | None:
    """The reply to a request whose ``deadline_s`` has passed or is no number; None: it is to be carried out.

    ``now``: the daemon's clock, which daemon.info shows.
    """
    deadline_s = request["deadline_s"]
    request_id = request.get("id")
    if not is_request_id(request_id):
        request_id = None
    if not is_number(deadline_s):
        return error_reply(request_id, INVALID_REQUEST, "deadline_s must be a number: seconds of daemon.info's now_s")
    if now <= deadline_s:
        return None
    text = f"read {now - deadline_s:.1f} s after its deadline; it was not carried out"
    return error_reply(request_id, REFUSED, text)


def result_reply(request_id: object, name: str, result: object) -> bytes:
    """NaN and Infinity, which JSON lacks, become null."""
    try:
        body = result.body if isinstance(result, Encoded) else encode(result)
    except PydanticSerializationError as error:
        return failure_reply(request_id, name, error)
    return b'{"jsonrpc":"2.0","id":%b,"result":%b}' % (_encode_id(request_id), body)


def error_reply(request_id: object, code: int, message: str, data: object = None) -> bytes:
    error: dict[str, object] = {"code": code, "message": message}
    if data is not None:
        error["data"] = data
    body = encode(error, serialize_unknown=True)
    return b'{"jsonrpc":"2.0","id":%b,"error":%b}' % (_encode_id(request_id), body)


def failure_reply(request_id: object, name: str, error: Exception) -> bytes:
    """The reply for an exception; an unexpected one is logged here and answered without its text."""
    match error:
        case ValidationError():
            return _params_reply(request_id, name, _problems(error))
        case InvalidParams():
            return _params_reply(request_id, name, list(error.problems))
        case ConfigError():
            return _params_reply(request_id, name, [("", problem) for problem in error.problems])
        case DialectError():
            return _params_reply(request_id, name, [("", str(error))])
        case _MethodNotFound():
            return error_reply(request_id, METHOD_NOT_FOUND, str(error))
        case TargetError():
            return error_reply(request_id, TARGET_ERROR, str(error))
        case RefusedError():
            return error_reply(request_id, REFUSED, str(error))
        case LinkError() | BusError():
            return error_reply(request_id, LINK_ERROR, str(error))
        case LimitExceeded():
            return error_reply(request_id, LIMIT_EXCEEDED, str(error))
        case RpcError():  # of another server, which was asked for this one's client
            return error_reply(request_id, error.code, str(error), error.data)
    _log.error("rpc method failed", method=name, exc_info=error)
    return error_reply(request_id, INTERNAL_ERROR, f"{_clip(name)} failed inside the daemon; its log says why")


def _params_reply(request_id: object, name: str, problems: list[tuple[str, str]]) -> bytes:
    text = "; ".join(f"{param}: {problem}" if param else problem for param, problem in problems[:10])
    data = {"problems": [{"param": param, "problem": problem} for param, problem in problems]}
    return error_reply(request_id, INVALID_PARAMS, f"{name}: {text}", data)


def _check(model: type[MethodParams], params: object) -> MethodParams:
    """Parameters by name, or by position in the declared order."""
    if params is None:
        params = {}
    elif type(params) is list:
        fields = list(model.model_fields)
        if len(params) > len(fields):
            raise InvalidParams(
                ("", f"{len(params)} parameters given; the method has {len(fields)}: {', '.join(fields)}")
            )
        params = dict(zip(fields, params, strict=False))
    elif type(params) is not dict:
        raise InvalidParams(("", "params must be an object or an array"))
    try:
        return model.model_validate(params)
    except ValidationError as error:
        if any(e["type"] == "extra_forbidden" for e in error.errors(include_url=False, include_context=False)):
            raise _unknown_params(model, error) from None
        raise


def _unknown_params(model: type[MethodParams], error: ValidationError) -> InvalidParams:
    problems = []
    known = list(model.model_fields)
    for loc, text in _problems(error):
        if text != _UNKNOWN:
            problems.append((loc, text))
            continue
        close = near_names(loc, known, n=1)
        names = ", ".join(known) or "none"
        hint = f"did you mean {close[0]}?" if close else f"the parameters are: {names}"
        problems.append((_clip(loc), f"no such parameter; {hint}"))
    return InvalidParams(*problems)


_UNKNOWN = "no such parameter"


def _problems(error: ValidationError) -> list[tuple[str, str]]:
    found = []
    for item in error.errors(include_url=False):
        text = item["msg"].removeprefix("Value error, ").removeprefix("Input ")
        if item["type"] == "missing":
            text = "is missing"
        elif item["type"] == "extra_forbidden":
            text = _UNKNOWN
        elif item["type"] != "value_error":
            text += f" (got {_clip(json.dumps(item['input'], default=str))})"
        found.append((".".join(str(part) for part in item["loc"]), text))
    return found


def _encode_id(request_id: object) -> bytes:
    return encode(request_id)


def _clip(text: str) -> str:
    return text if len(text) <= MAX_ECHO_CHARS else text[:MAX_ECHO_CHARS] + "…"
