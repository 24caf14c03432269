"""Exact lists of hosts and origins."""

from __future__ import annotations

import pytest

from skygcs.config.allow_list import allow_list, check_address
from skygcs.errors import RefusedError
from support.table import each

LOCAL = allow_list("127.0.0.1", 8750, (), tls=False)


@each("host", ["127.0.0.1:8750", "localhost:8750", "[::1]:8750"])
def test_this_machine_is_served_under_its_own_names(host: str) -> None:
    assert LOCAL.refusal(host, None, websocket=False) is None
    assert LOCAL.refusal(host, f"http://{host}", websocket=True, site="same-origin") is None


@each(
    "host",
    [
        None,
        "",
        "127.0.0.1",
        "127.0.0.1:8751",
        "127.evil.com",
        "127.evil.com:8750",
        "127.0.0.1.evil.com:8750",
        "localhost.:8750",
        "LOCALHOST:8750",
        "evil@127.0.0.1:8750",
        "127.0.0.1:8750:80",
        "0.0.0.0:8750",
        "127.1:8750",
        "2130706433:8750",
        " 127.0.0.1:8750",
    ],
)
def test_any_other_host_is_refused(host: str | None) -> None:
    assert LOCAL.refusal(host, None, websocket=False) is not None


@each(
    "origin",
    [
        "null",
        "",
        "http://evil.com",
        "https://127.0.0.1:8750",
        "http://127.0.0.1",
        "http://127.0.0.1:8751",
        "http://127.0.0.1:8750.evil.com",
        "http://127.0.0.1:8750/",
        "file://",
    ],
)
@each("websocket", [False, True])
def test_a_foreign_origin_is_refused(origin: str, websocket: bool) -> None:
    assert LOCAL.refusal("127.0.0.1:8750", origin, websocket=websocket) is not None


def test_a_websocket_needs_an_origin_and_no_other_site() -> None:
    own = "http://127.0.0.1:8750"
    assert LOCAL.refusal("127.0.0.1:8750", None, websocket=True) is not None
    assert LOCAL.refusal("127.0.0.1:8750", own, websocket=True, site="cross-site") is not None
    assert LOCAL.refusal("127.0.0.1:8750", own, websocket=True, site="same-site") is not None
    assert LOCAL.refusal("127.0.0.1:8750", own, websocket=True) is None  # a browser that does not send it


def test_another_address_is_served_under_itself_and_its_names_only() -> None:
    allowed = allow_list("192.168.1.10", 8750, ("gcs.lan",), tls=True)
    assert allowed.hosts == {"192.168.1.10:8750", "gcs.lan:8750"}
    assert allowed.origins == {"https://192.168.1.10:8750", "https://gcs.lan:8750"}
    assert allow_list("fd00::1", 443, (), tls=True).hosts == {"[fd00::1]:443", "[fd00::1]"}
    assert allow_list("0.0.0.0", 8750, ("gcs",), tls=True).hosts == {"gcs:8750"}


def test_another_address_needs_tls_and_a_wildcard_needs_names() -> None:
    check_address("127.0.0.1", (), tls=False)
    check_address("::1", (), tls=False)
    check_address("192.168.1.10", (), tls=True)
    check_address("0.0.0.0", ("gcs",), tls=True)
    for address in ("192.168.1.10", "0.0.0.0", "::", "127.0.0.2"):
        with pytest.raises(RefusedError, match="needs TLS"):
            check_address(address, ("gcs",), tls=False)
    with pytest.raises(RefusedError, match="names"):
        check_address("0.0.0.0", (), tls=True)
    with pytest.raises(RefusedError, match="IP address"):
        check_address("gcs.lan", (), tls=True)
