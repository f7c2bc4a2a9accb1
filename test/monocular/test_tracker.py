# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The monocular tracker on a synthetic road: targets kept, occluded, lost, departed; strides."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.monocular.boxes import overlap, Target, TargetEstimate, TargetState
from stereo_speed.monocular.colour_bins import BinImage
from stereo_speed.monocular.config import MonocularConfig
from stereo_speed.monocular.tracker import MonocularTracker

SIZE = (26.0, 13.0)
CONFIG = MonocularConfig(hidden_frames=8)


def box_of(centre, size=SIZE):
    return np.array([*(np.asarray(centre) - np.array(size) / 2), *size])


def drive(road, maps, frames, gone=(), **lane):
    """Draw a block that moves along the road, except in the frames of ``gone``."""
    images = []
    for number in range(1, frames + 1):
        blocks = [] if number in gone else [(*road.place(number, **lane), SIZE, maps.RED)]
        images.append(road.image(blocks, number))
    return images


def target_on(road, number=1, frame=1, **lane):
    centre, angle = road.place(frame, **lane)
    return Target(id=number, frame=frame, box_px=box_of(centre), angle_rad=angle)


def follow(road, images, targets, config=CONFIG, **options):
    """Run the tracker, and return its estimates by (id, frame), and the ends."""
    tracker = MonocularTracker(road.field, targets, config, **options)
    found, ends = {}, []
    for number, image in enumerate(images, 1):
        for estimate in tracker.process(number, image):
            assert estimate.frame == number
            assert (estimate.id, number) not in found
            found[estimate.id, number] = estimate
        ends += tracker.ended()
    return found, ends + tracker.finish()


def as_numbers(found):
    return np.array([[*key, *e.box_px, e.angle_rad, e.distance_px, e.similarity, *e.velocity_px]
                     for key, e in found.items()])


def overlaps(road, found, **lane):
    """Return the overlap of each estimate's centred box with the true one, both unrotated."""
    return np.array([overlap(e.box_px, box_of(road.place(frame, **lane)[0]))
                     for (_, frame), e in found.items()])


@pytest.mark.parametrize('seed', [0, 1, 2])
@pytest.mark.parametrize('stride', [1, 3])
def test_target_is_kept_round_the_bend(road, maps, seed, stride):
    lane = {'radius_px': 138.0}
    images = drive(road, maps, 31, **lane)
    found, ends = follow(road, images, [target_on(road, **lane)], seed=seed, stride=stride)
    assert list(found) == [(1, n) for n in range(1, 32, stride)]
    assert all(e.state is TargetState.TRACKED for e in found.values())
    assert overlaps(road, found, **lane).min() > 0.5
    last = found[1, 31]
    assert np.degrees(last.angle_rad - road.place(31)[1]) == pytest.approx(0, abs=8)
    assert last.distance_px == pytest.approx(-10, abs=3)  # off the middle of the road
    assert abs(last.distance_rate_px) < 1
    way = road.place(31, **lane)[0] - road.place(30, **lane)[0]
    np.testing.assert_allclose(last.velocity_px, way, atol=1.0)
    assert 0.5 < last.similarity <= 1
    end, = ends
    assert (end.id, end.first_frame, end.last_frame, end.frames, end.state) == (
        1, 1, 31, len(found), TargetState.STREAM_ENDED)


def test_marked_frame_returns_the_mark_itself(road, maps):
    target = target_on(road, frame=4)
    found, _ = follow(road, drive(road, maps, 5), [target])
    assert list(found) == [(1, 4), (1, 5)]
    np.testing.assert_array_equal(found[1, 4].box_px, target.box_px)
    assert found[1, 4].angle_rad == target.angle_rad
    assert found[1, 4].state is TargetState.TRACKED and found[1, 4].similarity == 1
    assert found[1, 4].distance_px == road.field.distance(
        target.box_px[:2] + target.box_px[2:] / 2)


