"""CPU of one frame from a serial port (pty) to a UDP ground station, against a bare uvloop echo of the same datagram.

Run by `make bench`. Everything is interleaved in one run and compared as ratios: these machines are noisy.
Results also in build/bench/forward.json.
"""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import encode

ROOT = Path(__file__).parents[2]
FRAMES = 60_000
ROUNDS = 5
RATIO_LIMIT = 3.0

ECHO = """
import asyncio, sys, uvloop
class Echo(asyncio.DatagramProtocol):
    def connection_made(self, transport):
        self.transport = transport
        print(transport.get_extra_info("sockname")[1], flush=True)
    def datagram_received(self, data, addr):
        self.transport.sendto(data, ("127.0.0.1", int(sys.argv[1])))
async def main():
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(Echo, local_addr=("127.0.0.1", 0))
    await asyncio.Event().wait()
uvloop.install()
asyncio.run(main())
"""


def cpu_s(pid: int) -> float:
    """CPU time of a process so far, all threads, to the nanosecond (schedstat)."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        total += int((task / "schedstat").read_text().split()[0])
    return total / 1e9


class Sink:
    """A ground station that only counts."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.2)
        self.port = self.socket.getsockname()[1]
        self.count = 0
        self.running = True
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        while self.running:
            try:
                self.socket.recv(2048)
                self.count += 1
            except TimeoutError:
                continue

    def close(self) -> None:
        self.running = False
        self.thread.join()
        self.socket.close()


