// Raw sensor pictures on the graphics processor: exact integer texels, bilinear demosaic as in section 4.1
// of the paper, and the classes of colour boxes on top, so that bounds can be dragged with the result
// in view. One draw per picture; nothing is asked of the server.

/** @typedef {import('./types').Picture} Picture */
/** @typedef {import('./types').ColorBox} ColorBox */

const MOST_COLORS = 32;

const VERTEX = `#version 300 es
in vec2 at;
void main() { gl_Position = vec4(at, 0.0, 1.0); }`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D raw;
uniform ivec2 size;
uniform ivec2 red;        // column and row of red in each 2×2 cell
uniform vec3 gains;
uniform int colors;
uniform vec3 low[${MOST_COLORS}];
uniform vec3 high[${MOST_COLORS}];
uniform vec4 second[${MOST_COLORS}];   // hue from, to (degrees; from < -1: none), saturation from, to
uniform vec3 looks[${MOST_COLORS}];
uniform float shade;      // how much pixels without a class are darkened; 0 shows the picture alone
out vec4 color;

float texel(ivec2 at) {
  // Mirrored at the border by whole cells, so that the colours of the filter stay in place.
  ivec2 inside = ivec2(at.x < 0 ? at.x + 2 : at.x >= size.x ? at.x - 2 : at.x, at.y < 0 ? at.y + 2 : at.y >= size.y ? at.y - 2 : at.y);
  return float(texelFetch(raw, inside, 0).r);
}

vec3 rgb(ivec2 at) {
  ivec2 cell = (at - red) & 1;
  float here = texel(at);
  float row = (texel(at - ivec2(1, 0)) + texel(at + ivec2(1, 0))) / 2.0;
  float column = (texel(at - ivec2(0, 1)) + texel(at + ivec2(0, 1))) / 2.0;
  float diagonal = (texel(at + ivec2(-1, -1)) + texel(at + ivec2(1, -1)) + texel(at + ivec2(-1, 1)) + texel(at + ivec2(1, 1))) / 4.0;
  if (cell == ivec2(0, 0)) return vec3(here, (row + column) / 2.0, diagonal);
  if (cell == ivec2(1, 1)) return vec3(diagonal, (row + column) / 2.0, here);
  return cell.x == 1 ? vec3(row, here, column) : vec3(column, here, row);
}

bool admits(int index, vec3 c) {
  if (any(lessThan(c, low[index])) || any(greaterThan(c, high[index]))) return false;
  vec4 look = second[index];
  if (look.x < -1.0) return true;
  float sum = c.r + c.g + c.b;
  float saturation = sum > 0.0 ? 1.0 - 3.0 * min(c.r, min(c.g, c.b)) / sum : 0.0;
  if (saturation < look.z || saturation > look.w) return false;
  float hue = degrees(atan(1.7320508 * (c.g - c.b), 2.0 * c.r - c.g - c.b));
  if (hue < 0.0) hue += 360.0;
  return look.x <= look.y ? hue >= look.x && hue <= look.y : hue >= look.x || hue <= look.y;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.x, size.y - 1 - int(gl_FragCoord.y));
  vec3 c = rgb(at);
  vec3 shown = c / 255.0;
  if (shade > 0.0) {
    vec3 lit = min(floor(c * gains + 0.5), vec3(255.0));
    int found = -1;
    for (int index = 0; index < colors; ++index) if (admits(index, lit)) { found = index; break; }
    float grey = dot(shown, vec3(0.3, 0.59, 0.11));
    shown = found < 0 ? mix(shown, vec3(grey * 0.45), shade) : looks[found] / 255.0;
  }
  color = vec4(shown, 1.0);
}`;

/** Column and row of red in a 2×2 cell. @param {string} order */
export function redOf(order) {
  return [['rggb', [0, 0]], ['grbg', [1, 0]], ['gbrg', [0, 1]], ['bggr', [1, 1]]].find(([name]) => name === order.toLowerCase())?.[1] ?? [0, 0];
}

export class BayerView {
  constructor() {
    this.canvas = document.createElement('canvas');
    this.gl = this.canvas.getContext('webgl2', { antialias: false, preserveDrawingBuffer: true });
    /** Whether this browser can do it. */
    this.works = false;
    /** @type {ColorBox[]} */
    this.colors = [];
    this.shade = 0;
    this.gains = [1, 1, 1];
    /** @type {Picture|null} */
    this.picture = null;
    if (this.gl) this.works = this.prepare(this.gl);
  }

  /** @private @param {WebGL2RenderingContext} gl */
  prepare(gl) {
    const program = gl.createProgram();
    for (const [kind, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
      const shader = gl.createShader(kind);
      if (!shader) return false;
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return false;
    gl.useProgram(program);
    this.program = program;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
    const at = gl.getAttribLocation(program, 'at');
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 2, gl.FLOAT, false, 0, 0);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    return true;
  }

  /** @param {Picture} picture raw */
  load(picture) {
    const gl = this.gl;
    if (!gl || !this.works) return;
    const { width, height } = picture.header;
    if (this.canvas.width !== width || this.canvas.height !== height) {
      [this.canvas.width, this.canvas.height] = [width, height];
      gl.viewport(0, 0, width, height);
    }
    this.picture = picture;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8UI, width, height, 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, picture.bytes);
    this.draw();
  }

  /** Draws the loaded picture again, after colours have changed. */
  draw() {
    const { gl, program, picture } = this;
    if (!gl || !program || !picture) return;
    const place = (/** @type {string} */ name) => gl.getUniformLocation(program, name);
    const { width, height, bayer } = picture.header;
    gl.uniform2i(place('size'), width, height);
    const red = redOf(bayer);
    gl.uniform2i(place('red'), Number(red[0]), Number(red[1]));
    gl.uniform3fv(place('gains'), this.gains);
    const colors = this.colors.slice(0, MOST_COLORS);
    gl.uniform1i(place('colors'), colors.length);
    if (colors.length) {
      gl.uniform3fv(place('low'), colors.flatMap((color) => [color.red[0], color.green[0], color.blue[0]]));
      gl.uniform3fv(place('high'), colors.flatMap((color) => [color.red[1], color.green[1], color.blue[1]]));
      gl.uniform4fv(place('second'), colors.flatMap((color) => (color.hue_deg || color.saturation
        ? [...(color.hue_deg ?? [0, 360]), ...(color.saturation ?? [0, 1])] : [-2, 0, 0, 1])));
      gl.uniform3fv(place('looks'), colors.flatMap((color) => color.looks));
    }
    gl.uniform1f(place('shade'), this.shade);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
