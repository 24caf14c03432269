"""What may be wrong with a link that is bound to vehicles (`vehicles`, `present_as`), as a person is told."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator

from skygcs.config.keylines import KeyPath
from skygcs.config.models import FleetConfig, LinkConfig
from skygcs.config.problem import Problem

BINDABLE = frozenset({"udp_server", "udp_client", "udp_broadcast", "tcp_server", "tcp_client", "memory"})
"""Types of links behind which a program may be; memory is for tests."""


def endpoint_text(link: LinkConfig) -> str:
    """ "kite", "kite as 1", "kite, hawk": what a bound link shows; empty if it is not bound."""
    shown = ", ".join(map(str, link.vehicles))
    return shown if link.present_as is None else f"{shown} as {link.present_as}"


def endpoint_problems(config: FleetConfig, wrong: Collection[KeyPath] = ()) -> Iterator[Problem]:
    """Keys of bound links that do not go together, or name nobody. ``wrong`` as in `checks.conflicts`."""
    for name, link in config.links.items():
        path = ("links", name)
        if not link.vehicles:
            if link.present_as is not None and not _is_wrong((*path, "vehicles"), wrong):
                text = "says how one vehicle is shown, and there is no `vehicles`: name that vehicle"
                yield Problem((*path, "present_as"), text)
            continue
        if link.type not in BINDABLE:
            text = (
                f"is for links to programs, udp_… and tcp_…; a {link.type} link has the vehicles themselves behind it"
            )
            yield Problem((*path, "vehicles"), text)
            continue
        if link.role != "gcs" and (*path, "role") not in wrong:
            text = (
                f'needs role = "gcs" (it is "{link.role}"): behind a bound link is a program that gives orders, and '
                "links of other roles are taken for vehicles and sent our own orders"
            )
            yield Problem((*path, "vehicles"), text)
        own_sysid = None if ("daemon", "sysid") in wrong else config.daemon.sysid
        yield from _vehicles(config, name, link, own_sysid, wrong)
        yield from _present_as(name, link, own_sysid)


def endpoint_warnings(config: FleetConfig) -> dict[str, str]:
    """By the name of each bound link whose program's frames lose signatures that another link asks for."""
    bound = {n: link for n, link in config.links.items() if link.enabled and link.vehicles}
    signed = [n for n, link in config.links.items() if link.enabled and link.signing is not None and not link.vehicles]
    warnings = {}
    for name, link in bound.items():
        if not signed or len(set(config.bound_sysids(link).values())) > 1:
            continue
        what = "every frame" if link.present_as is not None else "a frame that names no target"
        warnings[name] = (
            f"{what} from it is readdressed and loses its signature, and so does not count for vehicles that check "
            f"signatures (links.{', links.'.join(signed)} has a signing key): give orders to those through skygcs-cli, "
            "or through a link that is not bound"
        )
    return warnings


def _is_wrong(path: KeyPath, wrong: Collection[KeyPath]) -> bool:
    """Whether this key, or one within it, was refused for its own value."""
    return any(other[: len(path)] == path for other in wrong)


def _vehicles(
    config: FleetConfig, name: str, link: LinkConfig, own_sysid: int | None, wrong: Collection[KeyPath]
) -> Iterator[Problem]:
    first: dict[int, str | int] = {}
    for index, (vehicle, sysid) in enumerate(config.bound_sysids(link).items()):
        path = ("links", name, "vehicles", index)
        if sysid is None and _is_wrong(("vehicles", vehicle), wrong):
            continue  # there is one, and what is wrong with it is told there
        if sysid is None:
            near = difflib.get_close_matches(str(vehicle), config.vehicles, n=1)
            known = ", ".join(config.vehicles) or "none is named in this file"
            hint = f"did you mean {near[0]}?" if near else f"there are: {known}; or a system id, 1 to 255"
            yield Problem(path, f"there is no vehicle {vehicle!r}; {hint}")
        elif sysid == own_sysid:
            yield Problem(path, f"{sysid} is skygcs's own system id (daemon.sysid), and no vehicle's")
        elif sysid in first:
            yield Problem(path, f"{vehicle!r} is system {sysid}, as {first[sysid]!r} is: name it once")
        else:
            first[sysid] = vehicle


def _present_as(name: str, link: LinkConfig, own_sysid: int | None) -> Iterator[Problem]:
    path = ("links", name, "present_as")
    if link.present_as is None:
        return
    if len(link.vehicles) > 1:
        text = f"shows one vehicle under one id, and `vehicles` has {len(link.vehicles)}: make a link for each"
        yield Problem(path, text)
    if link.present_as == own_sysid:
        yield Problem(path, f"{link.present_as} is skygcs's own system id (daemon.sysid); vehicles have 1 to 250")
    if link.signing is not None:
        text = "changes every frame, and a changed frame has no signature: take out `signing`, or `present_as`"
        yield Problem(path, text)
