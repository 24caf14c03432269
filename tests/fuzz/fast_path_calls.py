"""Calls of the compiled fast path in any order, from outside and from within its callbacks, with memory that runs out.

Nothing is compared but what must be so of any order: it ends, and no datagram that was received is lost.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from typing import Any

from support.fast_path_bench import Bench, Channel, Slot, attitude

try:
    import _testcapi  # not in every distribution's Python
except ImportError:
    _testcapi = None

CALLS = 60
"""Of one run."""

BLOBS = {sysid: b"".join(attitude(n, sysid=sysid, number=n) for n in range(1024)) for sysid in (1, 2)}
FRAME_BYTES = 40

EXPECTED = (ValueError, OSError, MemoryError, RuntimeError)
"""What callbacks raise here, and what a fast path raises that is called while it receives."""


class Chaos:
    """Two fast paths of one table, each with some peers, which are sockets, and flows to the other's."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.bench = bench = Bench(recording=self.rng.random() < 0.5)
        bench.on_left = self._left
        self.servers = [bench.server, bench.socket()]
        self.fast_paths = [bench.fast_path, bench.new_fast_path(self.servers[1])]
        self.peers = [bench.socket() for _ in range(4)]
        self.outs = [bench.new_out(Channel(), whole=self.rng.random() < 0.5) for _ in range(3)]
        self.depth = 0
        self.calls = 0
        self.seq = 0

    def run(self) -> int:
        """The number of calls. Raises what is not EXPECTED."""
        unraisable, sys.unraisablehook = sys.unraisablehook, lambda fault: None
        try:
            for _ in range(CALLS):
                self._guarded(self._any_call)
            for fast_path in self.fast_paths:
                self._guarded(fast_path.close)
        finally:
            sys.unraisablehook = unraisable
            self.bench.close()
        return self.calls

    def _guarded(self, call: Callable[[], Any]) -> None:
        starve = _testcapi is not None and self.rng.random() < 0.1
        if starve:
            start = self.rng.randrange(30)
            _testcapi.set_nomemory(start, start + self.rng.choice((1, 3, 30)))
        try:
            call()
        except EXPECTED:
            pass
        finally:
            if starve:
                _testcapi.remove_mem_hooks()

    def _any_call(self) -> None:
        rng = self.rng
        self.calls += 1
        rng.choices(
            (self._send, self._ready, self._flow, self._peer, self._remove, self._table, self._close, self._pass_time),
            (20, 30, 25, 8, 3, 8, 1, 2),
        )[0]()

    def _left(self, *_: object) -> None:
        self._callback()

    def _callback(self, *_: object) -> None:
        """What Python may do when it is called: anything at all, or fail."""
        if self.depth > 2:
            return
        self.depth += 1
        try:
            for _ in range(self.rng.choice((0, 0, 1, 3))):
                self._any_call()
            if self.rng.random() < 0.05:
                raise self.rng.choice((ValueError("x"), OSError(5, "x"), BlockingIOError(11, "x"), MemoryError()))
        finally:
            self.depth -= 1

    def _send(self) -> None:
        rng = self.rng
        for _ in range(rng.choice((1, 3, 70))):
            count, sysid = rng.choice((1, 1, 1, 1, 2, 10, 65, 256, 257)), rng.choice((1, 1, 2))
            data = BLOBS[sysid][self.seq % 512 * FRAME_BYTES :][: count * FRAME_BYTES]
            self.seq += count
            if rng.random() < 0.05:
                data = rng.randbytes(rng.randrange(60))
            rng.choice(self.peers).sendto(data, rng.choice(self.servers).getsockname())

    def _ready(self) -> None:
        self.rng.choice(self.fast_paths).ready(self.rng.choice((0, 1, 300, 1 << 40)), self.rng.choice((0.0, 3600.0)))

    def _flow(self) -> None:
        rng, bench = self.rng, self.bench
        rng.choice(self.fast_paths).add_flow(
            rng.choice(self.peers).getsockname(),
            rng.choice((0x0101, 0x0101, 0x0201)),
            rng.choice((30, 30, 30, 0, 77777)),
            bench.stats,
            bench.heard,
            tuple(rng.sample(self.outs, rng.randrange(4))),
            rng.choice((None, Slot())),
            rng.choice((None, [], [1])),
            None,
            rng.choice((None, self._callback)),
        )

    def _peer(self) -> None:
        channel = self.bench.channel if self.rng.random() < 0.8 else Channel()
        address = self.rng.choice(self.peers).getsockname()
        self.rng.choice(self.fast_paths).add_peer(address, channel, self.bench.counts, self.rng.randrange(1, 4))

    def _remove(self) -> None:
        self.rng.choice(self.fast_paths).remove_peer(self.rng.choice(self.peers).getsockname())

    def _table(self) -> None:
        rng, table = self.rng, self.bench.table
        rng.choice(
            (table.invalidate, table.take, lambda: table.first_heard_on(rng.randrange(1 << 40), 1, self.bench.now))
        )()

    def _close(self) -> None:
        number = self.rng.randrange(2)
        self.fast_paths[number].close()
        if self.rng.random() < 0.7:
            self.fast_paths[number] = self.bench.new_fast_path(self.servers[number])
            self.outs[self.rng.randrange(3)] = self.bench.new_out(Channel())

    def _pass_time(self) -> None:
        self.bench.now += self.rng.choice((0.1, 0.6, 5.0))


def play(seed: int) -> int:
    """One run; the number of calls."""
    return Chaos(seed).run()
