"""The channel that supplies the state of a vehicle heard on several, and detection of duplicate system ids.

One vehicle may be heard on two channels: it has two radios, two receivers hear one radio, its ground station sends its
frames back, or it came back from another UDP port. Two vehicles may have one system id, and frames may be forged. So
one channel at a time, *the present one*, supplies the state, and orders are sent there:

    another channel ...                                         what becomes of its frames
    --------------------------------------------------------    -----------------------------------------------------
    while the present one is heard                              ignored, except answers to us if the channel agrees
    is the better link (`link_choice`)                          takes over, if it agrees: boot time and position are
                                                                those of the vehicle
    the present one is closed                                   takes over, unless it contradicts
    the present one is silent for the vehicle's timeout         takes over; if it contradicts or cannot be compared, as
                                                                a new start: another vehicle, or the same rebooted
    the present one is a ground station's that sends back       takes over
    what came over this one

    contradicts for CONTRADICTED_S: boot time, position, mode   a duplicate: reported with both channels, orders that do
    or arming state, firmware or type                           not end a flight are refused while it lasts
    the same link, and nothing shows that it is one vehicle     the same
    contradicts for less, without an explanation                reported as ignored

Sequence numbers differ per radio, so a second channel of one vehicle has in general no copies byte by byte: it agrees
by its clock (time_boot_ms) and its position.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

from skygcs.core.geo import distance_m, is_no_place
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import DEFAULT_LOST_S, HIGH_LATENCY_FACTOR, discovers, heartbeat_fields
from skygcs.core.mavlink.modes import SAFETY_ARMED
from skygcs.core.mavlink.msgids import GLOBAL_POSITION_INT, HEARTBEAT, HIGH_LATENCY2, SYSTEM_TIME, TIMESYNC
from skygcs.core.routing.link_choice import DEFAULT_COST, LinkChoice, LinkHealth, best_standby

STATE_CHANNEL_SILENT_S = 2.5
"""Two heartbeats may be lost; what a channel that is silent for longer showed contradicts nothing."""

BOOT_AGREES_S = 3.0
"""Two channels of one vehicle show the same clock except for their delays: a second or two on a multipoint radio. Two
vehicles that were switched on together may agree by this; they then differ in position or state."""

PLACE_MARGIN_M = 10.0
"""Two messages of one estimator differ by its drift; two receivers on one vehicle by GPS noise."""

PLACE_DELAY_S = 1.5
"""Difference of the channels' delays if their clocks cannot be compared; the vehicle may have moved meanwhile."""

PLACE_STEP_S = 0.3
"""Added to the difference of the times where both channels show one clock: positions of the same time differ by the
vehicle's motion between two steps of its estimator."""

ACCELERATION_MPS2 = 5.0
"""Acceleration of a multirotor tilted by 27 degrees."""

PLACE_FRESH_S = 3.0
"""An older position is not compared with another channel's while the present one is heard."""

CONTRADICTED_S = 4.0
"""A mode change shows on a slow link within one or two heartbeats, and a vehicle that moved to another channel is
silent on its old one; a contradiction that lasts longer means two vehicles."""

CONTRADICTIONS = 3
"""Contradicting frames, at least."""

OVER_S = 5.0
"""A duplicate is over after this time without a contradiction: several heartbeats of the slowest link."""

LAG_WINDOW_S = 5.0
"""The least delay of a channel is that of this time, or of up to twice as much: a queue empties now and then."""

LAG_MOST_S = 60.0
"""A larger difference is one of clocks, not of delays."""

MAX_COUNTED = 256
"""Messages counted per channel; a vehicle streams some fifty."""

ECHOED_HEARTBEATS = 3
"""Successive heartbeats that a ground station's channel had only as copies from another channel: then it echoes."""

REPORT_AGAIN_S = 60.0
"""Frames that were ignored are reported at most this often per channel."""

MAX_CHANNELS = 16
"""Channels remembered for one vehicle; the one that agrees least, and was silent for longest, is replaced."""

MAX_STATES = 8

BOOT_MS_AT = {SYSTEM_TIME: 8, 30: 0, 31: 0, 32: 0, GLOBAL_POSITION_INT: 0}
"""Offset of time_boot_ms: SYSTEM_TIME, ATTITUDE, ATTITUDE_QUATERNION, LOCAL_POSITION_NED, GLOBAL_POSITION_INT."""

