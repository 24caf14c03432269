"""``HOST:PORT`` in files."""

from __future__ import annotations

import pytest

from skygcs.config.addresses import host_and_port
from support.table import each


@each("text", ["", ":", "h:", ":1", "h:65536", "h:-1", "h:1x", "h:١", "h:000001", "a:b:1"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        host_and_port(text)
