# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Cross-sections against the closed forms of a level road."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.road.problem import RoadProblem
from stereo_speed.site.refine.cross_sections import BORDER_PX, LineView, SPACING_PX
from stereo_speed.site.refine.empty_road import Background, LIGHT_STEP_PX

F_PX, HEIGHT_M = 900.0, 3.0


@pytest.fixture(scope='module')
def view(drawn):
    """Return the right-hand line in an image whose grey level is the column."""
    ramp = np.tile(np.arange(640, dtype=np.float32), (360, 1))
    return LineView(drawn.fit, 0, False, Background(ramp, 1.0, 9))


def test_places_and_scale(drawn, view):
    """A metre across is f / z px along a row, projected onto the line's normal."""
    ends = drawn.lines['right'].left_px[[0, -1]]
    sections = view.sections(ends)
    uv = view.seen(sections.s_m, np.zeros(len(sections.s_m)))
    z = F_PX * HEIGHT_M / (uv[:, 1] - 60.0)
    sine = HEIGHT_M / np.hypot(HEIGHT_M, 2.0)  # the line is at x = -2
    np.testing.assert_allclose(sections.px_per_m, F_PX / z * sine, rtol=1e-4)
    steps = np.linalg.norm(np.diff(uv, axis=0), axis=-1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-2)
    assert SPACING_PX <= steps[0] < 1.02 * SPACING_PX
    inside = (uv >= BORDER_PX) & (uv <= np.array([639, 359]) - BORDER_PX)
    assert inside.all() and np.linalg.norm(uv[0] - ends[0]) < 3


def test_grey_levels_are_read_across(drawn, view):
    """On a ramp of columns the levels are the columns of the places."""
    sections = view.sections(drawn.lines['right'].left_px[[0, -1]])
    across = np.tile(np.linspace(-0.3, 0.3, 7), (len(sections.s_m), 1))
    grey = view.read(sections, across)
    uv = view.seen(sections.s_m, across)
    known = np.isfinite(grey)
    assert known.mean() > 0.9
    np.testing.assert_allclose(grey[known], uv[known][:, 0], atol=1e-4)  # single precision
    assert np.all(np.diff(grey, axis=1)[known[:, 1:] & known[:, :-1]] > 0)  # to the left of travel


def test_cross_section_beside_the_camera_is_limited_to_the_image(drawn, view):
    """Where a line passes the camera a metre of it is thousands of pixels."""
    fit = drawn.fit
    problem, model = fit.problem, fit.problem.model
    leaving = replace(model, half_length_m=3 * model.half_length_m,
                      frame=model.frame * [-1, -1, 1])  # so that the camera comes first
    x = np.where(np.arange(len(fit.x)) < 4, fit.x, -fit.x)  # offsets to the other side
    line = replace(view, fit=replace(
        fit, x=x, problem=RoadProblem(problem.rig, problem.picks, leaving)))
    sections = line.sections(np.array([[-1e6, 1.5e6], drawn.lines['right'].left_px[0]]))
    assert len(sections.s_m) > 10
    assert sections.arc_px.max() < 3 * np.hypot(640, 360)


def test_road_behind_the_camera_has_no_cross_sections(drawn, view):
    """There is nothing to read, and that is no error."""
    problem = drawn.fit.problem
    behind = replace(problem.model, centre_m=problem.model.centre_m * [1, 1, -1])
    line = replace(view, fit=replace(drawn.fit, problem=RoadProblem(
        problem.rig, problem.picks, behind)))
    sections = line.sections(drawn.lines['right'].left_px[[0, -1]])
    assert len(sections.s_m) == len(sections.arc_px) == len(sections.px_per_m) == 0
    assert line.read(sections, np.zeros((0, 7))).shape == (0, 7)
    assert sections.swept.shape == (0,)


def test_cross_sections_can_be_selected(drawn, view):
    sections = view.sections(drawn.lines['right'].left_px[[0, -1]])
    some = np.arange(len(sections.s_m)) % 3 == 0
    taken = sections.take(some)
    np.testing.assert_array_equal(taken.arc_px, sections.arc_px[some])
    np.testing.assert_array_equal(taken.px_per_m, sections.px_per_m[some])
    np.testing.assert_array_equal(taken.swept, sections.swept[some])


def test_places_that_lamps_sweep_are_read_no_brighter_than_the_rest(drawn, view):
    """Below a row of the image it is five times brighter, and the light changes by 30 %."""
    image = np.full((360, 640), 50, np.float32)
    change = np.zeros((360 // LIGHT_STEP_PX, 640 // LIGHT_STEP_PX), np.float32)
    image[196:], change[200 // LIGHT_STEP_PX:] = 250, 0.3
    line = replace(view, view=replace(view.view, image=image, change=change))
    sections = line.sections(drawn.lines['right'].left_px[[0, -1]], 0.29)
    v = line.seen(sections.s_m, np.zeros(len(sections.s_m)))[:, 1]
    np.testing.assert_array_equal(sections.swept, v > 200 - LIGHT_STEP_PX / 2)
    assert not line.sections(drawn.lines['right'].left_px[[0, -1]], 0.31).swept.any()
    grey = line.read(sections, np.zeros((len(v), 3)))
    np.testing.assert_allclose(grey[(v < 190) | sections.swept], 50.0, rtol=3e-3)
    alone = sections.take(sections.swept)
    np.testing.assert_allclose(line.read(alone, np.zeros((len(alone.s_m), 3))), 250.0, rtol=3e-3)
    # neither a few places in steady light, nor dark ones, tell how bright the line is
    few = sections.take(sections.swept | (np.cumsum(~sections.swept) < 4))
    assert line.read(few, np.zeros((len(few.s_m), 3))).max() > 240
    dark = replace(line, view=replace(line.view, image=np.where(image == 50, 2, image)))
    assert dark.read(sections, np.zeros((len(v), 3)))[sections.swept].min() > 19
