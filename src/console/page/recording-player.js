// One recording: its time line, a frame with everything found on it, and beside it what another configuration
// finds there.

import { ApiError } from './api.js';
import { Archive } from './archive.js';
import { ComparePanel } from './compare-panel.js';
import { duration, h, keyed, mark, replace, say } from './dom.js';
import { FieldView } from './field-view.js';
import { drawScene, SWITCHES } from './overlay.js';
import { PictureView } from './picture-view.js';
import { Playback, SPEEDS } from './playback.js';
import { RobotsTable } from './robots-table.js';
import { savePicture } from './save-picture.js';
import { store } from './store.js';
import { Timeline, timeText } from './timeline.js';
import { toast } from './toast.js';

/** @typedef {import('./types').Scene} Scene */
/** @typedef {import('./types').RecordedFrame} RecordedFrame */
/** @typedef {import('./types').Model} Model */

const LOOK_MS = 300;
const PAGE_FRAMES = 20;

export class RecordingPlayer {
  /** @param {string} place @param {string} name */
  constructor(place, name) {
    this.place = place;
    this.archive = new Archive(place, name);
    this.on = /** @type {import('./overlay.js').Switches} */ (Object.fromEntries(SWITCHES.map(([key, , , on]) => [key, on])));
    /** Left: what was recorded; right: what is compared. */
    this.pictures = [new PictureView(), new PictureView()];
    /** @type {(Scene|null)[]} */
    this.scenes = [null, null];
    /** @type {(Model|null)[]} */
    this.models = [null, null];
    this.titles = [h('p', null), h('p', null)];
    /** @type {Playback|null} */
    this.playback = null;
    /** @type {ComparePanel|null} */
    this.compare = null;
    /** @type {import('./types').Opened|null} */
    this.about = null;
    this.compared_name = '';
    this.closed = false;
    this.field = new FieldView();
    this.robots = new RobotsTable();
    this.timeline = new Timeline();
    this.flags = h('div', { class: 'flags' });
    this.flags_panel = h('div', { class: 'panel', hidden: true }, h('h2', null, 'Events, marks and configurations'), this.flags);
    this.side = h('div', { class: 'side' });
    this.buttons = SWITCHES.map(([key, letter, title, on]) => h('button', {
      class: 'switch', 'aria-pressed': String(on), title: `Key ${letter.toUpperCase()}`, onclick: () => this.toggle(key),
    }, title, h('kbd', null, letter)));
    this.play_button = h('button', { class: 'main', title: 'Space', onclick: () => this.togglePlay() }, 'Play');
    this.speed = h('select', { 'aria-label': 'Speed', onchange: () => {
      this.speed.blur();
      this.playback?.setSpeed(Number(this.speed.value));
    } }, SPEEDS.map((speed) => h('option', { value: String(speed), selected: speed === 1 }, `${speed} ×`)));
    this.time = h('b', null);
    this.what = h('span', { class: 'soft' });
    this.halves = this.pictures.map((picture, index) => h('figure', { hidden: index === 1 }, h('figcaption', null, this.titles[index]), picture));
    this.empty = h('div', { class: 'empty over' }, h('b', null, 'Opening …'), h('span', null, name));
    this.pair = h('div', { class: 'pair' }, this.halves, this.empty);
    this.element = h('section', { class: 'player' },
      h('div', { class: 'switches' }, h('a', { href: '#recordings', class: 'back' }, '‹ All'), h('b', null, name), this.buttons),
      this.pair, this.side, this.timeline,
      h('div', { class: 'under' },
        this.play_button, h('button', { 'aria-label': 'One frame back', title: '←', onclick: () => this.playback?.step(-1) }, '◀'),
        h('button', { 'aria-label': 'One frame forward', title: '→', onclick: () => this.playback?.step(1) }, '▶'), this.speed, this.time, this.what, h('span', { class: 'grow' }),
        h('button', { class: 'small', onclick: () => this.saveFrame() }, 'Save picture'),
        h('a', { class: 'button', href: this.archive.exportAddress('csv'), download: '' }, 'Save CSV'),
        h('a', { class: 'button', href: this.archive.exportAddress('ssl-log'), download: '' }, 'Save SSL log')));
    this.pictures.forEach((picture, index) => {
      picture.layers.push((context, view) => {
        const [scene, model] = [this.scenes[index], this.models[index]];
        if (scene && model) drawScene(context, view, scene, model, this.on);
      });
      picture.addEventListener('pick', (event) => this.pick(index, /** @type {CustomEvent} */ (event).detail.px));
      picture.addEventListener('view', () => this.follow(index));
    });
    this.timeline.addEventListener('seek', (event) => this.playback?.go({ time_s: /** @type {CustomEvent} */ (event).detail.time_s }));
    this.ends = [store.on('selection', () => this.draw())];
    this.open();
  }

