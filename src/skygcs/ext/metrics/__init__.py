"""``[metrics]``: the daemon's numbers for Prometheus, at an HTTP address of its own."""

from __future__ import annotations

import asyncio
import importlib
import os
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from skygcs.config.files import read_token
from skygcs.config.metrics import MetricsConfig
from skygcs.ext.metrics.order_results import OrderResults
from skygcs.extension import Extension
from skygcs.metrics.endpoint import MetricsEndpoint

if TYPE_CHECKING:
    from skygcs.rpc.context import Services


class Metrics(Extension[MetricsConfig]):
    """Serves GET /metrics from the daemon's start to its end."""

    Config = MetricsConfig

    def __init__(self, core: Services, config: MetricsConfig) -> None:
        """Raises ConfigError for a token file that cannot be read."""
        super().__init__(core, config)
        self._orders = OrderResults(core.event_log)
        self.endpoint = MetricsEndpoint(config, read_token("metrics", config.token_file), core.now)

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        notes = []
        if find_spec("prometheus_client") is None:
            notes.append("prometheus_client is not installed here: pip install 'skygcs[metrics]'")
        if config.token_file is not None and not os.path.isfile(config.token_file):
            notes.append(f"the file {config.token_file} (token_file) does not exist now")
        return notes

    def claim(self) -> None:
        """Bind the address. Raises LinkError."""
        self.endpoint.claim()

    async def start(self) -> None:
        """Listen. The collector and prometheus-client take 60 ms to import, beside the loop. Raises LinkError."""
        collector = await asyncio.to_thread(importlib.import_module, "skygcs.ext.metrics.collector")
        await self.endpoint.start(collector.MetricsCollector(self.core, self._orders.counts))

    async def ended(self) -> None:
        """Close the address and the connections of scrapers."""
        await self.endpoint.close()
