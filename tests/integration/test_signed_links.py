"""Links with a signing key in the whole daemon: who is heard, who can command, where a key goes and where not."""

from __future__ import annotations

import asyncio
import contextlib
import json
import stat
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.models import MemoryLinkConfig, SimulatedLinkConfig
from skygcs.config.signing import SigningSettings
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.mavlink.signing import is_signed_with, key_id, timestamp_at, timestamp_of
from skygcs.daemon import Daemon
from skygcs.errors import KeyFileError, LinkError, RefusedError, RpcError
from skygcs.rpc.client import connect
from support.called import sender_of, signing_setup_of
from support.daemons import made_daemon, memory_link, started
from support.hosts import until
from support.pymav import PymavPeer

KEY = bytes(range(32))
OTHER = bytes(range(1, 33))
VEHICLE = 7 << 8 | 1


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "skygcs" / "signing"


def key_file(folder: Path, key: bytes = KEY, name: str = "key", mode: int = 0o600) -> Path:
    path = folder / name
    path.write_text(key.hex())
    path.chmod(mode)
    return path


def signing(folder: Path, **settings: Any) -> SigningSettings:
    return SigningSettings(key_file=key_file(folder), **settings)


@contextlib.asynccontextmanager
async def running(tmp_path: Path, *, record: bool = False, **links: Any) -> AsyncIterator[Daemon]:
    daemon = made_daemon(
        tmp_path,
        daemon={"record": record},
        links={
            name: MemoryLinkConfig(name=name, **link) if isinstance(link, dict) else link
            for name, link in links.items()
        },
    )
    async with started(daemon):
        await until(lambda: all(row["state"] == "up" for row in daemon.links.status()))
        yield daemon


def wire(daemon: Daemon, name: str = "radio") -> Any:
    return memory_link(daemon, name).peer


class SignedPeer(PymavPeer):
    """A vehicle made of pymavlink that signs, and takes nothing that is not signed with its key."""

    def __init__(self, wire: Any, key: bytes = KEY, sysid: int = 7, behind_s: float = 0) -> None:
        super().__init__(sysid, 1)
        self.wire = wire
        self.mav.signing.secret_key = key
        self.mav.signing.timestamp = timestamp_at(time.time() - behind_s)
        self.mav.signing.link_id = 2
        self.mav.signing.sign_outgoing = True
        wire.on_bytes = self.parse

    def beat(self) -> None:
        self.wire.send(self.heartbeat())

    def good(self) -> list[Any]:
        return [m for m in self.seen if m.get_type() != "BAD_DATA"]


def counts(daemon: Daemon, name: str = "radio") -> dict[str, Any]:
    row = next(row for row in daemon.signing.status(daemon.hub.channels.values())["links"] if row["link"] == name)
    return dict(row["channels"][0])


async def test_a_vehicle_that_signs_is_heard_and_takes_our_signed_orders(tmp_path: Path) -> None:
    async with running(tmp_path, radio={"signing": signing(tmp_path, link_id=4)}) as daemon:
        peer = SignedPeer(wire(daemon))
        peer.beat()
        await until(lambda: VEHICLE in daemon.fleet.vehicles)
        sender_of(daemon).send("PARAM_REQUEST_READ", {"param_id": "SYSID_THISMAV"}, "7")
        await until(lambda: any(m.get_type() == "PARAM_REQUEST_READ" for m in peer.good()))
        assert all(m.get_signed() and m.get_link_id() == 4 for m in peer.good())
        assert peer.mav.signing.badsig_count == 0
        assert counts(daemon)["signed"] == 1
        assert counts(daemon)["sent_signed"] == len(peer.good())


async def test_a_vehicle_without_a_clock_is_heard_once_it_has_heard_us(tmp_path: Path) -> None:
    """Indoors, without GPS: its time is of last month, and it takes ours from our heartbeat."""
    async with running(tmp_path, radio={"signing": signing(tmp_path)}) as daemon:
        peer = SignedPeer(wire(daemon), behind_s=30 * 86400.0)
        peer.beat()
        await until(lambda: counts(daemon)["stale"] == 1)
        await until(lambda: peer.good())
        peer.beat()
        await until(lambda: VEHICLE in daemon.fleet.vehicles)


