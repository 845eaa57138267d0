"""The layouts in which a data set can be written and read, one file each, and the table of them."""

from harness.datasets.layouts.colmap import COLMAP
from harness.datasets.layouts.helvipad import HELVIPAD
from harness.datasets.layouts.layout import Layout
from harness.datasets.layouts.omnimvs import OMNIMVS
from harness.datasets.layouts.own import OWN

LAYOUTS: dict[str, Layout] = {each.name: each for each in (OWN, HELVIPAD, OMNIMVS, COLMAP)}
"""The layouts by their names in specifications; a folder is tested for each in this order."""

__all__ = ["LAYOUTS", "Layout"]
