"""`make soak`: one daemon, an hour of mixed traffic. Does it hang, grow, misdeliver or lose anything?

    make soak                                  # an hour, 20 vehicles, 2,000 frames/s
    make soak SOAK_MINUTES=3 SOAK_RATE=500

A real process with fleet state and recording on, between 20 vehicles with companions on three UDP links (roles peer,
radio and vehicle), two ground stations (one that takes several frames in a datagram, one that does not), and a hostile
peer; a client of its socket follows all vehicles at 2 Hz and all events. Datagrams hold 1 to 60 frames, one in twenty
is junk. Every frame is known byte for byte, with who must get it and who may (`bench.soak_traffic`).

It runs in legs of ten seconds. At the end of each all that is under way has come, and what has not is lost: explained
if the kernel had no room for a datagram (/proc/net/udp), or the daemon counted one that a socket did not take or a
frame that it took for a copy in that leg, else a fault. A watchdog asks the daemon something every few seconds. Growth
is the slope of a line through its resident memory after the warm-up. All in build/bench/soak.json, and as a table.
Exit code 1 if anything was missed; SOAK_SEED repeats a run.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.results import keep
from bench.soak_traffic import OWN, HostilePeer, UdpSocket, World, udp_sockets, wait_until
from support import router_bench as bench
from support.process import free_port

MINUTES = float(os.environ.get("SOAK_MINUTES", "60"))
VEHICLES = int(os.environ.get("SOAK_VEHICLES", "20"))
RATE_PER_S = int(os.environ.get("SOAK_RATE", "2000"))
SEED = int(os.environ.get("SOAK_SEED", "1"))

COMMANDS_PER_S = 10
STEP_S = 0.01
"""Everything is sent and received in steps: waking up for each datagram would cost more than the traffic."""

LEG_S = 10.0
QUIET_S = 2.0
"""What has not come after so long without anything coming, with every socket's queue empty, is lost."""

SAMPLE_S = 5.0
HANG_S = 60.0
"""A daemon that answers nothing for so long hangs; a loaded machine may keep it waiting for seconds."""

START_S = 180.0
"""How long a daemon may take on a loaded machine until it knows all vehicles."""

END_S = 60.0
KEPT_LOGS = 2
LOG_MB = 50

WARM_UP_S = 900.0
"""At most, and a quarter of short soaks: rings and queues fill, the fleet gets full of the hostile peer's vehicles
(20 MB), the allocator finds its level."""

LIMIT_MB = 110.0
GROWTH_MB = 2.0
"""What a line through the samples may rise by: vehicles that replace each other twice a second scatter over the
allocator's arenas. One small object kept of each frame would be 500 MB an hour, 10 kB of each forged vehicle 70."""

JUDGED_S = 600.0
"""Less than this after the warm-up shows no slope: memory rises in steps when a buffer is as full as never before."""


class Rpc:
    """A plain JSON-RPC socket, independent of the client library."""

    def __init__(self, path: Path, timeout_s: float = HANG_S) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(timeout_s)
        try:
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            raise
        self._lines = self._socket.makefile("rb")

    def call(self, method: str, **params: Any) -> Any:
        request = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        self._socket.sendall(json.dumps(request).encode() + b"\n")
        answer = json.loads(self._lines.readline())
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


@dataclass
class Samples:
    """What the sampler saw; ``rss`` is (seconds, MB)."""

    rss: list[tuple[float, float]] = field(default_factory=list)
    deleted_bytes: int = 0
    daemon_cpu_s: float = 0.0
    own_cpu_s: float = 0.0
    slowest_answer_s: float = 0.0


class Sampler(threading.Thread):
    """Looks at the daemon every SAMPLE_S, asks it something, deletes old logs; ``hung`` if it does not answer."""

    def __init__(self, pid: int, folder: Path) -> None:
        super().__init__(name="sampler", daemon=True)
        self.samples = Samples()
        self.ended = threading.Event()
        self.hung = threading.Event()
        self._pid, self._folder = pid, folder
        self._began, self._own_began = time.monotonic(), time.process_time()
        self._daemon_began = bench.cpu_s(pid)

    def run(self) -> None:
        with closing(Rpc(self._folder / "s")) as rpc:
            while not self.ended.wait(SAMPLE_S):
                try:
                    self._look()
                    began = time.monotonic()
                    rpc.call("daemon.info")
                    self.samples.slowest_answer_s = max(self.samples.slowest_answer_s, time.monotonic() - began)
                except TimeoutError:
                    self.hung.set()
                    return
                except (OSError, ValueError):  # the daemon is gone: the main thread says so
                    return

    def _look(self) -> None:
        samples = self.samples
        samples.rss.append((time.monotonic() - self._began, bench.rss_mb(self._pid)))
        samples.daemon_cpu_s = bench.cpu_s(self._pid) - self._daemon_began
        samples.own_cpu_s = time.process_time() - self._own_began
        for old in sorted((self._folder / "logs").glob("*.tlog"))[:-KEPT_LOGS]:
            samples.deleted_bytes += old.stat().st_size
            old.unlink()