async def test_unsigned_and_badly_signed_frames_are_dropped_counted_and_told_once(tmp_path: Path) -> None:
    async with running(tmp_path, radio={"signing": signing(tmp_path)}, gcs={"role": "gcs"}) as daemon:
        stranger, forger = PymavPeer(8, 1), SignedPeer(wire(daemon), OTHER, 9)
        for _ in range(3):
            wire(daemon).send(stranger.heartbeat())
            forger.beat()
        wire(daemon).send(PymavPeer(8, 1).heartbeat(version=1))
        await until(lambda: counts(daemon)["unsigned"] == 4 and counts(daemon)["bad_signature"] == 3)
        assert daemon.fleet.vehicles == {}
        assert not any(raw[5] in (8, 9) for raw in wire(daemon, "gcs").received)
        told = [e for e in daemon.event_log.recent if e["kind"] == "signing"]
        assert [e["sysid"] for e in told] == [8, 9]
        assert "not signed" in told[0]["text"] and "another key" in told[1]["text"]
        assert daemon.links.status()[0]["channels"][0]["signing"]["unsigned"] == 4
        assert daemon.links.status()[0]["channels"][0]["sources"] == {}


async def test_a_recorded_frame_is_not_taken_twice_nor_on_another_link_of_the_key(tmp_path: Path) -> None:
    links = {"radio": {"signing": signing(tmp_path)}, "spare": {"signing": signing(tmp_path, link_id=1)}}
    async with running(tmp_path, **links) as daemon:
        peer = SignedPeer(wire(daemon))
        first = peer.heartbeat()
        wire(daemon).send(first)
        await until(lambda: counts(daemon)["signed"] == 1)
        wire(daemon).send(first)
        wire(daemon, "spare").send(first)
        await until(lambda: counts(daemon)["replayed"] == 1 and counts(daemon, "spare")["replayed"] == 1)


async def test_links_of_one_group_may_carry_copies(tmp_path: Path) -> None:
    links = {
        name: {"signing": signing(tmp_path, link_id=n), "group": "pair"} for n, name in enumerate(("radio", "spare"))
    }
    async with running(tmp_path, **links) as daemon:
        first = SignedPeer(wire(daemon)).heartbeat()
        wire(daemon).send(first)
        wire(daemon, "spare").send(first)
        await until(lambda: counts(daemon)["signed"] == 1 and counts(daemon, "spare")["signed"] == 1)
        wire(daemon, "spare").send(first)
        await until(lambda: counts(daemon, "spare")["replayed"] == 1)


async def test_a_radio_needs_no_key_and_all_may_come_unsigned_where_it_is_said(tmp_path: Path) -> None:
    status = mav.MAVLink_radio_status_message(190, 180, 100, 40, 40, 0, 0)
    links = {"radio": {"signing": signing(tmp_path)}, "all": {"signing": signing(tmp_path, link_id=1)}}
    links["all"]["signing"] = signing(tmp_path, link_id=1, accept_unsigned=("*",))
    links["none"] = {"signing": signing(tmp_path, link_id=2, accept_unsigned=())}
    async with running(tmp_path, **links) as daemon:
        for name in links:
            wire(daemon, name).send(PymavPeer(51, 68).pack(status))
            wire(daemon, name).send(PymavPeer(7, 1).heartbeat())
        await until(lambda: all(sum(v for v in counts(daemon, n).values() if type(v) is int) >= 2 for n in links))
        assert [counts(daemon, name)["unsigned_allowed"] for name in links] == [1, 2, 0]


