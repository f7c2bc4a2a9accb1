# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Histograms of parts and the reference, on manual samples and against plain numpy."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.lab.baselines.cues import bhattacharyya
from stereo_speed.monocular.colour_bins import ALL_BINS, BACKGROUND, grid_points, Samples
from stereo_speed.monocular.reference import box_histogram, Layout, Reference

NOWHERE = np.zeros(ALL_BINS)  # colours in the surroundings


def samples(bins, outside=None, occluded=None):
    """Return the samples, from lists (N, M)."""
    masks = [None if m is None else np.array(m, dtype=bool) for m in (outside, occluded)]
    return Samples(np.array(bins, dtype=np.uint16), *masks)


def random_histogram(rng, parts, colours):
    """Return a histogram of few colours in each part."""
    histogram = np.zeros((parts, ALL_BINS))
    histogram[:, rng.choice(ALL_BINS, colours, replace=False)] = rng.dirichlet(
        np.ones(colours), parts)
    return histogram


@pytest.mark.parametrize(('down', 'parts', 'wanted'), [
    (6, 3, [0, 0, 1, 1, 2, 2]), (5, 2, [0, 0, 0, 1, 1]), (4, 4, [0, 1, 2, 3]), (3, 1, [0, 0, 0])])
def test_parts_of_a_grid_from_top_to_bottom(down, parts, wanted):
    layout = Layout.grid(2, down, parts)
    np.testing.assert_array_equal(layout.part, np.repeat(wanted, 2))
    np.testing.assert_allclose(layout.averaging.sum(axis=0), 1)
    mean = np.arange(2.0 * down) @ layout.averaging
    np.testing.assert_allclose(mean, [np.flatnonzero(layout.part == p).mean()
                                      for p in range(parts)])


def test_grid_has_every_x_with_every_y():
    points = grid_points(3, 2).points
    np.testing.assert_allclose(points.x, [-1 / 3, 0, 1 / 3] * 2, atol=1e-12)
    np.testing.assert_allclose(points.y, [-0.25] * 3 + [0.25] * 3)


def test_histogram_of_a_box_by_hand():
    """Two parts of three points; colours 7 and 9."""
    layout = Layout.grid(3, 2, 2)
    found = box_histogram(samples([[7, 7, 9, 9, 9, 9]]), layout, 0.2)
    np.testing.assert_allclose(found[:, [7, 9]], [[2 / 3, 1 / 3], [0, 1]])
    assert found.sum() == pytest.approx(2)
    # a part outside the image is taken to look like the other
    outside = [[False] * 3 + [True] * 3]
    found = box_histogram(samples([[7, 7, 9, 9, 9, 9]], outside), layout, 0.2)
    np.testing.assert_allclose(found[:, [7, 9]], [[2 / 3, 1 / 3]] * 2)


@pytest.mark.parametrize(('least', 'wanted'), [(0.2, [1.0, 0.0]), (0.3, [0.25, 0.75])])
def test_occluded_points_are_left_out_while_enough_are_free(least, wanted):
    """Of four foreground points one is free; background points do not count."""
    bins = [[7, 9, 9, 9, BACKGROUND, BACKGROUND]]
    occluded = [[False, True, True, True, False, False]]
    found = box_histogram(samples(bins, None, occluded), Layout.grid(6, 1, 1), least)[0]
    share = found[[7, 9]] / found[[7, 9]].sum()
    np.testing.assert_allclose(share, wanted)


def test_similarity_equals_the_coefficient_of_each_part():
    """Reference: the coefficient of full histograms."""
    rng = np.random.default_rng(0)
    layout, histogram = Layout.grid(5, 6, 3), random_histogram(rng, 3, 12)
    reference = Reference(histogram, NOWHERE, 4.0)
    colours = np.flatnonzero(histogram[0])
    bins = rng.choice(np.append(colours, [1, 2, 3]), (40, 30))
    found = reference.histograms(samples(bins), layout)
    full = np.array([[np.bincount(row[layout.part == p], minlength=ALL_BINS) / 10
                      for p in range(3)] for row in bins])
    np.testing.assert_allclose(reference.similarity(found), bhattacharyya(full, histogram))
    ring = Layout(layout.at, np.zeros(30, dtype=np.intp), 1)
    np.testing.assert_allclose(
        reference.similarity_to_whole(reference.histograms(samples(bins), ring)),
        bhattacharyya(full.mean(axis=1), histogram.mean(axis=0)))
    assert found.seen is None and np.all(found.visible == 1)


def test_colours_are_weighted_by_their_rarity_around():
    """Half 7, half 9; 9 is all around and counts 1 / (1 + 4 / 0.501)."""
    histogram, around = np.zeros((1, ALL_BINS)), np.zeros(ALL_BINS)
    histogram[0, [7, 9]], around[9] = 0.5, 1.0
    weight = 1 / (1 + 4 / 0.501)
    reference = Reference(histogram, around, 4.0)
    found = reference.histograms(samples([[9, 9], [8, 9], [7, 9]]), Layout.grid(2, 1, 1))
    norm = 0.5 + 0.5 * weight
    np.testing.assert_allclose(reference.similarity(found)[:, 0], [
        np.sqrt(0.5) * weight / norm, 0.5 * weight / norm, 1.0])


def test_seen_and_visible_by_hand():
    """Four points in two parts: one outside, one occluded, one both."""
    reference = Reference(np.full((2, ALL_BINS), 1 / ALL_BINS), NOWHERE, 0.0)
    found = reference.histograms(
        samples([[5, 5, 5, 5]], [[True, False, True, False]], [[False, True, True, False]]),
        Layout.grid(2, 2, 2))
    np.testing.assert_allclose(found.seen, [[0, 0.5]])
    np.testing.assert_allclose(found.visible, [0.5])
    np.testing.assert_allclose(found.shares.sum(axis=2), [[0, 1]])
