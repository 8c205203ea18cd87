"""The version of mapdata."""

__version__ = "0.4.0"
