// Setting up, as a row of steps, each with its own proof of success.

import { changes } from './changes.js';
import { h, mark, replace, say } from './dom.js';
import { isWorking } from './jobs.js';
import { drawScene } from './overlay.js';
import { PictureView } from './picture-view.js';
import { canDemosaic, Pictures } from './pictures.js';
import { CameraStep } from './setup-camera.js';
import { CheckStep } from './setup-check.js';
import { ColorsStep } from './setup-colors.js';
import { FieldStep } from './setup-field.js';
import { RobotsStep } from './setup-robots.js';
import { store } from './store.js';

/** @typedef {{level: 'good'|'bad'|'open', what: string, todo?: string}} Proof */
/** @typedef {import('./types').Pair} Pair */
/**
 * @typedef {object} Step
 * @property {string} name
 * @property {string} title
 * @property {HTMLElement} side
 * @property {() => Proof} proof
 * @property {() => void} [show]
 * @property {() => void} [hide]
 * @property {() => void} [update] with each frame, while shown
 * @property {import('./picture-view.js').Layer} [layer]
 * @property {(px: Pair, x: number, y: number) => void} [pick]
 * @property {(picture: import('./types').Picture) => void} [take] each picture, while shown
 * @property {() => Partial<import('./overlay.js').Switches>} [switches]
 */

/** How long the frame on which a proposal was tried is shown. */
const HELD_MS = 2500;
/** The overlay is that of a frame at most so far from the picture. */
const IN_STEP_S = 0.1;
/** While a job runs, pictures come at this distance. */
const WORKING_MS = 500;

const NO_SWITCHES = {
  robots: false, names: false, headings: false, ball: false, rejected: false, regions: false, runs: false, trails: false, prediction: false,
  covariance: false, lines: false, mask: false,
};

export class SetupView {
  constructor() {
    this.picture = new PictureView();
    this.held = h('div', { class: 'held', hidden: true }, 'The proposal, tried on this frame');
    this.work = h('div', { class: 'work' }, this.picture, this.held);
    /** @type {Step[]} */
    this.steps = [new CameraStep(), new FieldStep(this.picture), new ColorsStep(this.picture, this.work), new RobotsStep(), new CheckStep()];
    this.links = this.steps.map((step, index) => h('a', { href: `#setup/${step.name}` },
      h('span', { class: 'sign' }, String(index + 1)), h('span', null, h('b', null, step.title), h('small', null))));
    this.side = h('div', { class: 'panel side' });
    this.element = h('section', { class: 'setup' },
      h('nav', { class: 'steps', 'aria-label': 'Steps' }, this.links), this.work, this.side, changes.bar.element);
    /** @type {Step|null} */
    this.step = null;
    this.visible = false;
    this.raw = true;
    /** @type {Pictures|null} */
    this.pictures = null;
    this.picture.layers.push((context, view) => this.draw(context, view));
    this.picture.addEventListener('pick', (event) => {
      const { px, x, y } = /** @type {CustomEvent} */ (event).detail;
      this.step?.pick?.(px, x, y);
    });
    for (const topic of /** @type {const} */ (['scene', 'model', 'config', 'status'])) store.on(topic, () => this.update());
    changes.on(() => {
      this.hold();
      this.update();
    });
  }

  /** @param {string} part */
  show(part) {
    // Without a step: the first that is not proven.

    const step = this.steps.find(({ name }) => name === part) ?? this.steps.find((each) => each.proof().level !== 'good') ?? this.steps[0];
    this.visible = true;
    store.want('setup', ['detections', 'world']);
    this.pictures ??= new Pictures(() => this.wanted(), (picture) => this.take(picture));
    this.pictures.go();
    if (step !== this.step) {
      this.step?.hide?.();
      this.step = step;
      this.picture.handles = [];
      this.picture.bayer.shade = 0;
      replace(this.side, step.side);
      step.side.classList.add('stack');
      step.show?.();
      this.picture.bayer.draw();
      this.picture.drawAll();
    }
    this.update();
  }