  /** @param {string} place @param {string} name */
  is(place, name) {
    return this.place === place && this.archive.name === name;
  }

  close() {
    this.closed = true;
    this.playback?.close();
    clearTimeout(this.timer);
    for (const end of this.ends) end();
  }

  /** @type {number|undefined} */
  timer = undefined;

  /** @private */
  async open() {
    try {
      const about = await this.archive.open();
      if (this.closed) return;
      this.about = about;
      this.timeline.about = about;
      const playback = new Playback(this.archive, about, () => this.wish(), (frame, bytes) => this.show(frame, bytes));
      this.playback = playback;
      this.compare = new ComparePanel(this.archive, about, {
        time: () => playback.frame.time_s, index: () => playback.frame.index, go: (at) => playback.go(at), begun: () => this.look(),
      });
      replace(this.side, h('div', { class: 'panel stack' }, this.field), this.robots.element, this.compare.element, this.flags_panel);
      this.empty.hidden = true;
      playback.go({ index: 0 });
      this.look();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      say(/** @type {Element} */ (this.empty.firstElementChild), 'This recording cannot be shown');
      say(/** @type {Element} */ (this.empty.lastElementChild), `${error.text()}. ${error.help ?? ''}`);
    }
  }

  /** Asks for more of the time line until all of it is known. @private */
  async look() {
    clearTimeout(this.timer);
    if (this.closed) return;
    try {
      const survey = await this.archive.survey(this.about?.frames ?? 1);
      const had = this.timeline.survey?.comparison;
      this.timeline.survey = survey;
      this.timeline.redraw();
      await this.takeComparison(survey.comparison, had ?? null);
      this.listFlags();
      if (survey.done >= 1 && (!survey.comparison || survey.comparison.is_done)) return;
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (error.status !== 0 && error.status !== 503) return toast(error);
    }
    this.timer = setTimeout(() => this.look(), LOOK_MS);
  }

  /** @private @param {import('./types').ComparisonReport|null} report @param {import('./types').ComparisonReport|null} before */
  async takeComparison(report, before) {
    this.compare?.update(report);
    mark(this.side, 'has-comparison', Boolean(report));
    if (!report) return;
    const is_another = report.name !== this.compared_name || !before || report.from_s !== before.from_s || before.done > report.done;
    if (is_another) {
      this.compared_name = report.name;
      this.models[1] = await this.archive.otherModel();
    }
    if (is_another || !before?.is_done) this.playback?.refresh();
  }

  /** @private */
  listFlags() {
    const flags = this.timeline.flags();
    this.flags_panel.hidden = !flags.length;
    keyed(this.flags, flags, (flag) => `${flag.time_s} ${flag.text}`, (flag) => h('button', {
      class: 'plain flag', onclick: () => this.playback?.go({ time_s: flag.time_s }),
    }, h('b', null, flag.sign), h('time', null, duration(flag.time_s)), h('span', null, flag.text)), () => {});
  }

  /** @private @returns {{scale: 1|2|4, runs: boolean}} */
  wish() {
    return { scale: this.pictures[0].neededScale(), runs: this.on.runs };
  }

  /** @private @param {RecordedFrame} frame @param {Uint8Array<ArrayBuffer>} bytes */
  async show(frame, bytes) {
    if (frame.damaged) {
      this.scenes = [null, null];
      say(this.titles[0], 'The file is damaged here.');
    } else {
      const revision = frame.revision ?? 0;
      this.models[0] = await this.archive.model(revision);
      this.scenes = [sceneOf(frame, frame, this.playback?.worlds() ?? []), frame.other ? sceneOf(frame, frame.other, []) : null];
      say(this.titles[0], `Recorded, with configuration ${revision}`);
      say(this.titles[1], this.compared_name);
      const shown = this.models[0].picture;
      for (const picture of this.pictures) picture.setSize(shown);
    }
    const both = Boolean(frame.other);
    if (this.halves[1].hidden === both) {
      this.halves[1].hidden = !both;
      mark(this.pair, 'is-two', both);
    }
    const picture = frame.picture && bytes.length ? { header: frame.picture, bytes } : null;
    if (picture) await Promise.all(this.pictures.slice(0, both ? 2 : 1).map((each) => each.show(picture)));
    this.timeline.robots = this.models[0]?.robots.length ?? 0;
    this.draw();
  }

