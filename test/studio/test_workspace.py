# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A draft from its first point to its file, and back."""
from __future__ import annotations

from dataclasses import fields, replace

from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.tracker_config import TOLERANCES
from stereo_speed.io.truth import read_truth
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.write import site_text
from stereo_speed.studio.scene import epipolar_curve, on_plane
from stereo_speed.studio.workspace import Workspace
import yaml

SITE_FIELDS = {'where', 'name', 'lines', 'lanes', 'correction', 'known_lengths', 'tolerances',
               'calibrated', 'text'}


class Drawing:
    """A simulated user who takes steps."""

    def __init__(self, space):
        self.space, self.count = space, 0

    def __call__(self, step, /, **fields):
        self.count += 1
        assert self.space.take({'id': str(self.count), 'name': step, 'fields': fields})

    def site(self, path, every=2, backward=False):
        """Draw the lines of a site file."""
        for number, line in enumerate(load_site(path).picked.values(), 1):
            self('add_line', name=line.name)
            for view, uv in zip(('left', 'right'), line.views_px):
                for at in uv[::-every if backward else every].tolist():
                    self('add_point', line=number, view=view, at=at)


@pytest.fixture
def drawing(space):
    """Return a simulated user."""
    return Drawing(space)


def saved(space):
    """Save and read again."""
    return load_site(space.save())


def judged(space):
    """Return the figures of the current draft."""
    return space.judged(space.draft, space.refined).data


@pytest.mark.slow
def test_drawn_site_is_saved_and_opened_again(space, drawing, sample, tmp_path, scene):
    drawing.site(sample / 'site.yaml')
    drawing('lanes_between')
    data = judged(space)
    assert data['ready'] and not [n for n in data['notes'] if n['level'] == 'error']
    for lane in data['lanes'].values():
        assert abs(lane['width_m'] - 3.5) < 4 * lane['width_std_m'] < 0.4
    assert space.unsaved
    site = saved(space)
    assert not space.unsaved
    assert [(lane.name, lane.right, lane.left) for lane in site.lanes] == [
        ('lane_0', 'edge_right', 'line_0'), ('lane_1', 'line_0', 'edge_left')]
    hand = load_site(sample / 'site.yaml')
    np.testing.assert_allclose(site.picked['line_0'].left_px, hand.picked['line_0'].left_px[::2])
    again = Workspace(scene, space.site_path, tmp_path / 'init.yaml')
    assert not again.unsaved
    assert site_text(again.site(again.draft)) == site_text(site)


@pytest.mark.slow
def test_lanes_run_against_the_order_of_clicks_if_requested(space, drawing, sample):
    """Lines clicked from near to far; the shared line is written once for each direction."""
    drawing.site(sample / 'site.yaml', backward=True)
    right, middle, left = (line.number for line in space.draft.lines)
    drawing('add_lane', right=right, left=middle, backward=True)
    drawing('add_lane', right=left, left=middle)
    data = judged(space)
    assert [n['text'] for n in data['notes'] if n['level'] == 'error'] == []
    site = saved(space)
    assert [(lane.right, lane.left) for lane in site.lanes] == [
        ('edge_right', 'line_0_back'), ('edge_left', 'line_0')]
    hand = load_site(sample / 'site.yaml').picked
    np.testing.assert_array_equal(site.picked['line_0_back'].left_px,
                                  site.picked['line_0'].left_px[::-1])
    assert np.linalg.norm(site.picked['edge_right'].left_px[0] - hand['edge_right'].left_px[0]
                          ) < 60  # from far to near, as travel on this lane goes


@pytest.mark.slow
def test_faults_point_at_their_line_and_leave_the_others(space, drawing, sample):
    drawing.site(sample / 'site.yaml')
    drawing('lanes_between')
    # the left view of the last line drawn in the wrong order
    number, points = 3, [list(p) for p in load_site(
        sample / 'site.yaml').picked['edge_left'].left_px.tolist()[::2]]
    for index in (2, 4):
        drawing('move_point', line=number, view='left', index=index, at=points[6 - index])
    notes = [n for n in judged(space)['notes'] if n['level'] == 'error']
    assert notes and notes[0]['line'] == number and notes[0]['view'] == 'left'
    assert set(judged(space)['lines']) == {'1', '2'}
    assert not judged(space)['ready']
    with pytest.raises(InputError):
        space.save()
    assert not space.site_path.exists()


def test_swapped_sides_point_at_their_lane(space, drawing, sample):
    drawing.site(sample / 'site.yaml')
    drawing('add_lane', right=2, left=1)
    note, = [n for n in judged(space)['notes'] if n['level'] == 'error']
    assert note['lane'] == space.draft.lanes[0].number and "driver's right" in note['text']


