"""Entry points of installed packages: whatever one has written, those of the others are found."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from skygcs.config.extension_tables import GROUP, ON_DEMAND, installed, installed_points, on_demand, word_problems
from skygcs.ext.corrections.extension import OwnCorrections
from skygcs.extension import Extension
from skygcs.web.file_checks import CHECKS, EXTENSION_CHECKS, extension_checks

Install = Callable[[str, str | bytes], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Packages before all others on the path of imports, by name and the text of their entry points."""
    caches = (on_demand, extension_checks)

    def new(name: str, text: str | bytes) -> None:
        folder = tmp_path / f"{name}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (folder / "entry_points.txt").write_bytes(text if isinstance(text, bytes) else text.encode())
        for cache in caches:
            cache.cache_clear()

    monkeypatch.syspath_prepend(tmp_path)
    yield new
    for cache in caches:
        cache.cache_clear()


def test_the_standard_reader_finds_the_same() -> None:
    for group in (GROUP, ON_DEMAND, EXTENSION_CHECKS):
        assert set(installed_points(group).points.values()) == set(entry_points(group=group))
        assert installed_points(group).problems == ()


@pytest.mark.parametrize(
    "text",
    ["[skygcs.on_demand]\nkite\n", "[skygcs.on_demand]\nkite = a:b\n\n\n= \nx\n", b"[skygcs.on_demand]\n\xff = a:b\n"],
)
def test_a_package_that_cannot_be_read_hides_no_other(install: Install, text: str | bytes) -> None:
    before = dict(on_demand()), installed(), dict(extension_checks())
    install("broken", text)
    assert (dict(on_demand()), installed(), dict(extension_checks())) == before
    (problem,) = installed_points(ON_DEMAND).problems
    assert "cannot be read" in problem


def test_a_malformed_package_of_other_groups_is_none_of_ours(install: Install) -> None:
    install("elsewhere", "[console_scripts]\nnothing\n")
    assert "plan" in on_demand() and installed_points(ON_DEMAND).problems == ()


def test_a_word_of_the_core_stays_its_own(install: Install) -> None:
    install("usurper", "[skygcs.on_demand]\nplan = usurper:Plans\nkite = usurper:Kite\n")
    assert on_demand()["plan"].value == "skygcs.ext.plans.extension:Plans"
    assert on_demand()["kite"].value == "usurper:Kite"
    (problem,) = installed_points(ON_DEMAND).problems
    assert "plan is skygcs.ext.plans.extension:Plans" in problem and "usurper:Plans is not used" in problem


@pytest.mark.parametrize("part", [("undo", ()), ("kite", ("params",))])
def test_a_table_takes_no_word_of_the_methods_that_come_on_demand(part: tuple[str, tuple[str, ...]]) -> None:
    """They would be missing, or two would answer to one word."""
    name, names = part
    (problem,) = word_problems({name: type("Own", (Extension,), {"names": names}), "kites": Extension})
    assert problem == f"[{name}]: methods that begin with {(*names, name)[0]} are skygcs' own"


def test_a_table_of_ours_takes_the_place_of_what_is_made_without_it() -> None:
    assert "corrections" in on_demand() and "corrections" in installed()
    assert word_problems({"corrections": OwnCorrections}) == []


def test_a_check_of_the_page_takes_no_method_of_the_page(install: Install) -> None:
    names = ["web.hello", "web.subscribe", "vehicles.arm", "web.kite.check", next(iter(CHECKS))]
    install("pages", "[skygcs.page_checks]\n" + "".join(f"{name} = pages:check\n" for name in names))
    added = {name for name, point in extension_checks().items() if point.value == "pages:check"}
    assert added == {"web.kite.check"}
