"""``[corrections]`` in the daemon: its source, from the opening of the links to the end, and its status."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from skygcs.config.tables import Problem
from skygcs.errors import LinkError, RefusedError
from skygcs.ext.corrections.caster import CasterSource
from skygcs.ext.corrections.config import CorrectionsConfig, corrections_problems
from skygcs.ext.corrections.feeder import Feeder
from skygcs.ext.corrections.gga import GgaPosition, chosen_place
from skygcs.ext.corrections.methods import Corrections
from skygcs.ext.corrections.receiver import ReceiverSource

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.rpc.context import Services

_GPS = frozenset({"gps"})


class OwnCorrections(Corrections):
    """Takes the corrections of the table's source to the vehicles."""

    Config = CorrectionsConfig
    config: CorrectionsConfig

    def __init__(self, core: Services, config: CorrectionsConfig) -> None:
        super().__init__(core, config)
        self._receiver = None if config.serial is None else ReceiverSource(config, core.now)
        source = self._receiver or CasterSource(config, self._place, core.now)
        self.feeder = Feeder(source, self.feed, core.now, core.event_log.publish, core.fleet.sleep.check)
        self.feed.own_source = self.feeder.status

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        return corrections_problems(config, fleet)

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        files = (("password_file", config.password_file), ("ca_file", config.ca_file))
        notes = [
            f"the file {path} ({key}) does not exist now" for key, path in files if path and not os.path.isfile(path)
        ]
        if config.password_env is not None and not os.environ.get(config.password_env):
            notes.append(f"the environment variable {config.password_env} (password_env) is not set now")
        if config.serial is not None and not os.path.exists(config.serial):
            notes.append(f"the device {config.serial} (serial) is not there now")
        return notes

    def info(self) -> Mapping[str, Any]:
        status = self.feeder.status()
        return {key: status[key] for key in ("kind", "name", "state", "text", "age_s")}

    def announcement(self) -> str:
        return f"from {self.feeder.source.name} (skygcs-cli corrections status)"

    async def run(self) -> None:
        """Keep the source going."""
        await self.feeder.run()

    def woke(self, why: str) -> None:
        super().woke(why)
        self.feeder.woke(why)

    def restart_survey(self) -> dict[str, Any]:
        if self._receiver is None:
            raise RefusedError("the corrections come from a caster: there is no receiver that could survey")
        try:
            self._receiver.restart_survey()
        except LinkError as error:
            raise RefusedError(str(error)) from None
        return self.feeder.status()

    def _place(self, last: str | None) -> GgaPosition | None:
        """The place for a virtual station: a vehicle's, or the fleet's origin as long as none has a fix."""
        now = self.core.now()
        live = [actor for _, actor in sorted(self.core.fleet.vehicles.items()) if not actor.vehicle.replayed]
        fixes = ((actor.name, actor.state(now, _GPS)["gps"] or {}) for actor in live)
        place = chosen_place(fixes, only=self.config.gga_from, last=last)
        origin = self.core.fleet.origin
        if place is None and self.config.gga_from is None and origin is not None:
            return GgaPosition("[origin]", origin.lat_deg, origin.lon_deg, origin.alt_amsl_m)
        return place
