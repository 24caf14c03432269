"""Every method of the daemon is sorted in; the role view reads and nothing else."""

from __future__ import annotations

from skygcs.ext.federation.bridge.station_methods import DESCRIBED
from skygcs.web.roles import ENDS_FLIGHT, NOT_PASSED_ON, ORDERS, READ, STATION_ORDERS, access, may
from support.extension_parts import ALL_METHODS


def test_every_method_of_the_daemon_stands_in_one_list() -> None:
    lists = (READ, ENDS_FLIGHT, ORDERS, NOT_PASSED_ON)
    assert set().union(*lists) - {"auth"} == set(ALL_METHODS)
    assert sum(map(len, lists)) == len(set().union(*lists))


def test_orders_that_the_daemon_always_takes_have_the_connection_of_their_own() -> None:
    """What ends a flight is answered when all places are taken: those orders, and what shows what flies."""
    always = {name for name, method in ALL_METHODS.items() if method.always}
    assert always - READ - NOT_PASSED_ON <= ENDS_FLIGHT


def test_the_role_view_may_read_only() -> None:
    names = [*ALL_METHODS, "no.such", "", "vehicles.list ", "VEHICLES.LIST", "web.hello"]
    assert {name for name in names if may("view", name)} == READ
    assert {name for name in names if may("command", name)} == READ | ENDS_FLIGHT | ORDERS
    assert access("no.such") == "refused"


def test_of_the_station_only_the_outcome_of_an_order_may_be_asked_for_and_not_by_who_only_looks() -> None:
    assert set(DESCRIBED) >= STATION_ORDERS == {"federation.outcome"}
    assert {name for name in DESCRIBED if may("command", name)} == STATION_ORDERS
    assert not any(may("view", name) for name in DESCRIBED)
