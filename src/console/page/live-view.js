// The live view: the picture with what was found on it, the pitch beside it, the last ten seconds.

import { get, post } from './api.js';
import { h, mark, number, replace, say } from './dom.js';
import { FieldView } from './field-view.js';
import { css, drawScene, SWITCHES } from './overlay.js';
import { PictureView } from './picture-view.js';
import { canDemosaic, Pictures } from './pictures.js';
import { RobotsTable } from './robots-table.js';
import { store } from './store.js';
import { attempt, toast } from './toast.js';

/** @typedef {import('./types').Scene} Scene */

/** The overlay waits for its picture up to this delay. */
const IN_STEP_S = 0.5;
/** A picture older than this is not live. */
const STALE_MS = 3000;

export class LiveView {
  constructor() {
    this.picture = new PictureView();
    this.field = new FieldView();
    this.on = /** @type {import('./overlay.js').Switches} */ (Object.fromEntries(SWITCHES.map(([name, , , on]) => [name, on])));
    this.format = /** @type {'jpeg'|'raw'} */ ('jpeg');
    this.visible = false;
    /** Frame at which it is paused. @type {number|null} */
    this.paused = null;
    /** Newest picture that is shown. */
    this.shown_seq = 0;
    /** @type {Pictures|null} */
    this.pictures = null;
    /** @type {Scene|null} */
    this.scene = null;
    this.asking_pixel = false;
    this.buttons = SWITCHES.map(([name, key, title, on]) => h('button', {
      class: 'switch', 'aria-pressed': String(on), title: `Key ${key.toUpperCase()}`, onclick: () => this.toggle(name),
    }, title, h('kbd', null, key)));
    this.raw_button = h('button', {
      class: 'switch', 'aria-pressed': 'false', title: 'Raw sensor pictures, demosaiced by this computer’s graphics processor', onclick: () => this.switchFormat(),
    }, 'Raw');
    this.pause_button = h('button', { onclick: () => this.togglePause(), title: 'Space' }, 'Pause');
    this.back = h('button', { 'aria-label': 'One frame back', title: '←', onclick: () => this.step(-1) }, '◀');
    this.forward = h('button', { 'aria-label': 'One frame forward', title: '→', onclick: () => this.step(1) }, '▶');
    this.slider = h('input', { type: 'range', min: '0', max: '0', 'aria-label': 'Frame', hidden: true, oninput: () => this.scrub() });
    this.time = h('span', { class: 'soft' });
    this.reading = h('div', { class: 'reading' });
    this.robots = new RobotsTable();
    this.empty = h('div', { class: 'empty over' }, h('b', null, 'No picture yet'), h('span', null, 'Waiting for the camera. If this stays, its state is in Match.'));
    this.picture_ms = 0;
    this.element = h('section', { class: 'live' },
      h('div', { class: 'switches', role: 'toolbar', 'aria-label': 'Shown over the picture' }, this.buttons, h('span', { class: 'grow' }), this.raw_button),
      h('div', { class: 'frame' }, this.picture, this.empty),
      h('div', { class: 'side' },
        h('div', { class: 'panel stack' }, this.field),
        this.robots.element,
      ),
      h('div', { class: 'under' }, this.pause_button, this.back, this.forward, this.slider, this.time, this.reading),
    );
    this.field.classList.add('grow');
    this.picture.layers.push((context, view) => {
      if (this.scene && store.model) drawScene(context, view, this.scene, store.model, this.on);
    });
    this.picture.addEventListener('point', () => this.readPixel());
    this.picture.addEventListener('pick', (event) => this.pick(/** @type {CustomEvent} */ (event).detail.px));
    store.on('scene', () => this.update());
    store.on('model', () => this.update());
    store.on('selection', () => this.update());
    // Without news nothing else would notice.
    setInterval(() => this.checkPicture(), 500);
  }

  show() {
    this.visible = true;
    this.want();
    this.pictures ??= new Pictures(() => this.wanted(), async (picture) => {
      if (this.paused !== null) return;
      if (picture.header.format === 'raw' && !canDemosaic(picture)) {
        this.switchFormat();
        return toast(`The camera delivers ${picture.header.pixel_format}, not a Bayer picture.`, 'The encoded picture stays.');
      }
      await this.picture.show(picture);
      this.shown_seq = picture.header.seq;
      this.picture_ms = performance.now();
      this.update();
    });
    this.pictures.go();
    this.update();
  }

  hide() {
    this.visible = false;
    store.want('live', []);
    this.pictures?.close();
    this.pictures = null;
    if (this.paused !== null) this.togglePause();
  }

  /** @private */
  checkPicture() {
    const missing = this.paused === null && performance.now() - this.picture_ms > STALE_MS;
    this.empty.hidden = !missing;
    say(/** @type {Element} */ (this.empty.firstElementChild), this.picture_ms ? 'No new picture' : 'No picture yet');
  }

  /** @private */
  want() {
    store.want('live', ['detections', 'world', ...(this.on.runs ? ['runs'] : [])]);
  }

  /** @private */
  wanted() {
    if (!this.visible || this.paused !== null || document.hidden) return null;
    const scale = this.format === 'raw' ? 1 : this.picture.neededScale();
    return { scale: /** @type {1|2|4} */ (scale), format: this.format };
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const named = SWITCHES.find(([, key]) => key === event.key);
    if (named) this.toggle(named[0]);
    else if (event.key === ' ') this.togglePause();
    else if (event.key === 'ArrowLeft') this.step(-1);
    else if (event.key === 'ArrowRight') this.step(1);
    else if (event.key === 'k') this.markMoment();
    else return false;
    return true;
  }

  /** @private */
  async markMoment() {
    if (await attempt(post('/api/mark', { text: 'marked in the console' }))) toast('Marked.');
  }

