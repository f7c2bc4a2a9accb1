# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Pairing by stamp: hand-drawn timelines, brute force, and properties of random streams."""
import numpy as np
import pytest

from stereo_speed.core.pair_matcher import choose_tolerance_ns, PairMatcher, plan_pairs

MS = 1_000_000


def run(matcher, events):
    """Feed (side, stamp) events, and return the matched (left, right) stamps in order."""
    out = []
    for side, stamp in events:
        add = matcher.add_left if side == 'L' else matcher.add_right
        out += [(m[0], m[2]) for m in add(stamp, f'{side}{stamp}')]
    return out


def test_exact_pairs_come_at_once_with_their_items():
    matcher = PairMatcher()
    assert matcher.add_left(10, 'a') == []
    assert matcher.add_right(10, 'b') == [(10, 'a', 10, 'b')]
    assert (matcher.unpaired_left, matcher.unpaired_right) == (0, 0)


def test_exact_pairing_counts_images_without_a_partner():
    # L  1 2   4 5
    # R  1   3 4
    matcher = PairMatcher()
    out = run(matcher, [('L', 1), ('R', 1), ('L', 2), ('R', 3), ('L', 4), ('R', 4), ('L', 5)])
    assert out == [(1, 1), (4, 4)]
    assert matcher.flush() == []
    assert (matcher.unpaired_left, matcher.unpaired_right) == (2, 1)


def test_one_side_may_lag_behind():
    matcher = PairMatcher()
    out = run(matcher, [('L', t) for t in range(5)] + [('R', t) for t in range(5)])
    assert out == [(t, t) for t in range(5)]


def test_queue_keeps_the_newest():
    matcher = PairMatcher(queue_size=3)
    out = run(matcher, [('L', t) for t in range(5)] + [('R', t) for t in range(5)])
    assert out == [(2, 2), (3, 3), (4, 4)]
    assert (matcher.unpaired_left, matcher.unpaired_right) == (2, 2)


def test_nearest_waits_until_it_is_certain():
    # R 104 is within tolerance of L 100, but L 105 would be nearer: it comes, and wins.
    matcher = PairMatcher(tolerance_ns=10)
    assert run(matcher, [('L', 100), ('R', 104)]) == []
    assert run(matcher, [('L', 105)]) == []
    assert [m[::2] for m in matcher.flush()] == [(105, 104)]
    assert (matcher.unpaired_left, matcher.unpaired_right) == (1, 0)


def test_nearest_comes_at_once_when_frames_are_far_apart():
    matcher = PairMatcher(tolerance_ns=10)
    events = [('L', 0), ('R', 3), ('L', 100), ('R', 103), ('L', 200)]
    assert run(matcher, events) == [(0, 3), (100, 103)]
    assert run(matcher, [('R', 198)]) == [(200, 198)]


def test_beyond_the_tolerance_nothing_pairs():
    matcher = PairMatcher(tolerance_ns=10)
    assert run(matcher, [('L', 0), ('R', 11), ('L', 100), ('R', 111)]) == []
    assert matcher.flush() == []
    assert (matcher.unpaired_left, matcher.unpaired_right) == (2, 2)


def test_stamps_that_do_not_rise_are_left_out():
    matcher = PairMatcher()
    out = run(matcher, [('L', 5), ('L', 5), ('L', 4), ('R', 5), ('R', 5)])
    assert out == [(5, 5)]
    assert (matcher.unpaired_left, matcher.unpaired_right) == (2, 1)


def test_reset_forgets_time_and_counts():
    matcher = PairMatcher()
    run(matcher, [('L', 5), ('L', 5), ('R', 9)])
    matcher.reset()
    assert run(matcher, [('L', 1), ('R', 1)]) == [(1, 1)]
    assert (matcher.unpaired_left, matcher.unpaired_right) == (0, 0)


@pytest.mark.parametrize('arguments', [{'tolerance_ns': -1}, {'queue_size': 0}])
def test_invalid_arguments_are_refused(arguments):
    with pytest.raises(ValueError, match='tolerance_ns must be >= 0 and queue_size >= 1'):
        PairMatcher(**arguments)


@pytest.mark.parametrize('seed', range(10))
def test_nearest_equals_brute_force_where_frames_are_distinct(seed):
    rng = np.random.default_rng(seed)
    kept = [rng.random(60) < 0.8 for _ in range(2)]
    stamps = [[int(100 * i + rng.integers(-20, 21)) for i in range(60) if kept[side][i]]
              for side in range(2)]
    pairs, lost_left, lost_right = plan_pairs(*stamps, 45)
    got = [(stamps[0][i], stamps[1][j]) for i, j in pairs]
    near = {(a, b) for a in stamps[0] for b in stamps[1] if abs(a - b) <= 45}
    assert got == sorted(near)
    assert lost_left == len(stamps[0]) - len(got)
    assert lost_right == len(stamps[1]) - len(got)


@pytest.mark.parametrize('seed', range(10))
def test_properties_of_crowded_streams(seed):
    rng = np.random.default_rng(seed)
    stamps = [np.unique(rng.integers(0, 3000, 80)).tolist() for _ in range(2)]
    pairs, lost_left, lost_right = plan_pairs(*stamps, 40)
    assert all(abs(stamps[0][i] - stamps[1][j]) <= 40 for i, j in pairs)
    for side, lost in ((0, lost_left), (1, lost_right)):
        used = [pair[side] for pair in pairs]
        assert used == sorted(set(used))
        assert len(used) + lost == len(stamps[side])
    equal = {(stamps[0].index(t), stamps[1].index(t)) for t in set(stamps[0]) & set(stamps[1])}
    assert equal <= set(pairs)  # an equal stamp is always the nearest


@pytest.mark.parametrize('seed', range(5))
def test_order_of_arrival_does_not_matter_for_exact_pairs(seed):
    rng = np.random.default_rng(seed)
    left, right = ([int(t) for t in range(40) if rng.random() < 0.8] for _ in range(2))
    wanted = sorted(set(left) & set(right))
    matcher, out = PairMatcher(queue_size=100), []
    while left or right:
        side = 'L' if left and (not right or rng.random() < 0.5) else 'R'
        out += run(matcher, [(side, (left if side == 'L' else right).pop(0))])
    assert out == [(t, t) for t in wanted]


def test_tolerance_is_exact_when_stamps_are_equal():
    left = [i * 200 * MS for i in range(20)]
    assert choose_tolerance_ns(left, left) == 0
    assert choose_tolerance_ns(left, left[::3]) == 0


def test_tolerance_falls_back_when_few_stamps_are_equal():
    left = [i * 200 * MS for i in range(20)]
    right = [t + 300_000 for t in left]
    assert choose_tolerance_ns(left, right) == 5 * MS
    assert choose_tolerance_ns(left, left[:1] + right[1:]) == 5 * MS  # one may be chance
    fast = [i * 8 * MS for i in range(20)]
    assert choose_tolerance_ns(fast, [t + 100 for t in fast]) == 2 * MS
    assert choose_tolerance_ns([0], [100]) == 5 * MS
