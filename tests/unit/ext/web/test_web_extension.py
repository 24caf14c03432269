"""[web]: the command line that it makes is one that `skygcs` takes."""

from __future__ import annotations

from pathlib import Path

from skygcs.cli.serve import new_parser
from skygcs.config.web import WebConfig, WebMapConfig
from skygcs.ext.web.extension import page_address, web_arguments

SOCKET = Path("/run/x y.sock")


def test_the_page_gets_its_table() -> None:
    points = ((1.0, 2.0, 43.0, -79.0), (3.0, 4.0, 43.5, -79.5))
    table = WebConfig(
        host="10.0.0.1",
        port=80,
        names=("field",),
        tls_cert=Path("c"),
        tiles=Path("t x.mbtiles"),
        map=WebMapConfig(image=Path("i"), points=points),
    )
    args = new_parser().parse_args(web_arguments(table, SOCKET))
    wanted = (str(SOCKET), "10.0.0.1", 80, ["field"], Path("c"))
    assert (args.socket, args.host, args.port, args.name, args.tls_cert) == wanted
    assert args.supervised and len(args.map_point) == 2 and args.tiles == Path("t x.mbtiles")
    assert page_address(table) == "https://10.0.0.1:80/"
