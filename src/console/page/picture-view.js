// The camera's picture with layers drawn over it: zoom to the pointer, pan, pick, drag points under a
// magnifier. The picture and what is drawn on it are two canvases, so that the overlay stays at the
// display's rate while pictures may come slower.

import { BayerView } from './bayer.js';
import { onceAFrame } from './dom.js';

/** @typedef {import('./types').Pair} Pair */
/** @typedef {import('./types').Picture} Picture */
/** @typedef {import('./types').ViewTransform} ViewTransform */
/** @typedef {(context: CanvasRenderingContext2D, view: ViewTransform) => void} Layer */
/** @typedef {{at: () => Pair, move: (to: Pair) => void, done?: () => void}} Handle */

const LARGEST_SCALE = 40;
const GRAB_PX = 16;
const LOUPE_PX = 180;
const LOUPE_SCALE = 8;

export class PictureView extends HTMLElement {
  constructor() {
    super();
    this.under = document.createElement('canvas');
    this.over = document.createElement('canvas');
    /** Layers, drawn in this order. @type {Layer[]} */
    this.layers = [];
    /** Points that can be dragged. @type {Handle[]} */
    this.handles = [];
    /** Size of the whole picture, pixels. */
    this.size = { width: 640, height: 480 };
    /** @type {ViewTransform} */
    this.view = { scale: 1, left: 0, top: 0 };
    /** Number of the shown frame; 0 before the first. */
    this.seq = 0;
    this.fit_scale = 1;
    this.is_fitted = true;
    this.bayer = new BayerView();
    /** @type {ImageBitmap|HTMLCanvasElement|null} */
    this.image = null;
    /** Picture point under the pointer. @type {Pair|null} */
    this.pointer = null;
    /** @type {Handle|null} */
    this.dragged = null;
    /** @type {Map<number, {x: number, y: number}>} */
    this.touches = new Map();
    this.drawAll = onceAFrame(() => {
      this.drawPicture();
      this.drawOverlay();
    });
    this.redraw = onceAFrame(() => this.drawOverlay());
  }

  connectedCallback() {
    if (!this.under.isConnected) this.append(this.under, this.over);
    this.tabIndex = 0;
    this.setAttribute('role', 'img');
    this.setAttribute('aria-label', 'Picture of the camera with detections');
    this.resizes = new ResizeObserver(() => this.resized());
    this.resizes.observe(this);
    this.listen();
  }

  disconnectedCallback() {
    this.resizes?.disconnect();
  }

  /** Shows a picture of any scale. @param {Picture} picture */
  async show(picture) {
    const { header, bytes } = picture;
    this.seq = header.seq;
    const size = { width: header.width * header.scale, height: header.height * header.scale };
    if (header.format === 'raw') {
      this.bayer.load(picture);
      this.image = this.bayer.canvas;
    } else {
      const image = await createImageBitmap(new Blob([bytes], { type: 'image/jpeg' })).catch(() => null);
      if (!image) return;
      if (this.image instanceof ImageBitmap) this.image.close();
      this.image = image;
    }
    this.setSize(size);
    this.drawAll();
  }

  /** @param {{width: number, height: number}} size */
  setSize(size) {
    // A half-size picture of an odd size lacks a column.
    if (Math.abs(size.width - this.size.width) < 4 && Math.abs(size.height - this.size.height) < 4) return;
    this.size = size;
    this.fit();
  }

  fit() {
    const [width, height] = [this.clientWidth, this.clientHeight];
    this.fit_scale = Math.min(width / this.size.width, height / this.size.height) || 1;
    this.is_fitted = true;
    const scale = this.fit_scale;
    this.view = { scale, left: (width - this.size.width * scale) / 2, top: (height - this.size.height * scale) / 2 };
    this.moved();
  }

  /** How much of its resolution the picture needs. @returns {1|2|4} */
  neededScale() {
    const zoom = this.view.scale / this.fit_scale;
    if (zoom > 1.3) return 1;
    return this.view.scale * devicePixelRatio < 0.25 ? 4 : 2;
  }

  /** @param {number} factor @param {number} x CSS pixels, of the point that stays @param {number} y */
  zoom(factor, x = this.clientWidth / 2, y = this.clientHeight / 2) {
    const scale = Math.min(LARGEST_SCALE, Math.max(this.fit_scale, this.view.scale * factor));
    if (scale <= this.fit_scale * 1.001) return this.fit();
    const { left, top } = this.view;
    const ratio = scale / this.view.scale;
    this.view = { scale, left: x - (x - left) * ratio, top: y - (y - top) * ratio };
    this.is_fitted = false;
    this.keepInside();
  }

