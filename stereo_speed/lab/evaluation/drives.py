# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sequences with truth, simulated or from bags, and what a tracker makes of them."""
from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
import tempfile
from typing import Any, Mapping, Optional, Sequence

import numpy as np
import yaml

from .associate import match
from ..sim.config import SimConfig
from ..sim.sequence import SimSequence, simulate
from ...core.config import TrackerConfig
from ...core.errors import InputError
from ...core.records import (
    InitialFront, PassResult, StereoPair, TrackState, TrackUpdate)
from ...geometry.rig import StereoRig
from ...io.bags import StereoBag
from ...io.truth import read_truth, truth_of_rows, VehicleTruth
from ...pipeline.assembly import make_pipeline
from ...pipeline.config import PipelineConfig
from ...pipeline.run import run as run_pipeline
from ...road.lanes import LanePath
from ...road.problem import RoadPrior
from ...site.file import load_site, Site
from ...site.init_file import load_init
from ...site.lane_paths import lane_paths
from ...site.refine.refiner import refine_site

SITES = ('picked', 'refined', 'exact')


@dataclass(frozen=True, eq=False)
class Drive:
    """
    A sequence with all a tracker needs, and its truth.

    :param name: of the sequence.
    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param marks: the fronts as marked; None has them found.
    :param pairs: the pairs.
    :param truths: one for each vehicle.
    :param tolerances: parameters of the tracker that the site file gives.
    """

    name: str
    rig: StereoRig
    lanes: Mapping[str, LanePath]
    marks: Optional[tuple[InitialFront, ...]]
    pairs: Sequence[StereoPair]
    truths: tuple[VehicleTruth, ...]
    tolerances: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class VehicleRun:
    """
    What a tracker said of one vehicle, beside the truth.

    :param vehicle: its number.
    :param stamps_ns: of the readings; none when no track was on it.
    :param speeds_mps: live readings.
    :param stds_mps: their 1-sigmas.
    :param confirmed: whether each was confirmed: only those are published.
    :param truth_mps: the truth beside them; None where it is not told.
    :param verdict: of its pass; empty when there was no track.
    :param reason: of a rejection.
    :param pass_mps: speed of the pass, when it was measured.
    :param pass_std_mps: its 1-sigma.
    :param pass_truth_mps: mean of the truth over the same pairs.
    :param pairs: pairs of the pass.
    :param seen_pairs: pairs in which the truth shows the vehicle.
    :param last_quarter_ns: stamp that the last quarter of them begins with.
    """

    vehicle: int
    stamps_ns: list[int] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    stds_mps: list[float] = field(default_factory=list)
    confirmed: list[bool] = field(default_factory=list)
    truth_mps: list[Optional[float]] = field(default_factory=list)
    verdict: str = ''
    reason: str = ''
    pass_mps: Optional[float] = None
    pass_std_mps: Optional[float] = None
    pass_truth_mps: Optional[float] = None
    pairs: int = 0
    seen_pairs: int = 0
    last_quarter_ns: int = 0

    @property
    def measured(self) -> bool:
        """Whether its pass was measured."""
        return self.verdict == 'measured' and self.pass_mps is not None


@dataclass(frozen=True, kw_only=True)
class DriveRun:
    """
    What a tracker made of a drive.

    :param vehicles: one for each true vehicle.
    :param stray_tracks: tracks on none of them.
    :param cpu_ms: processor time per pair, ms, of all tracks; without the final results.
    """

    vehicles: list[VehicleRun]
    stray_tracks: int
    cpu_ms: float

    def to_json(self) -> dict[str, Any]:
        """Turn it into JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> DriveRun:
        """Turn JSON values back."""
        return cls(**{**value, 'vehicles': [VehicleRun(**v) for v in value['vehicles']]})


def simulated_drive(config: SimConfig, seed: Sequence[int], site: str, *,
                    tolerances: Optional[TrackerConfig] = None) -> Drive:
    """
    Simulate a drive and reconstruct its lanes.

    :param config: what to simulate.
    :param seed: of the simulation.
    :param site: ``picked``, ``refined`` or ``exact``: how well the lanes' lines are known.
    :param tolerances: draw the errors of calibration and stamps that these parameters allow
        for; None leaves both exact.
    :raises InputError: another site, a scene that cannot be drawn.
    """
    if site not in SITES:
        raise InputError('evaluation', 'site', site, ', '.join(SITES))
    sequence = simulate(config, np.random.default_rng(list(seed)))
    if tolerances is not None:
        sequence = disturbed(sequence, tolerances, np.random.default_rng([*seed, 1]))
    with tempfile.TemporaryDirectory() as folder:
        content = sequence.site_exact if site == 'exact' else sequence.site
        read = load_site(_write(content, Path(folder) / 'site.yaml'))
        marks = load_init(_write(sequence.init, Path(folder) / 'init.yaml'))
    rig, lanes = (_refined(read, sequence) if site == 'refined'
                  else (sequence.rig, lane_paths(read, sequence.rig)))
    return Drive(config.name, rig, lanes, marks, sequence.pairs, truth_of_rows(sequence.truth))


def disturbed(sequence: SimSequence, tolerances: TrackerConfig,
              rng: np.random.Generator) -> SimSequence:
    """
    Disturb what a tracker is told of cameras and times, within the tolerances it allows for.

    Both focal lengths are off by one share, as of one calibration; the stamps of both views by
    one time, as of one trigger.

    :param tolerances: gives the 1-sigmas: ``focal_std``, ``baseline_std_m``, ``stamp_std_s``;
        the angles between the cameras are off by what a site allows a calibrated rig.
    """
    angles = np.radians(RoadPrior().calibrated_std_deg) * rng.standard_normal(3)
    rig = sequence.rig.drifted(angles)
    focal = 1 + tolerances.focal_std * rng.standard_normal()
    baseline = 1 + tolerances.baseline_std_m / rig.baseline_m * rng.standard_normal()
    cameras = [replace(camera, K=camera.K * [[focal, focal, 1], [focal, focal, 1], [1, 1, 1]])
               for camera in (rig.left, rig.right)]
    late_ns = {pair.stamp_ns: round(1e9 * tolerances.stamp_std_s * rng.standard_normal())
               for pair in sequence.pairs}
    return replace(
        sequence, rig=StereoRig(cameras[0], cameras[1], rig.R, rig.t * baseline),
        pairs=tuple(replace(p, stamp_ns=p.stamp_ns + late_ns[p.stamp_ns],
                            right_stamp_ns=p.right_stamp_ns + late_ns[p.stamp_ns])
                    for p in sequence.pairs),
        truth=tuple({**row, 'stamp_ns': row['stamp_ns'] + late_ns[row['stamp_ns']]}
                    for row in sequence.truth))


def _write(content: Mapping[str, Any], path: Path) -> Path:
    path.write_text(yaml.safe_dump(dict(content)), encoding='utf-8')
    return path


def _refined(site: Site, sequence: SimSequence) -> tuple[StereoRig, dict[str, LanePath]]:
    """Refine the picks by the pass's own images, as one would before measuring."""
    refined = refine_site(site, sequence.rig, sequence.pairs)
    return refined.rig, refined.lanes


