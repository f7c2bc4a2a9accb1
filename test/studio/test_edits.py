# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Steps of a draft: their effect, the index of a new point, and errors."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.studio.draft import Draft, Point
from stereo_speed.studio.edits import apply, no_snap, place_for


def after(*steps, draft=Draft(), snapper=no_snap):
    """Return a draft after steps."""
    for name, fields in steps:
        draft = apply(draft, name, fields, snapper)
    return draft


def drawn(*points):
    """Return a draft with one line through points of the left view."""
    return after(('add_line', {}), *(
        ('add_point', {'line': 1, 'view': 'left', 'at': list(p)}) for p in points))


@pytest.mark.parametrize(('at', 'index'), [
    ((5.0, 1.0), 1), ((15.0, -1.0), 2), ((-5.0, 0.0), 0), ((26.0, 0.0), 3), ((20.0, 5.0), 3)])
def test_new_point_goes_between_its_neighbours(at, index):
    points = (Point(0.0, 0.0), Point(10.0, 0.0), Point(20.0, 0.0))
    if at == (20.0, 5.0):  # beside the last one: either side of it is right
        assert place_for(points, np.array(at)) in (2, 3)
    else:
        assert place_for(points, np.array(at)) == index


def test_points_are_added_moved_and_deleted():
    draft = drawn((0, 0), (20, 0), (10, 1))
    assert [(p.u, p.v) for p in draft.lines[0].left] == [(0, 0), (10, 1), (20, 0)]
    draft = after(('move_point', {'line': 1, 'view': 'left', 'index': 1, 'at': [11, 2]}),
                  ('delete_point', {'line': 1, 'view': 'left', 'index': 0}), draft=draft)
    assert [(p.u, p.v) for p in draft.lines[0].left] == [(11, 2), (20, 0)]
    assert draft.lines[0].right == ()


def test_points_snap_only_on_request_and_along_their_line():
    ways = []

    def snapper(view, at, way):
        ways.append(None if way is None else way.tolist())
        return Point(float(at[0]), 100.0, 0.05)
    step = ('add_point', {'line': 1, 'view': 'right', 'at': [3, 4], 'snap': True})
    draft = after(('add_line', {}), step, draft=Draft(), snapper=snapper)
    assert draft.lines[0].right == (Point(3.0, 100.0, 0.05),)
    draft = after(('add_point', {'line': 1, 'view': 'right', 'at': [9, 99], 'snap': True}),
                  draft=draft, snapper=snapper)
    assert ways == [None, [6.0, -1.0]]  # from the point before to where it was clicked
    draft = after(('add_point', {'line': 1, 'view': 'right', 'at': [30, 7], 'snap': False}),
                  draft=draft, snapper=snapper)
    assert draft.lines[0].right[-1] == Point(30.0, 7.0)


def test_deleted_line_leaves_no_trace():
    draft = after(('add_line', {}), ('add_line', {}), ('add_lane', {'right': 1, 'left': 2}),
                  ('add_length', {'kind': 'between'}),
                  ('set_length', {'length': 4, 'lines': [1, 2], 'length_m': 3.5}),
                  ('delete_line', {'line': 2}))
    assert (draft.lanes[0].right, draft.lanes[0].left) == (1, None)
    assert draft.lengths[0].lines == (1,)
    assert [line.number for line in draft.lines] == [1]
    assert after(('add_line', {}), draft=draft).lines[-1].number == 5  # numbers are not used again


def test_lane_has_a_path_or_two_lines():
    draft = after(('add_line', {}), ('add_line', {}), ('add_lane', {'right': 1, 'left': 2}),
                  ('set_lane', {'lane': 3, 'path': 1}))
    assert (draft.lanes[0].path, draft.lanes[0].right, draft.lanes[0].left) == (1, None, None)
    draft = after(('set_lane', {'lane': 3, 'right': 1, 'speed_limit': '55 mph'}), draft=draft)
    assert (draft.lanes[0].path, draft.lanes[0].right) == (None, 1)
    assert draft.lanes[0].speed_limit == '55 mph'


