"""Plans in the daemon: what keeps, checks and flies the fleet's one plan, and the queue of requests to make one."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from skygcs.ext.plans.methods import METHODS
from skygcs.ext.plans.plan_runner import PlanRunner
from skygcs.ext.plans.planning.planning_queue import PlanningQueue
from skygcs.ext.plans.planning.process import PlanningProcesses
from skygcs.extension import Extension, NoTable

if TYPE_CHECKING:
    from skygcs.rpc.context import Services


class Plans(Extension[NoTable]):
    """Plans of one fleet: it is the `PlanKeeper` of the fleet's `PlanPlace` once it is made."""

    own_methods = METHODS

    def __init__(self, core: Services, config: NoTable) -> None:
        super().__init__(core, config)
        loop = asyncio.get_running_loop()
        self.processes = PlanningProcesses()
        self.queue = PlanningQueue(loop, self.processes.compute)
        self.runner = PlanRunner(core.fleet, self.processes.call, loop, core.event_log.publish)
        if core.stopping:
            self.runner.end()

    def registered(self) -> None:
        self.core.fleet.plans.keeper = self.runner

    def close(self) -> None:
        self.queue.close()
        self.runner.close()

    async def ended(self) -> None:
        await self.processes.close()
