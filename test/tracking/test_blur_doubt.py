# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The uncertainty that blur adds to a pass, by hand."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.tracking.blur_doubt import doubt_of_blur
from stereo_speed.tracking.posterior import Posterior


def posterior(first_ns, stamps_s, speeds_mps):
    """Return a posterior whose states are 0 except for the speeds."""
    n = len(stamps_s)
    mean = np.zeros((n, 4))
    mean[:, 3] = speeds_mps
    return Posterior(first_ns, np.array(stamps_s), mean, np.zeros((4 * n, 4 * n)),
                     *np.ones((4, n)), *np.ones((2, n), bool), 0.5)


PASS = posterior(1_700_000_000_000_000_000, [0.0, 0.1, 0.2, 0.4], [20.0, 20.0, 19.0, 18.0])


def speeds(doubt):
    assert not np.delete(doubt, np.s_[3::4], axis=0).any()
    return doubt[3::4, 3::4]


def test_blur_doubt_is_a_share_of_each_change():
    one, other = (posterior(PASS.first_ns, PASS.stamps_s, by_hand) for by_hand in (
        [20.5, 20.5, 19.5, 18.5], [20.0, 21.0, 19.0, 18.0]))
    found = speeds(doubt_of_blur(PASS, [one, other], 0.2, 10.0))
    np.testing.assert_allclose(found, 0.01 + np.diag([0.0, 0.04, 0.0, 0.0]), atol=1e-12)
    assert not doubt_of_blur(PASS, [], 0.2, 10.0).any()


def test_missing_pairs_change_like_their_neighbours():
    """A third of the way between 0.3 and 0.9 m/s, and at the end like the last one."""
    other = posterior(PASS.first_ns, [0.0, 0.2], [20.3, 19.9])
    change = np.array([0.3, 0.6, 0.9, 0.9])
    np.testing.assert_allclose(speeds(doubt_of_blur(PASS, [other], 1.0, 10.0)),
                               np.outer(change, change), atol=1e-12)


@pytest.mark.parametrize('share', [0.1, 0.3])
def test_unsolved_alternatives_give_the_maximum_doubt(share):
    np.testing.assert_allclose(speeds(doubt_of_blur(PASS, [None], share, 10.0)), 100.0)
