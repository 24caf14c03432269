"""The failsafes' conditions of one vehicle: since when each holds, and whether it has gone off."""

from __future__ import annotations


class ConditionTimer:
    """One condition and since when it holds."""

    __slots__ = ("_since", "raised", "raised_at")

    def __init__(self) -> None:
        self._since: float | None = None
        self.raised = False
        self.raised_at: float | None = None
        """When it went off last."""

    def check(self, bad: bool, now: float, after_s: float = 0.0) -> bool:
        """True at the one moment when it has been bad for ``after_s``."""
        if not bad:
            self._since = None
            self.raised = False
            return False
        if self._since is None:
            self._since = now
        if self.raised or now - self._since < after_s:
            return False
        self.raised = True
        self.raised_at = now
        return True


class Failsafes:
    """The alarms of one vehicle; anew with every boot."""

    __slots__ = (
        "battery_critical",
        "battery_emergency",
        "battery_low",
        "crash",
        "fence",
        "gcs",
        "gcs_heard_at",
        "position",
        "setpoints",
    )

    def __init__(self) -> None:
        self.position = ConditionTimer()
        self.battery_low = ConditionTimer()
        self.battery_critical = ConditionTimer()
        self.battery_emergency = ConditionTimer()
        self.gcs = ConditionTimer()
        self.fence = ConditionTimer()
        self.crash = ConditionTimer()
        self.setpoints = ConditionTimer()
        self.gcs_heard_at: float | None = None
        """None: never; a vehicle that has never had a ground station does not miss it."""

    def gcs_lost(self, now: float, timeout_s: float) -> bool:
        """True at the moment the ground station has been silent for too long."""
        heard = self.gcs_heard_at
        return self.gcs.check(heard is not None and now - heard > timeout_s, now)
