"""A simulated vehicle: what PX4 and ArduCopter have in common. `px4` and `ardupilot` hold their differences.

Pure: frames go in through `on_frame`, come out of `step`; time is an argument, chance is seeded. What happens is
worked out on a fixed grid of TICK_S, so that it does not depend on how often `step` is called.
"""

from __future__ import annotations

from collections.abc import Iterable

from skygcs.core.mavlink.frame import Frame
from skygcs.sim import flight, requests, telemetry
from skygcs.sim.vehicle_state import TICK_S, VehicleState

MAX_CATCH_UP_S = 60.0
"""A `step` after a longer pause (a suspended laptop) skips what is older: 3000 ticks take a tenth of a second."""


class SimVehicle(VehicleState):
    """One vehicle, component 1 of the system its parameters name.

    It boots at ``now``; ``unix_us`` is the wall clock of that moment.

    Feed every received frame to `on_frame` (it ignores what is not for it) and call `step` often; each returned
    frame is one datagram or one write. After `on_frame`, the answers come out of the next `step`.
    """

    def on_frame(self, frame: Frame, now: float) -> None:
        """Take one received frame; answers come with the next `step`. Never raises on what a sender can do wrong."""
        if (
            now < self.boot_at
            or self.faults.deaf
            or frame.info is None
            or (frame.sysid, frame.compid) == (self.sysid, self.compid)
            or not self.signing.hears(frame)
        ):
            return
        system, component = frame.target()
        if system not in (0, self.sysid) or component not in (0, self.compid):
            return
        requests.handle(self, frame.info.name, frame.fields(), (frame.sysid, frame.compid), now)
        self._flush()

    def step(self, now: float) -> list[bytes]:
        """Live on until ``now``; the frames that were due, in order."""
        if now - self._clock > MAX_CATCH_UP_S:
            self._clock = now - MAX_CATCH_UP_S
        while self._clock + TICK_S <= now + 1e-9:
            self._clock += TICK_S
            self._tick(self._clock)
        return self.tx.take()

    def skip_to(self, at: float) -> None:
        """Leave out what has not been lived through before ``at``: the vehicle stood still meanwhile."""
        self._clock = max(self._clock, at)

    def begin_telemetry(self) -> Iterable[str]:
        self.builders = dict(telemetry.builders_of(self.autopilot))
        known = self.dialect.by_name
        named = {name: {field.name for field in known[name].fields} for name in self.builders if name in known}
        self._clocks = {name: telemetry.BOOT_CLOCKS.keys() & fields for name, fields in named.items()}
        return self.builders

    def send_message(self, name: str, now: float) -> bool:
        builder = self.builders.get(name)
        if builder is None or name not in self._clocks:
            return False
        fields = builder(self, now)
        if fields is not None:
            clocks = {clock: self.boot_ms * telemetry.BOOT_CLOCKS[clock] for clock in self._clocks[name]}
            self.tx.send(name, clocks | fields, self.tail_of(name))
        return True

    def _tick(self, now: float) -> None:
        if self.faults.reboot:
            self.faults.reboot = False
            self.reboot(now)
        if now < self.boot_at:
            self.motion.step(TICK_S, None, self.limits())  # the autopilot is off, the vehicle falls on
            return
        if self._rebooting:
            self._boot(now)
        while self._later and self._later[0][0] <= now:
            self._later.pop(0)[1]()
        self._watch_position(now)
        self._follow_home(now)
        self.on_tick(now)
        flight.step(self, now, TICK_S)
        requests.step(self, now)
        for name in self.streams.due(now):
            self.send_message(name, now)
        self._flush()
