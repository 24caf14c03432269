"""From switched on to ready, for each vehicle: the stages of `skygcs-cli up`.

| stage | it holds when | a vehicle without companion |
|---|---|---|
| reach | SSH reaches the companion, by a known host key | skipped |
| version | skygcs is installed there, the same version and code as here | skipped |
| disk | there is room for logs | skipped |
| service | its service runs and has reported that it is ready; it is started if it does not run | skipped |
| links | every link of its daemon is up | skipped |
| heard | the ground's daemon hears the vehicle | the same |
| preflight | its preflight passes, or it flies | the same |

A stage that does not hold ends the way of its vehicle, and of no other one. Nothing here arms or moves a vehicle.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, replace
from typing import Any

from skygcs.errors import CompanionError
from skygcs.ext.companions.bring_up import service_control
from skygcs.ext.companions.bring_up.ground_view import GroundView
from skygcs.ext.companions.bring_up.inventory import Companion
from skygcs.ext.companions.bring_up.probe import CompanionFacts, probe, require_room
from skygcs.ext.companions.bring_up.side_by_side import Progress
from skygcs.ext.companions.bring_up.ssh_session import Session

STAGES = ("reach", "version", "disk", "service", "links", "heard", "preflight")

LINKS_EVERY_S = 2.0
"""Each question starts a program on the companion, which takes a second of a slow one."""

PREFLIGHT_EVERY_S = 5.0
"""A GPS fix takes half a minute after power on; a preflight asks the vehicle for what is not known."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One vehicle to be made ready, and the computer on it. ``name`` is the companion's, else the vehicle's."""

    name: str
    vehicle: str
    sysid: int
    companion: Companion | None


Connect = Callable[[Companion], AbstractAsyncContextManager[Session]]