KNOWN_BY = (HEARTBEAT, HIGH_LATENCY2, *BOOT_MS_AT)

ANSWERS = frozenset({22, 39, 40, 44, 47, 51, 73, 77, 110, 148, 322, 324})
"""Answers: each of them counts, and none is a state. PARAM_VALUE, MISSION_ITEM, MISSION_REQUEST, MISSION_COUNT,
MISSION_ACK, MISSION_REQUEST_INT, MISSION_ITEM_INT, COMMAND_ACK, FILE_TRANSFER_PROTOCOL, AUTOPILOT_VERSION,
PARAM_EXT_VALUE, PARAM_EXT_ACK."""

_WRAP_S = 2**32 / 1000

Contradiction = Literal["boot time", "position", "mode", "firmware", "link"]
ReportKind = Literal["duplicate", "duplicate_over", "switched", "replaced", "ignored"]


@dataclass(frozen=True, slots=True)
class ReportedPosition:
    """A position as reported, with the vehicle's time since boot and the time it came."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    speed_mps: float
    boot_s: float
    at: float


Known = Iterable[tuple[Frame, float]]
"""The last frames of a vehicle, each with the time it came, for comparison when a second channel hears it, or when it
is heard again. (`KNOWN_BY` lists the messages.)"""


@dataclass(frozen=True, slots=True)
class SourceReport:
    """``channel_id`` is the other channel (of switched and replaced: the new one), ``present_id`` the present one (of
    switched and replaced: the one before); None: closed. ``why``: what contradicted, in words; of switched and
    replaced: what was wrong with the channel before. ``count``: frames that were ignored; of switched: earlier changes
    that were not reported. ``quiet``: it took place, and too many were reported lately."""

    kind: ReportKind
    channel_id: int | None
    present_id: int | None
    why: str = ""
    count: int = 0
    quiet: bool = False


class _Heard:
    """View of what one channel shows of the vehicle."""

    __slots__ = (
        "_earliest",
        "_earliest_before",
        "_earliest_from",
        "booted_at",
        "contradicted",
        "contradicted_at",
        "counts",
        "health",
        "heard_at",
        "heartbeat_at",
        "high_latency",
        "identity",
        "ignored",
        "link",
        "only_copies",
        "place",
        "reported_at",
        "shown",
    )

    def __init__(self, link: str, now: float, cost: int = DEFAULT_COST, *, known_good: bool = False) -> None:
        self.link = link
        self.health = LinkHealth(now, cost=cost, known_good=known_good)
        self.counts: dict[int, int] = {}
        """Frames by message id."""
        self.heard_at = now
        self.heartbeat_at = -math.inf
        self.booted_at: float | None = None
        self.place: ReportedPosition | None = None
        self.identity: tuple[int, int] | None = None
        self.shown: tuple[bool, int] | None = None
        self.high_latency = False
        self.only_copies = 0
        self.contradicted: dict[Contradiction, tuple[float, float, int]] = {}
        """Since when, when last, how often."""
        self.contradicted_at = -math.inf
        self.ignored = 0
        self.reported_at = -math.inf
        self._earliest = self._earliest_before = math.inf
        self._earliest_from = now

    def count(self, frame: Frame, now: float) -> None:
        """Count a frame that came."""
        self.heard_at = now
        self.health.heard(now)
        msgid, counts = frame.msgid, self.counts
        if msgid in counts or len(counts) < MAX_COUNTED:
            counts[msgid] = counts.get(msgid, 0) + 1

    @property
    def least_delayed_boot_at(self) -> float:
        """When the vehicle started, in our time, by the message that came with the least delay lately; infinite without
        a clock."""
        return min(self._earliest, self._earliest_before)

    def look(self, frame: Frame, now: float) -> None:
        """Take what this frame shows of its sender."""
        msgid = frame.msgid
        if msgid == HEARTBEAT:
            if discovers(frame):
                custom_mode, vehicle_type, autopilot, base_mode = heartbeat_fields(frame)
                self.heartbeat_at, self.high_latency = now, False
                self.identity = vehicle_type, autopilot
                self.shown = bool(base_mode & SAFETY_ARMED), custom_mode
                self.health.high_latency_factor = 1
            return
        if msgid == HIGH_LATENCY2:
            self.heartbeat_at, self.high_latency = now, True
            self.health.high_latency_factor = HIGH_LATENCY_FACTOR
            return
        if msgid == TIMESYNC:
            if any(frame.payload[:8]):  # tc1: it answers somebody's question, which came over this channel
                self.health.deaf = False
            return
        # when it was booted, by this message: the earliest of a window is least delayed
        at = BOOT_MS_AT.get(msgid)
        if at is None:
            return
        payload = frame.payload.ljust(28, b"\0")
        boot_s = int.from_bytes(payload[at : at + 4], "little") / 1000
        self.booted_at = now - boot_s
        if now - self._earliest_from >= LAG_WINDOW_S:
            self._earliest_from, self._earliest_before, self._earliest = now, self._earliest, math.inf
        self._earliest = min(self._earliest, self.booted_at)
        # where it says that it is
        if msgid == GLOBAL_POSITION_INT:
            lat, lon, alt, _, vx, vy, vz = struct.unpack_from("<iiiihhh", payload, 4)
            if not is_no_place(lat, lon) and abs(lat) <= 900_000_000:
                speed = math.sqrt(vx * vx + vy * vy + vz * vz) / 100
                self.place = ReportedPosition(lat / 1e7, lon / 1e7, alt / 1000, speed, boot_s, now)


class StateSource:
    """The state source of one vehicle (sysid and compid) heard on several channels. Call `accepts` for each frame of it
    and `tick` once a second, and take ``reports`` out."""

    def __init__(
        self,
        present_id: int | None,
        link: str,
        known: Known | None,
        now: float,
        *,
        lost_s: float = DEFAULT_LOST_S,
        cost: int = DEFAULT_COST,
    ) -> None:
        """``present_id``: the channel on which it was heard until now, on that link of this cost; None: that one is
        closed."""
        # the present channel, and the choice between channels
        self.present_id = present_id
        self.choice = LinkChoice()
        self.duplicate = False
        self.reports: list[SourceReport] = []
        self._lost_s = lost_s
        self._heard: dict[int | None, _Heard] = {present_id: _Heard(link, now, cost, known_good=True)}
        self._present = self._heard[present_id]
        # evidence that a channel is of the same vehicle
        self._states: dict[tuple[bool, int], float] = {}
        """Modes and arming states that the present channel showed, and when last."""
        self._unproven: _Heard | None = None
        """The channel before, while the present one has not shown that it is of the same vehicle."""
        # begin with the vehicle's last frames
        last_at = -math.inf
        for frame, at in known or ():
            self._present.look(frame, at)
            last_at = max(last_at, at)
        if present_id is None:
            self._present.heard_at = self._present.health.heard_at = last_at
        if self._present.shown is not None:
            self._note_state(self._present.shown, now)

    # -- frames

    def accepts(
        self,
        channel_id: int,
        link: str,
        frame: Frame,
        now: float,
        *,
        of: int | None = None,
        cost: int = DEFAULT_COST,
    ) -> bool:
        """True if this frame counts for the vehicle's state. ``of``: it is a copy of what came over that channel.
        ``cost``: the link's.

        A takeover has taken place when this returns; see ``reports``.
        """
        heard = self._heard.get(channel_id)
        if heard is None:
            if len(self._heard) >= MAX_CHANNELS:
                self._give_way()
            heard = self._heard[channel_id] = _Heard(link, now, cost)
        heard.count(frame, now)
        if frame.msgid == HEARTBEAT:
            heard.only_copies = 0 if of is None else heard.only_copies + 1
        if of is None or frame.msgid == HEARTBEAT:
            heard.look(frame, now)  # what is only a copy proves nothing of its sender
        if heard is self._present:
            if heard.shown is not None and frame.msgid == HEARTBEAT:
                self._note_state(heard.shown, now)
            if self._unproven is not None and heard.booted_at is not None:
                self._prove(heard)
            return not (of is not None and frame.msgid in ANSWERS and self._answers(of, now))
        self._compare(heard, frame, of, now)
        why = self._may_take_over(channel_id, heard, now)
        if why is not None:
            self._take_over(channel_id, heard, now, why)
            return True
        heard.ignored += 1
        return frame.msgid in ANSWERS and of is None and self._answers(channel_id, now)

    def is_original(self, channel_id: int) -> bool:
        """True if this is the vehicle's own channel, the present one being a ground station's: it hands back what came
        over this one, or this one agrees."""
        heard = self._heard.get(channel_id)
        if heard is None or heard is self._present or heard.heartbeat_at == -math.inf:
            return False
        return self._present.only_copies >= ECHOED_HEARTBEATS or self._agrees(heard)

    def may_be(self, channel_id: int) -> bool:
        """True if nothing shows that this channel hears another vehicle."""
        heard = self._heard.get(channel_id)
        return heard is None or (not heard.contradicted and self._may_be(heard))

    def take_over(self, channel_id: int, now: float) -> None:
        """This channel is the present one from now on."""
        self._take_over(channel_id, self._heard[channel_id], now, "a ground station's link, which returns its frames")

    def closed(self, channel_id: int) -> None:
        """Forget a channel that is gone."""
        if channel_id == self.present_id:
            self._heard[None] = self._heard.pop(channel_id)
            self.present_id = None
        else:
            self._heard.pop(channel_id, None)

    def tick(self, now: float) -> None:
        """Report what time alone brings: a duplicate that is over, ignored frames to report."""
        others = [(c, h) for c, h in self._heard.items() if h is not self._present]
        for channel_id, heard in others:
            for kind, (since, last, count) in list(heard.contradicted.items()):
                if now - last > CONTRADICTED_S:
                    del heard.contradicted[kind]
                    if not self._is_duplicate(since, last, count):
                        self._report_ignored(channel_id, heard, kind, now)
        if self.duplicate and not any(h.contradicted_at > now - OVER_S for _, h in others):
            self.duplicate = False
            self.reports.append(SourceReport("duplicate_over", None, self.present_id))

    def choose(self, received: Callable[[int], tuple[int, int] | None], now: float) -> None:
        """Assess each channel, and change over to a better one; a few times a second. ``received``: frames received and
        lost of this vehicle on a channel."""
        fastest = min((h.least_delayed_boot_at for h in self._heard.values()), default=math.inf)
        for channel_id, heard in self._heard.items():
            counters = None if channel_id is None else received(channel_id)
            if counters is not None:
                heard.health.sample(*counters, now)
            lag_s = heard.least_delayed_boot_at - fastest if math.isfinite(fastest) else math.inf
            heard.health.lag_s = lag_s if lag_s <= LAG_MOST_S else None
            heard.health.assess(now)
        if self.present_id is None:
            return
        better = self.choice.decide(self._present.health, self._standby(), lambda i: self._is_able(i, now), now)
        if better is not None:
            self._take_over(better.channel_id, self._heard[better.channel_id], now, better.why)

    def uplink_lost(self) -> None:
        """The vehicle does not hear us over the present channel."""
        self._present.health.deaf = True

    def stand_in(self, now: float) -> int | None:
        """The channel over which setpoints go as well, because the present one is in doubt; None: over no other."""
        if self.present_id is None or not self._present.health.in_doubt(now):
            return None
        return best_standby(self._standby(), lambda i: self._is_able(i, now))

    def to_probe(self, now: float) -> list[int]:
        """Channels over which to send a TIMESYNC request now: the vehicle did not hear us there."""
        return [i for i, heard in self._heard.items() if i is not None and heard.health.probe_due(now)]

    def _standby(self) -> dict[int, LinkHealth]:
        return {i: h.health for i, h in self._heard.items() if i is not None and h is not self._present}

    def _is_able(self, channel_id: int, now: float) -> bool:
        """True if this channel hears the autopilot, and it is the same vehicle's."""
        heard = self._heard[channel_id]
        hears = now - heard.heartbeat_at <= self._timeout_s(heard)
        return hears and not heard.contradicted and self._agrees(heard)

    def links(self) -> dict[int, LinkHealth]:
        """The health of each channel."""
        return {i: h.health for i, h in self._heard.items() if i is not None}

    def link_status(self, channel_id: int, now: float) -> dict[str, Any]:
        """Return what a person is shown of one of several links: whether it is chosen, since when, and its health.
        ``changes`` counts those of the choice since the vehicle was first heard on several links."""
        link = self.links().get(channel_id)
        if link is None:
            return {}
        chosen = channel_id == self.present_id
        since = self.choice.changed_at if chosen and self.choice.changes else link.since
        return {
            "chosen": chosen,
            "health": link.health.value,
            "since_s": round(now - since, 1),
            "recent_loss": None if link.loss is None else round(link.loss, 4),
            "behind_s": None if link.lag_s is None else round(link.lag_s, 3),
            "deaf": link.deaf,
            "changes": self.choice.changes,
        }

    def counts(self, channel_id: int) -> dict[int, int]:
        """Frames of the vehicle on one channel by message id, copies included."""
        heard = self._heard.get(channel_id)
        return {} if heard is None else heard.counts

    def heard_elsewhere_at(self) -> float:
        """When a channel that is not the present one was heard last."""
        return max((h.heard_at for h in self._heard.values() if h is not self._present), default=-math.inf)

    # -- is it the same vehicle

    def _boot_agrees(self, heard: _Heard) -> bool | None:
        """None: not known of one of the two."""
        if heard.booted_at is None or self._present.booted_at is None:
            return None
        return _same_boot(heard.booted_at, self._present.booted_at)

    def _place_agrees(self, heard: _Heard) -> bool | None:
        """None: not known of one of the two."""
        there, here = heard.place, self._present.place
        if there is None or here is None:
            return None
        if self._boot_agrees(heard):
            within_s = abs(there.boot_s - here.boot_s) + PLACE_STEP_S
        else:
            within_s = abs(there.at - here.at) + PLACE_DELAY_S
        reach_m = PLACE_MARGIN_M + here.speed_mps * within_s + ACCELERATION_MPS2 / 2 * within_s**2
        away_m = distance_m(here.lat_deg, here.lon_deg, there.lat_deg, there.lon_deg)
        return math.hypot(away_m, there.alt_amsl_m - here.alt_amsl_m) <= reach_m

    def _firmware_agrees(self, heard: _Heard) -> bool | None:
        if heard.identity is None or self._present.identity is None:
            return None
        return heard.identity == self._present.identity

    def _agrees(self, heard: _Heard) -> bool:
        """Shown to be the same vehicle."""
        place = self._place_agrees(heard)
        if self._boot_agrees(heard) is not True or self._firmware_agrees(heard) is False:
            return False
        return place is True or (place is None and self._present.place is None)

    def _may_be(self, heard: _Heard) -> bool:
        """Nothing shows that it is another one."""
        return False not in (self._boot_agrees(heard), self._place_agrees(heard), self._firmware_agrees(heard))

    def _answers(self, channel_id: int, now: float) -> bool:
        """True if answers over this channel count as the vehicle's."""
        heard = self._heard.get(channel_id)
        return heard is not None and heard is not self._present and not heard.contradicted and self._agrees(heard)

    # -- takeover

    def _may_take_over(self, channel_id: int, heard: _Heard, now: float) -> str | None:
        """Why this channel, which has just had a frame, takes over at once; None: it does not."""
        if now - heard.heartbeat_at > self._timeout_s(heard):
            return None  # it does not hear the autopilot
        silent_s = now - self._present.heard_at
        if silent_s > self._timeout_s(self._present):
            return f"silent for {silent_s:.1f} s"
        if self.present_id is None:
            return "closed" if self._may_be(heard) else None
        if silent_s <= self._present.health.silent_limit_s or not self._agrees(heard):
            return None
        for link in (self._present.health, heard.health):
            link.assess(now)
        better = self.choice.decide(self._present.health, {channel_id: heard.health}, lambda _: True, now)
        return None if better is None else better.why

    def _timeout_s(self, heard: _Heard) -> float:
        """After how long without a heartbeat the vehicle counts as lost on this channel."""
        return self._lost_s * (HIGH_LATENCY_FACTOR if heard.high_latency else 1)

    def _take_over(self, channel_id: int, heard: _Heard, now: float, why: str) -> None:
        before_id, before = self.present_id, self._present
        same = self._may_be(heard)
        unproven = same and heard.booted_at is None and before.booted_at is not None
        self._unproven = before if unproven else None
        self.present_id, self._present = channel_id, heard
        if before_id is None:
            del self._heard[None]
        for other in self._heard.values():
            other.contradicted.clear()
            other.contradicted_at = -math.inf
        self._states.clear()
        loud = self.choice.changed(now)
        if heard.shown is not None:
            self._note_state(heard.shown, now)
        if same:
            self.reports.append(self._switched(channel_id, before_id, why, loud=loud))
        else:
            self.reports.append(SourceReport("replaced", channel_id, before_id, why))
        if self.duplicate:
            self.duplicate = False
            self.reports.append(SourceReport("duplicate_over", None, channel_id))

    def _switched(self, channel_id: int, before_id: int | None, why: str, *, loud: bool) -> SourceReport:
        if not loud:
            return SourceReport("switched", channel_id, before_id, why, quiet=True)
        count, self.choice.unreported = self.choice.unreported, 0
        return SourceReport("switched", channel_id, before_id, why, count)

    def _prove(self, heard: _Heard) -> None:
        """The present channel took over unseen, and now shows a clock."""
        before, self._unproven = self._unproven, None
        assert before is not None and before.booted_at is not None and heard.booted_at is not None
        if not _same_boot(heard.booted_at, before.booted_at):
            self.reports.append(SourceReport("replaced", self.present_id, None))

    def _give_way(self) -> None:
        """One channel is forgotten."""
        others = [c for c, h in self._heard.items() if h is not self._present]
        del self._heard[min(others, key=lambda c: (self._may_be(self._heard[c]), self._heard[c].heard_at))]

    # -- contradictions

    def _compare(self, heard: _Heard, frame: Frame, of: int | None, now: float) -> None:
        """Note what this frame, which is not of the present channel, contradicts while that one is heard."""
        present = self._present
        if self.present_id is None or now - present.heard_at > STATE_CHANNEL_SILENT_S:
            return
        msgid = frame.msgid
        if msgid == HEARTBEAT:
            if not discovers(frame):
                self._report_ignored(self._id_of(heard), heard, "firmware", now)  # not a second vehicle
            elif self._firmware_agrees(heard) is False:
                self._contradicted(heard, "firmware", now)
            elif heard.shown is not None and heard.shown != present.shown and present.shown is not None:
                self._contradicted(heard, "mode", now)
            elif heard.shown is not None and not self.duplicate and self._agrees(heard):
                heard.contradicted.pop("mode", None)  # a slow link has shown the change, too
            elif of is None and heard.link == present.link and self._agrees_unproven(heard):
                self._contradicted(heard, "link", now)
            return
        if of is not None or msgid not in BOOT_MS_AT:
            return
        if self._boot_agrees(heard) is False:
            self._contradicted(heard, "boot time", now)
        fresh = present.place is not None and now - present.place.at <= PLACE_FRESH_S
        if msgid == GLOBAL_POSITION_INT and fresh and self._place_agrees(heard) is False:
            self._contradicted(heard, "position", now)

    def _agrees_unproven(self, heard: _Heard) -> bool:
        """Neither clock nor place of this channel is known: nothing shows that it is one vehicle."""
        return heard.booted_at is None and heard.place is None

    def _contradicted(self, heard: _Heard, kind: Contradiction, now: float) -> None:
        since, last, count = heard.contradicted.get(kind, (now, now, 0))
        if now - last > CONTRADICTED_S:
            since, count = now, 0
        heard.contradicted[kind] = since, now, count + 1
        heard.contradicted_at = now
        if not self.duplicate and self._is_duplicate(since, now, count + 1):
            self.duplicate = True
            channel_id = self._id_of(heard)
            self.reports.append(SourceReport("duplicate", channel_id, self.present_id, self._why(heard), heard.ignored))

    def _id_of(self, heard: _Heard) -> int | None:
        return next(c for c, h in self._heard.items() if h is heard)

    @staticmethod
    def _is_duplicate(since: float, last: float, count: int) -> bool:
        return last - since >= CONTRADICTED_S and count >= CONTRADICTIONS

    @staticmethod
    def _why(heard: _Heard) -> str:
        kinds = sorted(kind for kind in heard.contradicted if kind != "link")
        return f"{' and '.join(kinds)} differ" if kinds else "nothing shows that both are one"

    def _report_ignored(self, channel_id: int | None, heard: _Heard, kind: Contradiction, now: float) -> None:
        """Frames that contradicted for a moment: of a mode that the vehicle showed as well, it was a delay."""
        explained = kind == "link" or (kind == "mode" and heard.shown in self._states)
        if explained or now - heard.reported_at < REPORT_AGAIN_S:
            return
        heard.reported_at = now
        self.reports.append(SourceReport("ignored", channel_id, self.present_id, kind, heard.ignored))

    def _note_state(self, shown: tuple[bool, int], now: float) -> None:
        if shown not in self._states and len(self._states) >= MAX_STATES:
            del self._states[min(self._states, key=self._states.__getitem__)]
        self._states[shown] = now


def _same_boot(booted_at: float, other: float) -> bool:
    """True if two moments of start, in our time, are of one clock of 32 bits."""
    off_s = (booted_at - other) % _WRAP_S
    return min(off_s, _WRAP_S - off_s) <= BOOT_AGREES_S
