"""The version of mapdata."""

__version__ = "0.1.0"