  /** @param {number} dx @param {number} dy */
  pan(dx, dy) {
    this.view = { ...this.view, left: this.view.left + dx, top: this.view.top + dy };
    this.keepInside();
  }

  /** @private */
  keepInside() {
    const { scale } = this.view;
    const within = (/** @type {number} */ at, /** @type {number} */ room, /** @type {number} */ size) =>
      size <= room ? (room - size) / 2 : Math.min(0, Math.max(room - size, at));
    this.view.left = within(this.view.left, this.clientWidth, this.size.width * scale);
    this.view.top = within(this.view.top, this.clientHeight, this.size.height * scale);
    this.moved();
  }

  /** @private */
  moved() {
    this.drawAll();
    this.dispatchEvent(new CustomEvent('view'));
  }

  /** Shows the same part as another one of the same size. @param {PictureView} other */
  follow(other) {
    this.is_fitted = other.is_fitted;
    this.view = { ...other.view };
    this.drawAll();
  }

  /** @param {number} x CSS pixels @param {number} y @returns {Pair} */
  toPicture(x, y) {
    return [(x - this.view.left) / this.view.scale - 0.5, (y - this.view.top) / this.view.scale - 0.5];
  }

  /** @private */
  resized() {
    for (const canvas of [this.under, this.over]) {
      canvas.width = Math.round(this.clientWidth * devicePixelRatio);
      canvas.height = Math.round(this.clientHeight * devicePixelRatio);
    }
    const zoom = this.is_fitted ? 0 : this.view.scale / this.fit_scale;
    this.fit();
    if (zoom) this.zoom(zoom);
    this.drawPicture();
    this.drawOverlay();
  }

