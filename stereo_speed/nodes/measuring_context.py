# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What the node's thread and the measuring thread of a measuring node share."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional

from rclpy.impl.rcutils_logger import RcutilsLogger

from .calibration import CalibrationWatch
from .health import Refusals
from .measuring_settings import MeasuringSettings
from .measuring_state import Counts
from .measuring_workers import MeasuringWorkers
from .outputs import Outputs
from .rig_watch import RigWatch
from .self_test import SelfTestWatch
from ..core.records import InitialFront
from ..site.calibration_age import CalibrationAge
from ..site.file import Site


@dataclass(eq=False)
class MeasuringContext:
    """
    What a measuring node has from its start to its end.

    :param next_track: number of the next vehicle; numbers continue whatever happens.
    """

    log: RcutilsLogger
    settings: MeasuringSettings
    outputs: Outputs
    workers: MeasuringWorkers
    self_test: SelfTestWatch
    rig_watch: RigWatch
    refusals: Refusals
    counts: Counts = field(default_factory=Counts)
    next_track: int = 0


@dataclass(eq=False)
class Configuration:
    """
    What a measuring node has from its configuration until that is discarded.

    :param site: the site as read.
    :param annotations: vehicles that a person annotated; None to have them detected.
    :param calibration: the rig, from the messages of the cameras.
    :param age: consequences of the age of the site's calibration, at the newest pair.
    :param begun: whether measuring has begun; a rig that does not fit the site ends the node until
        then, and later ones do not.

    The measuring thread sets the last two.
    """

    site: Site
    annotations: Optional[tuple[InitialFront, ...]]
    calibration: CalibrationWatch
    age: CalibrationAge = CalibrationAge()
    begun: bool = False
