"""Requests that a page sends with a dropped file: models of requests, and conversion between file, page and world
frame.

The page draws in metres of the fleet's world frame. It sends the origin that it shows, so that its picture and the
positions of a check are of one frame.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skygcs.core.geo import EnuFrame, Origin
from skygcs.errors import RefusedError

MAX_TEXT_CHARS = 3 << 20
"""A message of the page has at most 4 MiB, and JSON lengthens the text that is in it."""

MAX_BASE64_CHARS = 3 << 20
MAX_PROBLEMS = 10
"""Problems of one request that an error names."""

Metres = Annotated[float, Field(ge=-1e5, le=1e5)]
Height = Annotated[float, Field(ge=-1e4, le=1e4)]
Point = Annotated[list[Metres], Field(min_length=2, max_length=2)]
Place = Annotated[list[Metres], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(min_length=1, max_length=64)]


class CheckRequest(BaseModel):
    """Base of the models: strict, and a key that is not known is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class OriginKeys(CheckRequest):
    """The origin as origin.get returns it."""

    lat_deg: Annotated[float, Field(ge=-90, le=90)]
    lon_deg: Annotated[float, Field(ge=-180, le=180)]
    alt_amsl_m: Height
    x_heading_deg: Annotated[float, Field(ge=-360, le=360)] = 90.0

    def origin(self) -> Origin:
        return Origin(self.lat_deg, self.lon_deg, self.alt_amsl_m, self.x_heading_deg)


class DroppedFile(CheckRequest):
    """A file by its name: text, or anything in base64."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    text: Annotated[str, Field(max_length=MAX_TEXT_CHARS)] | None = None
    base64: Annotated[str, Field(max_length=MAX_BASE64_CHARS)] | None = None

    def content(self) -> bytes:
        """The bytes of the file. Raises RefusedError."""
        if (self.text is None) == (self.base64 is None):
            raise RefusedError(f"{self.name}: give either text or base64")
        if self.text is not None:
            return self.text.encode("utf-8", "surrogatepass")  # a lone surrogate is no UTF-8: the reader refuses it
        try:
            return base64.b64decode(self.base64 or "", validate=True)
        except (binascii.Error, ValueError) as error:
            raise RefusedError(f"{self.name}: is not base64: {error}") from None


R = TypeVar("R", bound=CheckRequest)


def parsed(model: type[R], params: Mapping[str, Any]) -> R:
    """The request as its model. Raises RefusedError with each problem and where it is."""
    try:
        return model.model_validate(params)
    except ValidationError as error:
        problems = [
            f"{'.'.join(str(part) for part in problem['loc']) or 'params'}: {problem['msg']}"
            for problem in error.errors(include_url=False, include_context=False, include_input=False)[:MAX_PROBLEMS]
        ]
        raise RefusedError("; ".join(problems)) from None


class WorldMap:
    """Degrees to world metres and back about the page's origin; without an origin nothing can be drawn."""

    def __init__(self, origin: OriginKeys | None) -> None:
        self._frame = None if origin is None else EnuFrame(origin.origin())
        self._alt_m = 0.0 if origin is None else origin.alt_amsl_m

    @property
    def known(self) -> bool:
        return self._frame is not None

    def xy(self, lat_deg: float, lon_deg: float) -> list[float] | None:
        """World metres of a place at the origin's altitude, to the millimetre; None without an origin."""
        if self._frame is None:
            return None
        x, y, _ = self._frame.from_geodetic(lat_deg, lon_deg, self._alt_m)
        return [round(x, 3), round(y, 3)]

    def lat_lon(self, point: list[float]) -> tuple[float, float]:
        """Raises RefusedError without an origin."""
        if self._frame is None:
            raise RefusedError("the fleet has no origin yet, so a drawing has no place on earth: set the origin first")
        lat, lon, _ = self._frame.to_geodetic(point[0], point[1], 0.0)
        return lat, lon
