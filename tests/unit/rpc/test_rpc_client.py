"""The Python client against a real server."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.rpc import client_inbox, slices
from skygcs.rpc.address import client_address, default_socket_path
from skygcs.rpc.client import Client, connect
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon, FakeOutcome

TIMEOUT_S = 60.0


class Served:
    def __init__(self, daemon: FakeDaemon, server: RpcServer) -> None:
        self.daemon, self.server = daemon, server


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[Served]:
    daemon = FakeDaemon()
    server = RpcServer(daemon, tmp_path / "s.sock", tcp_port=0, token="open sesame")
    await server.start()
    yield Served(daemon, server)
    await server.close()


@pytest.fixture
async def gcs(served: Served) -> AsyncIterator[Client]:
    async with asyncio.timeout(TIMEOUT_S), connect(served.server.socket_path) as gcs:
        yield gcs


async def test_orders_answer_each_vehicles_outcome(served: Served, gcs: Client) -> None:
    served.daemon.vehicle("carol").outcome = FakeOutcome(False, "denied", "denied: no")
    outcomes = await gcs.arm(["alpha", 3], wait_s=1)
    assert {name: o["ok"] for name, o in outcomes.items()} == {"alpha": True, "carol": False}
    for order in (
        gcs.disarm("alpha", force=True),
        gcs.takeoff(1, 5),
        gcs.land("red"),
        gcs.rtl("1-3"),
        gcs.hold("all"),
        gcs.mode("alpha", "LAND"),
        gcs.goto("alpha", 43.0, -79.0, 5.0),
        gcs.goto("alpha", enu_m=(1, 2, 3), yaw_deg=90.0),
        gcs.reboot("alpha"),
        gcs.command("alpha", "DO_SET_SERVO", [1, float("nan"), None]),
    ):
        assert "alpha" in await order
    assert served.daemon.vehicle("alpha").orders[-1][1]["params"] == [1.0, None, None]


async def test_states_and_messages_are_read_and_sent(served: Served, gcs: Client) -> None:
    assert [s["name"] for s in await gcs.vehicles("1-2")] == ["alpha", "bravo"]
    assert (await gcs.vehicle(3))["name"] == "carol"
    await gcs.send("ATTITUDE", {"roll": 0.5}, target="alpha")
    assert served.daemon.sent == [("ATTITUDE", {"roll": 0.5}, "alpha", None)]


async def test_a_list_of_many_states_gives_others_their_turn(
    served: Served, gcs: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slices, "SLICE_S", -1.0)  # after each state
    turns: list[int] = []
    made = served.daemon.vehicle("alpha")

    async def take_turns() -> None:
        while True:
            turns.append(made.states_made)
            await asyncio.sleep(0)

    other = asyncio.create_task(take_turns())
    states = await asyncio.gather(gcs.vehicles(), gcs.vehicles("carol"), gcs.vehicles())
    other.cancel()
    wanted = [["alpha", "bravo", "carol"], ["carol"], ["alpha", "bravo", "carol"]]
    assert [[state["name"] for state in listed] for listed in states] == wanted
    first, second = turns.index(1), turns.index(2)
    assert second - first >= 3, "the second list began before the first one had its three turns"


async def test_an_error_answer_is_raised_with_code_and_data(gcs: Client) -> None:
    with pytest.raises(RpcError, match="no vehicle 'nobody'") as error:
        await gcs.arm("nobody")
    assert error.value.code == -32001
    with pytest.raises(RpcError) as error:
        await gcs.call("vehicles.takeoff", targets="all", hight_m=3)
    assert error.value.code == -32602 and error.value.data["problems"][0]["param"] == "hight_m"
    with pytest.raises(ValueError, match="JSON"):
        await gcs.call("vehicles.takeoff", targets="all", height_m=float("nan"))


async def test_a_result_is_relayed_as_the_daemon_encoded_it(served: Served, gcs: Client) -> None:
    states, plain, other = await asyncio.gather(
        gcs.relay("vehicles.list", {"targets": "1-2"}), gcs.vehicles("3"), gcs.relay("operator.relay", {})
    )
    assert [state["name"] for state in json.loads(states)] == ["alpha", "bravo"]
    assert [state["name"] for state in plain] == ["carol"]
    assert isinstance(json.loads(other), dict)
    with pytest.raises(RpcError) as refused:
        await gcs.relay("vehicles.arm", {"targets": "nobody"})
    assert refused.value.code == -32001
    with pytest.raises(RpcError, match="after its deadline"):
        await gcs.relay("vehicles.arm", {"targets": "alpha"}, deadline_s=0.0)
    assert served.daemon.vehicle("alpha").orders == []
    assert not gcs._connected()._encoded


async def test_calls_from_many_tasks_find_their_own_answers(served: Served, gcs: Client) -> None:
    served.daemon.vehicle("alpha").delay_s = 0.05
    slow = asyncio.create_task(gcs.land("alpha"))
    states = await asyncio.gather(*(gcs.vehicle(1 + i % 3) for i in range(300)))
    assert [s["sysid"] for s in states] == [1 + i % 3 for i in range(300)]
    assert set(await slow) == {"alpha"}


async def test_telemetry_comes_until_it_is_left(served: Served, gcs: Client) -> None:
    seen = []
    async for state in gcs.telemetry("1,2", rate_hz=20, groups=["mode"]):
        seen.append(state["name"])
        if len(seen) == 5:
            break
    assert seen[:4] == ["alpha", "bravo", "alpha", "bravo"]
    await gcs.call("daemon.info")
    made = served.daemon.vehicle("alpha").states_made
    await asyncio.sleep(0.15)
    assert served.daemon.vehicle("alpha").states_made == made


async def test_encoded_telemetry_is_passed_on_as_it_came_and_a_round_has_an_end(served: Served, gcs: Client) -> None:
    served.daemon.vehicle("alpha").name = 'al"pha\\'
    encoded = gcs.encoded_telemetry("all", rate_hz=5, groups=["name", "mode", "battery"])
    first: dict[str, Any] = {}
    async for update in encoded:
        first |= {name: json.loads(state) for name, state in update["states"].items()}
        if update["complete"]:
            break
    assert set(first) == {'al"pha\\', "bravo", "carol"}
    assert all(name == state["name"] for name, state in first.items())
    assert first["bravo"].keys() == {"name", "sysid", "mode", "battery"}
    plain = {state["name"]: state for state in await gcs.vehicles()}
    assert first["bravo"]["battery"] == plain["bravo"]["battery"]
    encoded.close()


async def test_who_iterates_slowly_gets_the_newest_state_only(served: Served, gcs: Client) -> None:
    states = gcs.telemetry("alpha", rate_hz=20, groups=["mode"])
    await anext(states)
    alpha = served.daemon.vehicle("alpha")
    for i in range(10):
        alpha.mode = f"MODE{i}"
        made = alpha.states_made
        while alpha.states_made < made + 2:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    await gcs.call("daemon.info")  # its answer comes behind the states
    assert (await anext(states))["mode"] == "MODE9"
    states.close()


async def test_events_and_messages_come_and_an_abandoned_subscription_ends(served: Served, gcs: Client) -> None:
    events, messages = gcs.events(kinds=["mode"]), gcs.messages("ATTITUDE", targets=1)
    await gcs.call("daemon.info")
    served.daemon.emit("armed", "alpha", "not this")
    served.daemon.emit("mode", "alpha", "this")
    served.daemon.hear("ATTITUDE", pitch=0.5)
    assert (await anext(events))["text"] == "this"
    assert (await anext(messages))["fields"]["pitch"] == 0.5
    assert served.daemon.listeners == 2
    events.close()
    events.close()
    del messages
    await gcs.call("daemon.info")
    assert served.daemon.listeners == 0


async def test_a_subscription_given_up_before_it_was_answered_ends_too(served: Served, gcs: Client) -> None:
    gcs.events().close()
    await gcs.call("daemon.info")
    await gcs.call("daemon.info")
    assert served.daemon.listeners == 0


async def test_waiting_for_an_event_can_be_given_up_and_taken_up_again(served: Served, gcs: Client) -> None:
    events = gcs.events()
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.02):
            await anext(events)
    served.daemon.emit("mode", "alpha", "later")
    assert (await anext(events))["text"] == "later"


async def test_events_lost_to_a_slow_program_are_told(
    served: Served, gcs: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_inbox, "MAX_WAITING", 10)
    events = gcs.events()
    await gcs.call("daemon.info")
    for i in range(25):
        served.daemon.emit("mode", "alpha", str(i))
    await gcs.call("daemon.info")
    await gcs.call("daemon.info")
    first = await anext(events)
    assert (first["text"], first["dropped"]) == ("15", 15)
    assert "dropped" not in await anext(events)


async def test_a_refused_subscription_raises_when_it_is_iterated(gcs: Client) -> None:
    with pytest.raises(RpcError, match="NONSENSE"):
        await anext(gcs.messages("NONSENSE"))
    with pytest.raises(RpcError, match="nobody"):
        await anext(gcs.telemetry("nobody"))


async def test_the_end_of_the_daemon_reaches_everyone_who_waits(served: Served, gcs: Client) -> None:
    served.daemon.vehicle("alpha").delay_s = 30
    events = gcs.events()
    order, event = asyncio.create_task(gcs.land("alpha")), asyncio.ensure_future(anext(events))
    await gcs.call("daemon.info")
    await served.server.close()
    for waiting in (order, event):
        with pytest.raises(DaemonUnreachable):
            await waiting
    with pytest.raises(DaemonUnreachable):
        await gcs.call("daemon.info")


async def test_closing_here_ends_what_waits(served: Served) -> None:
    served.daemon.vehicle("alpha").delay_s = 30
    gcs = connect(served.server.socket_path)
    await gcs.open()
    order = asyncio.create_task(gcs.land("alpha"))
    await asyncio.sleep(0)
    await gcs.close()
    await gcs.close()
    with pytest.raises(DaemonUnreachable):
        await order
    with pytest.raises(DaemonUnreachable):
        await gcs.call("daemon.info")


async def test_tcp_needs_the_right_token(served: Served) -> None:
    assert served.server.tcp_address is not None
    address = f"tcp://127.0.0.1:{served.server.tcp_address[1]}"
    async with connect(address, token="open sesame") as gcs:
        assert (await gcs.call("daemon.info"))["version"]
    with pytest.raises(RpcError, match="token is w") as error:
        async with connect(address, token="wrong"):
            pass
    assert error.value.code == -32004


def test_the_default_address_is_private_to_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SKYGCS_SOCKET", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert client_address() == "/run/user/7/skygcs.sock"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert client_address() == str(default_socket_path()) == f"/tmp/skygcs-{os.getuid()}/skygcs.sock"
    monkeypatch.setenv("SKYGCS_SOCKET", "/elsewhere")
    assert client_address() == "/elsewhere"
    assert client_address("/said") == "/said"


@pytest.mark.system
def test_the_client_imports_nothing_heavy() -> None:
    code = (
        "import sys, skygcs.rpc.client; print([m for m in ('pydantic', 'numpy', 'typer', 'rich') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
