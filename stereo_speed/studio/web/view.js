// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// One raw view: the image with zoom, pan, a magnifier at the cursor and a keyboard cursor.
//
// Pixel coordinates are those of the site file: the centre of the first pixel is (0, 0).

import {el} from './dom.js';

const LOUPE = 132, LOUPE_TIMES = 8;
const MOST_ZOOM = 40;
let hand = 'pointer'; // or 'keys': the input device used last, in any view
const GRAB = 9; // screen px within which a point is grabbed

export class RawView {
  // hooks: draw(view, context), press(view, uv) -> handle or null, drag(view, handle, uv),
  // drop(view, handle, uv), hover(view, uv), key(view, event) -> handled
  constructor(name, size, source, hooks) {
    this.name = name;
    this.size = size;
    this.hooks = hooks;
    this.canvas = el('canvas', {tabindex: '0', role: 'application', 'data-view': name,
      'aria-label': `${name} view: arrow keys move the cursor, Enter sets a point`});
    this.place = el('span', {class: 'place num'});
    this.root = el('div', {class: 'view', style: {'aspect-ratio': `${size[0]} / ${size[1]}`}}, this.canvas,
      el('span', {class: 'name'}, `${name} view`), this.place);
    this.image = new Image();
    this.image.onload = () => this.paint();
    this.scale = 0;
    this.cursor = null;
    this.pointer = null;
    this.load(source);
    new ResizeObserver(() => this.fit(false)).observe(this.canvas);
    this.listen();
  }

  load(source) {
    if (this.source === source) return;
    this.source = source;
    this.image.src = source;
  }

  // -- places ----------------------------------------------------------------------------------

  fit(anew = true) {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const least = Math.min(width / this.size[0], height / this.size[1]);
    if (anew || !this.scale || this.scale <= this.least * 1.001) {
      this.scale = least;
      this.x = (width - this.size[0] * least) / 2;
      this.y = (height - this.size[1] * least) / 2;
    }
    this.least = least;
    this.paint();
  }

  toScreen([u, v]) { return [this.x + (u + 0.5) * this.scale, this.y + (v + 0.5) * this.scale]; }

