// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// The connection to the server: messages from it, and steps sent to it.
//
// Steps are kept in the tab's session storage until the server has applied them, so that neither
// a reload nor a lost connection loses one; the identity of a step prevents it from being applied
// twice.

import {toast} from './dom.js';

const WAITING = 'studio-steps';
const AGAIN_MS = [250, 500, 1000, 2000, 4000];

function identity() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return [...bytes].map((b) => b.toString(16).padStart(2, '0')).join('');
}

class Refused extends Error {}

export class Link extends EventTarget {
  constructor() {
    super();
    this.waiting = JSON.parse(sessionStorage.getItem(WAITING) || '[]');
    this.sending = false;
    this.connected = false;
    this.tries = 0;
  }

  start() {
    this.listen();
    this.send();
  }

  tell(kind, detail) {
    this.dispatchEvent(new CustomEvent(kind, {detail}));
  }

  on(kind, act) {
    this.addEventListener(kind, (event) => act(event.detail));
  }

  listen() {
    const socket = new WebSocket(`ws://${location.host}/api/socket`);
    socket.onopen = () => { this.connected = true; this.tries = 0; this.tell('link'); this.send(); };
    socket.onmessage = (event) => { const data = JSON.parse(event.data); this.tell(data.kind, data); };
    socket.onclose = () => {
      this.connected = false;
      this.tell('link');
      setTimeout(() => this.listen(), AGAIN_MS[Math.min(this.tries++, AGAIN_MS.length - 1)]);
    };
  }

  step(name, fields = {}) {
    this.waiting.push({id: identity(), name, fields});
    this.keep();
    this.send();
  }

  keep() {
    sessionStorage.setItem(WAITING, JSON.stringify(this.waiting));
    this.tell('link');
  }

  async send() {
    if (this.sending) return;
    this.sending = true;
    let tries = 0;
    while (this.waiting.length) {
      try {
        await this.post('/api/step', this.waiting[0]);
        tries = 0;
      } catch (error) {
        if (!(error instanceof Refused)) {
          await new Promise((done) => setTimeout(done, AGAIN_MS[Math.min(tries++, AGAIN_MS.length - 1)]));
          continue;
        }
        toast(error.message, true);
        this.tell('refused');
      }
      this.waiting.shift();
      this.keep();
    }
    this.sending = false;
  }

  // Send a request to the server; throws an error with the reason of a refusal.
  async post(path, body, as = 'json') {
    const response = await fetch(path, {
      method: 'POST', headers: {'Content-Type': 'application/json'}, body: JSON.stringify(body)});
    if (response.status === 400) throw new Refused((await response.json()).error);
    if (!response.ok) throw new (response.status < 500 ? Refused : Error)(await response.text());
    return as === 'text' ? response.text() : response.json();
  }

  postForText(path, body) { return this.post(path, body, 'text'); }

  async get(path) {
    const response = await fetch(path);
    if (response.status === 400) throw new Refused((await response.json()).error);
    if (!response.ok) throw new Refused((await response.text()).trim());
    return response.json();
  }

  // Wait until the server has applied all steps, so that the next request includes them.
  async settled() {
    while (this.waiting.length) await new Promise((done) => setTimeout(done, 20));
  }

  // Send a slow request, and show its result.
  async ask(path, body, said) {
    try {
      await this.settled();
      const result = await this.post(path, body);
      if (said) toast(said(result));
      return result;
    } catch (error) {
      toast(error.message, true);
      return null;
    }
  }
}