class Follower(threading.Thread):
    """A client that follows every vehicle and the events; counts what it is sent, events by kind."""

    def __init__(self, path: Path) -> None:
        super().__init__(name="follower", daemon=True)
        self.lines = 0
        self.kinds: Counter[str] = Counter()
        self.ended = threading.Event()
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))
        self._socket.settimeout(0.5)
        for number, params in enumerate(({"topic": "telemetry", "rate_hz": 2}, {"topic": "events"})):
            request = {"jsonrpc": "2.0", "id": number, "method": "subscribe", "params": params}
            self._socket.sendall(json.dumps(request).encode() + b"\n")

    def run(self) -> None:
        rest = b""
        with self._socket:
            while not self.ended.is_set():
                try:
                    data = self._socket.recv(1 << 20)
                except TimeoutError:
                    continue
                except OSError:
                    return
                if not data:
                    return
                *lines, rest = (rest + data).split(b"\n")
                self.lines += len(lines)
                for line in lines:
                    if b'"method":"event"' in line[:60]:
                        self.kinds[json.loads(line)["params"]["event"]["kind"]] += 1


class Soak:
    """One run of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shares = {"field": max(VEHICLES // 5, 1), "near": VEHICLES * 3 // 10}
        shares["air"] = VEHICLES - sum(shares.values())
        self.world = World({link: (free_port(), count) for link, count in shares.items()}, SEED)
        self.hostile = HostilePeer(self.world)
        self.legs: list[dict[str, Any]] = []
        self.unexplained = 0
        self.faults: list[str] = []
        self.drops: Counter[int] = Counter()
        self._copies = 0
        self.sent_frames = 0

    # -- the daemon

    def fleet(self) -> str:
        """The fleet file: three links of vehicles and two ground stations."""
        lines = [
            "[daemon]",
            f'socket = "{self.folder}/s"',
            f'log_dir = "{self.folder}/logs"',
            f"record_max_mb = {LOG_MB}",
            f"sysid = {OWN[0]}\ncompid = {OWN[1]}",
        ]
        for link, role in (("field", "peer"), ("air", "radio"), ("near", "vehicle")):
            port = self.world.links[link][0]
            lines.append(
                f'[links.{link}]\ntype = "udp_server"\nhost = "127.0.0.1"\nport = {port}\nrole = "{role}"\n'
                + ("" if link == "air" else "peer_timeout_s = 600\n")
            )
        for n, station in enumerate(self.world.stations):
            lines.append(
                f'[links.station{n}]\ntype = "udp_client"\nhost = "127.0.0.1"\nport = {station.port}\nrole = "gcs"\n'
                + ("whole_datagrams = false\n" if n else "")
            )
        return "\n".join(lines) + "\n"

    def start(self) -> subprocess.Popen[bytes]:
        (self.folder / "fleet.toml").write_text(self.fleet())
        with (self.folder / "out").open("wb") as out:
            return subprocess.Popen(
                [sys.executable, "-m", "skygcs", "run", "-q", "fleet.toml"],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
                env={**os.environ, "PYTHONFAULTHANDLER": "1"},  # SIGABRT then shows where it hangs
            )

    def meet(self, rpc: Rpc) -> None:
        """Everybody is known and every route learned before anything counts."""

        def met() -> bool:
            self.world.beat(time.monotonic())
            return (
                all(station.router_at is not None for station in self.world.stations)
                and rpc.call("daemon.info")["vehicles"] >= VEHICLES
            )

        if not wait_until(met, self.world, START_S):
            raise RuntimeError(f"the daemon does not know all vehicles: {self.output()}")
        until = time.monotonic() + 3.0
        while time.monotonic() < until:
            self.world.beat(time.monotonic())
            self.world.receive(0.05)
        self.world.book.next_leg()  # a heartbeat of the last moment may still come
        self.world.book.totals.clear()
        self.world.book.strange.clear()

    def output(self) -> str:
        return (self.folder / "out").read_text(errors="replace")[-4000:]

    # -- legs

    def run(self) -> dict[str, Any]:
        process = self.start()
        try:
            with closing(self._connect(process)) as rpc:
                self.meet(rpc)
                sampler, follower = Sampler(process.pid, self.folder), Follower(self.folder / "s")
                for thread in (sampler, follower):
                    thread.start()
                began = time.monotonic()
                self._legs(process, sampler, rpc, began + MINUTES * 60)
                seconds = time.monotonic() - began
                after = self._after(process, sampler, rpc)
                for thread in (sampler, follower):
                    thread.ended.set()
                    thread.join(HANG_S)
            self._end(process, sampler)
            return self._report(sampler.samples, follower, after, seconds)
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
            self.hostile.close()
            self.world.close()

    def _connect(self, process: subprocess.Popen[bytes]) -> Rpc:
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline and process.poll() is None:
            with suppress(OSError):
                rpc = Rpc(self.folder / "s")
                if all(link["state"] == "up" for link in rpc.call("links.list")):
                    return rpc
                rpc.close()
            time.sleep(0.1)
        raise RuntimeError(f"the daemon did not start: {self.output()}")

    def _legs(self, process: subprocess.Popen[bytes], sampler: Sampler, rpc: Rpc, until: float) -> None:
        began = time.monotonic()
        self._inodes = _socket_inodes(process.pid)
        self._own = {os.fstat(r.sock.fileno()).st_ino: r.name for r in self.world.receivers}
        self._tx_dropped = 0
        self._dropped()  # what was dropped before counts for no leg
        self._tx_lost(rpc)
        while time.monotonic() < until and process.poll() is None and not sampler.hung.is_set():
            self._leg(min(LEG_S, until - time.monotonic()))
            try:
                self._settle(sampler, rpc)
                if not sampler.hung.is_set():
                    self._account(rpc, time.monotonic() - began)
            except TimeoutError:  # the sampler may have asked later
                sampler.hung.set()
            if len(self.legs) % 6 == 0:
                self._show(sampler.samples, time.monotonic() - began)
        if process.poll() is not None:
            self.faults.append(f"the daemon ended by itself: {self.output()}")

    def _leg(self, seconds: float) -> None:
        world = self.world
        began, sent = time.monotonic(), 0
        commands, steps = 0, 0
        while (elapsed := time.monotonic() - began) < seconds:
            world.beat(began + elapsed)
            while sent < elapsed * RATE_PER_S:
                sent += world.speak()
            while commands < elapsed * COMMANDS_PER_S:
                world.command()
                commands += 1
            while steps < elapsed / HostilePeer.STEP_S:
                self.hostile.step()
                steps += 1
            world.receive(0)
            time.sleep(max(0.0, began + elapsed + STEP_S - time.monotonic()))

    def _settle(self, sampler: Sampler, rpc: Rpc) -> None:
        """Until all has come, or nothing has for a while although nothing waits anywhere: a busy machine may keep the
        daemon waiting for seconds. Its own messages do not count."""
        totals = self.world.book.totals
        heard_at, delivered = time.monotonic(), totals["frames delivered"]
        while self.world.book.missing() and not sampler.hung.is_set():
            self.world.receive(0.05)
            if totals["frames delivered"] != delivered or any(row.waiting for row in self._sockets().values()):
                heard_at, delivered = time.monotonic(), totals["frames delivered"]
            elif time.monotonic() - heard_at > QUIET_S:
                rpc.call("daemon.info")  # what it had taken from a socket it has sent when it answers
                self.world.receive(0.2)
                if totals["frames delivered"] == delivered:
                    return

    def _account(self, rpc: Rpc, at_s: float) -> None:
        """What was lost in this leg, and why."""
        missing = self.world.book.missing()
        dropped = self._dropped()
        tx_dropped = self._tx_lost(rpc)
        copies = self._taken_for_copies(rpc)
        leg: dict[str, Any] = {"at_s": round(at_s)}
        if missing or dropped or tx_dropped or copies:
            names = [receiver.name for receiver in self.world.receivers]
            leg["lost"] = {names[n]: count for n, count in missing.items()}
            leg["dropped by the kernel"] = dropped
            leg["not taken from the daemon"] = tx_dropped
            leg["taken for copies"] = copies
            at_daemon = sum(n for where, n in dropped.items() if where.startswith("daemon"))
            unexplained = {
                name: count
                for name, count in leg["lost"].items()
                if not (at_daemon or tx_dropped or dropped.get(name)) and count > copies
            }
            if unexplained:
                leg["unexplained"] = unexplained
                self.unexplained += sum(unexplained.values())
        self.legs.append(leg)
        self.world.book.totals["frames lost"] += sum(missing.values())
        self.world.book.next_leg()

    def _dropped(self) -> dict[str, int]:
        """Datagrams that the kernel dropped since the last call, for want of room in a socket, by whose it was."""
        named: Counter[str] = Counter()
        for inode, row in self._sockets().items():
            if row.drops > self.drops[inode]:
                named[self._own.get(inode, "daemon")] += row.drops - self.drops[inode]
                self.drops[inode] = row.drops
        return dict(named)

    def _sockets(self) -> dict[int, UdpSocket]:
        """Every UDP socket of the daemon's and of the load's, by inode."""
        return udp_sockets(set(self._own) | self._inodes)

    def _tx_lost(self, rpc: Rpc) -> int:
        """Frames that a socket did not take from the daemon since the last call."""
        total = sum(channel["tx_dropped"] for link in rpc.call("links.list") for channel in link["channels"])
        fresh, self._tx_dropped = max(total - self._tx_dropped, 0), total
        return fresh

    def _taken_for_copies(self, rpc: Rpc) -> int:
        """Frames since the last call that the router took for copies of what came over another channel. The load sends
        none, but two frames of one source on two channels have equal seq and CRC by chance, once in 2^24 pairs."""
        total = rpc.call("router.stats")["counters"]["duplicate"]
        fresh, self._copies = total - self._copies, total
        return fresh

    def _show(self, samples: Samples, seconds: float) -> None:
        totals = self.world.book.totals
        rss = samples.rss[-1][1] if samples.rss else 0.0
        wrong = sum(totals[k] for k in WRONG)
        print(
            f"{seconds / 60:6.1f} min  {rss:6.1f} MB  {totals['frames delivered']:>10,} delivered  "
            f"{totals['frames lost']:,} lost  {wrong} wrong  daemon {samples.daemon_cpu_s / seconds:.0%}, "
            f"load {samples.own_cpu_s / seconds:.0%} of a core",
            flush=True,
        )

    # -- the end

    def _after(self, process: subprocess.Popen[bytes], sampler: Sampler, rpc: Rpc) -> dict[str, Any]:
        if sampler.hung.is_set() or process.poll() is not None:
            return {}
        links = rpc.call("links.list")
        return {
            "daemon": rpc.call("daemon.info"),
            "router": {k: v for k, v in rpc.call("router.stats").items() if k != "routes"},
            "channels": sum(len(link["channels"]) for link in links),
            "counters of links": {link["name"]: link.get("counters", {}) for link in links},
        }

    def _end(self, process: subprocess.Popen[bytes], sampler: Sampler) -> None:
        """SIGTERM ends it; one that hangs shows where."""
        if sampler.hung.is_set():
            process.send_signal(signal.SIGABRT)
            with suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            self.faults.append(f"the daemon hung: no answer for {HANG_S:.0f} s: {self.output()}")
            return
        process.send_signal(signal.SIGTERM)
        try:
            code = process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.faults.append(f"SIGTERM did not end it within {END_S:.0f} s")
            return
        said = self.output()
        if code:
            self.faults.append(f"it ended with code {code}: {said}")
        if "Traceback" in said or "Exception ignored" in said:
            self.faults.append(f"it printed a traceback: {said}")

    def _report(self, samples: Samples, follower: Follower, after: dict[str, Any], seconds: float) -> dict[str, Any]:
        last_s = samples.rss[-1][0] if samples.rss else 0.0
        warm_up_s = min(WARM_UP_S, last_s / 4)
        kept = [(t, mb) for t, mb in samples.rss if t >= warm_up_s]
        slope = offset = 0.0
        if len(kept) > 2:
            slope, offset = statistics.linear_regression([t for t, _ in kept], [mb for _, mb in kept])
        if after and after["daemon"]["faults"]:
            self.faults.append(f"{after['daemon']['faults']} faults behind frames: {self.output()}")
        totals = self.world.book.totals
        return {
            "minutes": round(seconds / 60, 1),
            "vehicles": VEHICLES,
            "seed": SEED,
            "frames_sent_per_s": round(totals["frames sent"] / seconds),
            "frames_delivered_per_s": round(totals["frames delivered"] / seconds),
            "traffic": dict(sorted(totals.items())),
            "hostile peer": dict(sorted(self.hostile.sent.items())),
            "lost and not explained": self.unexplained,
            "legs with losses": [leg for leg in self.legs if len(leg) > 1],
            "legs": len(self.legs),
            "strange": self.world.book.strange,
            "faults": self.faults,
            "cpu_share": {
                "daemon": round(samples.daemon_cpu_s / max(last_s, 1), 3),
                "load": round(samples.own_cpu_s / max(last_s, 1), 3),
            },
            "slowest_answer_s": round(samples.slowest_answer_s, 2),
            "told_to_the_client": {"lines": follower.lines, "events": dict(follower.kinds.most_common())},
            "recorded_mb_deleted": round(samples.deleted_bytes / 1e6),
            "rss_mb": {
                "at first": round(samples.rss[0][1], 1) if samples.rss else 0.0,
                "after warm-up": round(offset + slope * warm_up_s, 1),
                "at the end": round(offset + slope * last_s, 1),
                "most": round(max((mb for _, mb in samples.rss), default=0.0), 1),
            },
            "warm_up_s": round(warm_up_s),
            "growth_mb_per_hour": round(slope * 3600, 2),
            "growth_judged": last_s - warm_up_s >= JUDGED_S,
            "after": after,
            "samples": [(round(t, 1), round(mb, 2)) for t, mb in samples.rss],
        }


WRONG = ("unknown or damaged", "misdelivered", "doubled", "not a frame", "the daemon's, misdelivered")


def _socket_inodes(pid: int) -> set[int]:
    """The sockets of a process."""
    found = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            target = os.readlink(fd)
            if target.startswith("socket:["):
                found.add(int(target[8:-1]))
    return found


def missed(report: dict[str, Any]) -> list[str]:
    """What was asked and is not so."""
    rss = report["rss_mb"]
    rise_mb = rss["at the end"] - rss["after warm-up"]
    wrong = {k: report["traffic"][k] for k in WRONG if report["traffic"].get(k)}
    return [
        *report["faults"],
        *(f"{count} frames {what}: {report['strange'][:3]}" for what, count in wrong.items()),
        *(
            text
            for text, so in (
                (f"{report['lost and not explained']} frames lost without a reason", report["lost and not explained"]),
                (
                    f"memory rose by {rise_mb:.1f} MB (limit {GROWTH_MB})",
                    report["growth_judged"] and rise_mb > GROWTH_MB,
                ),
                (f"{rss['most']} MB (limit {LIMIT_MB})", rss["most"] > LIMIT_MB),
                ("nothing was delivered", not report["traffic"].get("frames delivered")),
            )
            if so
        ),
    ]


def table(report: dict[str, Any]) -> str:
    """The report as a person reads it."""
    traffic, rss, cpu = report["traffic"], report["rss_mb"], report["cpu_share"]
    lost = traffic.get("frames lost", 0)
    rows = [
        ("duration", f"{report['minutes']} min, {report['vehicles']} vehicles, seed {report['seed']}"),
        ("frames sent", f"{traffic['frames sent']:,} in {traffic['datagrams sent']:,} datagrams"),
        ("frames delivered", f"{traffic['frames delivered']:,} ({report['frames_delivered_per_s']:,} /s)"),
        ("junk datagrams", f"{traffic['junk datagrams']:,}"),
        ("hostile peer", ", ".join(f"{count:,} {what}" for what, count in report["hostile peer"].items())),
        ("lost", f"{lost:,} in {len(report['legs with losses'])} of {report['legs']} legs"),
        ("lost, not explained", f"{report['lost and not explained']:,}"),
        *((what, f"{traffic.get(what, 0):,}") for what in WRONG),
        ("resident memory", f"{rss['after warm-up']} MB after {report['warm_up_s']} s, {rss['at the end']} at the end"),
        (
            "growth",
            f"{report['growth_mb_per_hour']:+.2f} MB per hour"
            + ("" if report["growth_judged"] else " (too short to judge)"),
        ),
        ("slowest answer", f"{report['slowest_answer_s']} s"),
        ("processor", f"daemon {cpu['daemon']:.0%}, load {cpu['load']:.0%} of a core"),
    ]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="skygcs-soak-") as name:
        report = Soak(Path(name)).run()
    keep("soak", report)
    print(table(report))
    faults = missed(report)
    for text in faults:
        print(f"MISSED: {text}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
