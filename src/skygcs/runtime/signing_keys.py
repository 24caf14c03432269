"""The signing keys of the links, their clocks on disk, and reports of refused frames.

A key has one clock for all its links, and one table of streams, so that frames recorded on one link cannot be replayed
on another. Links of one group carry copies of the same frames on purpose: each of them has a table of its own.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from skygcs.cancellation import carried_through
from skygcs.config.files import read_state, write_whole
from skygcs.config.models import LinkConfig
from skygcs.config.signing import EVERY_MESSAGE, read_key
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.signing import (
    MAX_AHEAD_S,
    MAX_TIMESTAMP,
    TICKS_PER_S,
    Gate,
    SignatureStreams,
    SignatureVerdict,
    SigningClock,
    is_signed_with,
    key_id,
    sign,
    timestamp_at,
    timestamp_of,
    unix_time_of,
)
from skygcs.disk_writer import CLOSE_S, DiskWriter
from skygcs.errors import KeyFileError, RefusedError
from skygcs.events import Event
from skygcs.links.base import Channel

FORMAT = 1

AFTER_CRASH_S = 60.0
"""Added to a loaded clock: stamps up to this far may have been used since the last save. Clocks are saved every 10 s,
and at once after a larger jump; ArduPilot uses a minute, too."""

MAX_FILE_BYTES = 4096

LOCK_TRIES, LOCK_EVERY_S = 20, 0.02
"""Another program holds the folder for a few writes of the disk."""


def default_state_dir() -> Path | None:
    """$XDG_STATE_HOME/skygcs/signing, by default below ~/.local/state; None for a user without a home."""
    base = os.environ.get("XDG_STATE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ".local" / "state"
    except RuntimeError:
        return None
    return folder / "skygcs" / "signing"


class Kept(NamedTuple):
    """The saved clock of a key."""

    timestamp: int
    """The stamp to go on from, later than any that was used."""
    wall: int
    """This computer's clock at that time; 0 in older files."""


class Saved(NamedTuple):
    """The content of a key's file."""

    timestamp: int
    wall: int
    exact: bool
    """No later stamp was used before it is loaded."""

    def kept(self) -> Kept:
        margin = 0 if self.exact else int(AFTER_CRASH_S * TICKS_PER_S)
        return Kept(min(self.timestamp + margin, MAX_TIMESTAMP), self.wall)


def _saved(table: Any) -> Saved:
    """Decode a file, for `read_state`."""
    if table["format"] != FORMAT:
        raise ValueError(f"format {table['format']}")
    timestamp, wall = (min(max(int(time), 0), MAX_TIMESTAMP) for time in (table["timestamp"], table.get("wall", 0)))
    return Saved(timestamp, wall, bool(table["exact"]))


