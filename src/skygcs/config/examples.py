"""The example fleet files that come with skygcs, and a copy of one that stands by itself."""

from __future__ import annotations

import re
from pathlib import Path

from skygcs.errors import ConfigError

SUFFIX = ".toml"

HUB = "hub.toml"
"""An example of several stations is a folder with one of these, and a fleet file for each station."""


def examples_dir() -> Path:
    """Inside the package when installed, at the project's top in a checkout."""
    packaged = Path(__file__).parent.parent / "configs"
    return packaged if packaged.is_dir() else Path(__file__).parents[3] / "configs"


def scenarios() -> dict[str, str]:
    """Names of the examples, and the first line of each: what it is for, in one sentence or more."""
    found = {}
    for path in sorted(examples_dir().glob(f"*{SUFFIX}")):
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        found[path.stem] = first.removeprefix("#").strip()
    for path in sorted(examples_dir().glob(f"*/{HUB}")):
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        found[path.parent.name] = first.removeprefix("#").strip()
    return found


def station_texts(scenario: str) -> dict[str, str] | None:
    """Names and texts of the files of an example of several stations, as they stand together in a folder of their own;
    None for an example that is one fleet file."""
    folder = examples_dir() / scenario
    if scenario not in scenarios() or not folder.is_dir():
        return None
    found = {}
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        text = path.read_text(encoding="utf-8")
        text = text.replace(f"configs/{scenario}/", "").replace(f"up configs/{scenario}", "up")
        found[path.name] = text.replace(f"../../build/{scenario}/", "")
    return found


def example_text(scenario: str, file_name: str) -> str:
    """The example as it stands alone under ``file_name``: its logs beside it. Raises ConfigError for a name that no
    example has."""
    path = examples_dir() / f"{scenario}{SUFFIX}"
    if scenario not in scenarios():
        raise ConfigError("init", [f"there is no scenario {scenario!r}; there are: {', '.join(scenarios())}"])
    text = path.read_text(encoding="utf-8")
    text = text.replace(f"configs/{path.name}", file_name).replace("configs/", "")
    text = re.sub(r'"\.\./logs/[^"]*"', '"logs"', text)
    return re.sub(r'"\.\./tests/data/[^"]*"', '"flight.tlog"', text)
