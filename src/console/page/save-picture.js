// A picture with its overlay as a file of the user's computer.

import { h } from './dom.js';
import { drawScene, label } from './overlay.js';

/** Small pictures are enlarged, so that names can be read. */
const LEAST_WIDTH_PX = 1280;

/**
 * @param {import('./types').Picture|null} picture an encoded one, in full
 * @param {{scene: import('./types').Scene, model: import('./types').Model, title: string}[]} sides drawn side by side
 * @param {import('./overlay.js').Switches} on @param {string} name
 */
export async function savePicture(picture, sides, on, name) {
  const { width, height } = sides[0].model.picture;
  const scale = Math.max(1, Math.ceil(LEAST_WIDTH_PX / width));
  const canvas = h('canvas', { width: width * scale * sides.length, height: height * scale });
  const context = canvas.getContext('2d');
  if (!context) return;
  context.fillStyle = '#000';
  context.fillRect(0, 0, canvas.width, canvas.height);
  const image = picture ? await createImageBitmap(new Blob([picture.bytes], { type: 'image/jpeg' })).catch(() => null) : null;
  sides.forEach(({ scene, model, title }, index) => {
    const left = index * width * scale;
    context.save();
    context.beginPath();
    context.rect(left, 0, width * scale, height * scale);
    context.clip();
    if (image) context.drawImage(image, left, 0, width * scale, height * scale);
    drawScene(context, { scale, left, top: 0 }, scene, model, on);
    if (title) label(context, title, left + 80, 14);
    context.restore();
  });
  image?.close();
  /** @type {Blob|null} */
  const blob = await new Promise((resolve) => { canvas.toBlob(resolve, 'image/png'); });
  if (!blob) return;
  const address = URL.createObjectURL(blob);
  h('a', { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
