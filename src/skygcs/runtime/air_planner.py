"""The message rates of the vehicles behind each radio: planned, requested, measured; and the radio's quality.

A radio here is one channel into it, or all channels of a link whose modules share one air (XBee).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

from skygcs.config.models import SerialLinkConfig, SimulatedLinkConfig, XBeeLinkConfig
from skygcs.config.radio import RadioKeys
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.radio_link.capacity import BITS_PER_BYTE
from skygcs.core.radio_link.pacing import RadioReport
from skygcs.core.radio_link.rate_controller import RateController
from skygcs.core.radio_link.stream_rates import (
    CONTROLLED,
    NORMAL,
    POSITION,
    SELECTED,
    Downlink,
    RateDemand,
    fit,
    plan_bytes_per_s,
    profile_rates,
)
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.source_statistics import LOSS_WINDOW_S
from skygcs.events import Event
from skygcs.links.base import Channel, Link
from skygcs.links.paced import FRAME_OVERHEAD_BYTES, AirBudget
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.link_view import LinkWatch
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent

WAITING_AT_ONCE = 3
"""Most requests in a radio's queue: the next request is chosen late, from the newest measurements."""

RETRY_ROUNDS, ANSWER_S = 1.5, 0.2
"""Time before a command is repeated, in rounds: the command waits for the ground's turn and its answer for the
vehicle's, at most a round each, together one on average. With less, half of all commands would be sent twice on a large
network."""

GONE_AFTER_S = 20.0
"""A vehicle silent for this time leaves the plan, and the others get its share."""

STANDBY_HZ = 0.5
"""Position of a vehicle on a radio while another link carries its telemetry well: with the heartbeat 41 B/s instead of
240 with the nav profile. Place and clock show that the radio still hears the same vehicle, at most 2 s old."""

LOSS_POOR, LOSS_FAIR = 0.25, 0.10
"""Loss of one vehicle's frames over half a minute: reported above the former, and again below the latter."""

TXBUF_POOR, TXBUF_FAIR = 0.15, 0.4
MARGIN_POOR_DB, MARGIN_FAIR_DB = 8.0, 14.0


class _Radio:
    """A channel into a radio with its budget, or a link whose peers share one air, without a budget."""

    def __init__(self, link: Link, air: AirBudget | None) -> None:
        self.link = link
        self.air = air
        self.channels: dict[int, Channel] = {}
        self.downlink = Downlink()
        self.reached: dict[int, int] = {}
        """The channel of each vehicle of the plan."""
        self.demands: dict[int, RateDemand] = {}
        self.reduced: set[int] = set()
        """Vehicles that it only keeps in touch with: another link carries their telemetry."""
        self.budget: tuple[float, float] = (0.0, 0.0)
        """Downlink bytes/s: of all vehicles, and of one (its timeslot)."""
        self.planned: dict[int, dict[str, float]] = {}
        self.turn = 0
        self.unsettled_at = float("-inf")
        """When the last request was pending: losses before that do not count against the plan."""
        self.poor: set[str] = set()
        """Reported as poor: "txbuf", "signal", or a vehicle's name."""
        self.hinted: set[int] = set()


