"""The shares of readers in a turn of the loop."""

from __future__ import annotations

import ast
from pathlib import Path

import skygcs.links
from skygcs.links.reading import LEAST_BYTES, TURN_BYTES, TURN_S, ReadingTurns


class Reader:
    pass


def test_all_readers_of_a_turn_together_take_what_one_would() -> None:
    turns = ReadingTurns()
    readers = [Reader() for _ in range(32)]
    assert turns.share(readers[0]) == (TURN_BYTES, TURN_S)
    for _ in range(3):
        shares = [turns.share(reader) for reader in readers]
    assert sum(share.bytes for share in shares) <= TURN_BYTES
    assert sum(share.seconds for share in shares) <= TURN_S * 1.0001
    many = [Reader() for _ in range(1000)]
    for _ in range(2):
        shares = [turns.share(reader) for reader in many]
    assert {share.bytes for share in shares} == {LEAST_BYTES}
    for _ in range(2):
        assert turns.share(readers[0]).bytes >= LEAST_BYTES
    assert turns.share(readers[0]) == (TURN_BYTES, TURN_S)


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
