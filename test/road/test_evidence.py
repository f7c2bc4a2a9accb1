# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Which of two roads is more probable, and what its rivals are."""
from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import pytest
from stereo_speed.road import evidence
from stereo_speed.road.evidence import either
from stereo_speed.road.model import RoadShape


def road(curvature, log, wander=None, rivals=()):
    """Return what counts of a fitted road, with its log probability."""
    return SomeRoad(SimpleNamespace(model=SimpleNamespace(shape=RoadShape(curvature)),
                                    wander=wander), log, tuple(rivals))


@dataclass(frozen=True)
class SomeRoad:
    """A fitted road of a known log probability."""

    problem: SimpleNamespace
    log: float
    rivals: tuple


def test_rivals_of_two_searches_count_once(monkeypatch):
    """By hand; families with and without wandering lines are different ones."""
    monkeypatch.setattr(evidence, 'log_probability', lambda fit: fit.log)
    one = road(1, 0.0, rivals=[(0.5, road(2, -0.7)), (0.3, road(3, -1.2, wander=1))])
    other = road(2, -1.0, rivals=[(0.9, road(4, -1.1)), (0.8, road(1, -1.2)),
                                  (0.2, road(3, -2.6)), (0.001, road(5, -8.0))])
    for pair in ((one, other), (other, one)):
        best = either(*pair)
        assert best.log == 0.0
        found = [(round(share, 3), fit.problem.model.shape.curvature, fit.problem.wander)
                 for share, fit in best.rivals]
        assert found == [(0.5, 2, None), (0.331, 4, None), (0.3, 3, 1), (0.074, 3, None)]


@pytest.mark.parametrize('gain, wanted', [(0.001, 'first'), (0.1, 'second')])
def test_rounding_does_not_choose_between_two_searches(monkeypatch, gain, wanted):
    monkeypatch.setattr(evidence, 'log_probability', lambda fit: fit.log)
    first, second = road(1, 0.0), road(1, gain)
    assert either(first, second).log == {'first': 0.0, 'second': gain}[wanted]
    assert either(road(2, 0.0), second).log == gain
