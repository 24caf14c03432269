from collections.abc import Callable
from typing import Any

from skygcs.links.peers import Address

INTERFACE: int

class Table:
    records_waiting: int
    def __init__(
        self, messages: dict[int, tuple[int, int, int, int, Any]], frame_type: type, recording: bool
    ) -> None: ...
    def first_heard_on(self, key: int, channel_id: int, now: float, /) -> int: ...
    def invalidate(self) -> None: ...
    def take(self) -> tuple[int, int, bytes, int]: ...

class Out:
    def __init__(self, fd: int, address: Address, channel: Any, whole: bool) -> None: ...

class FastPath:
    kept: int
    too_large: int
    def __init__(
        self,
        table: Table,
        fd: int,
        largest: int,
        clock: Callable[[], float],
        slow: Callable[[bytes, Address, float], None],
        after: Callable[[], None],
        broken: Callable[[OSError], None],
        /,
    ) -> None: ...
    def add_peer(self, address: Address, channel: Any, parser_stats: Any, channel_id: int, /) -> None: ...
    def remove_peer(self, address: Address, /) -> None: ...
    def add_flow(
        self,
        address: Address,
        source: int,
        msgid: int,
        stats: Any,
        heard: dict[int, float],
        outs: tuple[Out, ...],
        slot: Any,
        watches: list[Any] | None,
        steady: bytes | None,
        again: Callable[[float], None] | None,
        /,
    ) -> None: ...
    def ready(self, left_bytes: int, seconds: float, /) -> None: ...
    def close(self) -> None: ...