def bag_drive(bag: Path, site: Path, init: Optional[Path], truth: Path, *,
              left: Optional[str] = None, right: Optional[str] = None) -> Drive:
    """
    Read a drive from a bag, with its site, marks and truth.

    :raises InputError: a file that cannot be used.
    """
    truths, read = read_truth(truth), load_site(site)
    marks = load_init(init) if init is not None else None
    with StereoBag(bag, left=left, right=right) as opened:
        rig = read.corrected_rig(opened.rig)
        return Drive(bag.name, rig, lane_paths(read, rig), marks, tuple(opened.pairs()), truths,
                     read.tolerances)


def track_drive(drive: Drive, tracker: str, config: TrackerConfig, seed: int) -> DriveRun:
    """
    Run a tracker over a drive, as ``replay`` would, and set what it says beside the truth.

    :param tracker: name of the tracker.
    :param config: its parameters.
    :param seed: of all its randomness.
    """
    chosen = PipelineConfig(replace(config, **drive.tolerances), tracker)
    pipeline = make_pipeline(drive.rig, drive.lanes, chosen, drive.marks, seed=seed)
    done = run_pipeline(pipeline, drive.pairs)
    return beside_truth(done.updates, {p.track: p for p in done.passes}, drive.truths,
                        1e3 * done.cpu_s / len(drive.pairs))


def beside_truth(updates: Sequence[TrackUpdate], passes: Mapping[int, PassResult],
                 truths: Sequence[VehicleTruth], cpu_ms: float) -> DriveRun:
    """Match tracks to vehicles and gather what was said of each."""
    tracks: dict[int, list[TrackUpdate]] = {}
    for update in updates:
        tracks.setdefault(update.track, []).append(update)
    matched = match(tracks, truths)
    runs = [_vehicle_run(truth, tracks[matched[truth.vehicle]], passes.get(
        matched[truth.vehicle])) if truth.vehicle in matched
        else VehicleRun(vehicle=truth.vehicle, seen_pairs=len(truth.stamps_ns),
                        last_quarter_ns=_last_quarter_ns(truth))
        for truth in truths]
    return DriveRun(vehicles=runs, stray_tracks=len(tracks) - len(matched),
                    cpu_ms=round(cpu_ms, 3))


def _last_quarter_ns(truth: VehicleTruth) -> int:
    """Give the stamp of the pair that the last quarter of a vehicle's pairs begins with."""
    return int(truth.stamps_ns[-max(len(truth.stamps_ns) // 4, 1)])


def _vehicle_run(truth: VehicleTruth, track: Sequence[TrackUpdate],
                 result: Optional[PassResult]) -> VehicleRun:
    """Set one track beside its vehicle."""
    stamps = [u.stamp_ns for u in track]
    run = VehicleRun(
        vehicle=truth.vehicle, stamps_ns=stamps, speeds_mps=[float(u.speed_mps) for u in track],
        stds_mps=[float(u.speed_std_mps) for u in track],
        confirmed=[u.state is TrackState.CONFIRMED for u in track],
        truth_mps=[None if np.isnan(v) else float(v) for v in truth.speed_at(stamps)],
        seen_pairs=len(truth.stamps_ns), last_quarter_ns=_last_quarter_ns(truth))
    if result is None:
        return run
    during = sorted(result.smoothed) or [ns for ns in stamps
                                         if result.first_ns <= ns <= result.last_ns]
    told = truth.speed_at(during)
    return replace(
        run, verdict=result.verdict.value, reason=result.reason, pass_mps=result.speed_mps,
        pass_std_mps=result.speed_std_mps, pairs=result.pairs,
        pass_truth_mps=float(np.nanmean(told)) if np.isfinite(told).any() else None)
