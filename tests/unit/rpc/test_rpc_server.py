"""The server over real sockets, against a fake daemon: what clients get, and what bad clients cannot do to others."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import stat
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skygcs.errors import LinkError
from skygcs.rpc import client_peer, sessions
from skygcs.rpc.server import RpcServer
from support.examples import examples
from support.fake_daemon import FakeDaemon, FakeOutcome
from support.rpc_bench import Bench, Peer, running, under_uvloop
from support.table import each


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    async with running(tmp_path) as bench:
        yield bench


def arm(request_id: object = 1, targets: str = "all") -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": request_id, "method": "vehicles.arm", "params": {"targets": targets}}


async def test_every_order_reaches_the_vehicles_with_its_arguments(bench: Bench) -> None:
    peer = await bench.connect()
    alpha = bench.daemon.vehicle("alpha")
    place = dict.fromkeys(("enu_m", "yaw_deg")) | {"lat_deg": 43.0, "lon_deg": -79.0, "height_m": 5.0}
    place |= {"force": False, "same_place": False, "together": None}
    rate: dict[str, Any] = {"message": "ATTITUDE", "rate_hz": None}
    raw = dict.fromkeys(("int_frame", "x", "y", "z")) | {"command": 183, "params": [1.0, None], "force": False}
    orders: list[tuple[str, dict[str, Any], tuple[str, dict[str, Any]]]] = [
        ("arm", {"force": True, "wait_s": 2.5}, ("arm", {"force": True, "wait_s": 2.5})),
        ("disarm", {}, ("disarm", {"force": False})),
        ("mode", {"mode": "LAND"}, ("set_mode", {"name": "LAND", "force": False})),
        ("takeoff", {"height_m": 3}, ("takeoff", {"height_m": 3.0, "arm": True, "wait_s": 0.0, "force": False})),
        ("land", {}, ("land", {})),
        ("rtl", {}, ("rtl", {})),
        ("hold", {}, ("hold", {})),
        ("stop", {}, ("stop", {"action": "hold"})),
        ("stop", {"action": "kill", "confirm": "kill-1"}, ("stop", {"action": "kill"})),
        ("goto", {"lat_deg": 43, "lon_deg": -79, "height_m": 5}, ("goto", place)),
        ("reboot", {"force": True}, ("reboot", {"force": True})),
        ("set_home", {}, ("set_home", {"lat_deg": None, "lon_deg": None, "alt_amsl_m": None, "force": False})),
        ("interval", rate, ("set_message_interval", rate)),
        ("request", {"message": 30}, ("request_message", {"message": 30})),
        ("stream", {"stream": "ALL", "rate_hz": 4}, ("request_stream", {"stream": "ALL", "rate_hz": 4.0})),
        ("command", {"command": 183, "params": [1, None]}, ("command", raw)),
    ]
    for method, params, expected in orders:
        answer = await peer.call(f"vehicles.{method}", targets="alpha", **params)
        assert answer["result"]["outcomes"]["alpha"]["ok"] is True, answer
        assert alpha.orders[-1] == expected
    assert bench.daemon.vehicle("bravo").orders == []


async def test_a_kill_without_its_word_is_an_error_for_all_of_them(bench: Bench) -> None:
    peer = await bench.connect()
    error = (await peer.call("vehicles.stop", targets="all", action="kill"))["error"]
    assert error["code"] == -32002
    assert "alpha, bravo and carol" in error["message"] and "'kill-3'" in error["message"]
    assert bench.daemon.vehicle("alpha").orders == []
    assert (await peer.call("vehicles.stop", targets="all", action="fall"))["error"]["code"] == -32602


async def test_each_vehicle_has_its_own_outcome(bench: Bench) -> None:
    peer = await bench.connect()
    bench.daemon.vehicle("carol").outcome = FakeOutcome(False, "denied", "denied: Arm: Throttle too high")
    outcomes = (await peer.call("vehicles.arm", targets=["1", 3]))["result"]["outcomes"]
    assert {name: o["ok"] for name, o in outcomes.items()} == {"alpha": True, "carol": False}
    assert outcomes["carol"]["message"] == "denied: Arm: Throttle too high"


async def test_reading_methods_answer(bench: Bench) -> None:
    peer = await bench.connect()
    for method in ("daemon.info", "links.list", "router.stats", "events.recent", "recorder.status", "messages.list"):
        assert "result" in await peer.call(method), method
    states = (await peer.call("vehicles.list"))["result"]
    assert [s["name"] for s in states] == ["alpha", "bravo", "carol"]
    assert states[0]["gps"]["vdop"] is None  # NaN in the snapshot
    assert states[0]["links"]["radio"]["loss_ratio"] == 0.013
    assert (await peer.call("vehicles.get", target=2))["result"]["name"] == "bravo"
    assert (await peer.call("vehicles.get", target="all"))["error"]["code"] == -32001
    assert (await peer.call("vehicles.get", target="nobody"))["error"]["code"] == -32001
    assert (await peer.call("messages.latest", target=1, name="attitude"))["result"]["fields"]["roll"] is None
    bench.daemon.fleet.vehicles.clear()
    assert (await peer.call("vehicles.list"))["result"] == []


async def test_links_are_changed_at_run_time_and_mistakes_are_told(bench: Bench) -> None:
    peer = await bench.connect()
    added = await peer.call("links.add", name="qgc", link={"type": "udp_client", "host": "::1", "port": 14550})
    assert [link["name"] for link in added["result"]] == ["radio", "qgc"]
    again = await peer.call("links.add", name="qgc", link={"type": "udp_client"})
    assert again["error"]["code"] == -32003
    wrong = await peer.call("links.add", name="x", link={})
    assert wrong["error"]["code"] == -32602 and "links.x.port: is missing" in wrong["error"]["message"]
    assert [link["name"] for link in (await peer.call("links.remove", name="qgc"))["result"]] == ["radio"]


async def test_a_message_is_checked_field_by_field_before_it_is_sent(bench: Bench) -> None:
    peer = await bench.connect()
    bad = await peer.call("messages.send", name="ATTITUDE", fields={"rol": 1, "yaw": "north"})
    assert {p["param"] for p in bad["error"]["data"]["problems"]} == {"fields.rol", "fields.yaw"}
    assert (await peer.call("messages.send", name="NONSENSE"))["error"]["code"] == -32602
    fields = {"type": "MAV_TYPE_GCS", "base_mode": "MAV_MODE_FLAG_SAFETY_ARMED|MAV_MODE_FLAG_TEST_ENABLED"}
    assert "result" in await peer.call("messages.send", name="heartbeat", fields=fields, target="alpha")
    assert bench.daemon.sent[-1] == ("HEARTBEAT", {"type": 6, "base_mode": 130}, "alpha", None)
    await peer.call("messages.send", name="STATUSTEXT", fields={"text": 123}, link="radio")
    assert bench.daemon.sent[-1] == ("STATUSTEXT", {"text": "123"}, None, "radio")
    await peer.call("messages.send", name="ATTITUDE", fields={"roll": None})
    assert bench.daemon.sent[-1][1]["roll"] != bench.daemon.sent[-1][1]["roll"]  # NaN
    wrong = await peer.call("messages.send", name="HEARTBEAT", fields={"type": "MAV_TYPE_CAR"})
    assert "MAV_TYPE_CAR" in wrong["error"]["message"]
    assert len(bench.daemon.sent) == 3


async def test_a_message_with_a_target_field_is_never_for_everyone_by_omission(bench: Bench) -> None:
    peer = await bench.connect()
    arm_all = {"command": 400, "param1": 1}
    for name, field, fields in (
        ("COMMAND_LONG", "target_system", arm_all),
        ("MANUAL_CONTROL", "target", {"z": 1000}),
        ("COMMAND_LONG", "target_system", {**arm_all, "target_component": 1}),
    ):
        error = (await peer.call("messages.send", name=name, fields=fields))["error"]
        assert error["code"] == -32602 and error["data"]["problems"][0]["param"] == "target"
        assert field in error["message"]
    both = await peer.call("messages.send", name="COMMAND_LONG", fields=arm_all, target="alpha", link="radio")
    assert both["error"]["code"] == -32602
    assert bench.daemon.sent == []
    assert "result" in await peer.call("messages.send", name="COMMAND_LONG", fields=arm_all, target="all")
    assert "result" in await peer.call("messages.send", name="COMMAND_LONG", fields=arm_all, link="radio")
    everyone = {**arm_all, "target_system": 0}
    assert "result" in await peer.call("messages.send", name="COMMAND_LONG", fields=everyone)
    assert "result" in await peer.call("messages.send", name="MANUAL_CONTROL", fields={"target": 1})


async def test_a_command_that_is_none_is_told_once_with_near_ones(bench: Bench) -> None:
    peer = await bench.connect()
    for wrong, near in (
        ("DO_SET_SERV", "DO_SET_SERVO"),
        ("mav_cmd_SERVO", "DO_REPEAT_SERVO"),
        ("NOSUCHCMD", "commands.list"),
    ):
        error = (await peer.call("vehicles.command", targets="all", command=wrong))["error"]
        assert error["code"] == -32602 and near in error["message"], error
    assert bench.daemon.vehicle("alpha").orders == []
    for right in ("mav_cmd_do_set_servo", "DO_SET_SERVO", "65000", 65000):
        assert "result" in await peer.call("vehicles.command", targets="alpha", command=right)
    listed = (await peer.call("commands.list"))["result"]
    assert {"id": 183, "name": "DO_SET_SERVO"} in listed


async def test_a_home_needs_no_altitude_but_both_coordinates(bench: Bench) -> None:
    peer = await bench.connect()
    assert "result" in await peer.call("vehicles.set_home", targets="alpha", lat_deg=43, lon_deg=-79)
    place = {"lat_deg": 43, "lon_deg": -79, "alt_amsl_m": None, "force": False}
    assert bench.daemon.vehicle("alpha").orders[-1][1] == place
    for part in ({"lat_deg": 43}, {"lon_deg": 1, "alt_amsl_m": 2}, {"alt_amsl_m": 180}):
        assert "error" in await peer.call("vehicles.set_home", targets="alpha", **part)


async def test_a_batch_is_answered_as_one_without_its_notifications(bench: Bench) -> None:
    peer = await bench.connect()
    info = {"jsonrpc": "2.0", "method": "daemon.info"}
    peer.send([{**info, "id": 1}, info, 5, arm(2), {**arm(3), "id": "x"}, {"jsonrpc": "2.0", "id": 4, "method": "no"}])
    answers = await peer.answer()
    assert [a["id"] for a in answers] == [1, None, 2, "x", 4]
    assert [a.get("error", {}).get("code") for a in answers] == [None, -32600, None, None, -32601]
    peer.send([{"jsonrpc": "2.0", "id": "x" * 40_000}, {**info, "id": 2}])  # no method, and an answer of much
    assert [a["id"][:1] if isinstance(a["id"], str) else a["id"] for a in await peer.answer()] == ["x", 2]
    peer.send([info, info], [], [info] * (sessions.MAX_BATCH + 1))
    assert (await peer.answer())["error"]["code"] == -32600
    assert (await peer.answer())["error"]["code"] == -32005


async def test_garbage_is_answered_and_the_next_request_works(bench: Bench) -> None:
    peer = await bench.connect()
    peer.send(b"{", b"\xff\xfe\x00", b"[" * 20_000, b"[" * 60_000, b"", b"   ", b"null", {"id": 1})
    codes = [(await peer.answer())["error"]["code"] for _ in range(6)]
    assert codes == [-32700, -32700, -32700, -32005, -32600, -32600]
    assert "result" in await peer.call("daemon.info")


async def test_a_line_that_is_too_long_is_skipped_and_nothing_is_kept_of_it(bench: Bench) -> None:
    peer = await bench.connect()
    for _ in range(5):
        peer.writer.write(b"x" * sessions.MAX_LINE_BYTES)
        await peer.writer.drain()
    peer.send(b"the end of the line")
    assert "at most" in (await peer.answer())["error"]["message"]
    assert "result" in await peer.call("daemon.info")
    assert bench.server.stats()["lines_too_long"] == 1


async def test_a_request_may_come_byte_by_byte_and_many_at_once(bench: Bench) -> None:
    peer = await bench.connect()
    for byte in json.dumps(arm(7)).encode() + b"\r\n":
        peer.writer.write(bytes([byte]))
        await peer.writer.drain()
    assert (await peer.answer())["id"] == 7
    peer.send(*({"jsonrpc": "2.0", "id": i, "method": "daemon.info"} for i in range(1000)))
    assert [(await peer.answer())["id"] for _ in range(1000)] == list(range(1000))


async def test_an_order_that_is_read_after_its_deadline_is_not_carried_out(bench: Bench) -> None:
    peer = await bench.connect()
    now_s = (await peer.call("daemon.info"))["result"]["now_s"]
    late, early = now_s - 0.5, now_s + 3600
    notification = arm(targets="carol") | {"deadline_s": late}
    del notification["id"]
    peer.send(notification, arm(1, "alpha") | {"deadline_s": late}, arm(2, "bravo") | {"deadline_s": early})
    refused, carried_out = await peer.answer(), await peer.answer()
    assert refused["id"] == 1 and "after its deadline" in refused["error"]["message"]
    assert carried_out["id"] == 2 and carried_out["result"]["outcomes"]["bravo"]["ok"]
    assert bench.server.stats()["requests_late"] == 2
    assert [bench.daemon.vehicle(name).orders for name in ("alpha", "carol")] == [[], []]


async def test_slow_orders_do_not_hold_up_quick_answers(bench: Bench) -> None:
    peer = await bench.connect()
    bench.daemon.vehicle("alpha").delay_s = 0.2
    peer.send(arm("slow", "alpha"), {"jsonrpc": "2.0", "id": "quick", "method": "daemon.info"})
    assert [(await peer.answer())["id"] for _ in range(2)] == ["quick", "slow"]


async def test_calls_in_flight_are_limited_per_client_only(bench: Bench) -> None:
    greedy, other = await bench.connect(), await bench.connect()
    alpha = bench.daemon.vehicle("alpha")
    alpha.delay_s = 30.0
    greedy.send(*(arm(i, "alpha") for i in range(sessions.MAX_IN_FLIGHT + 1)))
    answer = await greedy.answer()
    assert answer["id"] == sessions.MAX_IN_FLIGHT and answer["error"]["code"] == -32005
    assert (await other.call("vehicles.arm", targets="bravo"))["result"]["outcomes"]["bravo"]["ok"]
    await greedy.close()
    await bench.until(lambda: alpha.cancelled == sessions.MAX_IN_FLIGHT)


async def test_what_a_vanished_client_waits_for_is_cancelled(bench: Bench) -> None:
    peer = await bench.connect()
    alpha = bench.daemon.vehicle("alpha")
    alpha.delay_s = 30.0
    peer.send(arm(1, "alpha"), [arm(2, "alpha"), arm(3, "alpha")])
    await bench.until(lambda: len(alpha.orders) == 3)
    peer.writer.transport.abort()
    await bench.until(lambda: alpha.cancelled == 3)
    assert bench.server.stats()["sessions"] == 0


LASTING = ("land", "hold", "stop", "disarm")


async def test_orders_that_end_a_flight_go_on_when_their_client_vanishes(bench: Bench) -> None:
    peer = await bench.connect()
    alpha = bench.daemon.vehicle("alpha")
    alpha.delay_s = 0.2
    single, batched, notified, waited_for = (
        {"jsonrpc": "2.0", "id": i, "method": f"vehicles.{order}", "params": {"targets": "alpha"}}
        for i, order in enumerate(LASTING)
    )
    del notified["id"]
    peer.send(single, [batched, arm(9, "alpha")], notified, waited_for, arm(8, "alpha"))
    await bench.until(lambda: len(alpha.orders) == 6)
    peer.writer.transport.abort()
    await bench.until(lambda: alpha.cancelled == 2)  # the armings
    assert bench.server.stats()["sessions"] == 0
    await bench.until(lambda: sorted(alpha.finished) == sorted(LASTING))


async def test_a_landing_counts_although_its_client_is_gone_before_it_has_begun(bench: Bench) -> None:
    peer = await bench.connect()
    request = {"jsonrpc": "2.0", "method": "vehicles.land", "params": {"targets": "alpha"}}
    peer.send(request)
    peer.writer.transport.close()
    await bench.until(lambda: bench.daemon.vehicle("alpha").finished == ["land"])


async def test_orders_without_client_are_bounded_and_end_with_the_daemon(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "MAX_WITHOUT_CLIENT", 2)
    peer = await bench.connect()
    alpha = bench.daemon.vehicle("alpha")
    alpha.delay_s = 30.0
    one = {"jsonrpc": "2.0", "id": 1, "params": {"targets": "alpha"}}
    peer.send(*({**one, "method": f"vehicles.{order}"} for order in ("land", "rtl", "hold")))
    await bench.until(lambda: len(alpha.orders) == 3)
    peer.writer.transport.abort()
    await bench.until(lambda: alpha.cancelled == 1)
    await asyncio.sleep(0.02)
    assert alpha.cancelled == 1
    await bench.server.close()
    assert alpha.cancelled == 3


async def test_an_order_that_ends_with_the_daemon_is_answered(bench: Bench) -> None:
    peer, alpha = await bench.connect(), bench.daemon.vehicle("alpha")
    alpha.delay_s = 0.05
    peer.send(arm(1, "alpha"))
    await bench.until(lambda: bool(alpha.orders))
    await bench.server.close()
    assert (await peer.answer())["id"] == 1


async def test_a_client_that_only_stops_sending_is_still_answered(bench: Bench) -> None:
    peer = await bench.connect()
    bench.daemon.vehicle("alpha").delay_s = 0.05
    peer.writer.write(json.dumps(arm(1, "alpha")).encode())  # no newline: the end of file ends the line
    peer.writer.write_eof()
    assert (await peer.answer())["result"]["outcomes"]["alpha"]["ok"]
    assert await peer.answer() is None


async def test_a_client_that_never_reads_is_stopped_without_growing_the_daemon(bench: Bench) -> None:
    lazy, other = await bench.connect(), await bench.connect()
    lazy.writer.transport.set_write_buffer_limits(high=0)
    lazy.reader._transport.pause_reading()  # type: ignore[union-attr]
    request = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "messages.list"}).encode() + b"\n"

    async def flood() -> None:
        while True:
            lazy.writer.write(request * 100)
            await lazy.writer.drain()

    flooding = asyncio.create_task(flood())
    for _ in range(20):
        assert "result" in await other.call("daemon.info")
        await asyncio.sleep(0.01)
    assert not flooding.done()  # it waits: the daemon reads no more of its requests
    clients = bench.server._hub.sessions  # type: ignore[union-attr]
    unread = max(s._transport.get_write_buffer_size() for s in clients)  # type: ignore[union-attr]
    assert 0 < unread < client_peer.MAX_OUTPUT_BYTES
    assert max(len(s._lines) for s in clients) < sessions.MAX_LINE_BYTES
    flooding.cancel()
    lazy.writer.transport.abort()


async def test_a_client_whose_unread_replies_exceed_the_bound_is_closed(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_peer, "MAX_OUTPUT_BYTES", 300_000)
    lazy = await bench.connect()
    lazy.reader._transport.pause_reading()  # type: ignore[union-attr]
    bench.daemon.vehicle("alpha").delay_s = 0.05
    lazy.send(*({"jsonrpc": "2.0", "id": i, "method": "messages.list"} for i in range(20)))
    await bench.until(lambda: bench.server.stats().get("closed_unread"))
    assert bench.server.stats()["sessions"] == 0


async def test_the_replies_of_one_batch_are_bounded(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_peer, "MAX_OUTPUT_BYTES", 1_000_000)
    peer = await bench.connect()
    hub = bench.server._hub
    assert hub is not None
    begun: list[str] = []
    monkeypatch.setattr(hub.dispatcher.gate, "asked", lambda method: begun.append(method.name))
    methods = ["messages.list"] * 20 + ["links.list", "messages.list"]
    peer.send([{"jsonrpc": "2.0", "id": i, "method": name} for i, name in enumerate(methods)])
    answers = await peer.answer()
    assert [answer["id"] for answer in answers] == list(range(22))
    assert "result" in answers[0] and answers[-1]["error"]["code"] == -32005
    assert begun.count("messages.list") < 10, "what does not fit is not worked out"
    assert begun[-1] == "links.list", "what may be small, as every order, is begun all the same"


async def test_a_batch_gives_way_to_other_clients_and_to_no_later_line(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """128 replies of 134 kB held the loop for 112 ms."""
    monkeypatch.setattr(sessions, "TURN_S", 0.0)
    peer, other = await bench.connect(), await bench.connect()
    hub = bench.server._hub
    assert hub is not None
    begun: list[str] = []
    monkeypatch.setattr(hub.dispatcher.gate, "asked", lambda method: begun.append(method.name))
    reads = [{"jsonrpc": "2.0", "id": i, "method": "messages.list"} for i in range(20)]
    peer.send([*reads, arm(20, "alpha")], {**arm(21, "alpha"), "method": "vehicles.land"})
    await other.call("vehicles.list")
    assert len(begun) < len(reads), "it is not held up by all of them"
    assert [answer["id"] for answer in await peer.answer()] == list(range(21))
    assert (await peer.answer())["id"] == 21
    assert [order[0] for order in bench.daemon.vehicle("alpha").orders] == ["arm", "land"]


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(chunks=st.lists(st.binary(max_size=200), max_size=10), abrupt=st.booleans())
async def test_no_bytes_disturb_another_client(bench: Bench, chunks: list[bytes], abrupt: bool) -> None:
    bad, good = await bench.connect(), await bench.connect()
    for chunk in chunks:
        bad.writer.write(chunk)
        assert "result" in await good.call("daemon.info")
    if abrupt:
        bad.writer.transport.abort()
    assert "result" in await good.call("vehicles.arm", targets="all")
    for peer in bench.peers:
        await peer.close()
    bench.peers.clear()


# -- the socket


def test_a_token_is_needed_for_tcp(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="token"):
        RpcServer(FakeDaemon(), tmp_path / "s", tcp_port=0)


async def test_the_socket_is_private_and_removed_at_the_end(bench: Bench) -> None:
    path = bench.server.socket_path
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    await bench.server.close()
    assert not path.exists()
    await bench.server.close()


async def test_a_dead_daemons_socket_is_replaced_and_a_living_ones_is_not(tmp_path: Path) -> None:
    path = tmp_path / "s.sock"
    dead = socket.socket(socket.AF_UNIX)
    dead.bind(os.fspath(path))
    dead.close()
    first, second = RpcServer(FakeDaemon(), path), RpcServer(FakeDaemon(), path)
    await first.start()
    with pytest.raises(LinkError, match="another skygcs daemon listens"):
        await second.start()
    peer = Peer(*await asyncio.open_unix_connection(os.fspath(path)))
    assert "result" in await peer.call("daemon.info")
    await peer.close()
    await first.close()
    await second.start()
    await second.close()


async def test_a_claimed_path_is_nobody_elses_before_anybody_listens(tmp_path: Path) -> None:
    path = tmp_path / "s.sock"
    first, second = RpcServer(FakeDaemon(), path), RpcServer(FakeDaemon(), path)
    first.claim()
    first.claim()
    assert not path.exists()
    with pytest.raises(LinkError, match="another skygcs daemon listens"):
        second.claim()
    await first.start()
    assert path.exists()
    await first.close()
    second.claim()
    await second.close()


async def test_a_tcp_port_that_another_has_is_told_before_anything_is_begun(bench: Bench, tmp_path: Path) -> None:
    assert bench.server.tcp_address is not None
    port = bench.server.tcp_address[1]
    late = RpcServer(FakeDaemon(), tmp_path / "other.sock", tcp_port=port, token="open sesame")
    with pytest.raises(
        LinkError, match=f"cannot listen on 127.0.0.1:{port}: port {port} is in use by another program; stop"
    ):
        late.claim()
    await bench.server.close()
    await late.start()
    assert late.tcp_address == ("127.0.0.1", port)
    await late.close()


async def test_another_programs_listening_socket_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "s.sock"
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(os.fspath(path))
        other.listen(1)
        with pytest.raises(LinkError, match="another"):
            await RpcServer(FakeDaemon(), path).start()
    assert path.exists()


@each("make", [Path.touch, Path.mkdir])
async def test_what_is_no_socket_is_never_removed(tmp_path: Path, make: Any) -> None:
    path = tmp_path / "precious"
    make(path)
    with pytest.raises(LinkError, match="not a socket"):
        await RpcServer(FakeDaemon(), path).start()
    assert path.exists()


async def test_a_path_that_cannot_be_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="at most 107 bytes"):
        await RpcServer(FakeDaemon(), tmp_path / ("x" * 120)).start()
    (tmp_path / "file").touch()
    with pytest.raises(LinkError, match="cannot make the socket"):
        await RpcServer(FakeDaemon(), tmp_path / "file" / "s.sock").start()


# -- TCP


async def test_tcp_answers_after_the_right_token(bench: Bench) -> None:
    peer = await bench.connect_tcp()
    assert (await peer.call("auth", token="open sesame"))["result"] == {"ok": True}
    assert "result" in await peer.call("daemon.info")


@each(
    "first",
    [
        {"jsonrpc": "2.0", "id": 1, "method": "auth", "params": {"token": "open sesam"}},
        {"jsonrpc": "2.0", "id": 1, "method": "auth", "params": {"token": ""}},
        {"jsonrpc": "2.0", "id": 1, "method": "auth", "params": {"token": 7}},
        {"jsonrpc": "2.0", "id": 1, "method": "auth", "params": []},
        {"jsonrpc": "2.0", "id": 1, "method": "auth"},
        arm(),
        [arm()],
        b"GET / HTTP/1.1",
        b"open sesame",
        b"x" * 5000,
    ],
)
async def test_tcp_does_nothing_for_a_client_without_the_token(bench: Bench, first: object) -> None:
    peer = await bench.connect_tcp()
    peer.send(first, arm())
    answers = []
    try:
        while (answer := await peer.answer()) is not None:
            answers.append(answer)
    except ConnectionError:
        pass
    assert len(answers) <= 1 and all("error" in a for a in answers)
    assert bench.daemon.vehicle("alpha").orders == []


async def test_a_silent_tcp_client_is_closed(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "AUTH_TIMEOUT_S", 0.02)
    peer = await bench.connect_tcp()
    assert await peer.answer() is None


@each(
    "scenario",
    [
        test_a_batch_is_answered_as_one_without_its_notifications,
        test_garbage_is_answered_and_the_next_request_works,
        test_a_line_that_is_too_long_is_skipped_and_nothing_is_kept_of_it,
        test_a_request_may_come_byte_by_byte_and_many_at_once,
        test_what_a_vanished_client_waits_for_is_cancelled,
        test_orders_that_end_a_flight_go_on_when_their_client_vanishes,
        test_a_landing_counts_although_its_client_is_gone_before_it_has_begun,
        test_a_client_that_only_stops_sending_is_still_answered,
        test_a_client_that_never_reads_is_stopped_without_growing_the_daemon,
        test_tcp_answers_after_the_right_token,
    ],
)
def test_the_same_holds_under_uvloop_which_the_daemon_uses(
    tmp_path: Path, scenario: Callable[[Bench], Coroutine[Any, Any, None]]
) -> None:
    under_uvloop(tmp_path, scenario)


@each("turns", range(5))
async def test_a_connection_that_is_accepted_while_the_server_closes_is_closed_too(tmp_path: Path, turns: int) -> None:
    server = RpcServer(FakeDaemon(), tmp_path / "s.sock")
    await server.start()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.setblocking(False)
        client.connect(str(tmp_path / "s.sock"))
        for _ in range(turns):
            await asyncio.sleep(0)
        await server.close()
        with contextlib.suppress(ConnectionResetError):  # not accepted yet: the system ends it
            assert await asyncio.wait_for(asyncio.get_running_loop().sock_recv(client, 1), 10) == b""
