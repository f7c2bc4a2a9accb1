# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Optional outputs of ``replay``: ``--report``, ``--video`` and ``--sqlite``."""
from __future__ import annotations

import argparse
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .options import add_units_option
from ..core.records import StereoPair
from ..core.units import SpeedUnit
from ..io.pass_log import write_pass_log
from ..io.results import REPORTS, TRACKS
from ..io.video_writer import VideoWriter
from ..pipeline.assembly import MeasuringSite
from ..pipeline.pipeline import Step
from ..pipeline.run import Observer, Run
from ..report.overlay import draw, strip
from ..site.calibration_age import calibration_age

REPORT, VIDEO, SQLITE = REPORTS
_WIDTH_PX = 960  # width of the images in a report
_MONTHS = 12.0  # age at which a calibration is called old; equals the nodes' default


def add_report_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for report, video and database."""
    parser.add_argument('--report', action='store_true',
                        help=f'write {REPORT}, a self-contained file')
    parser.add_argument('--video', action='store_true',
                        help=f'write {VIDEO}: the left images with paths, fronts and speeds')
    parser.add_argument('--sqlite', action='store_true',
                        help=f'write {SQLITE} with all passes and readings')
    add_units_option(parser)


class RunPictures(AbstractContextManager['RunPictures']):
    """
    Collects the images for report and video during a run; a context manager.

    :param args: the options of ``replay``.
    """

    def __init__(self, args: argparse.Namespace) -> None:
        self.args, self.unit = args, SpeedUnit(args.units)
        self._site: Optional[NDArray[np.uint8]] = None
        self._video: Optional[VideoWriter] = None

    def __exit__(self, *_: object) -> None:
        """Remove an unfinished video."""
        if self._video is not None:
            self._video.close()

    def observer(self, place: MeasuringSite, rate_hz: float) -> Observer:
        """
        Return a function that is called with each pair and its :class:`Step`.

        :param place: the site as used for measuring.
        :param rate_hz: rate of the pairs, at which the video plays.
        """
        def observe(pair: StereoPair, step: Step) -> None:
            if self.args.report and self._site is None:
                self._site = draw(pair, (), place.lanes, place.rig)
            if self.args.video:
                frame = draw(pair, step.updates, place.lanes, place.rig)
                if self._video is None:
                    self._video = VideoWriter(self.args.out / VIDEO, frame.shape, rate_hz)
                self._video.write(frame)
        return observe

    def write(self, stage: Path, place: MeasuringSite, result: Run,
              frames: Sequence[NDArray[np.uint8]], summary: Mapping[str, Any],
              warnings: Sequence[str]) -> None:
        """
        Write the report and the database, and finish the video.

        :param stage: folder that they are written to.
        :param place: the site as used for measuring.
        :param result: the run.
        :param frames: annotated images of the run.
        :param summary: content of ``summary.json``.
        :param warnings: warnings for the report.
        """
        if self.args.report:
            from ..report.replay import replay_page, RunFacts  # matplotlib is slow to load
            page = replay_page(RunFacts(
                name=self.args.bag.resolve().name, updates=result.updates, passes=result.passes,
                lanes=place.lanes,
                site=None if self._site is None else strip([self._site], 1, _WIDTH_PX),
                frames=strip(frames, width_px=_WIDTH_PX // 2) if frames else None,
                summary=summary, warnings=warnings), self.unit)
            (stage / REPORT).write_text(page, encoding='utf-8')
        if self.args.sqlite:
            run = str(summary['input']['bag_sha256'])[:16]  # the same for the same bag
            write_pass_log(stage / SQLITE, run, stage / TRACKS, result.passes)
        if self._video is not None:
            self._video.path = stage / VIDEO
            self._video.keep()


def run_warnings(place: MeasuringSite, pairing: Mapping[str, Any], rig: Sequence[str],
                 last_ns: int) -> list[str]:
    """
    Return the warnings for a report.

    :param pairing: as reported by the bag.
    :param rig: lines on the steadiness of the rig and the focus of its cameras.
    :param last_ns: stamp of the last pair.
    """
    age = calibration_age(place.site.calibrated, last_ns, _MONTHS)
    out = [f'Rig {age.text}'] if age.text else []
    if place.not_refined:
        out.append(f'Site not refined, used as written: {place.not_refined}')
    if pairing['unpaired_left'] or pairing['unpaired_right']:
        out.append(f'{pairing["unpaired_left"]} left and {pairing["unpaired_right"]} right '
                   'images have no partner.')
    return [*out, *rig]
