# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Steps of the clock are distinguished from lost images, jitter and uneven exposures."""
import numpy as np
import pytest
from stereo_speed.core.stamp_watch import Gap, StampWatch

PERIOD_NS = 200_000_000
THIRTIETH_NS = 33_333_333


def steps_s(stamps_ns):
    watch = StampWatch()
    return [step for step in map(watch.add, map(int, stamps_ns)) if step]


@pytest.mark.parametrize('step_ns', [30_000_000, -30_000_000, 5_000_000])
def test_step_is_found_once(step_ns):
    stamps = PERIOD_NS * np.arange(60)
    stamps[40:] += step_ns
    assert steps_s(stamps) == pytest.approx([step_ns * 1e-9])


def test_missing_images_are_no_step():
    assert steps_s(PERIOD_NS * np.delete(np.arange(80), [30, 31, 45, 60, 61, 62])) == []


def test_step_is_found_where_images_were_missing_before():
    """They leave intervals of some periods while the pace is being learnt."""
    stamps = PERIOD_NS * np.delete(np.arange(60), [3, 4, 9, 14, 15, 16, 22])
    stamps[33:] += 30_000_000
    assert steps_s(stamps) == pytest.approx([0.03])


def test_gaps_of_whole_periods_are_remembered_until_time_jumps():
    watch = StampWatch()
    for ns in np.delete(PERIOD_NS * np.arange(100), [30, 31, *range(50, 70)]):
        watch.add(int(ns))
    assert list(watch.gaps) == [Gap(32 * PERIOD_NS, 3, 0.2), Gap(70 * PERIOD_NS, 21, 0.2)]
    watch.take_for_step(watch.gaps[0])
    assert (watch.steps, watch.last_step_s) == (1, pytest.approx(0.4))
    assert [gap.periods for gap in watch.gaps] == [21]
    watch.restart()
    assert not watch.gaps


def test_small_jitter_is_no_step():
    jitter = np.random.default_rng(0).normal(0, 1e5, 200)
    assert steps_s(PERIOD_NS * np.arange(200) + jitter) == []


def test_uneven_exposures_give_no_result():
    assert steps_s(np.cumsum(np.random.default_rng(1).uniform(1e8, 3e8, 200))) == []


