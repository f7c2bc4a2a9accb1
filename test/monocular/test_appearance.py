# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The colour likelihood (eq. 23-24) against numpy's histograms and by hand."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereo_speed.monocular.appearance import Appearance, UsualValue
from stereo_speed.monocular.background_model import BackgroundModel
from stereo_speed.monocular.boxes import corners
from stereo_speed.monocular.colour_bins import BinImage, Boxes, grid_points, ring_points
from stereo_speed.monocular.config import MonocularConfig

PAPER = MonocularConfig().with_paper_likelihood()
KNOWING = replace(PAPER, background_contrast=25.0)  # the background apart from the target
A, B, C = (200, 40, 10), (20, 220, 90), (70, 70, 250)  # BGR


def boxes(*rows, angle_rad=None):
    """Return boxes from (centre x, centre y, width, height)."""
    table = np.array(rows, dtype=float)
    angles = None if angle_rad is None else np.full(len(table), angle_rad)
    return Boxes(table[:, :2], table[:, 2:], angles)


def histogram(bgr):
    """Return numpy's joint bins [4096] of pixels [n, 3], red first, as a reference."""
    counts = np.histogramdd(bgr[:, ::-1], bins=(16, 16, 16), range=[(0, 256)] * 3)[0]
    return counts.ravel() / counts.sum()


def flat(colour, shape=(100, 140)):
    return np.tile(np.array(colour, np.uint8), (*shape, 1))


def likelihood_of(image, found, config=PAPER, mark=None):
    """Return log-likelihood, similarity and visible share of boxes, the first being the mark."""
    frame = BinImage(image)
    target = Appearance(config, frame, found if mark is None else mark)
    return target.log_likelihood(frame, found)


def test_marked_histogram_equals_numpy():
    """The mark is sampled 40 x 60: a box of that size has each of its pixels once."""
    image = np.random.default_rng(0).integers(0, 256, (100, 140, 3), dtype=np.uint8)
    target = Appearance(PAPER, BinImage(image), boxes((59.5, 49.5, 40, 60)))
    np.testing.assert_allclose(target.reference.histogram[0, :4096],
                               histogram(image[20:80, 40:80].reshape(-1, 3)), atol=1e-12)
    # turned by a right angle, the same pixels
    turned = Appearance(PAPER, BinImage(image.transpose(1, 0, 2).copy()),
                        boxes((49.5, 59.5, 40, 60), angle_rad=np.pi / 2))
    np.testing.assert_allclose(turned.reference.histogram, target.reference.histogram,
                               atol=1e-12)


@pytest.mark.parametrize('angle_deg', [20, -35, 70])
def test_rotated_box_contains_its_inner_pixels(angle_deg):
    """Reference: pixels on the inner side of all four edges."""
    image = np.zeros((140, 140, 3), np.uint8)
    rows, columns = np.mgrid[:140, :140]
    image[..., 0] = 255 * (columns > 66)
    image[..., 1] = 255 * (columns + rows > 145)
    image[..., 2] = 255 * (rows > 75)
    angle = np.radians(angle_deg)
    mark = boxes((70, 71, 70, 28), angle_rad=angle)
    inside = np.ones((140, 140), dtype=bool)
    points = corners(np.array([35, 57, 70, 28.0]), angle)
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, axis=0)):
        inside &= (x1 - x0) * (rows - y0) - (y1 - y0) * (columns - x0) >= 0
    assert inside.sum() == pytest.approx(70 * 28, rel=0.03)
    wanted = histogram(image[inside])
    found = Appearance(PAPER, BinImage(image), mark).reference.histogram[0, :4096]
    assert np.abs(found - wanted).sum() / 2 < 0.02
    upright = Appearance(PAPER, BinImage(image), boxes((70, 71, 70, 28)))
    assert np.abs(upright.reference.histogram[0, :4096] - wanted).sum() > 0.2  # the angle matters


def test_candidates_are_sampled_at_the_points_of_the_mark():
    """Reference: numpy's histogram at the pixels nearest to the 9 x 15 points."""
    image = np.random.default_rng(1).choice(np.array([10, 100, 200], np.uint8), (90, 120, 3))
    mark, candidate = boxes((60, 45, 40, 60)), (52.3, 40.8, 33.0, 51.0)
    frame = BinImage(image)
    target = Appearance(PAPER, frame, mark)
    x = 52.3 + 33 * ((np.arange(9) + 0.5) / 9 - 0.5)
    y = 40.8 + 51 * ((np.arange(15) + 0.5) / 15 - 0.5)
    seen = image[np.rint(y).astype(int)][:, np.rint(x).astype(int)].reshape(-1, 3)
    wanted = np.sum(np.sqrt(histogram(seen) * target.reference.histogram[0, :4096]))
    log_likelihood, alike, visible = target.log_likelihood(frame, boxes(candidate))
    assert alike == pytest.approx(wanted) and visible == 1
    assert log_likelihood == pytest.approx(-20 * (1 - wanted))


