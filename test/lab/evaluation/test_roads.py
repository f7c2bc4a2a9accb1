# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Summaries of random roads, worked by hand."""
from __future__ import annotations

import math

import numpy as np
import pytest
from stereo_speed.batch.job import Result
from stereo_speed.lab.evaluation.roads import (
    draw_road, KINDS, kinds_table, road_figures, RUN_OFF)
from stereo_speed.lab.sim.road import Road


def road(kind, clicks, refined, std=0.001, turned=False):
    value = {'kind': kind, 'turned': turned}
    if clicks is not None:
        value.update(clicks_error=clicks, clicks_std=0.002)
    if refined is not None:
        value.update(refined_error=refined, refined_std=std)
    return Result(key=kind, value=value)


RESULTS = [road('bend', 0.003, 0.001), road('bend', -0.004, -0.005, turned=True),
           road('sag', None, 0.002), road('sag', 0.001, None), Result(key='x', error='failed')]


def test_table_has_a_row_for_each_kind():
    rows = {row[0]: row[1:] for row in kinds_table(RESULTS).rows}
    assert list(rows) == ['all', 'bend', 'sag']
    assert rows['bend'] == pytest.approx(
        [2, math.sqrt(12.5) / 10, math.sqrt(13) / 10, 0.5, math.sqrt(13), 1, 1, 1, 0])
    # without clicks there is no comparison
    assert rows['sag'] == pytest.approx([2, 0.1, 0.2, 0.2, 2.0, 0, 0, 0, 1])
    assert rows['all'][0] == 4


def test_summary_sentence_of_all():
    assert road_figures(RESULTS).startswith(
        '4 roads: 3 refined, 1 refused, 0 kept as clicked, 1 found turned, 1 worse than the')


def test_kinds_alternate_and_cameras_rotate_to_either_side():
    drawn = [draw_road(0, number, 0.02) for number in range(2 * len(KINDS))]
    assert [road.kind for road in drawn] == 2 * list(KINDS)
    pans = np.array([road.config.rig_moved_deg[0] for road in drawn])
    assert set(np.abs(pans)) == {0.02} and abs(np.sign(pans).sum()) < len(pans)
    assert draw_road(0, 3).config == draw_road(0, 3).config != draw_road(1, 3).config


@pytest.mark.parametrize('number', range(12))
def test_run_offs_begin_or_end_in_view_and_turn_about_a_line_or_the_middle(number):
    drawn = draw_road(0, number, run_off=True)
    config, lines = drawn.config.road, Road(drawn.config.road).line_offsets()
    ends_m = config.clothoid_at_m, config.clothoid_at_m + config.clothoid_m
    assert drawn.kind == RUN_OFF and any(4 <= end <= 20 for end in ends_m)
    assert 0.0 in (config.curvature_start, config.curvature_end)
    assert any(config.turned_about_m == pytest.approx(place) for place in (
        lines['edge_right'], lines['edge_left'], (lines['edge_right'] + lines['edge_left']) / 2))
