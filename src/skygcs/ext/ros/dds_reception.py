"""Which readers have something to read: one thread that waits in Cyclone, and the loop that reads.

Cyclone's Python bindings hold the interpreter's lock while they write and read. A listener, which Cyclone calls from
its own threads with locks held, would wait for the interpreter while the loop waits for Cyclone: a process with
listeners stood still within seconds. So nothing of ours is called by Cyclone.

The thread waits (without the interpreter's lock) for any reader, hands the ready ones to the loop, and waits for the
loop to have read before it looks again: one turn of the loop per wake-up, however much comes.
"""

from __future__ import annotations

import asyncio
import ctypes
import threading
from collections.abc import Callable
from typing import Any

from cyclonedds.core import ReadCondition, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import DDS
from cyclonedds.sub import DataReader

READY_AT_ONCE = 64
"""Readers that one wake-up hands to the loop; the others are ready still at the next."""

LOOK_S = 0.5
"""The thread looks so often whether it is to end."""

_wait = DDS._dll_handle.dds_waitset_wait
_wait.argtypes = [ctypes.c_int32, ctypes.POINTER(ctypes.c_ssize_t), ctypes.c_size_t, ctypes.c_int64]
_wait.restype = ctypes.c_int32
_attach = DDS._dll_handle.dds_waitset_attach
_attach.argtypes = [ctypes.c_int32, ctypes.c_int32, ctypes.c_ssize_t]
_attach.restype = ctypes.c_int32


class Reception:
    """`watch` readers; `close` ends the thread."""

    def __init__(self, participant: DomainParticipant, loop: asyncio.AbstractEventLoop) -> None:
        self._waitset = WaitSet(participant)
        self._conditions: list[ReadCondition] = []
        self._takes: list[Callable[[], None]] = []
        self._loop = loop
        self._closed = False
        self._read = threading.Event()
        self._thread = threading.Thread(target=self._run, name="dds reception", daemon=True)
        self._thread.start()

    def watch(self, reader: DataReader[Any], mask: int, take: Callable[[], None]) -> None:
        """Call ``take`` on the loop when the reader has samples: it must take them, or some of them."""
        condition = ReadCondition(reader, mask)
        self._conditions.append(condition)
        self._takes.append(take)
        _attach(self._waitset._ref, condition._ref, len(self._takes) - 1)

    def close(self) -> None:
        """End the thread, without waiting for it."""
        self._closed = True
        self._read.set()

    def _run(self) -> None:
        ready = (ctypes.c_ssize_t * READY_AT_ONCE)()
        while not self._closed:
            count = _wait(self._waitset._ref, ready, READY_AT_ONCE, round(LOOK_S * 1e9))
            if count <= 0:
                if count < 0:
                    return
                continue
            self._read.clear()
            try:
                self._loop.call_soon_threadsafe(self._on_ready, list(ready[: min(count, READY_AT_ONCE)]))
            except RuntimeError:  # the loop has ended
                return
            self._read.wait()

    def _on_ready(self, numbers: list[int]) -> None:
        try:
            if not self._closed:
                for number in numbers:
                    self._takes[number]()
        finally:
            self._read.set()
