# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Evidence of violations that ``replay`` writes beside its results."""
from __future__ import annotations

import argparse
from collections import deque
from contextlib import AbstractContextManager, ExitStack
import dataclasses
from pathlib import Path
from typing import Any, NamedTuple, Optional, Sequence

from ..core.errors import InputError
from ..core.passes import PassResult
from ..core.records import StereoPair
from ..enforcement.chain import load_private_key
from ..enforcement.config import EnforcementConfig, load_enforcement_config
from ..enforcement.fingerprint import Approved, canonical, load_approved, sha256
from ..enforcement.instrument import Instrument
from ..enforcement.record import Setting
from ..enforcement.recorder import EvidenceRecorder
from ..enforcement.ring import ImageRing
from ..enforcement.store import EvidenceStore
from ..io.bags import StereoBag
from ..io.pass_json import track_id
from ..io.results import file_sha256
from ..io.source_image import SourceImage
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import PipelineConfig
from ..pipeline.pipeline import Step

FOLDER = 'evidence'
_OPTIONS = ('evidence_key', 'evidence_head', 'approved')
_RUN_DIGITS = 16


def add_evidence_options(parser: argparse.ArgumentParser) -> None:
    """Add the evidence options to the command."""
    parser.add_argument('--evidence', action='store_true',
                        help='write a record of each violation to DIR/evidence')
    parser.add_argument('--evidence-key', type=Path, metavar='PEM',
                        help='private key that signs records (made by evidence key)')
    parser.add_argument('--evidence-head', type=Path, metavar='FILE',
                        help='file for the head of the chain of records (default: '
                             'DIR/evidence/head.json)')
    parser.add_argument('--approved', type=Path, metavar='YAML',
                        help='file of approved fingerprints')


def check_options(args: argparse.Namespace) -> None:
    """Refuse evidence options without ``--evidence``."""
    for name in _OPTIONS:
        if getattr(args, name) is not None and not args.evidence:
            raise InputError('replay', f'--{name.replace("_", "-")}', getattr(args, name),
                             '--evidence as well')


class _Taken(NamedTuple):
    """A pair, with its images as received."""

    pair: StereoPair
    left: SourceImage
    right: SourceImage


class ReplayEvidence(AbstractContextManager['ReplayEvidence']):
    """
    Follows a replay and records its violations; does nothing without ``--evidence``.

    The bag is read some pairs ahead of processing.  Images read ahead wait in a queue, because in
    the ring they would displace images of passes that are still to be recorded.

    :param recorder: decides and writes; None without ``--evidence``.
    :param run: name of the run.
    :param config: parameters of enforcement.
    """

    def __init__(self, recorder: Optional[EvidenceRecorder], run: str,
                 config: EnforcementConfig) -> None:
        self.recorder, self.run, self.config = recorder, run, config
        self._offered: set[int] = set()
        self._taken: deque[_Taken] = deque()  # read, but not processed yet
        self._last_ns = 0
        self._stack = ExitStack()

    @classmethod
    def of(cls, args: argparse.Namespace, bag: StereoBag, place: MeasuringSite,
           config: PipelineConfig) -> ReplayEvidence:
        """
        Return the evidence recorder of this replay.

        :param args: the options.
        :param bag: the bag, which passes on its images as received.
        :param place: the site as used for measuring.
        :param config: parameters of the pipeline.
        :raises InputError: a key, file or folder is unusable.
        """
        enforcement = load_enforcement_config(args.config)
        if not args.evidence:
            return cls(None, '', enforcement)
        key = None if args.evidence_key is None else load_private_key(args.evidence_key)
        approved = Approved() if args.approved is None else load_approved(args.approved)
        source = {
            'bag': args.bag.resolve().name, 'bag_sha256': bag.input_hash(), 'seed': args.seed,
            'init_sha256': None if args.init is None else file_sha256(args.init),
            'boxes_sha256': None if args.boxes is None else file_sha256(args.boxes)}
        run = _run(Instrument.of('', place, config), source, enforcement, approved)
        setting = Setting(Instrument.of(run, place, config), place, enforcement, approved,
                          'header stamps of the recording', source)
        store = EvidenceStore(args.out / FOLDER, args.evidence_head, key,
                              enforcement.evidence.least_free_mib)
        ring = ImageRing.of(enforcement.evidence)
        out = cls(EvidenceRecorder(store, setting, ring), run, enforcement)
        out._stack.callback(store.close)
        bag.watcher = out.take
        return out

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def take(self, pair: StereoPair, left: SourceImage, right: SourceImage) -> None:
        """Queue the images of a pair as received; called in the reading thread."""
        if self.recorder is not None:
            self._taken.append(_Taken(pair, left, right))

    def observe(self, pair: StereoPair, step: Step) -> None:
        """Decide on the passes that ended with a pair."""
        self._last_ns = pair.stamp_ns
        self._lay_down(pair.index)
        self._offer(step.passes)

    def finish(self, passes: Sequence[PassResult]) -> None:
        """Decide on the passes that ended with the recording, and delete expired records."""
        self._offer([p for p in passes if p.track not in self._offered])
        if self.recorder is not None:
            self.recorder.delete_older(self._last_ns)

    def _lay_down(self, index: int) -> None:
        """Move the queued images of the pairs up to an index into the ring."""
        while self.recorder is not None and self._taken and self._taken[0].pair.index <= index:
            pair, left, right = self._taken.popleft()
            self.recorder.ring.add('left', pair.stamp_ns, left)
            self.recorder.ring.add('right', pair.right_stamp_ns, right)

    def _offer(self, passes: Sequence[PassResult]) -> None:
        for result in passes:
            self._offered.add(result.track)
            if self.recorder is not None:
                self.recorder.offer(track_id(self.run, result.track), result)

    def summary(self) -> dict[str, Any]:
        """Return the enforcement section of ``summary.json``."""
        if self.recorder is None:
            return {}
        return {'enforcement': {
            'run': self.run, 'parameters': dataclasses.asdict(self.config),
            'fingerprints': self.recorder.setting.instrument.fingerprints,
            **self.recorder.summary()}}

    def lines(self) -> list[str]:
        """Return the lines to print."""
        if self.recorder is None:
            return []
        none = ', '.join(f'{reason} {count}' for reason, count in sorted(
            self.recorder.refused.items()))
        return [f'{len(self.recorder.records)} records of violations in '
                f'{self.recorder.store.folder}' + (f'; no record of: {none}' if none else ''),
                *(f'  {self.recorder.store.folder / name / "page.html"}'
                  for name in self.recorder.records)]


def _run(instrument: Instrument, source: dict[str, Any], config: EnforcementConfig,
         approved: Approved) -> str:
    """
    Return a name for the replay that follows from its inputs, so that repeats make equal records.

    :param instrument: the measuring instrument.
    :param source: bag, seed and input files.
    :param config: parameters of enforcement.
    :param approved: approved fingerprints.
    """
    decided = [instrument.fingerprints, source, dataclasses.asdict(config),
               {kind: sorted(values) for kind, values in approved.of.items()}]
    return f'replay-{sha256(canonical(decided))[:_RUN_DIGITS]}'
