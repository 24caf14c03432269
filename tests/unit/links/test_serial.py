"""The serial link over ptys, and the stream channel under it."""

from __future__ import annotations

import asyncio
import fcntl
import os
import random
import termios
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import serial

from skygcs.config import models
from skygcs.core.radio_link.transmit_queue import BOUND, Priority
from skygcs.errors import LinkError
from skygcs.links.serial import SerialLink
from skygcs.links.stream import StreamChannel
from support.hosts import RecordingHost, frames_in, heartbeat, open_descriptors, own, text, until
from support.loops import on_every_loop
from support.pseudo_tty import PtyRadio
from support.table import each


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[PtyRadio]:
    radio = PtyRadio(tmp_path / "ttyRADIO")
    radio.plug_in()
    yield radio
    radio.pull_out()


@asynccontextmanager
async def opened(radio: PtyRadio, hub: RecordingHost, **keys: Any) -> AsyncIterator[SerialLink]:
    config = models.SerialLinkConfig(name="radio", device=str(radio.path), **keys)
    link = SerialLink(config, hub, asyncio.get_running_loop())
    await link.open()
    try:
        yield link
    finally:
        await link.close()


async def write_all(radio: PtyRadio, data: bytes) -> None:
    while data:
        data = data[radio.write(data) :]
        await asyncio.sleep(0)


@on_every_loop
async def test_frames_pass_both_ways_whole_and_in_order(radio: PtyRadio) -> None:
    host = RecordingHost()
    frames = [heartbeat(1 + n % 5, n % 256) for n in range(500)]
    async with opened(radio, host) as link:
        await write_all(radio, b"".join(frames))
        await until(lambda: len(host.heard) == 500)
        assert host.raws == frames
        channel = link.channels[0]
        got = b""
        for n in range(500):
            assert channel.send(frames[n])
            if n % 50 == 49:
                await asyncio.sleep(0)
                got += radio.read()
        await until(lambda: channel.tx_frames == 500)
        got += await radio.read_exactly(channel.tx_bytes - len(got))
        assert got == b"".join(frames)
        assert (channel.tx_dropped, channel.tx_bytes) == (0, len(b"".join(frames)))


