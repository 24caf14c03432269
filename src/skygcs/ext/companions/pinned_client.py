"""A client of a companion: JSON-RPC over TLS with pinned certificates."""

from __future__ import annotations

from skygcs.ext.companions.tls import Identity, PinnedTls
from skygcs.rpc.client import Client


async def connect_pinned(host: str, port: int, identity: Identity) -> Client:
    """The client, connected. Raises LinkError for files that cannot be used, DaemonUnreachable."""
    client = Client(f"tls://{host}:{port}", tls=PinnedTls(identity, server=False))
    await client.open()
    return client
