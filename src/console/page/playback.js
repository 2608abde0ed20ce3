// Where in a recording the user is: one frame at a time is asked for, and of several wishes only the last counts.

import { ApiError } from './api.js';
import { toast } from './toast.js';

/** @typedef {import('./archive.js').At} At */
/** @typedef {import('./types').RecordedFrame} RecordedFrame */

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
/** Trails are this long. */
const PAST_S = 2;

export class Playback {
  /**
   * @param {import('./archive.js').Archive} archive
   * @param {import('./types').Opened} about
   * @param {() => {scale: 1|2|4, runs: boolean}} wish
   * @param {(frame: RecordedFrame, bytes: Uint8Array<ArrayBuffer>) => Promise<void>} show
   */
  constructor(archive, about, wish, show) {
    this.archive = archive;
    this.about = about;
    this.wish = wish;
    this.show = show;
    /** @type {RecordedFrame} */
    this.frame = { index: 0, time_s: 0 };
    this.speed = 1;
    /** Where and when playing began. @type {{time_s: number, now_ms: number}|null} */
    this.playing = null;
    /** @type {At|null} */
    this.next = null;
    this.busy = false;
    this.closed = false;
    /** Frames shown before, for trails. @type {RecordedFrame[]} */
    this.past = [];
  }

  /** @param {At} at */
  go(at) {
    this.next = at;
    if (this.playing && 'time_s' in at) this.playing = { time_s: at.time_s, now_ms: performance.now() };
    else this.pause();
    this.run();
  }

  /** Frames on, or back. @param {number} by */
  step(by) {
    this.pause();
    const wished = this.next && 'index' in this.next ? this.next.index : this.frame.index;
    this.go({ index: Math.max(0, Math.min(this.about.frames - 1, wished + by)) });
  }

  play() {
    const at_end = this.frame.index >= this.about.frames - 1;
    this.playing = { time_s: at_end ? 0 : this.frame.time_s, now_ms: performance.now() };
    this.run();
  }

  pause() {
    this.playing = null;
  }

  /** @param {number} speed */
  setSpeed(speed) {
    this.speed = speed;
    if (this.playing) this.play();
  }

  close() {
    this.closed = true;
    this.pause();
  }

  /** The same frame again, with other wishes. */
  refresh() {
    if (!this.next) this.next = { index: this.frame.index };
    this.run();
  }

  /** What is due now: the last wish, or where playing has come to. @private @returns {At|null} */
  due() {
    const next = this.next;
    this.next = null;
    if (next || !this.playing) return next;
    const time_s = this.playing.time_s + ((performance.now() - this.playing.now_ms) / 1000) * this.speed;
    if (time_s < this.about.seconds) return { time_s };
    this.pause();
    return { index: this.about.frames - 1 };
  }

  /** @private */
  async run() {
    if (this.busy) return;
    this.busy = true;
    try {
      for (let at = this.due(); at && !this.closed; at = this.due()) {
        const { frame, bytes } = await this.archive.frame(at, this.wish());
        if (this.closed) break;
        this.remember(frame);
        this.frame = frame;
        await this.show(frame, bytes);
        // Not faster than the display, nor than the recording has frames.
        await new Promise((resolve) => { requestAnimationFrame(resolve); });
        const period_ms = (1000 * this.about.seconds) / Math.max(1, this.about.frames - 1) / this.speed;
        if (this.playing && period_ms > 20) await new Promise((resolve) => { setTimeout(resolve, period_ms / 2); });
      }
    } catch (error) {
      this.pause();
      if (!(error instanceof ApiError)) throw error;
      if (!this.closed) toast(error);
    } finally {
      this.busy = false;
    }
    if (this.next && !this.closed) this.run();
  }

  /** @private @param {RecordedFrame} frame */
  remember(frame) {
    const near = (/** @type {RecordedFrame} */ other) => other.time_s < frame.time_s && frame.time_s - other.time_s < PAST_S;
    this.past = [...this.past.filter((other) => near(other) && other.index !== this.frame.index), ...(near(this.frame) ? [this.frame] : [])];
  }

  /** Worlds before the shown frame. */
  worlds() {
    return [...this.past, this.frame].flatMap(({ world }) => (world ? [world] : []));
  }
}
