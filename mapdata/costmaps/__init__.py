"""Costmaps of robots that are learnt from recorded drives (docs/howto/costmap.md)."""

from mapdata.costmaps.costmap import Costmap, fit_costmap
from mapdata.costmaps.drives import read_drives
from mapdata.costmaps.inflation_layer import inflation_costs
from mapdata.costmaps.sites import Site, site_of

__all__ = ["Costmap", "Site", "fit_costmap", "inflation_costs", "read_drives", "site_of"]