@each("rescue", [True, False])
@on_every_loop
async def test_a_megabyte_of_noise_makes_no_frame_and_hides_none(
    radio: PtyRadio, rescue: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not rescue:
        monkeypatch.setattr("skygcs.links.stream.RESCUE_AFTER_S", 3600.0)
    host = RecordingHost()
    noise = random.Random(7).randbytes(1_000_000)
    good = [heartbeat(1 + n % 5, n) for n in range(200)]
    async with opened(radio, host) as link:
        await write_all(radio, noise)
        await until(lambda: link.channels[0].parser.stats.skipped_bytes > 999_000)
        await write_all(radio, b"".join(good))
        await until(lambda: len(host.heard) == len(good))
    assert host.raws == good


@on_every_loop
async def test_frames_behind_a_false_start_come_out_after_a_silence(radio: PtyRadio) -> None:
    host = RecordingHost()
    false_start = bytes((0xFD, 255, 0, 0, 0, 1, 1, 0, 0, 0))  # claims 257 more bytes
    async with opened(radio, host):
        await write_all(radio, false_start + heartbeat(1) + false_start + heartbeat(2))
        await until(lambda: len(host.heard) == 2)
        assert host.raws == [heartbeat(1), heartbeat(2)]
        slow = text(1, 1, "sent byte by byte, with long pauses")
        for at in range(0, len(slow), 20):
            await write_all(radio, slow[at : at + 20])
            await asyncio.sleep(0.15)
        await until(lambda: len(host.heard) == 3)
        assert host.raws[2] == slow


@on_every_loop
async def test_a_port_that_is_not_read_drops_by_policy_and_never_half_a_frame(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host) as link:
        channel = link.channels[0]
        assert isinstance(channel, StreamChannel)
        frames = [text(n % 250 + 1, n % 256, f"number {n} " + "x" * 36) for n in range(3000)]
        for frame in frames:
            assert channel.send(frame)
        assert len(channel.queue) == BOUND[Priority.FORWARDED]
        assert channel.tx_dropped == 3000 - channel.tx_frames - 1 - len(channel.queue)
        command = own("COMMAND_LONG", target_system=1, command=400)
        assert channel.send(command, Priority.COMMAND)
        got = b""
        while channel.queue or not got or channel.tx_frames + channel.tx_dropped < 3001:
            got += radio.read()
            await asyncio.sleep(0.001)
        got += await radio.read_exactly(channel.tx_bytes - len(got))
    received = frames_in(got)
    assert sum(len(frame.raw) for frame in received) == len(got), "only whole frames came"
    forwarded = [frame.raw for frame in received if frame.name == "STATUSTEXT"]
    first = next(n for n, raw in enumerate(forwarded) if raw != frames[n])
    assert forwarded[:first] == frames[:first]
    assert forwarded[first:] == frames[len(frames) - BOUND[Priority.FORWARDED] :], "the newest were kept"
    # the one frame that the kernel had taken in part goes first, then the command, then what is forwarded
    assert received[first].name == "COMMAND_LONG"


@on_every_loop
async def test_after_a_standstill_nothing_that_waited_in_a_blocked_port_is_sent(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host) as link:
        (channel,) = link.channels
        assert isinstance(channel, StreamChannel)
        for n in range(2000):
            channel.send(text(1, n % 256, f"of before {n}"))
        sent = channel.tx_frames
        assert sent < 1000 and channel.waiting(Priority.FORWARDED)
        host.reading.woke()
        assert channel.drop_waiting() > 0
        got = b""
        channel.send(text(1, 1, "of now"))
        while b"of now" not in got:
            got += radio.read()
            await asyncio.sleep(0.001)
        assert channel.tx_frames == sent + 1
        numbers = [int(f.fields()["text"].split()[-1]) for f in frames_in(got) if b"before" in f.raw]
        assert numbers == list(range(sent))


@on_every_loop
async def test_each_message_asks_once_for_a_standstill_and_an_empty_queue_never_does(radio: PtyRadio) -> None:
    host = RecordingHost()
    asked = list[int]()
    async with opened(radio, host) as link:
        (channel,) = link.channels
        host.reading.asleep = lambda: bool(asked.append(1))
        for n in range(10):
            assert channel.send(text(1, n, "one"))
        assert channel.tx_frames == len(asked) == 10


@on_every_loop
async def test_frames_that_waited_during_a_standstill_are_stale_even_behind_a_false_start(radio: PtyRadio) -> None:
    host = RecordingHost()
    seen = list[bool]()
    async with opened(radio, host) as link:
        (channel,) = link.channels
        host.on_frame = lambda _, __: seen.append(channel in host.reading.stale)
        assert not radio.write(
            waiting := heartbeat(1) + bytes((0xFD, 255, 0, 0, 0, 1, 1, 0, 0, 0)) + heartbeat(2)
        ) < len(waiting)
        host.reading.woke()
        assert channel in host.reading.stale
        await until(lambda: len(host.heard) == 2)
        assert seen == [True, True] and channel not in host.reading.stale
        await write_all(radio, heartbeat(3))
        await until(lambda: len(host.heard) == 3)
        assert seen == [True, True, False]


@on_every_loop
async def test_the_latest_of_a_key_is_sent_once_and_takes_one_sequence_number(radio: PtyRadio) -> None:
    host = RecordingHost()
    held = Outstanding(1000)
    async with opened(radio, host) as link:
        channel = shallow(link, held)
        for n in range(5):
            assert channel.send(own("HEARTBEAT", custom_mode=n), Priority.SETPOINT, key=7)
        held.bytes = 0
        await until(lambda: channel.tx_frames == 1)
        assert [(f.seq, f.fields()["custom_mode"]) for f in frames_in(await radio.read_exactly(channel.tx_bytes))] == [
            (0, 4)
        ]
        assert channel.tx_dropped == 0


class Outstanding:
    """How much the kernel would hold on a real port."""

    def __init__(self, size: int) -> None:
        self.bytes = size
        self.asked = 0

    def __call__(self) -> int:
        self.asked += 1
        return self.bytes


def shallow(link: SerialLink, held: Callable[[], int]) -> StreamChannel:
    channel = link.channels[0]
    assert isinstance(channel, StreamChannel)
    channel._outstanding = held
    return channel


@on_every_loop
async def test_the_kernel_buffer_is_kept_shallow_so_that_a_late_command_goes_first(radio: PtyRadio) -> None:
    host = RecordingHost()
    held = Outstanding(256)
    async with opened(radio, host, baud=57600) as link:
        channel = shallow(link, held)
        for n in range(20):
            assert channel.send(heartbeat(1, n))
        assert channel.send(own(), Priority.EMERGENCY)
        assert radio.read() == b""
        assert held.asked == 1, "one look, then a timer, whatever is offered meanwhile"
        held.bytes = 255
        await until(lambda: channel.tx_frames == 21)
        assert [frame.sysid for frame in frames_in(await radio.read_exactly(channel.tx_bytes))] == [255] + [1] * 20


@on_every_loop
async def test_a_fast_port_may_hold_more(radio: PtyRadio) -> None:
    async with opened(radio, RecordingHost(), baud=921600) as link:
        channel = shallow(link, Outstanding(1000))
        assert channel.send(heartbeat(1))
        assert channel.tx_frames == 1


@on_every_loop
async def test_a_hung_up_port_fails_with_a_reason(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host) as link:
        channel = link.channels[0]
        await write_all(radio, heartbeat(1))
        radio.pull_out()
        reason = await asyncio.wait_for(link.failed, 10)
        assert reason.startswith(f"serial {radio.path}: ") and "unplugged" in reason
        assert channel.send(heartbeat(1)) is False
        assert host.channels == [channel], "detached by close, not from within a callback"
    assert host.detached == [(channel, reason)]


@on_every_loop
async def test_a_terminal_hangup_while_data_waits_is_noticed(radio: PtyRadio) -> None:
    """What a USB unplug does to a port: EPOLLERR and EPOLLHUP at once."""
    if os.geteuid() != 0:
        pytest.skip("hanging up a terminal needs root")
    tiocvhangup = 0x5437
    async with opened(radio, RecordingHost()) as link:
        radio.write(heartbeat(1) * 100)
        other = os.open(radio.path, os.O_RDWR | os.O_NOCTTY)
        try:
            fcntl.ioctl(other, tiocvhangup)
        finally:
            os.close(other)
        assert "unplugged" in await asyncio.wait_for(link.failed, 10)


@on_every_loop
async def test_a_missing_device_says_so(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"serial .*ttyUSB9: no such device; plug it in"):
        async with opened(PtyRadio(tmp_path / "ttyUSB9"), RecordingHost()):
            pass


@on_every_loop
async def test_a_file_or_a_folder_is_not_a_serial_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for name in ("file", "."):
        before = open_descriptors()
        with pytest.raises(LinkError, match="not a serial port"):
            async with opened(PtyRadio(tmp_path / name), RecordingHost()):
                pass
        assert open_descriptors() == before


@on_every_loop
async def test_a_port_in_use_says_so(radio: PtyRadio) -> None:
    async with opened(radio, RecordingHost()):
        with pytest.raises(LinkError, match="in use by another program"):
            async with opened(radio, RecordingHost()):
                pass


@on_every_loop
async def test_permission_denied_names_the_group_to_join(radio: PtyRadio, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object, **__: object) -> None:
        raise serial.SerialException(13, "could not open port: [Errno 13] Permission denied")

    monkeypatch.setattr("skygcs.links.serial_port.serial.Serial", denied)
    os.chmod(radio.path, 0o660)
    expected = r"permission denied; add yourself to the group that owns it \(\w+\) and log in again"
    with pytest.raises(LinkError, match=expected):
        async with opened(radio, RecordingHost()):
            pass
    os.chmod(radio.path, 0o600)
    with pytest.raises(LinkError, match=f"its mode 0600 lets no group use it; .* sudo chmod 660 {radio.path}"):
        async with opened(radio, RecordingHost()):
            pass


@on_every_loop
async def test_the_port_is_raw_8n1_with_flow_control_on_request(radio: PtyRadio) -> None:
    for rtscts in (False, True):
        async with opened(radio, RecordingHost(), rtscts=rtscts, baud=115200):
            iflag, oflag, cflag, lflag, ispeed, ospeed, cc = termios.tcgetattr(radio.fd)
            assert bool(cflag & termios.CRTSCTS) is rtscts
            assert cflag & termios.CSIZE == termios.CS8
            assert not cflag & (termios.PARENB | termios.CSTOPB)
            assert not lflag & (termios.ICANON | termios.ECHO | termios.ISIG)
            assert not iflag & (termios.IXON | termios.ICRNL | termios.BRKINT)
            assert not oflag & termios.OPOST
            assert ispeed == ospeed == termios.B115200
            assert cc[termios.VMIN] == 1


@on_every_loop
async def test_baud_rates_are_tried_in_turn_until_a_good_frame_and_the_good_one_stays(
    radio: PtyRadio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skygcs.links.serial.TRY_BAUD_S", 0.05)
    speeds = {57600: termios.B57600, 115200: termios.B115200, 921600: termios.B921600}

    def speed() -> int:
        return int(termios.tcgetattr(radio.fd)[4])

    host = RecordingHost()
    config = models.SerialLinkConfig(name="radio", device=str(radio.path), baud=tuple(speeds))
    link = SerialLink(config, host, asyncio.get_running_loop())
    await link.open()
    seen = set()
    while len(seen) < 3:
        seen.add(link.baud)
        assert speed() == speeds[link.baud]
        radio.write(b"\xfd noise at the wrong rate")
        await asyncio.sleep(0.001)
    await until(lambda: link.baud == 115200)
    radio.write(heartbeat(1))
    await until(lambda: host.heard)
    stays = link.baud
    await asyncio.sleep(0.2)
    assert link.baud == stays
    await link.close()
    await link.open()
    assert link.baud == stays and speed() == speeds[stays], "the one that worked is tried first"
    await until(lambda: link.baud != stays)
    await link.close()


@on_every_loop
async def test_nothing_stays_open_after_close_and_close_is_idempotent(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host) as link:
        pass
    before = open_descriptors()
    await link.close()
    await link.open()
    await link.close()
    await link.close()
    assert open_descriptors() == before
    assert len(host.detached) == 2


@on_every_loop
async def test_what_the_host_refuses_to_attach_leaves_nothing_open(radio: PtyRadio) -> None:
    class Refusing(RecordingHost):
        def attach(self, channel: object) -> None:
            raise KeyError("no message 'NO_SUCH'")

    async with opened(radio, RecordingHost()):
        pass
    before = open_descriptors()
    with pytest.raises(KeyError):
        async with opened(radio, Refusing()):
            pass
    assert open_descriptors() == before
