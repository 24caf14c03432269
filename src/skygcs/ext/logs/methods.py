"""The methods of the recordings that the daemon has written. `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result


class ReplayParams(MethodParams):
    name: str = Field(min_length=1, max_length=200, description="As recordings.list has it.")


class RecordingFile(Result):
    name: str
    bytes: int
    begun_unix_s: float | None = Field(description="By its name, UTC; null: the name has no time.")
    ended_unix_s: float = Field(description="When it was last written to.")


class RecordingsList(Result):
    folder: str
    recordings: list[RecordingFile] = Field(description="The newest 200, newest first.")
    left_out: int = Field(description="Older ones that are not listed.")
    replays: str | None = Field(description="The one that is being replayed.")


class ReplayPage(Result):
    name: str
    address: str = Field(description="Of the page on this computer: for one browser, within an hour.")


class ReplayEnded(Result):
    ended: bool = Field(description="False: nothing was replayed.")


async def recordings_list(context: Context, _: NoParams) -> JsonObject:
    """The recordings of the daemon's log folder."""
    listed: dict[str, Any] = await context.services.extensions["recordings"].listed()
    return listed


async def recordings_replay(context: Context, params: ReplayParams) -> JsonObject:
    """Replay a recording on a page of its own, in place of another, for at most four hours."""
    page: dict[str, Any] = await context.services.extensions["recordings"].replay(params.name)
    return page


async def recordings_end(context: Context, _: NoParams) -> JsonObject:
    """End the replay."""
    ended: dict[str, Any] = await context.services.extensions["recordings"].end()
    return ended


METHODS: tuple[Method[Context], ...] = (
    Method("recordings.list", NoParams, recordings_list, RecordingsList, reach="nothing"),
    Method("recordings.replay", ReplayParams, recordings_replay, ReplayPage, reach="nothing"),
    Method("recordings.end", NoParams, recordings_end, ReplayEnded, reach="nothing"),
)
