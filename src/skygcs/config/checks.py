"""Checks of the fleet file as a whole: keys that are valid each and contradict each other."""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Collection, Iterator, Mapping
from itertools import combinations

from skygcs.config.control import GROUND, ControlSettings
from skygcs.config.models import (
    FleetConfig,
    LinkConfig,
    ReplayLinkConfig,
    SerialLinkConfig,
    SimulatedLinkConfig,
    TcpClientLinkConfig,
    TcpServerLinkConfig,
    UdpBroadcastLinkConfig,
    UdpClientLinkConfig,
    UdpServerLinkConfig,
    VehicleSettings,
    XBeeLinkConfig,
)
from skygcs.config.radio import RadioKeys, timing_problem
from skygcs.config.signing import EVERY_MESSAGE
from skygcs.config.tables import KeyPath, Problem
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.vehicle.targets import name_problem
from skygcs.spelling import near_names

MAX_SOCKET_PATH_BYTES = 107
"""sun_path holds 108 bytes with the final zero (Linux, unix(7))."""

MAX_SYSID = 255
MAX_MSGID = 0xFFFFFF

_WILDCARDS = frozenset({"", "0.0.0.0", "::"})
_LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


def conflicts(config: FleetConfig, wrong: Collection[KeyPath] = ()) -> list[Problem]:
    """Every conflict between keys. ``wrong`` are keys whose own values were refused: they are not checked again."""
    problems = [*_vehicle_names(config), *_vehicle_sysids(config), *_vehicle_types(config)]
    if ("daemon", "sysid") not in wrong:
        problems += _own_sysid(config)
    problems += _simulated(config)
    problems += _radios(config)
    problems += _control(config)
    active = {name: link for name, link in config.links.items() if link.enabled}
    problems += _shared_places(config, active)
    problems += _own_places(active)
    problems += _contradicting_filters(config.links)
    problems += _signing(active)
    problems += endpoint_problems(config, wrong)
    socket = config.daemon.socket
    if socket is not None and len(os.fsencode(socket)) > MAX_SOCKET_PATH_BYTES:
        problems.append(
            Problem(
                ("daemon", "socket"), f"is longer than the {MAX_SOCKET_PATH_BYTES} bytes a Unix socket's path may have"
            )
        )
    return problems


def control_place_problems(config: FleetConfig, places: Mapping[str, str]) -> list[Problem]:
    """Values of `ControlSettings.at` where nothing flies a vehicle. ``places``: those that extensions know, with the
    names of their tables."""
    problems = []
    present = [GROUND, *(place for place, table in places.items() if table in config.extensions)]
    for path, settings in _settings(config):
        at = None if settings.control is None else settings.control.at
        if at is None or at in present:
            continue
        text = f"must be one of {', '.join([GROUND, *places])}, not {at!r}"
        if at in places:
            text = f"{at!r} needs the table [{places[at]}], which this file does not have"
        problems.append(Problem((*path, "control", "at"), text))
    return problems


def added_conflicts(config: FleetConfig, name: str, link: LinkConfig) -> list[str]:
    """Return what conflicts if this link is added, or takes the place of the one of its name, as text for a person.
    Conflicts of before are left out."""
    others = {n: other for n, other in config.links.items() if n != name}
    before = conflicts(config.model_copy(update={"links": others}))
    after = conflicts(config.model_copy(update={"links": {**others, name: link}}))
    return [f"{'.'.join(map(str, p.path))}: {p.text}" for p in after if p not in before]


def link_warnings(config: FleetConfig) -> dict[str, str]:
    """By the name of each link that disturbs another one, a warning."""
    return {**replay_warnings(config.links), **endpoint_warnings(config)}


def open_servers(config: FleetConfig) -> dict[str, str]:
    """By the name of each server that accepts every host of the network, a warning that names the remedy."""
    notes = {}
    for name, link in config.links.items():
        if not (link.enabled and isinstance(link, UdpServerLinkConfig | TcpServerLinkConfig)) or _is_loopback(
            link.host
        ):
            continue
        signed = link.signing is not None and EVERY_MESSAGE not in link.signing.accept_unsigned
        if link.allow_from is None and not signed:
            where = f"{link.host or '0.0.0.0'}:{link.port}"
            notes[name] = (
                f"any host that reaches {where} can act as a vehicle or a ground station here; restrict it with "
                'allow_from = ["10.0.0.0/24"] (your network), with signing, or listen on 127.0.0.1'
            )
    return notes


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in _LOOPBACK


