# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The draft that all pages of a server share, with its history, figures and files.

A page may be closed, reloaded or disconnected at any time: its work is kept here. Each step has an
identity, so that one that is sent twice is applied once.
"""
from __future__ import annotations

from collections import OrderedDict
from dataclasses import asdict, replace
import hashlib
from pathlib import Path
from typing import Any, Mapping, Optional

import yaml

from .draft import Draft, draft_of, fronts_of, init_data, site_data, with_refined
from .edits import apply, fields_of, no_snap, Snapper, WHERE
from .figures import Figures, judge, neighbours
from .scene import Scene
from .truth_marks import truth_csv
from ..core.errors import InputError
from ..io.atomic import write_whole
from ..pipeline.assembly import refined_site
from ..pipeline.config import PipelineConfig
from ..site.file import load_site, Site, site_of
from ..site.init_file import load_init
from ..site.lane_paths import lane_paths
from ..site.refine.refiner import RefinedSite
from ..site.write import site_text

MOST_HISTORY = 1000  # number of steps that can be undone
MOST_KNOWN = 5000  # number of steps whose identity is remembered
UNDO, REDO, LANES = 'undo', 'redo', 'lanes_between'


class Workspace:
    """
    One draft.

    :param scene: the bag it is drawn on; None without one.
    :param site_path: the site file, opened if it exists, and saved to.
    :param init_path: the init file likewise.
    :param settings: parameters for measuring, roads and their refinement.
    :raises InputError: an existing file is unusable.
    """

    def __init__(self, scene: Optional[Scene], site_path: Path, init_path: Path,
                 settings: PipelineConfig = PipelineConfig()) -> None:
        self.scene, self.settings, self.config = scene, settings, settings.site
        self.site_path, self.init_path = site_path, init_path
        self.truth_path = init_path.with_name(f'{init_path.stem.removesuffix("_init")}_truth.csv')
        self.version = 0
        self.refined: Optional[RefinedSite] = None
        self._past: list[Draft] = []
        self._future: list[Draft] = []
        self._known: OrderedDict[str, None] = OrderedDict()
        self.draft = Draft(name=site_path.stem)
        if site_path.exists():
            self.draft = draft_of(load_site(site_path))
        if init_path.exists():
            fronts = fronts_of(load_init(init_path), self.draft.next_id)
            self.draft = replace(self.draft, fronts=fronts,
                                 next_id=self.draft.next_id + len(fronts))
        self._saved = {kind: self._content(kind) for kind in ('site', 'init', 'truth')}
        self._on_disk = {path: _digest(path) for path in (site_path, init_path, self.truth_path)}
        self.figures = self.judged(self.draft, None)

    # -- state ----------------------------------------------------------------------------------

    @property
    def unsaved(self) -> bool:
        """Return whether the site has unsaved changes."""
        return self._content('site') != self._saved['site']

    def state(self) -> dict[str, Any]:
        """Return the data that a page needs to draw the draft."""
        return {'version': self.version, 'draft': asdict(self.draft),
                'undo': len(self._past), 'redo': len(self._future),
                'unsaved': self.unsaved,
                **{f'unsaved_{kind}': self._content(kind) != self._saved[kind]
                   for kind in ('init', 'truth')},
                'site_file': self.site_path.name, 'init_file': self.init_path.name,
                'truth_file': self.truth_path.name}

    def judged(self, draft: Draft, refined: Optional[RefinedSite]) -> Figures:
        """Assess a draft; slow, may run in any thread."""
        return judge(draft, None if self.scene is None else self.scene.rig, self.config, refined)

    # -- steps ----------------------------------------------------------------------------------

    def take(self, message: Mapping[str, Any]) -> bool:
        """
        Apply one step.

        :param message: the step as sent by a page.
        :return: whether it was new.
        :raises InputError: the step is not possible; the draft is then unchanged.
        """
        identity, name, fields = fields_of(message)
        if identity in self._known:
            return False
        if name == UNDO:
            self._move(self._past, self._future)
        elif name == REDO:
            self._move(self._future, self._past)
        elif name == LANES:
            self._become(self._with_lanes())
        else:
            self._become(apply(self.draft, name, fields, self._snapper))
        self._known[identity] = None
        while len(self._known) > MOST_KNOWN:
            self._known.popitem(last=False)
        return True

    @property
    def _snapper(self) -> Snapper:
        return no_snap if self.scene is None else self.scene.snapped

    def _become(self, draft: Draft) -> None:
        """Make a draft the current one, and add the previous one to the history."""
        if draft == self.draft:
            return
        self._past.append(self.draft)
        del self._past[:-MOST_HISTORY]
        self._future.clear()
        self._show(draft)

    def _move(self, source: list[Draft], target: list[Draft]) -> None:
        if source:
            target.append(self.draft)
            self._show(source.pop())

    def _show(self, draft: Draft) -> None:
        self.draft = draft
        self.version += 1
        self.refined = None

    def _with_lanes(self) -> Draft:
        """Return the draft with a lane between all neighbouring lines a lane's width apart."""
        figures = self.judged(self.draft, None)
        pairs = neighbours(figures, self.draft)
        if not pairs:
            raise InputError(WHERE, 'lines', 'no two a lane apart that are no lane yet',
                             'lines fitted in both views')
        draft = self.draft
        for right, left in pairs:
            draft = apply(draft, 'add_lane', {'right': right, 'left': left}, no_snap)
        return draft

    def refine(self, draft: Draft) -> RefinedSite:
        """
        Find the lines of a draft in the images; takes seconds, may run in any thread.

        :raises InputError: the draft does not define a road yet.
        """
        if self.scene is None:
            raise InputError(WHERE, 'bag', 'none', 'a bag, for its images')
        return refined_site(self.site(draft), self.scene.rig, self.scene.spread,
                            self.config)[0]

    def accept(self, draft: Draft, refined: RefinedSite) -> None:
        """
        Apply the result of a refinement to the draft.

        :raises InputError: the draft has changed in the meantime.
        """
        if draft is not self.draft:
            raise InputError(WHERE, 'site', 'changes made while it was refined',
                             'the site as it was; refine again')
        self._become(with_refined(draft, refined.site))
        self.refined = refined

    # -- files ----------------------------------------------------------------------------------

    def site(self, draft: Draft) -> Site:
        """
        Return the whole draft as a site.

        :raises InputError: a part is incomplete, or not allowed in a site file.
        """
        for line in draft.lines:
            if not line.complete:
                raise InputError(WHERE, f'lines.{line.name}',
                                 f'{len(line.left)} left and {len(line.right)} right points',
                                 'two or more in each view')
        for lane in draft.lanes:
            if not lane.complete:
                raise InputError(WHERE, f'lanes.{lane.name}', 'a line missing',
                                 'a line on the right and one on the left')
        for known in draft.lengths:
            if not known.complete:
                raise InputError(WHERE, f'known_lengths.{known.name}', 'not all that it is of',
                                 'its lines or points')
        return replace(site_of(self.site_path, site_data(draft)),
                       correction=draft.rig_correction)

    def save(self, overwrite: bool = False) -> Path:
        """
        Write the site file, completely or not at all.

        :param overwrite: whether to write even if the file has changed since it was opened.
        :raises InputError: the draft is no site yet, or the file was changed by others.
        """
        site = self.site(self.draft)
        if self.scene is not None:
            lane_paths(site, site.corrected_rig(self.scene.rig), self.config.road)
        return self._write('site', self.site_path, site_text(site), overwrite)

    def save_init(self, overwrite: bool = False) -> Path:
        """Write the annotated fronts likewise; :raises InputError: none, or an incomplete one."""
        data = init_data(self.draft)
        first = [front for front in self.draft.fronts if front.of is None]
        if not first or len(data['vehicles']) < len(first):
            raise InputError(WHERE, 'vehicles', 'corners missing' if self.draft.fronts else 'none',
                             'four corners of each front in both views')
        text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=99)
        return self._write('init', self.init_path, text, overwrite)

    def save_truth(self, overwrite: bool = False) -> Path:
        """Write the truth of vehicles marked in several pairs; :raises InputError: none is."""
        if self.scene is None:
            raise InputError(WHERE, 'bag', 'none', 'a bag, for its cameras and stamps')
        return self._write('truth', self.truth_path, truth_csv(
            self.draft, self.draft.rig_now(self.scene.rig), self.scene.stamp_of), overwrite)

    def _write(self, kind: str, path: Path, text: str, overwrite: bool) -> Path:
        if not overwrite and _digest(path) != self._on_disk[path]:
            raise InputError(path.name, 'file', 'changes that were made outside this page',
                             'the file as it was opened; save again to replace it')
        write_whole(path.parent, {path.name: text})
        self._on_disk[path] = _digest(path)
        self._saved[kind] = self._content(kind)
        return path

    def _content(self, kind: str) -> str:
        """Return the part of the draft that a file stores, finished or not."""
        if kind == 'init':
            return repr([front for front in self.draft.fronts if front.of is None])
        if kind == 'truth':
            later = {front.of for front in self.draft.fronts} - {None}
            return repr([front for front in self.draft.fronts
                         if front.of is not None or front.number in later])
        return repr(replace(self.draft, fronts=(), next_id=0))


def _digest(path: Path) -> Optional[str]:
    """Return the SHA-256 of a file; None where it does not exist."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
