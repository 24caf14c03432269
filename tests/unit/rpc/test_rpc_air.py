"""link.status and link.select, on a daemon with an emulated radio."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.errors import TargetError
from skygcs.rpc.links import RadioAir
from skygcs.rpc.methods import METHODS
from support.on_air import OnAir, on_air

pytestmark = pytest.mark.looptime


def ask(air: OnAir, name: str, **params: Any) -> Any:
    method = METHODS[name]
    return method.handler(SimpleNamespace(services=air.daemon), method.params.model_validate(params))  # type: ignore[arg-type]


async def test_the_status_is_what_its_schema_says_and_json(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=1, ardupilot=1) as air:
        assert ask(air, "link.status") == [] or ask(air, "link.status")[0]["vehicles"] == []
        await air.settled(2)
        await asyncio.sleep(2)
        (reported,) = ask(air, "link.status")
        json.dumps(reported, allow_nan=False)
        assert set(reported) == set(RadioAir.model_fields)
        assert reported["link"] == "air" and len(reported["history"]) > 3
        assert [v["name"] for v in sorted(reported["vehicles"], key=lambda v: v["sysid"])] == ["v1", "v2"]


async def test_a_selection_takes_the_place_of_the_one_before(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=3, ardupilot=0) as air:
        await air.settled(3)

        def weights() -> dict[str, float]:
            return {v["name"]: v["weight"] for v in air.air()["vehicles"]}

        assert ask(air, "link.select", targets="2-3") == {"selected": ["v2", "v3"]}
        await asyncio.sleep(1.5)
        assert weights() == {"v1": 1.0, "v2": 2.0, "v3": 2.0}
        assert ask(air, "link.select", targets="1") == {"selected": ["v1"]}
        await asyncio.sleep(1.5)
        assert weights() == {"v1": 2.0, "v2": 1.0, "v3": 1.0}
        assert ask(air, "link.select") == {"selected": []}
        await asyncio.sleep(1.5)
        assert set(weights().values()) == {1.0}
        with pytest.raises(TargetError):
            ask(air, "link.select", targets="9")
