"""The hub's configuration as text. What the permissions are worth is tried with a real server: tests/federation."""

from __future__ import annotations

import re
from typing import Any

from skygcs.ext.federation.bridge.hub_config import hub_config, permissions
from skygcs.ext.federation.hub_inventory import HubInventory, inventory_of
from skygcs.ext.federation.server_program import parsed_version, version_warning
from support.table import each

KEYS = {name: "U" + letter * 55 for name, letter in zip(("north", "south", "boss", "visitor"), "ABCD", strict=True)}


def inventory(**tables: Any) -> HubInventory:
    users: dict[str, Any] = {name: {"role": "site", "nkey": key} for name, key in KEYS.items()}
    users["north"]["orders"] = ["south"]
    users["boss"] |= {"role": "operator", "orders": ["*"]}
    users["visitor"]["role"] = "observer"
    return inventory_of({"users": users, **tables}, "test")


def test_an_observer_may_ask_and_nothing_else() -> None:
    allowed = permissions(inventory(), "visitor")
    assert allowed.publish == ["here.*", "state.*.full.*"] and not allowed.answers
    assert not [s for s in allowed.subscribe if s.startswith(("cmd", "stop", "lease", "$", "_INBOX_."))]


def test_an_operator_asks_no_holder_to_release_a_lease_that_it_may_not_take() -> None:
    """Its requests had a home give its vehicle up again and again, although nobody then took it."""
    assert not [subject for subject in permissions(inventory(), "boss").publish if "lease" in subject.lower()]
    asked = [subject for subject in permissions(inventory(), "north").publish if subject.startswith("lease.")]
    assert asked == ["lease.north.*.request", "lease.south.*.request"]


@each("name", KEYS)
def test_nobody_has_what_leads_around_the_lists(name: str) -> None:
    allowed = permissions(inventory(), name)
    for subject in (*allowed.publish, *allowed.subscribe):
        assert not re.search(r"CONSUMER|DIRECT|STREAM\.(CREATE|UPDATE|DELETE|PURGE)|\$SYS|^>|^\*", subject), subject
    inboxes = [s for s in allowed.subscribe if s.startswith("_INBOX")]
    assert inboxes == [f"_INBOX_{KEYS[name]}.>"]
    assert not [s for s in allowed.publish if s.startswith("_INBOX")]
    assert all(subject.endswith(KEYS[name]) for subject in allowed.publish if subject.startswith(("cmd.", "stop.")))


def test_a_path_with_quotes_and_dollars_stays_one_text() -> None:
    text = hub_config(inventory(store='/tmp/a "b" $HOME \\ {x}', tls={"cert": "c", "key": "k", "ca": "a"}))
    assert r'store_dir: "/tmp/a \"b\" $HOME \\ {x}"' in text
    assert "verify: true" in text and 'cert_file: "c"' in text


@each(
    ("text", "warned"),
    [
        *(("nats-server: v2.9.10", True), ("2.9.22", True), ("2.9.23", False), ("v2.10.1", True), ("2.10.2", False)),
        *(("2.12.1-beta", False), ("1.4.1", True), ("", False), ("None", False)),
    ],
)
def test_versions_with_the_flaw_are_known(text: str, warned: bool) -> None:
    assert (version_warning(text) is not None) is warned


def test_a_version_is_read_out_of_any_text() -> None:
    assert parsed_version("nats-server: v2.10.20-RC.1") == (2, 10, 20)
    assert parsed_version("9" * 100) is None