def test_another_frame_rate_is_a_new_pace():
    stamps = np.cumsum([PERIOD_NS] * 40 + [PERIOD_NS // 3] * 80)
    assert len(steps_s(stamps)) <= 20  # until it has the new pace
    assert steps_s(stamps[60:]) == []


def unevenness_s(stamps_ns, most_s=4e-4):
    watch = StampWatch()
    for ns in map(int, stamps_ns):
        watch.add(ns)
    return watch.unevenness_s(most_s)


@pytest.mark.parametrize('period_ns', [PERIOD_NS, 33_366_700])
def test_unevenness_is_measured_to_the_limit_of_twenty_intervals(period_ns):
    """Also with lost images; the mean over many streams is right to a few per cent."""
    rng, std_ns = np.random.default_rng(2), 1.5e6
    found = []
    for _ in range(300):
        kept = np.flatnonzero(rng.random(60) > 0.2)
        found.append(unevenness_s(period_ns * kept + rng.normal(0, std_ns, len(kept))))
    assert None not in found
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(std_ns * 1e-9, rel=0.1)


def test_unevenness_is_less_certain_after_few_intervals():
    """A 1-sigma taken for the truth would be overconfident: mean error over it is at most 1."""
    rng, ratios = np.random.default_rng(3), []
    for _ in range(2000):
        found = unevenness_s(PERIOD_NS * np.arange(6) + rng.normal(0, 3e6, 6), 0.0)
        if found is not None:
            ratios.append(3e-3 / found)
    assert len(ratios) > 1990 and np.sqrt(np.mean(np.square(ratios))) < 1.1


@pytest.mark.parametrize('stamps_ns', [
    PERIOD_NS * np.arange(5.0),  # too few for an estimate
    PERIOD_NS * np.delete(np.arange(60), [30, 31, 45, 52, 53]),
    PERIOD_NS * np.arange(60) + np.random.default_rng(0).normal(0, 2e5, 60),  # in tolerance
    PERIOD_NS * np.arange(60) + 30_000_000 * (np.arange(60) > 50)])  # a step
def test_even_stamps_with_missing_images_and_steps_are_not_reported(stamps_ns):
    assert unevenness_s(stamps_ns) is None


def test_stamps_within_their_parameter_are_hardly_ever_reported():
    rng = np.random.default_rng(4)
    told = [unevenness_s(PERIOD_NS * np.arange(count) + rng.normal(0, 2e5, count)) is not None
            for count in rng.integers(6, 30, 2000)]
    assert np.mean(told) < 0.002


def told_s(stamps_ns):
    """Return the estimated scatter of the stamps after each of them."""
    watch, told = StampWatch(), []
    for ns in map(int, stamps_ns):
        watch.add(ns)
        told.append(watch.unevenness_s(4e-4))
    return told


@pytest.mark.parametrize('rate_hz, std_s', [
    (60.0, 2e-3), (60.0, 3e-3), (30.0, 5e-3), (30.0, 6e-3), (30.0, 8e-3), (5.0, 0.03)])
def test_unevenness_of_any_size_is_reported_and_stays_so(rate_hz, std_s):
    """Beyond a sixth of the period no pace is recognisable: all scatter of intervals counts."""
    rng, found = np.random.default_rng(5), []
    for _ in range(50):
        told = told_s(1e9 * np.sort(np.arange(80) / rate_hz + rng.normal(0, std_s, 80)))
        assert None not in told[8:]
        found += told[40::20]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(std_s, rel=0.15)


@pytest.mark.parametrize('rate_hz, std_s', [(30.0, 3e-3), (60.0, 3e-3)])
def test_missing_images_do_not_reduce_the_reported_unevenness(rate_hz, std_s):
    rng, found = np.random.default_rng(6), []
    for _ in range(100):
        stamps_ns = 1e9 * np.sort(np.arange(80) / rate_hz + rng.normal(0, std_s, 80))
        found.append(told_s(stamps_ns[rng.random(80) > 0.2])[-1])
    assert None not in found
    assert 1.0 < np.sqrt(np.mean(np.square(found))) / std_s < 2.0


def test_arbitrary_exposure_times_report_the_scatter_of_intervals():
    """Intervals of 0.1 to 0.3 s have a 1-sigma of 0.2 s / sqrt(12)."""
    rng = np.random.default_rng(1)
    found = [unevenness_s(np.cumsum(rng.uniform(1e8, 3e8, 60))) for _ in range(100)]
    assert None not in found
    assert np.mean(found) == pytest.approx(0.2 / np.sqrt(12) / np.sqrt(2), rel=0.15)


@pytest.mark.parametrize('off_ns', [2_500_000, -2_500_000, 10_000_000])
@pytest.mark.parametrize('period_ns', [PERIOD_NS, THIRTIETH_NS])
def test_single_stray_stamp_is_not_reported(off_ns, period_ns):
    stamps_ns = period_ns * np.arange(80)
    stamps_ns[50] += off_ns
    assert told_s(stamps_ns) == [None] * 80


def test_two_stray_stamps_are_reported():
    stamps_ns = THIRTIETH_NS * np.arange(80)
    stamps_ns[[50, 55]] += 2_500_000
    assert told_s(stamps_ns)[56] > 4e-4


@pytest.mark.parametrize('rate_hz', [29.0, 25.0, 20.0, 15.0, 50.0, 60.0])
def test_another_even_pace_is_not_uneven(rate_hz):
    stamps_s = np.concatenate([np.arange(40) / 30, 40 / 30 + np.arange(40) / rate_hz])
    assert told_s(stamps_s * 1e9) == [None] * 80


def test_onset_of_jitter_is_reported_within_a_few_pairs():
    rng = np.random.default_rng(7)
    for _ in range(50):
        stamps_ns = THIRTIETH_NS * np.arange(80.0)
        stamps_ns[50:] += rng.normal(0, 3e6, 30)
        told = told_s(stamps_ns)
        assert told[:50] == [None] * 50 and None not in told[60:]


def odd_shares(stamps_ns, odd_s=9e-4, most_s=0.01, least_s=0.06):
    """Return the relative speed uncertainty from odd stamps at each stamp."""
    watch, shares = StampWatch(), []
    for ns in map(int, stamps_ns):
        watch.add(ns)
        shares.append(watch.odd_share(odd_s, most_s, least_s))
    return np.array(shares)


def test_odd_share_is_computed_once_per_pair_for_all_tracks():
    watch = StampWatch()
    for ns in PERIOD_NS * np.arange(30) + 2_500_000 * (np.arange(30) == 29):
        watch.add(int(ns))
    share = watch.odd_share(9e-4, 0.01, 0.06)
    assert share > 0 and watch.odd_share(9e-4, 0.01, 0.06) is share
    assert watch.odd_share(9e-4, 1e-3, 0.06) == pytest.approx(share / 2.5)
    watch.add(30 * PERIOD_NS)
    assert watch.odd_share(9e-4, 0.01, 0.06) == pytest.approx(2.5 / 197.5)


def test_speeds_near_an_odd_stamp_are_doubted_by_its_share():
    stamps_ns = 100_000_000 * np.arange(80)
    stamps_ns[50] += 2_500_000
    shares = odd_shares(stamps_ns)
    assert not shares[:50].any() and not shares[71:].any()
    assert shares[50] == pytest.approx(2.5 / 102.5)
    assert shares[51] == pytest.approx(2.5 / 97.5)  # the way from it is too short by as much
    assert shares[52:71] == pytest.approx(2.5 / (97.5 + 100 * np.arange(1, 20)))


@pytest.mark.parametrize('stamps_ns', [
    PERIOD_NS * np.arange(60),
    PERIOD_NS * np.delete(np.arange(60), [30, 31, 45, 52, 53]),
    PERIOD_NS * np.arange(60) + np.random.default_rng(0).normal(0, 2e5, 60)])  # in tolerance
def test_regular_stamps_have_no_odd_share(stamps_ns):
    assert not odd_shares(stamps_ns)[3:].any()


def test_odd_share_is_limited_by_baseline_and_maximum_error():
    stamps_ns = THIRTIETH_NS * np.arange(80)
    stamps_ns[50] += 2_500_000
    assert odd_shares(stamps_ns)[50] == pytest.approx(2.5 / 60)
    assert odd_shares(stamps_ns, most_s=1e-3)[50] == pytest.approx(1.0 / 60)


def test_odd_stamp_among_the_first_is_noticed():
    """Of two different intervals either may be right: each is wrong by half."""
    assert odd_shares(PERIOD_NS * np.arange(3) + [0, 0, 4_000_000])[2] == pytest.approx(2 / 204)
    assert odd_shares(PERIOD_NS * np.arange(4) + [0, 0, 0, 4_000_000])[3] == pytest.approx(4 / 204)
