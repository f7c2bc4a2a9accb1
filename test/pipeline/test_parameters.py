# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every parameter has an effect, and all legal values run."""
from __future__ import annotations

from dataclasses import astuple, dataclass, Field, field, replace
from functools import lru_cache
import math
from typing import Any, Callable, Mapping, Optional, Sequence

import cv2
import numpy as np
import pytest
from stereo_speed.core.config import parameters_of, record_of
from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import Verdict
from stereo_speed.core.records import InitialFront, StereoPair, TrackUpdate
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.detection.box_detector import BoxConfig, BoxDetector
from stereo_speed.detection.config import DetectorConfig
from stereo_speed.detection.detector import PlaneSweepDetector
from stereo_speed.detection.protocol import (
    Detection, Detector, EarlierFront, ImageBox, TrackedRegion)
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.io.bags import StereoBag
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.pipeline import SpeedPipeline
from stereo_speed.pipeline.run import Observer, Run, run
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.tracking.constrained import ConstrainedTracker

Values = Mapping[str, Any]  # dotted name to value
SWEEP, BOXES = 'detectors.plane_sweep.', 'detectors.boxes.'
FIELDS = {name: field for name, field in {
    **dict(parameters_of(TrackerConfig)), **dict(parameters_of(DetectorConfig, SWEEP)),
    **dict(parameters_of(BoxConfig, BOXES))}.items()
    # For non-cars: test/detection/test_narrow_fronts.py.  The speed of boxes is like that of
    # the plane sweep, which is tested.
    if '.front.narrow_' not in name and name != BOXES + 'motion.speed_std_share'}
CHEAP: Values = {'particles': 40}


def configured(values: Values) -> PipelineConfig:
    """Return the configuration with some parameters set."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        *sections, last = name.split('.')
        inner = nested
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = value
    detectors = nested.pop('detectors', {})
    return PipelineConfig(
        record_of(TrackerConfig, nested, 'test'),
        detectors={name: record_of(kind, detectors.get(name, {}), 'test', f'detectors.{name}.')
                   for name, kind in (('plane_sweep', DetectorConfig), ('boxes', BoxConfig))})


@dataclass(frozen=True, eq=False)
class Scenario:
    """
    The input of a measurement.

    :param detector: makes a detector; None where the vehicles are annotated.
    """

    rig: StereoRig
    lanes: Mapping[str, LanePath]
    pairs: tuple[StereoPair, ...]
    fronts: tuple[InitialFront, ...] = ()
    detector: Optional[Callable[[PipelineConfig], Detector]] = None

    def run(self, config: PipelineConfig, observe: Optional[Observer] = None) -> Run:
        """Measure it."""
        detector = None if self.detector is None else self.detector(config)
        return run(SpeedPipeline(
            self.rig, self.lanes, config.shared,
            lambda start: ConstrainedTracker.start(start, config.tracker_settings),
            annotations=self.fronts, detector=detector), self.pairs, observe)

    def swept(self) -> Scenario:
        """Return it with its vehicles detected."""
        return replace(self, detector=lambda config: PlaneSweepDetector(
            self.rig, self.lanes, config.detectors['plane_sweep']))

    def boxed(self, at: Sequence[tuple[np.ndarray, np.ndarray]], *, late: int = 0,
              off_px: float = 0.0, first: int = 0) -> Scenario:
        """
        Return the scenario with its vehicles found by boxes around them.

        :param at: place of the front in each pair.
        :param late: number of pairs by which the boxes are late.
        :param off_px: error of the boxes.
        :param first: index of the first pair that has a box.
        """
        boxes = {pair.stamp_ns: around(left_px, off_px)
                 for pair, (left_px, _) in zip(self.pairs, at)}
        return replace(self, detector=lambda config: Boxed(
            BoxDetector(self.rig, self.lanes, config.detectors['boxes']), boxes, late, first))


def around(front_px: np.ndarray, off_px: float) -> ImageBox:
    """
    Return the box of a 1.8 m wide car whose front is 0.3 m above the road.

    :param off_px: by how much the box is too narrow on either side; it is too low by thrice that.
    """
    low, high = front_px.min(axis=0), front_px.max(axis=0)
    px_per_m = float(high[0] - low[0]) / 1.8
    return ImageBox(left_px=float(low[0]) - 1 + off_px,
                    top_px=float(high[1]) - 1.15 * px_per_m + 3 * off_px,
                    width_px=1.8 * px_per_m + 2 - 2 * off_px, height_px=1.45 * px_per_m,
                    score=0.6)


@dataclass(frozen=True)
class Boxed:
    """
    A detector that is given boxes.

    :param detector: takes the boxes.
    :param boxes: by the stamp of their pair.
    :param late: number of pairs by which they are late.
    :param first: index of the first pair that has a box.
    """

    detector: BoxDetector
    boxes: Mapping[int, ImageBox]
    late: int
    first: int

    def update(self, pair, tracked):
        """Return what is found by the boxes that have come."""
        stamps_ns = list(self.boxes)
        at = stamps_ns.index(pair.stamp_ns) - self.late
        if at >= self.first:
            self.detector.offer(stamps_ns[at], [self.boxes[stamps_ns[at]]])
        return self.detector.update(pair, tracked)

    def reset(self):
        """Forget the earlier pairs."""
        self.detector.reset()


@dataclass(frozen=True)
class Script:
    """
    A detector that finds one front in each of some pairs, unless a track holds it.

    :param found: index of the pair to what is found there.
    :param again: also find it where a track holds it.
    """

    found: Mapping[int, Detection]
    again: bool = False

    def update(self, pair, tracked):
        """Return what is found in a pair."""
        return [self.found[pair.index]] if pair.index in self.found and (
            self.again or not tracked) else []

    def reset(self):
        """Forget nothing."""


@pytest.fixture(scope='session')
def passing(sample) -> Scenario:
    """Return the sample's first pairs, annotated, on lanes without a speed limit."""
    with StereoBag(sample / 'bag') as bag:
        rig, pairs = bag.rig, tuple(bag.pairs())
    place = MeasuringSite.of(load_site(sample / 'site.yaml'), rig)
    lanes = {name: replace(lane, speed_limit_mps=None) for name, lane in place.lanes.items()}
    return Scenario(place.rig, lanes, pairs[:6], tuple(load_init(sample / 'init.yaml')))


