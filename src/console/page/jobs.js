// Jobs of the set-up worker, asked for and put into the page's terms. None of them changes anything.

import { post } from './api.js';
import { Camera } from './geometry.js';
import { outlineAt } from './overlay.js';
import { store } from './store.js';

/** @typedef {import('./types').Pair} Pair */
/** @typedef {{px: Pair, mm: Pair}} Point */
/** @typedef {Record<string, any>} KeySet keys of the configuration with values */

/** The server runs one job at a time; those of this page wait here. @type {Promise<any>} */
let last_job = Promise.resolve();
let running = 0;

/** Whether a job of this page runs or waits. */
export const isWorking = () => running > 0;

/** @param {string} kind @param {object} request @returns {Promise<any>} */
function job(kind, request) {
  running += 1;
  const answer = last_job.then(() => post(`/api/setup/${kind}`, request));
  last_job = answer.catch(() => null).finally(() => { running -= 1; });
  return answer;
}

/**
 * Where the pitch is seen, without any marks.
 * @param {KeySet} set assumed changes
 * @returns {Promise<{found: boolean, why: string|null, agreement: number, points: Point[]}>}
 */
export const findField = (set) => job('find-field', { set });

/**
 * The camera that shows these points.
 * @param {{points: Point[], as_found: boolean, use_lines: boolean, set: KeySet, camera_height_mm?: number}} request
 * @returns {Promise<{set: KeySet, rms_px: number, worst: number, worst_px: number, errors_px: Pair[], notes: string[],
 *   lines: {used: boolean, text: string, share: number|null, rms_px: number|null}|null}>}
 */
export async function calibrate(request) {
  const answer = await job('calibrate', request);
  const notes = [answer.lines?.text, answer.lens, answer.camera, ...(answer.hints ?? [])].filter(Boolean);
  return { ...answer, notes };
}

/**
 * Colours from live frames and from what was clicked.
 * @param {{frames: number, samples: {color: string, px: Pair}[], set: KeySet}} request
 * @returns {Promise<{set: KeySet, found: number, configured: number, balls: number, frames: number, summary: string}>}
 */
export async function learn(request) {
  const answer = await job('learn', request);
  const frames = Math.max(1, answer.frames);
  return { ...answer, found: answer.robots / frames, configured: answer.of_robots / frames };
}

/**
 * What is found in a live frame with these changes.
 * @param {KeySet} set @param {import('./types').Values} values the configuration with them
 * @returns {Promise<{detections: import('./types').Detections, has_ball: boolean, runs: number[]}>}
 */
export async function tryOut(set, values) {
  const answer = await job('try', { set, frames: 1 });
  const model = store.model;
  const camera = model && Camera.through(values.geometry.points, values.geometry.distortion, model.picture.width, model.picture.height);
  const robots = answer.seen.map((/** @type {any} */ robot) => {
    /** @type {Pair[]} */
    let outline_px = [];
    if (camera && model && robot.heading_deg !== null) {
      // The preview's camera sees the floor; the centre is where the program sees the top.
      const [fx, fy] = camera.toImage(robot.pose_mm);
      outline_px = outlineAt(model, robot.pose_mm, robot.heading_deg).map((point) => {
        const [x, y] = camera.toImage(point);
        return [x - fx + robot.center_px[0], y - fy + robot.center_px[1]];
      });
    }
    const name = robot.identity === null ? robot.team : `${robot.team} ${robot.identity}`;
    return { ...robot, name, outline_px, heading_px: null };
  });
  const rejected = answer.rejected.map((/** @type {any} */ candidate) => ({ ...candidate, color: null }));
  /** @type {number[]} */
  const runs = [...answer.runs];
  // The program's runs end behind their last pixel, the page's with it.
  for (let at = 2; at < runs.length; at += 4) runs[at] -= 1;
  return {
    detections: { seq: answer.seq, revision: 0, time_s: 0, regions: [], robots, balls: [], rejected }, has_ball: answer.balls > 0, runs,
  };
}
