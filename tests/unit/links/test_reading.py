"""The shares of readers in a turn of the loop."""

from __future__ import annotations

import ast
import os
import socket
import tty
from pathlib import Path

import skygcs.links
from skygcs.links.reading import LEAST_BYTES, TURN_BYTES, TURN_S, ReadingTurns, Share, waiting_bytes, waiting_datagrams
from support.table import each


class Reader:
    pass


def share_of(turns: ReadingTurns, reader: Reader) -> Share:
    share = turns.share(reader)
    assert share is not None
    return share


def test_all_readers_of_a_turn_together_take_what_one_would() -> None:
    turns = ReadingTurns()
    readers = [Reader() for _ in range(32)]
    assert turns.share(readers[0]) == (TURN_BYTES, TURN_S)
    for _ in range(3):
        shares = [share_of(turns, reader) for reader in readers]
    assert sum(share.bytes for share in shares) <= TURN_BYTES
    assert sum(share.seconds for share in shares) <= TURN_S * 1.0001
    many = [Reader() for _ in range(1000)]
    for _ in range(2):
        shares = [share_of(turns, reader) for reader in many]
    assert {share.bytes for share in shares} == {LEAST_BYTES}
    for _ in range(2):
        assert share_of(turns, readers[0]).bytes >= LEAST_BYTES
    assert turns.share(readers[0]) == (TURN_BYTES, TURN_S)


def test_a_reader_in_which_something_waited_is_stale_until_it_has_been_empty_once() -> None:
    turns = ReadingTurns()
    waits, empty, later = (Socket() for _ in range(3))
    turns.add(waits, waits.near.fileno(), lambda: 9)
    turns.add(empty, empty.near.fileno(), lambda: 9)
    waits.far.send(b"of before")
    waits.far.send(b"of before, too")
    turns.woke()
    turns.add(later, later.near.fileno(), lambda: 9)
    assert set(turns.stale) == {waits}
    waits.near.recv(100)
    assert not turns.emptied(waits, 1)  # the time it takes does not count
    waits.near.recv(100)
    assert turns.emptied(waits, 1)
    turns.trust(waits)
    assert not turns.stale
    for reader in (waits, empty, later):
        turns.remove(reader)
        reader.close()


@each("size", [1, 40, 1472])
def test_a_socket_that_is_never_empty_is_trusted_after_what_had_waited_at_the_wake_and_not_before(size: int) -> None:
    turns, reader = ReadingTurns(), Reader()
    udp = socket.AF_INET, socket.SOCK_DGRAM
    with socket.socket(*udp) as near, socket.socket(*udp) as far:
        near.bind(("127.0.0.1", 0))
        far.connect(near.getsockname())
        turns.add(reader, near.fileno(), lambda: waiting_datagrams(near))
        for _ in range(50):
            far.send(bytes(size))
        turns.woke()
        taken = 0
        while True:
            far.send(bytes(size))  # faster than it is read
            near.recv(2048)
            taken += 1
            if turns.emptied(reader, 1):
                break
        assert 50 <= taken <= 50 * 10, "of what the kernel says that one takes a third is no datagram"


def test_a_terminal_that_is_never_empty_is_trusted_after_what_had_waited_at_the_wake() -> None:
    turns, reader = ReadingTurns(), Reader()
    far, near = os.openpty()
    tty.setraw(near)
    turns.add(reader, near, lambda: waiting_bytes(near))
    os.write(far, bytes(2000))
    turns.woke()
    taken = 0
    while not turns.emptied(reader, 500) and taken < 1 << 20:
        os.write(far, bytes(500))
        os.read(near, 500)
        taken += 500
    assert 2000 <= taken < 1 << 18
    os.close(near)
    os.close(far)


def test_nothing_may_be_read_until_what_was_known_is_forgotten() -> None:
    turns = ReadingTurns()
    turns.asleep = lambda: True
    assert turns.share(Reader()) is None


class Socket:
    def __init__(self) -> None:
        self.near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    def close(self) -> None:
        self.near.close()
        self.far.close()


READS = {"read", "recv", "recvfrom", "recv_into", "recvfrom_into", "recvmsg", "ready"}
"""Methods that take bytes from a descriptor; `ready` is the compiled reader's."""


def test_whatever_reads_from_a_link_asks_for_its_share() -> None:
    """Of a kind of link that comes later as well."""
    readers = {}
    for path in Path(skygcs.links.__file__).parent.glob("*.py"):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
                called = {
                    n.func.attr
                    for n in ast.walk(function)
                    if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute)
                }
                if called & READS:
                    readers[f"{path.name} {function.name}"] = "share" in called
    assert [reader for reader, asks in readers.items() if not asks] == []
    assert {reader.split()[0] for reader in readers} == {"stream.py", "udp.py", "xbee.py"}
