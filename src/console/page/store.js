// What the page knows, in one place: filled by the sockets, read by the views.

import { ApiError, get } from './api.js';
import { History } from './history.js';
import { Quality } from './quality.js';
import { CreditSocket } from './socket.js';

/** @typedef {'connection'|'hello'|'model'|'status'|'scene'|'config'|'selection'} Topic */

const LATENCY_KEPT_S = 300;

class Store {
  constructor() {
    /** @type {import('./types').Hello|null} */
    this.hello = null;
    /** @type {import('./types').Model|null} */
    this.model = null;
    /** @type {import('./types').Status|null} */
    this.status = null;
    /** @type {import('./types').Configuration|null} */
    this.config = null;
    /** @type {import('./types').Detections|null} */
    this.detections = null;
    /** @type {import('./types').World|null} */
    this.world = null;
    /** @type {import('./types').Runs|null} */
    this.runs = null;
    this.history = new History();
    this.quality = new Quality(60);
    /** Latency of each stage, a point a second. @type {{time_s: number, p50: import('./types').StageTimes, worst_us: number}[]} */
    this.latencies = [];
    /** Capture to world of the frames since the last point, ms. @type {number[]} */
    this.latency_window = [];
    this.connected = false;
    /** Whether there ever was a connection. */
    this.met = false;
    /** When the connection was lost, of the steady clock. */
    this.lost_ms = performance.now();
    this.rate_hz = 0;
    /** Name of the robot that the user looks at. @type {string|null} */
    this.selected = null;
    /** Kinds of data wanted from the live socket, by the view that wants them. @type {Map<string, string[]>} */
    this.wanted = new Map();
    /** @type {Map<Topic, Set<() => void>>} */
    this.listeners = new Map();
    /** @type {CreditSocket|null} */
    this.live = null;
    this.seen = { detections: 0, world: 0, runs: 0, status: 0 };
    this.asking_model = false;
  }

  /** @param {Topic} topic @param {() => void} listener @returns {() => void} that ends it */
  on(topic, listener) {
    const listeners = this.listeners.get(topic) ?? new Set();
    this.listeners.set(topic, listeners.add(listener));
    return () => listeners.delete(listener);
  }

  /** @param {Topic} topic */
  tell(topic) {
    for (const listener of [...(this.listeners.get(topic) ?? [])]) listener();
  }

  /** Whether this page may change something. */
  get mayChange() {
    return this.hello?.rights === 'change';
  }

  /** @param {string|null} name */
  select(name) {
    this.selected = this.selected === name ? null : name;
    this.tell('selection');
  }

  /** @param {string} view @param {string[]} kinds none: it wants nothing any more */
  want(view, kinds) {
    if (kinds.length) this.wanted.set(view, kinds);
    else this.wanted.delete(view);
  }

  start() {
    this.live = new CreditSocket('/api/live', () => this.credit(), (data) => this.receive(data), (on) => this.connection(on));
    this.refresh();
  }

  /** @private */
  credit() {
    const want = ['status', ...new Set([...this.wanted.values()].flat())];
    return { want, after: Object.fromEntries(want.map((kind) => [kind, this.seen[/** @type {'world'} */ (kind)] ?? 0])) };
  }

  /** @private @param {string} data */
  receive(data) {
    const message = JSON.parse(data);
    const now = performance.now();
    for (const kind of /** @type {const} */ (['detections', 'world', 'runs'])) {
      const value = message[kind];
      if (!value) continue;
      if (kind === 'detections') this.measureRate(value.seq, now);
      this.seen[kind] = value.seq;
      /** @type {any} */ (this)[kind] = value;
      this.history.add(value.seq, { [kind]: value }, now);
    }
    if (message.status) this.takeStatus(message.status);
    if (message.world || message.detections) {
      this.quality.add(message.world ?? null, message.detections ?? null, this.model?.robots ?? [], this.frame_ms);
      if (message.world?.latency_ms !== undefined) this.latency_window.push(message.world.latency_ms);
      const revision = (message.detections ?? message.world).revision;
      if (this.model && revision > this.model.revision) this.refresh();
      this.tell('scene');
    }
  }

  get frame_ms() {
    return 1000 / (this.model?.picture.fps ?? 60);
  }

  /** @private @param {number} seq @param {number} now */
  measureRate(seq, now) {
    const since = this.rate_from;
    if (!since || seq < since.seq) this.rate_from = { seq, now };
    else if (now - since.now > 1000) {
      this.rate_hz = ((seq - since.seq) * 1000) / (now - since.now);
      this.rate_from = { seq, now };
    }
  }

  /** @type {{seq: number, now: number}|undefined} */
  rate_from;

  /** @private @param {any} status */
  takeStatus(status) {
    this.status = status;
    this.seen.status = status.seq ?? this.seen.status;
    this.keepLatency(status);
    if (this.model && status.configuration?.revision > this.model.revision) this.refresh();
    this.tell('status');
  }

  /** @private @param {import('./types').Status} status */
  keepLatency(status) {
    const time_s = performance.now() / 1000;
    const last = this.latencies.at(-1);
    if (last && time_s - last.time_s < 0.95) return;
    const window = this.latency_window.splice(0).sort((a, b) => a - b);
    const whole = status.latency_us;
    // The report's figures are those of the whole run; its shares of the stages are used for the newest second.
    const total_us = window.length ? 1000 * window[window.length >> 1] : whole.capture_to_world.p50;
    const factor = total_us / (whole.capture_to_world.p50 || 1);
    const p50 = {
      grabber: factor * whole.capture_to_frame.p50, classifier: factor * whole.capture_to_runs.p50,
      tracker: factor * whole.capture_to_detections.p50, filter: total_us,
    };
    const worst_us = window.length ? 1000 * window[window.length - 1] : whole.capture_to_world.p99;
    this.latencies.push({ time_s, p50, worst_us });
    while (this.latencies[0].time_s < time_s - LATENCY_KEPT_S) this.latencies.shift();
  }

  /** Reads everything that does not flow, again. */
  async refresh() {
    if (this.asking_model) return;
    this.asking_model = true;
    try {
      const [hello, model] = await Promise.all([get('/api/hello'), get('/api/model')]);
      [this.hello, this.model] = [hello, model];
      this.tell('hello');
      this.tell('model');
      if (!this.status) this.takeStatus(await get('/api/status'));
      this.config = await get('/api/config');
      this.tell('config');
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      // The socket says whether there is a connection, and asks again when it is back.
      if (error.status === 0 || error.status === 503) setTimeout(() => this.connected && this.refresh(), 1000);
    } finally {
      this.asking_model = false;
    }
  }

  /** @private @param {boolean} on */
  connection(on) {
    this.connected = on;
    if (on) {
      this.met = true;
      this.seen = { detections: 0, world: 0, runs: 0, status: 0 };
      this.refresh();
    } else {
      this.lost_ms = performance.now();
    }
    this.tell('connection');
  }
}

export const store = new Store();
