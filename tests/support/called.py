"""An RPC method called as a session does, without a socket, whose waiting has no place in virtual time."""

from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace
from typing import Any

from skygcs.config.extension_tables import demanded_word, on_demand
from skygcs.daemon import Daemon
from skygcs.ext.plans.extension import Plans
from skygcs.ext.signing.signing_setup import SigningSetup
from skygcs.rpc.dispatch import Encoded
from skygcs.rpc.methods import METHODS
from skygcs.rpc.slices import Slices


async def call(daemon: Daemon, name: str, /, *, reports: Any = None, **params: Any) -> Any:
    """The method's result. Raises what the method raises, and pydantic's error for parameters. ``reports``: a
    `runtime.fleet.Reports` of a client that asks for the outcomes as they come."""
    if name not in METHODS:
        daemon.extensions.demand(demanded_word(name, on_demand()))
    of_extensions = {method.name: method for method in daemon.extensions.methods}
    method = of_extensions.get(name) or METHODS[name]
    context: Any = SimpleNamespace(services=daemon, slices=Slices(asyncio.get_running_loop()), reports=reports)
    answer = method.handler(context, method.params.model_validate(params))
    result = await answer if asyncio.iscoroutine(answer) else answer
    return json.loads(result.body) if isinstance(result, Encoded) else result


def signing_setup_of(daemon: Daemon) -> SigningSetup:
    """What gives vehicles their keys; its extension is made for it."""
    daemon.extensions.demand("signing")
    setup: SigningSetup = daemon.extensions["signing"].setup
    return setup


def plans_of(daemon: Daemon) -> Plans:
    """The extension of plans, which is made for it."""
    daemon.extensions.demand("plan")
    plans: Plans = daemon.extensions["plan"]
    return plans