def test_undo_redo_and_duplicate_steps(space, drawing):
    drawing('add_line')
    drawing('rename_line', line=1, name='kerb')
    drawing('undo')
    assert space.draft.lines[0].name == 'line_0'
    drawing('undo')
    assert space.draft.lines == ()
    drawing('redo')
    drawing('redo')
    drawing('redo')  # nothing more: no harm
    assert space.draft.lines[0].name == 'kerb'
    version = space.version
    assert not space.take({'id': '1', 'name': 'add_line', 'fields': {}})
    assert (space.version, len(space.draft.lines)) == (version, 1)
    with pytest.raises(InputError, match='number 7'):
        space.take({'id': 'new', 'name': 'delete_line', 'fields': {'line': 7}})
    # a step that was refused was not taken, and changed nothing
    assert space.version == version


def test_file_changed_by_others_is_not_overwritten(space, drawing, sample):
    drawing.site(sample / 'site.yaml')
    drawing('lanes_between')
    saved(space)
    space.site_path.write_text('something else')
    with pytest.raises(InputError, match='made outside this page'):
        space.save()
    assert space.site_path.read_text() == 'something else'
    assert load_site(space.save(overwrite=True)).lanes


FAR = [[1.0, 2.0, 60.0], [1.0, 2.0, 40.0], [1.0, 2.0, 20.0]]
small = st.floats(0.001, 0.2, allow_nan=False)


@st.composite
def site_parts(draw):
    """Return the optional parts of a site file, and 1-sigmas of one line."""
    kinds = {'between': ['edge_right', 'line_0'], 'dashes': 'line_0', 'left_image': None}
    lengths = []
    for key in draw(st.lists(st.sampled_from(sorted(kinds)), max_size=3, unique=True)):
        known = {'length_m': draw(st.floats(0.5, 5000.0)), 'std_m': draw(small)}
        ends = {'left_image': [[500.25, 300], [500, 400]], 'right_image': [[480, 300], [480, 400]]}
        known.update({key: kinds[key]} if kinds[key] else ends)
        if key == 'left_image' and draw(st.booleans()):
            known['pick_std_px'] = draw(small)
        lengths.append({**known, **draw(st.sampled_from([{}, {'name': 'a <b>pole</b>'}]))})
    angles = {key: draw(st.floats(-0.9, 0.9)) for key in ('pan_deg', 'tilt_deg', 'roll_deg')}
    tolerances = {'stamp_std_s': 1e-5, 'focal_std': 1e-3, 'baseline_std_m': 2e-3}
    parts = {
        'name': draw(st.sampled_from(['bridge <b>7</b>', 'Brücke'])), 'known_lengths': lengths,
        'rig_correction': {**angles, 'covariance_deg2': (np.eye(3) * draw(small)).tolist()},
        'tolerances': {key: tolerances[key] for key in draw(st.sets(st.sampled_from(TOLERANCES)))},
        'calibrated': draw(st.dates())}
    kept = draw(st.sets(st.sampled_from(sorted(parts))))
    views = draw(st.sampled_from([(), ('left',), ('left', 'right')]))
    return ({key: value for key, value in parts.items() if key in kept and value},
            {f'{view}_std_px': draw(small) for view in views})


