"""The connection to a real hub: publish, request, serve; over a restart of the hub."""

from __future__ import annotations

import asyncio
import signal

import nats.js.errors
import pytest

from skygcs.errors import HubAway, NobodyThere, NotPermitted, ReplyLost
from skygcs.ext.federation.bridge.bus import Message
from support.hub import Hub, until


async def test_states_go_to_readers_and_requests_are_answered(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:
        seen: list[Message] = []
        await visitor.subscribe("state.*.fast", seen.append)

        async def here(message: Message) -> bytes:
            return b"answer to " + message.data

        await north.serve("here.north", here)
        assert await visitor.request("here.north", b"1", 10) == b"answer to 1"
        assert await north.publish("state.north.fast", b"{}")
        await until(lambda: seen, "the state arrives")
        assert seen == [Message("state.north.fast", b"{}")]


async def test_a_site_knows_who_ordered_whatever_the_order_says(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("boss") as boss, hub.bus("clerk") as clerk:
        taken: list[Message] = []

        async def take(message: Message) -> bytes:
            taken.append(message)
            return b"{}"

        await north.serve("cmd.north.*", take)
        for bus in (boss, clerk):
            assert await bus.request("cmd.north.alpha", b'{"by":"me@boss"}', 10) == b"{}"
        assert [message.sender for message in taken] == [hub.keys[name].public_key for name in ("boss", "clerk")]
        assert {message.subject for message in taken} == {"cmd.north.alpha"}


async def test_each_way_of_failing_has_its_name(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:

        async def never(_: Message) -> bytes:
            await asyncio.sleep(3600)
            return b""

        await north.serve("here.north", never)
        with pytest.raises(NobodyThere):
            await visitor.request("here.south", b"", 10)
        with pytest.raises(ReplyLost):
            await visitor.request("here.north", b"", 0.2)
        with pytest.raises(NotPermitted):
            await visitor.request("cmd.north.alpha", b"", 10)
        asked = asyncio.create_task(visitor.request("here.north", b"", 60))
        await asyncio.sleep(0.1)
        hub.kill()
        with pytest.raises(ReplyLost):  # at once, long before its time limit
            await asyncio.wait_for(asked, 10)
        await until(lambda: not visitor.connected, "the loss is noticed")
        with pytest.raises(HubAway):
            await visitor.request("here.north", b"", 10)
        assert not await visitor.publish("here.north", b"")


async def test_after_a_restart_of_the_hub_everything_goes_on_and_nothing_old_arrives(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:
        seen: list[bytes] = []
        await visitor.subscribe("event.*", lambda message: seen.append(message.data))
        hub.kill()
        await until(lambda: not north.connected, "the loss is noticed")
        assert not await north.publish("event.north", b"while it was away")
        await hub.start()
        await until(lambda: north.connected and visitor.connected, "both are back")

        async def sent() -> bool:
            return await north.publish("event.north", b"afterwards")

        assert await sent()
        await until(lambda: seen, "the event arrives")
        assert set(seen) == {b"afterwards"}
        assert (north.counters.not_sent, north.counters.connections) == (1, 2)


async def test_a_hub_that_is_replaced_is_another_one_with_empty_stores(hub: Hub) -> None:
    async with hub.bus("north") as north:
        before, leases = north.server_info["server_id"], await north.key_value("skygcs_leases")
        await leases.create("north.alpha", b"{}")
        await hub.replace()
        await until(lambda: north.connected and north.server_info["server_id"] != before, "the new hub is used")
        leases = await north.key_value("skygcs_leases")
        with pytest.raises(nats.js.errors.KeyNotFoundError):
            await leases.get("north.alpha")


async def test_a_hub_that_stands_still_is_given_up_and_used_again(hub: Hub) -> None:
    """As a cut network: nothing is refused, nothing answers."""
    async with hub.bus("north") as north:
        server = hub.process.process
        assert server is not None
        server.send_signal(signal.SIGSTOP)
        try:
            await until(lambda: not north.connected, "it is given up")
            assert "has not answered for 2 s" in north.text or "no connection within" in north.text
            assert not await north.publish("event.north", b"{}")
        finally:
            server.send_signal(signal.SIGCONT)
        await until(lambda: north.connected, "it is used again")
        assert await north.publish("event.north", b"{}")


async def test_what_is_not_taken_by_the_hub_is_dropped_and_no_memory_grows(hub: Hub) -> None:
    def readers() -> list[str]:
        return [repr(task) for task in asyncio.all_tasks() if "_wait_for_msgs" in repr(task)]

    async with hub.bus("north") as north:
        await north.subscribe("event.*", lambda message: None)
        assert len(readers()) == 1
        server = hub.process.process
        assert server is not None
        server.send_signal(signal.SIGSTOP)
        try:
            sent = [await north.publish("state.north.fast", bytes(1 << 20)) for _ in range(60)]
            assert sent[0] and not all(sent) and north.counters.not_sent == sent.count(False)
            client = north._client
            assert client is not None and 0 < client.pending_data_size < 6 << 20
            await until(lambda: not north.connected, "it is given up")
            await until(lambda: north._client is None and not client.pending_data_size, "nothing is kept for later")
            await until(lambda: not readers(), "its readers end with it")
        finally:
            server.send_signal(signal.SIGCONT)