def frames() -> list[bytes]:
    """The mix of the router study: mean 40 bytes, twenty vehicles."""
    dialect = load_dialect(("ardupilotmega", "px4-extras"))
    beat = {"type": 2, "autopilot": 3, "mavlink_version": 3, "custom_mode": 4}
    kinds = [("HEARTBEAT", beat)]
    kinds += [("ATTITUDE", {"time_boot_ms": 123456, "roll": 0.1, "yaw": 1.0, "yawspeed": 0.01})] * 8
    kinds += [("GLOBAL_POSITION_INT", {"lat": 437806000, "lon": -794653000, "alt": 180000, "hdg": 9000})] * 6
    kinds += [("SYS_STATUS", {"voltage_battery": 12000, "battery_remaining": 77})] * 2
    kinds += [("GPS_RAW_INT", {"time_usec": 1 << 40, "lat": 437806000, "fix_type": 3, "satellites_visible": 12})] * 3
    made = []
    seqs = [0] * 21
    for n in range(FRAMES):
        sysid = n % 20 + 1
        name, values = kinds[(n // 20) % len(kinds)]
        made.append(encode(dialect.find(name), values, sysid=sysid, compid=1, seq=seqs[sysid]))
        seqs[sysid] = (seqs[sysid] + 1) & 0xFF
    return made


def feed_pty(master: int, data: list[bytes], rate: float | None) -> None:
    """Write frames to the pty; as fast as it takes them if no rate is given."""
    start = time.monotonic()
    pending = b""
    at = 0
    while at < len(data) or pending:
        if not pending:
            if rate is not None:
                due = min(len(data), int((time.monotonic() - start) * rate))
                if due <= at:
                    time.sleep(0.0005)
                    continue
            else:
                due = min(len(data), at + 40)
            pending = b"".join(data[at:due])
            at = due
        select.select([], [master], [], 1.0)
        pending = pending[os.write(master, pending) :]


def feed_udp(port: int, data: list[bytes], rate: float) -> None:
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(("127.0.0.1", port))
    start = time.monotonic()
    at = 0
    while at < len(data):
        due = min(len(data), int((time.monotonic() - start) * rate))
        for frame in data[at:due]:
            out.send(frame)
        at = due
        time.sleep(0.0005)
    out.close()


def measured(pid: int, sink: Sink, feed: object, count: int) -> tuple[float, int]:
    """(CPU µs per delivered frame, delivered frames)."""
    before, got = cpu_s(pid), sink.count
    feed()  # type: ignore[operator]
    deadline = time.monotonic() + 3.0
    while sink.count - got < count and time.monotonic() < deadline:
        time.sleep(0.02)
    delivered = sink.count - got
    return (cpu_s(pid) - before) / max(delivered, 1) * 1e6, delivered


@pytest.mark.parametrize("record", [True, False], ids=["recording", "not-recording"])
def test_serial_to_udp_cost(tmp_path: Path, record: bool) -> None:
    data = frames()
    sink, echo_sink = Sink(), Sink()
    master, slave = pty.openpty()
    tty.setraw(slave)
    (tmp_path / "fleet.toml").write_text(
        f"""
[daemon]
socket = "{tmp_path}/s"
record = {str(record).lower()}
heartbeat = false
[links.radio]
type = "serial"
device = "{os.ttyname(slave)}"
role = "radio"
[links.gcs]
type = "udp_client"
host = "127.0.0.1"
port = {sink.port}
role = "gcs"
"""
    )
    daemon = subprocess.Popen([sys.executable, "-m", "skygcs", "run", "-q", str(tmp_path / "fleet.toml")], cwd=ROOT)
    echo = subprocess.Popen([sys.executable, "-c", ECHO, str(echo_sink.port)], stdout=subprocess.PIPE, text=True)
    assert echo.stdout is not None
    echo_port = int(echo.stdout.readline())
    rows: dict[str, list[float]] = {}
    lost: dict[str, int] = {}
    try:
        deadline = time.monotonic() + 10
        while not (tmp_path / "s").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.5)
        for _ in range(ROUNDS):
            runs = {
                "skygcs flood": (daemon.pid, sink, lambda: feed_pty(master, data, None), len(data)),
                "skygcs 10000/s": (daemon.pid, sink, lambda: feed_pty(master, data[:20000], 10_000), 20000),
                "skygcs 1000/s": (daemon.pid, sink, lambda: feed_pty(master, data[:2000], 1_000), 2000),
                "echo 60000/s": (echo.pid, echo_sink, lambda: feed_udp(echo_port, data, 60_000), len(data)),
                "echo 10000/s": (echo.pid, echo_sink, lambda: feed_udp(echo_port, data[:20000], 10_000), 20000),
                "echo 1000/s": (echo.pid, echo_sink, lambda: feed_udp(echo_port, data[:2000], 1_000), 2000),
            }
            for name, (pid, where, feed, count) in runs.items():
                cost, delivered = measured(pid, where, feed, count)
                rows.setdefault(name, []).append(cost)
                lost[name] = lost.get(name, 0) + count - delivered
    finally:
        for process in (daemon, echo):
            process.send_signal(signal.SIGTERM)
            process.wait(10)
        if echo.stdout is not None:
            echo.stdout.close()
        os.close(master)
        os.close(slave)
        sink.close()
        echo_sink.close()
    table = {
        name: {
            "us_per_frame": round(statistics.median(v), 2),
            "min": round(min(v), 2),
            "max": round(max(v), 2),
            "lost": lost[name],
        }
        for name, v in rows.items()
    }
    ratios = {
        rate: round(table[f"skygcs {rate}"]["us_per_frame"] / table[f"echo {rate}"]["us_per_frame"], 2)
        for rate in ("10000/s", "1000/s")
    }
    ratios["saturated"] = round(table["skygcs flood"]["us_per_frame"] / table["echo 60000/s"]["us_per_frame"], 2)
    out = ROOT / "build" / "bench"
    out.mkdir(parents=True, exist_ok=True)
    name = "forward.json" if record else "forward-not-recording.json"
    (out / name).write_text(json.dumps({"recording": record, "table": table, "ratios": ratios}, indent=2))
    print(f"\nrecording={record}")
    for key, row in table.items():
        print(f"  {key:16} {row['us_per_frame']:8.2f} us  ({row['min']}..{row['max']})  lost {row['lost']}")
    print(f"  ratio to the echo: {ratios}")
    assert lost["skygcs flood"] == 0, "nothing may be lost between serial and UDP"
    assert ratios["saturated"] <= RATIO_LIMIT