@pytest.mark.parametrize('tracker', ['environment', 'plain'])
def test_same_seed_repeats_the_result_and_another_does_not(road, maps, tracker):
    images, targets = drive(road, maps, 8), [target_on(road)]
    first, again, other = (as_numbers(follow(road, images, targets, tracker=tracker,
                                             seed=seed)[0]) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    np.testing.assert_allclose(first[:, 2:4], other[:, 2:4], atol=6)


def test_plain_tracker_keeps_an_easy_target_and_ignores_the_map(road, maps):
    images = drive(road, maps, 20)
    found, _ = follow(road, images, [target_on(road)], tracker='plain')
    assert overlaps(road, found).min() > 0.4

    class NoRoad:
        field = maps_of_one_kind(road)

    elsewhere, _ = follow(NoRoad, images, [target_on(road)], tracker='plain')
    columns = [0, 1, 2, 3, 4, 5, 6, 8, 9, 10]  # all but the distance
    np.testing.assert_array_equal(as_numbers(found)[:, columns],
                                  as_numbers(elsewhere)[:, columns])


def maps_of_one_kind(road):
    return type(road.field)(np.full_like(road.map, 128))


def test_target_that_vanishes_is_occluded_then_lost(road, maps):
    """Seen up to frame 12; it is lost eight frames later, and stays so."""
    images = drive(road, maps, 30, gone=range(13, 31))
    found, ends = follow(road, images, [target_on(road)])
    states = {n: e.state for (_, n), e in found.items()}
    assert all(states[n] is TargetState.TRACKED for n in range(1, 13))
    assert [states[n] for n in range(14, 21)] == [TargetState.OCCLUDED] * 7
    end, = ends
    assert end.state is TargetState.LOST
    assert end.last_frame == end.frames == max(states) and end.last_frame in (20, 21)


def test_occluded_target_is_reacquired(road, maps):
    images = drive(road, maps, 26, gone=range(10, 15))
    for seed in range(3):
        found, ends = follow(road, images, [target_on(road)], seed=seed)
        assert all(found[1, n].state is TargetState.OCCLUDED for n in range(11, 15))
        assert found[1, 26].state is TargetState.TRACKED
        assert overlaps(road, found)[-8:].min() > 0.4
        assert ends[0].state is TargetState.STREAM_ENDED
        # it has moved on along the road
        assert overlaps(road, found)[9:14].min() > 0.1


def test_target_that_drives_out_of_the_image_has_left(road, maps):
    """The road leaves the image at the lower edge, after 50 frames of 1.6 degrees."""
    lane = {'start_deg': 40.0, 'step_deg': 2.0}
    images = drive(road, maps, 32, **lane)
    found, ends = follow(road, images, [target_on(road, **lane)])
    end, = ends
    assert end.state is TargetState.LEFT_VIEW
    # the middle crosses the edge at 4.4 degrees below the corner's row
    assert 20 <= end.last_frame <= 27 and end.frames == len(found)


def test_several_targets_do_not_affect_each_other(road, maps):
    """Two of different colour side by side; with the paper's likelihood as if alone."""
    lanes = {1: {'radius_px': 139.0}, 5: {'radius_px': 121.0, 'start_deg': 72.0}}
    images = []
    for number in range(1, 22):
        blocks = [(*road.place(number, **lanes[1]), SIZE, maps.RED)]
        blocks.append((*road.place(number, **lanes[5]), SIZE, maps.BLUE))
        images.append(road.image(blocks, number))
    targets = [target_on(road, 5, frame=3, **lanes[5]), target_on(road, 1, **lanes[1])]
    found, ends = follow(road, images, targets)
    assert sorted(found) == [(1, n) for n in range(1, 22)] + [(5, n) for n in range(3, 22)]
    assert sorted((e.id, e.frames, e.state.value) for e in ends) == [
        (1, 21, 'stream_ended'), (5, 19, 'stream_ended')]
    for number, lane in lanes.items():
        mine = {key: e for key, e in found.items() if key[0] == number}
        assert overlaps(road, mine, **lane).min() > 0.5
    paper = CONFIG.with_paper_likelihood()
    found, _ = follow(road, images, targets, paper)
    for target in targets:
        alone, _ = follow(road, images, [target], paper)
        np.testing.assert_array_equal(as_numbers(alone), as_numbers(
            {key: e for key, e in found.items() if key[0] == target.id}))


def passing_scene(road, maps, frames):
    """Draw a standing person, and one of the same colour who walks past behind."""
    boxes, images = {1: [], 2: []}, []
    for number in range(1, frames + 1):
        boxes[1].append(np.array([112.0, 102, 16, 44]))
        boxes[2].append(np.array([70.0 + 3.0 * (number - 1), 99, 15.5, 43]))
        images.append(road.image([((x + w / 2, y + h / 2), 0.0, (w, h), maps.RED) for x, y, w, h
                                  in (boxes[2][-1], boxes[1][-1])], number))
    targets = [Target(id=i, frame=1, box_px=b[0]) for i, b in boxes.items()]
    return images, targets, boxes


@pytest.mark.slow
def test_target_passing_behind_another_is_kept_and_takes_no_pixels_of_it(road, maps):
    images, targets, boxes = passing_scene(road, maps, 33)
    kept = {}
    for covering in (False, True):
        kept[covering] = 0
        for seed in range(3):
            found, _ = follow(road, images, targets, replace(CONFIG, covering=covering),
                              seed=seed)
            kept[covering] += all(
                (i, 33) in found and overlap(found[i, 33].envelope_px, b[-1]) > 0.5
                for i, b in boxes.items())
    assert kept == {False: 0, True: 3}  # without it they end up on the same block


def test_nearest_target_occludes_in_frames_skipped_by_its_stride(road, maps, monkeypatch):
    """Stride 2, marked in frames 1 and 2: in frame 4 target 1 occludes at its predicted place."""
    images, targets, boxes = passing_scene(road, maps, 5)
    targets = [replace(targets[0], frame=1), replace(targets[1], frame=2, box_px=boxes[2][1])]
    occluders = []
    monkeypatch.setattr(BinImage, 'occlude', lambda self, box: occluders.append(box))
    tracker = MonocularTracker(road.field, targets, CONFIG, stride=2)
    for number, image in enumerate(images[:4], 1):
        occluders.clear()
        found = {e.id: e for e in tracker.process(number, image)}
        if number == 3:
            near = found[1]
    moved = near.box_px + [*near.velocity_px, 0, 0]
    np.testing.assert_allclose(occluders, [moved])  # no target is behind the last one
    both = [replace(t, frame=1) for t in targets]
    for covering, wanted in ((True, [targets[0].box_px]), (False, [])):
        occluders.clear()
        MonocularTracker(road.field, both, replace(CONFIG, covering=covering)).process(
            1, images[0])
        np.testing.assert_array_equal(occluders, wanted)


@pytest.mark.parametrize('contrast', [0.0, 25.0])
def test_target_marked_inside_the_box_of_a_nearer_one_is_tracked(road, maps, contrast):
    """It is wholly occluded in its first frame, where no background is known."""
    image = road.image([((150, 120), 0.0, (100, 80), maps.RED)], 1)
    targets = [Target(id=1, frame=1, box_px=np.array([100.0, 80, 100, 80])),
               Target(id=2, frame=1, box_px=np.array([120.0, 100, 20, 40]))]
    found, _ = follow(road, [image] * 4, targets, replace(CONFIG, background_contrast=contrast))
    assert (2, 2) in found and all(np.isfinite(e.box_px).all() for e in found.values())


def test_target_that_stood_before_it_was_marked_is_no_background(road, maps):
    """It stands for 30 frames, all of them learnt, is marked in the last and walks off."""
    size, images, boxes = (16.0, 44.0), [], []
    for number in range(1, 56):
        centre = np.array([90.0 + 2.5 * max(number - 30, 0), 110.0])
        boxes.append(box_of(centre, size))
        images.append(road.image([(centre, 0.0, size, maps.BLUE)], number))
    for seed in range(3):
        found, _ = follow(road, images, [Target(id=1, frame=30, box_px=boxes[29])], seed=seed)
        assert all(overlap(found[1, n].box_px, boxes[n - 1]) > 0.4 for n in (40, 55))


def upright_scene(road, maps, frames):
    """Draw an upright block that walks down and grows: a third of the rows below -20."""
    images, boxes = [], []
    for number in range(1, frames + 1):
        foot = np.array([120.0 + 0.5 * number, 60.0 + 4.0 * number])
        height = (foot[1] + 20) / 3
        size = (0.5 * height, height)
        centre = foot - [0, height / 2]
        boxes.append(box_of(centre, size))
        images.append(road.image([(centre, 0.0, size, maps.BLUE)], number))
    return images, np.array(boxes)


def test_upright_target_grows_as_it_approaches(road, maps):
    images, boxes = upright_scene(road, maps, 26)
    grown = []
    for seed in range(3):
        found, _ = follow(road, images, [Target(id=1, frame=1, box_px=boxes[0])], seed=seed)
        estimates = np.array([e.box_px for e in found.values()])
        assert len(estimates) == 26 and np.all(overlap(estimates, boxes) > 0.5)
        assert all(e.angle_rad == 0 for e in found.values())
        grown.append(estimates[-1, 3] / estimates[0, 3])
        end = found[1, 26]
        assert end.distance_px == pytest.approx(
            float(road.field.distance(end.box_px[:2] + end.box_px[2:] * [0.5, 1])))
    assert np.mean(grown) == pytest.approx(boxes[-1, 3] / boxes[0, 3], rel=0.15)  # by 2.2


def test_ends_are_reported_once_and_later_frames_have_no_estimates(road, maps):
    images = drive(road, maps, 6, gone=range(3, 7))
    tracker = MonocularTracker(road.field, [target_on(road)], replace(CONFIG, hidden_frames=1))
    ends = []
    for number, image in enumerate(images, 1):
        tracker.process(number, image)
        ends.append(len(tracker.ended()))
    assert sum(ends) == 1 and tracker.finish() == [] and tracker.filters == {}
    assert tracker.process(7, images[0]) == []


def test_unknown_tracker_is_refused(road):
    with pytest.raises(InputError, match=r"tracker: name: found 'gpf', wanted environment, plai"):
        MonocularTracker(road.field, [], CONFIG, tracker='gpf')


def test_no_targets_give_no_estimates(road, maps):
    tracker = MonocularTracker(road.field, [], CONFIG)
    assert tracker.process(1, drive(road, maps, 1)[0]) == []
    assert tracker.finish() == []


def test_estimate_is_of_a_target(road, maps):
    found, _ = follow(road, drive(road, maps, 2), [target_on(road)])
    assert all(isinstance(e, TargetEstimate) for e in found.values())