def test_likelihood_of_half_a_target_by_hand():
    """Half of the candidate has the target's colour: 1 - D^2 is the root of a half."""
    assert MonocularConfig().lambda_b == 20
    image = flat(A)
    image[:, 70:] = B
    found = boxes((40, 50, 20, 30), (70 - 0.5, 50, 36, 30), (110, 50, 20, 30))
    log_likelihood, alike, _ = likelihood_of(image, found, replace(PAPER, samples_across=12),
                                             mark=boxes((40, 50, 20, 30)))
    np.testing.assert_allclose(alike, [1, np.sqrt(0.5), 0])
    np.testing.assert_allclose(log_likelihood, [0, -20 * (1 - np.sqrt(0.5)), -20])


@pytest.mark.parametrize('angle_rad', [None, 0.4])
def test_marked_box_is_the_most_likely(angle_rad):
    rng = np.random.default_rng(2)
    image = flat(C)
    image[30:62, 50:82] = A
    image[46:62, 50:82] = B
    spread = np.array([66, 46, 30, 30]) + rng.normal(0, 1, (300, 4)) * [9, 9, 5, 5]
    found = boxes((66, 46, 30, 30), *spread, angle_rad=angle_rad)
    _, alike, _ = likelihood_of(image, found, mark=boxes((66, 46, 30, 30), angle_rad=angle_rad))
    assert alike[0] > 0.995 and alike[0] >= alike.max() - 0.005
    assert np.all((alike >= 0) & (alike <= 1 + 1e-12)) and alike.min() < 0.9


def test_points_outside_the_image_are_left_out():
    image = flat(A)
    found = boxes((0 - 0.5, 50, 40, 30), (139.5, 99.5, 40, 30), (-60, 50, 40, 30))
    frame = BinImage(image)
    target = Appearance(replace(PAPER, samples_across=10, samples_down=10), frame,
                        boxes((70, 50, 40, 30)))
    alike, seen, visible = target.compare(frame, found)
    np.testing.assert_allclose(visible, [0.5, 0.25, 0])
    np.testing.assert_allclose(seen, visible)
    np.testing.assert_allclose(alike, [1, 1, 0])
    # a box partly outside looks like its visible part
    np.testing.assert_allclose(Appearance(PAPER, frame, found).reference.histogram,
                               target.reference.histogram)


def test_bins_are_computed_once_for_any_part():
    """A frame that was sampled elsewhere gives the same as a fresh one."""
    image = np.random.default_rng(3).integers(0, 256, (80, 90, 3), dtype=np.uint8)
    used, grid = BinImage(image), grid_points(7, 5)
    for box in ((20, 20, 10, 12), (60, 50, 40, 20), (25, 24, 16, 18), (88, 5, 30, 30)):
        for angle in (None, 0.7):
            found = boxes(box, angle_rad=angle)
            np.testing.assert_array_equal(used.sample(found, grid)[0],
                                          BinImage(image).sample(found, grid)[0])


def test_parts_distinguish_top_and_bottom():
    image = flat(A)
    image[50:] = B
    upside_down = image[::-1].copy()
    mark = boxes((70, 49.5, 40, 40))
    for parts, wanted in ((1, 1.0), (2, 0.0)):
        config = replace(PAPER, parts=parts, samples_down=16)
        target = Appearance(config, BinImage(image), mark)
        assert target.compare(BinImage(image), mark)[0] == pytest.approx(1)
        assert target.compare(BinImage(upside_down), mark)[0] == pytest.approx(wanted, abs=1e-9)


def test_colours_of_the_surroundings_weigh_less():
    """Reference half A, half B; surroundings all B, with weight 1 / (1 + 4 * 1 / 0.501)."""
    image = flat(B)
    image[35:65, 60:80] = A
    mark = boxes((69.5, 49.5, 40, 30))
    ground = boxes((20, 49.5, 30, 30))
    weight = 1 / (1 + 4 / 0.501)
    for share, w in ((0.0, 1.0), (4.0, weight)):
        target = Appearance(replace(PAPER, surround_weight=share), BinImage(image), mark)
        alike = target.compare(BinImage(image), ground)[0]
        assert alike == pytest.approx(np.sqrt(0.5) * w / (0.5 + 0.5 * w))


