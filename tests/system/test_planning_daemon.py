"""Planning in a real daemon: hostile requests, cancelling, a client that leaves, and numpy stays out of the daemon."""

from __future__ import annotations

import asyncio
import json
import zipfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.rpc.client import Client, connect
from support.process import FIELD_TOML, DaemonProcess, wait_until

pytestmark = pytest.mark.system

FLEET_FILE = (
    FIELD_TOML
    + """[links.field]
type = "simulated"
px4 = 2
ardupilot = 0
"""
)
INVALID, REFUSED, TARGET, LIMIT_EXCEEDED = -32602, -32002, -32001, -32005
PIECE = [1.0, [0.0], [0.0], [5.0], None]


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaemonProcess]:
    with DaemonProcess(tmp_path_factory.mktemp("planning"), FLEET_FILE) as daemon:
        wait_until(lambda: daemon.known() == 2, "two vehicles are known")
        wait_until(
            lambda: all((s["position"] or {}).get("enu_m") for s in daemon.call("vehicles.list")), "all have positions"
        )
        yield daemon


def timed(pieces: Any) -> dict[str, Any]:
    return {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {"v1": pieces}}


def tangle(count: int, points: int) -> dict[str, Any]:
    """Written paths that wind around each other: minutes of work."""
    vehicles = {}
    for i in range(count):
        at = [0.1 * ((i * 7 + k * k) % 97) for k in range(points + 1)]
        vehicles[f"p{i}"] = [[0.7, [a, (b - a) / 0.7], [0.3 * i], [5.0], None] for a, b in pairwise(at)]
    return {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": vehicles}


@pytest.mark.parametrize(
    ("method", "params", "code"),
    [
        ("plan.make", {}, INVALID),
        ("plan.make", {"goals": {}}, INVALID),
        ("plan.make", {"goals": {"v1": [1e308, 0, 5]}}, INVALID),
        ("plan.make", {"goals": {"v1": [0, 0]}}, INVALID),
        ("plan.make", {"goals": {"v1": [0, 0, "5"]}}, INVALID),
        ("plan.make", {"goals": {f"v{i}": [0, 0, 5] for i in range(300)}}, INVALID),
        ("plan.make", {"goals": {"v1": [0, 0, 5]}, "paths": {"v1": {"points": [[0, 0, 5]]}}}, INVALID),
        ("plan.make", {"paths": {"v1": {"points": [[0, 0, 5]], "times_s": [1, 2]}}}, INVALID),
        ("plan.make", {"paths": {"v1": {"points": [[0, 0, 5], [1, 0, 5]], "times_s": [2, 1]}}}, REFUSED),
        ("plan.make", {"goals": {"../../etc/passwd": [0, 0, 5]}}, TARGET),
        ("plan.make", {"goals": {"v1": [0, 0, 5]}, "starts": {"v2": [0, 0, 5]}}, REFUSED),
        ("plan.make", {"goals": {"v1": [0, 0, 5]}, "downwash_ratio": 0.0}, REFUSED),
        ("plan.make", {"goals": {"v1": [0, 0, 5]}, "limits": {"jerk_mps3": -1.0}}, REFUSED),
        ("plan.make", {"goals": {"v1": [0, 0, 5]}, "space": {"fence": [[0, 0], [1, 1]]}}, INVALID),
        ("plan.make", {"goals": {"v1": [0, 0, 5]}, "space": {"boxes": [[[1, 1, 1], [0, 0, 0]]]}}, INVALID),
        ("plan.make", {"goals": {"v1": [0, 0, 5]}, "space": {"standing": {"v1": [0, 0, 0]}}}, REFUSED),
        (
            "plan.make",
            {"formation": {"vehicles": ["v1", "1"], "shape": "line", "middle_m": [0, 0, 9]}},
            INVALID,
        ),
        ("plan.make", {"formation": {"vehicles": ["v1"], "shape": "__class__", "middle_m": [0, 0, 9]}}, REFUSED),
        ("plan.certify", {"plan": {}}, REFUSED),
        ("plan.certify", {"plan": {"vehicles": 3}}, REFUSED),
        ("plan.certify", {"plan": timed([])}, REFUSED),
        ("plan.certify", {"plan": timed([[0.0, [0], [0], [0], None]])}, REFUSED),
        ("plan.certify", {"plan": timed([[1.0, [1e308], [0], [0], None]])}, REFUSED),
        ("plan.certify", {"plan": timed([["x", [0], [0], [0], None]])}, REFUSED),
        ("plan.certify", {"plan": timed([PIECE] * 10_001)}, REFUSED),
        ("plan.certify", {"plan": timed([[1.0, [0.0] * 17, [0], [0], None]])}, REFUSED),
        ("plan.certify", {"plan": timed([PIECE, [1.0, [50.0], [0.0], [5.0], None]])}, REFUSED),
        ("plan.certify", {"plan": timed([PIECE]), "space": {"standing": {"v1": [0, 0, 0]}}}, REFUSED),
        ("plan.cancel", {"job": -1}, None),
        ("plan.cancel", {"job": "1"}, INVALID),
    ],
)
async def test_a_hostile_request_is_an_error_and_nothing_else(
    daemon: DaemonProcess, method: str, params: dict[str, Any], code: int | None
) -> None:
    async with connect(daemon.socket) as gcs:
        if code is None:
            assert await gcs.call(method, **params) == {"cancelled": []}
        else:
            with pytest.raises(RpcError) as caught:
                await gcs.call(method, **params)
            assert caught.value.code == code and len(str(caught.value)) < 500, caught.value
        assert (await gcs.call("plan.jobs"))["jobs"] == []


async def test_what_is_nested_deeply_is_no_request(daemon: DaemonProcess) -> None:
    reader, writer = await asyncio.open_unix_connection(daemon.socket)
    deep = "[" * 100_000 + "]" * 100_000
    line = '{"jsonrpc":"2.0","id":1,"method":"plan.certify","params":{"plan":{"vehicles":' + deep + "}}}\n"
    writer.write(line.encode())
    assert json.loads(await reader.readline())["error"]["code"] == LIMIT_EXCEEDED
    writer.close()
    assert daemon.known() == 2


@pytest.mark.parametrize("method", ["plan.certify", "plan.load"])
async def test_a_plan_in_which_a_vehicle_is_twice_or_stands_in_its_own_way_is_refused(
    daemon: DaemonProcess, method: str
) -> None:
    """As files are: of two paths of one vehicle the last would win, and the first one not be certified."""
    reader, writer = await asyncio.open_unix_connection(daemon.socket)
    text = json.dumps(timed([PIECE]))
    twice = text.replace('"v1":', f'"v1": {json.dumps([PIECE])}, "v1":')
    stands = json.dumps(timed([PIECE]) | {"space": {"standing": {"v1": [9.0, 9.0, 5.0]}}})
    for plan, why in ((twice, "'v1' is there twice"), (stands, "v1 takes part in the plan")):
        one = f'{{"jsonrpc":"2.0","id":1,"method":"{method}","params":{{"plan":{plan}}}}}'
        for line in (one, f"[{one}]"):
            writer.write(line.encode() + b"\n")
            answer = json.loads(await reader.readline())
            assert why in (answer[0] if isinstance(answer, list) else answer)["error"]["message"]
    writer.close()


async def begun(gcs: Client, **params: Any) -> tuple[asyncio.Task[Any], int]:
    """A request that takes long, and its number, once it is computed."""
    told = asyncio.Event()
    task = asyncio.create_task(gcs.planning("plan.certify", on_progress=lambda _: told.set(), **params))
    await asyncio.wait_for(told.wait(), 60)
    return task, (await gcs.call("plan.jobs"))["jobs"][0]["job"]


async def test_a_request_is_cancelled_and_a_client_that_leaves_ends_its_own(daemon: DaemonProcess) -> None:
    long = {"plan": tangle(60, 180), "margin_m": 0.05}
    async with connect(daemon.socket) as gcs, connect(daemon.socket) as other:
        task, number = await begun(gcs, **long)
        with pytest.raises(RpcError, match="this client has a request"):
            await gcs.call("plan.make", goals={"v1": [0, 0, 9]})
        assert await other.call("plan.cancel") == {"cancelled": []}, "it has none"
        assert await other.call("plan.cancel", job=number) == {"cancelled": [number]}
        with pytest.raises(RpcError, match="was cancelled"):
            await task
        leaver = connect(daemon.socket)
        await leaver.open()
        task, _ = await begun(leaver, **long)
        await leaver.close()
        with pytest.raises(RpcError):
            await task
        for _ in range(200):
            if not (await gcs.call("plan.jobs"))["jobs"]:
                break
            await asyncio.sleep(0.05)
        jobs = await gcs.call("plan.jobs")
        assert jobs["jobs"] == [] and jobs["cancelled"] == 2
        found = await gcs.planning("plan.make", goals={"v1": [0.0, 9.0, 9.0]})
        assert found["certificate"]["certified"]


def test_numpy_is_not_loaded_into_the_daemon(daemon: DaemonProcess) -> None:
    assert daemon.call("plan.make", goals={"v1": [0.0, 9.0, 9.0]})["certificate"]["certified"]
    assert "numpy" not in Path(f"/proc/{daemon.call('daemon.info')['pid']}/maps").read_text()


def test_a_zip_bomb_and_a_way_out_of_the_zip_are_refused(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from skygcs.cli.main import app

    bomb = tmp_path / "bomb.skyc"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("show.json", b" " * (70 << 20))
    secret = tmp_path / "secret.json"
    secret.write_text('{"version": 1, "points": [[0, [0, 0, 5], []]]}')
    outside = tmp_path / "outside.skyc"
    drone = {"settings": {"name": "a", "trajectory": {"$ref": f"../../..{secret}#"}}}
    with zipfile.ZipFile(outside, "w") as archive:
        archive.writestr("show.json", json.dumps({"version": 1, "swarm": {"drones": [drone]}}))
    rows = tmp_path / "rows.csv"
    rows.write_text("vehicle,x,y,z\n" + "a,0,0,5\n" * 1_000_000)
    for path, words in ((bomb, "unpacks to more than 64 MiB"), (outside, "in the zip"), (rows, "more than 10000 rows")):
        result = CliRunner().invoke(app, ["plan", "check", str(path)])
        assert result.exit_code == 1 and words in result.output.replace("\n", " "), result.output
