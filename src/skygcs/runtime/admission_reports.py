"""Reports, once each, what a radio does not carry of programs' traffic: to the log, to subscribers, to its sender."""

from __future__ import annotations

from skygcs.config.models import DaemonConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.radio_link.admission import Note
from skygcs.core.radio_link.admission_frames import MAX_HZ
from skygcs.core.radio_link.capacity import BITS_PER_BYTE, HALF_DUPLEX_SHARE
from skygcs.core.radio_link.transmit_queue import OwnMessage, Priority
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.links.paced import AirBudget
from skygcs.runtime.hub import Hub
from skygcs.runtime.vehicle_services import OnEvent

LOG_BYTES = 10e6
"""Size of a short flight's log, for the example in the text."""

TEXT_BYTES = 50
"""Length of a STATUSTEXT without chunks."""

WARNING, INFO = 4, 6
"""MAV_SEVERITY."""


class AdmissionReports:
    """`tick` once a second."""

    def __init__(self, hub: Hub, own: DaemonConfig, dialect: Dialect, on_event: OnEvent) -> None:
        self._hub = hub
        self._own = own
        self._dialect = dialect
        self._on_event = on_event

    def tick(self, now: float) -> None:
        """Report the admission decisions since the last call."""
        for channel in tuple(self._hub.channels.values()):
            air = channel.air
            if air is None:
                continue
            air.third_party.own_sysid = self._own.sysid if self._own.heartbeat else None
            while air.third_party.notes:
                self._report(air.third_party.notes.popleft(), channel, air, now)

    def _report(self, note: Note, channel: Channel, air: AirBudget, now: float) -> None:
        link = channel.link.name
        clients = self._clients(note.source)
        where = f" ({', '.join(c.peer for c in clients)})" if clients else ""
        sender = f"{note.source >> 8}/{note.source & 0xFF}{where}"
        text = f"radio {link}: {sender} {self._sentence(note, link, air, now)}"
        name = self._name(note.msgid)
        data = {
            "link": link,
            "what": note.kind,
            "source": f"{note.source >> 8}/{note.source & 0xFF}",
            "target": note.target,
            "message": name,
        }
        self._on_event(Event("third_party", None, note.target or None, text, data))
        self._answer(clients, note, name)

    def _sentence(self, note: Note, link: str, air: AirBudget, now: float) -> str:
        name, key = self._name(note.msgid), f"links.{link}.third_party"
        target = f"vehicle {note.target}" if note.target else "all vehicles"
        match note.kind:
            case "streams":
                return (
                    f"asks {target} for streams ({name}): not sent, as skygcs plans the streams of this radio; "
                    f'change their streams in the fleet file or by skygcs-cli interval, or set {key}.streams = "allow"'
                )
            case "logs":
                rate = _down_bytes_per_s(air)
                return (
                    f"asks {target} for logs ({name}): not sent; at the {rate:.0f} B/s that one vehicle can send, "
                    f"10 MB take {LOG_BYTES / rate / 3600:.1f} h; fetch it by cable or from the card, or set "
                    f'{key}.logs = "allow"'
                )
            case "param_lists":
                how = "name one vehicle after the other" if not note.target else "ask for single parameters"
                return f'asks {target} for all parameters: not sent; {how}, or set {key}.param_lists = "allow"'
            case "files":
                return f'asks {target} for files: not sent, since {key}.files is "deny"'
            case "turn":
                other = air.third_party.files.running(now)
                return (
                    f"asks {target} for files while those of {other or 'another'} come: not sent until asked again "
                    f'then, as one vehicle at a time sends files; {key}.files = "allow" sends for all at once'
                )
            case "rate":
                return f"sends {name} to {target}: not sent, since {key}.rates.{name} is 0"
            case "thinned":
                allowed = self._allowed_hz(note.msgid, air)
                return (
                    f"sends {name} at {note.hz:.2g} Hz, of which {allowed:g} Hz go into the radio; send less of it, or "
                    f"raise {key}.rates.{name}"
                )
            case _:
                running = air.third_party.lists.running
                first = "" if running is None else f" ({_progress(running)})"
                return (
                    f"asks for the parameters of vehicle {note.target} while another's list is under way{first}: it "
                    f'waits, as one list at a time is sent for; {key}.param_lists = "allow" sends for all at once'
                )

    def _answer(self, clients: list[Channel], note: Note, name: str) -> None:
        """Send a short text on the client's own channel, unless the client sees only its vehicle there.

        It is sent as a component with our id in the addressed vehicle's system: QGroundControl shows texts of vehicles
        only. (MAVProxy shows only those of autopilots, and we do not pretend to be one.)
        """
        info = self._dialect.by_name.get("STATUSTEXT")
        if info is None:
            return
        text, severity = {
            "streams": ("streams are planned here: request not sent", WARNING),
            "logs": ("no log downloads over this radio", WARNING),
            "param_lists": ("parameter list refused on this radio", WARNING),
            "rate": (f"refused on this radio: {name}", WARNING),
            "files": ("no file transfers over this radio", WARNING),
            "turn": (f"files of {note.target} wait: one vehicle at a time", INFO),
            "thinned": (f"slowed down on this radio: {name}", INFO),
        }.get(note.kind, (f"parameters of {note.target} wait: one list at a time", INFO))
        payload = info.pack({"severity": severity, "text": text[:TEXT_BYTES]})
        message = OwnMessage(info, payload, note.target or self._own.sysid, self._own.compid)
        for channel in clients:
            if channel.translator is None:
                channel.send(message, Priority.PROTOCOL)

    def _clients(self, source: int) -> list[Channel]:
        """The channels that carry this source, except those of vehicles."""
        channels = (self._hub.channels[n] for n in self._hub.router.channels_of(source) if n in self._hub.channels)
        return [c for c in channels if c.air is None and c.config.role != "vehicle" and c.config.type != "replay"]

    def _name(self, msgid: int) -> str:
        info = self._dialect.messages.get(msgid)
        return str(msgid) if info is None else info.name

    def _allowed_hz(self, msgid: int, air: AirBudget) -> float:
        return air.rules.rates_hz.get(msgid, MAX_HZ.get(msgid, 0.0))


def _down_bytes_per_s(air: AirBudget) -> float:
    """Upper limit of one vehicle's rate: its timeslot, or half of the serial rate."""
    rates = air.pacer.rates
    round_s = rates.round_s(air.pacer.vehicles)
    serial = rates.baud / BITS_PER_BYTE * HALF_DUPLEX_SHARE
    return serial if round_s is None else min(serial, rates.slot_bytes / round_s)


def _progress(running: tuple[int, int, int]) -> str:
    system, seen, count = running
    return f"{system}'s: {seen} of {count}" if count else f"{system}'s, of which nothing has come yet"