def test_contrast_refuses_a_too_small_box():
    image = flat(B)
    image[30:70, 50:90] = A
    found = boxes((69.5, 49.5, 40, 40), (69.5, 49.5, 20, 20), (69.5, 49.5, 70, 70))
    for weight in (0.0, 5.0):
        best, small, large = likelihood_of(
            image, found, replace(PAPER, contrast_weight=weight),
            mark=boxes((69.5, 49.5, 40, 40))).log
        assert best > large + 1
        assert best - small == pytest.approx(weight)  # all around it is the target's colour


def test_ring_lies_around_the_box():
    ring = ring_points()
    outer = np.maximum(np.abs(ring.x), np.abs(ring.y))
    np.testing.assert_allclose(np.unique(np.round(outer, 6)), [0.575, 0.65])
    assert abs(ring.x.mean()) < 1e-12 and abs(ring.y.mean()) < 1e-12


@pytest.mark.parametrize('share', [0.0, 0.25, 1.0])
def test_reference_is_updated_by_its_share(share):
    image = flat(A)
    image[:, 70:] = B
    mark, now = boxes((40, 50, 20, 30)), boxes((100, 50, 20, 30))
    target = Appearance(replace(PAPER, adaptation=share), BinImage(image), mark)
    target.renew(BinImage(image), now)
    assert target.compare(BinImage(image), now)[0] == pytest.approx(np.sqrt(share))
    assert target.compare(BinImage(image), mark)[0] == pytest.approx(np.sqrt(1 - share))


def test_area_occluded_by_another_target_is_left_out():
    """The left half is occluded: the visible part is all A, and the rest counts as unseen."""
    image = flat(A)
    image[:, :60] = B
    mark, half = boxes((100, 50, 20, 30)), boxes((59.5, 50, 20, 30))
    target = Appearance(replace(PAPER, samples_across=10, unseen_share=0.4), BinImage(image), mark)
    target.usual.add(0.9)
    frame = BinImage(image)
    assert target.compare(frame, half)[0] == pytest.approx(np.sqrt(0.5))
    frame.occlude(np.array([40.0, 20, 20, 60]))  # columns 40 to 59
    alike, seen, visible = target.compare(frame, half)
    assert (alike, seen, visible) == (pytest.approx(1), pytest.approx(0.5), 1)
    log_likelihood, alike, _ = target.log_likelihood(frame, half)
    assert alike == pytest.approx(0.5 + 0.5 * 0.4 * 0.9)
    assert log_likelihood == pytest.approx(-20 * (1 - alike))
    # a target elsewhere is seen as before, a target there is not seen at all
    np.testing.assert_allclose(target.compare(frame, mark), np.ones((3, 1)))
    np.testing.assert_allclose(target.compare(frame, boxes((50, 50, 10, 30))), [[0], [0], [1]])


def test_visible_background_is_not_occluded():
    """Where the ground is visible, no target is in front."""
    background = BackgroundModel(140, 100, 25, 100)
    background.learn(flat(C), [])
    image = flat(C)
    image[:, :60] = B
    frame = BinImage(image, background)
    target = Appearance(PAPER, frame, boxes((30, 50, 20, 30)))
    frame.occlude(np.array([0.0, 0, 140, 100]))
    seen = target.compare(frame, boxes((30, 50, 20, 30), (100, 50, 20, 30)))[1]
    np.testing.assert_allclose(seen, [0, 1])


def test_similarity_never_exceeds_one():
    """A box full of the heavy colour, which the mark has in one half, and any other box."""
    image = flat(B)
    image[20:80, 40:60] = A
    image[20:80, 90:130] = A
    mark = boxes((39.5, 49.5, 40, 40))
    target = Appearance(replace(PAPER, surround_weight=4.0), BinImage(image), mark)
    assert target.compare(BinImage(image), boxes((110, 50, 30, 30)))[0] == 1
    rng = np.random.default_rng(4)
    spread = np.array([70, 50, 30, 30]) + rng.normal(0, 1, (300, 4)) * [30, 20, 5, 5]
    for parts in (1, 3):
        target = Appearance(replace(PAPER, surround_weight=4.0, parts=parts), BinImage(image),
                            mark)
        for alike in (target.compare(BinImage(image), boxes(*spread))[0],
                      target.surround_similarity(BinImage(image), boxes(*spread))):
            assert alike.min() >= 0 and 0.99 < alike.max() <= 1


def test_usual_value_is_a_mean_then_a_running_mean():
    usual, values = UsualValue(0.05), np.random.default_rng(5).uniform(0.3, 0.9, 20)
    assert usual.value == 0
    for value in values:
        usual.add(value)
    assert usual.value == pytest.approx(values.mean())
    usual.add(1.0)
    assert usual.value == pytest.approx(0.95 * values.mean() + 0.05)
    usual.restart()
    usual.add(0.25)
    assert usual.value == pytest.approx(0.25)


