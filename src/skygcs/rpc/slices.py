"""Long work of the socket's side in slices: an order, a control tick and routing have their turns in between."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from itertools import islice
from typing import Any

from pydantic_core import to_json

SLICE_S = 0.002
"""Then others have their turn: 50 whole states take 15 ms, the parameters of 15 vehicles 25 ms, in which no control
tick and no stop would come through."""

PAUSE_S = 0.001
"""After a slice, for everything else. A pause of one turn of the loop is not enough: an order takes six turns from the
socket to the link, so that it met six slices of each of such works: 20 to 40 ms."""


async def encoded_list(values: Iterable[Any], at_once: int = 1) -> bytes:
    """A JSON array of the values, which are taken from the iterable in slices, too; NaN becomes null.

    The clock is read after every ``at_once`` values. `Context.long_reads` lets one caller make slices at a time.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time() + SLICE_S
    pieces: list[bytes] = []
    following = iter(values)
    while some := list(islice(following, at_once)):
        pieces.append(to_json(some, inf_nan_mode="null")[1:-1])
        if loop.time() > deadline:
            await asyncio.sleep(PAUSE_S)
            deadline = loop.time() + SLICE_S
    return b"[" + b",".join(pieces) + b"]"
