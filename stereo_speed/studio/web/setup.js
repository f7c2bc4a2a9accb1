// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// The set-up page: lines drawn on both raw views, lanes, known lengths, annotated fronts.

import {above} from './above.js';
import {choice, digits, el, field, renew, toast} from './dom.js';
import {RawView} from './view.js';

export const COLOURS = ['#fbbf24', '#38bdf8', '#34d399', '#f472b6', '#a78bfa', '#fb923c', '#a3e635', '#f87171'];
const VIEWS = ['left', 'right'];
const MPH = 0.44704;
const MANY = 25; // number of points of a line above which they are drawn small
const ASK_MS = 60; // interval between requests for an epipolar band

export class Setup {
  constructor(link) {
    this.link = link;
    this.tool = {kind: 'line', id: null};
    this.picked = null; // {line, view, index}
    this.snap = true;
    this.band = null;
    this.frame = null; // index of the pair that is shown; null for the background
    this.ghost = null;
    this.views = {};
    this.side = el('aside', {'aria-label': 'Site'});
    this.aboveBox = el('div', {class: 'panel', id: 'above'});
    this.worth = el('div', {class: 'panel', id: 'worth'});
    this.stage = el('div', {class: 'views'});
    this.root = el('div', {class: 'setup'},
      el('div', {class: 'stage'}, this.stage, el('div', {class: 'below'}, this.aboveBox, this.worth)), this.side);
  }

  // -- messages of the server ------------------------------------------------------------------

  setScene(scene) {
    if (!scene || this.scene) return;
    this.scene = scene;
    for (const view of VIEWS) {
      this.views[view] = new RawView(view, scene.sizes[view], `/api/background/${view}`, {
        draw: (v, c) => this.draw(v, c), press: (v, uv) => this.press(v, uv),
        drag: (v, held, uv) => this.drag(v, held, uv), drop: (v, held, uv) => this.drop(v, held, uv),
        hover: (v, uv) => this.hover(v, uv), key: (v, event) => this.key(v, event)});
      this.stage.append(this.views[view].root);
    }
  }

  setWorkspace(workspace) {
    const before = this.draft;
    this.workspace = workspace;
    this.draft = workspace.draft;
    this.ghost = null;
    const there = (kind, things) => this.tool.kind === kind && things.some((t) => t.number === this.tool.id);
    const {lines, lengths, fronts} = this.draft;
    if (!there('line', lines) && !there('length', lengths) && !there('front', fronts)) {
      this.tool = {kind: 'line', id: lines.length ? lines[lines.length - 1].number : null};
    }
    if (before && lines.length > before.lines.length && this.wantsNew) {
      this.tool = {kind: 'line', id: lines[lines.length - 1].number};
      this.wantsNew = false;
    }
    if (before && fronts.length > before.fronts.length) this.tool = {kind: 'front', id: fronts[fronts.length - 1].number};
    if (before && lengths.length > before.lengths.length && lengths[lengths.length - 1].kind === 'points') {
      this.tool = {kind: 'length', id: lengths[lengths.length - 1].number};
    }
    if (this.picked) {
      const line = this.line(this.picked.line);
      if (!line || this.picked.index >= line[this.picked.view].length) this.picked = null;
    }
    this.show();
  }

  setFigures(figures) {
    this.figures = figures;
    this.show();
  }

  setBusy(busy) {
    this.busy = busy;
    if (this.draft) this.show();
  }

  line(id) { return this.draft.lines.find((line) => line.number === id); }

  colour(id) {
    const at = this.draft.lines.findIndex((line) => line.number === id);
    return COLOURS[Math.max(at, 0) % COLOURS.length];
  }

  // -- the side --------------------------------------------------------------------------------

  show() {
    if (!this.draft) return;
    renew(this.side, this.notesSection(), this.siteSection(), this.linesSection(), this.lanesSection(), this.lengthsSection(),
      this.frontsSection());
    renew(this.aboveBox, above(this.figures && this.figures.top, this.draft, (id) => this.colour(id),
      [this.aboveBox.clientWidth - 22, this.aboveBox.clientHeight - 46]));
    renew(this.worth, this.worthOf());
    this.paint();
  }

  paint() { Object.values(this.views).forEach((view) => view.paint()); }

