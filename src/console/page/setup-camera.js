// Step 1: the camera delivers sharp pictures, neither too dark nor too bright, at its full rate.

import { changes } from './changes.js';
import { h, number, replace, say } from './dom.js';
import { measure } from './setup-measure.js';
import { jobButton, keysForm, proofBox } from './setup-parts.js';
import { store } from './store.js';

/** @typedef {import('./types').Picture} Picture */

/** Share of pixels at the upper end above which colours are lost. */
const MOST_CLIPPED = 0.005;
const MEASURE_EVERY_MS = 250;

export class CameraStep {
  name = 'camera';
  title = 'Camera';

  constructor() {
    this.proofs = proofBox();
    this.histogram = h('canvas', { class: 'histogram', role: 'img', 'aria-label': 'Histogram of red, green and blue' });
    this.clipping = h('p', { class: 'soft' });
    this.sharpness = h('b', null, '–');
    this.best = 0;
    this.best_text = h('span', { class: 'soft' });
    this.device = h('p', { class: 'soft' });
    this.controls = h('div', { class: 'stack' });
    this.form = keysForm([
      { key: 'camera.fps', title: 'Frame rate', unit: 'fps', min: 1 },
      { key: 'camera.exposure_us', title: 'Exposure', unit: 'µs', min: 0, step: 100 },
      { key: 'camera.bayer_order', title: 'Colour filter', choices: ['rggb', 'grbg', 'gbrg', 'bggr'], unit: '' },
      { key: 'camera.mirrored', title: 'Seen through a mirror', unit: '' },
    ]);
    /** @type {ReturnType<typeof measure>|null} */
    this.measured = null;
    this.measured_ms = 0;
    this.side = h('div', null,
      h('h1', null, 'Camera'), this.proofs.element,
      h('h2', null, 'Brightness'), this.histogram, this.clipping,
      h('h2', null, 'Sharpness'),
      h('p', { class: 'row' }, this.sharpness, this.best_text, h('span', { class: 'grow' }), jobButton('Start again', '…', async () => { this.best = 0; }, false)),
      h('p', { class: 'soft' }, 'Turn the lens until the number is highest. Robots and lines in the picture help.'),
      h('h2', null, 'Settings'), this.form.element, this.controls, this.device,
    );
  }

  /** @param {Picture} picture */
  take(picture) {
    const now = performance.now();
    if (picture.header.format !== 'raw' || now - this.measured_ms < MEASURE_EVERY_MS) return;
    this.measured_ms = now;
    const { width, height, bayer } = picture.header;
    this.measured = measure(picture.bytes, width, height, bayer);
    this.best = Math.max(this.best, this.measured.sharpness);
    this.drawHistogram();
    say(this.sharpness, number(this.measured.sharpness, 1));
    say(this.best_text, `best so far ${number(this.best, 1)}`);
    const [red, green, blue] = this.measured.clipped.map((share) => `${number(100 * share, 1)} %`);
    say(this.clipping, `At the upper end: red ${red}, green ${green}, blue ${blue} of the pixels.`);
  }

  /** @private */
  drawHistogram() {
    const canvas = this.histogram;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [width * devicePixelRatio, height * devicePixelRatio];
    const context = canvas.getContext('2d');
    if (!context || !this.measured) return;
    context.scale(devicePixelRatio, devicePixelRatio);
    const { histograms } = this.measured;
    // Square roots: a floor of one brightness would hide everything else.
    const most = Math.sqrt(Math.max(...histograms.map((histogram) => Math.max(...histogram))));
    ['#ff6b6b', '#56cf94', '#5cb0ff'].forEach((color, channel) => {
      context.beginPath();
      histograms[channel].forEach((count, value) => context.lineTo(4 + (value / 255) * (width - 8), height - 4 - (Math.sqrt(count) / most) * (height - 12)));
      context.strokeStyle = color;
      context.lineWidth = 1.5;
      context.stroke();
      context.fillStyle = color;
      context.font = '600 11px system-ui, sans-serif';
      context.fillText('RGB'[channel], width - 36 + channel * 11, 14);
    });
  }

  update() {
    this.form.update();
    this.proofs.show(this.proof());
    const { device } = store.status?.camera ?? {};
    say(this.device, device ? `${device.description}. ${device.problem}` : `Source ${store.status?.source ?? ''}. Another camera: touchline cameras, then touchline run --source …`);
    this.updateControls();
  }

  /** The driver's settings that the configuration names. @private */
  updateControls() {
    const camera = changes.values?.camera;
    if (!camera) return;
    const named = [...Object.entries(camera.v4l2.controls).map(([name, value]) => /** @type {const} */ (['camera.v4l2.controls', name, value])),
      ...Object.entries(camera.genicam.features).map(([name, value]) => /** @type {const} */ (['camera.genicam.features', name, value]))];
    if (this.controls.childElementCount === named.length || this.controls.contains(document.activeElement)) return;
    replace(this.controls, named.map(([section, name, value]) => h('div', { class: 'form' },
      h('label', null, name),
      h('input', {
        type: typeof value === 'number' ? 'number' : typeof value === 'boolean' ? 'checkbox' : 'text', value: String(value), checked: value === true,
        onchange: (/** @type {Event} */ event) => {
          const input = /** @type {HTMLInputElement} */ (event.target);
          const set = typeof value === 'number' ? Number(input.value) : typeof value === 'boolean' ? input.checked : input.value;
          const whole = section === 'camera.v4l2.controls' ? changes.values?.camera.v4l2.controls : changes.values?.camera.genicam.features;
          changes.propose({ [section]: { ...whole, [name]: set } });
        },
      }))));
  }

  /** @returns {import('./setup-view.js').Proof} */
  proof() {
    const status = store.status;
    if (!status) return { level: 'open', what: 'waiting for the camera' };
    const { device, fps } = status.camera;
    if (device?.problem) return { level: 'bad', what: device.problem };
    if (status.rate.captured < 0.9 * fps && status.elapsed_s > 3) {
      return { level: 'bad', what: `${number(status.rate.captured)} of ${number(fps)} frames a second`, todo: 'A shorter exposure or a smaller picture lets the camera go faster.' };
    }
    if (this.measured && Math.max(...this.measured.clipped) > MOST_CLIPPED) return { level: 'bad', what: 'parts of the picture are too bright', todo: 'Shorten the exposure until nothing is at the upper end but lamps.' };
    if (this.measured && this.measured.mean < 12) return { level: 'bad', what: 'the picture is too dark', todo: 'Lengthen the exposure or raise the gain.' };
    return { level: 'good', what: `${number(status.rate.captured)} frames a second` };
  }
}
