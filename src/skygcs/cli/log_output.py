"""Files that offline tools write: all of them whole, or none of them there."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import IO, Any

from skygcs.errors import SkygcsError

PART_SUFFIX = ".part"
"""Of a file while it is written."""


class Outputs:
    """Files are written beside their place and moved there at the end of the ``with`` block, if it ends well."""

    def __init__(self, force: bool) -> None:
        self._force = force
        self._open: dict[Path, IO[Any]] = {}

    def __enter__(self) -> Outputs:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        problem: SkygcsError | None = None
        for path, file in self._open.items():
            try:
                file.close()
            except OSError as full:  # what was buffered goes to the disk only now
                problem = SkygcsError(f"{path}: {full.strerror or full}")
        for path in self._open:
            if kind is None and problem is None:
                _part(path).replace(path)
            else:
                _part(path).unlink(missing_ok=True)
        if kind is None and problem is not None:
            raise problem

    @property
    def paths(self) -> list[Path]:
        return list(self._open)

    def open_bytes(self, path: Path) -> IO[bytes]:
        """A new file. Raises SkygcsError if it cannot be made, or is there and may not be overwritten."""
        return self._opened(path, "wb")

    def open_text(self, path: Path) -> IO[str]:
        """The same for text (UTF-8, line ends as written)."""
        return self._opened(path, "w", encoding="utf-8", newline="")

    def _opened(self, path: Path, mode: str, **more: Any) -> IO[Any]:
        if path.is_dir():
            raise SkygcsError(f"{path}: is a folder; name a file in it")
        if path.exists() and not self._force:
            raise SkygcsError(f"{path}: exists; --force overwrites it")
        try:
            file: IO[Any] = open(_part(path), mode, **more)  # noqa: SIM115 - closed by __exit__
        except OSError as error:
            raise SkygcsError(f"{path}: {error.strerror or error}") from None
        self._open[path] = file
        return file


def make_folder(path: Path) -> None:
    """Raises SkygcsError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None


def _part(path: Path) -> Path:
    return path.with_name(path.name + PART_SUFFIX)
