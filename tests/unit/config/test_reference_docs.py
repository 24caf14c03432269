"""The reference pages name every key there is and show no file that is wrong."""

from __future__ import annotations

import contextlib
import re
import tomllib
from pathlib import Path, PosixPath
from typing import get_args

import pytest
from pydantic import BaseModel

from skygcs.config import control, models, signing, vehicle_tables
from skygcs.config.loader import load_fleet
from skygcs.errors import ConfigError
from support.extension_parts import extension_tables
from support.public_data import ROOT
from support.table import each

PAGE = (ROOT / "docs" / "reference" / "fleet-file.md").read_text()
LINKS = get_args(models.LinkConfig)


@each(
    "model",
    [
        models.DaemonConfig,
        models.OriginConfig,
        models.RateLimits,
        models.LinkCommon,
        *LINKS,
        models.VehicleEntry,
        models.FleetConfig,
        control.ControlSettings,
        control.GainSettings,
        control.ControlFenceSettings,
        control.RawSettings,
        control.TrajectorySettings,
        vehicle_tables.PreflightSettings,
        vehicle_tables.RuleSettings,
        *extension_tables(),
        vehicle_tables.MonitorConfig,
        vehicle_tables.SeparationSettings,
        signing.SigningSettings,
    ],
)
def test_every_key_of_the_fleet_file_is_described(model: type[BaseModel]) -> None:
    keys = {field.alias or key for key, field in model.model_fields.items()} - {"name", *models.NO_TABLES}
    named = set(re.findall(r"`([a-z_0-9]+)`", PAGE)) | {"type"}
    named |= {word for table in re.findall(r"\[([a-z.]+)", PAGE) for word in table.split(".")}
    assert keys <= named, keys - named


def test_every_kind_of_link_has_its_section() -> None:
    assert set(re.findall(r'### type = "(\w+)"', PAGE)) == {m.model_fields["type"].default for m in LINKS}


def section(title: str) -> str:
    """The part of the page below a heading, up to the next one; "" without."""
    return re.sub(r"\n +", " ", re.split(r"\n#+ ", PAGE.partition(f" {title}\n")[2])[0])


def stated(title: str) -> dict[str, object]:
    """Defaults in brackets behind the keys of a section that are values of TOML, not words."""
    found: dict[str, object] = {}
    for item in re.findall(r"^- (.*?)(?:: |$)", section(title), re.M):
        for key, default in re.findall(r"`([a-z_0-9]+)` \(`?([^)]*?)`?\)", item):
            with contextlib.suppress(tomllib.TOMLDecodeError):
                found[key] = tomllib.loads(f"x = {default}")["x"]
    return found


TABLES: dict[str, type[BaseModel]] = {
    "[daemon]": models.DaemonConfig,
    "[links.NAME]": models.LinkCommon,
    **{f'type = "{link.model_fields["type"].default}"': link for link in LINKS},
    **{f"[{model.__name__.removesuffix('Config').lower()}]": model for model in extension_tables()},
}
"""Headings, and the model whose keys are below each; of some models there is no such heading."""


def test_the_defaults_in_brackets_are_those_of_the_models() -> None:
    page, code = {}, {}
    for title, model in TABLES.items():
        for key, default in stated(title).items():
            if (field := model.model_fields.get(key)) is not None:
                page[title, key] = default
                value = field.get_default(call_default_factory=True)
                code[title, key] = {tuple: list, PosixPath: str}.get(type(value), lambda same: same)(value)
    assert len(page) > 70
    assert page == code


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda p: p.name)
def test_toml_on_a_page_passes_the_check(page: Path, tmp_path: Path) -> None:
    (tmp_path / "dialects").symlink_to(ROOT / "dialects")
    for number, text in enumerate(re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL)):
        path = tmp_path / f"{number}.toml"
        path.write_text(text)
        try:
            load_fleet(path)
        except ConfigError as error:  # a page may show some keys of a link without its type
            assert all("has no type" in problem for problem in error.problems), error


KINDS = {
    "RFD900x multipoint": "serial",
    "SiK pair": "serial",
    "XBee": "xbee",
    "ELRS in MAVLink mode": "serial",
    "mLRS": "serial",
    "LTE with WireGuard": "udp_server",
    "Wi-Fi": "udp_server",
}
"""Headings of the page of links, and the kind of link that each one has an example of."""


@each("heading, kind", KINDS.items())
def test_each_link_that_fits_has_an_example_of_its_own(heading: str, kind: str) -> None:
    page = (ROOT / "docs" / "howto" / "links-that-fit.md").read_text()
    section = page.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    examples = "".join(re.findall(r"```toml\n(.*?)```", section, re.DOTALL))
    assert f'type = "{kind}"' in examples
    assert "Good for" in section and f"[{heading.partition(' multi')[0].partition(' pair')[0][:4]}" in page


def test_shares_of_a_link_that_is_slower_than_its_port_leave_half_of_the_air_free() -> None:
    """mLRS' 31 Hz mode carries 2562 B/s down and 2000 B/s up, and its port 5760 B/s."""
    page = (ROOT / "docs" / "howto" / "links-that-fit.md").read_text()
    section = page.partition("\n## mLRS\n")[2].partition("\n## ")[0]
    down, up = (float(re.findall(rf"{key}_share = ([.0-9]+)", section)[0]) for key in ("downlink", "uplink"))
    assert 0.4 < down * 5760 / 2562 < 0.5 and 0.4 < up * 5760 / 2000 < 0.5
