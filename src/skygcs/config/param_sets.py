"""Parameter files that simulated vehicles begin with.

Apart from `files`, which every daemon imports: this module brings the parameter tables of the simulated firmwares.
"""

from __future__ import annotations

from pathlib import Path

from skygcs.config.files import open_regular
from skygcs.core.params.param_file import MAX_CHARS, parse
from skygcs.errors import ConfigError
from skygcs.sim.param_set import ParamSet, param_set


def load_param_set(path: Path) -> ParamSet:
    """Raises ConfigError for a file that does not exist, is not text, or belongs to another kind of vehicle."""
    try:
        with open_regular(path) as file:
            raw = file.read(4 * MAX_CHARS + 1)
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(str(path), [error.strerror or str(error)]) from None
    except UnicodeDecodeError:
        raise ConfigError(str(path), ["is not UTF-8 text"]) from None
    return param_set(parse(text, str(path)), str(path))