  notesSection() {
    const notes = (this.figures && this.figures.notes) || [];
    const rank = {error: 0, warning: 1, todo: 2};
    const sorted = [...notes].sort((a, b) => rank[a.level] - rank[b.level]);
    return el('section', {id: 'notes', 'aria-label': 'What to look at'},
      el('div', {class: 'row'}, el('h2', {}, 'To look at'), this.busy && el('span', {class: 'fine'}, `${this.busy} …`)),
      sorted.length ? sorted.slice(0, 6).map((note, i) => el('button', {class: `note ${note.level}`,
        'data-key': `note${i}`, onclick: () => this.goTo(note)}, note.text))
        : el('div', {class: 'note good'}, this.figures && this.figures.ready
          ? 'All lines fit one road. Ready to be saved.' : 'Nothing.'),
      sorted.length > 6 && el('span', {class: 'fine'}, `and ${sorted.length - 6} more`));
  }

  siteSection() {
    const {name, calibrated, tolerances} = this.draft;
    const given = Object.entries(tolerances).map(([key, value]) => `${key} ${value}`).join(', ');
    return el('section', {'aria-label': 'Site'},
      el('div', {class: 'row'}, el('h2', {}, 'Site'),
        field({'data-key': 'site-name', 'aria-label': 'Name of the site'}, name, (text) => this.link.step('rename_site', {name: text})),
        el('span', {class: 'fine'}, 'calibrated'), field({'data-key': 'calibrated', 'aria-label': 'Day of the calibration',
          title: 'Date of the calibration of the rig, which expires', placeholder: 'YYYY-MM-DD', class: 'day'}, calibrated || '',
        (day) => this.link.step('set_calibrated', {day}))),
      given && el('div', {class: 'fine num'}, `as the file says: ${given}`));
  }

  goTo(note) {
    if (note.line === null) {
      if (note.lane !== null) document.querySelector(`[data-lane="${note.lane}"] input`)?.focus();
      return;
    }
    this.pickTool('line', note.line);
    const view = this.views[note.view || 'left'];
    const points = this.line(note.line)?.[note.view || 'left'] || [];
    if (note.index !== null && points[note.index] && view) {
      this.pickPoint(view, note.index);
      view.scale = Math.max(view.scale, 4);
      view.show(view.cursor);
    }
    view?.canvas.focus();
    this.show();
  }

  pickTool(kind, id) {
    this.tool = {kind, id};
    if (!this.picked || this.picked.line !== id) { this.picked = null; this.band = null; }
    this.show();
  }

  linesSection() {
    const rows = this.draft.lines.map((line) => {
      const on = this.tool.kind === 'line' && this.tool.id === line.number;
      const fit = this.figures?.lines[line.number];
      const rms = fit && VIEWS.map((v) => digits(fit.views[v].rms_px)).join(' / ');
      return el('div', {class: `item ${on ? 'on' : ''}`, style: {'--mark': this.colour(line.number)}, 'data-line': line.number,
        onclick: (event) => { if (!on && event.target.tagName !== 'BUTTON') this.pickTool('line', line.number); }},
      el('div', {class: 'row'},
        field({class: 'name grow', 'aria-label': 'Name of the line', 'data-key': `line${line.number}`}, line.name,
          (name) => this.link.step('rename_line', {line: line.number, name})),
        el('button', {class: 'quiet', title: 'Draw this line', 'aria-pressed': on, 'data-key': `draw${line.number}`,
          onclick: () => this.pickTool('line', line.number)}, on ? 'drawing' : 'draw'),
        el('button', {class: 'quiet', title: 'Delete this line', 'aria-label': `Delete ${line.name}`,
          'data-key': `drop${line.number}`, onclick: () => this.link.step('delete_line', {line: line.number})}, '✕')),
      el('div', {class: 'row fine num'},
        line.points_m.length ? `surveyed, ${line.points_m.length} points`
          : `${line.left.length} + ${line.right.length} points`,
        rms && ` · ${rms} px off`,
        on && !line.points_m.length && el('button', {class: 'quiet end', title: 'Reverse the order of its points',
          'data-key': `turn${line.number}`, onclick: () => this.link.step('turn_line', {line: line.number})}, 'reverse'),
        on && !line.points_m.length && el('button', {class: 'quiet', title: 'Move all points onto the marking',
          'data-key': `snap${line.number}`, onclick: () => this.link.step('snap_line', {line: line.number})}, 'snap all')));
    });
    return el('section', {'aria-label': 'Lines'},
      el('div', {class: 'row'}, el('h2', {}, 'Lines'),
        el('button', {id: 'add-line', 'data-key': 'add-line', title: 'New line (N)', onclick: () => this.newLine()},
          '+ line')), rows);
  }

