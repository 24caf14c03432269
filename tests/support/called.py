"""An RPC method called as a session does, without a socket, whose waiting has no place in virtual time."""

from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace
from typing import Any

from skygcs.config.extension_tables import demanded_word, on_demand
from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.daemon import Daemon
from skygcs.ext.messages.message_sender import MessageSender
from skygcs.ext.plans.extension import Plans
from skygcs.ext.signing.signing_setup import SigningSetup
from skygcs.rpc.dispatch import Encoded
from skygcs.rpc.methods import METHODS
from skygcs.rpc.slices import Slices

ANYBODY = ClientIdentity(lambda: "client 0")


async def call(
    daemon: Daemon, name: str, /, *, reports: Any = None, client: ClientIdentity = ANYBODY, **params: Any
) -> Any:
    """The method's result. Raises what the method raises, and pydantic's error for parameters. ``reports``: a
    `runtime.fleet.Reports` of a client that asks for the outcomes as they come. ``client``: which calls."""
    if name not in METHODS:
        daemon.extensions.demand(demanded_word(name, on_demand()))
    of_extensions = {method.name: method for method in daemon.extensions.methods}
    method = of_extensions.get(name) or METHODS[name]
    slices = Slices(asyncio.get_running_loop())
    context: Any = SimpleNamespace(services=daemon, slices=slices, reports=reports, client=client)
    answer = method.handler(context, method.params.model_validate(params))
    result = await answer if asyncio.iscoroutine(answer) else answer
    if method.shown is not None:
        result = method.shown(result)
    return json.loads(result.body) if isinstance(result, Encoded) else result


def signing_setup_of(daemon: Daemon) -> SigningSetup:
    """The sender of signing keys to vehicles. Makes its extension if there is none yet."""
    daemon.extensions.demand("signing")
    setup: SigningSetup = daemon.extensions["signing"].setup
    return setup


def sender_of(daemon: Daemon) -> MessageSender:
    """The sender of any message. Makes its extension if there is none yet."""
    daemon.extensions.demand("messages.send")
    sender: MessageSender = daemon.extensions["messages.send"].sender
    return sender


def plans_of(daemon: Daemon) -> Plans:
    """The extension of plans, which is made for it."""
    daemon.extensions.demand("plan")
    plans: Plans = daemon.extensions["plan"]
    return plans
