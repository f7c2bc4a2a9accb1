# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The tables of Zhu, Yuan, Zheng and Ewing (2012), Section V, as data, with their settings.

All figures below are the paper's. It ran each cell 20 times from the same start and gives the
average of the *final* estimated speeds and the maximum error. Its comparison of trackers is in
plots (Figures 6, 9, 11, 13 and 15); what its text says of them is in ``FINDINGS``.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

LEAST_SPEEDUP = 20.0  # required with 400 particles


@dataclass(frozen=True)
class PaperRow:
    """
    A row of a table of the paper.

    :param value: value of the varied quantity.
    :param speed_mph: average speed.
    :param max_error_mph: maximum error.
    :param ms: average time per pair of frames, ms; None where the table has none.
    """

    value: float
    speed_mph: float
    max_error_mph: float
    ms: Optional[float] = None


@dataclass(frozen=True, kw_only=True)
class PaperTable:
    """
    A table of the paper.

    :param name: number of the table.
    :param sequence: our sequence that replaces the paper's.
    :param varies: heading of the varied quantity.
    :param particles: fixed number of particles; None where it is varied.
    :param parts: fixed number of parts N_p; None where it is varied.
    :param step_mps: fixed dynamic noise, m/s per frame at 5 frames/s; None where it is varied.
    :param rows: rows in the paper's order.
    """

    name: str
    sequence: str
    varies: str
    rows: tuple[PaperRow, ...]
    particles: Optional[int] = None
    parts: Optional[int] = None
    step_mps: Optional[float] = None


TABLE_1A = PaperTable(
    name='Table I(a)', sequence='straight55', varies='particles N',
    parts=10, step_mps=0.05, rows=(
        PaperRow(100, 54.50, 0.82, 127.5), PaperRow(200, 54.93, 0.33, 213.1),
        PaperRow(400, 54.95, 0.28, 405.3), PaperRow(600, 55.01, 0.31, 575.2),
        PaperRow(800, 54.95, 0.25, 761.4)))
TABLE_1B = PaperTable(
    name='Table I(b)', sequence='straight55', varies='parts N_p',
    particles=200, step_mps=0.05, rows=(
        PaperRow(4, 54.01, 2.72), PaperRow(6, 54.24, 1.33), PaperRow(8, 54.71, 0.65),
        PaperRow(10, 54.93, 0.33), PaperRow(12, 54.95, 0.35), PaperRow(16, 55.05, 0.52)))
TABLE_2A = PaperTable(
    name='Table II(a)', sequence='curve28', varies='particles N',
    parts=10, step_mps=0.15, rows=(
        PaperRow(100, 27.03, 3.129, 142.5), PaperRow(200, 27.16, 1.892, 233.2),
        PaperRow(400, 27.86, 0.961, 415.7), PaperRow(600, 27.83, 0.665, 598.0),
        PaperRow(800, 27.87, 0.575, 790.7)))
TABLE_2B = PaperTable(
    name='Table II(b)', sequence='curve28', varies='noise, m/s per frame',
    particles=400, parts=10, rows=(
        PaperRow(0.05, 27.63, 0.601), PaperRow(0.10, 27.71, 0.731), PaperRow(0.15, 27.86, 0.961),
        PaperRow(0.20, 27.69, 1.409), PaperRow(0.25, 27.89, 1.513)))
TABLES = (TABLE_1A, TABLE_1B, TABLE_2A, TABLE_2B)

COMPARED = ('straight55', 'straight36', 'circle36', 'curve28', 'two_vehicles',
            'lane_change35', 'lane_change30')

# (sequence, tracker) to the paper's finding in our words; no entry where the paper has no run.
FINDINGS: dict[tuple[str, str], str] = {
    ('straight55', 'constrained'): 'best of all; settles in a few frames (Fig. 6)',
    ('straight55', 'unconstrained'): 'settles too low; drifts when near (Figs. 5, 6)',
    ('straight55', 'triangulation'): 'large noise (Fig. 6)',
    ('straight55', 'kalman'): 'smoother, but too high; depth too large (Fig. 6)',
    ('straight55', 'multimodal'): 'inaccurate, fluctuates (Fig. 6)',
    ('straight36', 'constrained'): 'settles in two steps, then small fluctuations (Fig. 11)',
    ('straight36', 'multimodal'): 'drops at frame 7 and never comes near (Fig. 11)',
    ('circle36', 'constrained'): 'right from the first step, slightly low (Fig. 9)',
    ('circle36', 'triangulation'): 'large fluctuations (Fig. 9)',
    ('circle36', 'kalman'): 'still not very accurate (Fig. 9)',
    ('curve28', 'constrained'): 'settles after one frame; 27.86, max 0.961 (Table II)',
    ('two_vehicles', 'constrained'): 'slightly above the reference (Fig. 15)',
    ('lane_change35', 'constrained'): 'followed, less accurate (Figs. 15, 16)',
    ('lane_change30', 'constrained'): 'followed, less accurate (Figs. 15, 16)',
}
