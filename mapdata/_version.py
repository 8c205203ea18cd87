"""The version of mapdata."""

__version__ = "0.3.0"
