"""Cost of one small call in our dispatcher and in pjrpc (pip install pjrpc): the figures of decision 0002.

python tests/bench/rpc_dispatch_compare.py
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable
from typing import Any

from pjrpc.server import AsyncDispatcher, MethodRegistry
from pjrpc.server import Dispatcher as PlainDispatcher
from pjrpc.server.validators.pydantic import PydanticValidatorFactory

from skygcs.rpc.dispatch import Dispatcher, Method
from skygcs.rpc.models import TargetParams
from skygcs.rpc.replies import parse

CALLS, ROUNDS = 20_000, 5
TEXT = '{"jsonrpc":"2.0","id":1,"method":"vehicles.get","params":{"target":"alpha"}}'
LINE = TEXT.encode()
POSITION = {"lat_deg": 43.78, "lon_deg": -79.46, "alt_amsl_m": 180.0}
STATE = {"name": "alpha", "sysid": 1, "armed": False, "mode": "AUTO.LOITER", "position": POSITION}


async def answer_later(target: str) -> Any:
    return STATE


def answer(target: str) -> Any:
    return STATE


async def own_later(_: None, params: TargetParams) -> Any:
    return STATE


def registry(function: Callable[..., Any]) -> MethodRegistry:
    methods = MethodRegistry(validator_factory=PydanticValidatorFactory())
    methods.add("vehicles.get")(function)
    return methods


async def compare() -> None:
    theirs_later, theirs = AsyncDispatcher(), PlainDispatcher()
    theirs_later.add_methods(registry(answer_later))
    theirs.add_methods(registry(answer))
    later = Dispatcher({"vehicles.get": Method("vehicles.get", TargetParams, own_later)})
    own = Dispatcher({"vehicles.get": Method("vehicles.get", TargetParams, lambda context, params: STATE)})
    for _ in range(ROUNDS):
        times = [time.perf_counter()]
        for _ in range(CALLS):
            await theirs_later.dispatch(TEXT, context=None)
        times.append(time.perf_counter())
        for _ in range(CALLS):
            theirs.dispatch(TEXT, context=None)
        times.append(time.perf_counter())
        for _ in range(CALLS):
            await later.start(None, parse(LINE))  # type: ignore[misc]
        times.append(time.perf_counter())
        for _ in range(CALLS):
            own.start(None, parse(LINE))
        times.append(time.perf_counter())
        us = [(b - a) / CALLS * 1e6 for a, b in itertools.pairwise(times)]
        print("pjrpc coroutine {:.1f}  plain {:.1f}   own coroutine {:.1f}  plain {:.1f}  us".format(*us))


if __name__ == "__main__":
    asyncio.run(compare())
