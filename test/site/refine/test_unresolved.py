# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Far points of markings too narrow to be told from what lies beside them."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stereo_speed.core.records import StereoPair
from stereo_speed.site.file import PickedLine
from stereo_speed.site.refine import refiner, unresolved
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.markings import LocatedLine
from stereo_speed.site.refine.refiner import refine_site
from stereo_speed.site.refine.report import report
from stereo_speed.site.refine.section_model import BAND, EDGE, Shape
from stereo_speed.site.refine.unresolved import clicks_where_unresolved

LINES_M = {'right': -2.0, 'left': 1.5}
Z_M = np.linspace(44.0, 13.0, 32)
WIDTH_M = 0.04  # 1 px at a depth of 36 m times the cosine of the line's slope in the image
CLICK_PX = 0.3
SIGMAS = 3.0


def width_px(x_m, right):
    """Return how wide a marking is at the depths of the points, px."""
    return WIDTH_M * 900.0 / Z_M * 3.0 / np.hypot(3.0, x_m - 0.5 * right)


def located(drawn, name, off_px, kind=BAND):
    """Return a line as found, so far to the left of its true place in each view."""
    shape = Shape(kind, WIDTH_M if kind == BAND else 0.0, 0.6, 1)
    return tuple(LocatedLine(drawn.line(name, Z_M, right) + np.stack(
        [off, np.zeros_like(off)], axis=-1), np.full(32, 0.05), Z_M[0] - Z_M, shape, 0.1, 90, 90)
        for right, off in enumerate(off_px))


def found_with(drawn, right=(0.0, 0.0), left=(0.0, 0.0), kind=BAND):
    """Return both lines as found, with errors (2,) or (2, n) of each, px."""
    return {name: located(drawn, name, [np.broadcast_to(np.asarray(o, float), 32) for o in off],
                          kind)
            for name, off in (('right', right), ('left', left))}


def thin(name, right):
    return width_px(LINES_M[name], right) < 1


FAR = {right: np.where(thin('right', right), 2.0, 0.0) for right in (0, 1)}


@pytest.mark.parametrize('off_px, kind', [
    ({}, BAND),
    ({'right': (1.0, 1.0)}, BAND),
    ({'right': (3 * FAR[0], 0.1 * FAR[1])}, BAND),  # in one view only
    ({'right': (5 * FAR[0], -FAR[1])}, BAND),  # to different sides
    ({'right': (0.5 * FAR[0], 0.5 * FAR[1])}, BAND),  # 3 sigmas of a click are 0.9 px
    ({'right': (3.0, 3.0)}, BAND),  # another line as a whole
    ({'right': (3.0, 3.0), 'left': (3.0, 3.0)}, BAND),  # a knock of the rig
    ({'right': (FAR[0], FAR[1])}, EDGE)])
def test_points_stay(drawn, off_px, kind):
    found = found_with(drawn, **off_px, kind=kind)
    assert clicks_where_unresolved(drawn.fit, drawn.lines, found, SIGMAS) is found


def test_points_that_contradict_those_of_a_refined_site_stay(drawn):
    """The old ones may have been found on a worse day."""
    found = found_with(drawn, right=(FAR[0], FAR[1]))
    old = {name: replace(line, left_std_px=np.full(12, 0.05), right_std_px=np.full(12, 0.05))
           for name, line in drawn.lines.items()}
    assert clicks_where_unresolved(drawn.fit, old, found, SIGMAS) is found


def test_far_points_beside_the_clicks_give_way_to_these(drawn):
    """Those of the other line too, as the far stretch of one shows something else."""
    found = found_with(drawn, right=(FAR[0], FAR[1]))
    kept = clicks_where_unresolved(drawn.fit, drawn.lines, found, SIGMAS)
    for name, x_m in LINES_M.items():
        for right, (line, before) in enumerate(zip(kept[name], found[name])):
            clicks_px = drawn.lines[name].views_px[right]
            # the clicks are at even depths, from 45 to 12 m
            scale = np.interp(np.linspace(-45, -12, 12), -Z_M, width_px(x_m, right))
            count = int((scale < 1).sum())
            wanted_px = np.concatenate([clicks_px[:count], before.uv_px[~thin(name, right)]])
            assert count >= 3
            np.testing.assert_allclose(line.uv_px, wanted_px, atol=0.02)
            assert (np.diff(line.s_m) > 0).all()
            # and what the nearer clicks leave unknown of their common displacement
            assert ((line.std_px[:count] > CLICK_PX) & (line.std_px[:count] < 0.6)).all()
            np.testing.assert_array_equal(line.std_px[count:], 0.05)
            np.testing.assert_array_equal(line.is_clicked, np.arange(len(line.s_m)) < count)