@pytest.fixture(scope='session')
def scenarios(passing) -> Callable[[str], Scenario]:
    """Return the scenarios by name, each made once."""
    @lru_cache(maxsize=None)
    def made(name: str) -> Scenario:
        return MAKERS[name](passing)
    return made


def quads(passing: Scenario) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return where the front is in each pair, as a run with the defaults measures it."""
    updates = passing.run(configured(CHEAP)).updates
    return [(u.quad_left_px, u.quad_right_px) for u in updates]


def blank(pair: StereoPair) -> StereoPair:
    """Return a pair whose images show nothing."""
    return replace(pair, left=np.full_like(pair.left, 90), right=np.full_like(pair.right, 90))


def with_post(pair: StereoPair, quad: tuple[np.ndarray, np.ndarray]) -> StereoPair:
    """Return a pair with a post in front of a fifth of the front, a tenth of its width nearer."""
    views = []
    for image, corners, nearer in ((pair.left, quad[0], 0.0), (pair.right, quad[1], 0.1)):
        low, high = corners.min(axis=0), corners.max(axis=0)
        at = round(float(low[0] + (0.3 - nearer) * (high[0] - low[0])))
        view = image.copy()
        view[:, at:at + round(0.2 * float(high[0] - low[0]))] = 60
        views.append(view)
    return replace(pair, left=views[0], right=views[1])


def _first(count: int) -> Callable[[Scenario], Scenario]:
    return lambda passing: replace(passing, pairs=passing.pairs[:count])


def _occluded(passing: Scenario) -> Scenario:
    at = quads(passing)
    return replace(passing, pairs=tuple(
        with_post(pair, at[k]) if k in (3, 4) else pair for k, pair in enumerate(passing.pairs)))


def _lost(passing: Scenario) -> Scenario:
    return replace(passing, pairs=tuple(
        blank(pair) if k == 3 else pair for k, pair in enumerate(passing.pairs)))


def _late(passing: Scenario) -> Scenario:
    return replace(passing, pairs=tuple(
        replace(pair, right_stamp_ns=pair.stamp_ns + 600_000) for pair in passing.pairs[:4]))


def _blurred(passing: Scenario) -> Scenario:
    """Put the right camera out of focus."""
    return replace(passing, pairs=tuple(
        replace(pair, right=cv2.GaussianBlur(pair.right, (0, 0), 1.5))
        for pair in passing.pairs[:4]))


def _glare(passing: Scenario) -> Scenario:
    """Put a strong lamp before the front, whose light spreads in the lens."""
    pairs = []
    for pair, quad in zip(passing.pairs[:4], quads(passing)):
        views = []
        for image, (u, v) in zip((pair.left, pair.right), (q.mean(axis=0) for q in quad)):
            at_v, at_u = np.indices(image.shape)
            lamp = 1500.0 * (np.hypot(at_u - u, at_v - v) < 3)
            spread = lamp + 3 * cv2.GaussianBlur(lamp, (0, 0), 8.0)
            views.append(np.clip(image + spread, 0, 255).astype(np.uint8))
        pairs.append(replace(pair, left=views[0], right=views[1]))
    return replace(passing, pairs=tuple(pairs))


def _twice(passing: Scenario) -> Scenario:
    return replace(passing, pairs=passing.pairs[:3], fronts=passing.fronts * 2)


def _short_path(passing: Scenario) -> Scenario:
    """End the path of the lane soon after the first pair."""
    lane = passing.lanes['lane_0']
    begin, start = lane.path.position(np.array(0.0)), passing.rig.triangulate(
        *(q.mean(axis=0) for q in (passing.fronts[0].left_px, passing.fronts[0].right_px)))
    path = StraightPath(begin, lane.path.frame(np.array(0.0))[:, 0],
                        float(lane.path.arc_length(start)) + 8.0)
    return replace(passing, lanes={'lane_0': replace(lane, path=path)}, pairs=passing.pairs[:5])


def _receding(passing: Scenario) -> Scenario:
    """Let the vehicle drive backwards, which shows as its rear would."""
    lane, first, pairs = passing.lanes['lane_0'], quads(passing)[4], passing.pairs[:5]
    ahead = lane.path.frame(np.array(0.0))[:, 0]
    path = StraightPath(lane.path.position(np.array(lane.path.length_m)), -ahead,
                        lane.path.length_m)
    return replace(
        passing, lanes={'lane_0': replace(lane, path=path)}, pairs=tuple(
            replace(shown, index=at.index, stamp_ns=at.stamp_ns, right_stamp_ns=at.stamp_ns)
            for shown, at in zip(reversed(pairs), pairs)),
        fronts=(replace(passing.fronts[0], left_px=first[0], right_px=first[1]),))


def moved_lane(passing: Scenario, name: str, left_m: float, *, left: float = 0.0, up: float = 0.0
               ) -> dict[str, LanePath]:
    """
    Return a straight lane beside that of the sample.

    :param left_m: distance to its left, where the sample's path is at the first pair.
    :param left: by how much it diverges to the left, per metre.
    :param up: by how much it climbs.
    """
    lane, front = passing.lanes['lane_0'], passing.fronts[0]
    s_m = lane.path.arc_length(passing.rig.triangulate(
        front.left_px.mean(axis=0), front.right_px.mean(axis=0)))
    axes = lane.path.frame(np.array(s_m)).T
    start = lane.path.position(np.array(s_m)) - s_m * axes[0] + left_m * axes[1]
    path = StraightPath(start, axes[0] + left * axes[1] + up * axes[2], lane.path.length_m)
    return {name: replace(lane, name=name, path=path)}


def _crossing(passing: Scenario) -> Scenario:
    """Move the vehicle from one lane into another that climbs."""
    return replace(passing, lanes=moved_lane(passing, 'own', -0.6)
                   | moved_lane(passing, 'other', -1.8, left=0.04, up=-0.02))


def _swept_across(passing: Scenario) -> Scenario:
    """Detect a vehicle that crosses its lane."""
    return replace(passing, lanes=moved_lane(passing, 'other', -2.0, left=0.06), fronts=(),
                   pairs=passing.pairs[:3]).swept()


def _scripted(speed_mps: float, at: tuple[int, ...] = (0,), earlier: int = 0, *,
              again: bool = False) -> Callable[[Scenario], Scenario]:
    """
    Return the maker of a scenario in which a script detects the front at a speed.

    :param again: also where a track holds it, then slightly displaced.
    """
    def made(passing: Scenario) -> Scenario:
        where = quads(passing)

        def found(k: int) -> Detection:
            since, aside_px = passing.pairs[k - earlier:k], 12.0 * k * again
            return Detection(
                lane='lane_0', left_px=where[k][0] + [aside_px, 0.0],
                right_px=where[k][1] + [aside_px, 0.0], std_px=0.7, s_m=0.0,
                lateral_m=0.0, width_m=1.8, height_m=0.5, speed_mps=speed_mps,
                speed_std_mps=0.05 * speed_mps, earlier=None if not earlier else EarlierFront(
                    pairs=since, left_px=where[k - earlier][0], right_px=where[k - earlier][1]))
        script = Script({k: found(k) for k in at}, again)
        return replace(passing, fronts=(), detector=lambda config: script)
    return made


def _uneven(passing: Scenario) -> Scenario:
    """Shift stamps off their regular interval by some ms."""
    return replace(passing, pairs=tuple(
        replace(pair, stamp_ns=pair.stamp_ns + off_ns, right_stamp_ns=pair.stamp_ns + off_ns)
        for pair, off_ns in zip(passing.pairs, 2 * (0, 4_000_000, 1_000_000, 3_000_000))))


def _swept(passing: Scenario) -> Scenario:
    return replace(passing, fronts=(), pairs=passing.pairs[:4]).swept()


def _swept_behind(passing: Scenario) -> Scenario:
    """Detect a vehicle that is partly hidden by a post in the second pair."""
    first, second, third = passing.pairs[:3]
    return replace(passing, fronts=(), pairs=(
        first, with_post(second, quads(passing)[1]), third)).swept()


def _slow(passing: Scenario) -> Scenario:
    """Double the time between pairs."""
    first = passing.pairs[0].stamp_ns
    later = ((pair, 2 * pair.stamp_ns - first) for pair in passing.pairs[:3])
    return replace(passing, fronts=(), pairs=tuple(
        replace(pair, stamp_ns=ns, right_stamp_ns=ns) for pair, ns in later)).swept()


def _followed(passing: Scenario) -> Scenario:
    """Let a second copy of the vehicle follow: it is also where it will be two pairs later."""
    at, pairs = quads(passing), []
    for k, pair in enumerate(passing.pairs[:3]):
        views = [pair.left.copy(), pair.right.copy()]
        ahead = passing.pairs[k + 2]
        for view, image, corners in zip(views, (ahead.left, ahead.right), at[k + 2]):
            (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
            margin = 0.2 * (right - left)
            part = (slice(round(top - 2 * margin), round(bottom + margin)),
                    slice(round(left - margin), round(right + margin)))
            view[part] = image[part]
        pairs.append(replace(pair, left=views[0], right=views[1]))
    return replace(passing, fronts=(), pairs=tuple(pairs)).swept()


@dataclass(frozen=True)
class Near:
    """
    A detector that is given a tracked vehicle near the one to find.

    :param detector: searches for the vehicle.
    :param ahead_m: how far the other vehicle is ahead.
    :param left_m: how far it is to the left.
    """

    detector: Detector
    ahead_m: float
    left_m: float

    def update(self, pair, tracked):
        """Return what is found where no track is."""
        other = TrackedRegion(
            lane='lane_0', s_m=25.9 + 4.9 * pair.index + self.ahead_m,
            lateral_m=self.left_m, width_m=1.8, height_m=0.5,
            left_px=np.zeros((4, 2)), right_px=np.zeros((4, 2)))
        return self.detector.update(pair, [*tracked, other])

    def reset(self):
        """Forget the earlier pairs."""
        self.detector.reset()


def _boxed(scenario: Callable[[Scenario], Scenario], **how: Any
           ) -> Callable[[Scenario], Scenario]:
    """Return the maker of a scenario whose vehicle is found by boxes instead."""
    def made(passing: Scenario) -> Scenario:
        other = scenario(passing)
        return replace(other, fronts=()).boxed(quads(passing), **how)
    return made


def _near(ahead_m: float, left_m: float, make: Callable[[Scenario], Scenario] = _swept
          ) -> Callable[[Scenario], Scenario]:
    def made(passing: Scenario) -> Scenario:
        alone = make(replace(passing, pairs=passing.pairs[:2]))
        return replace(alone, detector=lambda config: Near(
            alone.detector(config), ahead_m, left_m))
    return made


MAKERS: dict[str, Callable[[Scenario], Scenario]] = {
    'start': _first(1), 'short': _first(4), 'passing': _first(5), 'longer': _first(6),
    'occluded': _occluded, 'lost': _lost, 'late': _late, 'blurred': _blurred,
    'glare': _glare, 'twice': _twice,
    'short path': _short_path, 'receding': _receding, 'crossing': _crossing,
    'detected at 20': _scripted(20.0), 'detected late': _scripted(24.6, (3,), 3),
    'detected again': _scripted(24.6, (0, 1), again=True),
    'found again': lambda passing: _scripted(24.6, (0, 1, 2, 3, 4))(_receding(passing)),
    'uneven': _uneven,
    'swept': _swept, 'swept across': _swept_across,
    'swept behind a post': _swept_behind, 'slow': _slow, 'followed': _followed,
    'behind another': _near(10.0, 0.0), 'beside another': _near(0.0, 3.7)}
MAKERS |= {'boxed': _boxed(_first(3)), 'boxed late': _boxed(_first(4), late=1),
           'boxed third': _boxed(_first(3), first=2),
           'boxed fourth': _boxed(_first(4), first=3),
           'boxed aside': _boxed(lambda passing: replace(
               passing, lanes=moved_lane(passing, 'other', -1.6), pairs=passing.pairs[:3])),
           'boxed badly': _boxed(_first(3), off_px=3.0),
           'boxed slow': _boxed(_slow), 'boxed across': _boxed(_swept_across),
           'boxed behind a post': _boxed(_swept_behind),
           'boxed behind another': _near(10.0, 0.0, _boxed(_first(2))),
           'boxed beside another': _near(0.0, 3.7, _boxed(_first(2)))}


@dataclass(frozen=True)
class Case:
    """
    The evidence that a parameter has an effect.

    :param scenario: name of what is measured.
    :param value: another value of the parameter; None uses a greater one.
    :param given: values of other parameters that are not at their defaults.
    """

    scenario: str
    value: Any = None
    given: Values = field(default_factory=dict)


def swept(scenario: str, value: Any = None, **given: Any) -> Case:
    """Return a case of the detector; ``__`` stands for the dot in names of its parameters."""
    return Case(scenario, value, {SWEEP + k.replace('__', '.'): v for k, v in given.items()})


TWO = {'particles': 60, 'particle_budget': 100}
LORRY = {'front__least_width_m': 2.0, 'front__tall_width_m': 1.5}
HIGH = {'front__low_m': 1.0, 'front__high_m': 2.5}  # where a car has no texture
UNCERTAIN = {'max_speed_std_mps': 0.0, 'max_speed_std_share': 0.0}
AT_ONCE = {'visibility.confirm_pairs': 1}
ANY_STD = {'max_speed_std_share': 1.0}
ANY_SCATTER = {'verdict.most_scatter_px': 10.0}
# Parameters that have an effect only in other scenarios, or at other values.
CASES: dict[str, Case] = {
    'particles': Case('passing', 60),
    'resample_ess': Case('passing', 0.0),
    'trigger_tolerance_s': Case('late'),
    'uneven_stamp_sigmas': Case('uneven', 1e6),
    'exposure_odds': Case('uneven', 0.0),
    'max_speed_std_share': Case('passing', 0.0, {'max_speed_std_mps': 0.0}),
    'max_speed_std_mps': Case('passing', 0.0, {'max_speed_std_share': 0.0}),
    'max_scale_std_share': Case('passing', 0.0),
    'particle_budget': Case('twice', 200, TWO | {'effort.fewest_particles': 20}),
    'visibility.least_ncc': Case('passing', 0.999),
    'visibility.occlusion_deficit': Case('occluded', 1.0),
    'visibility.occlusion_noise_factor': Case('occluded', 100.0),
    'visibility.occlusion_best_share': Case('occluded', 1.0),
    'visibility.reading_std_mps': Case('passing', 0.0, {'visibility.reading_std_share': 0.0}),
    'visibility.reading_std_share': Case('passing', 0.0, {'visibility.reading_std_mps': 0.0}),
    'visibility.unnoticed_std_mps': Case(
        'passing', 0.0, {'visibility.unnoticed_braking_mps2': 9.0}),
    'visibility.lost_after_s': Case('lost', 0.1),
    'visibility.occluded_for_s': Case('occluded', 0.1),
    'visibility.least_width_px': Case('receding', 50.0),
    'visibility.beyond_path_m': Case('short path', 0.0),
    'visibility.speed_change_sigmas': Case(
        'passing', 0.0, AT_ONCE | {'verdict.most_acceleration_mps2': 0.1}),
    'start.most_gap_px': Case('start', 0.1),
    'start.least_ncc': Case('start', 0.999),
    'start.tall_width_m': Case('start', 1.0, {'start.tall_high_m': 0.7}),
    'start.tall_high_m': Case('start', 0.7, {'start.tall_width_m': 1.0}),
    'verdict.least_width_px': Case('passing', 100.0),
    'verdict.far_width_px': Case('passing', 100.0, UNCERTAIN),
    'verdict.most_scatter_px': Case('passing', 0.001),
    'verdict.most_height_change_m': Case('crossing', 0.1),
    'verdict.most_speed_mps': Case('passing', 20.0),
    'verdict.most_acceleration_mps2': Case(
        'passing', 0.1, AT_ONCE | {'visibility.speed_change_sigmas': 0.0}),
    'verdict.off_road_m': Case('crossing', 0.1, ANY_STD | ANY_SCATTER),
    'verdict.off_road_share': Case(
        'crossing', 1.0, ANY_STD | ANY_SCATTER | {'verdict.off_road_m': 0.1}),
    'noise.narrow_m': Case('short', 4.0),
    'noise.narrow_relief_std_m': Case('short', 0.1, {'noise.narrow_m': 4.0}),
    'noise.narrow_texture_floor_px': Case('short', 0.2, {'noise.narrow_m': 4.0}),
    'noise.texture_floor_px': Case('passing', 0.1),
    'noise.clipped_floor_px': Case('glare', 0.5),
    'noise.glare_level': Case('glare', 10.0), 'noise.glare_floor_px': Case('glare', 0.0),
    'noise.sharpness_sigmas': Case('blurred', 1000.0),
    'noise.most_blur_px': Case('blurred', 0.5),
    'noise.blur_doubt': Case('blurred', 0.0),
    'noise.band_share': Case('glare', 0.0, ANY_STD | {'noise.clipped_floor_px': 0.0}),
    'verdict.lane_hysteresis_m': Case('crossing', 0.0),
    'effort.live_observations': Case('passing', 4),
    'effort.pass_observations': Case('passing', 4, {'effort.live_observations': 4}),
    'effort.fewest_particles': Case('twice', 20, TWO),
    'effort.solve_interval_s': Case('longer', 0.5),
    'association.catch_up_pairs': Case('detected late', 1),
    'association.same_speed_sigmas': Case('detected at 20', 100.0),
    'association.moving_sigmas': Case('detected late', 100.0),
    'classes.width_std_m': Case('detected at 20'),
    'classes.odd_height_share': Case('passing', 0.5), 'classes.odd_height_m': Case('passing', 0.5),
    'classes.edge_width_m': Case('detected at 20', 4.0, {'classes.edge_height_m': 0.5}),
    'classes.edge_height_m': Case('detected at 20', 0.5, {'classes.edge_width_m': 4.0}),
    'classes.least_height_m': Case('detected at 20', 2.0),
    'classes.heavy_width_m': Case('short', 2.0), 'classes.still_margin': Case('passing', 1.0),
    'association.doubt_s': Case('detected at 20', 0.3),
    'association.braking_mps2': Case('detected at 20', 0.0, {'association.doubt_s': 0.3}),
    'association.gone_s': Case('found again', 0.0, AT_ONCE | {
        'visibility.least_width_px': 48.0, 'association.moving_sigmas': 0.0}),
    'association.same_vehicle_m': Case('detected again', 0.1),
    **{f'second.{name}': Case('longer', value, {'second.most_std_share': 0.1} if name !=
                              'most_std_share' else {}) for name, value in {
        'enabled': False, 'most_sigmas': 0.0, 'most_difference_mps': 0.0, 'most_std_share': 0.1,
        'least_pairs': 7, 'most_pairs': 4, 'most_points': 6, 'least_quality': 0.2,
        'most_round_trip_px': 0.05, 'match_std_px': 0.5, 'match_floor_px': 0.01,
        'tail_dof': 30.0, 'interval_s': 0.5}.items()},
    'second.least_sigmas': Case('longer', 0.0, {
        'second.most_std_share': 0.1, 'second.most_difference_mps': 0.0}),
    'second.least_points': Case('longer', 190, {
        'second.most_points': 200, 'second.most_std_share': 0.1}),
    SWEEP + 'interval_s': swept('swept', 0.3),
    SWEEP + 'long_every': swept('swept', 2, motion__least_px=13.0),
    SWEEP + 'forget_after_s': swept('swept', 0.15),
    SWEEP + 'sweep.still_ncc': swept('swept', -1.0),
    SWEEP + 'sweep.least_ncc': swept('swept', 1.0),
    SWEEP + 'sweep.least_contrast': swept('swept', 100.0),
    SWEEP + 'sweep.noise_factor': swept('swept', 20.0),
    SWEEP + 'sweep.least_votes': swept('swept', 100.0),
    SWEEP + 'sweep.most_proposals': swept('followed', 1, spacing__headway_s=0.0),
    SWEEP + 'sweep.most_refined': swept('followed', 1, spacing__headway_s=0.0),
    SWEEP + 'front.low_m': swept('swept', 0.4),
    SWEEP + 'front.raised_low_m': swept('swept', 0.3, **HIGH),
    SWEEP + 'front.raised_high_m': swept('swept', 0.9, **HIGH),
    SWEEP + 'front.tall_low_m': swept('swept', 0.3, **LORRY),
    SWEEP + 'front.tall_high_m': swept('swept', 1.0, **LORRY),
    SWEEP + 'front.tall_width_m': swept('swept', 1.5, front__least_width_m=2.0),
    SWEEP + 'front.least_width_m': swept('swept', 2.0),
    SWEEP + 'front.least_cross_ncc': swept('swept', 1.0),
    SWEEP + 'front.upright_factor': swept('swept', 100.0),
    SWEEP + 'front.hopeless_ncc': swept('swept', 1.0),
    SWEEP + 'front.apart_m': swept('swept', 0.1, front__apart_px=0.0),
    SWEEP + 'front.apart_px': swept('swept', 0.0, front__apart_m=0.1),
    SWEEP + 'motion.reference_s': swept('swept', 0.3, long_every=1000, motion__least_px=9.0),
    SWEEP + 'motion.long_reference_s': swept('swept', 0.25, long_every=1,
                                             motion__least_px=25.0),
    SWEEP + 'motion.least_speed_mps': swept('slow', 15.0),
    SWEEP + 'motion.greatest_speed_mps': swept('swept', 15.0),
    SWEEP + 'motion.aside_mps': swept('swept across', 0.0, motion__aside_m=0.0),
    SWEEP + 'motion.aside_m': swept('swept across', 2.0, motion__aside_mps=0.0),
    SWEEP + 'motion.least_ncc': swept('swept', 1.0),
    SWEEP + 'motion.still_margin': swept('swept', 1.0),
    SWEEP + 'motion.least_px': swept('swept', 100.0),
    SWEEP + 'motion.change_factor': swept('swept', 0.1),
    SWEEP + 'motion.occluded_share': swept('swept', 1.0, motion__change_factor=0.1),
    SWEEP + 'motion.speed_std_share': Case('swept', 0.0,
                                           {'association.same_speed_sigmas': 0.5}),
    SWEEP + 'spacing.along_m': swept('behind another', 1.0),
    SWEEP + 'spacing.headway_s': swept('behind another', 0.0),
    SWEEP + 'spacing.across_m': swept('beside another', 10.0),
    SWEEP + 'spacing.beside_m': swept('beside another', 2.0),
    SWEEP + 'spacing.least_half_m': swept('beside another', 3.0),
}


def boxed(scenario: str, value: Any = None, **given: Any) -> Case:
    """Return a case of the box detector, as :func:`swept` does."""
    return Case(scenario, value, {BOXES + k.replace('__', '.'): v for k, v in given.items()})


def _by_boxes(case: Case) -> Case:
    """Return a case of the sweep for the same parameter of the box detector."""
    return replace(case, scenario='boxed' + case.scenario.removeprefix('swept'), given={
        name.replace(SWEEP, BOXES): value for name, value in case.given.items()})


CASES |= {name.replace(SWEEP, BOXES): _by_boxes(case) for name, case in CASES.items()
          if name.startswith(SWEEP) and name.replace(SWEEP, BOXES) in FIELDS}
CASES |= {
    BOXES + 'least_score': boxed('boxed', 0.7),
    BOXES + 'history_pairs': boxed('boxed late', 0),
    BOXES + 'forget_after_s': boxed('boxed slow', 0.25, motion__reference_s=0.1),
    BOXES + 'fit.margin_share': boxed('boxed badly', 0.0),
    BOXES + 'fit.lower_share': boxed('boxed', 0.1),
    BOXES + 'fit.side_share': boxed('boxed', 0.0),
    BOXES + 'front.reach_m': boxed('boxed aside', 0.3),
    BOXES + 'motion.reference_s': boxed('boxed third', 0.3),
    BOXES + 'motion.long_reference_s': boxed('boxed fourth', 0.25, motion__least_px=13.0),
    BOXES + 'motion.aside_m': boxed('boxed across', 0.0, motion__aside_mps=0.0),
    BOXES + 'motion.least_speed_mps': boxed('boxed slow', 15.0),
    BOXES + 'spacing.along_m': boxed('boxed behind another', 1.0),
    BOXES + 'spacing.headway_s': boxed('boxed behind another', 0.0),
    BOXES + 'spacing.across_m': boxed('boxed beside another', 10.0),
    BOXES + 'spacing.beside_m': boxed('boxed beside another', 2.0),
    BOXES + 'spacing.least_half_m': boxed('boxed beside another', 3.0),
}


def case_of(name: str) -> Case:
    """Return the case for a parameter."""
    usual = 'swept' if name.startswith(SWEEP) else 'boxed' if name.startswith(BOXES) else 'short'
    return CASES.get(name, Case(usual))


def greater(known: Field[Any]) -> Any:
    """Return a valid value of a parameter other than its default, a greater one if possible."""
    default, meta = known.default, known.metadata
    if meta['choices']:
        return next(choice for choice in meta['choices'] if choice != default)
    if isinstance(default, bool):
        return not default
    value = min(type(default)(1.7 * default), meta['high'])
    return value if value != default else meta['low']


Report = tuple[list[Any], Any]  # of the updates, in order; of the passes, or the error's line


class Different(Exception):
    """A run's report differs from another one already, so its rest does not matter."""


