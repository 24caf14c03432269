"""Reading files that the fleet file or a command names: never a pipe or device, which would stop the daemon."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from skygcs.core.params.param_file import MAX_CHARS, parse
from skygcs.errors import ConfigError
from skygcs.sim.param_set import ParamSet, param_set


def open_regular(path: Path) -> BinaryIO:
    """The file, open for reading. Raises OSError, also for what is no regular file.

    Opening a named pipe waits until a program writes to it: the loop, and with it the daemon, would stop. A
    device such as /dev/zero has no end.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except ValueError as error:  # a NUL within the name
        raise OSError(errno.EINVAL, str(error)) from None
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "is not a regular file")
        return open(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def load_param_set(path: Path) -> ParamSet:
    """Raises ConfigError for a file that does not exist, is no text, or belongs to another kind of vehicle."""
    try:
        with open_regular(path) as file:
            raw = file.read(4 * MAX_CHARS + 1)
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(str(path), [error.strerror or str(error)]) from None
    except UnicodeDecodeError:
        raise ConfigError(str(path), ["is not UTF-8 text"]) from None
    return param_set(parse(text, str(path)), str(path))
