# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Transform recorded images as if the rig had swayed, or a camera were displaced or out of focus.

A camera that rotates about its own centre sees the same rays at other pixels, independently of
distance, so its image follows exactly from the recorded one. Exceptions are the border, and the
noise, which interpolation and blur smooth: the lost variance of white noise is added again.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .calibration_error import drawn_calibration
from .config import SimConfig
from .optics import FaultConfig, LensConfig, Optics, SHARP
from .sway import Sway, swayed
from .texture import Image
from ...core.errors import InputError
from ...core.records import RigMotion
from ...core.tracker_config import TrackerConfig
from ...core.units import seconds
from ...estimation.robust import robust_std
from ...geometry.rig import StereoRig

_GRAIN_SIGMAS = 3.0  # greater differences are taken for motion


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """
    The disturbance of a rig.

    :param sway_deg: 1-sigma of each angle of the rig, degrees.
    :param sway_hz: frequency of the sway; 0 for angles that are independent in each pair.
    :param turn_deg: pan to the right, tilt upwards and roll clockwise of one camera, degrees.
    :param turn_s: time of that turn, s after the first pair.
    :param exposure_step: largest random change of the exposure of a pair, as a share; uniform
        between both signs, the same in both views.
    :param defocus_px: 1-sigma of the blur of one camera, px.
    :param gamma: the images are taken to be this root of the light, which is blurred.
    :param camera: the camera that turns or is out of focus: 0 left, 1 right.
    :param calibration: whether errors are added to the calibration, see
        :func:`drawn_calibration`; the 1-sigmas are the default tolerances.
    """

    sway_deg: float = 0.0
    sway_hz: float = 0.0
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_s: float = 0.0
    exposure_step: float = 0.0
    defocus_px: float = 0.0
    gamma: float = 1.0
    camera: int = 1
    calibration: bool = False

    @property
    def changes_images(self) -> bool:
        """Return whether images are disturbed."""
        return bool(
            self.sway_deg or any(self.turn_deg) or self.exposure_step or self.defocus_px)


class Disturber:
    """
    Disturbs the images of one recording, with random numbers drawn in advance for each pair.

    ``calibrated`` is the rig as the calibration of the copy describes it.

    :param what: the disturbance.
    :param rig: the rig of the recording.
    :param stamps_ns: stamps of the pairs, in order.
    :param grain_grey: noise 1-sigma of the left and of the right images, grey levels.
    :param rng: source of the sway, the exposures and the noise.
    :raises InputError: there is no disturbance, or only after the last pair.
    """

    def __init__(self, what: Disturbance, rig: StereoRig, stamps_ns: Sequence[int],
                 grain_grey: tuple[float, float], rng: np.random.Generator) -> None:
        if not (what.changes_images or what.calibration):
            raise InputError('disturb', 'disturbance', 'none', 'a sway, a turn, exposure steps '
                             'or a defocus that is not zero, or errors of the calibration')
        times_s = [seconds(stamp_ns, stamps_ns[0]) for stamp_ns in stamps_ns]
        if any(what.turn_deg) and what.turn_s > times_s[-1]:
            raise InputError('disturb', 'time of the turn', f'{what.turn_s:g} s',
                             f'at most {times_s[-1]:g} s, when the last pair is taken')
        self.what, self.rig = what, rig
        self._stamps_ns = np.array(stamps_ns, np.int64)
        self._grain_grey = grain_grey
        wind, light, self._grain, calibration = rng.spawn(4)
        self.calibrated = drawn_calibration(rig, TrackerConfig(), calibration) \
            if what.calibration else rig
        sway = Sway(SimConfig(
            sway_deg=what.sway_deg, sway_hz=what.sway_hz, right_turn_deg=what.turn_deg,
            right_turn_s=what.turn_s), wind)
        self._motions = [sway.motion(t_s) for t_s in times_s]
        faults = FaultConfig(exposure_step=what.exposure_step, right_defocus_px=what.defocus_px)
        size = rig.left.width_px, rig.left.height_px
        self._optics = Optics(LensConfig(gamma=what.gamma), faults, size, light)
        self._of_grain = Optics(SHARP, faults, size, light)
        self._exposures = [self._optics.exposure() for _ in times_s]

    def motion(self, index: int, side: int) -> Optional[RigMotion]:
        """
        Return the rig motion in a pair, as it affects one view; None where there is none.

        :param index: index of the pair.
        :param side: 0 left, 1 right.
        """
        motion = self._motions[index]
        if motion is None or self.what.camera == 1:
            return motion
        pan, tilt, roll = np.add(motion.sway_rad, 0.0 if side else motion.drift_rad).tolist()
        return RigMotion((pan, tilt, roll))  # the rotation of this view's camera

    def nearest(self, stamp_ns: int) -> int:
        """Return the index of the pair that is nearest in time."""
        return int(np.argmin(np.abs(self._stamps_ns - stamp_ns)))

    def disturbed(self, image: NDArray[Any], stamp_ns: int, side: int) -> NDArray[Any]:
        """
        Return the disturbed image.

        Clipped pixels stay clipped in a shorter exposure, because their brightness is unknown.

        :param image: (H, W) uint8 or uint16.
        :param stamp_ns: its header stamp; the disturbance is that of the nearest pair.
        :param side: 0 left, 1 right.
        """
        index, full = self.nearest(stamp_ns), float(np.iinfo(image.dtype).max)
        exposure = self._exposures[index]
        light = image.astype(np.float32)
        light[image >= full] = full / min(exposure, 1.0)
        light = exposure * self._seen(light, index, side, self._optics)
        noise = self._grain.standard_normal(light.shape, np.float32)
        kept = self._seen(noise, index, side, self._of_grain)
        lost = max(0.0, 1.0 - float(kept.var() / noise.var()))
        light += np.float32(self._grain_grey[side] * np.sqrt(lost)) * noise
        return np.asarray(np.clip(np.rint(light), 0.0, full).astype(image.dtype))

    def _seen(self, image: Image, index: int, side: int, optics: Optics) -> Image:
        moved = swayed(image, side, self.rig, self.motion(index, side))
        return optics.spread(moved, int(side == self.what.camera))


def grain_grey(images: Sequence[NDArray[Any]]) -> float:
    """
    Return the noise 1-sigma of a static view, in its grey levels.

    :param images: (H, W), successive images; a single one gives 0.
    """
    found = [0.0]
    for before, after in zip(images, images[1:]):
        change = after.astype(np.float32) - before
        usual = max(robust_std(change), 1.0)  # at least one grey level, because of quantisation
        found.append(float(np.std(change[np.abs(change) <= _GRAIN_SIGMAS * usual])) / np.sqrt(2))
    return float(np.median(found[1:] or found))
