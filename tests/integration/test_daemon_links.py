"""Links that come, change and go while the daemon runs; what a person sees of them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import structlog

from skygcs.config.dialects import offline_dialect
from skygcs.config.models import DaemonConfig, FleetConfig, MemoryLinkConfig, SerialLinkConfig
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.routing_table import RouteNote
from skygcs.daemon import Daemon
from skygcs.errors import ConfigError, LinkError, RefusedError
from skygcs.rpc.client import connect
from skygcs.runtime.task_set import ask, asking_from
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.tlog.reading import LogReader
from support.called import sender_of
from support.daemons import made_daemon, memory_link, started
from support.hosts import until
from support.process import free_port
from support.routed import heartbeat, message


@contextlib.asynccontextmanager
async def running(tmp_path: Path, *, record: bool = False, **links: dict[str, Any]) -> AsyncIterator[Daemon]:
    daemon = made_daemon(
        tmp_path,
        daemon={"record": record},
        links={name: MemoryLinkConfig(name=name, **keys) for name, keys in links.items()},
    )
    async with started(daemon):
        await until(lambda: all(row["state"] in ("up", "disabled") for row in daemon.links.status()))
        yield daemon


def peer_of(daemon: Daemon, name: str) -> Any:
    return memory_link(daemon, name).peer


async def test_a_link_added_changed_and_removed_at_run_time(tmp_path: Path) -> None:
    async with running(tmp_path, radio={"role": "radio"}) as daemon, connect(tmp_path / "s") as gcs:
        await gcs.call("links.add", name="gcs", link={"type": "memory", "role": "gcs"})
        await until(lambda: daemon.links.status()[-1]["state"] == "up")
        peer_of(daemon, "radio").send(heartbeat(7))
        await until(lambda: any(raw[5] == 7 for raw in peer_of(daemon, "gcs").received))
        await gcs.call("links.change", name="gcs", link={"block_msg_id_out": ["ATTITUDE"]})
        await until(lambda: daemon.links.status()[-1]["state"] == "up")
        peer = peer_of(daemon, "gcs")
        peer_of(daemon, "radio").send(message("ATTITUDE", 7, seq=1) + heartbeat(7, seq=2))
        await until(lambda: any(raw[5] == 7 for raw in peer.received))
        assert [raw[7] for raw in peer.received if raw[5] == 7] == [0]
        rows = await gcs.call("links.list")
        assert rows[-1]["channels"][0]["filtered_out"] == 1
        await gcs.call("links.remove", name="gcs")
        assert [row["name"] for row in await gcs.call("links.list")] == ["radio"]


async def test_a_wrong_description_changes_nothing_and_says_what_is_wrong(tmp_path: Path) -> None:
    async with running(tmp_path, radio={}) as daemon:
        with pytest.raises(ConfigError, match="ATITUDE"):
            await daemon.links.change("radio", {"allow_msg_id_in": ["ATITUDE"]})
        with pytest.raises(ConfigError, match="port"):
            await daemon.links.add("x", {"type": "udp_server", "port": "many"})
        with pytest.raises(LinkError, match="already"):
            await daemon.links.add("radio", {"type": "memory"})
        with pytest.raises(LinkError, match="no link 'y'; there are: radio"):
            await daemon.links.remove("y")
        assert [row["state"] for row in daemon.links.status()] == ["up"]


async def test_a_conflict_is_an_event_and_both_directions_are_on_the_tlog(tmp_path: Path) -> None:
    async with running(tmp_path, record=True, radio={}) as daemon:
        peer = peer_of(daemon, "radio")
        peer.send(heartbeat(255, 25, gcs=True))
        peer.send(heartbeat(7))
        await until(lambda: 7 << 8 | 1 in daemon.fleet.vehicles)
        answer = sender_of(daemon).send("PARAM_REQUEST_READ", {"param_id": "SYSID_THISMAV"}, "7")
        assert answer == {"sent": 1, "message": "PARAM_REQUEST_READ"}
        with pytest.raises(RefusedError, match="was not sent"):
            sender_of(daemon).send("PARAM_REQUEST_READ", {"target_system": 99})
        assert [e["kind"] for e in daemon.event_log.recent].count("conflict") == 1
        await until(lambda: any(raw[5] == 255 and raw[7] == 0 for raw in peer.received))
    [tlog] = (tmp_path / "logs").glob("*.tlog")
    names = [(r.frame.sysid, r.frame.name) for r in LogReader(tlog.read_bytes(), offline_dialect()) if r.frame]
    assert (7, "HEARTBEAT") in names
    assert names.count((255, "PARAM_REQUEST_READ")) == 1
    assert (255, "HEARTBEAT") in names


async def test_over_a_terrible_network_every_vehicle_is_still_found(tmp_path: Path) -> None:
    bad = {"loss": 0.3, "duplicate": 0.2, "delay_s": 0.01, "jitter_s": 0.03, "split": False, "seed": 5}
    async with running(tmp_path, radio=bad, gcs={"role": "gcs"}) as daemon:
        peer = peer_of(daemon, "radio")
        for seq in range(30):
            for sysid in range(1, 11):
                peer.send(heartbeat(sysid, seq=seq))
            await asyncio.sleep(0.005)
        await until(lambda: len(daemon.fleet.vehicles) == 10)
        assert daemon.hub.faults == 0


async def test_changes_that_race_leave_no_link_behind(tmp_path: Path) -> None:
    async with running(tmp_path, gcs={"role": "gcs"}) as daemon:
        attempts = [daemon.links.change("gcs", {"seed": n}) for n in range(5)]
        attempts += [daemon.links.add("new", {"type": "memory"}) for _ in range(3)]
        attempts += [daemon.links.remove("gcs"), daemon.links.add("gcs", {"type": "memory", "role": "gcs"})]
        results = await asyncio.gather(*attempts, return_exceptions=True)
        assert all(isinstance(r, LinkError) for r in results if r is not None)
        await until(lambda: all(row["state"] == "up" for row in daemon.links.status()))
        assert sorted(row["name"] for row in daemon.links.status()) == ["gcs", "new"]
        assert len(daemon.hub.channels) == 2
        running_links = [t for t in asyncio.all_tasks() if t.get_name().startswith("link ") and not t.done()]
        assert sorted(t.get_name() for t in running_links) == ["link gcs", "link new"]


async def test_a_change_whose_asker_goes_away_is_carried_through(tmp_path: Path) -> None:
    async with running(tmp_path, gcs={"role": "gcs"}) as daemon:
        change = asyncio.create_task(daemon.links.change("gcs", {"seed": 7}))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        change.cancel()
        await asyncio.wait({change})
        assert change.cancelled()
        await until(lambda: daemon.links.configs["gcs"].model_dump()["seed"] == 7)
        await until(lambda: daemon.links.status()[0]["state"] == "up")


async def test_a_link_in_conflict_with_another_is_refused_and_the_old_one_stays(tmp_path: Path) -> None:
    port = free_port()
    async with running(tmp_path, radio={}) as daemon:
        await daemon.links.add("gcs", {"type": "udp_server", "host": "127.0.0.1", "port": port, "enabled": False})
        await daemon.links.add("loop", {"type": "udp_client", "host": "127.0.0.1", "port": port})
        with pytest.raises(LinkError, match=f"links.loop.port: {port} is our own link gcs"):
            await daemon.links.change("gcs", {"enabled": True})
        await daemon.links.change("loop", {"enabled": False})
        await daemon.links.add("sim", {"type": "simulated", "px4": 2, "first_sysid": 5})
        with pytest.raises(LinkError, match="first_sysid: 6 is also a vehicle of the simulated link sim"):
            await daemon.links.add("sim2", {"type": "simulated", "px4": 1, "first_sysid": 6})
        with pytest.raises(LinkError, match="system ids above 255"):
            await daemon.links.change("sim", {"first_sysid": 255})
        assert [row["state"] for row in daemon.links.status() if row["name"] in ("radio", "sim")] == ["up", "up"]


async def test_a_link_is_switched_off_and_on_at_run_time(tmp_path: Path) -> None:
    async with running(tmp_path, radio={}, spare={"enabled": False}) as daemon:
        states = {row["name"]: row["state"] for row in daemon.links.status()}
        assert states == {"radio": "up", "spare": "disabled"}
        await daemon.links.change("radio", {"enabled": False})
        await daemon.links.change("spare", {"enabled": True})
        await until(lambda: any(row["state"] == "up" for row in daemon.links.status()))
        states = {row["name"]: row["state"] for row in daemon.links.status()}
        assert states == {"radio": "disabled", "spare": "up"}
        assert [c.link.name for c in daemon.hub.channels.values()] == ["spare"]
        assert daemon.links.link("radio") is None
        with pytest.raises(LinkError, match="already"):
            await daemon.links.add("radio", {"type": "memory"})
        await daemon.links.remove("radio")
        assert [row["name"] for row in daemon.links.status()] == ["spare"]


@contextlib.asynccontextmanager
async def with_vehicles(tmp_path: Path, **links: dict[str, Any]) -> AsyncIterator[Daemon]:
    """Vehicles 7 and 8 on the link "radio", 9 on "other"."""
    async with running(tmp_path, radio={"role": "radio"}, other={"role": "vehicle"}, **links) as daemon:
        peer_of(daemon, "radio").send(heartbeat(7) + heartbeat(8))
        peer_of(daemon, "other").send(heartbeat(9))
        await until(lambda: len(daemon.fleet.vehicles) == 3)
        yield daemon


def sent_to(daemon: Daemon, link: str, name: str) -> list[dict[str, Any]]:
    dialect = daemon.dialect
    frames = FrameParser(dialect).feed_datagram(b"".join(peer_of(daemon, link).received))
    return [f.fields() for f in frames if f.name == name]


async def test_the_target_field_is_filled_whatever_its_name(tmp_path: Path) -> None:
    async with with_vehicles(tmp_path) as daemon:
        assert sender_of(daemon).send("MANUAL_CONTROL", {"x": 100}, "8") == {"sent": 1, "message": "MANUAL_CONTROL"}
        await until(lambda: sent_to(daemon, "radio", "MANUAL_CONTROL"))
        [fields] = sent_to(daemon, "radio", "MANUAL_CONTROL")
        assert (fields["target"], fields["x"]) == (8, 100)
        assert sent_to(daemon, "other", "MANUAL_CONTROL") == []


async def test_a_message_that_waited_for_its_methods_does_not_follow_a_later_order(tmp_path: Path) -> None:
    """The first messages.send of all waits for an import; a hold that came meanwhile is not undone by it."""
    async with with_vehicles(tmp_path) as daemon:
        came = ask()
        hold = asyncio.create_task(daemon.fleet.orders.command_all("7", VehicleActor.hold))
        await asyncio.sleep(0.1)
        for target in ("7", "all"):
            asking_from(came)
            with pytest.raises(RefusedError, match=r"COMMAND_LONG was not sent: \S+ got a later order; send it again"):
                sender_of(daemon).send("COMMAND_LONG", {"command": 512}, target)
        asking_from(came)
        assert sender_of(daemon).send("COMMAND_LONG", {"command": 512}, "8")["sent"] == 1
        assert sender_of(daemon).send("COMMAND_LONG", {"command": 512}, "7")["sent"] == 1
        hold.cancel()


async def test_a_message_for_somebody_is_not_sent_to_everybody_unless_that_is_said(tmp_path: Path) -> None:
    async with with_vehicles(tmp_path) as daemon:
        with pytest.raises(RefusedError, match=r"COMMAND_LONG is addressed: give a target .* its field target_system"):
            sender_of(daemon).send("COMMAND_LONG", {"command": 400, "param1": 1.0})
        with pytest.raises(RefusedError, match="its field target "):
            sender_of(daemon).send("MANUAL_CONTROL", {"x": 1})
        with pytest.raises(RefusedError, match="not both"):
            sender_of(daemon).send("COMMAND_LONG", {"command": 400}, "7", "radio")
        with pytest.raises(RefusedError, match="the target 8 differ"):
            sender_of(daemon).send("COMMAND_LONG", {"command": 512, "target_system": 7}, "8")
        await asyncio.sleep(0.05)
        assert sent_to(daemon, "radio", "COMMAND_LONG") == sent_to(daemon, "other", "COMMAND_LONG") == []
        sender_of(daemon).send("COMMAND_LONG", {"command": 1, "target_system": 0})
        sender_of(daemon).send("COMMAND_LONG", {"command": 2}, link="other")
        assert sender_of(daemon).send("COMMAND_LONG", {"command": 3}, "all")["sent"] == 3
        await until(lambda: len(sent_to(daemon, "other", "COMMAND_LONG")) == 3)
        seen = [(f["command"], f["target_system"]) for f in sent_to(daemon, "radio", "COMMAND_LONG")]
        assert seen == [(1, 0), (3, 7), (3, 8)]
        seen = [(f["command"], f["target_system"]) for f in sent_to(daemon, "other", "COMMAND_LONG")]
        assert seen == [(1, 0), (2, 0), (3, 9)]


async def test_a_message_without_target_says_who_else_gets_it_and_goes_out_once_a_link(tmp_path: Path) -> None:
    async with with_vehicles(tmp_path) as daemon:
        values = {"text": "hello"}
        answer = sender_of(daemon).send("STATUSTEXT", values, "7")
        assert answer["note"] == "STATUSTEXT has no target field: on the same link v8 got it as well"
        assert "note" not in sender_of(daemon).send("STATUSTEXT", values, "9")
        assert sender_of(daemon).send("STATUSTEXT", values, "all") == {"sent": 2, "message": "STATUSTEXT"}
        await until(lambda: len(sent_to(daemon, "radio", "STATUSTEXT")) == 2)


async def test_two_vehicles_of_one_id_are_told_and_refused_until_one_is_gone(tmp_path: Path) -> None:
    async with with_vehicles(tmp_path) as daemon:
        key = 7 << 8 | 1
        channel = next(iter(daemon.hub.channels))
        daemon.hub.router.table.notes.append(
            RouteNote("duplicate", 7, 1, channel, present_id=channel, why="boot time differ")
        )
        daemon.hub.tick(daemon.now())
        event = daemon.event_log.recent[-1]
        assert (event["kind"], event["vehicle"], event["sysid"]) == ("duplicate", "v7", 7)
        assert "give it another id" in event["text"]
        [outcome] = (await daemon.fleet.orders.command_all("7", VehicleActor.arm)).values()
        assert outcome.result == "refused"
        assert daemon.fleet.vehicles[key].state(daemon.now())["duplicate_sysid"] is True
        daemon.hub.router.table.notes.append(RouteNote("duplicate_over", 7, 1, channel))
        daemon.hub.tick(daemon.now())
        assert (daemon.event_log.recent[-1]["kind"], daemon.event_log.recent[-1]["data"]["change"]) == (
            "duplicate",
            "duplicate_over",
        )
        assert daemon.fleet.vehicles[key].state(daemon.now())["duplicate_sysid"] is False


async def test_a_landing_takes_every_link_to_its_vehicle_at_once(tmp_path: Path) -> None:
    async with with_vehicles(tmp_path) as daemon:
        peer_of(daemon, "other").send(heartbeat(7, seq=9))
        await until(lambda: len(daemon.hub.router.channels_of(7 << 8 | 1)) == 2)
        landing = asyncio.create_task(daemon.fleet.orders.command_all("7", VehicleActor.land))
        await until(lambda: sent_to(daemon, "radio", "COMMAND_LONG") and sent_to(daemon, "other", "COMMAND_LONG"))
        attempts = [f["confirmation"] for link in ("radio", "other") for f in sent_to(daemon, link, "COMMAND_LONG")]
        assert attempts == [0, 0], "not only when it is repeated"
        landing.cancel()
        await asyncio.wait({landing})


@pytest.mark.parametrize("key", ["allow_src_sys_in", "block_src_sys_in", "allow_src_comp_in", "block_src_comp_in"])
async def test_no_broadcast_goes_out_while_a_link_keeps_sources_out(tmp_path: Path, key: str) -> None:
    async with running(tmp_path, radio={"role": "radio"}) as daemon:
        peer_of(daemon, "radio").send(heartbeat(7) + heartbeat(8))
        await until(lambda: len(daemon.fleet.vehicles) == 2)
        await daemon.links.add("kept", {"type": "memory", key: [1]})
        landing = asyncio.create_task(daemon.fleet.orders.command_all("all", VehicleActor.land))
        await until(lambda: len(sent_to(daemon, "radio", "COMMAND_LONG")) >= 2)
        targets = {f["target_system"] for f in sent_to(daemon, "radio", "COMMAND_LONG") if f["command"] == 21}
        assert targets == {7, 8}
        landing.cancel()
        await asyncio.wait({landing})


async def test_messages_give_way_to_orders_and_heartbeats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with with_vehicles(tmp_path) as daemon:
        used: list[Priority] = []
        for channel in daemon.hub.channels.values():
            monkeypatch.setattr(channel, "send", lambda out, priority, key=None: used.append(priority) or True)
        sender_of(daemon).send("STATUSTEXT", {}, "7")
        sender_of(daemon).send("STATUSTEXT", {}, link="radio")
        sender_of(daemon).send("STATUSTEXT", {})
        sender_of(daemon).send("COMMAND_LONG", {"target_system": 7})
        assert set(used) <= {Priority.PROTOCOL, Priority.HEARTBEAT}
        assert used.count(Priority.PROTOCOL) == 5


async def test_a_fault_in_one_vehicles_tick_grounds_nobody_and_is_told_once(tmp_path: Path) -> None:
    async with running(tmp_path, radio={}) as daemon:
        peer_of(daemon, "radio").send(heartbeat(7) + heartbeat(8))
        await until(lambda: len(daemon.fleet.vehicles) == 2)
        broken, sound = daemon.fleet.vehicles.values()
        ticks: list[float] = []

        def fails(now: float) -> None:
            raise RuntimeError("a fault of one vehicle")

        broken.tick = fails  # type: ignore[method-assign]
        sound.tick = ticks.append  # type: ignore[method-assign]
        await until(lambda: len(ticks) > 2)
        assert [e["kind"] for e in daemon.event_log.recent].count("fault") == 1
        assert daemon.hub.faults > 2


async def test_a_link_that_is_down_is_a_warning_and_not_among_the_open_ones(tmp_path: Path) -> None:
    missing = SerialLinkConfig(name="usb", device=str(tmp_path / "no-such-device"))
    daemon = made_daemon(tmp_path, links={"gcs": MemoryLinkConfig(name="gcs"), "usb": missing})
    with structlog.testing.capture_logs() as reported:
        async with started(daemon):
            await until(lambda: {row["state"] for row in daemon.links.status()} == {"up", "down"})
            assert daemon.links.open_names() == ["gcs"]
    levels = {line["event"].split(":")[0]: line["log_level"] for line in reported}
    assert levels["link usb is down"] == "warning" and levels["link gcs is up"] == "info"


async def test_a_reload_changes_only_the_links_that_differ(tmp_path: Path) -> None:
    def fleet(**links: dict[str, Any]) -> FleetConfig:
        own = DaemonConfig(socket=tmp_path / "s", log_dir=tmp_path / "logs", record=False)
        return FleetConfig(daemon=own, links={n: MemoryLinkConfig(name=n, **keys) for n, keys in links.items()})

    async with running(tmp_path, vehicle={"role": "vehicle"}, gcs={"role": "gcs"}, old={}) as daemon:
        await daemon.links.add("by-hand", {"type": "memory"})
        daemon._file_config = fleet(vehicle={"role": "vehicle"}, gcs={"role": "gcs"}, old={})
        kept, received = peer_of(daemon, "gcs"), [0]
        vehicle = peer_of(daemon, "vehicle")

        async def fly() -> None:
            for seq in range(200):
                vehicle.send(heartbeat(7, seq=seq))
                received[0] = seq + 1
                await asyncio.sleep(0.002)

        flying = asyncio.create_task(fly())
        await until(lambda: received[0] > 50)
        lines = await daemon.reload(fleet(vehicle={"role": "vehicle"}, gcs={"role": "gcs"}, new={}))
        assert sorted(lines) == ["link new added", "link old removed"]
        lines = await daemon.reload(fleet(vehicle={"role": "vehicle"}, gcs={"role": "gcs"}, new={"delay_s": 0.1}))
        assert lines == ["link new changed"]
        await flying
        await until(lambda: len([raw for raw in kept.received if raw[5] == 7]) == 200)
        assert [raw[4] for raw in kept.received if raw[5] == 7] == [n & 0xFF for n in range(200)]
        assert {row["name"] for row in daemon.links.status()} == {"vehicle", "gcs", "by-hand", "new"}
        assert {row["name"]: row["opened"] for row in daemon.links.status()}["gcs"] == 1
        # what a reload does not apply is named
        other = fleet(vehicle={"role": "vehicle"}, gcs={"role": "gcs"}, new={"delay_s": 0.1})
        assert await daemon.reload(other) == ["the fleet file is as before: nothing changes"]
        other = other.model_copy(update={"daemon": other.daemon.model_copy(update={"sysid": 254})})
        assert await daemon.reload(other) == ["[daemon] differs: it is applied by a restart"]


async def test_a_reload_may_give_the_port_of_one_link_to_another(tmp_path: Path) -> None:
    port = free_port()
    async with running(tmp_path) as daemon:
        empty = daemon._file_config
        link = {"type": "udp_server", "host": "127.0.0.1", "port": port}
        one = FleetConfig.model_validate({"daemon": empty.daemon.model_dump(), "links": {"a": link}})
        two = FleetConfig.model_validate({"daemon": empty.daemon.model_dump(), "links": {"b": link}})
        assert await daemon.reload(one) == ["link a added"]
        await until(lambda: daemon.links.status()[0]["state"] == "up")
        assert sorted(await daemon.reload(two)) == ["link a removed", "link b added"]
        await until(lambda: daemon.links.status()[0]["state"] == "up")
        assert [row["name"] for row in daemon.links.status()] == ["b"]