class AirPlanner:
    """Call `tick` once a second and `step`, which sends requests for the vehicles in turn, some ten times a second.
    Vehicles are keyed sysid << 8 | compid."""

    def __init__(self, hub: Hub, fleet: Fleet, watch: LinkWatch, dialect: Dialect, on_event: OnEvent) -> None:
        self.selected: set[int] = set()
        """Vehicles that an operator has selected."""
        self._hub = hub
        self._fleet = fleet
        self._watch = watch
        self._on_event = on_event
        self._bytes = {info.name: info.length + FRAME_OVERHEAD_BYTES for info in dialect.messages.values()}
        self._radios: dict[Hashable, _Radio] = {}
        """By channel, or by the name of a link with one air."""

    def tick(self, now: float) -> None:
        """Plan anew after changes, and assess each radio."""
        self._find_radios()
        for radio in self._radios.values():
            members = self._members(radio, now)
            self._plan(radio, members, now)
            self._judge(radio, members, now)
        for actor in self._fleet.vehicles.values():
            if not self._is_silent(actor, now):
                self._settle_link(actor)

    def _settle_link(self, actor: VehicleActor) -> None:
        """Set the radio that is the chosen link to this vehicle, if one is, and leave radios that lost it."""
        key, streams = actor.vehicle.key, actor.streams
        planned = {radio.reached[key] for radio in self._radios.values() if key in radio.demands}
        chosen = next((n for n in self._hub.channels_to(actor.sysid, actor.compid) if n in planned), None)
        if streams.planned and chosen is None:
            actor.commands.set_min_retry(0.0)
        for channel_id in streams.radios():
            if channel_id not in planned:
                streams.forget_radio(channel_id)
        streams.choose(chosen)

    def step(self, now: float) -> None:
        """Send requests for planned rates that vehicles do not have yet, while few requests wait."""
        if self._hub.router.state_sources:
            self._replan(now)
        for radio in self._radios.values():
            keys = list(radio.planned)
            for offset in range(len(keys)):
                if sum(c.waiting(Priority.PROTOCOL) for c in radio.channels.values()) >= WAITING_AT_ONCE:
                    break
                key = keys[(radio.turn + offset) % len(keys)]
                actor, channel_id = self._fleet.vehicles.get(key), radio.reached[key]
                if actor is not None and actor.streams.ask_on(channel_id, now, self._sender(channel_id)):
                    radio.turn = (radio.turn + offset + 1) % len(keys)
                    break

    def select(self, keys: set[int]) -> None:
        """Give these vehicles, and no others, higher rates from now on."""
        self.selected = keys

    def status(self, now: float) -> list[dict[str, Any]]:
        """Every radio with a budget: uplink and downlink, its vehicles, its history."""
        return [self._status_of(radio, air, now) for radio, air in self._with_budget()]

    def radios(self, now: float) -> list[dict[str, Any]]:
        """`status` without the single vehicles, what others send, and the history: it costs the same for any number
        of vehicles but one sum over them."""
        return [
            {
                "link": radio.link.name,
                "vehicles": len(radio.planned),
                "down": self._down_of(radio),
                "up": air.pacer.status(now),
                "classes": air.queue.status(),
                "poor": len(radio.poor),
            }
            for radio, air in self._with_budget()
        ]

    # -- the inside

    def _find_radios(self) -> None:
        """Note those that have come and forget those that have gone; each with the channels it has now."""
        found: dict[Hashable, dict[int, Channel]] = {}
        for number, channel in self._hub.channels.items():
            if channel.air is not None:
                found[number] = {number: channel}
            elif channel.link.shares_air:
                found.setdefault(channel.link.name, {})[number] = channel
        self._radios = {key: radio for key, radio in self._radios.items() if key in found}
        for key, channels in found.items():
            first = next(iter(channels.values()))
            self._radios.setdefault(key, _Radio(first.link, first.air)).channels = channels

    def _with_budget(self) -> list[tuple[_Radio, AirBudget]]:
        return [(radio, radio.air) for radio in self._radios.values() if radio.air is not None]

    def _sender(self, channel_id: int) -> Callable[[MessageInfo, Mapping[str, Any]], bool]:
        return lambda info, values: self._hub.send_on((channel_id,), info, values, Priority.PROTOCOL)

    def _replan(self, now: float) -> None:
        """Plan anew at once where a vehicle needs a radio more, or less, than it did: the link that carried its
        telemetry is at risk or lost, or carries it well again."""
        for radio in self._radios.values():
            if any(self._is_reduced(radio, key, now) != (key in radio.reduced) for key in radio.demands):
                self.tick(now)
                return

    def _channel_of(self, radio: _Radio, actor: VehicleActor, now: float) -> int | None:
        """The radio's channel over which this vehicle is reached: the chosen link to it, or one on standby."""
        for channel_id in self._hub.channels_to(actor.sysid, actor.compid):
            if channel_id in radio.channels:
                return channel_id
        state = self._hub.router.state_sources.get(actor.vehicle.key)
        for channel_id, link in {} if state is None else state.links().items():
            heard = now - link.heard_at <= GONE_AFTER_S
            if channel_id in radio.channels and heard and state is not None and state.may_be(channel_id):
                return channel_id
        return None

    def _is_reduced(self, radio: _Radio, key: int, now: float) -> bool:
        """True if another link carries this vehicle's telemetry well, and this radio only keeps in touch."""
        state = self._hub.router.state_sources.get(key)
        if state is None or state.present_id is None or state.present_id in radio.channels:
            return False
        return not state.links()[state.present_id].at_risk(now)

    def _is_silent(self, actor: VehicleActor, now: float) -> bool:
        silence_s = actor.vehicle.silence_s(now)
        return silence_s is not None and silence_s > GONE_AFTER_S

    def _members(self, radio: _Radio, now: float) -> dict[int, VehicleActor]:
        """Vehicles that are reached over this radio."""
        return {
            key: actor
            for key, actor in self._fleet.vehicles.items()
            if not actor.vehicle.replayed
            and not self._is_silent(actor, now)
            and self._channel_of(radio, actor, now) is not None
        }

    def _plan(self, radio: _Radio, members: Mapping[int, VehicleActor], now: float) -> None:
        round_s = None
        if radio.air is not None:
            radio.air.set_vehicles(len(members), now)
            round_s = radio.air.pacer.rates.round_s(len(members))
        reached = {k: n for k, actor in members.items() if (n := self._channel_of(radio, actor, now)) is not None}
        for key, actor in members.items():
            if reached[key] in self._hub.channels_to(actor.sysid, actor.compid):
                actor.commands.set_min_retry(0.0 if round_s is None else RETRY_ROUNDS * round_s + ANSWER_S)
        report = self._report_of(radio, now)
        if any(c is not None and not c.settled for c in map(partial(self._controller, radio), members.values())):
            radio.unsettled_at = now
        settled = now - radio.unsettled_at > LOSS_WINDOW_S
        free = None if report is None else report.txbuf_free
        radio.downlink.look(self._loss_of_all(radio, members, now) if settled else None, free, now)
        radio.reduced = {k for k in members if self._is_reduced(radio, k, now)}
        demands = {k: demand for k, actor in members.items() if (demand := self._demand(radio, k, actor)) is not None}
        if radio.air is not None:
            radio.air.third_party.set_unplanned(actor.sysid for k, actor in members.items() if k not in demands)
        budget = self._budget(radio)
        if (demands, budget, reached) == (radio.demands, radio.budget, radio.reached):
            return
        radio.demands, radio.budget, radio.reached = demands, budget, reached
        radio.planned = fit(demands, *budget, self._bytes)
        for key, rates in radio.planned.items():
            members[key].streams.plan(reached[key], rates, self._bytes)

    def _controller(self, radio: _Radio, actor: VehicleActor) -> RateController | None:
        """Controller of this vehicle on this radio; None: it is not in its plan."""
        channel_id = radio.reached.get(actor.vehicle.key)
        return None if channel_id is None else actor.streams.on_radio(channel_id)

    def _budget(self, radio: _Radio) -> tuple[float, float]:
        if radio.air is None:
            config = radio.link.config
            assert isinstance(config, XBeeLinkConfig) and radio.link.bytes_per_s is not None
            total = radio.link.bytes_per_s * config.downlink_share * radio.downlink.factor
            return total, total
        keys, pacer = radio.link.config, radio.air.pacer
        share = keys.downlink_share if isinstance(keys, RadioKeys) else 0.5
        serial = pacer.rates.baud / BITS_PER_BYTE * share * radio.downlink.factor
        round_s = pacer.rates.round_s(pacer.vehicles)
        slot = serial if round_s is None else pacer.rates.slot_bytes / round_s * share * pacer.rates.duty_cycle
        return serial * (pacer.rates.duty_cycle if round_s is None else 1.0), slot * radio.downlink.factor

    def _demand(self, radio: _Radio, key: int, actor: VehicleActor) -> RateDemand | None:
        """The rates that the fleet file demands of it; None (``streams = {}``): none is requested, none turned off."""
        config = radio.link.config
        assert isinstance(config, SerialLinkConfig | SimulatedLinkConfig | XBeeLinkConfig)
        rates = actor.config.streams if config.stream_profile == "custom" else profile_rates(config.stream_profile)
        if not rates:
            return None
        if key in radio.reduced:
            return RateDemand({POSITION: min(STANDBY_HZ, rates.get(POSITION) or STANDBY_HZ)})
        rates = {n: hz for n, hz in rates.items() if hz > 0 and n in self._bytes and self._has(actor, n)}
        if actor.streams.position_hz is not None:
            rates[POSITION] = max(rates.get(POSITION, 0.0), actor.streams.position_hz)
        if actor.offboard.sends_setpoints or actor.streams.position_hz is not None:
            return RateDemand(rates, CONTROLLED)
        return RateDemand(rates, SELECTED if key in self.selected else NORMAL)

    def _has(self, actor: VehicleActor, message: str) -> bool:
        return message != "EKF_STATUS_REPORT" or actor.vehicle.family == "ardupilot"

    def _loss_of(self, radio: _Radio, key: int, now: float) -> float | None:
        heard = self._watch.of(key, now).get(radio.link.name)
        return None if heard is None else heard.loss

    def _loss_of_all(self, radio: _Radio, members: Mapping[int, VehicleActor], now: float) -> float | None:
        losses = [loss for key in members if (loss := self._loss_of(radio, key, now)) is not None]
        return sum(losses) / len(losses) if losses else None

    def _report_of(self, radio: _Radio, now: float) -> RadioReport | None:
        """The newest status report of the radio itself."""
        return radio.air.pacer.last if radio.air is not None and radio.air.pacer.fresh(now) else None

    def _judge(self, radio: _Radio, members: Mapping[int, VehicleActor], now: float) -> None:
        """Report each loss of quality once, and its end."""
        report = self._report_of(radio, now)
        if report is not None:
            text = f"its transmit buffer is {1 - report.txbuf_free:.0%} full: the radio cannot send as much as it gets"
            self._report(radio, "txbuf", report.txbuf_free < TXBUF_POOR, report.txbuf_free > TXBUF_FAIR, text, None)
        margins = [f.margin_db for key in members if (f := self._watch.of(key, now).get(radio.link.name))]
        known = [margin for margin in margins if margin is not None]
        if known:
            text = f"its signal is only {min(known):.0f} dB above the noise"
            self._report(radio, "signal", min(known) < MARGIN_POOR_DB, min(known) > MARGIN_FAIR_DB, text, None)
        for key, actor in members.items():
            loss = self._loss_of(radio, key, now)
            if loss is not None:
                text = f"{loss:.0%} of its frames are lost"
                self._report(radio, actor.name, loss > LOSS_POOR, loss < LOSS_FAIR, text, actor)
            self._hint(radio, key, actor)

    def _report(self, radio: _Radio, what: str, poor: bool, fair: bool, text: str, actor: VehicleActor | None) -> None:
        link = radio.link.name
        name, sysid = (None, None) if actor is None else (actor.name, actor.sysid)
        data = {"link": link, "what": what if actor is None else "loss"}
        if poor and what not in radio.poor:
            radio.poor.add(what)
            self._on_event(Event("link_degraded", name, sysid, f"radio {link}: {text}", data))
        elif fair and what in radio.poor:
            radio.poor.discard(what)
            fine = "is heard well again" if actor is not None else f"{what} is well again"
            self._on_event(Event("link_recovered", name, sysid, f"radio {link}: {fine}", data))

    def _hint(self, radio: _Radio, key: int, actor: VehicleActor) -> None:
        """Report streams that a vehicle does not stop on request; its parameters have to be changed."""
        controller = self._controller(radio, actor)
        unresponsive = controller.unresponsive() if controller is not None and key not in radio.hinted else []
        if not unresponsive:
            return
        radio.hinted.add(key)
        wasted = sum(hz * self._bytes.get(name, 0) for name, hz in unresponsive)
        names = ", ".join(f"{name} {hz:.2g} Hz" for name, hz in unresponsive[:4])
        how = (
            "lower its port's SRx_ parameters"
            if actor.vehicle.family == "ardupilot"
            else "set its port's profile to Minimal (MAV_0_MODE = 7) and lower its rate (MAV_0_RATE)"
        )
        text = f"still streams messages that it was requested to stop ({names}; {wasted:.0f} B/s of the radio): {how}"
        self._on_event(Event("warning", actor.name, actor.sysid, text, {"link": radio.link.name}))

    def _down_of(self, radio: _Radio) -> dict[str, float]:
        """The downlink of all vehicles of a radio: budget, plan and measure."""
        total, each = radio.budget
        planned = sum(plan_bytes_per_s(rates, self._bytes) for rates in radio.planned.values())
        return {
            "budget_bytes_per_s": round(total, 1),
            "per_vehicle_bytes_per_s": round(each, 1),
            "planned_bytes_per_s": round(planned, 1),
            "measured_bytes_per_s": round(
                sum(s.bytes_per_s for c in radio.channels.values() for s in c.sources.values()), 1
            ),
            "factor": round(radio.downlink.factor, 2),
        }

    def _status_of(self, radio: _Radio, air: AirBudget, now: float) -> dict[str, Any]:
        (channel,) = radio.channels.values()
        planned = {k: plan_bytes_per_s(rates, self._bytes) for k, rates in radio.planned.items()}
        # each vehicle of the plan
        vehicles = []
        for key, rates in radio.planned.items():
            actor = self._fleet.vehicles.get(key)
            if actor is None:
                continue
            stats = channel.sources.get(key)
            trip = actor.streams.round_trip_s()
            vehicles.append(
                {
                    "name": actor.name,
                    "sysid": actor.sysid,
                    "weight": radio.demands[key].weight,
                    "planned_bytes_per_s": round(planned[key], 1),
                    "measured_bytes_per_s": None if stats is None else round(stats.bytes_per_s, 1),
                    "loss": self._loss_of(radio, key, now),
                    "round_trip_s": None if trip is None else round(trip, 3),
                    "settled": (controller := self._controller(radio, actor)) is None or controller.settled,
                    "standby": key in radio.reduced,
                    "scaled": any(hz > rates.get(n, 0.0) for n, hz in radio.demands[key].rates_hz.items()),
                    "streams": actor.streams.status(radio.reached[key]),
                }
            )
        # the radio as a whole
        return {
            "link": radio.link.name,
            "peer": channel.peer,
            "vehicles": vehicles,
            "down": self._down_of(radio),
            "up": air.status(now),
            "poor": sorted(radio.poor),
            "history": [report.as_dict(now) for report in list(air.pacer.history)[-60:]],
        }