  newLine() {
    this.wantsNew = true;
    this.link.step('add_line');
  }

  lanesSection() {
    const lines = [['', '–'], ...this.draft.lines.map((line) => [String(line.number), line.name])];
    const number = (text) => (text === '' ? null : Number(text));
    const rows = this.draft.lanes.map((lane) => {
      const set = (fields) => this.link.step('set_lane', {lane: lane.number, ...fields});
      const along = el('label', {}, lane.path === null ? 'or along' : 'along', choice({'data-key': `path${lane.number}`}, lines,
        lane.path, (v) => set({path: number(v)})));
      const sides = lane.path !== null ? [along]
        : [lane.right === null && lane.left === null && along, el('label', {}, 'left of driver', choice({'data-key': `left${lane.number}`}, lines, lane.left,
          (v) => set({left: number(v)}))),
        el('label', {}, 'right of driver', choice({'data-key': `right${lane.number}`}, lines, lane.right,
          (v) => set({right: number(v)})))];
      return el('div', {class: 'item', 'data-lane': lane.number},
        el('div', {class: 'row'},
          field({class: 'name grow', 'aria-label': 'Name of the lane', 'data-key': `lane${lane.number}`}, lane.name,
            (name) => set({name})),
          el('button', {class: 'quiet', 'data-key': `way${lane.number}`, 'aria-label': `Direction of ${lane.name}`,
            title: 'Reverse the direction of travel; swaps right and left',
            onclick: () => set({backward: !lane.backward, right: lane.left, left: lane.right})},
          lane.backward ? '↑ against clicks' : '↓ as clicked'),
          el('button', {class: 'quiet', 'aria-label': `Delete ${lane.name}`, 'data-key': `droplane${lane.number}`,
            onclick: () => this.link.step('delete_lane', {lane: lane.number})}, '✕')),
        el('div', {class: 'row'}, sides,
          el('label', {}, 'limit', field({'data-key': `limit${lane.number}`, 'aria-label': `Limit of ${lane.name}`},
            lane.speed_limit, (text) => set({speed_limit: text})))));
    });
    return el('section', {'aria-label': 'Lanes'},
      el('div', {class: 'row'}, el('h2', {}, 'Lanes'),
        el('button', {id: 'lanes-between', 'data-key': 'lanes-between', title: 'A lane between all neighbouring lines (L)',
          onclick: () => this.link.step('lanes_between')}, '+ between lines'),
        el('button', {id: 'add-lane', 'data-key': 'add-lane', onclick: () => this.link.step('add_lane')}, '+ lane')),
      rows);
  }

  lengthsSection() {
    const lines = [['', '–'], ...this.draft.lines.map((line) => [String(line.number), line.name])];
    const rows = this.draft.lengths.map((known) => {
      const set = (fields) => this.link.step('set_length', {length: known.number, ...fields});
      const on = this.tool.kind === 'length' && this.tool.id === known.number;
      const chosen = (at, value) => {
        const next = [known.lines[0], known.lines[1]];
        next[at] = value === '' ? undefined : Number(value);
        const all = next.filter((n) => n !== undefined);
        if (all.length) set({lines: all});
      };
      const of = known.kind === 'points'
        ? el('button', {class: 'quiet', 'aria-pressed': on, 'data-key': `pts${known.number}`,
          onclick: () => this.pickTool('length', known.number)}, `${known.left.length} + ${known.right.length} of 2 points`)
        : (known.kind === 'between' ? [0, 1] : [0]).map((at) => choice({'data-key': `of${known.number}${at}`,
          'aria-label': 'line'}, lines, known.lines[at], (v) => chosen(at, v)));
      const checked = this.figures?.lengths.find((l) => l.name === known.name);
      return el('div', {class: `item ${on ? 'on' : ''}`},
        el('div', {class: 'row'}, field({class: 'name grow', 'data-key': `known${known.number}`,
          'aria-label': 'Name of the length'}, known.name, (name) => set({name})),
        el('button', {class: 'quiet', 'aria-label': `Delete ${known.name}`, 'data-key': `dropknown${known.number}`,
          onclick: () => this.link.step('delete_length', {length: known.number})}, '✕')),
        el('div', {class: 'row'}, of),
        el('div', {class: 'row fine'}, field({'data-key': `m${known.number}`, 'aria-label': 'length in m'}, known.length_m,
          (v) => set({length_m: Number(v)})), el('span', {class: 'unit'}, 'm ±'),
        field({'data-key': `s${known.number}`, 'aria-label': '1-sigma in m'}, known.std_m,
          (v) => set({std_m: Number(v)})), 'm'),
        checked && el('span', {class: `fine num ${checked.wrong ? 'bad' : ''}`},
          `found ${digits(checked.measured_m, 3)} ± ${digits(checked.measured_std_m, 3)} m`));
    });
    return el('section', {'aria-label': 'Known lengths'},
      el('div', {class: 'row'}, el('h2', {}, 'Known lengths'),
        choice({'data-key': 'add-length', 'aria-label': 'New known length', id: 'add-length'}, [['', '+ length …'],
          ['between', 'between two lines'], ['dashes', 'a dash and its gap'], ['points', 'between two points']], '',
        (kind) => kind && this.link.step('add_length', {kind}))), rows);
  }