  /** @private @param {keyof import('./overlay.js').Switches} name */
  toggle(name) {
    this.on[name] = !this.on[name];
    const index = SWITCHES.findIndex(([known]) => known === name);
    this.buttons[index].setAttribute('aria-pressed', String(this.on[name]));
    this.want();
    this.update();
  }

  /** @private */
  switchFormat() {
    if (!this.picture.bayer.works) return toast('This browser has no WebGL 2, which raw pictures need.', 'The encoded picture stays.');
    this.format = this.format === 'raw' ? 'jpeg' : 'raw';
    this.raw_button.setAttribute('aria-pressed', String(this.format === 'raw'));
  }

  /** @private */
  togglePause() {
    if (this.paused === null) {
      this.paused = this.shown_seq;
      store.history.frozen = true;
    } else {
      this.paused = null;
      store.history.frozen = false;
      store.history.clear();
      this.pictures?.go();
    }
    const frames = store.history.shown();
    this.slider.hidden = this.paused === null;
    this.slider.max = String(Math.max(0, frames.length - 1));
    this.slider.value = String(frames.findIndex((scene) => scene.seq === this.paused));
    say(this.pause_button, this.paused === null ? 'Pause' : 'Live');
    mark(this.pause_button, 'main', this.paused !== null);
    this.update();
  }

  /** @private @param {number} by */
  step(by) {
    if (this.paused === null) this.togglePause();
    this.slider.value = String(Number(this.slider.value) + by);
    this.scrub();
  }

  /** @private */
  async scrub() {
    const scene = store.history.shown()[Number(this.slider.value)];
    if (!scene?.picture) return;
    this.paused = scene.seq;
    await this.picture.show(scene.picture);
    this.update();
  }

  /** What is drawn: with the picture if both are known, else the newest. @private */
  currentScene() {
    if (this.paused !== null) return store.history.around(this.paused);
    const newest = store.detections;
    const late = newest ? newest.seq - this.shown_seq : 0;
    // On a slow line the overlay stays current while the picture is older.
    const few = Math.max(2, Math.round(IN_STEP_S * (store.model?.picture.fps ?? 60)));
    if (Math.abs(late) <= few) return store.history.around(this.shown_seq);
    return { seq: newest?.seq ?? 0, detections: newest ?? undefined, world: store.world ?? undefined, runs: store.runs ?? undefined };
  }

  /** @private */
  update() {
    if (!this.visible) return;
    this.scene = this.currentScene();
    if (store.model) this.picture.setSize(store.model.picture);
    this.picture.redraw();
    this.field.scene = this.scene;
    this.field.switches = this.on;
    this.field.redraw();
    const now = performance.now();
    if (this.paused === null && now - (this.listed_ms ?? 0) < 120) return;
    this.listed_ms = now;
    this.robots.update(this.scene, store.model);
    if (this.paused === null) return say(this.time, '');
    const behind = ((store.history.newest()?.seq ?? 0) - this.paused) / (store.model?.picture.fps ?? 60);
    say(this.time, `frame ${this.paused}, ${behind.toFixed(2)} s before the pause`);
  }

  /** @type {number|undefined} */
  listed_ms;

  /** @private @param {import('./types').Pair} px */
  pick(px) {
    const near = this.scene?.detections?.robots.find((robot) => Math.hypot(robot.center_px[0] - px[0], robot.center_px[1] - px[1]) < 25);
    if (near) store.select(near.name);
  }

  /** @private */
  async readPixel() {
    const at = this.picture.pointer;
    if (!at) return replace(this.reading);
    if (this.asking_pixel) return;
    this.asking_pixel = true;
    const [x, y] = at.map(Math.round);
    const seq = this.paused ?? this.shown_seq;
    try {
      this.showPixel(x, y, await get(`/api/pixel?x=${x}&y=${y}&seq=${seq}`));
    } catch {
      // A frame that is not kept any more has no exact pixels.
      replace(this.reading, h('span', null, 'pixel ', h('b', null, `${x}, ${y}`)));
    }
    setTimeout(() => {
      this.asking_pixel = false;
      const now = this.picture.pointer?.map(Math.round);
      if (now && (now[0] !== x || now[1] !== y)) this.readPixel();
    }, 60);
  }

  /** @private @param {number} x @param {number} y @param {import('./types').PixelReading} pixel */
  showPixel(x, y, pixel) {
    const swatch = h('i', { class: 'swatch' });
    swatch.style.background = css(pixel.rgb);
    const looks = (/** @type {string} */ name) => {
      const dot = h('i', { class: 'swatch' });
      dot.style.background = css(store.model?.colors.find((color) => color.name === name)?.looks ?? [128, 128, 128]);
      return dot;
    };
    replace(this.reading,
      h('span', null, 'pixel ', h('b', null, `${x}, ${y}`)),
      pixel.field_mm ? h('span', null, h('b', null, `${number(pixel.field_mm[0])}, ${number(pixel.field_mm[1])}`), ' mm') : null,
      swatch,
      h('span', null, 'RGB ', h('b', null, pixel.rgb.map((value) => number(value)).join(' '))),
      pixel.raw === null || pixel.raw === undefined ? null : h('span', null, 'raw ', h('b', null, String(pixel.raw))),
      h('span', null, 'hue ', h('b', null, pixel.hue_deg === null ? '–' : `${number(pixel.hue_deg)}°`), ' sat ', h('b', null, number(pixel.saturation, 2)), ' bright ', h('b', null, number(pixel.intensity))),
      pixel.colors.length ? pixel.colors.map((name) => h('span', { class: 'chip' }, looks(name), name)) : h('span', null, 'no colour admits it'),
    );
  }
}