class SigningStore:
    """One file per key, named by its id and without the key. ``problems``: why the last access failed, by key id, of
    the keys of which it did; ``shared``: ids of keys that another program on this computer saves as well.

    The time in a file never goes back, whichever daemon writes it: if two use one key, the later time counts.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._known: dict[str, Saved | None] = {}
        """By key id: content of its file as it was read or written here last."""
        self.shared = set[str]()
        self._lock_tries = LOCK_TRIES
        self.problems = {} if folder is not None else {"": "there is no folder for the clocks of the keys"}

    def load(self, key_id: str) -> Kept:
        """The saved clock of a key; zeros without a file."""
        if self._folder is None:
            return Kept(0, 0)
        path, saved = self._path(key_id), None
        try:
            saved = read_state(path, MAX_FILE_BYTES, _saved)
        except FileNotFoundError:
            pass
        except (OSError, ValueError) as error:
            self.problems[key_id] = f"{path} cannot be read ({error})"
        self._known[key_id] = saved
        return Kept(0, 0) if saved is None else saved.kept()

    def save(self, key_id: str, timestamp: int, *, wall: int, exact: bool, back: bool = False) -> None:
        """Save it atomically; ``exact``: no later stamp will be used before the next `load`; ``back``: also if that of
        another program is later."""
        if self._folder is None:
            return
        path, saved = self._path(key_id), Saved(timestamp, wall, exact)
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with self._alone(self._folder):
                there = _there(path)
                if there is not None and there != self._known.get(key_id):
                    self.shared.add(key_id)
                    if not back:
                        later = max(timestamp, there.timestamp), max(wall, there.wall)
                        saved = Saved(*later, exact=False)  # the other one goes on
                write_whole(path, json.dumps({"format": FORMAT, **saved._asdict()}).encode(), 0o600)
                self._known[key_id] = saved
        except OSError as error:
            self.problems[key_id] = f"{path} cannot be written ({error.strerror})"
        else:
            self.problems.pop(key_id, None)

    @contextmanager
    def _alone(self, folder: Path) -> Iterator[None]:
        """Other programs wait meanwhile with what they save in this folder. One that stands still in it is waited for
        once; while it does, and on a file system without locks, the block runs all the same. Raises OSError."""
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            tries, self._lock_tries = self._lock_tries, 1
            for left in reversed(range(tries)):
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(LOCK_EVERY_S if left else 0.0)
                except OSError:
                    break
                else:
                    self._lock_tries = LOCK_TRIES
                    break
            yield
        finally:
            os.close(handle)

    def _path(self, key_id: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{key_id}.json"


def _there(path: Path) -> Saved | None:
    """The content of a file; None for one that is missing or damaged."""
    try:
        return read_state(path, MAX_FILE_BYTES, _saved)
    except (OSError, ValueError):
        return None


MAX_REPORTED = 64
"""Kinds of refused frames of one link (verdict and source) that are reported, each once; all are counted."""

SAVE_EVERY_S = 10.0
"""Period of saving the clocks; the signing guide requires once a minute."""

_KEPT_OUT = {
    SignatureVerdict.UNSIGNED: (
        "is not signed: give its sender the key (skygcs-cli signing setup, over a cable) or name the message in "
        "accept_unsigned"
    ),
    SignatureVerdict.FORGED: ("is signed with another key than this link's, or was changed on its way"),
    SignatureVerdict.REPLAYED: (
        "is not newer than its sender's last one: a copy, a replay, or overtaken by a later one; links "
        "that carry the same vehicles belong in one group"
    ),
    SignatureVerdict.STALE: (
        "is {behind_s:.0f} s older than others' signatures: played from a recording, or its sender's clock is "
        "behind and will follow ours as soon as it hears us"
    ),
    SignatureVerdict.AHEAD: (
        "is stamped {ahead} ahead of this computer's clock ({now}), and nothing follows it: set this computer's "
        "clock if that is wrong (a computer without a battery for its clock starts with an old time); else the "
        "sender's is: give a vehicle its key again over a cable (skygcs-cli signing setup), set another "
        "station's clock; links.{link}.signing.max_ahead_s allows for more"
    ),
    SignatureVerdict.CROWDED: ("comes from one sender too many"),
}

OnRefused = Callable[[Frame, SignatureVerdict], None]


@dataclass(slots=True)
class _Key:
    """A key in use: its clock and how much of it is on disk."""

    secret: bytes = field(repr=False)
    clock: SigningClock
    saved: int
    pinned: bool = False
    """`Signing.is_pinned`, as it was reported last."""

    @property
    def id(self) -> str:
        return key_id(self.secret)


class LinkSigning:
    """One link's key and rules, and the state that its channels share."""

    def __init__(self, config: LinkConfig, key: _Key, gate: Gate, wall: Callable[[], int]) -> None:
        assert config.signing is not None
        self.config = config
        self.settings = config.signing
        self.key = key
        self.gate = gate
        self.wall = wall
        self.reported: set[tuple[SignatureVerdict, int]] = set()


class _ChannelSigning:
    """Fulfils `links.base.ChannelSigning` for one channel."""

    def __init__(
        self, link: LinkSigning, on_refused: Callable[[LinkSigning, Channel, Frame, SignatureVerdict], None]
    ) -> None:
        self._link = link
        self._on_refused = on_refused
        self._counts = dict.fromkeys(SignatureVerdict, 0)
        self._sent = 0

    def admit(self, channel: Channel, frames: list[Frame]) -> list[Frame]:
        check = self._link.gate.check
        counts = self._counts
        wall = self._link.wall()
        admitted = []
        for frame in frames:
            verdict = check(frame, wall)
            counts[verdict] += 1
            if verdict is SignatureVerdict.SIGNED or verdict is SignatureVerdict.ALLOWED:
                admitted.append(frame)
            else:
                self._on_refused(self._link, channel, frame, verdict)
        return admitted

    def sign(self, raw: bytes, info: MessageInfo) -> bytes:
        link = self._link
        if not link.settings.sign_outgoing:
            return raw
        self._sent += 1
        stamp = link.key.clock.stamp(link.wall())
        return sign(raw, info.crc_extra_byte, link.key.secret, link.settings.link_id, stamp)

    def counters(self) -> dict[str, int]:
        return {verdict.value: count for verdict, count in self._counts.items()} | {"sent_signed": self._sent}