def outcome(scenario: Scenario, values: Values, beside: Optional[Report] = None) -> Report:
    """
    Return the complete report of a run, as comparable values.

    :param beside: the report of another run.
    :raises Different: at the first update that differs from that of the other run.
    """
    updates: list[Any] = []

    def add(pair: StereoPair, step: Any) -> None:
        at = len(updates)
        updates.extend((u.stamp_ns, u.track, u.lane, u.state, u.speed_mps, u.speed_std_mps, u.s_m,
                        u.lateral_m, u.position_cov_m2.tolist(), u.quad_left_px.tolist())
                       for u in step.updates)
        if beside is not None and updates[at:] != beside[0][at:len(updates)]:
            raise Different
    try:
        done = scenario.run(configured({**CHEAP, **values}), add)
    except InputError as error:
        return updates, str(error)
    return updates, [comparable(astuple(one)) for one in done.passes]


def changes(scenario: Scenario, values: Values, usual: Report) -> bool:
    """Return whether a run's report differs from another one."""
    try:
        return outcome(scenario, values, usual) != usual
    except Different:
        return True


def comparable(value: Any) -> Any:
    """Return a value with lists in place of its arrays, which have no truth value."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: comparable(one) for key, one in value.items()}
    return [comparable(one) for one in value] if isinstance(value, (tuple, list)) else value


@pytest.fixture(scope='session')
def usual(scenarios) -> Callable[[Case], Report]:
    """Return the function that gives the report of a case without the changed parameter."""
    known: dict[Any, Report] = {}

    def found(case: Case) -> Report:
        key = case.scenario, *sorted(case.given.items())
        if key not in known:
            known[key] = outcome(scenarios(case.scenario), case.given)
        return known[key]
    return found


# Its proposals matter where the first place fails: test/detection/test_box_proposals.py.
ELSEWHERE = BOXES + 'fit.lower_edge_px'


@pytest.mark.slow
@pytest.mark.parametrize('name', [name for name in FIELDS if name != ELSEWHERE])
def test_every_parameter_changes_something(name, scenarios, usual):
    case = case_of(name)
    value = greater(FIELDS[name]) if case.value is None else case.value
    assert value != case.given.get(name, FIELDS[name].default)
    assert changes(scenarios(case.scenario), {**case.given, name: value}, usual(case))


COSTLY = {'particles': 300, 'effort.fewest_particles': 300}  # greatest values drawn for these


def drawn(known: Field[Any], rng: np.random.Generator, most: float) -> Any:
    """Return a random valid value of a parameter, a bound in one of three draws."""
    default, meta = known.default, known.metadata
    if meta['choices']:
        return meta['choices'][rng.integers(len(meta['choices']))]
    if isinstance(default, bool):
        return bool(rng.integers(2))
    low, high = meta['low'], min(meta['high'], most)
    if rng.random() < 1 / 3:
        return type(default)(low if rng.random() < 0.5 else high)
    if high > 30 * max(low, 0.0) and low >= 0:
        value = math.exp(rng.uniform(math.log(max(low, 1e-5 * high)), math.log(high)))
    else:
        value = rng.uniform(low, high)
    return type(default)(min(max(round(value) if isinstance(default, int) else value, low), high))


def drawn_config(seed: int) -> PipelineConfig:
    """Return a random configuration; where few parameters are drawn, the others are defaults."""
    rng = np.random.default_rng(seed)
    share = rng.choice([0.03, 0.2, 1.0])
    for _ in range(1000):
        values = {name: drawn(known, rng, COSTLY.get(name, math.inf))
                  for name, known in FIELDS.items() if rng.random() < share}
        try:
            return configured({**CHEAP, **values})
        except InputError:
            continue  # parameters that contradict each other are refused before anything runs
    raise AssertionError('no legal configuration')


@pytest.mark.slow
@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('seed', [*range(20), 263])
@pytest.mark.parametrize('name', ['short', 'swept'])
def test_every_valid_configuration_runs(name, seed, scenarios):
    scenario, config = scenarios(name), drawn_config(seed)
    updates: list[TrackUpdate] = []
    try:
        done = replace(scenario, pairs=scenario.pairs[:4 - (name == 'swept')]).run(
            config, lambda pair, step: updates.extend(step.updates))
    except InputError as error:
        assert name == 'short' and 'first front' in str(error)  # the annotation is no front then
        return
    for update in updates:
        assert np.isfinite([update.speed_mps, update.speed_std_mps, *update.position_m]).all()
    for one in done.passes:
        assert (one.speed_mps is None) == (one.verdict is Verdict.REJECTED)
        assert one.speed_mps is None or math.isfinite(one.speed_mps + one.speed_std_mps)


def test_only_parameters_have_cases():
    assert set(CASES) <= set(FIELDS)
    assert {n for case in CASES.values() for n in case.given} <= set(FIELDS)
