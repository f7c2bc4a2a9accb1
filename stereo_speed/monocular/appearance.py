# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The likelihood of a box from its colours (2010, Section IV.D, eq. 23-24).

A joint RGB histogram of 16 bins per channel is compared with that of the initial box by their
Bhattacharyya coefficient. Five extensions can be switched on. Three come from work that the paper
builds on: colours shared with the surroundings count less (Comaniciu, Ramesh and Meer 2003, its
[1]); the box is divided into parts (Perez et al. 2002, its [27]); the reference is slowly adapted
(Zhou, Chellappa and Moghaddam 2004, its [24]). Two are our own: the contrast with the surroundings
(a box that is too small has the target's colours around it), and occlusion of targets by nearer
ones.

A box may be marked before its background has been seen, as in the first frame. Then its reference
includes ground, and the box is sampled again when the background becomes known.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .background_model import BackgroundModel
from .boxes import envelope
from .colour_bins import (
    ALL_BINS, BACKGROUND, BinImage, Boxes, grid_points, INITIAL_SAMPLES, Samples)
from .config import MonocularConfig
from .reference import box_histogram, Layout, Reference
from ..core.records import Array


class Evidence(NamedTuple):
    """
    How similar boxes are to the target.

    :param similarity: (N,), similarity of the visible part of each box to the reference, 0 to 1.
    :param seen: (N,), share of the box that is in the image and not occluded.
    :param visible: (N,), share of the box in the image.
    """

    similarity: Array
    seen: Array
    visible: Array


class Likelihood(NamedTuple):
    """
    The likelihood of boxes.

    :param log: (N,), logarithm of the likelihood (eq. 23), up to a constant.
    :param similarity: (N,), similarity including a default for the unseen part, 0 to 1.
    :param visible: (N,), share of the box in the image.
    """

    log: Array
    similarity: Array
    visible: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class InitialView:
    """
    The initial box in its frame, kept until all of its background is known.

    :param image: (H, W, 3), the frame.
    :param box: the initial box.
    :param occluded: (M,), which samples showed another target in front; None where none did.
    :param known: share of the box's background that was known when it was last sampled.
    """

    image: NDArray[np.uint8]
    box: Boxes
    occluded: Optional[NDArray[np.bool_]]
    known: float = 0.0

    @property
    def envelope_px(self) -> Array:
        """Return the upright box around the initial box, px."""
        size = self.box.size_px[0]
        angle = 0.0 if self.box.angle_rad is None else float(self.box.angle_rad[0])
        return envelope(np.concatenate([self.box.centre_px[0] - size / 2, size]), angle)

    def samples(self, background: BackgroundModel) -> Samples:
        """Return the samples of the box, using the background known by now."""
        found = _sample_finely(BinImage(self.image, background), self.box)
        if self.occluded is None:
            return found
        return found._replace(occluded=self.occluded & (found.bins != BACKGROUND))


class UsualValue:
    """
    The usual level of a value: at first the mean, later a running mean.

    :param renewal: weight of a new value in the running mean.

    ``value`` is 0 before the first.
    """

    def __init__(self, renewal: float) -> None:
        self.renewal, self.value, self._count = renewal, 0.0, 0

    def add(self, value: float) -> None:
        """Include a value in the mean."""
        self._count += 1
        self.value += max(1.0 / self._count, self.renewal) * (value - self.value)

    def restart(self) -> None:
        """Let the next value replace all earlier ones."""
        self._count = 0


class Appearance:
    """
    The appearance of a target.

    :param config: parameters of the likelihood.
    :param frame: the frame in which the target is marked.
    :param box: the initial box.

    ``usual`` is the target's usual similarity; it starts at 0, because a target that was just
    marked is not occluded.
    """

    def __init__(self, config: MonocularConfig, frame: BinImage, box: Boxes) -> None:
        self.config = config
        self.usual = UsualValue(config.usual_renewal)
        self._layout = Layout.grid(config.samples_across, config.samples_down, config.parts)
        self._fine_layout = Layout.grid(*INITIAL_SAMPLES, config.parts)
        self._ring = Layout.ring()
        self._surroundings = _surroundings(frame, box, self._ring)
        samples = _sample_finely(frame, box)
        self.reference = self._reference(self._histogram(samples))
        self._initial: Optional[InitialView] = None
        if frame.background is not None:
            occluded = None if samples.occluded is None else samples.occluded[0]
            self._initial = InitialView(image=frame.image.copy(), box=box, occluded=occluded)

    @property
    def unseen_similarity(self) -> float:
        """Return the similarity that is assumed for unseen parts."""
        return self.config.unseen_share * self.usual.value

    def log_likelihood(self, frame: BinImage, boxes: Boxes) -> Likelihood:
        """Return the likelihood of boxes (eq. 23)."""
        similarity, seen, visible = self.compare(frame, boxes)
        # parts outside the image or behind other targets get a default similarity
        similarity = seen * similarity + (1.0 - seen) * self.unseen_similarity
        log_likelihood = -self.config.lambda_b * (1.0 - similarity)
        if self.config.contrast_weight > 0:
            log_likelihood -= self.config.contrast_weight * self.surround_similarity(frame, boxes)
        return Likelihood(log_likelihood, similarity, visible)

    def compare(self, frame: BinImage, boxes: Boxes) -> Evidence:
        """Compare the seen part of each box with the reference."""
        found = self.reference.histograms(frame.sample(boxes, self._layout.at), self._layout)
        alike = self.reference.similarity(found)
        if found.seen is None:
            return Evidence(alike.mean(axis=1), found.visible, found.visible)
        # parts are weighted by their seen share
        total = np.maximum(found.seen.sum(axis=1), 1e-9)
        return Evidence(np.sum(alike * found.seen, axis=1) / total, found.seen.mean(axis=1),
                        found.visible)

    def surround_similarity(self, frame: BinImage, boxes: Boxes) -> Array:
        """Return the similarity (N,) of the seen surroundings of each box to the reference."""
        samples = frame.sample(boxes, self._ring.at)
        return self.reference.similarity_to_whole(self.reference.histograms(samples, self._ring))

    def review(self, background: BackgroundModel, now_px: Array) -> bool:
        """
        Sample the initial box again when more of its background has become known.

        Samples that another target occluded when the box was marked stay excluded.

        :param now_px: (4,), current box of the target; the background learnt there is not trusted.
        :return: whether it was sampled again.
        """
        view = self._initial
        if view is None:
            return False
        known = background.known_share(view.envelope_px, now_px, self.config.background_updates)
        again = known >= view.known + self.config.background_gain or known == 1.0
        if again:
            self.reference = self._reference(self._histogram(view.samples(background)))
            self.usual.restart()  # the usual similarity belonged to the old reference
            view = replace(view, known=known)
        self._initial = None if known == 1.0 else view
        return again

    def renew(self, frame: BinImage, box: Boxes) -> None:
        """Blend the reference with the target's current appearance, by ``adaptation``."""
        share = self.config.adaptation
        if share > 0:
            now = self._histogram(_sample_finely(frame, box))
            self.reference = self._reference((1 - share) * self.reference.histogram + share * now)

    def _histogram(self, samples: Samples) -> Array:
        return box_histogram(samples, self._fine_layout, self.config.initial_free_share)

    def _reference(self, histogram: Array) -> Reference:
        return Reference(histogram, self._surroundings, self.config.surround_weight)


def _sample_finely(frame: BinImage, box: Boxes) -> Samples:
    """Sample a single box with the fine grid of the reference."""
    return frame.sample(box, grid_points(*INITIAL_SAMPLES))


def _surroundings(frame: BinImage, box: Boxes, ring: Layout) -> Array:
    """Return the histogram (bins,) around the initial box; background has share 1."""
    samples = BinImage(frame.image).sample(box, ring.at)
    seen = samples.bins if samples.outside is None else samples.bins[~samples.outside]
    counts = np.bincount(seen.ravel(), minlength=ALL_BINS).astype(np.float64)
    share = counts / max(counts.sum(), 1.0)
    share[BACKGROUND] = 1.0
    return np.asarray(share)
