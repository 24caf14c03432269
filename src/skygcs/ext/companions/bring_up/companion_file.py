"""The configuration of one companion, from a file for it alone or from one for all."""

from __future__ import annotations

import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

from skygcs.errors import CompanionError, ConfigError
from skygcs.ext.companions.bring_up.inventory import Companion

FOLDER = "companions"
FOR_ALL = "companion.toml"
MAX_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class CompanionFile:
    """The text for one companion, checked. ``source`` is the file it came from."""

    source: Path
    text: str

    def key_dir(self, home: str, folder: str) -> str:
        """The folder of its keys, if the file lies in ``folder`` of the companion."""
        given = str(tomllib.loads(self.text)["companion"].get("key_dir", "keys"))
        if given.startswith("~/"):
            return home + given[1:]
        return given if given.startswith("/") else f"{folder}/{given}"


def companion_file(companion: Companion, fleet_folder: Path, given: Path | None = None) -> CompanionFile:
    """The file of this companion: ``given``, else companions/NAME.toml beside the fleet file, else companion.toml.

    ``${name}``, ``${vehicle}`` and ``${sysid}`` in it are replaced by the companion's. Raises CompanionError.
    """
    own = fleet_folder / FOLDER / f"{companion.name}.toml"
    source = given if given is not None else own if own.exists() else fleet_folder / FOR_ALL
    try:
        with source.open("rb") as file:
            text = file.read(MAX_BYTES + 1).decode("utf-8")
    except FileNotFoundError:
        todo = f"write {own}, or {fleet_folder / FOR_ALL} for all: docs/howto/companion.md"
        raise CompanionError("configure", f"there is no {source}", todo) from None
    except (OSError, UnicodeDecodeError) as error:
        raise CompanionError("configure", f"{source} cannot be read: {error}") from None
    if len(text) > MAX_BYTES:
        raise CompanionError("configure", f"{source} is larger than {MAX_BYTES} bytes")
    for key, value in (("name", companion.name), ("vehicle", companion.vehicle), ("sysid", str(companion.sysid))):
        text = text.replace(f"${{{key}}}", value)
    _check(companion, source, text)
    return CompanionFile(source, text)


def _check(companion: Companion, source: Path, text: str) -> None:
    from skygcs.config.loader import load_fleet
    from skygcs.ext.companions.companion_table import companion_table

    with tempfile.TemporaryDirectory(prefix="skygcs-") as folder:
        draft = Path(folder) / source.name
        draft.write_text(text, encoding="utf-8")
        try:
            config = load_fleet(draft)
        except ConfigError as error:
            raise CompanionError("configure", f"{source}: {'; '.join(error.problems)}", "correct it") from None
    table = companion_table(config)
    if table is None:
        raise CompanionError("configure", f"{source} has no table [companion]", "add it: docs/howto/companion.md")
    if table.vehicle != companion.vehicle:
        reason = f"{source} is for vehicle {table.vehicle}, {companion.name} is on {companion.vehicle}"
        raise CompanionError("configure", reason, 'write vehicle = "${vehicle}"')
    sysid = config.vehicles[table.vehicle].sysid
    if sysid != companion.sysid:
        reason = f"{source} gives {companion.vehicle} system id {sysid}, the fleet file {companion.sysid}"
        raise CompanionError("configure", reason, "write sysid = ${sysid}")
