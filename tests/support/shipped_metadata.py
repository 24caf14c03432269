"""Metadata of the parameters of a vehicle that is only a name: by the tables that skygcs ships."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from skygcs.runtime.param_cache import ParamCache
from skygcs.runtime.param_metadata import VehicleMetadata
from support.vehicles import flight_dialect


def shipped_metadata(family: str) -> VehicleMetadata:
    vehicle = SimpleNamespace(family=family, firmware=None)
    params = SimpleNamespace(rate=None, cache=ParamCache(None))
    services = SimpleNamespace(dialect=flight_dialect())
    actor = SimpleNamespace(vehicle=vehicle, services=services, params=params, request=None)
    return VehicleMetadata(cast(Any, actor))