def test_unseen_part_counts_as_a_share_of_the_usual():
    target = Appearance(PAPER, BinImage(flat(A)), boxes((70, 50, 40, 30)))
    assert target.unseen_similarity == 0  # just marked: it is not occluded
    target.usual.add(0.8)
    assert target.unseen_similarity == pytest.approx(0.8 * PAPER.unseen_share)


@pytest.mark.parametrize('now, share', [((110, 40, 20, 30), 0.5), ((38, 28, 44, 44), 0.0)])
def test_initial_box_is_resampled_once_its_background_is_known(now, share):
    """The left half of the box is ground, which becomes known when the target has left it."""
    background = BackgroundModel(140, 100, 25, 100)
    ground, there = flat(C), flat(C)
    there[30:80, 60:80] = A
    mark = boxes((59.5, 49.5, 40, 40))
    target = Appearance(KNOWING, BinImage(there, background), mark)
    assert target.reference.histogram[0, 4096] == 0  # the ground still counts as target
    for frames, wanted in ((1, 0.0), (8, share)):
        for _ in range(frames):
            background.learn(ground, [])
        target.review(background, np.array(now, dtype=float))
        assert target.reference.histogram[0, 4096] == pytest.approx(wanted, abs=0.06)
        assert target.reference.histogram.sum() == pytest.approx(1)


def test_resampled_reference_equals_that_of_a_known_background():
    """Oracle: the same box, marked when the background was already known."""
    rng = np.random.default_rng(6)
    ground = rng.integers(60, 80, (100, 140, 3), dtype=np.uint8)
    there = ground.copy()
    there[30:80, 60:80] = A
    mark, config = boxes((65, 55, 40, 40)), replace(KNOWING, parts=3)
    background = BackgroundModel(140, 100, 25, 100)
    early = Appearance(config, BinImage(there, background), mark)
    for _ in range(12):
        background.learn(ground, [])
    late = Appearance(config, BinImage(there, background), mark)
    assert np.abs(early.reference.histogram - late.reference.histogram).sum() > 0.5
    early.review(background, np.array([0.0, 0, 10, 10]))
    np.testing.assert_allclose(early.reference.histogram, late.reference.histogram)


@pytest.mark.parametrize('free_px, wanted', [(0, (0.0, 1.0)), (3, (0.15, 0.85)), (8, (1.0, 0.0))])
def test_occluder_is_sampled_only_if_little_else_is_left(free_px, wanted):
    """Of 20 columns, the left ones are free and A, the others occluded and B."""
    image = flat(B)
    image[:, :60 + free_px] = A
    frame = BinImage(image)
    frame.occlude(np.array([60.0 + free_px, 0, 80, 100]))
    mark = boxes((69.5, 49.5, 20, 30))
    target = Appearance(PAPER, frame, mark)
    whole = target.reference.histogram[0]
    found = [whole[np.ravel_multi_index((r >> 4, g >> 4, b >> 4), (16,) * 3)]
             for b, g, r in (A, B)]
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    likelihood = target.log_likelihood(BinImage(image), mark)
    assert all(np.isfinite(v).all() for v in likelihood)


def test_box_touching_the_image_is_sampled_at_its_edge():
    image = flat(B)
    image[:, 0] = A
    target = Appearance(PAPER, BinImage(image), boxes((-50.4, 50, 100, 30)))
    assert target.reference.histogram.sum() == pytest.approx(1)
    assert target.compare(BinImage(image), boxes((0, 50, 0.5, 30)))[0] == pytest.approx(1)


def test_resampled_box_has_no_colours_of_an_occluder():
    """A is the target's, B that of the one before its right half, C the ground all around."""
    background = BackgroundModel(140, 100, 25, 100)
    there = flat(C)
    there[30:80, 50:70] = A
    there[30:80, 60:70] = B
    frame, mark = BinImage(there, background), boxes((59.5, 49.5, 40, 40))
    frame.occlude(np.array([60.0, 30, 10, 50]))
    target = Appearance(KNOWING, frame, mark)
    for _ in range(8):
        background.learn(flat(C), [])
    assert target.review(background, np.array([110.0, 40, 20, 30]))
    b = np.ravel_multi_index((90 >> 4, 220 >> 4, 20 >> 4), (16,) * 3)
    assert target.reference.histogram[0, b] == 0
    assert target.reference.histogram[0, 4096] == pytest.approx(2 / 3, abs=0.03)  # and A one third
    assert not target.review(background, np.array([110.0, 40, 20, 30]))  # once is enough
