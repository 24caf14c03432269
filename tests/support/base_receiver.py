"""A u-blox base receiver to test with: its messages are read and made by pyubx2, which is not ours."""

from __future__ import annotations

import contextlib
import itertools
import socket
from collections.abc import Mapping
from io import BytesIO
from typing import Any

from pyubx2 import GET, SET, UBX_CONFIG_DATABASE, UBX_PROTOCOL, UBXMessage, UBXReader

from support.rtcm import STANDARD_1005, rtcm_frame

NMEA = b"$GNRMC,101530.00,V,,,,,,,280926,,,N,V*1C\r\n"


def ack(*, accepted: bool = True) -> bytes:
    """The answer to a CFG-VALSET."""
    return bytes(UBXMessage("ACK", "ACK-ACK" if accepted else "ACK-NAK", GET, clsID=0x06, msgID=0x8A).serialize())


def nav_svin(duration_s: int, accuracy_m: float, *, valid: bool = False, active: bool = True) -> bytes:
    """NAV-SVIN as the receiver sends it."""
    values = {"dur": duration_s, "meanAcc": round(accuracy_m * 1e4), "obs": duration_s}
    values |= {"valid": valid, "active": active}
    return bytes(UBXMessage("NAV", "NAV-SVIN", GET, **values).serialize())


def settings_in(data: bytes) -> list[dict[str, Any]]:
    """The settings of each CFG-VALSET in these bytes, by pyubx2's names."""
    reader = UBXReader(BytesIO(data), msgmode=SET, protfilter=UBX_PROTOCOL)
    found = []
    for _, parsed in reader:
        assert parsed is not None and parsed.identity == "CFG-VALSET", parsed
        found.append({k: v for k, v in vars(parsed).items() if k in UBX_CONFIG_DATABASE})
    return found


class BaseReceiver:
    """A receiver at the other end of a socket pair, which stands for the port. `second` is called once a second."""

    def __init__(self, *, accepts: bool = True, answers: bool = True) -> None:
        self.accepts, self.answers = accepts, answers
        self.asked: list[dict[str, Any]] = []
        """Settings of each request."""
        self.settings: dict[str, Any] = {"CFG_USBOUTPROT_NMEA": 1}
        self.surveyed_s: int | None = None
        """Duration of its survey; None: it has not begun."""
        self.valid = False
        self.sent_rtcm: list[bytes] = []
        self.far: socket.socket | None = None
        self._near: socket.socket | None = None
        self._epoch = itertools.count(1)
        self._held = b""

    def open_port(self, device: str, baud: int, **_: Any) -> Any:
        """In place of `links.serial_port.open_port`: the port, newly opened."""
        self.unplug()
        near, self.far = socket.socketpair()
        near.setblocking(False)
        self.far.setblocking(False)
        self._near = near
        return near

    def unplug(self) -> None:
        """The cable is pulled out."""
        if self.far is not None:
            self.far.close()
            self.far = None

    def lose_power(self) -> None:
        """Settings in the RAM are gone."""
        self.settings = {"CFG_USBOUTPROT_NMEA": 1}
        self.surveyed_s, self.valid = None, False

    def second(self) -> None:
        """Answer what was asked, and send what is due; what nobody has the port open for is lost."""
        self.answer()
        for message in self.due():
            self._send(message)

    def due(self) -> list[bytes]:
        """The messages of this second."""
        epoch = next(self._epoch)
        on: Mapping[str, Any] = self.settings
        out = [NMEA] if on.get("CFG_USBOUTPROT_NMEA") else []
        if self.surveyed_s is not None and not self.valid:
            self.surveyed_s += 1
            least, limit = on["CFG_TMODE_SVIN_MIN_DUR"], on["CFG_TMODE_SVIN_ACC_LIMIT"] / 1e4
            self.valid = self.surveyed_s >= least and self.accuracy_m <= limit
        if on.get("CFG_MSGOUT_UBX_NAV_SVIN_USB"):
            out.append(nav_svin(self.surveyed_s or 0, self.accuracy_m, valid=self.valid, active=not self.valid))
        rtcm = []
        if on.get("CFG_USBOUTPROT_RTCM3X"):
            placed = self.valid or on.get("CFG_TMODE_MODE") == 2
            every = on.get("CFG_MSGOUT_RTCM_3X_TYPE1005_USB") or 0
            if placed and every and epoch % every == 0:
                rtcm.append(STANDARD_1005)
            types = [
                t for t in (*range(1074, 1125, 10), *range(1077, 1128, 10)) if f"CFG_MSGOUT_RTCM_3X_TYPE{t}_USB" in on
            ]
            rtcm += [rtcm_frame(t, epoch=epoch) for t in types if on[f"CFG_MSGOUT_RTCM_3X_TYPE{t}_USB"]]
        self.sent_rtcm += rtcm
        return out + rtcm

    @property
    def accuracy_m(self) -> float:
        """The longer it averages, the better."""
        return 10.0 / max(self.surveyed_s or 1, 1) ** 0.5

    def answer(self) -> None:
        """Answer what was asked."""
        with contextlib.suppress(OSError):  # nothing more, or nobody has the port open
            self._held += b"" if self.far is None else self.far.recv(65536)
        asked, self._held = settings_in(self._held), b""
        for settings in asked:
            self.asked.append(settings)
            if self.answers and self.accepts:
                self._apply(settings)
            if self.answers:
                self._send(ack(accepted=self.accepts))

    def _apply(self, settings: Mapping[str, Any]) -> None:
        before = self.settings.get("CFG_TMODE_MODE", 0)
        self.settings |= settings
        mode = self.settings.get("CFG_TMODE_MODE", 0)
        if mode != 1:
            self.surveyed_s, self.valid = None, False
        elif before != 1:
            self.surveyed_s, self.valid = 0, False

    def _send(self, data: bytes) -> None:
        if self.far is not None:
            with contextlib.suppress(OSError):  # the port was closed
                self.far.send(data)
