"""JSON-RPC 2.0 without I/O: one parsed request in, one encoded reply out. https://www.jsonrpc.org/specification

Methods are declared here, and described as an OpenRPC document (`document`, which answers `rpc.discover`).

Why not a library: docs/decisions/0002-json-rpc-dispatch.md.
"""

from __future__ import annotations

import asyncio
import inspect
import json
from collections.abc import AsyncIterator, Callable, Collection, Coroutine, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar

import structlog
from pydantic import TypeAdapter, ValidationError

from skygcs import __version__
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
from skygcs.rpc import error_codes
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
from skygcs.rpc.json_lines import id_of, is_id
from skygcs.rpc.models import MethodParams
from skygcs.rpc.replies import NotJsonError, encode, error_reply, reply_of
from skygcs.spelling import is_number, near_names

MAX_ECHO_CHARS = 80
"""Most characters of a client's input that an error text repeats."""

MAX_PROBLEMS = 100
"""Problems of one request that are answered. A megabyte may have 100,000; to put one into words takes 60 us."""

MAX_LISTED = 2000
"""Problems that are looked at. To list 100,000 of them takes 0.3 s."""

MAX_MEMBERS = 4096
"""Members of one parameter: more than an autopilot has parameters. To check 60,000 of them takes 0.2 s."""

_log = structlog.get_logger(__name__)
C = TypeVar("C")
T = TypeVar("T")


class InvalidParams(SkygcsError):
    """Parameters of the right types that still do not fit; ``problems`` is (parameter, what is wrong with it)."""

    def __init__(self, *problems: tuple[str, str]) -> None:
        self.problems = problems
        super().__init__("; ".join(f"{p}: {text}" if p else text for p, text in problems))


class LimitExceeded(SkygcsError):
    """A client has reached a limit, its own or that of all clients together; the text names it."""


Reach = Literal["targets", "fleet", "nothing"]
"""Vehicles that a call waits for: those that its parameters name, any of the fleet, or none."""


@dataclass(frozen=True)
class Method(Generic[C]):
    """One method: its handler gets the session's context and checked parameters, and answers.

    A handler that is a plain function runs at once, without a task; the first line of its docstring is the summary.
    ``outlives_client``: once asked for it is carried out to its end, whether or not the client stays for the answer.
    ``always``: it is answered to a client that came when all places were taken, and while the daemon shuts down: what
    ends a flight or shows what flies. ``while_stopping``: it is answered while the daemon shuts down (5 s at most).
    ``unique_keys``: a request in which an object has a key twice is refused, as the last one would silently win.
    ``reach``: what the gate of calls to vehicles counts while a coroutine is carried out. None: the vehicles in its
    parameter ``targets`` or ``target``, and without such a parameter the whole fleet; only a method that sends nothing
    to vehicles declares "nothing", so that one that is not declared is counted, and not missed. ``reached``: where
    other parameters, or what is loaded, say which vehicles of the fleet these are: a list of targets. ``shown``: makes
    the answer of what is awaited, where the handler is a plain function that returns a coroutine.
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
    reach: Reach | None = None
    reached: Callable[[C, Any], Sequence[Any]] | None = None
    shown: Callable[[Any], Any] | None = None

    @property
    def waits(self) -> bool:
        """True if it answers later."""
        return self.shown is not None or inspect.iscoroutinefunction(self.handler)

    @property
    def goes_to(self) -> Reach:
        """``reach``, or what follows from the parameters."""
        return self.reach or ("targets" if {"targets", "target"} & self.params.model_fields.keys() else "fleet")

    @property
    def ends_flight(self) -> bool:
        """True for an order that ends a flight: it is always answered, and carried out without its client."""
        return self.always and self.outlives_client


class MethodTable(dict[str, Method[C]]):
    """The methods that can be called, by name."""

    def __init__(self, methods: Iterable[Method[C]]) -> None:
        self.always: set[str] = set()
        self.while_stopping: set[str] = set()
        """With those that are always answered."""
        self.coroutines: set[str] = set()
        """Names of the methods that answer later."""
        self._take(methods)

    def add(self, methods: Collection[Method[C]]) -> None:
        """Take further methods. Raises ValueError as `require_free` does."""
        self.require_free(methods)
        self._take(methods)

    def require_free(self, methods: Collection[Method[C]]) -> None:
        """Raises ValueError if one of these has the name of another."""
        if twice := [name for name in sorted(method.name for method in methods) if name in self]:
            raise ValueError(f"two methods are called {', '.join(twice)}")

    def _take(self, methods: Iterable[Method[C]]) -> None:
        for method in methods:
            self[method.name] = method
            if method.always:
                self.always.add(method.name)
            if method.always or method.while_stopping:
                self.while_stopping.add(method.name)
            if method.waits:
                self.coroutines.add(method.name)


def first_word(name: str) -> str:
    """The word of a method's name that all methods of one part begin with."""
    return name.partition(".")[0]


