// Pictures of the camera: asked for one at a time, the next when the last one is drawn.

import { CreditSocket } from './socket.js';
import { store } from './store.js';

/** @typedef {import('./types').Picture} Picture */
/** @typedef {import('./types').PictureHeader} PictureHeader */

/** A picture with its header: a length, a header in JSON, bytes. @param {ArrayBuffer} data @returns {Picture} */
export function parsePicture(data) {
  const length = new DataView(data).getUint32(0, true);
  /** @type {PictureHeader} */
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  return { header, bytes: new Uint8Array(data, 4 + length) };
}

/** Whether a raw picture has one byte a pixel behind a colour filter, as bayer.js needs it. @param {Picture} picture */
export function canDemosaic({ header, bytes }) {
  return /^bayer_?8$/i.test(header.pixel_format) && bytes.length >= header.width * header.height;
}

/** Asks for pictures while they are looked at. */
export class Pictures {
  /**
   * @param {() => {scale: 1|2|4, format: 'jpeg'|'raw'}|null} wanted null while paused or hidden
   * @param {(picture: Picture) => Promise<void>|void} show
   */
  constructor(wanted, show) {
    this.socket = new CreditSocket('/api/picture', wanted, async (data) => {
      const picture = parsePicture(data);
      store.history.add(picture.header.seq, { picture }, performance.now());
      await show(picture);
    });
  }

  /** After a pause. */
  go() {
    this.socket.next();
  }

  close() {
    this.socket.close();
  }
}
