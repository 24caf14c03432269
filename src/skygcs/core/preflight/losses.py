"""Recent loss of a source. The counters of `core/routing/source_statistics.py` count since the link was opened."""

from __future__ import annotations

from collections import deque

WINDOW_S = 30.0
SAMPLE_S = 1.0
LEAST_FRAMES = 20
"""With fewer frames a single lost one is 5 % or more."""


class LossWindow:
    """Call `sample` once a second with the counters of one source, which may restart at any time. Bounded memory."""

    __slots__ = ("_marks",)

    def __init__(self) -> None:
        self._marks: deque[tuple[float, int, int]] = deque(maxlen=int(WINDOW_S / SAMPLE_S) + 1)

    def sample(self, frames: int, lost: int, now: float) -> None:
        if self._marks and frames < self._marks[-1][1]:
            self._marks.clear()
        self._marks.append((now, frames, lost))

    def frames(self) -> int:
        """Frames received within the window."""
        return self._marks[-1][1] - self._marks[0][1] if self._marks else 0

    def loss(self) -> float | None:
        """Lost / (received + lost), 0..1; None with fewer than LEAST_FRAMES."""
        frames = self.frames()
        if frames < LEAST_FRAMES:
            return None
        lost = max(0, self._marks[-1][2] - self._marks[0][2])
        return lost / (frames + lost)