class BringUp:
    """Takes vehicles through the stages. ``version`` and ``content`` (`content.own_content`; "": not compared) are our
    own, ``wait_s`` how long links, vehicle and preflight may
    take each; ``on_stage`` is called with the progress and a stage that has begun or ended."""

    def __init__(
        self,
        connect: Connect,
        ground: GroundView,
        *,
        version: str,
        content: str = "",
        wait_s: float,
        on_stage: Callable[[Progress, str], None] = lambda progress, stage: None,
    ) -> None:
        self._connect = connect
        self._ground = ground
        self._version = version
        self._content = content
        self._wait_s = wait_s
        self._on_stage = on_stage

    async def run(self, candidate: Candidate, progress: Progress) -> str:
        """All stages; ``progress.data["stages"]`` has ok (None: not over), elapsed_s and text of each. Raises
        CompanionError at the first one that does not hold."""
        progress.data["stages"] = {}
        async with contextlib.AsyncExitStack() as stack:
            on_board: tuple[Session, CompanionFacts] | None = None
            if candidate.companion is not None:
                on_board = await self._on_board(candidate.companion, progress, stack)
            async with self._stage(progress, "heard") as entry:
                entry["text"] = await self._heard(candidate, on_board)
        async with self._stage(progress, "preflight") as entry:
            entry["text"] = await self._preflight(candidate)
        return f"ready, {entry['text']}"

    async def _on_board(
        self, companion: Companion, progress: Progress, stack: contextlib.AsyncExitStack
    ) -> tuple[Session, CompanionFacts]:
        async with self._stage(progress, "reach") as entry:
            session = await stack.enter_async_context(self._connect(companion))
            facts = await probe(session)
            entry["text"] = companion.place
        async with self._stage(progress, "version") as entry:
            _require_version(facts, self._version, companion.name)
            _require_content(facts, self._content, companion.name)
            entry["text"] = facts.version
        async with self._stage(progress, "disk"):
            require_room(facts)
        async with self._stage(progress, "service") as entry:
            entry["text"] = await service_control.start(session, facts)
            facts = replace(facts, state="active")
        async with self._stage(progress, "links") as entry:
            entry["text"] = await self._links(session, facts)
        return session, facts

    async def _links(self, session: Session, facts: CompanionFacts) -> str:
        """Wait until all links of the companion's daemon are up."""
        deadline = asyncio.get_running_loop().time() + self._wait_s
        while True:
            links = [link for link in await service_control.ask(session, facts, "links") if isinstance(link, Mapping)]
            closed = [link for link in links if link.get("state") not in ("up", "disabled")]
            if not closed:
                return ", ".join(str(link.get("name")) for link in links if link.get("state") == "up")
            if asyncio.get_running_loop().time() >= deadline:
                raise CompanionError("links", f"on the companion, {link_text(closed[0])}", "correct it there")
            await asyncio.sleep(LINKS_EVERY_S)

    async def _heard(self, candidate: Candidate, on_board: tuple[Session, CompanionFacts] | None) -> str:
        if await self._ground.heard(candidate.vehicle, self._wait_s):
            return "heard"
        missing = f"the ground has not heard {candidate.vehicle} (system id {candidate.sysid}) for {self._wait_s:g} s"
        if on_board is None:
            raise CompanionError("heard", missing, "is it on, and are its radio and the ground's links all right?")
        vehicles = await service_control.ask(*on_board, "status")
        there = [v for v in vehicles if isinstance(v, Mapping) and v.get("connected")]
        if not there:
            todo = "is the autopilot on, are its cable, port and baud as in companion.toml?"
            raise CompanionError("heard", "neither the companion nor the ground hears its autopilot", todo)
        if all(v.get("sysid") != candidate.sysid for v in there):
            heard = ", ".join(str(v.get("sysid")) for v in there)
            todo = "correct SYSID_THISMAV or MAV_SYS_ID, or the fleet file"
            raise CompanionError("heard", f"the companion hears system id {heard}, not {candidate.sysid}", todo)
        todo = "compare `ground` in companion.toml with the ground's links, and see its firewall"
        raise CompanionError("heard", f"the companion hears {candidate.vehicle}, the ground does not", todo)

    async def _preflight(self, candidate: Candidate) -> str:
        deadline = asyncio.get_running_loop().time() + self._wait_s
        while True:
            report = await self._ground.preflight(candidate.vehicle)
            wrong = [f for f in report["findings"] if f["verdict"] in ("fail", "unknown")]
            if report.get("in_air"):
                return "in flight"
            if report["ok"]:
                return f"{sum(f['verdict'] == 'pass' for f in report['findings'])} checks passed"
            if asyncio.get_running_loop().time() >= deadline:
                first = wrong[0] if wrong else {"text": "no check passed", "todo": ""}
                more = f" (and {len(wrong) - 1} more: skygcs-cli preflight {candidate.vehicle})" if wrong[1:] else ""
                raise CompanionError("preflight", str(first["text"]) + more, str(first["todo"]))
            await asyncio.sleep(PREFLIGHT_EVERY_S)

    @contextlib.asynccontextmanager
    async def _stage(self, progress: Progress, name: str) -> AsyncIterator[dict[str, Any]]:
        loop = asyncio.get_running_loop()
        began = loop.time()
        entry: dict[str, Any] = {"ok": None, "elapsed_s": 0.0, "text": ""}
        progress.data["stages"][name] = entry
        progress.step = name
        self._on_stage(progress, name)
        try:
            yield entry
            entry["ok"] = True
        except Exception as error:
            entry["text"] = str(error)
            raise
        finally:
            entry["ok"] = bool(entry["ok"])
            entry["elapsed_s"] = round(loop.time() - began, 3)
            self._on_stage(progress, name)


def link_text(link: Mapping[str, Any]) -> str:
    """A link that is not up, for a person."""
    why = link.get("last_error") or link.get("state")
    return f"link {link.get('name')} is not up: {why}"


def _install(name: str) -> str:
    return f"skygcs-cli companions install {name} --bundle FILE"


def _require_content(facts: CompanionFacts, own: str, name: str) -> None:
    if own and facts.content and facts.content != own:
        text = f"skygcs {facts.version} there and here, but other code: {facts.content} there, {own} here"
        raise CompanionError("version", text, f"{_install(name)}, of a bundle made here")


def _require_version(facts: CompanionFacts, own: str, name: str) -> None:
    install = _install(name)
    if not facts.program:
        raise CompanionError("version", "skygcs is not installed there", install)
    if facts.version != own:
        raise CompanionError("version", f"skygcs {facts.version or 'of an unknown version'} there, {own} here", install)
