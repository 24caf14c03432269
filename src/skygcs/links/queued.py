"""Channels with a queue in front of them: a plain one, or the sender's side of a radio (`paced.AirBudget`)."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from skygcs.core.radio_link.admission import ThirdPartyRules
from skygcs.core.radio_link.pacing import RadioRates
from skygcs.core.radio_link.transmit_queue import Priority, TxQueue
from skygcs.links.base import Channel, Link, Outgoing
from skygcs.links.paced import AirBudget


class QueuedChannel(Channel):
    """What waits is in ``_line``; subclasses `_offer` and `_pop`, which count what was dropped or refused."""

    def __init__(self, link: Link, peer: str, radio: RadioRates | None, third_party: ThirdPartyRules | None) -> None:
        """``radio``: there is one at the other end; ``third_party``: what others may send into it."""
        super().__init__(link, peer)
        self.queue: TxQueue[Outgoing] = TxQueue()
        if radio is not None:
            self.air = AirBudget(self.queue, radio, link.loop.time(), third_party, link.host.dialect)
        self._line: TxQueue[Outgoing] | AirBudget = self.queue if self.air is None else self.air

    def counters(self) -> dict[str, Any]:
        return {**super().counters(), "tx_waiting": len(self._line)}

    def _offer(self, outgoing: Outgoing, priority: Priority, now: float, key: Hashable | None) -> bool:
        """Queue it; False if it was dropped or refused."""
        if self.air is None:
            counters = self.queue.counters[priority]
            lost = counters.dropped + counters.refused
            taken = self.queue.offer(outgoing, priority, now, key)
            self.tx_dropped += counters.dropped + counters.refused - lost
        else:
            taken = self.air.offer(outgoing, priority, now, key, signed=self.signing is not None)
            self.tx_dropped += self.air.take_lost()
        return taken

    def _pop(self, now: float) -> tuple[Outgoing, Priority] | None:
        """What is to be written now; None if nothing waits or the budget is spent."""
        popped = self._line.pop(now)
        if self.air is not None:
            self.tx_dropped += self.air.take_lost()
        return popped