def test_fifth_corner_moves_the_nearest():
    corner = [('front_corner', {'front': 1, 'view': 'left', 'at': at})
              for at in ([0, 0], [10, 0], [10, 10], [0, 10], [11, 9])]
    front, = after(('add_front', {'frame': 3}), *corner).fronts
    assert [(p.u, p.v) for p in front.left] == [(0, 0), (10, 0), (11, 9), (0, 10)]


@pytest.mark.parametrize(('name', 'fields', 'told'), [
    ('burn', {}, "step: found 'burn'"),
    ('add_point', {'line': 9, 'view': 'left', 'at': [0, 0]}, 'number 9'),
    ('add_point', {'line': 1, 'view': 'top', 'at': [0, 0]}, 'one of left, right'),
    ('add_point', {'line': 1, 'view': 'left', 'at': [0]}, 'a pixel'),
    ('add_point', {'line': 1, 'view': 'left', 'at': [0, float('nan')]}, 'at.v'),
    ('add_point', {'line': 1, 'view': 'left', 'at': ['0', 1]}, 'at.u'),
    ('add_point', {'line': 1, 'view': 'left', 'at': [0, 1e9]}, 'at.v'),
    ('add_point', {'line': 1, 'view': 'left', 'at': [0, 0], 'colour': 1}, 'unknown key colour'),
    ('move_point', {'line': 1, 'view': 'left', 'index': 0, 'at': [0, 0]}, 'below 0'),
    ('rename_line', {'line': 1, 'name': ''}, 'a name'),
    ('rename_line', {'line': 1, 'name': 'x' * 81}, 'at most 80'),
    ('rename_line', {'line': 1, 'name': 'other'}, 'other twice'),
    ('rename_line', {'line': True, 'name': 'x'}, 'an integer'),
    ('set_lane', {'lane': 3, 'speed_limit': '55'}, "a speed like '55 mph'"),
    ('set_lane', {'lane': 3, 'right': 44}, 'number 44'),
    ('set_length', {'length': 4, 'length_m': -1}, r'm in \[0.01, 1000\]'),
    ('set_length', {'length': 4, 'lines': [1, 1]}, 'one line, or two'),
    ('add_length', {'kind': 'wide'}, 'one of between'),
    ('add_front', {'frame': -1}, 'an integer from 0'),
    ('set_calibrated', {'day': '2026-02-30'}, 'a day such as 2026-05-31'),
])
def test_impossible_step_says_why(name, fields, told):
    draft = after(('add_line', {}), ('add_line', {'name': 'other'}), ('add_lane', {}),
                  ('add_length', {'kind': 'between'}))
    with pytest.raises(InputError, match=told):
        apply(draft, name, fields, no_snap)


def test_other_steps():
    draft = drawn((0, 0), (10, 0))
    draft = after(('rename_site', {'name': ' north  gate '}), ('turn_line', {'line': 1}),
                  ('add_lane', {}), ('add_length', {'kind': 'points'}),
                  ('add_front', {'frame': 0}),
                  ('length_point', {'length': 3, 'view': 'right', 'at': [1, 2]}), draft=draft)
    assert draft.name == 'north gate'
    assert draft.calibrated is None
    dated = after(('set_calibrated', {'day': '2026-05-31'}), draft=draft)
    assert dated.calibrated == '2026-05-31'
    assert after(('set_calibrated', {'day': ''}), draft=dated) == draft
    assert [(p.u, p.v) for p in draft.lines[0].left] == [(10, 0), (0, 0)]
    assert draft.lengths[0].right == (Point(1.0, 2.0),)
    snapped = apply(draft, 'snap_line', {'line': 1},
                    lambda view, at, way: Point(float(at[0]), 5.0, 0.1) if at[0] else None)
    assert snapped.lines[0].left == (Point(10.0, 5.0, 0.1), Point(0.0, 0.0))
    draft = after(('delete_lane', {'lane': 2}), ('delete_length', {'length': 3}),
                  ('delete_front', {'front': 4}), draft=draft)
    assert (draft.lanes, draft.lengths, draft.fronts) == ((), (), ())