def replay_warnings(links: Mapping[str, LinkConfig]) -> dict[str, str]:
    """By the name of each replay beside links that can carry vehicles, a warning. A recording never reaches a vehicle,
    but its vehicles are listed beside live ones."""
    live = [
        n for n, link in links.items() if link.enabled and link.role != "gcs" and not isinstance(link, ReplayLinkConfig)
    ]
    if not live:
        return {}
    text = (
        f"a replay beside {', '.join(live)}: nothing of it is sent there, but its vehicles are listed beside live ones "
        "(marked replayed, no orders to them), and one whose id is heard live is not shown from the file; "
        "a daemon of its own keeps the two apart"
    )
    return {n: text for n, link in links.items() if link.enabled and isinstance(link, ReplayLinkConfig)}


def message_problems(links: Mapping[str, LinkConfig], dialect: Dialect) -> Iterator[Problem]:
    """Messages in filters and rate limits that the dialect does not have. An id it does not have is allowed: that is
    how an unknown message is filtered."""
    for name, link in links.items():
        for key in ("allow_msg_id_in", "block_msg_id_in", "allow_msg_id_out", "block_msg_id_out"):
            for index, message in enumerate(getattr(link, key)):
                if text := _message_problem(message, dialect):
                    yield Problem(("links", name, key, index), text)
        for key in ("rate_in", "rate_out"):
            for message in getattr(link, key).messages:
                if message != "*" and (text := _message_problem(message, dialect)):
                    yield Problem(("links", name, key, "messages", message), text)
        if isinstance(link, RadioKeys):
            for message in link.third_party.rates:
                if text := _message_problem(message, dialect):
                    yield Problem(("links", name, "third_party", "rates", message), text)
        if link.signing is not None and "accept_unsigned" in link.signing.model_fields_set:
            for index, message in enumerate(link.signing.accept_unsigned):
                if message != "*" and (text := _message_problem(message, dialect)):
                    yield Problem(("links", name, "signing", "accept_unsigned", index), text)


def timing_problems(links: Mapping[str, LinkConfig]) -> list[Problem]:
    """Timing files that their radio links cannot use. Their paths are absolute already."""
    return [
        Problem(("links", name, "timing_file"), text)
        for name, link in links.items()
        if isinstance(link, RadioKeys) and link.enabled and link.role == "radio" and link.timing_file is not None
        if (text := timing_problem(link, link.timing_file)) is not None
    ]


def dialect_problems(dialect: Dialect) -> list[Problem]:
    """A dialect that lacks what discovering and commanding a vehicle needs."""
    missing = [name for name in ("HEARTBEAT", "COMMAND_LONG", "COMMAND_ACK") if name not in dialect.by_name]
    if not missing:
        return []
    text = f"{dialect.name} has no {' and no '.join(missing)}; name one that has as well: "
    return [Problem(("dialect",), text + '["ardupilotmega", "px4-extras"], for instance')]


def stream_problems(config: FleetConfig, dialect: Dialect) -> list[Problem]:
    """Messages in a ``streams`` key that the dialect does not have: they cannot be requested."""
    return [
        Problem((*path, "streams", message), text)
        for path, settings in _settings(config)
        for message in settings.streams or {}
        if (text := _message_problem(message, dialect))
    ]


