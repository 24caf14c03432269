"""Opening what a person named: never waited for, and nothing but a regular file."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from skygcs.config.files import open_regular
from skygcs.config.param_sets import load_param_set
from skygcs.config.signing import read_key
from skygcs.errors import ConfigError, KeyFileError
from support.table import each


@pytest.fixture(autouse=True)
def _not_for_ever() -> Iterator[None]:
    """What waits for a writer of the pipe is interrupted, and the test fails."""

    def waited(*_: object) -> None:
        raise AssertionError("it waits for the pipe")

    before = signal.signal(signal.SIGALRM, waited)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    path = tmp_path / "pipe"
    os.mkfifo(path, 0o600)
    return path


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"what stands there")
    with open_regular(path) as file:
        assert file.read() == b"what stands there"


@each("name", ["/dev/zero", "/dev/null", "/"])
def test_devices_and_folders_are_none(name: str) -> None:
    with pytest.raises(OSError, match=r"not a regular file|Is a directory"):
        open_regular(Path(name))


def test_a_pipe_is_not_waited_for(pipe: Path) -> None:
    with pytest.raises(OSError, match="not a regular file"):
        open_regular(pipe)
    with pytest.raises(KeyFileError, match="not a regular file"):
        read_key(pipe)
    with pytest.raises(ConfigError, match="not a regular file"):
        load_param_set(pipe)


def test_a_name_with_a_nul_is_none_and_nothing_stays_open(tmp_path: Path, pipe: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    for path in (Path("a\0b"), pipe, tmp_path, tmp_path / "absent"):
        with pytest.raises(OSError):
            open_regular(path)
    assert len(os.listdir("/proc/self/fd")) == before
