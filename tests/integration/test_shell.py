"""PX4's shell through the whole daemon, with simulated vehicles; pymavlink reads and writes the frames."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.models import SimulatedLinkConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.daemon import Daemon
from skygcs.errors import RpcError
from skygcs.ext.shell.extension import ShellConfig
from skygcs.ext.shell.shell_output import MAX_OUTPUT_BYTES
from skygcs.rpc.client import Client, connect
from skygcs.sim.px4_shell import VERSION, Px4Shell
from skygcs.sim.vehicle import SimVehicle
from support.daemons import listening, made_daemon, simulated_link, started
from support.hosts import until
from support.pymav import PymavPeer
from support.vehicles import parsed

SERIAL_CONTROL = 126


class Lab:
    """v1 and v2 are PX4s, v3 is an ArduCopter, all on one link."""

    def __init__(self, daemon: Daemon, gcs: Client, socket: Path) -> None:
        self.daemon = daemon
        self.gcs = gcs
        self.socket = socket
        self.heard: list[tuple[int, Frame]] = []
        """SERIAL_CONTROL that all of them hear, with its addressee."""
        listening(self.vehicles[0], lambda frame, _: self.heard.append((frame.payload[79], frame)), "SERIAL_CONTROL")

    @property
    def vehicles(self) -> list[SimVehicle]:
        link = simulated_link(self.daemon, "sim")
        return list(link.vehicles)

    def shell(self, sysid: int = 1) -> Px4Shell:
        shell = next(v for v in self.vehicles if v.sysid == sysid).shell
        assert shell is not None
        return shell

    def lines(self, sysid: int = 1) -> list[str]:
        return [line for line in self.shell(sysid).lines if line]

    async def open(self, vehicle: str = "v1", gcs: Client | None = None, *, force: bool = False) -> str:
        gcs = gcs or self.gcs
        session = str((await gcs.call("shell.open", vehicle=vehicle, force=force))["session"])
        await self.until_ready(session, gcs)
        return session

    async def write(self, session: str, text: str) -> dict[str, Any]:
        return dict(await self.gcs.call("shell.write", session=session, text=text))

    async def read(self, session: str, wait_s: float = 0.0) -> dict[str, Any]:
        return dict(await self.gcs.call("shell.read", session=session, wait_s=wait_s))

    async def until_ready(self, session: str, gcs: Client | None = None) -> str:
        text = ""
        for _ in range(2000):
            answer = await (gcs or self.gcs).call("shell.read", session=session, wait_s=5.0)
            text += answer["text"]
            assert answer["end"] is None, answer
            if answer["ready"]:
                return text
        raise AssertionError(text)

    async def status(self) -> dict[str, Any]:
        return dict(await self.gcs.call("shell.status"))

    def inject(self, peer: PymavPeer, message: Any) -> None:
        """A frame comes on the vehicles' channel."""
        channel = next(iter(self.daemon.hub.channels.values()))
        frame = parsed(peer.pack(message))
        self.daemon.hub.on_frames(channel, [frame], self.daemon.now())

    async def arm(self, sysid: int = 1) -> None:
        outcomes = await self.gcs.arm(f"v{sysid}", force=True)
        assert outcomes[f"v{sysid}"]["ok"], outcomes
        await until(lambda: self.daemon.fleet.vehicles[sysid << 8 | 1].vehicle.armed)

    async def disarm(self, sysid: int = 1) -> None:
        await self.gcs.disarm(f"v{sysid}", force=True)
        await until(lambda: not self.daemon.fleet.vehicles[sysid << 8 | 1].vehicle.armed)


@contextlib.asynccontextmanager
async def running(tmp_path: Path, **link: Any) -> AsyncIterator[Lab]:
    links = {"sim": SimulatedLinkConfig(name="sim", px4=2, ardupilot=1, dynamics="kinematic", **link)}
    made = made_daemon(tmp_path, {"shell": ShellConfig()}, daemon={"record": True}, links=links)
    async with started(made) as daemon:
        await until(lambda: len(daemon.fleet.vehicles) == 3)
        await asyncio.sleep(5.0)  # versions have come
        async with connect(tmp_path / "s") as gcs:
            yield Lab(daemon, gcs, tmp_path / "s")


