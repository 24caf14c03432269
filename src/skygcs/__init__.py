"""skygcs: one asyncio process between one radio, many MAVLink vehicles, their ground stations and your programs."""

__version__ = "0.1.0"
