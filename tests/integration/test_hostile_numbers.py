"""Numbers that no one means, through every door: whatever they are, they are refused in words or do no harm."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from support.asked import asked, methods_with_numbers, resolved, virtual_loop
from support.examples import examples
from support.extension_parts import PLAIN_METHODS
from support.hosts import until
from support.loops import on_every_loop

MAGNITUDES = (
    *(5e-324, 2.3e-308, 1e-300, 1e-45, 1e-12, 1e-6, 1e-3, 0.04, 0.5, 1.0, 2.0, 19.9, 20.0, 180.0, 255.0, 256.0),
    *(1000.0, 65536.0, 1e7, 1e10, 1e18, 3.3e38, 3.5e38, 1e300, 1.7976931348623157e308),
)
CAPTURE = Path(__file__).parents[1] / "data" / "sitl-3ardupilot-2px4.tlog"
TINY = st.sampled_from(MAGNITUDES[:5])
FLOATS = st.one_of(TINY, st.sampled_from([0.0, -0.0, *MAGNITUDES]), st.sampled_from([-m for m in MAGNITUDES]))
INTEGERS = st.sampled_from([0, 1, -1, 2, 7, 255, 256, -(2**31), 2**31, 2**53 + 1, 2**63, 2**64, 10**30, -(10**400)])
TARGETS = st.sampled_from(["all", "1", "v1", 1, ["v1"], "2-5", "7"])
WORDS = st.sampled_from(["ATTITUDE", "HEARTBEAT", "COMMAND_LONG", "GUIDED", "LOITER", "WPNAV_SPEED", "POSITION", "x"])
BY_NAME = {
    "targets": TARGETS,
    "target": TARGETS,
    "key_file": st.just("/nowhere/key"),
    "token": WORDS,
    "data": st.sampled_from(["", "0wAA", "AAAA"]),
}
NO_SHRINKING = (Phase.explicit, Phase.generate)
"""Each example is a daemon's life: what fails says enough by itself."""

RATES = [5e-324, 1e-300, 1e-9, 9.9e-4]
"""Positive, and slower than a rate may be."""

NO_PLACE_HERE = frozenset({"links.add", "links.change", "links.remove"})
"""They get requests of their own below."""


def values(schema: Mapping[str, Any], defs: Mapping[str, Any], name: str = "") -> st.SearchStrategy[Any]:
    """What has the right shape, with numbers that have not."""
    schema = resolved(schema, defs)
    if name in BY_NAME:
        return BY_NAME[name]
    if "enum" in schema:
        return st.sampled_from(schema["enum"])
    if "const" in schema:
        return st.just(schema["const"])
    if "anyOf" in schema or "oneOf" in schema:
        return st.one_of([values(s, defs, name) for s in schema.get("anyOf") or schema["oneOf"]])
    match schema.get("type"):
        case "number":
            return st.one_of(FLOATS, INTEGERS)
        case "integer":
            return st.one_of(INTEGERS, FLOATS)
        case "boolean":
            return st.booleans()
        case "null":
            return st.none()
        case "array":
            items = values(schema.get("items", {}), defs, name)
            return st.lists(items, min_size=schema.get("minItems", 0), max_size=min(schema.get("maxItems", 7), 7))
        case "object" if "properties" in schema:
            given = {key: values(s, defs, key) for key, s in schema["properties"].items()}
            required = {key: given.pop(key) for key in schema.get("required", ())}
            return st.fixed_dictionaries(required, optional=given)
        case "object":
            more = schema.get("additionalProperties")
            each = values(more, defs) if isinstance(more, dict) else st.one_of(FLOATS, INTEGERS, WORDS)
            return st.dictionaries(st.one_of(WORDS, st.sampled_from(["param1", "rate", "q"])), each, max_size=4)
    return WORDS


