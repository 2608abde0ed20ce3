// Questions to the server, one at a time. What keeps flowing is in live.js and pictures.js.

/** An answer that is not the one hoped for, in the server's words. */
export class ApiError extends Error {
  /** @param {number} status @param {any} error */
  constructor(status, error) {
    super(error?.message ?? `The console answered with status ${status}.`);
    /** HTTP status; 0 when there was no answer. */
    this.status = status;
    /** @type {string|null} */
    this.help = error?.help ?? null;
    /** @type {number|null} */
    this.line = error?.line ?? null;
    /** @type {string|null} */
    this.key = error?.key ?? null;
  }

  /** The message with its place. */
  text() {
    const place = [this.key, this.line === null ? null : `line ${this.line}`].filter(Boolean).join(', ');
    return place ? `${place}: ${this.message}` : this.message;
  }
}

/** @param {string} path @param {RequestInit} [options] @returns {Promise<any>} */
async function ask(path, options) {
  let response;
  try {
    response = await fetch(path, { cache: 'no-store', ...options });
  } catch {
    throw new ApiError(0, { message: 'The console does not answer.', help: 'Wait until the connection is back, then try again.' });
  }
  const body = await response.json().catch(() => null);
  if (!response.ok) throw new ApiError(response.status, body?.error);
  return body;
}

/** @param {string} path */
export const get = (path) => ask(path);

/** An answer that is not JSON. @param {string} path @returns {Promise<ArrayBuffer>} */
export async function getBytes(path) {
  let response;
  try {
    response = await fetch(path, { cache: 'no-store' });
    if (response.ok) return await response.arrayBuffer();
  } catch {
    throw new ApiError(0, { message: 'The console does not answer.', help: 'Wait until the connection is back, then try again.' });
  }
  const body = await response.json().catch(() => null);
  throw new ApiError(response.status, body?.error);
}

/** @param {string} path @param {object} [body] */
export function post(path, body = {}) {
  return ask(path, { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(body) });
}

/** Address of a web socket of this server. @param {string} path */
export function socketAddress(path) {
  return `${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}${path}`;
}
