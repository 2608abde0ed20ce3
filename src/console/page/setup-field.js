// Step 2: where the pitch lies in the picture. It is found by itself, or its corners are dragged; the
// lines follow the hand at once, and the program's calibration answers with the error of each point.

import { changes } from './changes.js';
import { h, number, replace, say } from './dom.js';
import { Camera, fieldLines, subdivided } from './geometry.js';
import { calibrate, findField } from './jobs.js';
import { label, path, place } from './overlay.js';
import { jobButton, keysForm, presetList, proofBox } from './setup-parts.js';
import { store } from './store.js';
import { attempt, toast } from './toast.js';

/** @typedef {import('./types').Pair} Pair */
/** @typedef {{name: string, mm: Pair, px: Pair|null, error_px: number|null}} Mark px: where the user put it */

/** Mean error below which lines lie on lines. */
const GOOD_ERROR_PX = 1.5;

export class FieldStep {
  name = 'field';
  title = 'Field';

  /** @param {import('./picture-view.js').PictureView} picture */
  constructor(picture) {
    this.picture = picture;
    /** @type {Mark[]} */
    this.marks = [];
    this.size = '';
    /** Error of the last calibration. @type {number|null} */
    this.rms_px = null;
    /** Revision whose geometry the marks were made from. */
    this.revision = -1;
    this.busy = false;
    /** Height of the lens, if the user gave it. @type {number|undefined} */
    this.height_mm = undefined;
    this.proofs = proofBox();
    this.presets = presetList('preset', 'Sizes of a league …', (preset) => this.choosePreset(preset));
    this.form = keysForm([
      { key: 'field.length_mm', title: 'Length', unit: 'mm', min: 100 },
      { key: 'field.width_mm', title: 'Width', unit: 'mm', min: 100 },
      { key: 'field.goal_width_mm', title: 'Goal width', unit: 'mm', min: 0 },
      { key: 'field.goal_depth_mm', title: 'Goal depth', unit: 'mm', min: 0 },
      { key: 'field.center_circle_radius_mm', title: 'Radius of the centre circle', unit: 'mm', min: 0 },
    ]);
    this.height = h('input', { type: 'number', id: 'camera-height', min: 100, max: 20000, step: 10, onchange: () => {
      this.height_mm = Number(this.height.value) || undefined;
      this.calibrate(false);
    } });
    this.errors = h('tbody', null);
    this.lens = h('div', { class: 'soft' });
    this.find = jobButton('Find the field', 'Looking for lines …', () => this.findField());
    this.side = h('div', null,
      h('h1', null, 'Field'), this.proofs.element,
      h('h2', null, 'Size'), this.presets.element, this.form.element,
      h('h2', null, 'Place'),
      h('div', { class: 'form' }, h('label', { for: 'camera-height' }, 'Height of the lens above the floor'), h('div', { class: 'unit' }, this.height, h('span', null, 'mm'))),
      h('div', { class: 'row' }, this.find, h('span', { class: 'soft' }, 'or drag the corners in the picture')),
      h('table', null, h('thead', null, h('tr', null, h('th', null, 'Point'), h('th', { class: 'n' }, 'pixel'), h('th', { class: 'n' }, 'error'))), this.errors),
      this.lens,
    );
  }

  show() {
    this.makeMarks();
    this.presets.load();
  }

  /** @private @param {import('./setup-parts.js').Preset} preset */
  choosePreset(preset) {
    if (!preset.values) return toast('The sizes of this preset are not known here.', 'Enter them below.');
    const { length_mm, width_mm, goal_width_mm, goal_depth_mm, center_circle_radius_mm } = preset.values.field;
    changes.propose({
      'field.length_mm': length_mm, 'field.width_mm': width_mm, 'field.goal_width_mm': goal_width_mm, 'field.goal_depth_mm': goal_depth_mm,
      'field.center_circle_radius_mm': center_circle_radius_mm,
    });
  }

