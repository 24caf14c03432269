"""mDNS between companions and the ground: the ground announces its link, a companion finds it and opens its own.

Anyone in the network can announce a ground station. What is found is used for MAVLink alone, which authenticates
nobody unless it is signed; orders over TLS go by pinned certificates (`skygcs.ext.companions.tls`).
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import socket
import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from skygcs.errors import LinkError, SkygcsError
from skygcs.events import Event
from skygcs.ext.companions.companion_table import CompanionConfig, GroundAddress
from skygcs.ext.companions.ground_choice import Candidate, GroundChoice
from skygcs.ext.companions.ground_contact import GROUND_LINK
from skygcs.ext.companions.role import ground_link
from skygcs.runtime.linktable import LinkTable

if TYPE_CHECKING:
    from zeroconf import ServiceStateChange, Zeroconf
    from zeroconf.asyncio import AsyncZeroconf

SIOCGIFADDR = 0x8915
"""linux/sockios.h"""

SERVICE = "_skygcs._udp.local."
TICK_S = 1.0

AGAIN_S = 30.0
"""While the ground is not heard, mDNS is begun anew after this time: an interface that came up later is not used by it
until then. It is also how often the ground looks whether its addresses have changed."""

RESOLVE_MS = 3000
"""Time for the address of a station that was announced."""

MAX_RESOLVING = 32
"""Announcements whose address is being asked for; further ones are ignored until then."""


def open_zeroconf(interfaces: Sequence[str]) -> AsyncZeroconf:
    """mDNS on these addresses of this computer; none: on all of them. Raises LinkError."""
    try:
        from zeroconf import InterfaceChoice
        from zeroconf.asyncio import AsyncZeroconf
    except ImportError:
        raise LinkError('mDNS needs the extra "companions": pip install "skygcs[companions]"') from None
    try:
        return AsyncZeroconf(interfaces=list(interfaces) or InterfaceChoice.All)
    except OSError as error:
        raise LinkError(f"mDNS cannot be used: {error.strerror or error}") from None


def own_addresses() -> tuple[str, ...]:
    """The IPv4 address of each network interface of this computer, without loopback (netdevice(7))."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # an interface without an address
                answer = fcntl.ioctl(probe, SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
                found.append(socket.inet_ntoa(answer[20:24]))
    return tuple(sorted(address for address in set(found) if not address.startswith("127.")))


class GroundFinder:
    """Follows the ground stations that are announced, and keeps the link `GROUND_LINK` pointed at one of them."""

    def __init__(
        self,
        config: CompanionConfig,
        links: LinkTable,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
    ) -> None:
        self.problem: str | None = None
        """Why mDNS cannot be used."""
        self.choice = GroundChoice(config.ground_name)
        self._config = config
        self._links = links
        self._loop = loop
        self._on_event = on_event
        self._opened: Candidate | None = None
        self._resolving: set[asyncio.Task[None]] = set()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        present = self.choice.present
        return {
            "name": None if present is None else present.name,
            "found": sorted({candidate.name for candidate in self.choice.candidates}),
            "ignored": self.choice.ignored,
            "problem": self.problem,
        }

    async def run(self) -> None:
        """Search until cancelled."""
        while True:
            try:
                await self._browse()
            except SkygcsError as error:
                self._report_problem(str(error))
                await asyncio.sleep(AGAIN_S)

    async def _browse(self) -> None:
        """One use of mDNS: as long as the ground is heard, AGAIN_S at least."""
        from zeroconf.asyncio import AsyncServiceBrowser

        opened = open_zeroconf(self._config.interfaces)
        try:
            self._report_problem(None)
            AsyncServiceBrowser(opened.zeroconf, SERVICE, handlers=[self._on_change])
            begun = self._loop.time()
            while self._loop.time() - begun < AGAIN_S or self._silent_s() < AGAIN_S:
                await asyncio.sleep(TICK_S)
                await self._tick()
        finally:
            for task in self._resolving:
                task.cancel()
            await opened.async_close()

    def _on_change(self, zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange) -> None:
        """An announcement; called by zeroconf on the loop's thread."""
        station = name.removesuffix("." + SERVICE)
        if state_change.name == "Removed":
            self.choice.gone(station)
        elif len(self._resolving) >= MAX_RESOLVING:
            self.choice.ignored += 1
        else:
            task = self._loop.create_task(self._resolve(zeroconf, name, station), name="mdns address")
            self._resolving.add(task)
            task.add_done_callback(self._resolving.discard)

    async def _resolve(self, zeroconf: Zeroconf, name: str, station: str) -> None:
        from zeroconf import BadTypeInNameException
        from zeroconf.asyncio import AsyncServiceInfo

        try:
            info = AsyncServiceInfo(SERVICE, name)
            answered = await info.async_request(zeroconf, RESOLVE_MS)
        except (BadTypeInNameException, OSError, ValueError):
            self.choice.ignored += 1
            return
        if not answered or info.port is None:
            self.choice.ignored += 1
            return
        transport = (info.properties.get(b"transport") or b"udp").decode("ascii", "replace")
        hosts = sorted(info.parsed_scoped_addresses(), key=lambda host: ":" in host)  # IPv4 first
        self.choice.found(station, transport, hosts, info.port)

    async def _tick(self) -> None:
        """Point the link at whom the choice names now."""
        chosen = self.choice.decide(self._loop.time(), self._silent_s())
        if chosen is None or chosen == self._opened:
            return
        address = GroundAddress("tcp" if chosen.transport == "tcp" else "udp", chosen.host, chosen.port)
        link = ground_link(address, self._config.signing)
        table = link.model_dump(mode="json", exclude_unset=True, exclude={"name"}) | {"type": link.type}
        try:
            if GROUND_LINK in self._links:
                await self._links.remove(GROUND_LINK)
            await self._links.add(GROUND_LINK, table)
        except SkygcsError as error:
            self._report_problem(str(error))
            return
        self._opened = chosen
        text = f"ground station {chosen.name} found at {chosen.transport}:{chosen.host}:{chosen.port}"
        self._on_event(Event("companion", None, None, text, {"change": "ground", "ground": chosen.name}))

    def _silent_s(self) -> float:
        """Seconds since the ground was heard last."""
        heard = [channel.last_rx_at for channel in self._links.link_channels(GROUND_LINK) if channel.rx_frames]
        return self._loop.time() - max(heard) if heard else float("inf")

    def _report_problem(self, problem: str | None) -> None:
        if problem is not None and problem != self.problem:
            text = f"the ground is not looked for: {problem}"
            self._on_event(Event("companion", None, None, text, {"change": "mdns", "reason": problem}))
        self.problem = problem


class GroundAnnouncement:
    """Announces a link of the ground by mDNS, with the addresses that this computer has."""

    def __init__(
        self,
        link: str,
        interfaces: Sequence[str],
        links: LinkTable,
        on_event: Callable[[Event], None],
        *,
        name: str | None = None,
    ) -> None:
        """``name`` of the ground station; None: the computer's."""
        self.problem: str | None = None
        self.announced: str | None = None
        """The announcement now: "NAME at HOST:PORT"; None: there is none."""
        self._link = link
        self._interfaces = tuple(interfaces)
        self._links = links
        self._on_event = on_event
        self._name = name or socket.gethostname().partition(".")[0] or "ground"

    async def run(self) -> None:
        """Announce until cancelled."""
        while True:
            try:
                await self._announce()
            except SkygcsError as error:
                self._report(str(error))
                await asyncio.sleep(AGAIN_S)

    async def _announce(self) -> None:
        """Announce the link until the addresses or the link have changed."""
        place = self._place()
        opened = open_zeroconf(self._interfaces)
        try:
            from zeroconf import Error
            from zeroconf.asyncio import AsyncServiceInfo

            # announce the service
            addresses, transport, port = place
            info = AsyncServiceInfo(
                SERVICE,
                f"{self._name}.{SERVICE}",
                port=port,
                parsed_addresses=list(addresses),
                properties={"transport": transport},
                server=f"{self._name}.local.",
            )
            try:
                await (await opened.async_register_service(info, allow_name_change=True))
            except (Error, OSError) as error:
                raise LinkError(f"mDNS refuses the announcement: {error or type(error).__name__}") from None
            # keep it until the place changes
            self.announced = f"{info.name.removesuffix('.' + SERVICE)} at {', '.join(addresses)} port {port}"
            self._report(None)
            while True:
                await asyncio.sleep(AGAIN_S)
                if self._place() != place:
                    return
        finally:
            # withdraw it
            self.announced = None
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(TICK_S):
                    await opened.async_unregister_all_services()
            await opened.async_close()

    def _place(self) -> tuple[tuple[str, ...], str, int]:
        """Addresses, transport and port of the link as it is open now. Raises LinkError."""
        config = self._links.configs.get(self._link)
        if config is None or config.type not in ("udp_server", "tcp_server"):
            raise LinkError(f"the link {self._link} that is announced to companions is not there")
        port, host = config.port, config.host
        if host not in ("", "0.0.0.0", "::"):
            return (host,), config.type.removesuffix("_server"), port
        addresses = self._interfaces or own_addresses()
        if not addresses:
            raise LinkError("this computer has no address but 127.0.0.1: is the network up?")
        return addresses, config.type.removesuffix("_server"), port

    def _report(self, problem: str | None) -> None:
        if problem is not None and problem != self.problem:
            text = f"companions cannot find this ground station: {problem}"
            self._on_event(Event("companion", None, None, text, {"change": "mdns", "reason": problem}))
        self.problem = problem