  /** @private @param {HTMLCanvasElement} canvas */
  context(canvas) {
    const context = canvas.getContext('2d');
    if (!context) return null;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, this.clientWidth, this.clientHeight);
    return context;
  }

  /** @private */
  drawPicture() {
    const context = this.context(this.under);
    if (!context || !this.image) return;
    context.imageSmoothingEnabled = this.view.scale < 4;
    const { scale, left, top } = this.view;
    context.drawImage(this.image, left, top, this.size.width * scale, this.size.height * scale);
  }

  /** @private */
  drawOverlay() {
    const context = this.context(this.over);
    if (!context) return;
    for (const layer of this.layers) {
      context.save();
      layer(context, this.view);
      context.restore();
    }
    if (this.dragged) this.drawLoupe(context, this.dragged.at());
  }

  /** A magnifier in a corner away from the point. @private @param {CanvasRenderingContext2D} context @param {Pair} point */
  drawLoupe(context, point) {
    if (!this.image) return;
    const { scale, left, top } = this.view;
    const on_left = (point[0] + 0.5) * scale + left < this.clientWidth / 2;
    const [x, y] = [on_left ? this.clientWidth - LOUPE_PX - 12 : 12, 12];
    const span = LOUPE_PX / LOUPE_SCALE;
    const per_px = this.image.width / this.size.width;
    context.save();
    context.beginPath();
    context.rect(x, y, LOUPE_PX, LOUPE_PX);
    context.fillStyle = '#000';
    context.fill();
    context.clip();
    context.imageSmoothingEnabled = false;
    const [from_x, from_y] = [(point[0] + 0.5 - span / 2) * per_px, (point[1] + 0.5 - span / 2) * per_px];
    context.drawImage(this.image, from_x, from_y, span * per_px, span * per_px, x, y, LOUPE_PX, LOUPE_PX);
    // The lines that are drawn with the point show where they come to lie.
    const view = { scale: LOUPE_SCALE, left: x + LOUPE_PX / 2 - (point[0] + 0.5) * LOUPE_SCALE, top: y + LOUPE_PX / 2 - (point[1] + 0.5) * LOUPE_SCALE };
    for (const layer of this.layers) {
      context.save();
      layer(context, view);
      context.restore();
    }
    context.restore();
    context.strokeStyle = '#fff';
    context.lineWidth = 2;
    context.strokeRect(x, y, LOUPE_PX, LOUPE_PX);
    context.lineWidth = 1;
    context.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(x + LOUPE_PX / 2 + 5 * dx, y + LOUPE_PX / 2 + 5 * dy);
      context.lineTo(x + LOUPE_PX / 2 + 26 * dx, y + LOUPE_PX / 2 + 26 * dy);
    }
    context.stroke();
  }

  /** @private @param {number} x @param {number} y */
  handleAt(x, y) {
    let [nearest, distance] = [/** @type {Handle|null} */ (null), GRAB_PX];
    for (const handle of this.handles) {
      const [px, py] = handle.at();
      const apart = Math.hypot((px + 0.5) * this.view.scale + this.view.left - x, (py + 0.5) * this.view.scale + this.view.top - y);
      if (apart < distance) [nearest, distance] = [handle, apart];
    }
    return nearest;
  }

  /** @private */
  listen() {
    if (this.listens) return;
    this.listens = true;
    /** @type {{x: number, y: number, moved: boolean, handle: Handle|null, offset: Pair}|null} */
    let press = null;
    const place = (/** @type {MouseEvent} */ event) => {
      const box = this.getBoundingClientRect();
      return { x: event.clientX - box.left, y: event.clientY - box.top };
    };
    this.addEventListener('wheel', (event) => {
      event.preventDefault();
      const { x, y } = place(event);
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.002)), x, y);
    }, { passive: false });
    this.addEventListener('pointerdown', (event) => {
      const at = place(event);
      this.touches.set(event.pointerId, at);
      this.setPointerCapture(event.pointerId);
      const handle = event.button === 0 ? this.handleAt(at.x, at.y) : null;
      const grabbed = handle ? handle.at() : [0, 0];
      const [px, py] = this.toPicture(at.x, at.y);
      press = { ...at, moved: false, handle, offset: [grabbed[0] - px, grabbed[1] - py] };
      this.dragged = handle;
      if (handle) this.redraw();
    });
    this.addEventListener('pointermove', (event) => {
      const at = place(event);
      this.point(this.toPicture(at.x, at.y));
      const before = this.touches.get(event.pointerId);
      if (!before || !press) {
        this.classList.toggle('grabs', Boolean(this.handleAt(at.x, at.y)));
        return;
      }
      if (this.touches.size === 2) {
        const other = [...this.touches].find(([id]) => id !== event.pointerId)?.[1] ?? before;
        const apart = (/** @type {{x: number, y: number}} */ a) => Math.max(10, Math.hypot(a.x - other.x, a.y - other.y));
        this.zoom(apart(at) / apart(before), (at.x + other.x) / 2, (at.y + other.y) / 2);
        press.moved = true;
      } else if (press.handle) {
        const [px, py] = this.toPicture(at.x, at.y);
        press.moved = true;
        press.handle.move([px + press.offset[0], py + press.offset[1]]);
        this.redraw();
      } else if (press.moved || Math.hypot(at.x - press.x, at.y - press.y) > 4) {
        press.moved = true;
        this.pan(at.x - before.x, at.y - before.y);
      }
      this.touches.set(event.pointerId, at);
    });
    const up = (/** @type {PointerEvent} */ event) => {
      this.touches.delete(event.pointerId);
      const at = place(event);
      if (press?.handle) press.handle.done?.();
      else if (press && !press.moved && event.type === 'pointerup') {
        this.dispatchEvent(new CustomEvent('pick', { detail: { px: this.toPicture(at.x, at.y), x: at.x, y: at.y } }));
      }
      if (!this.touches.size) press = null;
      this.dragged = null;
      this.redraw();
    };
    this.addEventListener('pointerup', up);
    this.addEventListener('pointercancel', up);
    this.addEventListener('pointerleave', () => this.point(null));
    this.addEventListener('dblclick', () => this.fit());
    this.addEventListener('keydown', (event) => {
      const step = 60;
      /** @type {Record<string, () => void>} */
      const keys = {
        '+': () => this.zoom(1.3), '=': () => this.zoom(1.3), '-': () => this.zoom(1 / 1.3), 0: () => this.fit(),
        ArrowUp: () => this.pan(0, step), ArrowDown: () => this.pan(0, -step),
      };
      if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  /** @private @param {Pair|null} point */
  point(point) {
    const [x, y] = point ?? [-1, -1];
    const inside = x >= -0.5 && y >= -0.5 && x < this.size.width - 0.5 && y < this.size.height - 0.5;
    this.pointer = point && inside ? point : null;
    this.dispatchEvent(new CustomEvent('point'));
  }
}

customElements.define('tl-picture', PictureView);