  /** @private */
  draw() {
    const { playback, about } = this;
    if (!playback || !about) return;
    for (const picture of this.pictures) picture.redraw();
    [this.field.scene, this.field.model, this.field.switches] = [this.scenes[0], this.models[0], this.on];
    this.field.redraw();
    this.robots.update(this.scenes[0], this.models[0]);
    const { frame } = playback;
    this.timeline.setTime(frame.time_s);
    say(this.time, timeText(about.begins_s, frame.time_s));
    const missing = frame.damaged ? 'damaged' : frame.detections ? '' : ', no results recorded';
    say(this.what, `frame ${frame.seq ?? '–'}, ${frame.index + 1} of ${about.frames}${missing}`);
    say(this.play_button, playback.playing ? 'Pause' : 'Play');
    mark(this.play_button, 'main', !playback.playing);
  }

  /** Both pictures show the same part. @private @param {number} index of the one that was moved */
  follow(index) {
    const other = this.pictures[1 - index];
    if (this.following || this.halves[1].hidden) return;
    this.following = true;
    if (other.clientWidth === this.pictures[index].clientWidth) other.follow(this.pictures[index]);
    this.following = false;
    if (this.pictures[index].neededScale() === 1) this.playback?.refresh();
  }

  following = false;

  /** @private @param {number} index @param {import('./types').Pair} px */
  pick(index, px) {
    const near = this.scenes[index]?.detections?.robots.find((robot) => Math.hypot(robot.center_px[0] - px[0], robot.center_px[1] - px[1]) < 25);
    if (near) store.select(near.name);
  }

  /** @private @param {keyof import('./overlay.js').Switches} name */
  toggle(name) {
    this.on[name] = !this.on[name];
    this.buttons[SWITCHES.findIndex(([known]) => known === name)].setAttribute('aria-pressed', String(this.on[name]));
    if (name === 'runs') this.playback?.refresh();
    this.draw();
  }

  /** @private */
  togglePlay() {
    if (this.playback?.playing) this.playback.pause();
    else this.playback?.play();
    this.draw();
  }

  /** @private */
  async saveFrame() {
    const { playback } = this;
    const [scene, model] = [this.scenes[0], this.models[0]];
    if (!playback || !scene || !model) return toast('There is no picture of this frame.');
    const { frame, bytes } = await this.archive.frame({ index: playback.frame.index }, { scale: 1, runs: this.on.runs });
    const picture = frame.picture ? { header: frame.picture, bytes } : null;
    const sides = [{ scene, model, title: '' }];
    if (this.scenes[1] && this.models[1]) sides.push({ scene: this.scenes[1], model: this.models[1], title: this.compared_name });
    await savePicture(picture, sides, this.on, `${this.archive.name.replace(/\.mcap$/, '')}-${frame.seq ?? frame.index}.png`);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.playback) return false;
    const named = SWITCHES.find(([, key]) => key === event.key);
    /** @type {Record<string, () => void>} */
    const keys = {
      ' ': () => this.togglePlay(), ArrowLeft: () => this.playback?.step(-1), ArrowRight: () => this.playback?.step(1),
      PageUp: () => this.playback?.step(-PAGE_FRAMES), PageDown: () => this.playback?.step(PAGE_FRAMES),
      Home: () => this.playback?.go({ index: 0 }), End: () => this.playback?.go({ index: (this.about?.frames ?? 1) - 1 }),
    };
    if (named) this.toggle(named[0]);
    else if (keys[event.key]) keys[event.key]();
    else return false;
    return true;
  }
}

/** @param {RecordedFrame} frame @param {{detections?: any, world?: any, runs?: number[]|null}} found @param {import('./types').World[]} past @returns {Scene} */
function sceneOf(frame, found, past) {
  const [seq, revision] = [frame.seq ?? 0, frame.revision ?? 0];
  return {
    seq, past, detections: found.detections ?? undefined, world: found.world ?? undefined,
    runs: found.runs ? { seq, revision, runs: found.runs } : undefined,
  };
}