  frontsSection() {
    const last = this.scene.pairs - 1;
    const marked = this.draft.fronts.find((front) => this.tool.kind === 'front' && front.number === this.tool.id);
    const again = marked && this.frame !== null && marked.frame !== this.frame ? marked.of ?? marked.number : null;
    const first = (front) => front.of ?? front.number;
    const sorted = [...this.draft.fronts].sort((a, b) => first(a) - first(b) || a.number - b.number);
    const rows = sorted.map((front) => {
      const on = this.tool.kind === 'front' && this.tool.id === front.number;
      return el('div', {class: `item ${on ? 'on' : ''}`, 'data-front': front.number},
        el('div', {class: 'row'}, el('span', {class: 'grow'}, front.of === null ? `pair ${front.frame}`
          : `↳ pair ${front.frame}`),
          el('span', {class: 'fine num'}, `${front.left.length} + ${front.right.length} of 4 corners`),
          el('button', {class: 'quiet', 'aria-pressed': on, 'data-key': `front${front.number}`,
            onclick: () => { this.look(front.frame); this.pickTool('front', front.number); }}, on ? 'marking' : 'mark'),
          el('button', {class: 'quiet', 'aria-label': 'Delete this vehicle', 'data-key': `dropfront${front.number}`,
            onclick: () => this.link.step('delete_front', {front: front.number})}, '✕')));
    });
    return el('section', {'aria-label': 'Vehicles'},
      el('h2', {}, `Vehicles in ${last + 1} pairs`),
      el('div', {class: 'row wrap'},
        this.workspace.unsaved_init && el('button', {id: 'save-init', 'data-key': 'save-init',
          onclick: () => this.save('init')}, `Save ${this.workspace.init_file}`),
        this.workspace.unsaved_truth && el('button', {id: 'save-truth', 'data-key': 'save-truth',
          title: 'Positions and speeds of the vehicles marked in several pairs, for evaluation',
          onclick: () => this.save('truth')}, `Save ${this.workspace.truth_file}`)),
      el('div', {class: 'row fine'},
        el('button', {'data-key': 'background', 'aria-pressed': this.frame === null, onclick: () => this.look(null)},
          'background'),
        el('button', {'data-key': 'earlier', 'aria-label': 'Pair before', disabled: this.frame === 0,
          onclick: () => this.look(Math.max((this.frame ?? 1) - 1, 0))}, '◂'),
        field({'data-key': 'frame', 'aria-label': 'Pair', class: 'short'}, this.frame ?? '', (text) => {
          const index = Number(text);
          if (Number.isInteger(index) && index >= 0 && index <= last) this.look(index);
        }),
        el('button', {'data-key': 'later', 'aria-label': 'Next pair', disabled: this.frame === last,
          onclick: () => this.look(Math.min((this.frame ?? -1) + 1, last))}, '▸'),
        el('button', {class: 'end', 'data-key': 'add-front', id: 'add-front', disabled: this.frame === null,
          title: 'Mark the front of a vehicle in this pair',
          onclick: () => this.link.step('add_front', {frame: this.frame})}, '+ vehicle')),
      again !== null && el('button', {id: 'add-mark', 'data-key': 'add-mark',
        title: 'Mark the same vehicle in this pair as well: marks in several pairs give its truth',
        onclick: () => this.link.step('add_front', {frame: this.frame, of: again})}, '+ mark of the same vehicle'),
      rows);
  }