  toImage([x, y]) { return [(x - this.x) / this.scale - 0.5, (y - this.y) / this.scale - 0.5]; }

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return this.toImage([event.clientX - box.left, event.clientY - box.top]);
  }

  inside([u, v]) { return u >= -0.5 && v >= -0.5 && u <= this.size[0] - 0.5 && v <= this.size[1] - 0.5; }

  zoom(times, uv) {
    const [x, y] = this.toScreen(uv);
    const scale = Math.min(Math.max(this.scale * times, this.least), MOST_ZOOM);
    this.scale = scale;
    this.x = x - (uv[0] + 0.5) * scale;
    this.y = y - (uv[1] + 0.5) * scale;
    this.keep();
    this.paint();
  }

  // Keep the image within the canvas.
  keep() {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    const [w, h] = [this.size[0] * this.scale, this.size[1] * this.scale];
    this.x = w <= width ? (width - w) / 2 : Math.min(0, Math.max(width - w, this.x));
    this.y = h <= height ? (height - h) / 2 : Math.min(0, Math.max(height - h, this.y));
  }

  show(uv) {
    const [x, y] = this.toScreen(uv);
    const {clientWidth: width, clientHeight: height} = this.canvas;
    if (x < 20 || x > width - 20) this.x += width / 2 - x;
    if (y < 20 || y > height - 20) this.y += height / 2 - y;
    this.keep();
  }

  near(a, b) {
    const [[x, y], [s, t]] = [this.toScreen(a), this.toScreen(b)];
    return Math.hypot(x - s, y - t);
  }

  grabs(a, b) { return this.near(a, b) <= GRAB; }

  // -- painting --------------------------------------------------------------------------------

  paint() {
    if (!this.asked) {
      this.asked = true;
      requestAnimationFrame(() => { this.asked = false; this.paintNow(); });
    }
  }

  paintNow() {
    const context = this.canvas.getContext('2d');
    const ratio = window.devicePixelRatio || 1;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = '#10181d';
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    if (!this.scale) return;
    this.canvas.dataset.transform = `${this.scale},${this.x},${this.y}`;
    context.imageSmoothingEnabled = this.scale < 3;
    if (this.image.complete && this.image.naturalWidth) {
      context.drawImage(this.image, this.x, this.y, this.size[0] * this.scale, this.size[1] * this.scale);
    }
    this.hooks.draw(this, context);
    const at = this.focus();
    this.place.textContent = at ? `${at[0].toFixed(1)}, ${at[1].toFixed(1)}` : '';
    if (at && this.inside(at)) this.paintLoupe(context, at);
  }

  // The inspected position: under the pointer, or under the keyboard cursor.
  focus() {
    const byKeys = hand === 'keys' && document.activeElement === this.canvas;
    return this.pointer || (byKeys ? this.cursor : null);
  }

  paintLoupe(context, at) {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    const [x, y] = this.toScreen(at);
    const left = x < width / 2 ? width - LOUPE - 8 : 8;
    const top = y < height / 2 ? height - LOUPE - 8 : 8;
    const times = Math.max(LOUPE_TIMES, this.scale * 2), span = LOUPE / times;
    context.save();
    context.beginPath();
    context.roundRect(left, top, LOUPE, LOUPE, 8);
    context.clip();
    context.fillStyle = '#10181d';
    context.fillRect(left, top, LOUPE, LOUPE);
    context.imageSmoothingEnabled = false;
    context.drawImage(this.image, at[0] + 0.5 - span / 2, at[1] + 0.5 - span / 2, span, span,
      left, top, LOUPE, LOUPE);
    const was = [this.scale, this.x, this.y];
    this.scale = times;
    this.x = left + LOUPE / 2 - (at[0] + 0.5) * times;
    this.y = top + LOUPE / 2 - (at[1] + 0.5) * times;
    this.hooks.draw(this, context);
    [this.scale, this.x, this.y] = was;
    context.strokeStyle = 'rgb(255 255 255 / .75)';
    context.lineWidth = 1;
    const [cx, cy] = [left + LOUPE / 2, top + LOUPE / 2];
    context.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(cx + 5 * dx, cy + 5 * dy);
      context.lineTo(cx + 18 * dx, cy + 18 * dy);
    }
    context.stroke();
    context.restore();
    context.strokeStyle = 'rgb(255 255 255 / .5)';
    context.beginPath();
    context.roundRect(left, top, LOUPE, LOUPE, 8);
    context.stroke();
    const [sx, sy] = this.toScreen(at);
    if (!this.pointer) {
      context.strokeStyle = '#fff';
      context.beginPath();
      context.moveTo(sx - 9, sy); context.lineTo(sx + 9, sy);
      context.moveTo(sx, sy - 9); context.lineTo(sx, sy + 9);
      context.stroke();
    }
  }

  // -- hands -----------------------------------------------------------------------------------

  listen() {
    const canvas = this.canvas;
    canvas.addEventListener('pointerdown', (event) => {
      canvas.focus({preventScroll: true});
      canvas.setPointerCapture(event.pointerId);
      const uv = this.at(event);
      if (event.button !== 0 || event.ctrlKey || this.space) {
        this.pan = [event.clientX, event.clientY];
      } else if (this.inside(uv)) {
        this.held = this.hooks.press(this, uv);
      }
      this.pointer = this.pan ? null : uv;
      this.paint();
      event.preventDefault();
    });
    canvas.addEventListener('pointermove', (event) => {
      hand = 'pointer';
      if (this.pan) {
        this.x += event.clientX - this.pan[0];
        this.y += event.clientY - this.pan[1];
        this.pan = [event.clientX, event.clientY];
        this.keep();
      } else {
        this.pointer = this.at(event);
        if (this.held) this.hooks.drag(this, this.held, this.pointer);
        this.hooks.hover(this, this.pointer);
      }
      this.paint();
    });
    canvas.addEventListener('pointerup', (event) => {
      const held = this.held;
      this.held = this.pan = null;
      if (held) this.hooks.drop(this, held, this.at(event));
      this.paint();
    });
    canvas.addEventListener('pointercancel', () => { this.held = this.pan = null; });
    canvas.addEventListener('pointerleave', () => {
      if (this.held) return;
      this.pointer = null;
      this.hooks.hover(this, null);
      this.paint();
    });
    canvas.addEventListener('contextmenu', (event) => event.preventDefault());
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), this.at(event));
    }, {passive: false});
    canvas.addEventListener('focus', () => {
      if (!this.cursor) this.cursor = [this.size[0] / 2, this.size[1] / 2];
      this.paint();
    });
    canvas.addEventListener('blur', () => this.paint());
    canvas.addEventListener('keydown', (event) => this.key(event));
    canvas.addEventListener('keyup', (event) => { if (event.key === ' ') this.space = false; });
  }

  key(event) {
    hand = 'keys';
    const way = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (event.key === ' ') {
      this.space = true;
      event.preventDefault();
    } else if (way && !event.ctrlKey) {
      const step = event.altKey ? 0.1 : event.shiftKey ? 10 : 1;
      this.pointer = null;
      this.moveCursor([this.cursor[0] + way[0] * step, this.cursor[1] + way[1] * step]);
      event.preventDefault();
    } else if (event.key === '+' || event.key === '=') {
      this.zoom(1.5, this.cursor);
    } else if (event.key === '-') {
      this.zoom(1 / 1.5, this.cursor);
    } else if (event.key === '0') {
      this.fit();
    } else if (!this.hooks.key(this, event)) {
      return;
    }
    event.stopPropagation();
  }

  moveCursor([u, v]) {
    this.cursor = [Math.min(Math.max(u, 0), this.size[0] - 1), Math.min(Math.max(v, 0), this.size[1] - 1)];
    this.show(this.cursor);
    this.hooks.hover(this, this.cursor);
    this.paint();
  }
}
