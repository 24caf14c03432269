"""Long answers in slices."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator

import pytest

from skygcs.rpc import slices
from skygcs.rpc.slices import ORDER_S, PAUSE_S, Slices


@pytest.mark.parametrize("at_once", [1, 2, 7, 100])
@pytest.mark.parametrize("number", [0, 1, 2, 7, 8])
async def test_a_list_is_the_same_in_any_slices(number: int, at_once: int) -> None:
    values = [{"n": n, "text": ",[]", "list": []} for n in range(number)]
    assert json.loads(await Slices(asyncio.get_running_loop()).encoded_list(values, at_once)) == values


async def test_what_json_lacks_is_null() -> None:
    assert (
        await Slices(asyncio.get_running_loop()).encoded_list([float("nan"), float("inf"), 1.5], 2)
        == b"[null,null,1.5]"
    )


async def test_the_loop_has_its_turn_between_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slices, "SLICE_S", -1.0)  # each look at the clock ends a slice
    taken: list[int] = []
    seen: list[int] = []

    async def look() -> None:
        while True:
            seen.append(len(taken))
            await asyncio.sleep(0)

    def numbers() -> Iterator[int]:
        for n in range(6):
            taken.append(n)
            yield n

    looking = asyncio.create_task(look())
    await asyncio.sleep(0)
    assert json.loads(await Slices(asyncio.get_running_loop()).encoded_list(numbers(), 2)) == [0, 1, 2, 3, 4, 5]
    looking.cancel()
    assert {2, 4, 6} <= set(seen)


@pytest.mark.looptime
async def test_a_slice_is_followed_by_a_pause_only_while_an_order_is_on_its_way() -> None:
    pauses = Slices(asyncio.get_running_loop())
    assert pauses.pause_s() == 0.0
    pauses.order_came()
    await asyncio.sleep(ORDER_S / 2)
    assert pauses.pause_s() == PAUSE_S
    await asyncio.sleep(ORDER_S)
    assert pauses.pause_s() == 0.0
