// What a raw picture says about exposure and focus. Pure.

import { redOf } from './bayer.js';

const CLIPPED_FROM = 254;
/** Samples are compared at this distance: neighbours of the same colour of the filter. */
const CELL = 2;

/**
 * Histogram and sharpness of a raw Bayer picture.
 * @param {Uint8Array} bytes @param {number} width @param {number} height @param {string} order
 */
export function measure(bytes, width, height, order) {
  const histograms = [new Uint32Array(256), new Uint32Array(256), new Uint32Array(256)];
  const red = redOf(order);
  let [edges, sum, count] = [0, 0, 0];
  for (let y = 0; y + CELL < height; y += 1) {
    for (let x = 0; x + CELL < width; x += 1) {
      const at = y * width + x;
      const value = bytes[at];
      const [cx, cy] = [(x - Number(red[0])) & 1, (y - Number(red[1])) & 1];
      histograms[cx === cy ? (cx ? 2 : 0) : 1][value] += 1;
      if (cx === cy) continue;
      // Green has the most samples.
      edges += (bytes[at + CELL] - value) ** 2 + (bytes[at + CELL * width] - value) ** 2;
      sum += value;
      count += 1;
    }
  }
  const clipped = histograms.map((histogram) => {
    let over = 0;
    for (let value = CLIPPED_FROM; value < 256; value += 1) over += histogram[value];
    return over / Math.max(1, histogram.reduce((total, each) => total + each, 0));
  });
  // Independent of brightness, so that exposure does not pass for focus.
  const mean = sum / Math.max(1, count);
  return { histograms, clipped, sharpness: count && mean > 1 ? (100 * Math.sqrt(edges / (2 * count))) / mean : 0, mean };
}
