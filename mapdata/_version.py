"""The version of mapdata."""

__version__ = "0.2.0"