async def test_our_time_is_kept_and_never_goes_back(
    tmp_path: Path, state_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wall clock is a year behind at the second start, as on a board without a battery."""
    radio = {"signing": signing(tmp_path)}
    async with running(tmp_path, radio=radio) as daemon:
        await until(lambda: counts(daemon)["sent_signed"] > 0 and bool(wire(daemon).received))
        last = max(timestamp_of(raw) for raw in wire(daemon).received)
    kept = json.loads((state_home / f"{key_id(KEY)}.json").read_text())
    assert kept["exact"] and kept["timestamp"] >= last
    assert KEY.hex() not in (state_home / f"{key_id(KEY)}.json").read_text()
    monkeypatch.setattr("skygcs.runtime.signing_keys.timestamp_at", lambda unix_s: last - 365 * 86400 * 100_000)
    async with running(tmp_path, radio=radio) as daemon:
        await until(lambda: counts(daemon)["sent_signed"] > 0 and bool(wire(daemon).received))
        assert min(timestamp_of(raw) for raw in wire(daemon).received) > last


async def test_only_who_signs_with_the_key_becomes_a_peer_where_it_is_required(tmp_path: Path) -> None:
    links = {
        "plain": {},
        "keyed": {"signing": signing(tmp_path)},
        "asked": {"signing": signing(tmp_path, link_id=1, accept_unsigned=("*",))},
    }
    async with running(tmp_path, **links) as daemon:
        parser = FrameParser(daemon.dialect)
        (unsigned,) = parser.feed_datagram(PymavPeer(7, 1).heartbeat())
        (forged,) = parser.feed_datagram(SignedPeer(wire(daemon, "keyed"), OTHER).heartbeat())
        (right,) = parser.feed_datagram(SignedPeer(wire(daemon, "keyed")).heartbeat())
        for name, wanted in (("plain", (True,) * 4), ("keyed", (False, False, True, True)), ("asked", (True,) * 4)):
            config = daemon.links.configs[name]
            judged = [daemon.hub.vouches_for(config, f) for f in ([unsigned], [forged], [right], [unsigned, right])]
            assert tuple(judged) == wanted, name
        wire(daemon, "keyed").send(right.raw)
        await until(lambda: counts(daemon, "keyed")["signed"] == 1)  # to be asked moved no stream on


# -- times of the future


YEAR_2104 = (1 << 48) - 2


def stamped(peer: SignedPeer, timestamp: int) -> bytes:
    peer.mav.signing.timestamp = timestamp
    return peer.heartbeat()


async def test_a_frame_of_the_year_2104_is_dropped_told_and_pins_nothing(tmp_path: Path, state_home: Path) -> None:
    async with running(tmp_path, radio={"signing": signing(tmp_path)}) as daemon:
        peer = SignedPeer(wire(daemon))
        wire(daemon).send(stamped(peer, YEAR_2104))
        wire(daemon).send(stamped(peer, YEAR_2104))
        await until(lambda: counts(daemon)["ahead"] == 2)
        assert daemon.fleet.vehicles == {}
        (told,) = [e for e in daemon.event_log.recent if e["kind"] == "signing"]
        assert (
            "7/1" in told["text"] and "radio" in told["text"] and "days ahead of this computer's clock" in told["text"]
        )
        assert told["data"]["verdict"] == "ahead"
        (key,) = daemon.signing.status(daemon.hub.channels.values())["keys"]
        assert key["ahead_s"] < 60 and not key["pinned"]
        peer = SignedPeer(wire(daemon))
        peer.beat()
        await until(lambda: VEHICLE in daemon.fleet.vehicles)
    kept = json.loads((state_home / f"{key_id(KEY)}.json").read_text())
    assert kept["timestamp"] < timestamp_at(time.time() + 86400)
    assert kept["wall"] <= timestamp_at(time.time() + 1)


async def test_max_ahead_s_allows_for_more(tmp_path: Path) -> None:
    links = {"radio": {"signing": signing(tmp_path, max_ahead_s=90 * 86400)}}
    async with running(tmp_path, **links) as daemon:
        peer = SignedPeer(wire(daemon), behind_s=-60 * 86400)
        peer.beat()
        await until(lambda: VEHICLE in daemon.fleet.vehicles)
        wire(daemon).send(stamped(peer, YEAR_2104))
        await until(lambda: counts(daemon)["ahead"] == 1)


def pin(state_home: Path) -> Path:
    """What a frame of the year 2104 left on disk before there was a limit."""
    state_home.mkdir(parents=True)
    path = state_home / f"{key_id(KEY)}.json"
    path.write_text(json.dumps({"format": 1, "timestamp": YEAR_2104, "exact": True}))
    return path


async def test_a_clock_that_was_pinned_before_is_told_and_mended(tmp_path: Path, state_home: Path) -> None:
    path = pin(state_home)
    radio = {"signing": signing(tmp_path)}
    async with running(tmp_path, radio=radio) as daemon, connect(tmp_path / "s") as gcs:
        (told,) = [e for e in daemon.event_log.recent if e["kind"] == "warning"]
        assert f"skygcs-cli signing reset-clock {key_id(KEY)}" in told["text"]
        assert (await gcs.call("signing.status"))["keys"][0]["pinned"]
        peer = SignedPeer(wire(daemon))
        peer.beat()
        await until(lambda: counts(daemon)["stale"] == 1)
        answer = await gcs.call("signing.reset_clock", key_id=key_id(KEY))
        assert "days ahead" in answer["message"]
        key = (await gcs.call("signing.status"))["keys"][0]
        assert not key["pinned"] and abs(key["ahead_s"]) < 60
        await until(lambda: json.loads(path.read_text())["timestamp"] < timestamp_at(time.time() + 60))
        peer = SignedPeer(wire(daemon))
        peer.beat()
        await until(lambda: VEHICLE in daemon.fleet.vehicles)
        sender_of(daemon).send("PARAM_REQUEST_READ", {"param_id": "SYSID_THISMAV"}, "7")
        await until(lambda: any(m.get_type() == "PARAM_REQUEST_READ" for m in peer.good()))
    async with running(tmp_path, radio=radio) as daemon:
        assert not [e for e in daemon.event_log.recent if e["kind"] == "warning"]
        assert not daemon.signing.status(daemon.hub.channels.values())["keys"][0]["pinned"]


async def test_a_clock_is_not_set_back_while_a_vehicle_is_armed_nor_one_that_nobody_uses(
    tmp_path: Path, state_home: Path
) -> None:
    pin(state_home)
    async with (
        running(tmp_path, radio={"signing": signing(tmp_path)}, other={}) as daemon,
        connect(tmp_path / "s") as gcs,
    ):
        wire(daemon, "other").send(PymavPeer(9, 1).heartbeat(armed=True))
        await until(lambda: 9 << 8 | 1 in daemon.fleet.vehicles)
        with pytest.raises(RpcError, match="v9 armed"):
            await gcs.call("signing.reset_clock", key_id=key_id(KEY))
        with pytest.raises(RpcError, match=f"no key 'cafe' is in use; in use: {key_id(KEY)}"):
            await gcs.call("signing.reset_clock", key_id="cafe", force=True)
        assert "message" in await gcs.call("signing.reset_clock", key_id=key_id(KEY), force=True)


async def test_a_vehicle_is_given_no_time_of_the_future(tmp_path: Path, state_home: Path) -> None:
    pin(state_home)
    async with running(tmp_path, sim=simulated(ardupilot=1)) as daemon:
        await discovered(daemon, 1)
        outcome = (await signing_setup_of(daemon).setup("1", key_file(tmp_path)))["v1"]
        assert outcome.result == "refused" and "reset-clock" in outcome.message
        daemon.signing.reset_clock(key_id(KEY))
        assert (await signing_setup_of(daemon).setup("1", key_file(tmp_path)))["v1"].ok


# -- giving vehicles their key


def simulated(**settings: Any) -> SimulatedLinkConfig:
    return SimulatedLinkConfig(name="sim", dynamics="kinematic", **settings)


async def discovered(daemon: Daemon, count: int) -> None:
    await until(lambda: len(daemon.fleet.vehicles) == count)


async def test_a_vehicle_gets_a_key_and_signs(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    async with (
        running(tmp_path, record=True, sim=simulated(ardupilot=1), gcs={"role": "gcs"}) as daemon,
        connect(tmp_path / "s") as gcs,
    ):
        await discovered(daemon, 1)
        seen: list[str] = []
        daemon.hub.observers.add(None, None, lambda frame, channel, now: seen.append(frame.name))
        came = {
            vehicle: outcome
            async for vehicle, outcome in gcs.outcomes("signing.setup", targets="1", key_file=str(path))
        }
        answer = {"outcomes": came}  # as they come, as for every order
        assert answer["outcomes"]["v1"]["ok"], answer
        assert key_id(KEY) in answer["outcomes"]["v1"]["message"]
        assert "give the link the key" in answer["outcomes"]["v1"]["message"]
        frames = wire(daemon, "gcs").received
        at = len(frames)
        await until(lambda: len(frames) > at + 5)
        signed = [raw for raw in frames[at:] if raw[5] == 1]
        assert signed and all(is_signed_with(raw, KEY) for raw in signed)
        # unsigned orders do nothing any more, nor does an unsigned off: the link has no key
        off = await gcs.call("signing.off", targets="1")
        assert off["outcomes"]["v1"]["result"] == "timeout"
        assert "only over a link that signs" in off["outcomes"]["v1"]["message"]
        events = json.dumps(list(daemon.event_log.recent))
        assert "SETUP_SIGNING" not in seen
    logs = b"".join(p.read_bytes() for p in (tmp_path / "logs").iterdir())
    assert len(logs) > 1000 and KEY not in logs and KEY.hex() not in events
    assert not any(KEY in raw for raw in frames)


async def test_unsigned_orders_to_a_vehicle_that_signs_say_so(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    why = "; it signs its messages and drops those that are not signed with its key, and link sim signs none"
    async with running(tmp_path, sim=simulated(ardupilot=1)) as daemon, connect(tmp_path / "s") as gcs:
        await discovered(daemon, 1)
        before = await gcs.call("params.get", targets="1", names=["NO_SUCH"])
        assert why not in before["outcomes"]["v1"]["NO_SUCH"]["message"]
        assert (await signing_setup_of(daemon).setup("1", path))["v1"].ok
        await until(lambda: why in daemon.fleet.vehicles[1 << 8 | 1].commands.why_silent())
        arm = (await gcs.call("vehicles.arm", targets="1"))["outcomes"]["v1"]
        param = (await gcs.call("params.get", targets="1", names=["RTL_ALT"]))["outcomes"]["v1"]["RTL_ALT"]
        plan = (await gcs.call("missions.download", target="1"))["outcome"]
        for outcome in (arm, param, plan):
            assert outcome["result"] == "timeout" and why in outcome["message"], outcome


async def test_a_vehicle_that_signs_over_a_link_with_its_key_is_only_silent(tmp_path: Path) -> None:
    key = SigningSettings(key_file=key_file(tmp_path))
    async with running(tmp_path, radio={"signing": key}, other={}) as daemon:
        SignedPeer(wire(daemon)).beat()
        await until(lambda: VEHICLE in daemon.fleet.vehicles)
        assert daemon.fleet.vehicles[7 << 8 | 1].commands.why_silent() == ""
        wire(daemon, "other").send(PymavPeer(8, 1).heartbeat())
        await discovered(daemon, 2)
        assert daemon.fleet.vehicles[8 << 8 | 1].commands.why_silent() == "", "it does not sign"


async def test_a_key_in_use_is_changed_and_forgotten_over_the_link_that_has_it(tmp_path: Path) -> None:
    path, other = key_file(tmp_path), key_file(tmp_path, OTHER, "other")
    both = SigningSettings(key_file=path, accept_unsigned=("*",))
    async with running(tmp_path, sim=simulated(ardupilot=1, signing=both)) as daemon:
        await discovered(daemon, 1)
        for _ in range(2):
            assert (await signing_setup_of(daemon).setup("1", path))["v1"].ok
            off = await signing_setup_of(daemon).off("1")
            assert off["v1"].ok and off["v1"].message == "it no longer signs"
        assert (await signing_setup_of(daemon).setup("1", path))["v1"].ok
        told = await signing_setup_of(daemon).setup("1", other)
        assert told["v1"].ok and "drops the vehicle's frames" in told["v1"].message
        assert counts(daemon, "sim")["bad_signature"] > 0


async def test_a_firmware_that_cannot_sign_is_told(tmp_path: Path) -> None:
    async with running(tmp_path, sim=simulated(px4=1)) as daemon:
        await discovered(daemon, 1)
        told = await signing_setup_of(daemon).setup("1", key_file(tmp_path))
        assert (told["v1"].ok, told["v1"].result, told["v1"].attempts) == (False, "timeout", 3)
        assert "not every firmware" in told["v1"].message


async def test_no_key_while_armed_or_where_others_hear(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    async with running(tmp_path, sim=simulated(ardupilot=2), radio={"role": "radio"}, bench={}) as daemon:
        vehicle, on_radio = PymavPeer(7, 1), PymavPeer(8, 1)
        wire(daemon, "bench").send(vehicle.heartbeat(armed=True))
        wire(daemon).send(on_radio.heartbeat())
        await discovered(daemon, 4)
        told = await signing_setup_of(daemon).setup("all", path)
        assert {name: outcome.result for name, outcome in told.items()} == dict.fromkeys(
            ("v1", "v2", "v7", "v8"), "refused"
        )
        assert "v2 on the same link" in told["v1"].message
        assert "armed" in told["v7"].message
        assert "radio: a radio, received by everyone in range" in told["v8"].message
        assert (await signing_setup_of(daemon).setup("1,2", path, force=True))["v2"].ok
        assert not any(raw[7] | raw[8] << 8 == 256 for raw in wire(daemon).received + wire(daemon, "bench").received)


async def test_a_vehicle_that_is_armed_meanwhile_is_sent_no_more(tmp_path: Path) -> None:
    async with running(tmp_path, bench={}) as daemon:
        vehicle = PymavPeer(7, 1)
        wire(daemon, "bench").send(vehicle.heartbeat())
        await discovered(daemon, 1)
        setup = asyncio.create_task(signing_setup_of(daemon).setup("7", key_file(tmp_path)))
        await asyncio.sleep(0.1)
        wire(daemon, "bench").send(vehicle.heartbeat(armed=True))
        told = await setup
        assert (told["v7"].result, told["v7"].attempts) == ("refused", 1)
        assert sum(KEY in raw for raw in wire(daemon, "bench").received) == 1


async def test_a_key_from_elsewhere_is_not_forwarded_recorded_or_shown(tmp_path: Path) -> None:
    async with running(tmp_path, record=True, radio={}, gcs={"role": "gcs"}) as daemon:
        wire(daemon).send(PymavPeer(7, 1).heartbeat())
        await discovered(daemon, 1)
        seen: list[str] = []
        daemon.hub.observers.add(None, None, lambda frame, channel, now: seen.append(frame.name))
        other = PymavPeer(254, 190)
        for target in (7, 0):
            message = mav.MAVLink_setup_signing_message(target, target and 1, list(OTHER), 1)
            wire(daemon, "gcs").send(other.pack(message))
        wire(daemon, "gcs").send(other.heartbeat(vehicle=False))
        await until(lambda: any(raw[5] == 254 for raw in wire(daemon).received))
        assert seen == ["HEARTBEAT"]
        assert not any(OTHER in raw for raw in wire(daemon).received)
        assert [e["text"] for e in daemon.event_log.recent if e["kind"] == "signing"] == [
            "gcs (memory): system 254 sent a signing key (SETUP_SIGNING); keys are not forwarded: connect directly, "
            "or use skygcs-cli signing setup"
        ]
        with pytest.raises(RefusedError, match="signing setup"):
            sender_of(daemon).send("SETUP_SIGNING", {"secret_key": list(OTHER)}, "7")
    assert OTHER not in b"".join(p.read_bytes() for p in (tmp_path / "logs").iterdir())


# -- key files that may not be used


async def test_a_daemon_with_a_key_others_can_read_does_not_start(tmp_path: Path) -> None:
    settings = SigningSettings(key_file=key_file(tmp_path, mode=0o640))
    with pytest.raises(KeyFileError, match=r"mode 0640\); run: chmod 600 .*links\.radio\.signing"):
        async with running(tmp_path, radio={"signing": settings}):
            pass


async def test_a_bad_key_at_run_time_changes_nothing(tmp_path: Path) -> None:
    good = signing(tmp_path)
    async with running(tmp_path, radio={"signing": good}) as daemon:
        bad = key_file(tmp_path, OTHER, "bad", mode=0o604)
        with pytest.raises(KeyFileError, match="0604"):
            await daemon.links.change("radio", {"signing": {"key_file": str(bad)}})
        with pytest.raises(LinkError, match="link_id"):
            await daemon.links.add("two", {"type": "memory", "signing": {"key_file": str(good.key_file)}})
        copy = key_file(tmp_path, KEY, "copy")
        with pytest.raises(KeyFileError, match=r"is the key of links\.radio as well"):
            await daemon.links.add("two", {"type": "memory", "signing": {"key_file": str(copy)}})
        assert stat.S_IMODE(copy.stat().st_mode) == 0o600
        peer = SignedPeer(wire(daemon))
        peer.beat()
        await until(lambda: counts(daemon)["signed"] == 1)
