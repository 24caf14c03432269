"""The load generator of tests/bench/native/router_load.c in Python, for machines without a compiler.

Same arguments, same report, telemetry over UDP and commands; slower than any router and its latencies include its own
scheduling: good for what is lost or misdelivered at 10,000/s, not for costs.
"""

from __future__ import annotations

import itertools
import json
import select
import socket
import struct
import sys
import time

from fastcrc.crc16 import mcrf4xx

ATTITUDE, COMMAND, HEARTBEAT = (30, 39), (76, 152), (0, 50)
GCS_SYSID = 240
ROUTER_HEARD_S = 30.0
"""How long the load waits for the router's first datagram to each ground station."""

BEAT = bytes((4, 0, 0, 0, 2, 3, 81, 4, 3))


def encode(kind: tuple[int, int], sysid: int, compid: int, seq: int, payload: bytes) -> bytes:
    msgid, extra = kind
    payload = payload.rstrip(b"\0") or b"\0"
    body = bytes((len(payload), 0, 0, seq & 0xFF, sysid, compid, msgid, 0, 0)) + payload
    return b"\xfd" + body + struct.pack("<H", mcrf4xx(body + bytes((extra,))))


class Load:
    """One run."""

    def __init__(self, options: dict[str, str]) -> None:
        self.vehicles = int(options.get("vehicles", 20))
        self.gcs = [_bound(int(port)) for port in options["gcs"].split(",")]
        self.to = ("127.0.0.1", int(options["to"]))
        own = int(options.get("own_sockets", 0))
        self.own = bool(own)
        self.radio = [_bound(self.to[1] + 8000 + v) for v in range(self.vehicles if own else 1)]
        self.rates = {"telemetry": float(options.get("rate", 0)), "commands": float(options.get("commands", 0))}
        self.per_datagram = int(options.get("per_datagram", 1))
        seconds = float(options.get("seconds", 2))
        self.totals = {k: int(r * seconds) // self.per_datagram * self.per_datagram for k, r in self.rates.items()}
        self.sent = {"telemetry": 0, "commands": 0}
        self.seen: dict[str, dict[tuple[int, int], float]] = {"telemetry": {}, "commands": {}}
        self.newest: dict[tuple[str, int, int], int] = {}
        self.bad = {k: {"duplicates": 0, "out_of_order": 0, "wrong": 0, "corrupt": 0} for k in self.rates}
        self.router_at: dict[int, tuple[str, int]] = {}
        self.measuring = False

    def receive(self, wait_s: float) -> bool:
        ready = select.select([*self.gcs, *self.radio], [], [], max(wait_s, 0))[0]
        for sock in ready:
            try:
                while True:
                    data, address = sock.recvfrom(65536)
                    if sock in self.gcs:
                        self.router_at[self.gcs.index(sock)] = address
                    self._datagram(data, sock)
            except BlockingIOError:
                continue
        return bool(ready)

    def _datagram(self, data: bytes, sock: socket.socket) -> None:
        at = 0
        while at + 12 <= len(data) and data[at] == 0xFD:
            size = data[at + 1] + 12
            if self.measuring:
                self._frame(data[at : at + size], sock)
            at += size

    def _frame(self, raw: bytes, sock: socket.socket) -> None:
        sysid, msgid = raw[5], raw[7]
        payload = raw[10:-2] + bytes(40)
        number = int.from_bytes(payload[:4], "little")
        if msgid == COMMAND[0] and GCS_SYSID <= sysid < GCS_SYSID + len(self.gcs):
            target = payload[30] - 1
            wrong = sock in self.gcs or (self.own and self.radio[target] is not sock)
            self._note("commands", number, 0, target, wrong)
        elif msgid == ATTITUDE[0] and 1 <= sysid <= self.vehicles:
            wrong = sock not in self.gcs
            self._note("telemetry", number, 0 if wrong else self.gcs.index(sock), sysid, wrong)

    def _note(self, stream: str, number: int, receiver: int, vehicle: int, wrong: bool) -> None:
        bad = self.bad[stream]
        if wrong or number >= self.totals[stream]:
            bad["wrong" if wrong else "corrupt"] += 1
        elif (receiver, number) in self.seen[stream]:
            bad["duplicates"] += 1
        else:
            self.seen[stream][receiver, number] = time.monotonic()
            key = (stream, receiver, vehicle)
            bad["out_of_order"] += number < self.newest.get(key, 0)
            self.newest[key] = max(number, self.newest.get(key, 0))

    def send(self, stream: str, due: int) -> None:
        while self.sent[stream] < min(due, self.totals[stream]):
            number = self.sent[stream]
            if stream == "commands":
                gcs = number % len(self.gcs)
                payload = struct.pack("<I24xHBB", number, 400, number % self.vehicles + 1, 1)
                frame = encode(COMMAND, GCS_SYSID + gcs, 190, number // len(self.gcs), payload)
                self.gcs[gcs].sendto(frame, self.router_at[gcs])
                self.sent[stream] += 1
                continue
            step = self.per_datagram
            vehicles = [(n // step if self.own else n) % self.vehicles for n in range(number, number + step)]
            parts = []
            for n, vehicle in enumerate(vehicles, number):
                turn = n // (self.vehicles * step) * step + n % step if self.own else n // self.vehicles
                parts.append(encode(ATTITUDE, vehicle + 1, 1, turn + 2, struct.pack("<I", n) + bytes([17] * 20)))
            self.radio[vehicles[0] if self.own else 0].sendto(b"".join(parts), self.to)
            self.sent[stream] += step

    def warm_up(self) -> None:
        turns = itertools.count()
        heard_until = time.monotonic() + ROUTER_HEARD_S
        # Until each ground station has heard the router: on a loaded machine that may take longer than two turns.
        while (turn := next(turns)) < 2 or (len(self.router_at) < len(self.gcs) and time.monotonic() < heard_until):
            for v in range(self.vehicles):
                self.radio[v if self.own else 0].sendto(encode(HEARTBEAT, v + 1, 1, turn % 256, BEAT), self.to)
            until = time.monotonic() + 0.15
            while time.monotonic() < until:
                self.receive(0.02)
        if self.totals["commands"]:
            for g, address in self.router_at.items():
                self.gcs[g].sendto(
                    encode(HEARTBEAT, GCS_SYSID + g, 190, 0, bytes((0, 0, 0, 0, 6, 8, 0, 4, 3))), address
                )
            time.sleep(0.15)
            self.receive(0)

    def run(self) -> float:
        self.measuring = True
        start = time.monotonic()
        while any(self.sent[k] < self.totals[k] for k in self.totals):
            elapsed = time.monotonic() - start
            for stream, rate in self.rates.items():
                self.send(stream, int(elapsed * rate) // self.per_datagram * self.per_datagram)
            self.receive(0.0005)
        while self.receive(0.3):
            pass
        return start

    def report(self, stream: str, start: float) -> dict[str, float]:
        seen = self.seen[stream]
        expected = self.sent[stream] * (len(self.gcs) if stream == "telemetry" else 1)
        elapsed = max(seen.values(), default=start) - start
        return {
            "sent": self.sent[stream],
            "expected": expected,
            "received": len(seen),
            "lost": expected - len(seen),
            **self.bad[stream],
            "elapsed_s": elapsed,
            "p50_us": 0.0,
            "p99_us": 0.0,
            "p999_us": 0.0,
        }


def _bound(port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
    sock.bind(("127.0.0.1", port))
    sock.setblocking(False)
    return sock


def main() -> None:
    load = Load(dict(word.split("=", 1) for word in sys.argv[1:]))
    load.warm_up()
    print("ready", flush=True)
    sys.stdin.readline()
    start = load.run()
    print(json.dumps({stream: load.report(stream, start) for stream in load.rates}), flush=True)


if __name__ == "__main__":
    main()