  look(frame) {
    this.frame = frame;
    for (const view of VIEWS) {
      this.views[view].load(frame === null ? `/api/background/${view}` : `/api/frame/${frame}/${view}`);
    }
    if (frame === null && this.tool.kind === 'front') this.tool = {kind: 'line', id: this.draft.lines.at(-1)?.number ?? null};
    this.show();
  }

  worthOf() {
    const {lanes = {}, rig = {}} = this.figures || {};
    const rows = this.draft.lanes.filter((lane) => lanes[lane.number]).map((lane) => {
      const f = lanes[lane.number];
      return el('tr', {}, el('td', {}, lane.name), el('td', {class: 'num'}, digits(f.length_m, 1)),
        el('td', {class: 'num'}, f.width_m === null ? '–' : `${digits(f.width_m, 3)} ± ${digits(f.width_std_m, 3)}`),
        el('td', {class: 'num'}, digits(f.residual_px)),
        el('td', {class: 'num', title: `${digits(100 * f.speed_std, 3)} % of the speed`},
          `± ${digits(f.speed_std_mph, 3)}`));
    });
    const angles = (rig.angles || []).map((a) => `${a.name} ${digits(a.deg, 4)}° ± ${digits(a.std_deg, 4)}°`);
    return [el('h2', {}, 'Accuracy'),
      rows.length ? el('table', {id: 'lane-table'}, el('thead', {}, el('tr', {}, ['lane', 'length m', 'width m', 'off px',
        'mph at limit'].map((t, i) => el('th', {class: i ? 'num' : ''}, t)))), el('tbody', {}, rows))
        : el('p', {class: 'fine'}, 'Width, length and their share of the speed uncertainty appear here.'),
      el('p', {class: 'fine num'}, rig.looked_at
        ? `Right camera since its calibration: ${angles.join(', ')}.`
          + (rig.moved_probability !== undefined ? ` Moved with probability ${digits(rig.moved_probability, 3)}.` : '')
        : 'Right camera: assumed as calibrated, not checked. “Refine” checks it.'),
      rig.baseline_m && el('p', {class: 'fine num'}, `Baseline ${digits(rig.baseline_m, 3)} m, focal length `
        + `${digits(rig.focal_px, 0)} px.`)];
  }

  // -- hands -----------------------------------------------------------------------------------

  press(view, uv) {
    const {kind, id} = this.tool;
    if (kind === 'line') {
      const line = this.line(id);
      if (line) {
        const index = line[view.name].findIndex((p) => view.grabs([p.u, p.v], uv));
        if (index >= 0) {
          this.pickPoint(view, index);
          return {kind: 'move', index};
        }
      }
      const other = this.draft.lines.find((l) => l.number !== id
        && l[view.name].some((p) => view.grabs([p.u, p.v], uv)));
      if (other) {
        this.pickTool('line', other.number);
        this.pickPoint(view, other[view.name].findIndex((p) => view.grabs([p.u, p.v], uv)));
        return null;
      }
      if (!line) { toast('Add a line first: “+ line”, or N.'); return null; }
      if (line.points_m.length) { toast('This line was surveyed; it is not drawn.'); return null; }
    }
    this.ghost = {view: view.name, uv, kind};
    return {kind: 'new'};
  }

  drag(view, held, uv) {
    this.ghost = {view: view.name, uv, kind: this.tool.kind, index: held.index};
    this.ask(view, uv);
  }

  drop(view, held, uv) {
    if (!view.inside(uv)) { this.ghost = null; return; }
    if (held.kind === 'move') {
      const point = this.line(this.tool.id)[view.name][held.index];
      if (view.near([point.u, point.v], uv) < 2) { this.ghost = null; return; }
      this.link.step('move_point', {line: this.tool.id, view: view.name, index: held.index, at: uv, snap: this.snap});
    } else {
      this.set(view, uv);
    }
  }

  set(view, at) {
    const {kind, id} = this.tool;
    if (kind === 'line' && id !== null) {
      this.link.step('add_point', {line: id, view: view.name, at, snap: this.snap});
    } else if (kind === 'length') {
      this.link.step('length_point', {length: id, view: view.name, at});
    } else if (kind === 'front') {
      this.link.step('front_corner', {front: id, view: view.name, at});
    }
  }

