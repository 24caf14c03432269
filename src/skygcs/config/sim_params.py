"""Parameter files of simulated vehicles, read when they are powered up."""

from __future__ import annotations

from pathlib import Path

from skygcs.config.regular_file import open_regular
from skygcs.core.params.param_file import MAX_CHARS, parse
from skygcs.errors import ConfigError
from skygcs.sim.param_set import ParamSet, param_set


def load_param_set(path: Path) -> ParamSet:
    """Raises ConfigError, for a person, for a file that is not there, is none, or is of another kind of vehicle."""
    try:
        with open_regular(path) as file:
            raw = file.read(4 * MAX_CHARS + 1)
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(str(path), [error.strerror or str(error)]) from None
    except UnicodeDecodeError:
        raise ConfigError(str(path), ["is no text in UTF-8"]) from None
    return param_set(parse(text, str(path)), str(path))
