"""Plans that come in parts, because a line of the socket has 1 MiB and a show of a hundred vehicles more."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

from skygcs.core.plan.file_reading import MAX_FILE_BYTES
from skygcs.errors import RefusedError

MAX_PART_CHARS = 400_000
"""Inside JSON each character may become two bytes, or six; a line has 1 MiB."""

MAX_UPLOADS = 4
"""At the same time, of all clients: 128 MiB at most."""

KEPT_S = 60.0
"""After its last part. A part takes a fraction of a second, over the slowest network a few seconds."""


@dataclass(slots=True)
class _Upload:
    last_at: float
    parts: list[bytes] = field(default_factory=list)
    size: int = 0


class PlanUploads:
    """Uploads to one daemon. Times are the loop's."""

    def __init__(self) -> None:
        self._uploads: dict[int, _Upload] = {}
        self._numbers = itertools.count(1)

    def add(self, number: int | None, part: str, now: float) -> tuple[int, int]:
        """Append a part, to a new upload if ``number`` is None: its number, and how many bytes it has by now.

        Raises RefusedError: too many, too large, unknown or too old.
        """
        self._drop_old(now)
        if number is None:
            if len(self._uploads) >= MAX_UPLOADS:
                raise RefusedError(
                    f"{MAX_UPLOADS} plans are being uploaded already: try again in a minute, or load one of them"
                )
            number = next(self._numbers)
            self._uploads[number] = _Upload(now)
        upload = self._known(number)
        data = part.encode(errors="replace")  # a lone surrogate is no text; the reader of plans refuses it
        if upload.size + len(data) > MAX_FILE_BYTES:
            del self._uploads[number]
            raise RefusedError(f"a plan has at most {MAX_FILE_BYTES >> 20} MiB; upload {number} is dropped")
        upload.parts.append(data)
        upload.size += len(data)
        upload.last_at = now
        return number, upload.size

    def take(self, number: int, now: float) -> bytes:
        """All of an upload, which is used up by that. Raises RefusedError."""
        self._drop_old(now)
        upload = self._known(number)
        del self._uploads[number]
        return b"".join(upload.parts)

    def __len__(self) -> int:
        return len(self._uploads)

    def _known(self, number: int) -> _Upload:
        upload = self._uploads.get(number)
        if upload is None:
            raise RefusedError(
                f"there is no upload {number}: it was used, or had no part for {KEPT_S:g} s; begin it again without one"
            )
        return upload

    def _drop_old(self, now: float) -> None:
        for number in [n for n, upload in self._uploads.items() if now - upload.last_at > KEPT_S]:
            del self._uploads[number]
