"""The configuration of a nats-server as the hub of a federation: pure text, made from an inventory.

Who may do what, by role. Everything that is not in a list is refused by the server:

    observer   reads    the state batches, events and audit of all sites
               asks     here.* and state.*.full.*
    operator   reads    as an observer
               asks     as an observer; log.*; orders (cmd, stop) of the sites in `orders`
    site S     reads    as an observer; here, full states, orders and logs that are asked of S; requests for leases of
                        its own vehicles and of those of the sites in `orders`
               asks     as an operator; requests for leases of its own vehicles and of those of the sites in `orders`
               sends    state.S, event.S, audit.S, bridge.S (read by S alone: two bridges of one name find each other);
                        answers to what it was asked, once each
               stores   leases of its own vehicles and of those of the sites in `orders`; its logs
    keeper     makes    the two stores; nothing else

Three permissions that nats-server has and nobody here gets, each a way around the lists: consumers (the server sends
what they read to any subject they name), direct gets (the same), and the making or changing of streams (a stream may
listen on any subject, and republish). So stores are made by a keeper, keys are read by STREAM.MSG.GET, whose answer is
wrapped, and watching is replaced by asking again.

An order's subject ends with the public key of the station that gives it, and no other station may send there: the site
knows who ordered, whatever the order itself says.

Inboxes have the public key of their station in their name. Only that station may subscribe there, and only a site that
was asked may send there, once (`allow_responses`).
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import NamedTuple

from skygcs.ext.federation.hub_inventory import HubInventory, HubUser

LEASES = "skygcs_leases"
"""The key-value store; its keys are SITE.VEHICLE."""

LOGS = "skygcs_logs"
"""The object store."""

INBOX = "_INBOX_"
"""Prefix of inboxes, before the public key. No user's name stands there: a station knows its key, and no other."""

ORDERS = "cmd."
"""Subjects of orders, cmd.SITE.VEHICLE.KEY: who sends one cannot name another's key, so the site knows who it was."""

STOPS = "stop."
"""Subjects of emergency stops, stop.SITE.VEHICLE.KEY: no flood of other messages fills the queue that they come in."""

MAX_PAYLOAD_BYTES = 1 << 20
MAX_PENDING_BYTES = 8 << 20
"""A reader that is so far behind is cut off: four sites' states of two seconds. The others do not wait for it."""

WRITE_DEADLINE_S = 2
ANSWER_WITHIN_S = 300
"""An order may be carried out for minutes before its outcome is known."""

MAX_CONTROL_LINE_BYTES = 4096
MAX_CONNECTIONS = 4096
MAX_SUBSCRIPTIONS = 1000


class Permissions(NamedTuple):
    """Permissions of one user: subjects that it may publish to and subscribe, and whether it may answer."""

    publish: list[str]
    subscribe: list[str]
    answers: bool


def permissions(inventory: HubInventory, name: str) -> Permissions:
    """Return what this user of the inventory may do."""
    user = inventory.users[name]
    if user.role == "keeper":
        return _keeper(user)
    ordered = inventory.sites_ordered_by(name)
    reads = ["state.*.fast", "state.*.slow", "event.*", "audit.*", f"{INBOX}{user.nkey}.>"]
    asks = ["here.*", "state.*.full.*"]
    if user.role == "observer":
        return Permissions(asks, reads, False)
    asks += ["log.*", *_file_reads()]
    asks += [f"{kind}{site}.*.{user.nkey}" for site in ordered for kind in (ORDERS, STOPS)]
    if user.role == "operator":
        return Permissions(asks, reads, False)
    asked = [f"bridge.{name}", f"here.{name}", f"state.{name}.full.*", f"{ORDERS}{name}.*.*", f"{STOPS}{name}.*.*"]
    asked.append(f"log.{name}")
    requests = [f"lease.{site}.*.request" for site in (name, *ordered)]
    sends = [f"state.{name}.fast", f"state.{name}.slow", f"event.{name}", f"audit.{name}", f"bridge.{name}"]
    leases = [f"$KV.{LEASES}.{site}.*" for site in (name, *ordered)]
    kept = [f"$JS.API.STREAM.INFO.KV_{LEASES}", f"$JS.API.STREAM.MSG.GET.KV_{LEASES}"]
    files = [f"$O.{LOGS}.C.*", f"$O.{LOGS}.M.*"]
    return Permissions([*asks, *sends, *requests, *leases, *kept, *files], [*reads, *asked, *requests], True)


