"""The sending side of a simulated vehicle: encodes its frames with its own sequence number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import encode_payload
from skygcs.sim import protocol as m
from skygcs.sim.faults import Faults
from skygcs.sim.onboard_signing import BoardSigning
from skygcs.sim.rng import Rng

TEXT_BYTES = 50
"""STATUSTEXT.text; longer ones are sent in chunks."""


class Transmitter:
    """Collects the frames of one vehicle until `take`."""

    def __init__(self, dialect: Dialect, rng: Rng, faults: Faults, signing: BoardSigning) -> None:
        self.sysid = 0
        self._dialect = dialect
        self._rng = rng
        self._faults = faults
        self._signing = signing
        self._out: list[bytes] = []
        self._texts: list[tuple[int, str]] = []
        self._seq = 0
        self._text_id = 0

    def restart(self, sysid: int) -> None:
        """The vehicle boots: its sequence starts anew, what it was about to say is forgotten."""
        self.sysid = sysid
        self._texts.clear()
        self._seq = 0
        self._text_id = 0

    def send(self, name: str, fields: Mapping[str, Any], tail: bytes = b"") -> None:
        """One message now, ``tail`` behind what the dialect knows of it. A message the dialect lacks is not sent."""
        info = self._dialect.by_name.get(name)
        if info is None:
            return
        payload = info.pack(fields) + tail
        raw = encode_payload(info, payload, sysid=self.sysid, compid=m.MAV_COMP_ID_AUTOPILOT1, seq=self._seq)
        self._seq = (self._seq + 1) & 0xFF
        if not self._faults.mute:
            self._out.append(self._signing.signed(raw, info))

    def acknowledge(self, command: int, result: int, target: tuple[int, int], progress: int = 0) -> None:
        if self._rng.happens(self._faults.ack_loss):
            return
        fields = {"command": command, "result": result, "progress": progress}
        self.send("COMMAND_ACK", {**fields, "target_system": target[0], "target_component": target[1]})

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT with the next `flush`: texts follow the acknowledgement they explain, as in the firmwares."""
        self._texts.append((severity, text))

    def flush(self) -> None:
        texts, self._texts = self._texts, []
        for severity, text in texts:
            self._send_text(severity, text.encode())

    def take(self) -> list[bytes]:
        """The frames since the last call."""
        out, self._out = self._out, []
        return out

    def _send_text(self, severity: int, text: bytes) -> None:
        if len(text) <= TEXT_BYTES:
            self.send("STATUSTEXT", {"severity": severity, "text": text})
            return
        self._text_id += 1
        for chunk_seq, at in enumerate(range(0, len(text), TEXT_BYTES)):
            part = text[at : at + TEXT_BYTES]
            self.send("STATUSTEXT", {"severity": severity, "text": part, "id": self._text_id, "chunk_seq": chunk_seq})
