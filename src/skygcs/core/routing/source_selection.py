"""Selection of the channel that supplies the state of each vehicle that is heard on several.

a vehicle                                        its state comes from
----------------------------------------------   ----------------------------------------------------------------
heard on one channel, and nowhere else before    that channel: it is not in `SourceSelection.sources`
heard on several, or before on another           the one that its `StateSource` selects, frame by frame
heard through a ground station first             the station, until it is heard on a channel of its own
on one channel again for FORGOTTEN_S             that channel: it is removed from ``sources``
on a replayed or a bound channel                 never from there
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from skygcs.core.mavlink.frame import Frame
from skygcs.core.routing.routing_table import Port, RouteNote, RoutingTable
from skygcs.core.routing.state_source import Known, SourceReport, StateSource

FORGOTTEN_S = 10.0
"""A vehicle is on one channel again when no other one has had a frame with its ids for this time."""


class SourceSelection:
    """State sources by sysid<<8|compid, over the channels of one routing table."""

    def __init__(self, table: RoutingTable, vehicle_timeout_s: float) -> None:
        self.sources: dict[int, StateSource] = {}
        """The vehicles that are heard on several channels, or were just now; see `supplies`."""
        self._table = table
        self._vehicle_timeout_s = vehicle_timeout_s
        table.through_station = self._through_station
        # facts and callbacks of the fleet
        self.known: Callable[[int], Known | None] = lambda source: None
        """The last frames of a vehicle whose state is kept; None for any other source."""
        self.on_replaced: Callable[[int], None] = lambda source: None
        """Called when another vehicle has taken a known one's place (or the same one restarted on another channel),
        before its first frame counts."""
        self.on_switched: Callable[[int, int], None] = lambda source, channel_id: None
        """Called when a vehicle's state comes over this channel from now on, which also gets its orders."""
        self.received: Callable[[int, int], tuple[int, int] | None] = lambda channel_id, source: None
        """Frames received and lost of a source on a channel; None: not counted."""

    @property
    def duplicates(self) -> set[int]:
        """Autopilot ids (sysid<<8|compid) that two vehicles use."""
        return {source for source, state in self.sources.items() if state.duplicate}

    # -- channels and frames

    def heard_first(self, port: Port, source: int, now: float) -> None:
        """A channel has frames of a source for the first time: if it is a vehicle that others hear, or that was heard
        before, one of them supplies its state from now on."""
        if source in self.sources or port.policy.replayed:
            return
        on = self._table.by_source.get(source, ())
        others = [p for p in on if p is not port and not p.policy.replayed and not p.bound]
        replayed = any(p.policy.replayed for p in on)  # ground stations echo it
        hearing = [p for p in others if source in p.vehicles and not (replayed and p.policy.role == "gcs")]
        known = self.known(source)
        if hearing:
            before = max(hearing, key=lambda p: p.heard[source])
            lost_s, cost = self._vehicle_timeout_s, before.policy.cost
            state = StateSource(before.id, before.policy.link, known, now, lost_s=lost_s, cost=cost)
        elif known is not None and not others:
            state = StateSource(None, "", known, now, lost_s=self._vehicle_timeout_s)
        else:
            return
        self.sources[source] = state
        self._table.topology_changed(source)

    def found_vehicle(self, port: Port, source: int, now: float) -> None:
        """A source heard on several channels was found to be a vehicle on this one."""
        if source in self.sources or port.policy.replayed or port.bound:
            return
        if any(p is not port and not p.policy.replayed and not p.bound for p in self._table.by_source[source]):
            lost_s, cost = self._vehicle_timeout_s, port.policy.cost
            self.sources[source] = StateSource(port.id, port.policy.link, None, now, lost_s=lost_s, cost=cost)

    def closed(self, channel_id: int) -> None:
        """Forget a channel that is gone."""
        for state in self.sources.values():
            state.closed(channel_id)

    def supplies(self, channel_id: int, frame: Frame, now: float, *, copy_of: int | None) -> bool:
        """True if this frame, of one of `sources`, counts for the vehicle's state; call it after `Router.decide`.
        ``copy_of``: the channel on which it was heard first, if the verdict was DUPLICATE; else None."""
        table = self._table
        port = table.ports[channel_id]
        source = frame.sysid << 8 | frame.compid
        state = self.sources[source]
        if port.policy.replayed or port.bound or frame.info is None:
            return False
        if source in table.heard_directly and port.policy.role == "gcs":
            return False
        counts = state.accepts(channel_id, port.policy.link, frame, now, of=copy_of, cost=port.policy.cost)
        handed_back = not counts and port.policy.role != "gcs" and table.is_station(state.present_id)
        if handed_back and state.is_original(channel_id):
            state.take_over(channel_id, now)
            counts = True
        if state.reports:
            self._report(source, state)
        return counts

    # -- as time passes

    def tick(self, now: float) -> None:
        """Call it about once a second, after routes have expired."""
        for source, state in list(self.sources.items()):
            state.tick(now)
            if state.reports:
                self._report(source, state)
            ports = self._table.by_source.get(source, [])
            alone = not ports or (len(ports) == 1 and ports[0].id == state.present_id)
            if alone and not state.duplicate and now - state.heard_elsewhere_at() > FORGOTTEN_S:
                del self.sources[source]
                self._table.topology_changed(source)

    def choose_links(self, now: float) -> None:
        """Assess the links to each vehicle that is heard on several, and change over to better ones. Call it some times
        a second."""
        for source, state in list(self.sources.items()):
            state.choose(partial(self._received, source), now)
            if state.reports:
                self._report(source, state)

    def uplink_lost(self, source: int) -> None:
        """This vehicle does not hear us over the link that is used; without effect if it is heard on one only."""
        if (state := self.sources.get(source)) is not None:
            state.uplink_lost()

    def links_to_probe(self, now: float) -> list[tuple[int, int]]:
        """Vehicles and channels over which they did not hear us and are to be asked again now."""
        return [(source, i) for source, state in self.sources.items() for i in state.to_probe(now)]

    # -- inside

    def _through_station(self, source: int) -> bool:
        state = self.sources.get(source)
        return state is not None and self._table.is_station(state.present_id)

    def _received(self, source: int, channel_id: int) -> tuple[int, int] | None:
        return self.received(channel_id, source)

    def _report(self, source: int, state: StateSource) -> None:
        """Pass on what a state source has found: to the journal, and to those that depend on the channel."""
        reports, state.reports = state.reports, []
        for report in reports:
            if not report.quiet:
                self._note(source, report)
            if report.kind in ("switched", "replaced"):
                self._table.topology_changed(source)
                self._table.drop_echo_routes(source)
                self.on_switched(source, report.channel_id or 0)
            if report.kind == "replaced":
                self.on_replaced(source)

    def _note(self, source: int, report: SourceReport) -> None:
        note = RouteNote(
            report.kind,
            source >> 8,
            source & 0xFF,
            report.channel_id or 0,
            present_id=report.present_id or 0,
            why=report.why,
            count=report.count,
        )
        self._table.notes.append(note)