@dataclass(frozen=True, slots=True)
class Encoded:
    """A result that is JSON already: another process made it, and nothing of it is decoded here."""

    body: bytes


class OnDemand(Protocol):
    """Methods that come into the table when one of them is first called."""

    @property
    def extension_tables(self) -> Collection[str]:
        """Names of the tables of the fleet file that installed extensions have; empty before `add`."""
        ...

    def may_have(self, name: str) -> bool:
        """True if a method that is not in the table may come into it, or calls before this one wait for that."""
        ...

    def came(self) -> Callable[[], None]:
        """Note that a call comes which has to wait. Returns what the task that carries it out calls first."""
        ...

    async def add(self, name: str) -> None:
        """Add it, if it exists. It returns to calls of one first word in the order in which they came. Raises what
        adding it raises."""
        ...

    async def add_all(self) -> None:
        """Add all that can be added."""
        ...

    async def once_beside(self, name: str, function: Callable[[], object]) -> None:
        """Call a function while the loop goes on, once for all that wait for it by this name, which has a dot."""
        ...


class Gate(Protocol):
    """Way of all calls to their handlers; `rpc.work_gate.WorkGate`."""

    def asked(self, method: Method[Any]) -> None:
        """A method whose handler is a plain function is about to be called."""
        ...

    def room(
        self, method: Method[Any], context: Any, params: MethodParams
    ) -> AbstractAsyncContextManager[asyncio.Future[Any]]:
        """Room for a call of a method whose handler is a coroutine; the block sets the outcome unless it is done, as
        another call has it. Raises LimitExceeded, and what the block raises."""
        ...

    def stats(self) -> dict[str, Any]:
        """JSON-able counters."""
        ...


class OpenGate:
    """`Gate` that carries out everything."""

    def asked(self, method: Method[Any]) -> None:
        return

    @asynccontextmanager
    async def room(self, method: Method[Any], context: Any, params: MethodParams) -> AsyncIterator[asyncio.Future[Any]]:
        yield asyncio.get_running_loop().create_future()

    def stats(self) -> dict[str, Any]:
        return {}


Admit = Callable[[Mapping[str, Any]], bytes | None]
"""The encoded refusal of a request that is not to be carried out now; None: it is."""

Reply = bytes | Coroutine[Any, Any, bytes] | None
"""Encoded reply without newline; or a coroutine that makes it; or None (a notification that is done)."""


