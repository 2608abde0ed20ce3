// A web socket that comes back by itself. The browser asks for each message when it has used the last
// one (a credit), so nothing queues anywhere: a slow line gets fewer messages, not old ones.

import { socketAddress } from './api.js';

const SHORTEST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 2000;
/** A server without news answers each second; silence for this long means that the line is dead. */
const SILENCE_MS = 5000;

export class CreditSocket {
  /**
   * @param {string} path
   * @param {() => object|null} request the next credit, or null while nothing is wanted
   * @param {(data: any) => void|Promise<void>} receive
   * @param {(connected: boolean) => void} [changed]
   */
  constructor(path, request, receive, changed) {
    this.path = path;
    this.request = request;
    this.receive = receive;
    this.changed = changed ?? (() => {});
    /** @type {WebSocket|null} */
    this.socket = null;
    this.connected = false;
    this.pause_ms = SHORTEST_PAUSE_MS;
    this.asked = false;
    this.heard_ms = 0;
    this.closed = false;
    this.watch = setInterval(() => this.check(), 1000);
    this.open();
  }

  /** @private */
  open() {
    if (this.closed) return;
    const socket = new WebSocket(socketAddress(this.path));
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    this.asked = false;
    this.heard_ms = performance.now();
    socket.onopen = () => {
      this.pause_ms = SHORTEST_PAUSE_MS;
      this.say(true);
      this.next();
    };
    socket.onmessage = async (event) => {
      this.heard_ms = performance.now();
      if (socket !== this.socket) return;
      await this.receive(event.data);
      this.asked = false;
      // Not faster than the display, and not at all while the page is hidden.
      requestAnimationFrame(() => this.next());
    };
    socket.onclose = () => {
      if (socket !== this.socket) return;
      this.socket = null;
      this.say(false);
      setTimeout(() => this.open(), this.pause_ms);
      this.pause_ms = Math.min(2 * this.pause_ms, LONGEST_PAUSE_MS);
    };
  }

  /** Sends a credit, unless one is on its way. */
  next() {
    if (this.asked || this.socket?.readyState !== WebSocket.OPEN) return;
    const request = this.request();
    if (!request) return;
    this.asked = true;
    this.heard_ms = performance.now();
    this.socket.send(JSON.stringify(request));
  }

  /** Ends it for good. */
  close() {
    this.closed = true;
    clearInterval(this.watch);
    this.socket?.close();
    this.socket = null;
  }

  /** @private */
  check() {
    if (this.asked && performance.now() - this.heard_ms > SILENCE_MS) {
      // A dead line may take minutes to say so.
      const socket = this.socket;
      this.socket = null;
      socket?.close();
      this.say(false);
      this.open();
    }
    this.next();
  }

  /** @private @param {boolean} connected */
  say(connected) {
    if (connected === this.connected) return;
    this.connected = connected;
    this.changed(connected);
  }
}