def _message_problem(message: str | int, dialect: Dialect) -> str | None:
    if isinstance(message, int) or message.isdecimal():
        return None if 0 <= int(message) <= MAX_MSGID else f"{message} is not a message id (0 to {MAX_MSGID})"
    try:
        dialect.find(message)
    except KeyError:
        near = near_names(message, dialect.by_name, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        return f"the dialect has no message {message}{hint}"
    return None


def _vehicle_names(config: FleetConfig) -> Iterator[Problem]:
    groups = {group for vehicle in config.vehicle_configs() for group in vehicle.groups}
    by_file: dict[str, str] = {}
    for name, entry in config.vehicles.items():
        path: KeyPath = ("vehicles", name)
        if text := name_problem(name):
            yield Problem(path, f"the name {name!r} {text}")
        elif name in groups:
            yield Problem(path, f"{name!r} is the name of a vehicle and of a group; orders to it would be ambiguous")
        elif re.fullmatch(r"v[0-9]+", name) and int(name[1:]) != entry.sysid:
            yield Problem(path, f"the name {name!r} is the default name of vehicle {name[1:]}")
        elif (other := by_file.setdefault(re.sub(r"\W", "_", name), name)) != name:
            yield Problem(path, f"{name!r} and {other!r} would share their files, whose names have _ for signs")
    for path, group in _group_keys(config):
        if text := name_problem(group):
            yield Problem(path, f"the group name {group!r} {text}")


def _group_keys(config: FleetConfig) -> Iterator[tuple[KeyPath, str]]:
    for path, settings in _settings(config):
        groups = (settings.group,) if isinstance(settings.group, str) else settings.group or ()
        for group in groups:
            yield (*path, "group"), group


def _settings(config: FleetConfig) -> list[tuple[KeyPath, VehicleSettings]]:
    """Every table with settings of vehicles."""
    sections: list[tuple[KeyPath, VehicleSettings]] = [(("defaults",), config.defaults)]
    sections += [(("types", name), settings) for name, settings in config.types.items()]
    sections += [(("vehicles", name), entry) for name, entry in config.vehicles.items()]
    return sections


def _vehicle_sysids(config: FleetConfig) -> Iterator[Problem]:
    first: dict[int, str] = {}
    for name, entry in config.vehicles.items():
        if entry.sysid in first:
            text = f"{entry.sysid} is already the system id of {first[entry.sysid]}: a system id belongs to one vehicle"
            yield Problem(("vehicles", name, "sysid"), text)
        else:
            first[entry.sysid] = name


def _vehicle_types(config: FleetConfig) -> Iterator[Problem]:
    for name, entry in config.vehicles.items():
        if entry.type is not None and entry.type not in config.types:
            near = near_names(entry.type, config.types, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            yield Problem(("vehicles", name, "type"), f"there is no [types.{entry.type}]{hint}")


def _own_sysid(config: FleetConfig) -> Iterator[Problem]:
    for name, entry in config.vehicles.items():
        if entry.sysid == config.daemon.sysid and name != config.aboard:
            text = f"{entry.sysid} is skygcs's own system id (daemon.sysid)"
            yield Problem(("vehicles", name, "sysid"), text)


def _simulated(config: FleetConfig) -> Iterator[Problem]:
    taken: dict[int, str] = {}
    for name, link in config.links.items():
        if not isinstance(link, SimulatedLinkConfig) or not link.enabled:
            continue
        sysids = range(link.first_sysid, link.first_sysid + link.vehicle_count)
        path = ("links", name, "first_sysid")
        if not sysids:
            *kinds, last = link.counts
            yield Problem(("links", name), f"has no vehicles: give their number with {', '.join(kinds)} or {last}")
        elif sysids[-1] > MAX_SYSID:
            yield Problem(path, f"{len(sysids)} vehicles from {sysids[0]} on need system ids above {MAX_SYSID}")
        elif config.daemon.sysid in sysids and config.aboard is None:
            yield Problem(path, f"{config.daemon.sysid} is skygcs's own system id and cannot be a simulated vehicle")
        elif clash := next((s for s in sysids if s in taken), None):
            yield Problem(path, f"{clash} is also a vehicle of the simulated link {taken[clash]}")
        taken.update(dict.fromkeys(sysids, name))


def _radios(config: FleetConfig) -> Iterator[Problem]:
    for name, link in config.links.items():
        if not isinstance(link, RadioKeys) or not link.enabled:
            continue
        for key in sorted(RadioKeys.model_fields.keys() & link.model_fields_set):
            if link.role != "radio":
                yield Problem(
                    ("links", name, key), f'has an effect only with role = "radio"; the role is "{link.role}"'
                )
        if isinstance(link, SimulatedLinkConfig) and link.radio is not None:
            nodes = link.vehicle_count + 1
            if link.radio.nodes is not None and link.radio.nodes < nodes:
                text = f"{link.radio.nodes} nodes are too few for {nodes - 1} vehicles and the ground"
                yield Problem(("links", name, "radio", "nodes"), text)
            if len(link.radio.distances_m) >= nodes:
                text = f"{len(link.radio.distances_m)} distances are too many for {nodes - 1} vehicles"
                yield Problem(("links", name, "radio", "distances_m"), text)


def _control(config: FleetConfig) -> Iterator[Problem]:
    """Keys of flight control that contradict each other, reported at the first level that has them."""
    base = config.defaults.control or ControlSettings()
    types = {name: t.control.over(base) if t.control else base for name, t in config.types.items()}
    levels: list[tuple[KeyPath, ControlSettings, ControlSettings]] = [(("defaults",), base, ControlSettings())]
    levels += [(("types", name), whole, base) for name, whole in types.items()]
    for name, entry in config.vehicles.items():
        below = types.get(entry.type or "", base)
        levels.append((("vehicles", name), entry.control.over(below) if entry.control else below, below))
    said = dict(_settings(config))
    for path, whole, below in levels:
        known = below.problems()
        for key, text in whole.problems():
            if (key, text) not in known:
                yield Problem((*path, "control", *_said(said[path].control, key, text)), text)


def _said(settings: ControlSettings | None, key: tuple[str, ...], text: str) -> tuple[str, ...]:
    """The key of a text that this level sets; ``key`` if it sets none."""
    table = None if settings is None else settings.model_dump(exclude_none=True)
    for part in key[:-1]:
        table = (table or {}).get(part)
    mentioned = [key[-1], *re.findall(r"[a-z_]+", text)]
    return (*key[:-1], next((word for word in mentioned if table and word in table), key[-1]))


def _places(link: LinkConfig) -> list[tuple[str, str, int | str]]:
    """(kind, host, port or device) that a link occupies or talks to; port 0 is any free one and never clashes."""
    match link:
        case SerialLinkConfig() | XBeeLinkConfig():
            return [("serial", "", os.path.realpath(link.device))]
        case UdpServerLinkConfig():
            return [("udp", link.host, link.port)] if link.port else []
        case TcpServerLinkConfig():
            return [("tcp", link.host, link.port)] if link.port else []
        case UdpClientLinkConfig() | UdpBroadcastLinkConfig():
            local = [("udp", "0.0.0.0", link.local_port)] if link.local_port else []
            return [("udp to", link.host, link.port), *local]
        case TcpClientLinkConfig():
            return [("tcp to", link.host, link.port)]
    return []


def _shared_places(config: FleetConfig, links: Mapping[str, LinkConfig]) -> Iterator[Problem]:
    """Two links on one device or port."""
    occupied = [(("links", name), place) for name, link in links.items() for place in _places(link)]
    if config.daemon.tcp_port:
        occupied.insert(0, (("daemon", "tcp_port"), ("tcp", "127.0.0.1", config.daemon.tcp_port)))
    for (path_a, a), (path_b, b) in combinations(occupied, 2):
        if a[0] == b[0] and a[2] == b[2] and path_a != path_b and _same_host(a[1], b[1]):
            where = {"serial": "the device {2}", "udp": "UDP port {2}", "tcp": "TCP port {2}"}.get(a[0], "{1}:{2}")
            yield Problem(path_b, f"{where.format(*b)} is already used by {'.'.join(path_a)}")


def _same_host(a: str, b: str) -> bool:
    return a == b or a in _WILDCARDS or b in _WILDCARDS or (a in _LOOPBACK and b in _LOOPBACK)


def _own_places(links: Mapping[str, LinkConfig]) -> Iterator[Problem]:
    """A link that sends to another link of the same daemon: every frame would loop."""
    for name, link in links.items():
        if isinstance(link, UdpClientLinkConfig | UdpBroadcastLinkConfig | TcpClientLinkConfig):
            if not link.port:
                yield Problem(("links", name, "port"), "0 is not a port to send to")
            kind = UdpServerLinkConfig if not isinstance(link, TcpClientLinkConfig) else TcpServerLinkConfig
            heard = link.host in _LOOPBACK or isinstance(link, UdpBroadcastLinkConfig)
            for other, server in links.items():
                if heard and isinstance(server, kind) and server.port == link.port and link.port:
                    yield Problem(("links", name, "port"), f"{link.port} is our own link {other}: frames would loop")


def _contradicting_filters(links: Mapping[str, LinkConfig]) -> Iterator[Problem]:
    for name, link in links.items():
        for what in ("msg_id", "src_sys", "src_comp"):
            for way in ("in", "out"):
                allow, block = f"allow_{what}_{way}", f"block_{what}_{way}"
                allowed = {_plain(entry) for entry in getattr(link, allow)}
                for index, entry in enumerate(getattr(link, block)):
                    if _plain(entry) in allowed:
                        text = f"{entry} is also in {allow}; remove it from one of them"
                        yield Problem(("links", name, block, index), text)


def _signing(links: Mapping[str, LinkConfig]) -> Iterator[Problem]:
    """Links whose signatures cannot be distinguished or checked."""
    used: dict[tuple[str, int], str] = {}
    for name, link in links.items():
        if link.signing is None:
            continue
        if isinstance(link, ReplayLinkConfig):
            text = "a recording cannot be checked: its signatures are too old to be accepted"
            yield Problem(("links", name, "signing"), text)
        place = (str(link.signing.key_file), link.signing.link_id)
        if other := used.get(place):
            text = f"{place[1]} is already the link_id of links.{other}, which has the same key; give each link its own"
            yield Problem(("links", name, "signing", "link_id"), text)
        used.setdefault(place, name)


def _plain(message: str | int) -> str:
    return str(message).upper()


BINDABLE = frozenset({"udp_server", "udp_client", "udp_broadcast", "tcp_server", "tcp_client", "memory"})
"""Types of links that can have a program behind them; memory is for tests."""


def endpoint_text(link: LinkConfig) -> str:
    """ "kite", "kite as 1", "kite, hawk": what a bound link shows; empty if it is not bound."""
    shown = ", ".join(map(str, link.vehicles))
    return shown if link.translated_sysid is None else f"{shown} as {link.translated_sysid}"


def endpoint_problems(config: FleetConfig, wrong: Collection[KeyPath] = ()) -> Iterator[Problem]:
    """Keys of bound links that contradict each other, or name no vehicle. ``wrong`` as in `checks.conflicts`."""
    for name, link in config.links.items():
        path = ("links", name)
        if not link.vehicles:
            if link.translated_sysid is not None and not _is_wrong((*path, "vehicles"), wrong):
                text = "gives one vehicle another id, but there is no `vehicles`: name that vehicle"
                yield Problem((*path, "translated_sysid"), text)
            continue
        if link.type not in BINDABLE:
            text = (
                f"is for links to programs, udp_… and tcp_…; a {link.type} link has the vehicles themselves behind it"
            )
            yield Problem((*path, "vehicles"), text)
            continue
        if link.role != "gcs" and (*path, "role") not in wrong:
            text = (
                f'needs role = "gcs" (it is "{link.role}"): a bound link has a program behind it that gives orders; '
                "links of other roles carry vehicles and are sent our own orders"
            )
            yield Problem((*path, "vehicles"), text)
        known = ("daemon", "sysid") not in wrong and config.aboard is None
        own_sysid = config.daemon.sysid if known else None
        yield from _vehicles(config, name, link, own_sysid, wrong)
        yield from _translated_sysid(name, link, own_sysid)


def endpoint_warnings(config: FleetConfig) -> dict[str, str]:
    """By the name of each bound link whose program's frames lose signatures that another link requires, a warning."""
    bound = {n: link for n, link in config.links.items() if link.enabled and link.vehicles}
    signed = [n for n, link in config.links.items() if link.enabled and link.signing is not None and not link.vehicles]
    warnings = {}
    for name, link in bound.items():
        if not signed or len(set(config.bound_sysids(link).values())) > 1:
            continue
        what = "every frame" if link.translated_sysid is not None else "a frame that names no target"
        warnings[name] = (
            f"{what} from it is readdressed and loses its signature, so vehicles that check "
            f"signatures (links.{', links.'.join(signed)} has a signing key): give orders to those through skygcs-cli, "
            "or through a link that is not bound"
        )
    return warnings


def _is_wrong(path: KeyPath, wrong: Collection[KeyPath]) -> bool:
    """True if this key, or one within it, was refused for its own value."""
    return any(other[: len(path)] == path for other in wrong)


def _vehicles(
    config: FleetConfig, name: str, link: LinkConfig, own_sysid: int | None, wrong: Collection[KeyPath]
) -> Iterator[Problem]:
    first: dict[int, str | int] = {}
    for index, (vehicle, sysid) in enumerate(config.bound_sysids(link).items()):
        path = ("links", name, "vehicles", index)
        if sysid is None and _is_wrong(("vehicles", vehicle), wrong):
            continue  # it exists, and its problem is reported there
        if sysid is None:
            near = near_names(str(vehicle), config.vehicles, n=1)
            known = f"there are: {', '.join(config.vehicles)}" if config.vehicles else "the fleet file names none"
            hint = f"did you mean {near[0]}?" if near else f"{known}; or a system id, 1 to 255"
            yield Problem(path, f"there is no vehicle {vehicle!r}; {hint}")
        elif sysid == own_sysid:
            yield Problem(path, f"{sysid} is skygcs's own system id (daemon.sysid), and no vehicle's")
        elif sysid in first:
            yield Problem(path, f"{vehicle!r} is system {sysid}, as {first[sysid]!r} is: name it once")
        else:
            first[sysid] = vehicle


def _translated_sysid(name: str, link: LinkConfig, own_sysid: int | None) -> Iterator[Problem]:
    path = ("links", name, "translated_sysid")
    if link.translated_sysid is None:
        return
    if len(link.vehicles) > 1:
        text = f"gives one vehicle another id, and `vehicles` has {len(link.vehicles)}: make a link for each"
        yield Problem(path, text)
    if link.translated_sysid == own_sysid:
        yield Problem(path, f"{link.translated_sysid} is skygcs's own system id (daemon.sysid); vehicles have 1 to 250")
    if link.signing is not None:
        text = "changes every frame, and a changed frame has no signature: remove `signing`, or `translated_sysid`"
        yield Problem(path, text)