  /** Corners and ends of the halfway line, where the configuration has them. @private */
  makeMarks() {
    const values = changes.values;
    if (!values || !store.model) return;
    const [x, y] = [values.field.length_mm / 2, values.field.width_mm / 2];
    /** @type {[string, Pair][]} */
    const places = [['top left', [-x, y]], ['top right', [x, y]], ['bottom right', [x, -y]], ['bottom left', [-x, -y]]];
    const { width, height } = store.model.picture;
    const camera = Camera.through(values.geometry.points, values.geometry.distortion, width, height);
    this.revision = store.config?.revision ?? 0;
    this.size = `${x} ${y}`;
    if (document.activeElement !== this.height) this.height.value = String(Math.round(values.geometry.camera_mm[2]));
    this.marks = places.map(([name, mm]) => ({ name, mm, px: camera ? camera.toImage(mm) : null, error_px: this.marks.find((mark) => mark.name === name)?.error_px ?? null }));
    for (const [name, mm] of /** @type {[string, Pair][]} */ ([['halfway line top', [0, y]], ['halfway line bottom', [0, -y]]])) {
      this.marks.push({ name, mm, px: null, error_px: null });
    }
    this.picture.handles = this.marks.map((mark) => ({
      at: () => mark.px ?? this.camera()?.toImage(mark.mm) ?? [0, 0],
      move: (to) => {
        mark.px = to;
        mark.error_px = null;
        this.rms_px = null;
        this.picture.redraw();
        this.list();
      },
      done: () => this.calibrate(false),
    }));
  }

  /** Of the marks, for the preview. @private */
  camera() {
    const values = changes.values;
    if (!values || !store.model) return null;
    const { width, height } = store.model.picture;
    const points = this.marks.filter((mark) => mark.px).map((mark) => ({ field_mm: mark.mm, image_px: /** @type {Pair} */ (mark.px) }));
    return Camera.through(points, values.geometry.distortion, width, height);
  }

  /** @private */
  async findField() {
    const found = await attempt(findField(Object.fromEntries(changes.draft)));
    if (!found) return;
    if (!found.found) return toast(found.why ?? 'The field was not found.', 'Check length and width, or drag the corners to their places.');
    this.found = found.points;
    const corner = (/** @type {Mark} */ mark) => found.points.find(({ mm }) => Math.hypot(mm[0] - mark.mm[0], mm[1] - mark.mm[1]) < 1)?.px ?? null;
    for (const mark of this.marks) mark.px = corner(mark) ?? mark.px;
    await this.calibrate(true);
  }

  /** All points of the last search. @type {import('./jobs.js').Point[]} */
  found = [];

  /** @private @param {boolean} as_found whether the points are those of the search @returns {Promise<void>} */
  async calibrate(as_found) {
    if (this.busy) {
      this.again = true;
      return;
    }
    this.busy = true;
    const marks = this.marks.filter((mark) => mark.px);
    const points = as_found ? this.found : marks.map((mark) => ({ px: /** @type {Pair} */ (mark.px), mm: mark.mm }));
    const set = Object.fromEntries([...changes.draft].filter(([key]) => !key.startsWith('geometry')));
    const answer = await attempt(calibrate({ points, as_found, use_lines: true, set, camera_height_mm: this.height_mm }));
    this.busy = false;
    if (this.again) {
      this.again = false;
      return this.calibrate(false);
    }
    if (!answer) return;
    // Lines that were measured tell more than the points by which the search for them began.
    this.rms_px = answer.lines?.used ? answer.lines.rms_px : answer.rms_px;
    points.forEach(({ mm }, index) => {
      const mark = this.marks.find((each) => Math.hypot(mm[0] - each.mm[0], mm[1] - each.mm[1]) < 1);
      if (mark) mark.error_px = Math.hypot(...answer.errors_px[index]);
    });
    replace(this.lens, answer.notes.map((note) => h('p', null, note)));
    if (Object.keys(answer.set).length) changes.propose(answer.set, true);
    if (as_found) toast('The field was found.', 'Check that the drawn lines lie on those of the pitch, then apply.');
  }

