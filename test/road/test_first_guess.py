# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The initial guess of the fit, from exact picks."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.road.first_guess import guess_road, Hints, NoRoadError
from stereo_speed.road.fit import fit_road
from stereo_speed.road.problem import Picks, RoadProblem


@pytest.mark.parametrize('distorted', [False, True])
def test_exact_picks_of_a_straight_road(make_scene, distorted):
    """Height, direction and offsets are right to centimetres, residuals to a pixel."""
    scene = make_scene(std_px=0.0, distorted=distorted)
    model, x = guess_road(scene.rig, list(scene.lines.values()), 0)
    assert not any(model.shape) and model.lines == 3
    np.testing.assert_allclose(np.diff(np.sort(model.offsets(x))), [3.5, 3.5], atol=0.05)
    assert model.frame[:, 0] @ scene.tangent[0] > np.cos(np.radians(0.1))
    picks = Picks.of(scene.lines)
    assert np.abs(RoadProblem(scene.rig, picks, model).feet(x).residual_px).max() < 1.0


def test_exact_picks_of_a_curve(make_scene):
    """One curvature coefficient is the half length over the radius."""
    scene = make_scene(curvature=1 / 80, std_px=0.0)
    model, x = guess_road(scene.rig, list(scene.lines.values()), 1)
    along = x[4 + model.lines] / model.half_length_m  # of the longest line, not of the lane
    assert along == pytest.approx(1 / 80, rel=0.12)
    np.testing.assert_allclose(np.diff(np.sort(model.offsets(x))), [3.5, 3.5], atol=0.4)


def test_line_found_only_near_its_ends_has_little_influence(make_scene):
    """A curve through its two ends would cut through the bend."""
    scene = make_scene(curvature=1 / 80, std_px=0.0)
    whole, x = guess_road(scene.rig, list(scene.lines.values()), 1)
    for name in scene.lines:
        ends = {**scene.lines, name: tuple(
            view[[0, -3, -2, -1]] for view in scene.lines[name])}
        model, found = guess_road(scene.rig, list(ends.values()), 1)
        assert found[4 + model.lines] / model.half_length_m == pytest.approx(
            x[4 + whole.lines] / whole.half_length_m, rel=0.1)
        assert model.frame[:, 2] @ whole.frame[:, 2] > np.cos(np.radians(0.5))


def test_every_pick_is_within_the_road(make_scene):
    scene = make_scene(std_px=0.0)
    model, x = guess_road(scene.rig, list(scene.lines.values()), 0)
    feet = RoadProblem(scene.rig, Picks.of(scene.lines), model).feet(x)
    assert np.all(np.abs(feet.s_m) < 1.05 * model.half_length_m)


def test_views_without_common_points_are_refused(make_scene):
    flat = np.stack([np.linspace(100, 900, 10), np.full(10, 400.0)], axis=-1)
    with pytest.raises(NoRoadError, match='fewer than 3 points in common'):
        guess_road(make_scene().rig, [(flat, flat - [10, 0])], 0)


def test_line_above_the_horizon_of_the_others_is_refused(make_scene):
    """No ray of its picks meets their surface."""
    scene = make_scene(std_px=0.0)
    names = list(scene.lines)
    sky = tuple(view * [1, 0] + [0, 5] for view in scene.lines[names[0]])
    with pytest.raises(NoRoadError, match='do not meet one road surface'):
        guess_road(scene.rig, [sky, *(scene.lines[n] for n in names[1:])], 0,
                   Hints(plane_of=1))


def in_a_sag(rig, x_m):
    """
    Return a line x_m beside the camera on a road that climbs towards it by 2 %, from a sag.

    The camera is 2.3 m high and looks level; 33 to 68 m away the grade changes to 3 % downhill.
    """
    z = np.linspace(100, 11, 2000)
    sinks = np.interp(z, [33, 68], [0.02, -0.03])  # with the distance
    below_m = 2.3 + 0.02 * 11 + np.cumsum((sinks * np.gradient(-z))[::-1])[::-1]
    picks = []
    for view in rig.project(np.stack([np.full_like(z, x_m), below_m, z], axis=-1))[:2]:
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(view, axis=0), axis=-1))])
        at = np.linspace(0, along[-1], 14)
        picks.append(np.stack([np.interp(at, along, column) for column in view.T], axis=-1))
    return tuple(picks)


def test_road_through_a_sag_is_as_long_as_its_visible_part(make_scene):
    """The plane of its near part meets the rays of its far part kilometres away, or never."""
    rig = make_scene().rig
    lines = {name: in_a_sag(rig, x_m) for name, x_m in (('a', -2.0), ('b', 1.5), ('c', 5.0))}
    for terms in (0, 1, 2):
        assert guess_road(rig, list(lines.values()), terms)[0].half_length_m < 100
    assert fit_road(rig, lines).residual_px.max() < 0.3


def on_a_bend(rig, side_m, far_rad, shares):
    """
    Return picks of a line beside a bend of 77 m radius, at shares of its curve in the images.

    The bend turns back in the images, at 54 m from the camera, which is 2.9 m above its plane.
    """
    angle = np.linspace(far_rad, -0.6, 6000)
    radius_m = 77 + side_m
    points = np.stack([radius_m * np.cos(angle) - 75, np.full_like(angle, 2.9),
                       radius_m * np.sin(angle) + 54], axis=-1)
    picks = []
    for view in rig.project(points)[:2]:
        seen = view[(view > 5).all(axis=-1) & (view < [1018, 762]).all(axis=-1)]
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(seen, axis=0), axis=-1)))
        picks.append(np.stack([np.interp(np.array(shares) * along[-1], along, column)
                               for column in seen.T], axis=-1))
    return tuple(picks)


DASH = np.linspace(0, 0.04, 4)


@pytest.mark.parametrize(('far_rad', 'begin', 'dashes', 'hidden'), [
    (1.5, 0.02, (0.2, 0.45, 0.9), 0.5), (1.2, 0.02, (0.2, 0.45, 0.9), 0.6),
    (1.0, 0.02, (0.2, 0.45, 0.9), 0.6), (0.9, 0.02, (0.2, 0.45, 0.9), 0.4),
    (0.9, 0.23, (0.22, 0.38, 0.75), 0.4), (1.2, 0.19, (0.14, 0.72, 0.77), 0.44)])
def test_sharp_bend_is_found_by_lines_with_gaps(make_scene, far_rad, begin, dashes, hidden):
    """Of one line three dashes were found, of another a fifth: curves through them go astray."""
    rig = make_scene().rig
    lines = {
        'solid': on_a_bend(rig, -3.5, far_rad, [0, *np.linspace(begin, 1, 41)]),
        'dashed': on_a_bend(rig, 0.0, far_rad, [0, *np.add.outer(dashes, DASH).ravel(), 1]),
        'hidden': on_a_bend(rig, 3.5, far_rad, [0, *np.linspace(hidden, hidden + 0.2, 12), 1])}
    assert fit_road(rig, lines).residual_px.max() < 0.3
