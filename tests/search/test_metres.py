"""Points and cells in metres, by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mapdata import to_metres


def test_points_in_metres_are_those_of_the_cells() -> None:
    """The origin is the lower left corner, about which the map is turned."""
    points = [[[3.0, 0.0], [0.0, 4.0]]]
    np.testing.assert_allclose(
        to_metres(points=points, rows=3, resolution=0.5)[0], np.array([[0, 0], [2, 1.5]])
    )
    turned = to_metres(points=points, rows=3, resolution=0.5, origin=(10.0, 20.0, math.pi / 2))
    np.testing.assert_allclose(turned[0], np.array([[10, 20], [8.5, 22]]))
    middles = to_metres(cells=[[2, 0], [0, 3]], rows=3, resolution=0.5)
    np.testing.assert_allclose(middles, np.array([[0.25, 0.25], [1.75, 1.25]]))


def test_points_and_origins_of_another_shape_are_refused() -> None:
    """The error names the expected shape; an origin has a yaw."""
    with pytest.raises(ValueError, match=r"origin: got \(0, 0\), expected \(x, y, yaw\)"):
        to_metres(points=[[1, 2]], rows=3, resolution=0.5, origin=(0, 0))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"points: got shape \(3,\), expected \(..., 2\)"):
        to_metres(points=[1, 2, 3], rows=3, resolution=0.5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "points and cells: got neither, expected one"),
        ({"points": [1, 2], "cells": [1, 2]}, "points and cells: got both, expected one"),
        ({"cells": [1.0, 2.0]}, "cells: got numbers of float64, expected integers; points= takes"),
        ({"cells": [1, 2, 3]}, r"cells: got shape \(3,\)"),
        ({"cells": [[1, 2], [-1, -1]]}, "cells: got -1, the padding of paths in batches"),
    ],
)
def test_points_or_cells_that_cannot_be_are_refused(
    arguments: dict[str, Any], message: str
) -> None:
    """One of both is expected, and cells are integers without padding."""
    with pytest.raises(ValueError, match=message):
        to_metres(**arguments, rows=3, resolution=0.5)