  again = false;

  update() {
    const values = changes.values;
    const size = values ? `${values.field.length_mm / 2} ${values.field.width_mm / 2}` : '';
    if (!this.picture.dragged && !this.busy && (size !== this.size || this.revision !== store.config?.revision || !this.marks.length)) {
      const kept = size !== this.size ? this.marks.map(({ px }) => px) : null;
      this.makeMarks();
      // The corners stay where they are in the picture when the sizes change.
      if (kept) this.marks.forEach((mark, index) => { mark.px = kept[index] ?? mark.px; });
    }
    this.form.update();
    this.proofs.show(this.proof());
    this.list();
  }

  /** @private */
  list() {
    const rows = this.marks.filter((mark) => mark.px);
    replace(this.errors, rows.map((mark) => h('tr', null, h('td', null, mark.name), h('td', { class: 'n' }, `${number(mark.px?.[0], 1)}, ${number(mark.px?.[1], 1)}`),
      h('td', { class: mark.error_px !== null && mark.error_px > GOOD_ERROR_PX ? 'n warn' : 'n' }, mark.error_px === null ? '–' : `${number(mark.error_px, 2)} px`))));
  }

  /** @param {CanvasRenderingContext2D} context @param {import('./types').ViewTransform} view */
  layer(context, view) {
    const values = changes.values;
    // What is proposed, while nothing is dragged; else what the hand says.
    const proposed = changes.draft.has('geometry.points') || [...changes.draft.keys()].some((key) => key.startsWith('geometry'));
    const model = store.model;
    const camera = values && model && proposed && !this.picture.dragged
      ? Camera.through(values.geometry.points, values.geometry.distortion, model.picture.width, model.picture.height) : this.camera();
    if (values && camera) {
      context.lineWidth = 1.5;
      for (const line of fieldLines(values.field)) {
        path(context, view, subdivided(line, 40).map((point) => camera.toImage(point)));
        context.strokeStyle = 'rgba(0, 0, 0, 0.6)';
        context.lineWidth = 3.5;
        context.stroke();
        context.strokeStyle = '#7dffb0';
        context.lineWidth = 1.5;
        context.stroke();
      }
    }
    for (const mark of this.marks) {
      const at = mark.px ?? camera?.toImage(mark.mm);
      if (!at) continue;
      const [x, y] = place(view, at);
      const is_corner = !mark.name.startsWith('halfway');
      context.beginPath();
      context.arc(x, y, is_corner ? 9 : 6, 0, 2 * Math.PI);
      context.strokeStyle = '#000';
      context.lineWidth = 4;
      context.stroke();
      context.strokeStyle = mark.px ? '#7dffb0' : 'rgba(255, 255, 255, 0.7)';
      context.lineWidth = 2;
      context.stroke();
      if (is_corner) label(context, mark.error_px === null ? mark.name : `${mark.name} ${number(mark.error_px, 1)} px`, x, y + (y < 60 ? 22 : -22), { font: '500 12px system-ui, sans-serif' });
    }
  }

  /** @returns {import('./setup-view.js').Proof} */
  proof() {
    if (this.rms_px !== null) {
      return this.rms_px < GOOD_ERROR_PX
        ? { level: 'good', what: `lines lie on lines, ${number(this.rms_px, 2)} px`, todo: 'Look at the goals and the middle too: the drawn lines must lie on those of the pitch.' }
        : { level: 'bad', what: `${number(this.rms_px, 1)} px off`, todo: 'Drag the point with the largest error, or check length and width.' };
    }
    const tops = store.status?.tops;
    if (tops && !tops.problem && tops.votes > 100) return { level: 'good', what: `robots measure ${number(100 * tops.scale, 1)} %`, todo: 'The drawn lines must lie on those of the pitch.' };
    return { level: 'open', what: 'not checked', todo: 'The drawn lines must lie on those of the pitch. Find the field, or drag its corners.' };
  }
}
