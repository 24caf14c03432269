"""The sender's side of a channel into a radio: its queue, a budget that follows the radio's reports, and the share of
third-party traffic."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace
from typing import Any

from skygcs.config.radio import ThirdPartyKeys
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import CRC_BYTES, HEADER_V2_BYTES, SIGNATURE_BYTES, Frame, check
from skygcs.core.mavlink.msgids import FILE_TRANSFER_PROTOCOL, GPS_RTCM_DATA, PARAM_VALUE
from skygcs.core.radio_link.admission import CORRECTIONS_SHARE, AdmissionDecision, ThirdPartyRules, ThirdPartyTraffic
from skygcs.core.radio_link.admission_frames import Kind, ThirdPartyFrame
from skygcs.core.radio_link.capacity import RadioRates
from skygcs.core.radio_link.corrections import Corrections
from skygcs.core.radio_link.pacing import Pacer, report_of
from skygcs.core.radio_link.transmit_queue import Outgoing, OwnMessage, Priority, TxQueue
from skygcs.core.routing.source_statistics import RADIO_SOURCE
from skygcs.core.token_bucket import TokenBucket

FRAME_OVERHEAD_BYTES = HEADER_V2_BYTES + CRC_BYTES
"""Header and checksum of MAVLink 2, unsigned."""

_PARAM_COUNT_AT, _PARAM_INDEX_AT = 4, 6
"""Offsets in a PARAM_VALUE (common.xml)."""


class AirBudget:
    """The sender's side of one channel into a radio: its queue, what fills it, and its budget.

    `offer`, `pop` and `next_send_time` take the place of the queue's own. `refresh` about once a second, `on_radio` for
    every report of its radio, `heard` for what comes from it.
    """

    def __init__(
        self,
        queue: TxQueue[Outgoing],
        rates: RadioRates,
        now: float,
        rules: ThirdPartyRules | None = None,
        dialect: Dialect | None = None,
    ) -> None:
        """``dialect``: without it nothing is known of what others send, and all of it is alike."""
        self.queue = queue
        self.pacer = Pacer(rates)
        self.rules = rules or ThirdPartyRules()
        rate = self.pacer.rate(now)
        self._messages: Mapping[int, MessageInfo] = {} if dialect is None else dialect.messages
        self.third_party = ThirdPartyTraffic(self.rules, rate, now)
        self.corrections = Corrections(self._corrections_rate(rate), now)
        self._corrections_info = None if dialect is None else dialect.by_name.get("GPS_RTCM_DATA")
        self._signed = False
        self.on_due: Callable[[], object] = lambda: None
        """Called when what came down has made something due that `next_send_time` promised for later."""
        self._lost = 0
        queue.budget = TokenBucket(rate, self.pacer.burst_bytes(), now)
        queue.forwarded = self.third_party.budget

    # -- up

    def offer(
        self, outgoing: Outgoing, priority: Priority, now: float, key: Hashable | None = None, *, signed: bool = False
    ) -> bool:
        """Queue it, or have it wait until its turn; False if it was dropped or refused."""
        if type(outgoing) is bytes and priority is Priority.FORWARDED:
            frame, _ = check(outgoing, self._messages)
            return frame is not None and self._offer_third_party(frame, now)
        if isinstance(outgoing, Frame):
            return self._offer_third_party(outgoing, now)
        self._signed = signed
        size = wire_bytes(outgoing, signed=signed)
        if isinstance(outgoing, OwnMessage):
            if outgoing.info.msgid == GPS_RTCM_DATA:
                return self.corrections.offer(outgoing.sysid << 8 | outgoing.compid, outgoing.payload, now)
            return self._put(outgoing, priority, now, key, size, flow_of(outgoing))
        return self._put(outgoing, priority, now, key, size, 0)

    def pop(self, now: float) -> tuple[Outgoing, Priority] | None:
        """Return what is to be written now; see `TxQueue.pop`."""
        if (released := self.third_party.poll(now)) is not None:
            self._put_third_party(*released, now)
        if not self.queue.waiting(Priority.CORRECTION):  # one at a time: which is next is decided as late as can be
            self._put_correction(now)
        return self.queue.pop(now)

    def next_send_time(self, now: float) -> float | None:
        """Time at which to call `pop` again, if nothing more is offered; None: not before something is."""
        times = [self.queue.next_send_time(now), self.third_party.next_poll(now)]
        if not self.queue.waiting(Priority.CORRECTION):
            times.append(self.corrections.next_send_time(now))
        return min((at for at in times if at is not None), default=None)

    def clear(self) -> int:
        """Forget everything that waits (the link went down); how many that were."""
        return self.queue.clear() + self.third_party.clear() + self.corrections.clear()

    def take_lost(self) -> int:
        """Entries that were dropped or refused because too many wait, since the last call."""
        lost, self._lost = self._lost, 0
        return lost

    def __len__(self) -> int:
        """Return what waits, here or in the queue."""
        return len(self.queue) + self.third_party.waiting + len(self.corrections)

    # -- what the radio says

    def set_baud(self, baud: int, now: float) -> None:
        """Another rate of the serial port was found to be right."""
        self.pacer.rates = replace(self.pacer.rates, baud=baud)
        self.refresh(now)

    def set_vehicles(self, count: int, now: float) -> None:
        """So many are heard behind this radio."""
        self.pacer.vehicles = count
        self.refresh(now)

    def on_radio(self, frame: Frame, sent_bytes: int, now: float) -> None:
        """A RADIO_STATUS or RADIO that came over this channel; ``sent_bytes`` is all that was written to it."""
        if (frame.sysid, frame.compid) == RADIO_SOURCE and self.pacer.on_report(
            report_of(frame.fields(), now), sent_bytes
        ):
            self.refresh(now)

    def heard(self, frames: list[Frame], now: float) -> None:
        """Frames that came over this channel."""
        for frame in frames:
            if frame.msgid == PARAM_VALUE:
                payload = frame.payload.ljust(_PARAM_INDEX_AT + 2, b"\0")
                count = int.from_bytes(payload[_PARAM_COUNT_AT:_PARAM_INDEX_AT], "little")
                index = int.from_bytes(payload[_PARAM_INDEX_AT : _PARAM_INDEX_AT + 2], "little")
                self.third_party.on_param_value(frame.sysid, frame.compid, index, count, now)
                if (at := self.third_party.next_poll(now)) is not None and at <= now:
                    self.on_due()
            elif frame.msgid == FILE_TRANSFER_PROTOCOL:
                self.third_party.on_file_part(frame.sysid, now)

    def refresh(self, now: float) -> None:
        budget = self.queue.budget
        assert budget is not None
        rate = self.pacer.rate(now)
        budget.set_rate(rate, now)
        budget.set_burst(self.pacer.burst_bytes(), now)
        self.third_party.set_rate(rate, now)
        self.corrections.set_rate(self._corrections_rate(rate), now)

    def status(self, now: float) -> dict[str, Any]:
        """Return what the radio bears up, what it reports, how each class fares, and what others send."""
        return {
            **self.pacer.status(now),
            "classes": self.queue.status(),
            "third_party": self.third_party.status(now),
            "corrections": self.corrections.status(),
        }

    # -- the inside

    def _corrections_rate(self, rate: float) -> float:
        own = self.rules.corrections_bytes_per_s
        return CORRECTIONS_SHARE * rate if own is None else min(own, rate)

    def _offer_third_party(self, frame: Frame, now: float) -> bool:
        decision = self.third_party.judge(frame, now, self.queue.holds)
        match decision.outcome:
            case "send":
                return self._put_third_party(frame, decision, now)
            case "correction":
                return self.corrections.offer(frame.sysid << 8 | frame.compid, frame.payload, now)
            case "wait":
                return True
            case "refuse":
                return False

    def _put_correction(self, now: float) -> None:
        """Queue the next fragment, under the ids of its base."""
        info = self._corrections_info
        fragment = None if info is None else self.corrections.pop(now)
        if info is not None and fragment is not None:
            message = OwnMessage(info, info.pack(fragment.values), fragment.source >> 8, fragment.source & 0xFF)
            size = wire_bytes(message, signed=self._signed)
            self.corrections.charge(size, now)
            self._put(message, Priority.CORRECTION, now, None, size, 0)

    def _put_third_party(self, frame: Frame, decision: AdmissionDecision, now: float) -> bool:
        size, priority = len(frame.raw), decision.priority
        if priority is Priority.EMERGENCY:
            self._drop_orders_before(frame)
        if priority is not Priority.FORWARDED and self.queue.offer(
            frame, priority, now, decision.key, size=size, flow=decision.flow
        ):
            return True
        # also if its class is full: no sender here repeats it
        return self._put(frame, Priority.FORWARDED, now, decision.key, size, decision.flow, decision.answer_bytes)

    def _drop_orders_before(self, stop: Frame) -> None:
        """Drop what others ordered of a vehicle before it was stopped: it must not reach the vehicle afterwards."""
        stopped = stop.target()[0]

        def is_outdated(entry: Outgoing) -> bool:
            if not isinstance(entry, Frame) or stopped not in (0, entry.target()[0]):
                return False
            return ThirdPartyFrame.of(entry).kind is Kind.ORDER

        self._lost += self.queue.drop(Priority.COMMAND, is_outdated) + self.queue.drop(Priority.FORWARDED, is_outdated)

    def _put(
        self,
        entry: Outgoing,
        priority: Priority,
        now: float,
        key: Hashable | None,
        size: int,
        flow: Hashable,
        answer_bytes: int = 0,
    ) -> bool:
        counters = self.queue.counters[priority]
        before = counters.dropped + counters.refused
        taken = self.queue.offer(entry, priority, now, key, size=size, flow=flow, answer_bytes=answer_bytes)
        self._lost += counters.dropped + counters.refused - before
        return taken


def third_party_rules(keys: ThirdPartyKeys, dialect: Dialect) -> ThirdPartyRules:
    """Return what a link's [third_party] table says. Raises KeyError for a message name the dialect does not have."""

    def msgid(name: str) -> int:
        return int(name) if name.isdecimal() else dialect.find(name).msgid

    return ThirdPartyRules(
        keys.param_lists,
        keys.files,
        keys.streams,
        keys.logs,
        {msgid(name): hz for name, hz in keys.rates.items()},
        keys.bytes_per_s,
        keys.corrections_bytes_per_s,
    )


def wire_bytes(outgoing: Outgoing, *, signed: bool) -> int:
    """How long it is on the wire; of a message of ours, in MAVLink 2."""
    if type(outgoing) is bytes:
        return len(outgoing)
    if isinstance(outgoing, Frame):
        return len(outgoing.raw)
    assert isinstance(outgoing, OwnMessage)
    trimmed = len(outgoing.payload.rstrip(b"\0")) or 1
    return FRAME_OVERHEAD_BYTES + trimmed + SIGNATURE_BYTES * signed


def flow_of(message: OwnMessage) -> int:
    """The system that a message of ours is for: 0 is everybody."""
    at = message.info.target_system_offset
    return message.payload[at] if 0 <= at < len(message.payload) else 0