class Dispatcher(Generic[C]):
    """Finds the method, checks its parameters, runs it, encodes the reply. Never raises for what a client sent."""

    def __init__(
        self, methods: Mapping[str, Method[C]], on_demand: OnDemand | None = None, gate: Gate | None = None
    ) -> None:
        """``on_demand`` adds to ``methods``, a `MethodTable`."""
        self.gate = gate or OpenGate()
        self._methods = methods if isinstance(methods, MethodTable) else MethodTable(methods.values())
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

        ``key_twice``: `replies.key_twice` of the line that the request came in; called where the method needs it.
        ``admit`` is asked before an import, and again before the handler: much time may pass between.
        """
        if type(request) is not dict:
            return error_reply(None, INVALID_REQUEST, "a request is a JSON object")
        request_id = request.get("id")
        if not is_id(request_id):
            return error_reply(None, INVALID_REQUEST, "id must be a string or a number")
        name = request.get("method")
        if request.get("jsonrpc") != "2.0" or type(name) is not str:
            return error_reply(request_id, INVALID_REQUEST, 'a request has "jsonrpc": "2.0" and a method name')
        notification = "id" not in request
        if (refusal := admit(request)) is not None:
            return None if notification else refusal
        if self._on_demand is not None and self._on_demand.may_have(name):
            return self._start_later(self._on_demand, context, request, key_twice, admit, self._on_demand.came())
        return self._start_now(context, request, key_twice)

    def _start_now(self, context: C, request: dict[str, Any], key_twice: Callable[[], str | None]) -> Reply:
        """Carry out a well-formed request that is admitted, with the methods that there are."""
        request_id, name, notification = request.get("id"), request["method"], "id" not in request
        try:
            method = self._methods.get(name)
            if method is None:
                tables = () if self._on_demand is None else self._on_demand.extension_tables
                raise _MethodNotFound(name, self._methods, tables)
            if method.unique_keys and (twice := key_twice()) is not None:
                raise InvalidParams(("", f"the key {_clip(twice)!r} is there twice in one object"))
            params = _check(method.params, request.get("params"))
            if name in self._methods.coroutines:
                return self._finish(method, context, params, request_id, notification)
            self.gate.asked(method)
            result = method.handler(context, params)
        except Exception as error:
            return None if notification else failure_reply(request_id, name, error)
        return None if notification else result_reply(request_id, name, result)

    def outlives_client(self, request: object) -> bool:
        """True if a request that `start` answered with a coroutine is to be finished without its client, too."""
        if not isinstance(request, dict):
            return False
        method = self._methods.get(request["method"])
        return method is not None and method.outlives_client

    async def every_method(self) -> tuple[Method[C], ...]:
        """All methods: those that would come with their first call are imported for it, beside the loop."""
        if self._on_demand is not None:
            await self._on_demand.add_all()
        return tuple(self._methods.values())

    async def described(self, describe: Callable[[tuple[Method[C], ...]], T]) -> T:
        """Return what ``describe`` makes of all methods. It is called beside the loop, once for all that wait, and
        keeps what it made last."""
        methods = await self.every_method()
        if self._on_demand is not None:
            await self._on_demand.once_beside("rpc.discover", lambda: describe(methods))
        return describe(methods)

    async def _start_later(
        self,
        on_demand: OnDemand,
        context: C,
        request: dict[str, Any],
        key_twice: Callable[[], str | None],
        admit: Admit,
        begins: Callable[[], None],
    ) -> bytes:
        """The first calls of methods that are imported for them, beside the loop, in their order. Closed before its
        first step it has begun nothing. ``begins``: see `OnDemand.came`."""
        begins()
        try:
            await on_demand.add(request["method"])
        except Exception as error:
            return failure_reply(request["id"], request["method"], error) if "id" in request else b""
        if (refusal := admit(request)) is not None:
            return refusal if "id" in request else b""
        reply = self._start_now(context, request, key_twice)
        return await reply if isinstance(reply, Coroutine) else reply or b""

    async def _finish(
        self, method: Method[C], context: C, params: MethodParams, request_id: object, notification: bool
    ) -> bytes:
        try:
            async with self.gate.room(method, context, params) as outcome:
                if not outcome.done():
                    outcome.set_result(await method.handler(context, params))
            result = outcome.result() if method.shown is None else method.shown(outcome.result())
        except asyncio.CancelledError:
            end_if_cancelled()  # its client is gone, or the daemon ends
            # what it waited for was cancelled by something else: the client is there and waits for an answer
            cancelled = RefusedError(f"{method.name} was cancelled: skygcs ends, or a vehicle of it is gone")
            return b"" if notification else failure_reply(request_id, method.name, cancelled)
        except Exception as error:
            return b"" if notification else failure_reply(request_id, method.name, error)
        return b"" if notification else result_reply(request_id, method.name, result)


class _MethodNotFound(SkygcsError):
    """``tables``: those of installed extensions, whether the fleet file has them or not."""

    def __init__(self, name: str, known: Mapping[str, object], tables: Collection[str]) -> None:
        close = near_names(name, known, n=3)
        hint = f"; did you mean {', '.join(close)}?" if close else "; rpc.discover lists the methods"
        table, dot, _ = name[:MAX_ECHO_CHARS].partition(".")
        if dot and table in tables and not any(one.startswith(f"{table}.") for one in known):
            hint = f"; it needs the table [{table}] in the fleet file"
        super().__init__(f"no method {_clip(name)}{hint}")


def deadline_refusal(request: Mapping[str, Any], now: float) -> bytes | None:
    """The reply to a request whose ``deadline_s`` has passed or is not a number; None: carry it out.

    ``now``: the daemon's clock, which daemon.info shows.
    """
    deadline_s, request_id = request["deadline_s"], id_of(request)
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
    except NotJsonError as error:
        return failure_reply(request_id, name, error)
    return reply_of(request_id, body)


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
    data = {"problems": [{"param": param, "problem": problem} for param, problem in problems[:MAX_PROBLEMS]]}
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
    elif len(params) > len(model.model_fields) + MAX_PROBLEMS:  # each would be looked at
        raise InvalidParams(("", f"{len(params)} parameters given; the method has {', '.join(model.model_fields)}"))
    for name, value in params.items():
        if type(value) is dict and len(value) > MAX_MEMBERS:
            raise InvalidParams((_clip(name), f"has {len(value)} members; at most {MAX_MEMBERS}"))
    try:
        return model.model_validate(params)
    except ValidationError as error:
        raise _invalid(model, error) from None


def _invalid(model: type[MethodParams], error: ValidationError) -> InvalidParams:
    """The first `MAX_PROBLEMS` of an error in words; those of parameters that the method lacks name near ones."""
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
    if error.error_count() > MAX_LISTED:
        return [("", f"{error.error_count()} values are wrong: it is not what this method takes")]
    found = []
    for item in error.errors(include_url=False)[:MAX_PROBLEMS]:
        text = item["msg"].removeprefix("Value error, ").removeprefix("Input ")
        if item["type"] == "missing":
            text = "is missing"
        elif item["type"] == "extra_forbidden":
            text = _UNKNOWN
        elif item["type"] != "value_error":
            text += f" (got {_clip(_shown(item['input']))})"
        found.append((".".join(str(part) for part in item["loc"]), text))
    return found


def _shown(value: object) -> str:
    """A client's value as it wrote it. Never raises."""
    text = ""
    try:
        for piece in json.JSONEncoder(default=str).iterencode(value):
            text += piece
            if len(text) > MAX_ECHO_CHARS:  # the rest is not shown
                break
        return text
    except (TypeError, ValueError, RecursionError):  # a key that is no text, a number of 5,000 digits, a circle
        return f"a value of type {type(value).__name__}"


