"""A scripted vehicle's parameters and a network that loses, doubles, overtakes and delays, all in the test's own time.

Independent of the simulated vehicles: large sets, ranges, and autopilots that misbehave.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from skygcs.core.mavlink.param_encoding import Encoding, Param, ParamType, ParamValue, from_bits
from skygcs.core.protocols.base import Effect, Send


def big_set(count: int) -> list[Param]:
    """Names of all lengths to 16, both kinds of values."""
    params = []
    for i in range(count):
        name = f"P{i:04d}_" + "ABCDEFGHIJ"[: i % 11]
        params.append(Param(name, i - 7, ParamType.INT32) if i % 2 else Param(name, i / 8, ParamType.REAL32))
    return params


@dataclass
class ParamVehicle:
    """Answers as PX4 does (true indices), or as ArduPilot does (``named_index`` None for what is asked by name)."""

    params: dict[str, Param]
    encoding: Encoding = Encoding.BYTEWISE
    index_for_named: bool = True
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    read_only: set[str] = field(default_factory=set)
    deaf_to: set[int] = field(default_factory=set)
    """Indices it never answers."""
    history: list[tuple[str, Any]] = field(default_factory=list)
    """Every value taken."""

    @classmethod
    def of(cls, params: list[Param], **more: Any) -> ParamVehicle:
        return cls({p.name: p for p in params}, **more)

    def hear(self, message: str, values: Mapping[str, Any]) -> list[ParamValue]:
        if message == "PARAM_REQUEST_LIST":
            return [self._value(p, i) for i, p in enumerate(self.params.values())]
        if message == "PARAM_REQUEST_READ" and values["param_index"] >= 0:
            index = values["param_index"]
            found = list(self.params.values())[index : index + 1]
            return [self._value(p, index) for p in found if index not in self.deaf_to]
        param = self.params.get(values["param_id"])
        if param is None:
            return []
        if message == "PARAM_SET":
            param = self._set(param, values)
        index = list(self.params).index(param.name) if self.index_for_named else None
        return [self._value(param, index)]

    def _set(self, param: Param, values: Mapping[str, Any]) -> Param:
        value = from_bits(values["param_value"], ParamType(values["param_type"]), self.encoding)
        if param.name not in self.read_only and values["param_type"] == param.type:
            low, high = self.limits.get(param.name, (-1e38, 1e38))
            self.params[param.name] = param = replace(param, value=min(max(value, low), high))
            self.history.append((param.name, param.value))
        return param

    def _value(self, param: Param, index: int | None) -> ParamValue:
        return ParamValue(param, len(self.params), index)


@dataclass(frozen=True)
class Network:
    """``loss`` and ``duplicate`` each way; every frame takes its own time, so that they overtake each other."""

    loss: float = 0.0
    duplicate: float = 0.0
    delay_s: tuple[float, float] = (0.01, 0.01)
    bytewise: bool = False
    """Frames come in pieces; messages that are no frames do not."""


class Delays:
    """Messages on their way through a network, and the test's own time."""

    def __init__(self, network: Network, seed: int) -> None:
        self.network = network
        self.random = random.Random(seed)
        self.now = 100.0
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._serial = 0

    def at(self, delay_s: float, call: Callable[[], None]) -> None:
        self._serial += 1
        heapq.heappush(self._queue, (self.now + delay_s, self._serial, call))

    def arrive_by(self, at_s: float) -> bool:
        """Let the first of all that is on its way arrive, if it does by then; True if it did."""
        if not self._queue or self._queue[0][0] > at_s:
            return False
        self.now, _, call = heapq.heappop(self._queue)
        call()
        return True

    def _through(self, call: Callable[[], None]) -> None:
        for _ in range(2 if self.random.random() < self.network.duplicate else 1):
            if self.random.random() >= self.network.loss:
                self.at(self.random.uniform(*self.network.delay_s), call)


class Wire(Delays):
    """Runs an exchange against a vehicle until it is done."""

    def __init__(self, vehicle: ParamVehicle, network: Network, seed: int = 0) -> None:
        super().__init__(network, seed)
        self.vehicle = vehicle
        self.sent: list[Send] = []
        self.reports = 0

    def run(self, exchange: Any, *, limit_s: float = 3600.0) -> Any:
        """The outcome. What is still on its way when it is done stays there."""
        end = self.now + limit_s
        self._carry(exchange, exchange.start(self.now))
        while not exchange.done:
            if not self.arrive_by(exchange.deadline):
                self.now = max(self.now, exchange.deadline)
                self._carry(exchange, exchange.on_timer(self.now))
            assert self.now < end, "it does not come to an end"
        return exchange.outcome

    def _carry(self, exchange: Any, effects: tuple[Effect, ...]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                self.sent.append(effect)
                self._through(lambda e=effect: self._arrive(exchange, e))  # type: ignore[misc]

    def _arrive(self, exchange: Any, effect: Send) -> None:
        for value in self.vehicle.hear(effect.message, effect.values):
            self._through(lambda v=value: self._carry(exchange, exchange.on_value(v, self.now)))  # type: ignore[misc]
