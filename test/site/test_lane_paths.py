# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lane paths of sites: picked, surveyed and mixed lines, and errors."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.errors import SiteError
from stereo_speed.site.file import LaneSpec, PickedLine, Site, SurveyedLine
from stereo_speed.site.lane_paths import in_one_direction, lane_paths


def site_of(lines, *lanes):
    """Return a site of picked (left, right) or surveyed (points) lines."""
    made = {name: PickedLine(name, *value) if isinstance(value, tuple) else
            SurveyedLine(name, value) for name, value in lines.items()}
    lanes = lanes or (('edge_right', 'line_0', None), ('line_0', 'edge_left', None))
    return Site('site.yaml', 'test', made, tuple(
        LaneSpec(f'lane_{i}', *names, 20.0) for i, names in enumerate(lanes)))


@pytest.fixture(scope='module')
def scene(make_scene):
    """Return a straight road."""
    return make_scene(seed=1)


def test_lanes_of_a_picked_site(scene):
    """Two lanes side by side, 3.5 m apart, s from the first pick."""
    lanes = lane_paths(site_of(scene.lines), scene.rig)
    assert list(lanes) == ['lane_0', 'lane_1'] and lanes['lane_0'].speed_limit_mps == 20.0
    path, other = lanes['lane_0'].path, lanes['lane_1'].path
    s = path.arc_length(other.position(40.0))
    across = (other.position(40.0) - path.position(s)) @ path.frame(s)
    np.testing.assert_allclose(across, [0, 3.5, 0], atol=0.15)
    first = scene.rig.left.project(path.position(0.0))[0]
    assert np.linalg.norm(first - scene.lines['edge_right'][0][0]) < 60


def test_path_line_surveyed_and_mixed(scene):
    """The same lane from its picked middle, from points and from one line of each kind."""
    wanted = lane_paths(site_of(scene.lines), scene.rig)['lane_0'].path
    right_m = np.stack([wanted.position(s) - 1.75 * wanted.frame(s)[:, 1]
                        for s in np.linspace(5, 60, 12)])
    site = site_of({'right': right_m, 'line_0': scene.lines['line_0']},
                   ('right', 'line_0', None), (None, None, 'right'))
    lanes = lane_paths(site, scene.rig)
    s = wanted.arc_length(lanes['lane_0'].path.position(np.linspace(5, 50, 5)))
    np.testing.assert_allclose(
        lanes['lane_0'].path.position(np.linspace(5, 50, 5)), wanted.position(s), atol=0.1)
    np.testing.assert_allclose(lanes['lane_1'].path.position(0.0), right_m[0], atol=1e-9)
    assert lanes['lane_1'].residual_px == 0.0
    single = lane_paths(
        site_of({'line_0': scene.lines['line_0']}, (None, None, 'line_0')), scene.rig)
    assert single['lane_0'].path.tangent(0.0) @ scene.tangent[0] > np.cos(np.radians(0.2))


@pytest.mark.parametrize('std_m', [0.001, 0.03])
def test_lane_of_a_clicked_and_a_surveyed_line_is_as_uncertain_as_its_clicks(scene, std_m):
    """The direction of a single clicked line is known far worse than that of measured points."""
    rng, errors = np.random.default_rng(3), []
    path = lane_paths(site_of(scene.lines), scene.rig)['lane_0'].path
    along = np.linspace(5, 45, 12)
    right_m, left_m = (np.stack([path.position(s) + across * path.frame(s)[:, 1] for s in along])
                       for across in (-1.75, 1.75))
    for _ in range(25):
        clicks = tuple(uv + rng.normal(0, 0.3, uv.shape) for uv in scene.rig.project(left_m)[:2])
        site = site_of({'right': right_m, 'left': clicks}, ('right', 'left', None))
        site = replace(site, lines={**site.lines, 'right': replace(
            site.lines['right'], std_m=std_m)})
        lane = lane_paths(site, scene.rig)['lane_0']
        s = lane.path.length_m / 2
        off = lane.path.tangent(s) @ path.frame(path.arc_length(lane.path.position(s)))[:, 1:]
        errors.append(off / lane.heading_std_rad)
    score = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (score < 1.3).all() and np.abs(errors).max() < 4.0


def test_surveyed_lines_that_are_swapped_or_opposed_are_refused(scene):
    path = lane_paths(site_of(scene.lines), scene.rig)['lane_0'].path
    right_m, left_m = (np.stack([path.position(s) + across * path.frame(s)[:, 1]
                                 for s in np.linspace(5, 45, 12)]) for across in (-1.75, 1.75))
    clicks = tuple(scene.rig.project(left_m)[:2])
    lanes = ('right', 'left', None)
    for left in (left_m, clicks):
        assert lane_paths(site_of({'right': right_m, 'left': left}, lanes), scene.rig)
        with pytest.raises(SiteError, match=r'lanes\[0\]: found right opposed to left, wanted p'):
            lane_paths(site_of({'right': right_m[::-1], 'left': left}, lanes), scene.rig)
        with pytest.raises(SiteError, match=r'lanes\[0\].right: found left, left of right, want'):
            lane_paths(site_of({'right': right_m, 'left': left}, ('left', 'right', None)),
                       scene.rig)