def _clip(text: str) -> str:
    return text if len(text) <= MAX_ECHO_CHARS else text[:MAX_ECHO_CHARS] + "…"


ERRORS: dict[int, str] = {
    error_codes.TARGET_ERROR: (
        "The targets name no vehicle; the text names the part that matches none, and the vehicles."
    ),
    error_codes.REFUSED: "skygcs refuses the order itself; the text says why.",
    error_codes.LINK_ERROR: "A link could not be opened, changed or sent on.",
    error_codes.NOT_AUTHENTICATED: "TCP only: the first request must be auth with the token.",
    error_codes.LIMIT_EXCEEDED: "A limit per client, or of all clients together, is reached; the text names it.",
}


_REF = "#/components/schemas/{model}"


def document(methods: Iterable[Method[Any]]) -> dict[str, Any]:
    """All of it, JSON-able; takes half a second for the methods of the daemon."""
    methods = list(methods)
    results = [(i, "serialization", TypeAdapter(method.result)) for i, method in enumerate(methods)]
    result_schemas, definitions = TypeAdapter.json_schemas(
        [(key, "serialization", adapter) for key, _, adapter in results], ref_template=_REF
    )
    components = dict(definitions.get("$defs", {}))
    described = []
    for i, method in enumerate(methods):
        params = method.params.model_json_schema(ref_template=_REF)
        components.update(params.get("$defs", {}))
        described.append(_method(method, params, result_schemas[i, "serialization"]))
    return {
        "openrpc": "1.3.2",
        "info": {
            "title": "skygcs",
            "version": __version__,
            "description": "JSON-RPC 2.0, one object a line, on a Unix socket (or TCP on loopback, after auth).",
        },
        "methods": described,
        "components": {"schemas": components},
    }


def _method(method: Method[Any], params: dict[str, Any], result: Any) -> dict[str, Any]:
    text = inspect.cleandoc(method.handler.__doc__ or "")
    required = set(params.get("required", ()))
    return {
        "name": method.name,
        "summary": text.split("\n", 1)[0],
        "description": text,
        "paramStructure": "either",
        "params": [
            {"name": name, "description": schema.get("description", ""), "required": name in required, "schema": schema}
            for name, schema in params.get("properties", {}).items()
        ],
        "result": {"name": "result", "schema": result},
        "errors": [{"code": code, "message": ERRORS[code]} for code in method.errors],
    }
