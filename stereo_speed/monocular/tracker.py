# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The monocular tracker: takes frames and returns the targets' boxes (2010, Section IV).

Each target has a bootstrap filter (eq. 11-14): resample, predict, weight, average. A target that
no longer looks like itself is occluded; its particles continue by the motion model. A target that
stays occluded is lost, and one that leaves the image has left; it ends and is never reacquired.

Targets are located from the nearest to the farthest, by the rows of their feet, and each occludes
those behind it. So two targets do not claim the same pixels.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Union

import numpy as np
from numpy.typing import NDArray

from .appearance import Appearance
from .background_model import BackgroundModel
from .boxes import envelope, Target, TargetEnd, TargetEstimate, TargetState
from .colour_bins import BinImage, Boxes
from .config import MonocularConfig
from .distance import DistanceField
from .motion import EnvironmentMotion, ParticleMotion, PlainMotion
from .particles import first_particles, mean_box, Particles, reference_point
from .perspective import draw_horizons
from ..core.errors import InputError
from ..core.records import Array
from ..estimation.weights import normalise_log_weights

TRACKERS = ('environment', 'plain')


class TargetFilter:
    """
    The filter of one target.

    :param target: as marked.
    :param frame: the frame in which it is marked.
    :param field: the environment.
    :param motion: its motion model.
    :param particles: its initial particles.
    :param config: parameters.
    :param rng: random generator.
    """

    def __init__(self, target: Target, frame: BinImage, field: DistanceField,
                 motion: ParticleMotion, particles: Particles, config: MonocularConfig,
                 rng: np.random.Generator) -> None:
        self.target, self.field, self.motion = target, field, motion
        self.config, self.rng = config, rng
        self.upright = target.upright
        self.particles = motion.start(particles)
        self.weights = np.full(len(particles), 1.0 / len(particles))
        self.appearance = Appearance(config, frame, self._boxes(self.particles.take(
            np.zeros(1, dtype=np.intp))))
        self.state = TargetState.TRACKED
        self.last_frame, self.frames = target.frame, 1
        self._usual_evidence: Optional[float] = None
        self._last_seen = target.frame
        self.estimate = self._estimate(target.frame, target.box_px, target.angle_rad, 1.0)

    def step(self, number: int, frame: BinImage) -> Optional[TargetEstimate]:
        """
        Track the target into a frame.

        :param number: number of the frame; only the difference to the last one matters.
        :return: its estimate; None when it has ended, see ``state``.
        """
        frames = float(number - self.last_frame)
        moved, log_weights = self.motion.move(
            self.particles.resampled(self.weights, self.rng), frames, self.rng)
        boxes = self._boxes(moved)
        found = self.appearance.log_likelihood(frame, boxes)
        # the likelihood of an unseen target is the lower bound for every box
        unseen = -self.config.lambda_b * (1.0 - self.appearance.unseen_similarity)
        visible = found.visible >= self.config.least_visible
        log_weights = log_weights + np.where(visible, np.maximum(found.log, unseen), unseen)
        self.particles, self.weights = moved, normalise_log_weights(log_weights)
        box, angle = mean_box(moved, self.weights, self.upright)
        one = Boxes.one(box, angle, self.upright)
        self._decide(number, frame, one, float(self.weights @ ~visible))
        if not self.state.followed:
            return None
        if self.state is TargetState.TRACKED:
            self.appearance.renew(frame, one)
        if frame.background is not None:
            self.appearance.review(frame.background, envelope(box, angle))
        self.last_frame, self.frames = number, self.frames + 1
        self.estimate = self._estimate(number, box, angle, float(self.weights @ found.similarity))
        return self.estimate

    def expected_px(self, number: int) -> Array:
        """Return the box (4,) predicted for a frame with constant velocity, px."""
        box = self.estimate.box_px.copy()
        box[:2] += self.estimate.velocity_px * (number - self.last_frame)
        return box

    def end(self) -> TargetEnd:
        """Return how the target ended."""
        state = TargetState.STREAM_ENDED if self.state.followed else self.state
        return TargetEnd(id=self.target.id, first_frame=self.target.frame,
                         last_frame=self.last_frame, frames=self.frames, state=state)

    def _decide(self, number: int, frame: BinImage, box: Boxes, outside: float) -> None:
        """
        Decide whether the target is tracked, occluded, lost or has left.

        It is tracked where its box exceeds its surroundings in similarity nearly as much as usual.

        :param outside: weight of the particles outside the image.
        """
        c = self.config
        similarity, seen, visible = self.appearance.compare(frame, box)
        evidence = float(similarity[0] - self.appearance.surround_similarity(frame, box)[0])
        usual = evidence if self._usual_evidence is None else self._usual_evidence
        if outside > c.outside_weight or visible[0] < c.least_visible:
            self.state = TargetState.LEFT_VIEW
        elif seen[0] >= c.least_visible and evidence > 0 \
                and evidence >= c.hidden_evidence * usual:
            self.state = TargetState.TRACKED
            self._last_seen = number
            self._usual_evidence = usual + c.usual_renewal * (evidence - usual)
            self.appearance.usual.add(float(similarity[0]))
        elif number - self._last_seen <= c.hidden_frames:
            self.state = TargetState.OCCLUDED
        else:
            self.state = TargetState.LOST

    def _boxes(self, particles: Particles) -> Boxes:
        """Return the boxes of particles."""
        if not self.upright:
            return Boxes(particles.point_px, particles.size_px, particles.angle_rad)
        half = np.stack([np.zeros(len(particles)), particles.size_px[:, 1] / 2], axis=-1)
        return Boxes(particles.point_px - half, particles.size_px, None)

    def _estimate(self, number: int, box_px: Array, angle_rad: float,
                  similarity: float) -> TargetEstimate:
        """Return the estimate in a frame."""
        point = reference_point(box_px, self.upright)
        velocity = self.weights @ self.particles.velocity_px
        before = float(self.field.level(point - velocity))
        return TargetEstimate(
            frame=number, id=self.target.id, state=self.state, box_px=box_px,
            angle_rad=angle_rad, distance_px=float(self.field.distance(point)),
            distance_rate_px=float(self.field.level(point)) - before,
            similarity=min(max(similarity, 0.0), 1.0), velocity_px=velocity)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Due:
    """
    A target to be located in a frame.

    :param target: the target, as marked.
    :param box_px: (4,), its last box, px.
    :param seen: whether it was seen there.
    """

    target: Target
    box_px: Array
    seen: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class _Occluder:
    """
    A target that occludes others in a frame in which it is not due itself.

    :param box_px: (4,), its expected box, px.
    """

    box_px: Array
    seen: bool = True


