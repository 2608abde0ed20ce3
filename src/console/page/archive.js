// A recording on the server, and questions about it.

import { get, getBytes, post } from './api.js';

/** @typedef {import('./types').Model} Model */
/** @typedef {import('./types').RecordedFrame} RecordedFrame */
/** @typedef {{index: number}|{time_s: number}|{difference_after: number}|{difference_before: number}} At */
/**
 * Another configuration: of a preset, of a file, another one of the recording, or that of the group with changes.
 * @typedef {{preset: string}|{text: {name: string, text: string}}|{revision: number}|{group: {set: Record<string, any>}}} With
 */

/** Most parts of the time line. */
const BINS = 600;

export class Archive {
  /** @param {string} place @param {string} name */
  constructor(place, name) {
    this.name = name;
    this.base = `/api/recordings/${encodeURIComponent(place)}/${encodeURIComponent(name)}`;
    /** By revision. @type {Map<number, Model>} */
    this.models = new Map();
  }

  /** @returns {Promise<import('./types').Opened>} */
  open() {
    return get(this.base);
  }

  /** @param {number} frames of the recording: no part of the time line without one @returns {Promise<import('./types').Survey>} */
  survey(frames) {
    return get(`${this.base}/survey?bins=${Math.min(BINS, frames)}`);
  }

  /**
   * A frame with everything found on it, and its picture.
   * @param {At} at @param {{scale: 1|2|4, runs: boolean}} wish
   * @returns {Promise<{frame: RecordedFrame, bytes: Uint8Array<ArrayBuffer>}>}
   */
  async frame(at, { scale, runs }) {
    const [[name, value]] = Object.entries(at);
    const data = await getBytes(`${this.base}/frame?${name}=${value}&scale=${scale}${runs ? '&runs=1' : ''}`);
    const length = new DataView(data).getUint32(0, true);
    return { frame: JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))), bytes: new Uint8Array(data, 4 + length) };
  }

  /** What is needed to draw with a configuration of the recording. @param {number} revision */
  async model(revision) {
    let model = this.models.get(revision);
    if (!model) {
      model = /** @type {Model} */ (await get(`${this.base}/model?revision=${revision}`));
      this.models.set(revision, model);
    }
    return model;
  }

  /** The same of the configuration that is compared. @returns {Promise<Model>} */
  otherModel() {
    return get(`${this.base}/model?other=1`);
  }

  /** @param {With} other @param {number} from_s @param {number} to_s @returns {Promise<{most_frames: number}>} */
  compare(other, from_s, to_s) {
    return post(`${this.base}/compare`, { with: other, from_s, to_s });
  }

  stop() {
    return post(`${this.base}/stop`);
  }

  /** @param {'csv'|'ssl-log'} form */
  exportAddress(form) {
    return `${this.base}/export/${form}`;
  }
}
