"""The clock of a station: seconds that go on while the computer sleeps, and unix seconds that never step."""

from __future__ import annotations

import time

from skygcs.config.files import boot_s


class SiteClock:
    """`now_s` for everything within the process, `site_s` for what other sites are sent.

    `boot_s`: a laptop that slept for an hour must not take what it had for new. ``site_s`` is the wall clock when
    the process began, and goes on like that: a correction of the wall clock would make every age jump. Sites measure
    the difference of their clocks with pings.
    """

    def __init__(self) -> None:
        self._began_s = self.now_s()
        self._began_unix_s = time.time()

    def now_s(self) -> float:
        """Monotonic."""
        return boot_s()

    def site_s(self) -> float:
        """Unix seconds."""
        return self._began_unix_s + (self.now_s() - self._began_s)