  pickPoint(view, index) {
    const point = this.line(this.tool.id)?.[view.name][index];
    if (!point) return;
    this.picked = {line: this.tool.id, view: view.name, index};
    view.cursor = [point.u, point.v];
    view.show(view.cursor);
    this.ask(view, view.cursor);
    this.paint();
  }

  hover(view, uv) {
    if (!uv) {
      if (this.picked) {
        const point = this.line(this.picked.line)?.[this.picked.view][this.picked.index];
        if (point) { this.ask(this.views[this.picked.view], [point.u, point.v]); return; }
      }
      this.band = null;
      this.paint();
    } else if (view.inside(uv)) {
      this.ask(view, uv);
    }
  }

  // Request the epipolar band of a position; of several pending requests only the last is sent.
  ask(view, uv) {
    this.question = {view: view.name, at: uv};
    if (this.asking) return;
    this.asking = true;
    setTimeout(async () => {
      const question = this.question;
      try {
        const answer = await this.link.post('/api/epipolar', question);
        this.band = {view: question.view === 'left' ? 'right' : 'left', ...answer};
      } catch { this.band = null; }
      this.asking = false;
      if (this.question !== question) this.ask(this.views[this.question.view], this.question.at);
      this.paint();
    }, ASK_MS);
  }

  key(view, event) {
    const line = this.tool.kind === 'line' ? this.line(this.tool.id) : null;
    const points = line ? line[view.name] : [];
    const at = this.picked && this.picked.view === view.name && line ? this.picked.index : -1;
    if (event.key === 'Enter') {
      if (at >= 0 && event.shiftKey) {
        this.link.step('move_point', {line: line.number, view: view.name, index: at, at: view.cursor, snap: this.snap});
      } else {
        this.picked = null;
        this.set(view, view.cursor);
      }
    } else if ((event.key === 'Delete' || event.key === 'Backspace') && at >= 0) {
      this.link.step('delete_point', {line: line.number, view: view.name, index: at});
    } else if ((event.key === '.' || event.key === ',') && points.length) {
      const step = event.key === '.' ? 1 : -1;
      this.pickPoint(view, at < 0 ? (step > 0 ? 0 : points.length - 1) : (at + step + points.length) % points.length);
    } else if (event.key === 'Escape') {
      this.picked = null;
      this.paint();
    } else {
      return false;
    }
    event.preventDefault();
    return true;
  }

  // Keys that work anywhere on the page.
  globalKey(event) {
    const key = event.key.toLowerCase();
    if ((event.ctrlKey || event.metaKey) && key === 'z') this.link.step(event.shiftKey ? 'redo' : 'undo');
    else if ((event.ctrlKey || event.metaKey) && key === 'y') this.link.step('redo');
    else if ((event.ctrlKey || event.metaKey) && key === 's') this.save('site');
    else if (event.ctrlKey || event.metaKey || event.altKey) return false;
    else if (key === 'n') this.newLine();
    else if (key === 'l') this.link.step('lanes_between');
    else if (key === 's') this.toggleSnap();
    else if (key === 'v') {
      const other = document.activeElement === this.views.left?.canvas ? 'right' : 'left';
      this.views[other]?.canvas.focus();
    } else return false;
    return true;
  }

  toggleSnap() {
    this.snap = !this.snap;
    this.link.tell('tools');
  }

  async save(what, overwrite = false) {
    document.activeElement?.blur?.(); // include unfinished input
    try {
      await this.link.settled();
      const {saved} = await this.link.post('/api/save', {what, overwrite});
      toast(`saved ${saved}`);
    } catch (error) {
      if (error.message.includes('outside this page') && confirm(`${error.message}. Replace it?`)) this.save(what, true);
      else toast(error.message, true);
    }
  }

  // -- drawing ---------------------------------------------------------------------------------