class MonocularTracker:
    """
    Tracks all targets of a video, each from its initial box on, in every ``stride``-th frame.

    :param field: the environment.
    :param targets: the targets, as marked.
    :param config: parameters.
    :param tracker: ``environment`` or ``plain``.
    :param seed: seed of all random numbers; each target has its own stream.
    :param stride: use every stride-th frame.
    :param more_later: whether further targets may be marked while frames are processed.
    :raises InputError: no such tracker.
    """

    def __init__(self, field: DistanceField, targets: Sequence[Target],
                 config: MonocularConfig, *, tracker: str = 'environment', seed: int = 0,
                 stride: int = 1, more_later: bool = False) -> None:
        if tracker not in TRACKERS:
            raise InputError('tracker', 'name', repr(tracker), ', '.join(TRACKERS))
        self.field, self.targets, self.config = field, list(targets), config
        self.tracker, self.seed, self.stride = tracker, seed, stride
        self.more_later = more_later
        self.filters: dict[int, TargetFilter] = {}
        self._ended: list[TargetEnd] = []
        self.background = BackgroundModel(field.width, field.height, config.background_contrast,
                                          config.background_frames) \
            if config.background_contrast > 0 else None

    def process(self, number: int, image: NDArray[np.uint8]) -> list[TargetEstimate]:
        """
        Track the targets into a frame; frames must come in order.

        Skipping a frame makes the step to the next one longer. A target marked in a skipped frame
        is never tracked.

        :param number: number of the frame, from 1.
        :param image: (H, W, 3) uint8, BGR.
        :return: estimates of the targets that are due, seen or predicted; may be empty.
        """
        due = [t for t in self.targets if t.frame <= number
               and (number - t.frame) % self.stride == 0
               and (t.id in self.filters) == (number > t.frame)]
        if not due:
            if not self.filters and (self.more_later or any(
                    t.frame > number and (t.frame - number) % self.stride == 0
                    for t in self.targets)):
                self._learn(image)
            return []
        frame = BinImage(image, self.background)
        estimates = []
        order = self._nearest_first(due, number)
        for item in order:
            if isinstance(item, _Occluder):
                frame.occlude(item.box_px)
                continue
            found = self._locate(item.target, number, frame)
            if found is not None:
                estimates.append(found.estimate)
                if self._occludes(found) and item is not order[-1]:
                    frame.occlude(found.estimate.box_px)
        self._learn(image)
        return estimates

    def mark(self, target: Target, frames: Sequence[tuple[int, NDArray[np.uint8]]]) -> None:
        """
        Start a target that is marked after later frames have been processed.

        Other targets do not occlude it in those frames, because their positions there are no
        longer known.

        :param target: the target, with a number that no other target has.
        :param frames: number and image of the marked frame and of all frames since.
        """
        self.targets.append(target)
        for number, image in frames:
            begun = number == target.frame or target.id in self.filters
            if begun and (number - target.frame) % self.stride == 0:
                self._locate(target, number, BinImage(image, self.background))

    def _locate(self, target: Target, number: int, frame: BinImage) -> Optional[TargetFilter]:
        """Start a target or track it into a frame; return its filter, None when it ended."""
        known = self.filters.get(target.id)
        if known is None:
            known = self.filters[target.id] = self._start(target, frame)
        elif known.step(number, frame) is None:
            self._ended.append(self.filters.pop(target.id).end())
            return None
        return known

    def _nearest_first(self, due: Sequence[Target],
                       number: int) -> list[Union[_Due, _Occluder]]:
        """Order the due targets and their occluders: seen ones first, then by nearness."""
        order: list[Union[_Due, _Occluder]] = []
        for target in due:
            known = self.filters.get(target.id)
            order.append(
                _Due(target=target, box_px=target.box_px, seen=True) if known is None else
                _Due(target=target, box_px=known.estimate.box_px,
                     seen=known.state is TargetState.TRACKED))
        located = {t.id for t in due}
        order += [_Occluder(box_px=known.expected_px(number)) for i, known in self.filters.items()
                  if i not in located and self._occludes(known)]
        return sorted(order, key=lambda item: (not item.seen, -(item.box_px[1] + item.box_px[3])))

    def _occludes(self, known: TargetFilter) -> bool:
        """Return whether a target occludes those behind it."""
        return self.config.covering and known.upright and known.state is TargetState.TRACKED

    def _learn(self, image: NDArray[np.uint8]) -> None:
        """
        Learn the background, except where the targets are.

        A target that stood still before it was marked is learnt as background; see
        :meth:`_unlearn`.
        """
        if self.background is not None:
            self.background.learn(image, [f.estimate for f in self.filters.values()])

    def ended(self) -> list[TargetEnd]:
        """Return the targets that ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def stop(self, number: int) -> None:
        """Stop tracking a target; does nothing if it is not tracked."""
        known = self.filters.pop(number, None)
        if known is not None:
            self._ended.append(known.end())

    def finish(self) -> list[TargetEnd]:
        """End all targets, as the stream ends; return those not returned before."""
        self._ended += [f.end() for f in self.filters.values()]
        self.filters.clear()
        return self.ended()

    def _start(self, target: Target, frame: BinImage) -> TargetFilter:
        """Make the filter of a target in the frame in which it is marked."""
        rng = np.random.default_rng([self.seed, target.id])
        c, upright = self.config, target.upright
        known = [t for t in self.targets if t.upright] if upright else [target]
        horizons = draw_horizons(known, c, c.particles, rng)
        motion: ParticleMotion = PlainMotion(c, upright) if self.tracker == 'plain' \
            else EnvironmentMotion(self.field, c, target)
        particles = first_particles(target, c.particles, c.start_speed, horizons, rng)
        self._unlearn(target, frame)
        return TargetFilter(target, frame, self.field, motion, particles, c, rng)

    def _unlearn(self, target: Target, frame: BinImage) -> None:
        """
        Discard the background in an initial box that looks almost like it.

        A target that stood there before was learnt as background. The true background is learnt
        when the target has gone, and the initial box is then sampled again.
        """
        box = Boxes.one(target.box_px, target.angle_rad, target.upright)
        if self.background is not None \
                and frame.background_share(box) > self.config.background_match:
            self.background.forget(envelope(target.box_px, target.angle_rad))
            frame.background_changed()
