"""What is known of one vehicle's parameters, how far the vehicle vouches for it, and its file in the cache."""

from __future__ import annotations

from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.param_encoding import Encoding, Param, encoding_of
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.param_cache import CachedParams, CacheKey, ParamCache


class ParamBook:
    """``complete``: these are all. ``hash``: PX4's over them when they were read, None without one.

    ``recalled``: they come from an earlier run, or from before the vehicle was lost: changes may not have been heard.
    ``stale``: a value has changed since that hash was read, so it must not vouch for what is known now.
    """

    def __init__(self, vehicle: Vehicle, dialect: Dialect, cache: ParamCache) -> None:
        self.params: dict[str, Param] = {}
        self.complete = False
        self.hash: int | None = None
        self.stale = False
        self.recalled = False
        self._vehicle = vehicle
        self._dialect = dialect
        self._cache = cache
        self._unsaved = False

    @property
    def encoding(self) -> Encoding:
        """How the vehicle sends whole numbers."""
        fields = self._version_fields()
        return encoding_of(self._vehicle.autopilot, None if fields is None else int(fields["capabilities"]))

    @property
    def capabilities(self) -> int:
        """MAV_PROTOCOL_CAPABILITY bits; 0 while they are unknown."""
        fields = self._version_fields()
        return 0 if fields is None else int(fields["capabilities"])

    def heard(self, param: Param) -> None:
        """The vehicle reported the value of a parameter, to us or to another program."""
        known = self.params.get(param.name)
        if known is not None and known != param:
            self.params[param.name] = param
            self._unsaved = self.stale = True

    def remember(self, params: tuple[Param, ...], hash_: int | None) -> None:
        """A complete list has been read; ``hash_`` None: it has none, or it changed meanwhile."""
        self.params = {p.name: p for p in params}
        self.complete = self._unsaved = True
        self.recalled = False
        self.vouched(hash_)
        self.save()

    def vouched(self, hash_: int | None) -> None:
        """This is the hash over what is known now; None: it is unknown."""
        self.hash = hash_
        self.stale = False

    def vouches(self, hash_: int | None) -> bool:
        """True if a hash that the vehicle has just sent shows that the known values are those it holds."""
        return self.complete and hash_ is not None and hash_ == self.hash and not self.stale

    def recall(self) -> None:
        """Take what an earlier run has kept, if nothing is known yet."""
        key = None if self.complete else self._key()
        cached = None if key is None else self._cache.load(key)
        if cached is not None:
            self.params = {p.name: p for p in cached.params}
            self.complete = self.recalled = True
            self.vouched(cached.hash)

    def save(self) -> None:
        """Keep what is known for the next run, as far as the vehicle will be able to vouch for it."""
        key = self._key()
        if self._unsaved and self.complete and key is not None:
            self._unsaved = False
            if self._vehicle.family != "px4" or (self.hash is not None and not self.stale):
                self._cache.store(key, CachedParams(tuple(self.params.values()), self.hash))

    def doubt(self) -> None:
        """The vehicle was lost or has rebooted: what is known has to be vouched for anew."""
        self.save()
        self.complete = False

    def _key(self) -> CacheKey | None:
        """None while the vehicle has not said what firmware it runs."""
        fields = self._version_fields()
        if fields is None:
            return None
        uid2 = bytes(fields.get("uid2") or ())
        board = uid2.hex() if any(uid2) else f"{int(fields.get('uid', 0)):016x}"
        commit = bytes(fields.get("flight_custom_version") or ()).hex()
        firmware = f"{fields.get('flight_sw_version', 0)}-{commit}"
        v = self._vehicle
        return CacheKey(v.family, v.sysid, v.compid, board, firmware)

    def _version_fields(self) -> dict[str, Any] | None:
        info = self._dialect.by_name.get("AUTOPILOT_VERSION")
        slot = None if info is None else self._vehicle.slots.get(info.msgid)
        return None if slot is None or slot.frame is None else slot.frame.fields()