def _file_reads() -> list[str]:
    return [f"$JS.API.STREAM.INFO.OBJ_{LOGS}", f"$JS.API.STREAM.MSG.GET.OBJ_{LOGS}"]


def _keeper(user: HubUser) -> Permissions:
    streams = [f"$JS.API.STREAM.{verb}.{stream}" for verb in ("CREATE", "INFO") for stream in _streams()]
    return Permissions(streams, [f"{INBOX}{user.nkey}.>"], False)


def _streams() -> tuple[str, str]:
    return f"KV_{LEASES}", f"OBJ_{LOGS}"


def hub_config(inventory: HubInventory) -> str:
    """The text of the configuration file."""
    host = f"[{inventory.host}]" if ":" in inventory.host else inventory.host
    lines = [
        "# Made by skygcs from an inventory; changes belong there.",
        f"listen: {_quoted(f'{host}:{inventory.port}')}",
        'server_name: "skygcs-hub"',
        f"max_payload: {MAX_PAYLOAD_BYTES}",
        f"max_pending: {MAX_PENDING_BYTES}",
        f"max_control_line: {MAX_CONTROL_LINE_BYTES}",
        f"max_connections: {MAX_CONNECTIONS}",
        f"max_subscriptions: {MAX_SUBSCRIPTIONS}",
        f'write_deadline: "{WRITE_DEADLINE_S}s"',
        'ping_interval: "5s"',
        "ping_max: 2",
        'lame_duck_duration: "30s"',
        'lame_duck_grace_period: "1s"',
        "jetstream {",
        f"  store_dir: {_quoted(str(inventory.store))}",
        f"  max_memory_store: {64 << 20}",
        f"  max_file_store: {inventory.store_mb * 1_000_000}",
        "}",
        *_tls(inventory),
        "authorization {",
        "  timeout: 2",
        "  users: [",
    ]
    for name, user in inventory.users.items():
        lines += _user(name, user, permissions(inventory, name))
    return "\n".join([*lines, "  ]", "}", ""])


def _tls(inventory: HubInventory) -> Iterable[str]:
    tls = inventory.tls
    if tls is None:
        return
    yield "tls {"
    yield f"  cert_file: {_quoted(str(tls.cert))}"
    yield f"  key_file: {_quoted(str(tls.key))}"
    if tls.ca is not None:
        yield f"  ca_file: {_quoted(str(tls.ca))}"
        yield "  verify: true"
    yield "  timeout: 2"
    yield "}"


def _user(name: str, user: HubUser, allowed: Permissions) -> Iterable[str]:
    yield f"    {{ # {name}: {user.role}"
    yield f"      nkey: {_quoted(user.nkey or '')}"
    yield "      permissions: {"
    yield f"        publish: {{ allow: [{', '.join(map(_quoted, allowed.publish))}] }}"
    yield f"        subscribe: {{ allow: [{', '.join(map(_quoted, allowed.subscribe))}] }}"
    if allowed.answers:
        yield f'        allow_responses: {{ max: 1, expires: "{ANSWER_WITHIN_S}s" }}'
    yield "      }"
    yield "    }"


def _quoted(text: str) -> str:
    """A string of the configuration's grammar, which is JSON's; a $ within quotes is no variable."""
    return json.dumps(text, ensure_ascii=False)