@pytest.mark.parametrize('turn_deg', [(0.1, 0.0, 0.0), (0.0, 0.1, 0.0)])
@pytest.mark.parametrize('off_m', [0.0, 0.15])
def test_rotation_of_the_rig_since_the_clicks_is_no_contradiction(drawn, turn_deg, off_m):
    """Nor does it hide one; it displaces the lines by about 2 px, and then the clicks as well."""
    turned = Rotation.from_euler('xyz', turn_deg, degrees=True).as_matrix()

    def seen_px(name, right, beside_m=0.0):
        points = np.stack([np.full(32, LINES_M[name]) + beside_m, np.full(32, 3.0), Z_M], axis=-1)
        return drawn.rig.project(points @ turned.T)[right]
    found = {name: tuple(replace(line, uv_px=seen_px(name, right, np.where(
        thin(name, right) & (name == 'right'), -off_m, 0.0)))
        for right, line in enumerate(lines)) for name, lines in found_with(drawn).items()}
    kept = clicks_where_unresolved(drawn.fit, drawn.lines, found, SIGMAS)
    if not off_m:
        assert kept is found
        return
    for right, line in enumerate(kept['right']):
        clicks_px = line.uv_px[line.is_clicked]
        truth_px = seen_px('right', right)
        along = truth_px[-1] - truth_px[0]
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        moved_px = (drawn.lines['right'].views_px[right][:len(clicks_px)] - truth_px[0]) @ normal
        assert len(clicks_px) >= 3 and np.abs(moved_px).min() > 0.2
        std_px = line.std_px[line.is_clicked]
        off_px = (clicks_px - truth_px[0]) @ normal
        assert (np.abs(off_px) < 1.5 * std_px).all() and std_px.max() < 1.0


@pytest.mark.parametrize('std_px', [0.3, 0.6])
def test_scattered_clicks_do_not_contradict(drawn, std_px):
    """Points as exact as by day are not given up for clicks, be these worse than usual."""
    rng, found, changed = np.random.default_rng(1), found_with(drawn), 0
    for _ in range(100):
        lines = {name: PickedLine(name, *(uv + rng.normal(0, std_px, uv.shape)
                                          for uv in line.views_px))
                 for name, line in drawn.lines.items()}
        changed += clicks_where_unresolved(drawn.fit, lines, found, SIGMAS) is not found
    assert changed == 0


@pytest.mark.parametrize('near', [2, 3])
def test_line_of_which_little_is_left_is_lost(drawn, near):
    found = found_with(drawn, right=(FAR[0], FAR[1]))
    found['right'] = tuple(line.take(np.arange(32) < np.count_nonzero(thin('right', right)) + near)
                           for right, line in enumerate(found['right']))
    kept = clicks_where_unresolved(drawn.fit, drawn.lines, found, SIGMAS)
    assert set(kept) == ({'left'} if near < 3 else {'left', 'right'})


def test_clicks_that_the_road_hides_do_not_count(drawn, monkeypatch):
    monkeypatch.setattr(unresolved, 'hidden', lambda fit, line, right, s_m: s_m < -12.0)
    kept = clicks_where_unresolved(
        drawn.fit, drawn.lines, found_with(drawn, right=(FAR[0], FAR[1])), SIGMAS)
    assert set(kept) == {'left', 'right'}
    for name in kept:
        for line in kept[name]:
            assert line.is_clicked.sum() >= 2 and line.s_m.min() > -12.0


@pytest.mark.slow
def test_road_follows_the_clicks_there(drawn, monkeypatch):
    """Both lines are found farther and farther outside, as where the asphalt is lighter."""
    far = {name: np.where(Z_M > 28.0, 0.2 * sign * (Z_M - 28.0), 0.0)
           for name, sign in (('right', -1), ('left', 1))}
    found = found_with(drawn, **{name: (off, off) for name, off in far.items()})
    monkeypatch.setattr(refiner, 'locate_both', lambda views, *_: found[
        views[0].fit.names[views[0].line]])
    images = [np.clip(drawn.image(right, noise=1.0, seed=right), 0, 255).astype(np.uint8)
              for right in (0, 1)]
    pairs = [StereoPair(0, 0, 0, *images)]
    refined = refine_site(drawn.site, drawn.rig, pairs, RefineConfig())
    road = refined.road
    far_m = road.points(0, road.feet.s_m.min(keepdims=True), np.zeros(1))
    assert abs(far_m[0, 1] - 3.0) < 0.03  # with the points as found, 0.36 m
    assert set(refined.partly_clicked) == {'right', 'left'} and not refined.is_found
    told = [w for w in report(refined).warnings if 'narrower than a pixel' in w]
    assert sorted(w.split(':')[0] for w in told) == ['left', 'right']
