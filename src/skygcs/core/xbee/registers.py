"""Settings of XBee modules (AT registers): which a person sets, how they are written and shown, and what goes wrong.

Source: Digi, XBee-PRO 900HP/XSC user guide (90002173), "AT commands"; 2.4 GHz DigiMesh modules have CH instead of HP.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

SHOWN = ("HV", "VR", "SH", "SL", "NI", "AP", "BD", "ID", "CM", "HP", "CH", "PL", "EE", "NP", "TO", "NH", "MT", "RR",
         "RO", "D6", "D7", "DH", "DL")  # fmt: skip
"""Registers that `xbee show` reads, in this order; a module has not all of them."""

MEANING = {
    "HV": "hardware",
    "VR": "firmware",
    "SH": "own address, high half",
    "SL": "own address, low half",
    "NI": "name",
    "AP": "mode of the port: 0 transparent, 1 API, 2 API with escapes",
    "BD": "baud of the port",
    "ID": "network id",
    "CM": "channel mask",
    "HP": "preamble id",
    "CH": "channel",
    "PL": "power level",
    "EE": "encryption: 0 off, 1 on",
    "NP": "most payload of a packet, bytes",
    "TO": "delivery: 0x40 point to multipoint, 0xC0 DigiMesh",
    "NH": "most hops",
    "MT": "repeats of a broadcast",
    "RR": "repeats of an unacknowledged packet",
    "RO": "silence that ends a packet, characters (transparent mode)",
    "D6": "RTS: 0 off, 1 on",
    "D7": "CTS: 0 off, 1 on",
    "DH": "destination, high half (transparent mode)",
    "DL": "destination, low half (transparent mode)",
}

READ_ONLY = frozenset({"HV", "VR", "SH", "SL", "NP"})

NETWORK = frozenset({"ID", "CM", "HP", "CH", "EE", "KY", "BR"})
"""Registers that must be the same in all modules of a network: one that is set otherwise is out of reach."""

BAUD_CODES = {1200: 0, 2400: 1, 4800: 2, 9600: 3, 19200: 4, 38400: 5, 57600: 6, 115200: 7, 230400: 8}

LIKELY_BAUD = (115200, 9600, 57600, 230400, 38400, 19200)
"""Tried in this order; a module is delivered with 9600."""

MAX_NAME_CHARS = 20
KEY_DIGITS = (32, 64)
"""Lengths of KY: AES of 128 or 256 bits, in hexadecimal digits."""


def parse_setting(name: str, text: str) -> bytes:
    """The value of NAME=TEXT as it goes to the module. Raises ValueError with what is wrong.

    Numbers are decimal or 0x…; BD is a rate; NI is text; KY is hexadecimal.
    """
    if len(name) != 2 or not name.isalnum() or not name.isascii():
        raise ValueError(f"{name!r} is not a setting: AT registers have two letters")
    if name in READ_ONLY:
        raise ValueError(f"{name} ({MEANING[name]}) can only be read")
    if name == "NI":
        if not 0 < len(text) <= MAX_NAME_CHARS or not text.isascii() or not text.isprintable() or text[0] == " ":
            raise ValueError(f"NI: a name has 1 to {MAX_NAME_CHARS} printable ASCII characters")
        return text.encode("ascii")
    if name == "KY":
        if len(text) not in KEY_DIGITS or not all(c in "0123456789abcdefABCDEF" for c in text):
            raise ValueError("KY: a key has 32 or 64 hexadecimal digits")
        return bytes.fromhex(text)
    try:
        number = int(text, 16) if text.lower().startswith("0x") else int(text)
    except ValueError:
        raise ValueError(f"{name}: {text!r} is not a number (decimal, or 0x…)") from None
    if not 0 <= number < 1 << 64:
        raise ValueError(f"{name}: {text} is not 0 to 2^64 - 1")
    if name == "BD":
        number = BAUD_CODES.get(number, number)
        if number not in BAUD_CODES.values():
            raise ValueError(f"BD: no rate of a module; choose one of {', '.join(map(str, BAUD_CODES))}")
    return number.to_bytes(max(1, (number.bit_length() + 7) // 8), "big")


def show_setting(name: str, value: bytes) -> str:
    """A register's value for a person."""
    if name == "NI":
        return value.decode("ascii", "replace")
    number = int.from_bytes(value, "big")
    if name == "BD":
        return next((str(baud) for baud, code in BAUD_CODES.items() if code == number), f"0x{number:X}")
    if name in ("AP", "PL", "EE", "NP", "NH", "MT", "RR", "RO", "D6", "D7"):
        return str(number)
    return f"0x{number:X}"


def same_value(name: str, left: bytes, right: bytes) -> bool:
    """True if two values of a register are the same: modules pad numbers with zeros."""
    return left == right if name == "NI" else left.lstrip(b"\0") == right.lstrip(b"\0")


def problems(values: Mapping[str, bytes]) -> list[str]:
    """Return what of a ground module's settings does not fit skygcs, one line each."""
    found = []
    mode = int.from_bytes(values.get("AP", b"\2"), "big")
    if mode == 0:
        found.append("AP is 0: the ground's module needs API mode, vehicles' modules 0 (skygcs-cli xbee set PORT AP=2)")
    if values.get("D7") == b"\0":
        found.append("D7 is 0: without CTS the module drops what it cannot take (D7=1, and rtscts in the fleet file)")
    if values.get("EE") == b"\0":
        found.append("EE is 0: anybody with such a module and this network id can give orders (EE=1 and KY at each)")
    return found


def order_of_writing(names: Sequence[str]) -> list[str]:
    """Names in the order in which they are written: what may end the conversation comes last."""
    last = ("KY", "EE", "CM", "CH", "HP", "ID", "BD", "AP")
    return sorted(names, key=lambda name: last.index(name) if name in last else -1)
