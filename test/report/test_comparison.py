# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The plots of the laboratory."""
from __future__ import annotations

import cv2
import numpy as np

from stereo_speed.report.comparison import draw_survival, SurvivalCurve


def test_plot_has_every_curve_also_without_an_error(tmp_path):
    curves = [SurvivalCurve(name=name, strides=[1, 2], shares=shares, errors=[0.05, float('nan')])
              for name, shares in (('first', [0.9, 0.8]), ('second', [0.3, 0.2]))]
    sizes = []
    for count in (0, 1, 2):
        draw_survival(tmp_path / 'kept.png', 'title', curves[:count])
        image = cv2.imread(str(tmp_path / 'kept.png'))
        sizes.append(int(np.sum(np.ptp(image.astype(int), axis=2) > 40)))  # coloured pixels
    assert sizes[0] == 0 < sizes[1] < sizes[2]
