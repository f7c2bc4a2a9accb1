# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The monocular tracker: frames in, the targets' boxes out (2010, Section IV).

A bootstrap filter per target (eq. 11-14): resample, move, weigh, average. A target that does not
look like itself any more is hidden; its particles go on as they moved. One that stays hidden is
lost, one that leaves the image has left: it ends and is never taken up again.

Targets are looked for from the nearest to the farthest, as their feet tell, and each hides what is
behind it. So two of them do not take the same pixels for themselves.
"""
from __future__ import annotations

from typing import Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .appearance import Appearance, USUAL_SHARE
from .background_model import Background
from .boxes import envelope, Target, TargetEnd, TargetEstimate, TargetState
from .colour_bins import BinImage, Boxes
from .config import MonocularConfig
from .distance import DistanceField
from .motion import EnvironmentMotion, MotionModel, PlainMotion
from .particles import first_particles, mean_box, Particles, reference_point
from .perspective import draw_horizons
from ..core.errors import InputError
from ..core.records import Array
from ..estimation.weights import normalise_log_weights

TRACKERS = ('environment', 'plain')
_MOSTLY = 0.8  # of a mark that looks as the background does: the target itself was learnt


class TargetFilter:
    """
    The filter of one target.

    :param target: as marked.
    :param frame: the frame it is marked in.
    :param field: the environment.
    :param motion: how it moves.
    :param particles: its first states.
    :param config: parameters.
    :param rng: randomness.
    """

    def __init__(self, target: Target, frame: BinImage, field: DistanceField,
                 motion: MotionModel, particles: Particles, config: MonocularConfig,
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
        self._usual: Optional[float] = None
        self._hidden_since = target.frame
        self.estimate = self._estimate(target.frame, target.box_px, target.angle_rad, 1.0)

    def step(self, number: int, frame: BinImage) -> Optional[TargetEstimate]:
        """
        Follow the target into a frame.

        :param number: of the frame; only its distance from the last one counts.
        :return: where it is; None when it has ended, see ``state``.
        """
        frames = float(number - self.last_frame)
        moved, log_weights = self.motion.move(
            self.particles.resampled(self.weights, self.rng), frames, self.rng)
        boxes = self._boxes(moved)
        log_likelihood, alike, visible = self.appearance.log_likelihood(frame, boxes)
        # a target that is not seen looks like anything: no box is less likely than that
        unseen = -self.config.lambda_b * (1.0 - self.appearance.unseen)
        log_likelihood = np.where(visible >= self.config.least_visible,
                                  np.maximum(log_likelihood, unseen), unseen)
        log_weights = log_weights + log_likelihood
        self.particles, self.weights = moved, normalise_log_weights(log_weights)
        box, angle = mean_box(moved, self.weights, self.upright)
        one = _one(box, angle, self.upright)
        self._judge(number, frame, one, float(self.weights @ (visible
                                                              < self.config.least_visible)))
        if self.state not in (TargetState.TRACKED, TargetState.HIDDEN):
            return None
        if self.state is TargetState.TRACKED:
            self.appearance.renew(frame, one)
        if frame.background is not None:
            self.appearance.review(frame.background, envelope(box, angle))
        self.last_frame, self.frames = number, self.frames + 1
        self.estimate = self._estimate(number, box, angle, float(self.weights @ alike))
        return self.estimate

    def expected_px(self, number: int) -> Array:
        """Give the box (4,) in which it is in a frame if it goes on as it was seen to, px."""
        box = self.estimate.box_px.copy()
        box[:2] += self.estimate.velocity_px * (number - self.last_frame)
        return box

    def end(self) -> TargetEnd:
        """Tell how the target ended."""
        state = self.state
        if state in (TargetState.TRACKED, TargetState.HIDDEN):
            state = TargetState.STREAM_ENDED
        return TargetEnd(id=self.target.id, first_frame=self.target.frame,
                         last_frame=self.last_frame, frames=self.frames, state=state)

    def _judge(self, number: int, frame: BinImage, box: Boxes, outside: float) -> None:
        """
        Decide whether the target is seen, hidden, lost or has left.

        It is seen where its box looks more like it than the surroundings do, nearly as usual.

        :param outside: weight of the particles outside the image.
        """
        c = self.config
        alike, seen, visible = self.appearance.compare(frame, box)
        evidence = float(alike[0] - self.appearance.around(frame, box)[0])
        usual = evidence if self._usual is None else self._usual
        if outside > 0.5 or visible[0] < c.least_visible:
            self.state = TargetState.LEFT_VIEW
        elif seen[0] >= c.least_visible and evidence > 0 \
                and evidence >= c.hidden_evidence * usual:
            self.state = TargetState.TRACKED
            self._hidden_since = number
            self._usual = usual + USUAL_SHARE * (evidence - usual)
            self.appearance.note(float(alike[0]))
        elif number - self._hidden_since <= c.hidden_frames:
            self.state = TargetState.HIDDEN
        else:
            self.state = TargetState.LOST

    def _boxes(self, particles: Particles) -> Boxes:
        """Give the boxes of particles."""
        if not self.upright:
            return Boxes(particles.point_px, particles.size_px, particles.angle_rad)
        half = np.stack([np.zeros(len(particles)), particles.size_px[:, 1] / 2], axis=-1)
        return Boxes(particles.point_px - half, particles.size_px, None)

    def _estimate(self, number: int, box_px: Array, angle_rad: float,
                  alike: float) -> TargetEstimate:
        point = reference_point(box_px, self.upright)
        velocity = self.weights @ self.particles.velocity_px
        before = float(self.field.level(point - velocity))
        return TargetEstimate(
            frame=number, id=self.target.id, state=self.state, box_px=box_px,
            angle_rad=angle_rad, distance_px=float(self.field.distance(point)),
            distance_rate_px=float(self.field.level(point)) - before,
            similarity=min(max(alike, 0.0), 1.0), velocity_px=velocity)


class MonocularTracker:
    """
    Follows all targets of a video; each from its mark on, in every ``stride``-th frame.

    :param field: the environment.
    :param targets: as marked.
    :param config: parameters.
    :param tracker: ``environment`` or ``plain``.
    :param seed: of all randomness; each target has its own stream.
    :param stride: look at every stride-th frame.
    :raises InputError: no such tracker.
    """

    def __init__(self, field: DistanceField, targets: Sequence[Target],
                 config: MonocularConfig, *, tracker: str = 'environment', seed: int = 0,
                 stride: int = 1) -> None:
        if tracker not in TRACKERS:
            raise InputError('tracker', 'name', repr(tracker), ', '.join(TRACKERS))
        self.field, self.targets, self.config = field, list(targets), config
        self.tracker, self.seed, self.stride = tracker, seed, stride
        self.filters: dict[int, TargetFilter] = {}
        self._ended: list[TargetEnd] = []
        self.background = Background(field.width, field.height, config.background_contrast,
                                     config.background_frames) \
            if config.background_contrast > 0 else None

    def process(self, number: int, image: NDArray[np.uint8]) -> list[TargetEstimate]:
        """
        Look at a frame; frames come in order.

        A frame left out makes the step to the next one longer. A target marked in it is never
        followed.

        :param number: of the frame, from 1.
        :param image: (H, W, 3) uint8, BGR.
        :return: the targets seen or predicted in it; of none when no target's turn has come.
        """
        due = [t for t in self.targets if t.frame <= number
               and (number - t.frame) % self.stride == 0
               and (t.id in self.filters) == (number > t.frame)]
        if not due:
            if not self.filters and any(t.frame > number and (t.frame - number) % self.stride == 0
                                        for t in self.targets):
                self._learn(image)
            return []
        frame = BinImage(image, self.background)
        found = []
        order = self._ordered(due, number)
        for target, cover_px in order:
            if cover_px is not None:
                frame.cover(cover_px)
                continue
            known = self.filters.get(target.id)
            if known is None:
                known = self.filters[target.id] = self._start(target, frame)
            elif known.step(number, frame) is None:
                self._ended.append(self.filters.pop(target.id).end())
                continue
            found.append(known.estimate)
            if self._covers(known) and target is not order[-1][0]:
                frame.cover(known.estimate.box_px)
        self._learn(image)
        return found

    def _ordered(self, due: Sequence[Target],
                 number: int) -> list[tuple[Target, Optional[Array]]]:
        """
        Order the targets: the nearest first, and those that are seen before those that are not.

        :return: the targets due, and those that hide others though they are not due: these with
            the box (4,) in which they are expected, px; the others with None.
        """
        rows = []
        for target in due:
            known = self.filters.get(target.id)
            box = target.box_px if known is None else known.estimate.box_px
            seen = known is None or known.state is TargetState.TRACKED
            rows.append((not seen, -(box[1] + box[3]), target, None))
        waiting = {t.id for t in due}
        for i, known in self.filters.items():
            if i not in waiting and self._covers(known):
                box = known.expected_px(number)
                rows.append((False, -(box[1] + box[3]), known.target, box))
        rows.sort(key=lambda row: row[:2])
        return [(target, box) for _, _, target, box in rows]

    def _covers(self, known: TargetFilter) -> bool:
        """Tell whether a target hides those behind it."""
        return bool(self.config.covering) and known.upright \
            and known.state is TargetState.TRACKED

    def _learn(self, image: NDArray[np.uint8]) -> None:
        """
        Learn the background, but for where the targets are.

        Who stands still before the mark is learnt with it; see :meth:`_unlearn`.
        """
        if self.background is not None:
            self.background.learn(image, [f.estimate for f in self.filters.values()])

    def ended(self) -> list[TargetEnd]:
        """Give the targets that ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def stop(self, number: int) -> None:
        """Follow a target no further; one that is not followed is left as it is."""
        known = self.filters.pop(number, None)
        if known is not None:
            self._ended.append(known.end())

    def finish(self) -> list[TargetEnd]:
        """End all targets, as the stream ends; give those not given before."""
        self._ended += [f.end() for f in self.filters.values()]
        self.filters.clear()
        return self.ended()

    def _start(self, target: Target, frame: BinImage) -> TargetFilter:
        """Make the filter of a target whose turn has come."""
        rng = np.random.default_rng([self.seed, target.id])
        c, upright = self.config, target.upright
        known = [t for t in self.targets if t.upright] if upright else [target]
        horizons = draw_horizons(known, c, c.particles, rng)
        motion: MotionModel = PlainMotion(c, upright) if self.tracker == 'plain' \
            else EnvironmentMotion(self.field, c, target)
        particles = first_particles(target, c.particles, c.start_speed, horizons, rng)
        self._unlearn(target, frame)
        return TargetFilter(target, frame, self.field, motion, particles, c, rng)

    def _unlearn(self, target: Target, frame: BinImage) -> None:
        """
        Forget the background in a mark that hardly stands out from it.

        Who stood there before was learnt as background. What is behind is learnt when the
        target has gone, and the mark is then read again.
        """
        mark = _one(target.box_px, target.angle_rad, target.upright)
        if self.background is not None and frame.background_share(mark) > _MOSTLY:
            self.background.forget(envelope(target.box_px, target.angle_rad))
            frame.background_changed()


def _one(box_px: Array, angle_rad: float, upright: bool) -> Boxes:
    """Give one box to look at."""
    return Boxes(box_px[None, :2] + box_px[None, 2:] / 2, box_px[None, 2:],
                 None if upright else np.array([angle_rad]))
