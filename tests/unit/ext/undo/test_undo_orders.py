"""The list of changes that can be undone, as the RPC shows it."""

from __future__ import annotations

import asyncio
from pathlib import Path

from skygcs.disk_writer import DiskWriter
from skygcs.ext.undo.undo_orders import UndoOrders
from skygcs.runtime.undo_journal import UndoJournal
from support.inline_disk import Inline


async def test_however_many_ask_for_the_list_the_disk_reads_it_once(tmp_path: Path) -> None:
    loop, thread = asyncio.get_running_loop(), Inline()
    disk = DiskWriter(loop, lambda event: None, loop.time, thread)
    journal = UndoJournal(tmp_path)
    journal.left_over(journal.begin("alpha", 7, "px4", "fence test", {"GF_ACTION": 1.0}, {"GF_ACTION": 2.0}))
    orders = UndoOrders(journal, {}, loop.time, disk, lambda event: None)
    thread.stuck = True
    asking = [asyncio.ensure_future(orders.left()) for _ in range(64)]
    await asyncio.sleep(0)
    assert disk.status()["waiting"] == 1
    asking[0].cancel()
    thread.stuck = False
    await disk.run("another journal", int)
    (change,) = journal.left()
    assert all(answer["changes"] == [change.as_dict()] for answer in await asyncio.gather(*asking[1:]))
    journal.drop(change)
    assert (await orders.left())["changes"] == []
    await disk.close()