async def _ask_all(questions: list[tuple[str, Any]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        async with asked(Path(folder)) as gcs:
            for method, params in questions:
                gcs.ask(method, params)
                await asyncio.sleep(0)
            await gcs.live(6.0)
            assert not gcs.internal_errors(), gcs.internal_errors()
            assert not gcs.faults(), gcs.faults()
            assert not gcs.complaints, gcs.complaints


@pytest.mark.parametrize("method", [name for name in methods_with_numbers() if name not in NO_PLACE_HERE])
@given(data=st.data())
@settings(max_examples=examples(4), phases=NO_SHRINKING)
def test_no_number_of_a_client_is_a_fault_of_ours(method: str, data: st.DataObject) -> None:
    schema = PLAIN_METHODS[method].params.model_json_schema()
    asked_for = values(schema, schema.get("$defs", {}))
    questions = [(method, data.draw(asked_for)) for _ in range(25)]
    with asyncio.Runner(loop_factory=virtual_loop) as runner:
        runner.run(_ask_all(questions))


@on_every_loop
async def test_a_rate_that_has_no_period_is_refused_with_its_bounds(tmp_path: Path) -> None:
    async with asked(tmp_path) as gcs:
        for rate_hz in RATES:
            doors = {
                "subscribe": [{"topic": "telemetry"}, {"topic": "messages"}],
                "vehicles.interval": [{"targets": "all", "message": "ATTITUDE"}],
                "vehicles.stream": [{"targets": "all", "stream": "POSITION"}],
            }
            for method, params in ((m, p) for m, each in doors.items() for p in each):
                error = (await gcs.reply(method, {**params, "rate_hz": rate_hz}))["error"]
                assert error["code"] == -32602 and "rate_hz" in error["message"], error
                assert "0.001" in error["message"] or "1 to 1000" in error["message"], error
        for rate_hz in (0.001, 20):
            assert "result" in await gcs.reply("subscribe", {"topic": "telemetry", "rate_hz": rate_hz})
        await until(lambda: len(gcs.notices) > 3)
        assert not gcs.internal_errors() and not gcs.faults() and not gcs.complaints


LINKS = {
    "replay": ("speed", "raw_bytes_per_s"),
    "memory": ("delay_s", "jitter_s", "loss"),
    "simulated": ("wind_mps", "gust_mps", "sensor_latency_s", "lat_deg", "alt_amsl_m", "duty_cycle"),
    "udp_server": ("peer_timeout_s",),
}


async def _add_links(keys: list[tuple[str, str, float]], capture: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        async with asked(Path(folder)) as gcs:
            for number, (kind, key, value) in enumerate(keys):
                needs = {"replay": {"file": str(capture)}, "simulated": {"px4": 1, "first_sysid": 9}}
                needs["udp_server"] = {"host": "127.0.0.1", "port": 0}
                link = {"type": kind, **needs.get(kind, {}), key: value}
                asked_for = gcs.ask("links.add", {"name": f"l{number}", "link": link})
                await gcs.live(1.0)
                answer = gcs.answer(asked_for)
                assert "result" in answer or key in answer["error"]["message"], answer
                gcs.ask("links.remove", {"name": f"l{number}"})
            limits = {"type": "memory", "rate_in": {"messages": {"*": 5e-324}, "bytes_per_s": 5e-324}}
            asked_for = gcs.ask("links.add", {"name": "limited", "link": limits})
            await gcs.live(1.0)
            error = gcs.answer(asked_for)["error"]
            assert "0.001" in error["message"] and "rate_in.bytes_per_s" in error["message"]
            await gcs.live(2.0)
            assert not gcs.internal_errors(), gcs.internal_errors()
            assert not gcs.faults(), gcs.faults()
            assert not gcs.complaints, gcs.complaints


LINK_KEYS = [(kind, key) for kind, keys in LINKS.items() for key in keys]


@given(st.lists(st.tuples(st.sampled_from(LINK_KEYS), FLOATS), min_size=8, max_size=20))
@settings(max_examples=examples(8), phases=NO_SHRINKING)
def test_no_number_of_a_link_is_a_fault_of_ours(drawn: list[tuple[tuple[str, str], float]]) -> None:
    keys = [(kind, key, value) for (kind, key), value in drawn]
    with asyncio.Runner(loop_factory=virtual_loop) as runner:
        runner.run(_add_links(keys, CAPTURE))


DAEMON_KEYS = ["record_max_mb", "record_max_minutes", "vehicle_timeout_s", "route_timeout_s", "goto_limit_m"]


async def _run_with(own: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        async with asked(Path(folder), daemon={**own, "record": True}) as gcs:
            await gcs.live(3.0)
            assert not gcs.internal_errors() and not gcs.complaints
            assert not gcs.faults(), gcs.faults()
            assert len(list((Path(folder) / "logs").iterdir())) < 10, "one recording, not one for each frame"


@given(st.dictionaries(st.sampled_from([*DAEMON_KEYS, "operator_timeout_s", "preflight_valid_minutes"]), FLOATS))
@settings(max_examples=examples(40), phases=NO_SHRINKING)
def test_no_number_of_the_fleet_file_is_a_fault_of_ours(own: dict[str, float]) -> None:
    try:
        with asyncio.Runner(loop_factory=virtual_loop) as runner:
            runner.run(_run_with(own))
    except ValidationError as error:
        assert {str(e["loc"][-1]) for e in error.errors()} <= own.keys()
