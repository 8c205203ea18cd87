"""Models of costs: the shape of a curve over clearance, and a network over planes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mapdata.costmaps.cost_models import (
    KNOT,
    MAX_RATIO,
    Curve,
    PlaneNetwork,
    knots,
    nearest_knot,
    with_one_minimum,
)


def curve_of(costs: dict[float, float]) -> Curve:
    """Return a curve with the cost of the nearest clearance at each knot."""
    curve = Curve(np.full(len(knots()), 100))
    metres, values = np.array(list(costs)), np.array(list(costs.values()))
    nearest = np.abs(knots()[:, None] - metres).argmin(axis=1)
    with torch.no_grad():
        curve.steps.copy_(torch.from_numpy(np.diff(np.log(values[nearest]))))
    return curve


def test_knots_are_metres() -> None:
    """They lie in the middle of intervals of `KNOT` from 0 to 2 m."""
    assert knots()[[0, 1, -1]] == pytest.approx([0.025, 0.075, 1.975])
    assert nearest_knot(np.array([0.0, 0.049, 0.051, 1.975, 2.0])).tolist() == [0, 0, 1, 39, 39]


def test_a_curve_is_linear_between_knots_and_constant_beyond() -> None:
    """In the logarithm, as `numpy.interp`."""
    curve = curve_of({0.2: 3.0, 0.7: 1.0, 1.9: 5.0})
    metres = np.array([0.0, 0.3, 0.4561, 0.99, 1.2999, 1.99, 2.0])
    logs = np.insert(np.cumsum(curve.steps.detach().numpy()), 0, 0)
    found = curve(torch.tensor(metres, dtype=torch.float32)[:, None]).detach().numpy()
    np.testing.assert_allclose(found, np.interp(metres, knots(), logs), atol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_steps_with_one_minimum(seed: int) -> None:
    """No other choice of signs is nearer, and the minimum is within the bounds."""
    rng = np.random.default_rng(seed)
    steps = rng.standard_normal(9)
    first, last = sorted(rng.integers(0, 10, 2).tolist())
    found = with_one_minimum(steps, first, last)
    candidates = [
        np.where(np.arange(9) < lowest, np.minimum(steps, 0), np.maximum(steps, 0))
        for lowest in range(first, last + 1)
    ]
    assert any(np.array_equal(found, candidate) for candidate in candidates)
    errors = [((candidate - steps) ** 2).sum() for candidate in candidates]
    assert ((found - steps) ** 2).sum() == pytest.approx(min(errors))


def test_a_constrained_curve_falls_and_then_rises() -> None:
    """Its minimum is at a knot that was driven, and its range is bounded."""
    counts = np.zeros(len(knots()), np.int64)
    counts[8:20] = 30
    curve = Curve(counts)
    rng = np.random.default_rng(3)
    with torch.no_grad():
        curve.steps.copy_(torch.from_numpy(rng.normal(-0.3, 1, len(counts) - 1)))
    curve.constrain()
    steps = curve.steps.detach().numpy()
    assert np.flatnonzero(steps < -1e-6)[-1] < np.flatnonzero(steps > 1e-6)[0]
    logs = np.insert(np.cumsum(steps), 0, 0)
    assert 8 <= logs.argmin() < 20
    assert np.ptp(logs) <= np.log(MAX_RATIO) + 1e-5


def test_a_curve_goes_on_at_its_edge() -> None:
    """What paths do not cross gets no gradient, and keeps the cost of the knot beside it."""
    curve = curve_of({0.2: 3.0, 0.7: 1.0, 1.1: 5.0})
    wanted = curve.steps.detach().clone()
    metres = torch.tensor([[0.5], [0.9], [1.1]])
    curve(metres).square().sum().backward()
    gradient = curve.steps.grad
    assert gradient is not None
    beyond = knots()[1:] > 1.1 + KNOT
    assert not gradient[torch.from_numpy(beyond)].any()
    assert not wanted[torch.from_numpy(beyond)].any()


def test_a_network_looks_at_each_cell_alone() -> None:
    """Planes of other means and scales give the same costs, once it was made for them."""
    rng = np.random.default_rng(1)
    driven = rng.standard_normal((50, 2))
    outputs = []
    for factor, offset in ((1.0, 0.0), (1000.0, 7.0)):
        torch.manual_seed(4)
        network = PlaneNetwork(driven * factor + offset)
        cells = torch.tensor(driven * factor + offset, dtype=torch.float32).reshape(5, 10, 2)
        outputs.append(network(cells).detach().numpy())
    assert outputs[0].shape == (5, 10)
    assert np.abs(outputs[0]).max() <= 1.5
    np.testing.assert_allclose(outputs[0], outputs[1], atol=1e-3)