@pytest.mark.parametrize('bend', [1, -1], ids=['to the left', 'to the right'])
@pytest.mark.parametrize('swapped', [False, True])
def test_surveyed_lines_of_other_lengths_are_compared_where_there_are_both(scene, bend, swapped):
    """The right one goes on for 250 m round a bend, the left one ends after 60 m."""
    def line_m(radius_m, length_m):
        angle = np.linspace(0.0, length_m / 200.0, 40)
        return np.stack([bend * (200.0 - radius_m * np.cos(angle)), np.full(40, 3.0),
                         70.0 - radius_m * np.sin(angle)], axis=-1)
    # At the camera's end both run towards it, and bend to the driver's left or right.
    outer, inner = 201.75, 198.25
    right, left = (outer, inner) if bend > 0 else (inner, outer)
    lines = {'right': line_m(right, 250.0), 'left': line_m(left, 60.0)}
    names = ('left', 'right') if swapped else ('right', 'left')
    site = site_of(lines, (*names, None))
    if swapped:
        with pytest.raises(SiteError, match='left of'):
            lane_paths(site, scene.rig)
    else:
        assert lane_paths(site, scene.rig)


def shuffled(uv):
    """Swap two distant picks."""
    uv = uv.copy()
    uv[[4, 6]] = uv[[6, 4]]
    return uv


def test_refusals(scene):
    """Each fault is named with its place."""
    right, middle, left = (scene.lines[n] for n in ('edge_right', 'line_0', 'edge_left'))
    near = tuple(uv[-1] + np.linspace(-0.3, 0, 6)[:, None] * (uv[-1] - uv[-2]) for uv in middle)
    outside = middle[0] + [0.0, 800.0]
    cases = {
        r'lines.line_0.left_image\[\d+\]: found a pick behind': {
            **scene.lines, 'line_0': (shuffled(middle[0]), middle[1])},
        r'lines.line_0.right_image\[\d+\]: found a pick behind': {
            **scene.lines, 'line_0': (middle[0], middle[1][::-1])},
        r'lanes\[0\].right: found edge_right, left of line_0': {
            'edge_right': left, 'line_0': middle, 'edge_left': right},
        r'lines.line_0.left_image\[\d+\]: found .*a pixel of the 1024x768 image': {
            **scene.lines, 'line_0': (outside, middle[1])},
        r'm, wanted at least 5.0 m of road': {**scene.lines, 'line_0': near},
    }
    for match, lines in cases.items():
        with pytest.raises(SiteError, match=f'site.yaml: .*{match}'):
            lane_paths(site_of(lines), scene.rig)


def over_crest(rig, left_m, rng):
    """Return clicks on a line of a bend of 95 m radius whose grade falls from 4 to -2 %."""
    s = np.linspace(0.0, 85.0, 8501)
    grade = 0.0375 - 0.0604 * np.clip((s - 10.0) / 70.0, 0, 1)
    turn = 0.0105 * (s - 60.0)
    height, ahead, aside = (0.01 * (np.cumsum(rate) - np.sum(rate))
                            for rate in (grade, np.cos(turn), np.sin(turn)))
    points = np.stack([left_m * np.cos(turn) - 3.0 + aside, 5.0 - height,
                       7.0 - ahead + left_m * np.sin(turn)], axis=-1)
    left, right, *seen = rig.project(points)
    views = []
    for view, inside in zip((left, right), seen):
        at = np.flatnonzero(inside)
        some = at[np.linspace(0, len(at) - 1, 14).astype(int)]
        views.append(view[some] + rng.normal(0, 0.3, (14, 2)))
    return tuple(views)


@pytest.mark.parametrize('seed', [3, 4, 5])
def test_picks_beyond_a_crest_are_in_order(scene, seed):
    """The road that fits the clicks may end before them, and all of them lie at its end."""
    rng = np.random.default_rng(seed)
    lines = {name: over_crest(scene.rig, left_m, rng) for name, left_m in (
        ('edge_right', -1.75), ('line_0', 1.75), ('edge_left', 5.25))}
    assert len(lane_paths(site_of(lines), scene.rig)) == 2


def test_what_a_site_says_of_the_errors_of_a_path_adds_in_squares(scene):
    site = site_of(scene.lines)
    doubted = replace(site, lanes=(replace(site.lanes[0], path_std=0.03), *site.lanes[1:]))
    plain, said = (lane_paths(each, scene.rig) for each in (site, doubted))
    first, *others = (lane.name for lane in site.lanes)
    assert said[first].shape_std == pytest.approx(np.hypot(plain[first].shape_std, 0.03))
    assert all(said[name].shape_std == plain[name].shape_std for name in others)


def test_views_that_disagree_are_refused(scene):
    """Lines that bend differently in the two views cannot be the same line."""
    left, right = scene.lines['line_0']
    wave = right + np.stack([40 * np.sin(np.arange(14) * 1.7), np.zeros(14)], axis=-1)
    site = site_of({**scene.lines, 'line_0': (left, wave)})
    with pytest.raises(SiteError, match='line_0'):
        lane_paths(site, scene.rig)


def bend_in_view(rig, radius_m):
    """Return the picks (left, right) of a line that comes round a bend of 180 degrees."""
    angle = np.radians(np.linspace(100, 280, 14))
    points = np.column_stack([5 + radius_m * np.cos(angle), np.full(14, 5.0),
                              70 + radius_m * np.sin(angle)])
    return rig.project(points)[:2]


@pytest.mark.parametrize('clicked', [False, True])
def test_lines_round_a_bend_have_one_direction_unless_clicked_oppositely(scene, clicked):
    """Such lines fold in the image, so that epipolar lines cross them twice."""
    lines = {'edge_right': bend_in_view(scene.rig, 15.0), 'line_0': bend_in_view(scene.rig, 11.5)}
    if clicked:
        lines['line_0'] = tuple(view[::-1] for view in lines['line_0'])
    site = site_of(lines, ('edge_right', 'line_0', None))
    assert in_one_direction(site, scene.rig)[1] == ({'line_0'} if clicked else set())
