"""Targets of several sites: which part goes to which site, and what is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import TargetError
from skygcs.ext.federation.protocol.site_names import name_of_token, select_at, split_by_site, subject_token
from skygcs.ext.federation.protocol.state_batch import VehicleRow, row_from_state
from support.table import each

SITES = ("south", "east")


def row(sysid: int, name: str, *groups: str) -> VehicleRow:
    made = row_from_state({"name": name, "sysid": sysid, "compid": 1, "groups": list(groups)})
    assert made is not None
    return made


@each(
    ("expression", "own", "others", "changed"),
    [
        ("all", ("all",), {}, False),
        ("alpha, 2-5", ("alpha", "2-5"), {}, False),
        (7, ("7",), {}, False),
        ("7/191,alpha/191,all/100", ("7/191", "alpha/191", "all/100"), {}, False),
        ("south/alpha", (), {"south": ("alpha",)}, True),
        (["south/1-5", "bravo", "south/all"], ("bravo",), {"south": ("1-5", "all")}, True),
        ("north/alpha", ("alpha",), {}, True),
        ("south/7/191", (), {"south": ("7/191",)}, True),
        ("south/3", (), {"south": ("3",)}, True),
    ],
)
def test_each_part_goes_to_its_site(
    expression: str, own: tuple[str, ...], others: dict[str, tuple[str, ...]], changed: bool
) -> None:
    found = split_by_site(expression, "north", SITES)
    assert (found.own, dict(found.others), found.changed, found.every) == (own, others, changed, False)


@each("expression", ["*/all", "all sites", ["alpha", "*/all"]])
def test_every_site_means_the_own_one_and_those_that_come_later_too(expression: str) -> None:
    found = split_by_site(expression, "north", SITES)
    assert "all" in found.own
    assert found.others == {"south": ("all",), "east": ("all",)}
    assert found.every and found.changed


@each(
    ("expression", "words"),
    [
        ("west/alpha", "no site 'west' has been heard; there are: east, north, south"),
        ("*/alpha", "only */all names every site"),
        ("south/", "all vehicles of a site: south/all"),
        ("", "no target given"),
    ],
)
def test_what_names_nothing_is_refused_with_what_there_is(expression: str, words: str) -> None:
    with pytest.raises(TargetError) as error:
        split_by_site(expression, "north", SITES)
    assert words in str(error.value)


def test_a_part_is_read_at_its_site_as_a_daemon_reads_it() -> None:
    rows = [row(3, "carol"), row(1, "alpha", "red"), row(2, "bravo", "red")]
    assert [v.name for v in select_at("south", ["red"], rows)] == ["alpha", "bravo"]
    assert [v.name for v in select_at("south", ["2-9"], rows)] == ["bravo", "carol"]
    assert [v.name for v in select_at("south", ["all"], rows)] == ["alpha", "bravo", "carol"]
    assert select_at("south", ["all"], []) == []
    with pytest.raises(TargetError, match="south: no vehicle 'delta'"):
        select_at("south", ["delta"], rows)


@given(st.text(min_size=1, max_size=40))
def test_a_name_becomes_one_token_of_a_subject_and_comes_back(name: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError:
        return
    token = subject_token(name)
    assert token.isascii() and not set(token) & set(" .*>/\r\n\t")
    assert name_of_token(token) == name


@given(st.text(alphabet="ab=4F2e0.é", max_size=8))
def test_only_what_is_written_so_is_read_as_a_name(token: str) -> None:
    try:
        name = name_of_token(token)
    except ValueError:
        return
    assert subject_token(name) == token