  hide() {
    this.visible = false;
    this.release();
    this.step?.hide?.();
    this.step = null;
    store.want('setup', []);
    this.pictures?.close();
    this.pictures = null;
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (!event.ctrlKey && !event.metaKey) return false;
    if (event.key === 'z') changes.undo();
    else if (event.key === 's') changes.save();
    else return false;
    return true;
  }

  /** @private */
  wanted() {
    if (!this.visible || document.hidden || this.holds) return null;
    // On one laptop the job needs the processors more.
    if (isWorking() && performance.now() - this.taken_ms < WORKING_MS) return null;
    return /** @type {const} */ ({ scale: this.raw ? 1 : this.picture.neededScale(), format: this.raw ? 'raw' : 'jpeg' });
  }

  /** @private @param {import('./types').Picture} picture */
  async take(picture) {
    if (picture.header.format === 'raw' && !(canDemosaic(picture) && this.picture.bayer.works)) {
      this.raw = false;
      return;
    }
    if (this.holds) return;
    this.taken_ms = performance.now();
    // A picture comes before what is found on it, and outlines of the frame before would lie beside their robots.
    await store.history.found(picture.header.seq, 1000 * IN_STEP_S);
    if (this.holds || !this.visible) return;
    await this.picture.show(picture);
    this.shown_seq = picture.header.seq;
    this.step?.take?.(picture);
  }

  /** @private */
  update() {
    if (!this.visible) return;
    if (store.model) this.picture.setSize(store.model.picture);
    const now = performance.now();
    if (now - this.updated_ms > 150) {
      this.updated_ms = now;
      this.steps.forEach((step, index) => {
        const { level, what } = step.proof();
        const link = this.links[index];
        const [sign, text] = link.children;
        mark(link, 'is-good', level === 'good');
        mark(link, 'is-bad', level === 'bad');
        say(sign, level === 'good' ? '✓' : level === 'bad' ? '!' : String(index + 1));
        say(/** @type {Element} */ (text.lastElementChild), what);
        if (step === this.step) link.setAttribute('aria-current', 'step');
        else link.removeAttribute('aria-current');
      });
      this.step?.update?.();
    }
    this.picture.redraw();
  }

  updated_ms = 0;

  /** Shows for a moment what the proposal finds, on the frame on which it was tried. @private */
  async hold() {
    const tried = changes.tried?.detections ?? null;
    if (tried === this.shown_try) return;
    this.shown_try = tried;
    if (!tried || !this.visible || !this.step?.switches?.().robots) return this.release();
    const nearest = store.history.shown().sort((a, b) => Math.abs(a.seq - tried.seq) - Math.abs(b.seq - tried.seq))[0];
    // Where robots have moved on, their outlines would lie beside them.
    if (!nearest?.picture || Math.abs(nearest.seq - tried.seq) > 4) return this.release();
    clearTimeout(this.timer);
    this.holds = true;
    this.held.hidden = false;
    await this.picture.show(nearest.picture);
    this.timer = setTimeout(() => this.release(), HELD_MS);
  }

  /** @private */
  release() {
    clearTimeout(this.timer);
    this.holds = false;
    this.held.hidden = true;
    this.pictures?.go();
  }

  holds = false;
  /** @type {import('./types').Detections|null} */
  shown_try = null;
  /** @type {number|undefined} */
  timer = undefined;

  /** What was found with the proposal while it is tried; else what is found now, on the shown picture. @private @returns {import('./types').Scene} */
  scene() {
    const tried = changes.tried?.detections;
    if (this.holds && tried) return { seq: tried.seq, detections: tried };
    // Outlines beside their robots would look like a wrong set-up: better none for a moment.
    return store.history.around(this.shown_seq, Math.max(1, Math.round(IN_STEP_S * (store.model?.picture.fps ?? 60))));
  }

  shown_seq = 0;
  taken_ms = 0;

  /** @private @param {CanvasRenderingContext2D} context @param {import('./types').ViewTransform} view */
  draw(context, view) {
    const model = store.model;
    if (!model || !this.step) return;
    const switches = { ...NO_SWITCHES, ...this.step.switches?.() };
    drawScene(context, view, this.scene(), model, switches);
    this.step.layer?.(context, view);
  }
}
