"""When the hub's store of leases is another one than before."""

from __future__ import annotations

from skygcs.ext.federation.protocol.lease_store import MAX_NAMES, LeaseStore
from support.table import each


def opened(last_revision: int = 10, now: float = 0.0) -> LeaseStore:
    store = LeaseStore()
    assert store.question().highest == 0
    assert store.found(store.question(), "created", last_revision, now)
    assert store.question().highest == last_revision
    return store


def test_it_keeps_its_name_while_its_revisions_grow_and_over_a_restart_of_the_bridge() -> None:
    store = opened()
    name = store.name
    for revision in (10, 11, 20):
        assert not store.found(store.question(), "created", revision, 1.0)
    assert (store.name, opened(25, 7.0).name, opened(0, 8.0).name) == (name, name, name)


@each(("identity", "last"), [("created again", 50), ("created", 11)])
def test_another_creation_or_a_lower_last_revision_is_another_store(identity: str, last: int) -> None:
    store = opened()
    store.note(12)
    name = store.name
    assert store.found(store.question(), identity, last, 1.0)
    assert store.name != name
    assert not store.found(store.question(), identity, last, 2.0)


def test_an_answer_that_a_newer_revision_overtook_says_nothing() -> None:
    store = opened()
    question = store.question()
    store.note(12)
    assert not store.found(question, "created", 10, 1.0)


def test_two_questions_about_one_change_find_it_once() -> None:
    store = opened()
    first, second = store.question(), store.question()
    assert store.found(first, "created", 3, 1.0)
    name = store.name
    assert not store.found(second, "created", 3, 1.1)
    assert not store.written(second, 3, 1.2)
    assert store.name == name


def test_a_write_with_a_revision_that_was_known_before_it_went_to_another_store() -> None:
    store = opened()
    assert not store.written(store.question(), 11, 1.0)
    name = store.name
    assert store.written(store.question(), 11, 2.0)
    assert (store.name != name, store.question().highest) == (True, 11)
    assert store.written(store.question(), 2, 2.5)
    assert not store.written(store.question(), 3, 3.0)


@each(("last", "same"), [(11, False), (12, True)])
def test_tokens_of_the_daemon_show_that_it_went_back_while_the_bridge_was_away(last: int, same: bool) -> None:
    name = opened().name
    store = LeaseStore()
    store.note(12, name)
    assert store.found(store.question(), "created", last, 5.0)
    assert (store.name == name) is same


def test_names_that_are_kept_have_a_bound() -> None:
    store = opened()
    for number in range(3 * MAX_NAMES):
        store.note(1, f"hub {number}")
        store.note(12)
    assert len(store._highest) == MAX_NAMES
    assert store.question().highest == 12