def decoded(frame: Frame) -> Any:
    (message,) = PymavPeer(1, 1).mav.parse_buffer(bytes(frame.raw))
    return message


async def test_a_command_is_executed_and_its_output_comes(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        session = await lab.open()
        assert await lab.write(session, "ver all\n") == {"waiting_bytes": 8}
        text = await lab.until_ready(session)
        assert text == "ver all\n" + VERSION + "nsh> \x1b[K"
        assert lab.lines() == ["ver all"] and lab.lines(2) == []
        # what was sent, as pymavlink reads it; the addressee stands behind the fields that it knows
        assert {sysid for sysid, _ in lab.heard} == {1}
        messages = [decoded(frame) for _, frame in lab.heard]
        assert {(m.device, m.timeout, m.baudrate) for m in messages} == {(10, 0, 0)}
        flags = mav.SERIAL_CONTROL_FLAG_RESPOND | mav.SERIAL_CONTROL_FLAG_EXCLUSIVE | mav.SERIAL_CONTROL_FLAG_MULTI
        assert [(m.flags, m.count, bytes(m.data[: m.count])) for m in messages] == [
            (flags, 0, b""),
            (flags, 8, b"ver all\n"),
        ]
        assert {bytes(frame.payload[79:81]) for _, frame in lab.heard} == {bytes([1, 1])}
        assert await lab.gcs.call("shell.close", session=session) == {"closed": True}
        await until(lambda: not lab.shell().running)
        assert (decoded(lab.heard[-1][1]).flags, decoded(lab.heard[-1][1]).count) == (0, 0)
        texts = [e["text"] for e in await lab.gcs.call("events.recent") if e["kind"] == "shell"]
        assert texts == ["shell opened", "shell: ver all", "shell ended: closed"]


@pytest.mark.deep
async def test_nothing_is_sent_by_itself_and_the_table_must_be_there(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        session = await lab.open()
        count = len(lab.heard)
        await asyncio.sleep(60.0)
        assert len(lab.heard) == count
        await lab.gcs.call("shell.close", session=session)
        with pytest.raises(RpcError, match="no such session"):
            await lab.write(session, "ver all\n")


async def test_many_lines_are_executed_in_order_and_never_fill_the_pipe(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        session = await lab.open()
        lines = [f"echo {n} {'x' * (n * 7 % 100)}" for n in range(12)] + ["sleep 9", "sleep 4", "dmesg", "echo end"]
        await lab.write(session, "".join(f"{line}\n" for line in lines))
        text = await lab.until_ready(session)
        while "end\nnsh> " not in text:
            text += await lab.until_ready(session)
        assert lab.lines() == lines
        assert text.count("line 199 of the boot") == 1
        assert lab.shell().overfull == 0
        assert all(decoded(frame).count <= 70 for _, frame in lab.heard)


async def test_an_armed_vehicle_gets_nothing_unless_it_is_insisted_upon(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        # before
        await lab.arm()
        with pytest.raises(RpcError, match=r"v1 is armed: a shell is for disarmed vehicles; insist with force"):
            await lab.open()
        assert lab.heard == []
        await lab.disarm()
        # in the middle: what waits is dropped, and said
        session = await lab.open()
        await lab.write(session, "sleep 3\nver all\nparam set A 1\n")
        await asyncio.sleep(0.5)
        await lab.arm()
        count = len(lab.heard)
        answer = await lab.read(session, 5.0)
        while not answer["refused"]:
            answer = await lab.read(session, 5.0)
        assert answer["refused"].startswith("22 bytes were not sent: v1 is armed")
        with pytest.raises(RpcError, match="v1 is armed"):
            await lab.write(session, "reboot\n")
        # its end is not told to an armed vehicle; the next begin makes up for it
        await lab.gcs.call("shell.close", session=session)
        await asyncio.sleep(1.0)
        assert len(lab.heard) == count and lab.lines() == ["sleep 3"]
        await lab.disarm()
        session = await lab.open()
        assert [decoded(frame).flags for _, frame in lab.heard[count : count + 2]] == [0, 22]
        await lab.gcs.call("shell.close", session=session)
        # by force
        await lab.arm()
        session = await lab.open(force=True)
        await lab.write(session, "commander status\n")
        assert "Armed" in await lab.until_ready(session)


@pytest.mark.deep
async def test_a_line_that_arming_cuts_off_ends_the_session_and_is_never_executed(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        session = await lab.open()
        vehicle, part, vehicle_shell = lab.vehicles[0], lab.daemon.extensions["shell"], lab.shell()
        assert vehicle.sysid == 1
        part.write(session, "echo " + "a" * 110 + "\n")
        part.tick(lab.daemon.now())
        vehicle.armed = True
        vehicle.send_message("HEARTBEAT", 0.0)
        await until(lambda: part.status()["sessions"] == [])
        vehicle.armed = False
        await asyncio.sleep(3.0)
        session = await lab.open()
        await lab.write(session, "ver all\n")
        await lab.until_ready(session)
        assert [line for line in vehicle_shell.lines if line] == ["ver all"]


async def test_other_firmware_and_other_clients_are_refused(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        for force in (False, True):
            with pytest.raises(RpcError, match=r"v3: ArduPilot has no shell over MAVLink"):
                await lab.open("v3", force=force)
        with pytest.raises(RpcError, match="nobody"):
            await lab.open("nobody")
        session = await lab.open()
        async with connect(lab.socket) as other:
            with pytest.raises(RpcError, match=r"a client has had v1's shell for \d+ s: one at a time"):
                await lab.open(gcs=other)
            second = await lab.open("v2", other)
            assert second != session
            assert {s["vehicle"] for s in (await lab.status())["sessions"]} == {"v1", "v2"}
        await until(lambda: len(lab.daemon.extensions["shell"].status()["sessions"]) == 1)


@pytest.mark.deep
async def test_a_client_that_dies_leaves_no_session_and_no_shell(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        for reads in (False, True):
            other = connect(lab.socket)
            await other.open()
            session = await lab.open(gcs=other)
            waiting = None
            if reads:
                waiting = asyncio.ensure_future(other.call("shell.read", session=session, wait_s=60.0))
                await asyncio.sleep(0.1)
            await other.call("shell.write", session=session, text="sleep 5\nver all\n")
            await asyncio.sleep(0.3)
            await other.close()
            if waiting is not None:
                await asyncio.gather(waiting, return_exceptions=True)
            await until(lambda: (lab.daemon.extensions["shell"].status()["sessions"]) == [])
            await until(lambda: not lab.shell().running)
        assert "ver all" not in lab.lines()
        await lab.open()


async def test_a_flood_is_bounded_and_what_is_lost_is_counted(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        session = await lab.open()
        lab.shell().put_out(b"".join(b"%07d\n" % n for n in range(20_000)))
        await asyncio.sleep(60.0)
        answer = await lab.read(session)
        assert len(answer["text"]) == MAX_OUTPUT_BYTES
        assert answer["dropped_bytes"] == 160_000 - MAX_OUTPUT_BYTES
        assert answer["text"].endswith("0019999\n")
        (shown,) = (await lab.status())["sessions"]
        assert shown["dropped_bytes"] == answer["dropped_bytes"] and shown["received_bytes"] > 160_000
        assert (await lab.read(session))["dropped_bytes"] == 0


async def test_frames_of_others_and_bad_ones_get_nowhere(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        session = await lab.open()
        await lab.read(session)
        data = list(b"evil".ljust(70, b"\0"))
        v1, v2 = PymavPeer(1, 1), PymavPeer(2, 1)
        reply, shell = mav.SERIAL_CONTROL_FLAG_REPLY, mav.SERIAL_CONTROL_DEV_SHELL
        lab.inject(v2, mav.MAVLink_serial_control_message(shell, reply, 0, 0, 4, data))  # another vehicle
        lab.inject(PymavPeer(1, 2), mav.MAVLink_serial_control_message(shell, reply, 0, 0, 4, data))  # its neighbour
        lab.inject(v1, mav.MAVLink_serial_control_message(shell, 0, 0, 0, 4, data))  # no reply
        lab.inject(v1, mav.MAVLink_serial_control_message(0, reply, 0, 0, 4, data))  # a serial port
        assert (await lab.read(session))["text"] == ""
        status = await lab.status()
        assert (status["ignored_frames"], status["bad_frames"]) == (2, 0)
        for count in (71, 255):
            lab.inject(v1, mav.MAVLink_serial_control_message(shell, reply, 0, 0, count, data))
        assert (await lab.read(session))["text"] == ""
        assert (await lab.status())["bad_frames"] == 2
        lab.inject(v1, mav.MAVLink_serial_control_message(shell, reply, 0, 0, 4, list(b"good".ljust(70, b"\0"))))
        assert (await lab.read(session))["text"] == "good"


@pytest.mark.deep
async def test_a_vehicle_in_a_flight_of_ours_has_no_console_whoever_insists(tmp_path: Path) -> None:
    """A command of the console could change what the flight was checked with: parameters, modes, the estimator."""
    async with running(tmp_path) as lab:
        session = await lab.open()
        await lab.gcs.call("origin.from_vehicle", target="v1")
        await lab.gcs.call("vehicles.takeoff", targets="v1", height_m=5.0, arm=True)
        vehicle = lab.daemon.fleet.vehicles[1 << 8 | 1].vehicle
        await until(lambda: (vehicle.telemetry("position") or {"alt_rel_m": 0.0})["alt_rel_m"] > 4.5)
        outcomes = (await lab.gcs.call("control.set", targets="v1", mode="position"))["outcomes"]
        assert outcomes["v1"]["ok"], outcomes
        sent = len(lab.heard)
        with pytest.raises(RpcError, match="command of the console may change"):
            await lab.write(session, "param set MPC_XY_P 5\n")
        await lab.gcs.call("shell.close", session=session)
        for force in (False, True):
            with pytest.raises(RpcError, match=r"command of the console may change.*`skygcs-cli hold v1` first"):
                await lab.open(force=force)
        await asyncio.sleep(5.0)
        assert len(lab.heard) == sent and lab.lines() == []
        # nor has its neighbour, whose lines it would execute, too
        await lab.gcs.call("shell.close", session=await lab.open("v2", force=True))
        vehicle.firmware = "1.13.3"
        with pytest.raises(RpcError, match="command of the console may change"):
            await lab.open("v2", force=True)


@pytest.mark.deep
async def test_others_on_the_same_link_must_be_disarmed_and_look_at_the_addressee(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        await lab.arm(2)
        with pytest.raises(RpcError, match="v2 is armed and on the same link: a shell"):
            await lab.open("v1")
        await lab.disarm(2)
        vehicle = lab.daemon.fleet.vehicles[2 << 8 | 1].vehicle
        known = vehicle.firmware
        for version in ("1.13.3", None, "1.4.1"):
            vehicle.firmware = version
            with pytest.raises(RpcError, match=r"v2 \(PX4 .*\) may execute what is typed for v1, too"):
                await lab.open("v1")
        vehicle.firmware = known
        await lab.open("v1")
        assert lab.lines(2) == []


@pytest.mark.deep
async def test_a_shell_that_does_not_greet_gets_an_enter_whatever_modules_print(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        first = await lab.open()
        await lab.gcs.call("shell.close", session=first)
        lab.shell().greeting = b"INFO  [commander] Armed by external command\n"
        await asyncio.sleep(0.5)
        count = len(lab.heard)
        opened = await lab.gcs.call("shell.open", vehicle="v1", force=False)
        await lab.write(opened["session"], "ver all\n")
        text = await lab.until_ready(opened["session"])
        assert text.startswith("INFO") and VERSION in text
        sent = [decoded(frame) for _, frame in lab.heard[count:]]
        assert [bytes(m.data[: m.count]) for m in sent] == [b"", b"\n", b"ver all\n"]


async def test_bad_requests_are_named(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        session = await lab.open()
        for text, why in (
            ("", "text"),
            ("x" * 3000, "text"),
            ("x" * 121, "121 characters"),
            ("\x1b[2J\n", "printable ASCII"),
            ("caf\u00e9\n", "printable ASCII"),
        ):
            with pytest.raises(RpcError, match=why):
                await lab.write(session, text)
        for wait_s in (-1.0, 61.0):
            with pytest.raises(RpcError, match="wait_s"):
                await lab.read(session, wait_s)
        with pytest.raises(RpcError, match="no such session"):
            await lab.read("0" * 16)
        await lab.write(session, "sleep 1000\n")
        with pytest.raises(RpcError, match="2048 may"):
            for _ in range(30):
                await lab.write(session, "y" * 119 + "\n")
        assert (await lab.write(session, "\x03"))["waiting_bytes"] <= 1
