"""Reports the router's notes as events: routes, conflicts, duplicate system ids, signing keys sent in clear."""

from __future__ import annotations

from skygcs.config.checks import endpoint_text
from skygcs.core.routing.routing_table import MAX_CHANNEL_ROUTES, MAX_LINK_ROUTES, RouteNote
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.vehicle_services import OnEvent

_EVENT_KINDS = {
    "conflict": "conflict",
    "out_of_bounds": "warning",
    "crowded": "warning",
    "crowded_over": "warning",
}
"""Kind of event by kind of note; all others are "route"."""

_STATE_EVENT_KINDS = {
    "duplicate": "duplicate",
    "duplicate_over": "duplicate",
    "ignored": "conflict",
    "switched": "route",
    "replaced": "conflict",
}
"""Kind of event by kind of note about the channels that carry a vehicle's state (`core.routing.state_source`)."""


class RouteReports:
    """The hub calls `on_note` and `on_key`. Duplicate system ids are passed on to the fleet."""

    def __init__(self, fleet: Fleet, on_event: OnEvent, route_timeout_s: float) -> None:
        self._fleet = fleet
        self._on_event = on_event
        self._route_timeout_s = route_timeout_s
        self._key_links: set[str] = set()
        """Links on which a signing key was reported."""

    def on_note(self, note: RouteNote, channel: Channel | None, present: Channel | None) -> None:
        """A note of the router about ``channel``; ``present`` is the channel that carries the vehicle's state."""
        if note.kind in _STATE_EVENT_KINDS:
            self._on_state_note(note, channel, present)
            return
        text = self._text(note, channel)
        data = {"change": note.kind, "compid": note.compid}
        self._on_event(Event(_EVENT_KINDS.get(note.kind, "route"), None, note.sysid, text, data))

    def on_key(self, sysid: int, channel: Channel) -> None:
        """A system sent a signing key. Reported once per link: keys are repeated."""
        link = channel.link.name
        if link not in self._key_links:
            self._key_links.add(link)
            text = (
                f"{link} ({channel.peer}): system {sysid} sent a signing key (SETUP_SIGNING); keys are not forwarded: "
                "connect directly, or use skygcs-cli signing setup"
            )
            self._on_event(Event("signing", None, sysid, text, {"link": link}))

    def _on_state_note(self, note: RouteNote, channel: Channel | None, present: Channel | None) -> None:
        key = note.sysid << 8 | note.compid
        there, here = _named(channel), _named(present)
        if note.kind in ("duplicate", "duplicate_over"):
            where = f"its state comes over {here}, the other one sends over {there}"
            self._fleet.set_duplicate(key, where if note.kind == "duplicate" else None)
        data = {"change": note.kind, "compid": note.compid, "link": there, "present": here, "ignored": note.count}
        vehicle = self._fleet.vehicles.get(key)
        name = None if vehicle is None else vehicle.name
        text = _state_text(note, here, there)
        self._on_event(Event(_STATE_EVENT_KINDS[note.kind], name, note.sysid, text, data))

    def _text(self, note: RouteNote, channel: Channel | None) -> str:
        where, source = _named(channel), f"{note.sysid}/{note.compid}"
        match note.kind:
            case "out_of_bounds":
                return _out_of_bounds_text(note, where, channel)
            case "learned":
                return f"{source} heard on {where}"
            case "expired":
                return f"{source} not heard on {where} for {self._route_timeout_s:g} s, route forgotten"
            case "cleared":
                return f"{source} restarted (SYSTEM_TIME went back), its routes are learned anew"
            case "crowded":
                return (
                    f"{where} has no room for a route to {source}: more sources were heard there, or on its link, than "
                    f"the {MAX_CHANNEL_ROUTES} ({MAX_LINK_ROUTES}) that are kept; only autopilots find room, in place "
                    "of others; other links are not affected; allow_from or signing admits known senders only"
                )
            case "crowded_over":
                return f"{where}: the link has room for further routes again"
            case "conflict":
                return (
                    f"{where} sends frames with our own id {source}: they are dropped; "
                    "give one of the two another daemon.sysid or daemon.compid"
                )
        # an echo
        if channel is not None and channel.config.type == "replay":
            return f"{source} in the recording {where} is heard live as well: the recorded one is not shown"
        return f"{where} hands back frames of {source}, which is heard on a link of its own: they are dropped"


def _named(channel: Channel | None) -> str:
    """A channel in messages: its link and the peer's address."""
    return "a closed channel" if channel is None else f"{channel.link.name} ({channel.peer})"


def _state_text(note: RouteNote, here: str, there: str) -> str:
    """Text for a change of a vehicle's channels: ``here`` is the present one, ``there`` the other."""
    ids = f"{note.sysid}/{note.compid}"
    if note.kind == "duplicate":
        return (
            f"two vehicles with system id {note.sysid} are on the air: one over {here}, which supplies its state, "
            f"another over {there} ({note.why}), which is ignored; until that ends it takes only hold, land, rtl and "
            "stop, which go to both, and a confirmed disarm; switch one off and give it another id (PX4: MAV_SYS_ID, "
            "ArduPilot: SYSID_THISMAV)"
        )
    if note.kind == "duplicate_over":
        return f"only one vehicle with system id {note.sysid} is heard any more: it takes all orders again"
    if note.kind == "ignored":
        return (
            f"{note.count} frames with the ids {ids} over {there} contradict the vehicle over {here} ({note.why}): "
            "they are ignored"
        )
    if note.kind == "switched":
        why = f" ({note.why})" if note.why else ""
        more = f"; {note.count} changes since the last report of one were not reported" if note.count else ""
        return f"{ids} is followed over {there} now, before over {here}{why}{more}"
    return (
        f"{ids} is another vehicle now, or has restarted: it is heard over {there}, before over {here}; nothing that "
        "was known of it counts any more"
    )


def _out_of_bounds_text(note: RouteNote, where: str, channel: Channel | None) -> str:
    """Text for a program behind a bound link that addressed another system; in the ids that the program knows."""
    if channel is None or channel.translator is None:
        return f"{where} addressed a system that its link is not bound to"
    translated = channel.translator.translated
    allowed = ", ".join(str(translated(sysid)) for sysid in sorted(channel.translator.vehicles))
    addressed = f"system {translated(note.target)}" if note.target else "all systems (target 0)"
    return (
        f"{where}: {translated(note.sysid)}/{note.compid} addressed {addressed}, and this link is bound to "
        f"{endpoint_text(channel.config)}: dropped, as all such frames; what may be addressed there: {allowed}"
    )
