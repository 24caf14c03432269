"""`skygcs import-router MAIN.conf`: a mavlink-router configuration as a fleet file."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from skygcs.config.loader import load_fleet
from skygcs.config.router_import import import_router
from skygcs.errors import ConfigError


def import_router_file(file: Path, output: Path | None, *, force: bool) -> int:
    """The fleet file to ``output`` or stdout, notes to stderr.

    Raises ConfigError for a file that is not one, that exists, or whose links cannot stand side by side in a fleet.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(str(file), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(file), [f"is not UTF-8 text (byte {error.start})"]) from None
    imported = import_router(text, str(file))
    _check(imported.text, file)
    if output is None:
        sys.stdout.write(imported.text)
    else:
        try:
            with open(output, "w" if force else "x", encoding="utf-8") as target:
                target.write(imported.text)
        except FileExistsError:
            raise ConfigError(str(output), ["exists; --force overwrites it"]) from None
        except OSError as error:
            raise ConfigError(str(output), [f"cannot be written: {error.strerror}"]) from None
    for note in imported.notes:
        print(f"note: {note}", file=sys.stderr)
    return 0


def _check(text: str, file: Path) -> None:
    """What is brought over must be a fleet file; two endpoints on one port, say, are none."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fleet.toml"
        path.write_text(text, encoding="utf-8")
        try:
            load_fleet(path)
        except ConfigError as error:
            reason = "its links cannot stand in one fleet file (lines are those of the file it would become):"
            raise ConfigError(str(file), [reason, *error.problems]) from None