def why_silent(heartbeat: Frame | None, links: Iterable[LinkConfig]) -> str:
    """Why a vehicle with this newest heartbeat may not answer over these links, as the end of a sentence: it signs, and
    we do not. "" otherwise."""
    links = list(links)
    unsigned = [link.name for link in links if link.signing is None or not link.signing.sign_outgoing]
    if heartbeat is None or not heartbeat.signed or not unsigned or len(unsigned) < len(links):
        return ""
    name = unsigned[0]
    return (
        f"; it signs its messages and drops those that are not signed with its key, and link {name} signs none: "
        f"give it that key (links.{name}.signing)"
    )


class Signing:
    """Call `prepare` for each link before it opens and `attach` for each channel; `run` runs as long as the daemon."""

    def __init__(
        self,
        dialect: Dialect,
        on_event: Callable[[Event], None],
        store: SigningStore,
        unix_s: Callable[[], float] = time.time,
    ) -> None:
        self.disk: DiskWriter | None = None
        """Saves the clocks beside the loop; without one they are not saved."""
        self._dialect = dialect
        self._on_event = on_event
        self._store = store
        self._unix_s = unix_s
        self._keys: dict[bytes, _Key] = {}
        self._links: dict[str, LinkSigning] = {}
        self._streams: dict[tuple[bytes, str | None], SignatureStreams] = {}
        self._watchers: list[OnRefused] = []
        self._store_failed = set[str]()
        self._shared = set[str]()
        """Keys of which it is reported that another program signs with them."""

    # -- links

    def prepare(self, config: LinkConfig) -> None:
        """Read the link's key. Raises KeyFileError and then keeps the link's earlier key."""
        if config.signing is None or not config.enabled:
            self.forget(config.name)
            return
        try:
            key = self.key_of(read_key(config.signing.key_file))
        except KeyFileError as error:
            raise KeyFileError(error.path, f"{error.reason} (links.{config.name}.signing)") from None
        self._require_own_link_id(config, key)
        scope = config.name if config.group is not None else None
        streams = self._streams.setdefault((key.secret, scope), SignatureStreams(key.clock))
        allowed = self._allowed(config.signing.accept_unsigned)
        gate = Gate(key.secret, key.clock, streams, allowed, config.signing.max_ahead_s)
        self._links[config.name] = LinkSigning(config, key, gate, self._wall)

    def forget(self, name: str) -> None:
        """Remove a link; its key's clock and streams stay, in case it comes back."""
        self._links.pop(name, None)

    def attach(self, channel: Channel) -> None:
        """Let the channel of a link with a key check and sign from now on."""
        if channel.config.signing is not None:
            channel.signing = _ChannelSigning(self._links[channel.link.name], self._refused)

    def key_of(self, secret: bytes) -> _Key:
        """The key with its clock, which goes on from its saved state."""
        key = self._keys.get(secret)
        if key is None:
            clock = SigningClock(*self._store.load(key_id(secret)))
            self._report_store()  # before a save, which replaces what could not be read
            clock.see_wall(self._wall())
            key = self._keys[secret] = _Key(secret, clock, saved=0)
            self._report_pinned(key)
        return key

    def is_pinned(self, secret: bytes) -> bool:
        """True if the key's clock is further ahead of this computer's than any received frame may move it now."""
        return self._ahead_s(self.key_of(secret)) > MAX_AHEAD_S

    def pinned_text(self, secret: bytes) -> str:
        """The problem of a clock that `is_pinned`, and what to do."""
        key = self.key_of(secret)
        back_s = (key.clock.wall - self._wall()) / TICKS_PER_S
        back = (
            f"this computer's clock is {_duration(back_s)} behind what it was: set it; " if back_s > MAX_AHEAD_S else ""
        )
        return (
            f"the clock of key {key.id} is {_duration(self._ahead_s(key))} ahead of this computer's "
            f"({self._now_text()}): {back}if this computer's clock is right, another program signed with a wrong time, "
            f"and what we sign carries it on: set the key's clock back with skygcs-cli signing reset-clock {key.id}"
        )

    def reset_clock(self, wanted: str) -> str:
        """Set a key's clock back to this computer's, in memory and on disk; returns a message. Raises RefusedError."""
        key = next((key for key in self._keys.values() if key.id == wanted), None)
        if key is None:
            in_use = ", ".join(key.id for key in self._keys.values()) or "none"
            raise RefusedError(f"no key {wanted!r} is in use; in use: {in_use}")
        wall = self._wall()
        before_s = self._ahead_s(key)
        key.clock.reset(wall)
        for (secret, _), streams in self._streams.items():
            if secret == key.secret:
                streams.reset()
        if self.disk is not None:
            self.disk.offer(
                "a clock of signing", partial(self._store.save, key.id, wall, wall=wall, exact=False, back=True)
            )
        key.saved = wall
        text = f"the clock of key {key.id} was {_duration(before_s)} ahead of this computer's and is set back to it"
        self._on_event(Event("signing", None, None, f"signing: {text}", {"key_id": key.id, "ahead_s": round(before_s)}))
        return text

    def _ahead_s(self, key: _Key) -> float:
        """How far the key's clock is ahead of this computer's, s."""
        return (key.clock.timestamp - self._wall()) / TICKS_PER_S

    def _now_text(self) -> str:
        return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(self._unix_s()))

    def stamp(self, secret: bytes) -> int:
        """A time for a vehicle that gets this key: later than all that were used with it."""
        return self.key_of(secret).clock.stamp(self._wall())

    def link_key(self, name: str) -> bytes | None:
        """The key of a link; None for one without."""
        link = self._links.get(name)
        return None if link is None else link.key.secret

    def vouches_for(self, name: str, frames: list[Frame]) -> bool:
        """True if an unknown peer that sends these frames may be admitted to the link: one of them is signed with its
        key, or the link needs no signature. The streams do not change."""
        link = self._links.get(name)
        if link is None or EVERY_MESSAGE in link.settings.accept_unsigned:
            return True
        return any(frame.signed and is_signed_with(frame.raw, link.key.secret) for frame in frames)

    @contextmanager
    def watching(self, on_refused: OnRefused) -> Iterator[None]:
        """Pass every refused frame to ``on_refused`` in the meantime."""
        self._watchers.append(on_refused)
        try:
            yield
        finally:
            self._watchers.remove(on_refused)

    def _allowed(self, names: tuple[str | int, ...]) -> frozenset[int] | None:
        if EVERY_MESSAGE in names:
            return None
        return frozenset(
            int(n) if isinstance(n, int) or n.isdecimal() else self._dialect.find(n).msgid
            for n in names
            if isinstance(n, int) or n.isdecimal() or n.upper() in self._dialect.by_name
        )

    def _require_own_link_id(self, config: LinkConfig, key: _Key) -> None:
        assert config.signing is not None
        for name, other in self._links.items():
            if name != config.name and other.key is key and other.settings.link_id == config.signing.link_id:
                raise KeyFileError(
                    str(config.signing.key_file),
                    f"is the key of links.{name} as well, with the same link_id {config.signing.link_id}; "
                    f"give links.{config.name}.signing another link_id, so that the streams can be distinguished",
                )

    def _wall(self) -> int:
        return timestamp_at(self._unix_s())

    # -- reports

    def _refused(self, link: LinkSigning, channel: Channel, frame: Frame, verdict: SignatureVerdict) -> None:
        for watcher in self._watchers:
            watcher(frame, verdict)
        source = frame.sysid << 8 | frame.compid
        if (verdict, source) in link.reported or len(link.reported) >= MAX_REPORTED:
            return
        link.reported.add((verdict, source))
        name = channel.link.name
        stamp, clock = (timestamp_of(frame.raw) if frame.signed else 0), link.key.clock
        why = _KEPT_OUT[verdict].format(
            behind_s=(clock.timestamp - stamp) / TICKS_PER_S,
            ahead=_duration((stamp - clock.wall) / TICKS_PER_S),
            now=self._now_text(),
            link=name,
        )
        source_ids = f"{frame.sysid}/{frame.compid}"
        text = f"{name} ({channel.peer}): {frame.name} of {source_ids} is dropped: it {why} (reported once)"
        data = {"link": name, "compid": frame.compid, "verdict": verdict.value, "message": frame.name}
        self._on_event(Event("signing", None, frame.sysid, text, data))

    def status(self, open_channels: Iterable[Channel]) -> dict[str, Any]:
        """Keys by their id with their time, links with their rules, and counters of each open channel."""
        # channels of each link
        channels: dict[str, list[Channel]] = {}
        for channel in open_channels:
            channels.setdefault(channel.link.name, []).append(channel)
        used = {name: link.key.id for name, link in self._links.items()}
        # keys, and the links that use them
        keys = [
            {
                "key_id": key.id,
                "time_unix_s": round(unix_time_of(key.clock.timestamp), 5),
                "ahead_s": round(self._ahead_s(key), 3),
                "pinned": self._ahead_s(key) > MAX_AHEAD_S,
                "links": [name for name, used_id in used.items() if used_id == key.id],
            }
            for key in self._keys.values()
        ]
        # links, and the counters of their channels
        links = [
            {
                "link": name,
                "key_id": link.key.id,
                "key_file": str(link.settings.key_file),
                "link_id": link.settings.link_id,
                "sign_outgoing": link.settings.sign_outgoing,
                "accept_unsigned": list(link.settings.accept_unsigned),
                "channels": [
                    {"peer": channel.peer, **channel.signing.counters()}
                    for channel in channels.get(name, [])
                    if channel.signing is not None
                ],
            }
            for name, link in self._links.items()
        ]
        return {"keys": keys, "links": links}

    # -- time on disk

    async def run(self) -> None:
        """Save the clocks regularly, and at the end exactly."""
        try:
            while True:
                await asyncio.sleep(1.0)
                for key in list(self._keys.values()):
                    self._report_pinned(key)
                    if key.clock.timestamp - key.saved > SAVE_EVERY_S * TICKS_PER_S or not key.saved:
                        stamp = max(key.clock.timestamp, self._wall())
                        key.clock.see_wall(self._wall())
                        key.saved = stamp
                        await self._save(key, stamp, exact=False)
                    self._report_store()
        finally:
            # a second cancellation must not leave a clock behind what was sent: its vehicle would refuse what follows
            await carried_through(self._save_all())

    async def _save_all(self) -> None:
        for key in self._keys.values():
            await self._save(key, key.clock.timestamp, exact=True)
        self._report_store()

    async def _save(self, key: _Key, stamp: int, *, exact: bool) -> None:
        if self.disk is None:
            return
        job = partial(self._store.save, key.id, stamp, wall=key.clock.wall, exact=exact)
        try:
            await self.disk.run("a clock of signing", job, within_s=CLOSE_S)
        except OSError as error:
            self._store.problems[key.id] = f"the clock of key {key.id} cannot be written ({error.strerror})"

    def _report_pinned(self, key: _Key) -> None:
        """A clock that has come too far ahead is reported once: at the start, or since this computer's was set back."""
        before, key.pinned = key.pinned, self.is_pinned(key.secret)
        if key.pinned and not before:
            data = {"key_id": key.id, "ahead_s": round(self._ahead_s(key))}
            self._on_event(Event("warning", None, None, f"signing: {self.pinned_text(key.secret)}", data))

    def _report_store(self) -> None:
        """A clock that cannot be read or saved is reported once per reason, and once when it is saved again."""
        problems = tuple(self._store.problems.values())  # copied at once: threads of the disk change it
        before, self._store_failed = self._store_failed, set(problems)
        texts = [
            f"{problem}: after a restart with a wrong system clock, vehicles may reject our messages as old"
            for problem in sorted(self._store_failed - before)
        ]
        if before and not self._store_failed:
            texts = ["the clocks of the keys are saved again"]
        shared, self._shared = self._store.shared - self._shared, self._shared | self._store.shared
        texts += [
            f"another skygcs on this computer signs with key {key}: a vehicle that hears both drops what one sends "
            "as old, unless their links have different link_ids (links.NAME.signing.link_id)"
            for key in sorted(shared)
        ]
        for text in texts:
            self._on_event(Event("warning", None, None, f"signing: {text}", {}))


def _duration(seconds: float) -> str:
    """ "28,502 days", "3.2 h", "80 s"."""
    if seconds >= 2 * 86400:
        return f"{seconds / 86400:,.0f} days"
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds:.0f} s"