@pytest.mark.slow
@settings(max_examples=20, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(site_parts(), st.sampled_from([None, {}, {'std_m': 0.05}]),
       st.sampled_from(['55 mph', '80 km/h', '22.2 m/s', '37.777777 km/h']))
def test_opened_and_saved_file_keeps_its_content(sample, tmp_path, parts, survey, limit):
    more, stds = parts
    data = {**yaml.safe_load((sample / 'site.yaml').read_text()), **more}
    line = data['lines']['line_0']
    for key, value in stds.items():
        line[key] = [value] * len(line[key.replace('std_px', 'image')])
    data['lanes'][0]['speed_limit'] = limit
    data['lanes'][0]['class_limits'] = {'heavy_vehicle': limit}
    data['lanes'][0]['path_std'] = 0.0213
    if survey is not None:
        data['lines']['survey'] = {'points_m': FAR, **survey}
        data['lanes'].append({'name': 'middle', 'path': 'survey', 'speed_limit': limit})
    path = tmp_path / 'site.yaml'
    path.write_text(yaml.safe_dump(data))
    was = load_site(path)
    assert {field.name for field in fields(was)} == SITE_FIELDS  # new fields have to be added here
    space = Workspace(None, path, tmp_path / 'init.yaml')
    assert not space.unsaved
    again = load_site(space.save())
    if len(stds) < 2:  # those of a single view do not count
        clicks = replace(was.picked['line_0'], left_std_px=None, right_std_px=None)
        was = replace(was, lines={**was.lines, 'line_0': clicks})
    assert site_text(again) == site_text(was)


def test_line_of_both_directions_round_trips(sample, edited, tmp_path):
    """One painted line is in the file once for each direction of travel."""
    def more(data):
        middle, edge = data['lines']['line_0'], data['lines'].pop('edge_left')
        for name, line in (('line_0_back', middle), ('edge_left', edge)):
            data['lines'][name] = {key: points[::-1] for key, points in line.items()}
        data['lanes'][1].update(right='edge_left', left='line_0_back')
    path = edited('site.yaml', more)
    was = site_text(load_site(path))
    space = Workspace(None, path, tmp_path / 'init.yaml')
    assert site_text(load_site(space.save())) == was


@pytest.mark.slow
def test_refining_is_one_step(space, drawing, sample):
    drawing.site(sample / 'site.yaml')
    drawing('lanes_between')
    before = space.draft
    refined = space.refine(before)
    space.accept(before, refined)
    line = space.draft.lines[0]
    assert all(p.std_px is not None for p in line.left)
    data = judged(space)
    assert data['rig']['looked_at'] and data['rig']['moved_probability'] < 0.1
    assert data['lanes'][str(space.draft.lanes[0].number)]['width_std_m'] < 0.01
    assert saved(space).correction is not None
    drawing('undo')
    assert space.draft == before
    drawing('rename_line', line=1, name='kerb')
    with pytest.raises(InputError, match='changes made while'):
        space.accept(before, refined)


def test_marked_fronts_make_an_init_file(space, drawing, sample):
    hand = load_init(sample / 'init.yaml')[0]
    drawing('add_front', frame=hand.frame)
    with pytest.raises(InputError, match='four corners'):
        space.save_init()
    for view, corners in (('left', hand.left_px), ('right', hand.right_px)):
        for at in corners.tolist():
            drawing('front_corner', front=1, view=view, at=at)
    front, = load_init(space.save_init())
    assert front.frame == hand.frame
    np.testing.assert_allclose(front.left_px, hand.left_px, atol=0.006)
    np.testing.assert_allclose(front.right_px, hand.right_px, atol=0.006)
    assert not space.site_path.exists()


def mark(drawing, scene, number, front_m, of=None):
    """Annotate a front of 1.6 m by 0.8 m, centred at each point of a path."""
    frame, middle = front_m
    drawing('add_front', frame=frame, of=of)
    corners = np.array([[-0.8, -0.4, 0], [0.8, -0.4, 0], [0.8, 0.4, 0], [-0.8, 0.4, 0]])
    left, right, _, _ = scene.rig.project(middle + corners)
    for view, uv in (('left', left), ('right', right)):
        for at in uv.tolist():
            drawing('front_corner', front=number, view=view, at=at)


@pytest.mark.parametrize(('frames', 'curved'), [((1, 5), False), ((1, 3, 4, 6, 9), True)])
def test_marks_in_several_pairs_give_the_truth(space, drawing, scene, frames, curved):
    """On known paths: straight at constant speed, or accelerating."""
    stamps = [scene.stamp_of(frame) for frame in frames]
    seconds = np.array([(ns - stamps[0]) * 1e-9 for ns in stamps])
    velocity = np.array([1.0, 0.5, -20.0]) + np.outer(seconds, [0, 0, -3.0 if curved else 0.0])
    places = np.array([-2.0, -1.0, 60.0]) + seconds[:, None] * (
        np.array([1.0, 0.5, -20.0]) + np.outer(seconds / 2, [0, 0, -3.0 if curved else 0.0]))
    with pytest.raises(InputError, match='marked in more than one pair'):
        space.save_truth()
    for number, (frame, place) in enumerate(zip(frames, places), 1):
        mark(drawing, scene, number, (frame, place), None if number == 1 else 1)
    truth, = read_truth(space.save_truth())
    assert truth.stamps_ns.tolist() == stamps
    np.testing.assert_allclose(truth.position_m, places, atol=0.002)
    np.testing.assert_allclose(truth.speed_mps, np.linalg.norm(velocity, axis=1), atol=0.01)
    assert len(load_init(space.save_init())) == 1  # the first mark, no later one
    drawing('delete_front', front=1)
    assert space.draft.fronts == ()


@pytest.mark.parametrize('distorted', [False, True])
def test_point_lies_on_the_epipolar_curve_of_its_partner(make_scene, distorted):
    rig = make_scene(distorted=distorted).rig
    point = np.array([2.0, 1.5, 30.0])
    left, right, _, _ = rig.project(point)
    for view, one, other in (('left', left, right), ('right', right, left)):
        curve = epipolar_curve(rig, view, one)
        a, b = curve[:-1], curve[1:]
        share = np.clip(np.sum((other - a) * (b - a), axis=1)
                        / np.sum((b - a)**2, axis=1), 0, 1)
        gap = np.linalg.norm(a + share[:, None] * (b - a) - other, axis=1)
        assert gap.min() < 0.05, view


def test_point_of_the_road_is_predicted_in_the_other_view(space, drawing, sample, scene):
    drawing.site(sample / 'site.yaml')
    plane = space.judged(space.draft, None).plane
    line = load_site(sample / 'site.yaml').picked['line_0']
    told = on_plane(scene.rig, plane, 'left', line.left_px[4])
    gap = np.linalg.norm(line.right_px - told, axis=1)
    assert gap.min() < 40  # of the picks, which are farther apart than that
    back = on_plane(scene.rig, plane, 'right', told)
    np.testing.assert_allclose(back, line.left_px[4], atol=0.01)
    assert on_plane(scene.rig, plane, 'left', np.array([500.0, 5.0])) is None  # the sky