  draw(view, context) {
    if (!this.draft) return;
    if (this.band && this.band.view === view.name) this.drawBand(view, context);
    for (const lane of this.draft.lanes) {
      const path = this.figures?.lanes[lane.number]?.paths[view.name];
      if (path && path.length > 1) {
        stroke(context, view, path, 'rgb(255 255 255 / .55)', 1.2, [6, 5]);
        arrow(context, view, path);
      }
    }
    for (const line of this.draft.lines) this.drawLine(view, context, line);
    for (const known of this.draft.lengths) {
      if (known.kind === 'points') this.drawMarks(view, context, known, 'length', '#fff');
    }
    if (this.frame !== null) {
      for (const front of this.draft.fronts) {
        if (front.frame === this.frame) this.drawMarks(view, context, front, 'front', '#fb923c');
      }
    }
    if (this.ghost && this.ghost.view === view.name) dot(context, view, this.ghost.uv, '#fff', 5, false);
  }

  drawLine(view, context, line) {
    const on = this.tool.kind === 'line' && this.tool.id === line.number;
    const colour = this.colour(line.number);
    const fit = this.figures?.lines[line.number]?.views[view.name];
    const points = line[view.name];
    context.globalAlpha = on ? 1 : 0.65;
    const small = points.length > MANY ? 0.5 : 1;
    if (fit && fit.curve.length > 1) stroke(context, view, fit.curve, colour, on ? 1.8 : 1.2);
    else if (points.length > 1) stroke(context, view, points.map((p) => [p.u, p.v]), colour, 1, [3, 3]);
    points.forEach((point, index) => {
      const picked = this.picked && this.picked.line === line.number && this.picked.view === view.name
        && this.picked.index === index;
      dot(context, view, [point.u, point.v], colour, picked ? 6 : small * (on ? 4 : 2.5), point.std_px !== null);
      const off = fit?.residual_px[index];
      if (on && off > 1) label(context, view, [point.u, point.v], `${off.toFixed(1)} px`);
      if (picked) ring(context, view, [point.u, point.v]);
    });
    context.globalAlpha = 1;
  }

  drawMarks(view, context, thing, kind, colour) {
    const points = thing[view.name].map((p) => [p.u, p.v]);
    const on = this.tool.kind === kind && this.tool.id === thing.number;
    const closed = kind === 'front' && points.length === 4 ? [...points, points[0]] : points;
    if (closed.length > 1) stroke(context, view, closed, colour, on ? 1.8 : 1.1);
    points.forEach((p) => dot(context, view, p, colour, on ? 2.5 : 1.5, true));
  }

  drawBand(view, context) {
    const {curve, half_width_px: half, on_road: place} = this.band;
    if (curve.length > 1) {
      context.save();
      context.globalAlpha = 0.28;
      stroke(context, view, curve, '#5eead4', Math.max(2 * half * view.scale, 3));
      context.restore();
      stroke(context, view, curve, 'rgb(94 234 212 / .8)', 1);
    }
    if (place) ring(context, view, place, '#5eead4');
  }
}

function stroke(context, view, points, colour, width, dash = []) {
  context.beginPath();
  points.forEach((p, i) => { const [x, y] = view.toScreen(p); if (i) context.lineTo(x, y); else context.moveTo(x, y); });
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.lineJoin = 'round';
  context.setLineDash(dash);
  context.stroke();
  context.setLineDash([]);
}

function dot(context, view, uv, colour, radius, full) {
  const [x, y] = view.toScreen(uv);
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.lineWidth = 1.6;
  context.strokeStyle = colour;
  context.fillStyle = full ? colour : 'rgb(16 24 29 / .5)';
  context.fill();
  context.stroke();
}

function ring(context, view, uv, colour = '#fff') {
  const [x, y] = view.toScreen(uv);
  context.beginPath();
  context.arc(x, y, 10, 0, 7);
  context.lineWidth = 1.4;
  context.strokeStyle = colour;
  context.stroke();
}

function label(context, view, uv, text) {
  const [x, y] = view.toScreen(uv);
  context.font = '11px system-ui, sans-serif';
  context.lineWidth = 3;
  context.strokeStyle = '#10181d';
  context.fillStyle = '#fff';
  context.strokeText(text, x + 9, y - 7);
  context.fillText(text, x + 9, y - 7);
}

function arrow(context, view, path) {
  const at = Math.floor(path.length * 0.6);
  const [a, b] = [view.toScreen(path[at - 1]), view.toScreen(path[at])];
  const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
  context.save();
  context.translate(...b);
  context.rotate(angle);
  context.beginPath();
  context.moveTo(8, 0); context.lineTo(-5, -5); context.lineTo(-5, 5); context.closePath();
  context.fillStyle = '#fff';
  context.fill();
  context.restore();
}

export {MPH};
