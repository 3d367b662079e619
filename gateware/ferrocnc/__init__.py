"""FerroCNC gateware: reads a board file, builds the SoC around the cores in `gateware/rtl`, exports
its map."""

VERSION = (0, 1, 0)
"""Gateware version (major, minor, patch): readable in `ident.gateware_version`."""
