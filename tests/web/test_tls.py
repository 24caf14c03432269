"""The page over TLS in a real browser: it trusts the certificate's key alone, signs in, sees the fleet and orders."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from playwright.sync_api import Browser, Error, Page, expect

from support.browser import until
from support.certificates import Authority
from support.web_station import WebStation, chromium, chromium_options

ADDRESS = "127.0.0.2"
"""Not 127.0.0.1: there browsers allow much without TLS, and the page is served without it."""


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return Authority(tmp_path_factory.mktemp("authority"), "lab").issue("gcs", ADDRESS)


@pytest.fixture(scope="module")
def tls_station(tmp_path_factory: pytest.TempPathFactory, certificates: tuple[Path, Path]) -> Iterator[WebStation]:
    certificate, key = map(str, certificates)
    options = ("--host", ADDRESS, "--tls-cert", certificate, "--tls-key", key)
    station = WebStation(tmp_path_factory.mktemp("tls"), (2, 1), web=options)
    try:
        yield station.start()
    finally:
        station.close()


def key_pin(certificate: Path) -> str:
    """The hash of the key in a certificate, as Chromium's option wants it."""
    key = x509.load_pem_x509_certificate(certificate.read_bytes()).public_key()
    return base64.b64encode(
        hashlib.sha256(key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).digest()
    ).decode()


@pytest.fixture
def trusting(browser: Browser, certificates: tuple[Path, Path], tmp_path: Path) -> Iterator[Page]:
    """A page of a Chromium that takes this key and no other, in a profile of its own: the option works only there."""
    path = chromium()
    assert path is not None
    pin = f"--ignore-certificate-errors-spki-list={key_pin(certificates[0])}"
    context = browser.browser_type.launch_persistent_context(
        str(tmp_path / "profile"),
        executable_path=path,
        args=[*chromium_options(), pin],
        viewport={"width": 1280, "height": 800},
    )
    yield context.pages[0]
    context.close()


def test_a_browser_signs_in_over_tls_sees_the_fleet_and_holds_it(tls_station: WebStation, trusting: Page) -> None:
    page, base = trusting, f"https://{ADDRESS}:{tls_station.port}"
    errors: list[str] = []
    asked: list[str] = []
    sockets: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda ws: sockets.append(ws.url))
    address = tls_station.address()
    assert address.startswith(f"{base}/?token=")
    page.goto(address)
    assert page.url == f"{base}/", "the token is not left in the address"
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(3)
    assert page.evaluate("isSecureContext && location.protocol") == "https:"
    [cookie] = page.context.cookies()
    assert cookie["name"] == f"__Host-skygcs_{tls_station.port}" and cookie["domain"] == ADDRESS
    assert cookie["secure"] and cookie["httpOnly"] and cookie["sameSite"] == "Strict"
    assert page.evaluate("document.cookie") == ""
    page.locator("tr.row[data-name=v1]").click()
    page.get_by_title("Hold v1 where it is, at once").click()
    until(page, "skygcs.store.state.orders.length === 1 && skygcs.store.state.orders[0].state === 'done'")
    assert page.evaluate("Object.keys(skygcs.store.state.orders[0].outcomes)") == ["v1"]
    assert sockets == [f"wss://{ADDRESS}:{tls_station.port}/ws"]
    assert [url for url in asked if not url.startswith((f"{base}/", "data:", "blob:"))] == [], "no mixed content"
    assert errors == []
    page.reload()
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(3)


def test_a_browser_that_does_not_know_the_certificate_gets_nothing(tls_station: WebStation, browser: Browser) -> None:
    page = browser.new_page()
    try:
        with pytest.raises(Error, match="ERR_CERT_AUTHORITY_INVALID"):
            page.goto(tls_station.address())
        assert page.context.cookies() == []
    finally:
        page.close()
