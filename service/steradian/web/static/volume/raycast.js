// @ts-check
/** Maximum-intensity projection of a volume by ray casting in WebGL 2.
 *
 * The projection is orthographic, so that lengths are equal everywhere in the image. Depth (z) points down in a side
 * view; x, y and z form a right-handed system.
 *
 * @typedef {[number, number, number]} Triple
 * @typedef {{values: Float32Array | Uint8Array, shape: Triple, origin: Triple, spacing: Triple}} Block  mm; C order
 * @typedef {{camera: Triple, clip: readonly number[], window: [number, number], colours: Uint32Array, depth: boolean,
 *            depths: [number, number], fit?: readonly number[],
 *            transfer?: {gamma: number, log: number}, twoSided?: boolean, smooth?: boolean}} RenderSettings
 *   camera: azimuth and elevation in degrees, zoom; clip: shares of the extent, x from and to, then y and z;
 *   depths: in mm, at the ends of the hues; fit: shares of the extent that fill the image;
 *   transfer: exponent, and range of a logarithmic scale in dB (0: none); twoSided: to either side of the colours' middle
 */

const VERTEX = `#version 300 es
precision highp float;
out vec2 place;
void main() {
  place = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(place, 0.0, 1.0);
}`;

// The texture axes are those of the volume in reverse order, because the last axis runs fastest: .zyx below.
const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler3D;
in vec2 place;
out vec4 colour;
uniform sampler3D volume;
uniform sampler2D colours;
uniform vec3 right, up, along, extent, first, last, offset;
uniform vec2 half_size, window, depths;
uniform float spacing;
uniform bool by_depth, two_sided;
uniform float gamma, decibels;

float transfer(float share) {
  return decibels > 0.0 ? max(0.0, 1.0 + 20.0 / decibels * log2(max(share, 1e-9)) / log2(10.0)) : pow(share, gamma);
}

void main() {
  vec3 start = offset + right * (place.x * half_size.x) + up * (place.y * half_size.y);
  vec3 low = (first - 0.5) * extent, high = (last - 0.5) * extent;
  vec3 slope = mix(along, vec3(1e-9), lessThan(abs(along), vec3(1e-9)));
  vec3 one = (low - start) / slope, other = (high - start) / slope;
  vec3 nearer = min(one, other), farther = max(one, other);
  float enter = max(nearer.x, max(nearer.y, nearer.z)), leave = min(farther.x, min(farther.y, farther.z));
  colour = vec4(0.0, 0.0, 0.0, 1.0);
  if (enter >= leave) return;
  int steps = int(clamp(ceil((leave - enter) / spacing), 1.0, 2048.0));
  float length = (leave - enter) / float(steps);
  float greatest = -1e30, depth = 0.0;
  for (int n = 0; n < steps; n++) {
    vec3 at = (start + along * (enter + (float(n) + 0.5) * length)) / extent + 0.5;
    float value = texture(volume, at.zyx).r;
    if (value > greatest) { greatest = value; depth = at.z; }
  }
  float share = clamp((greatest - window.x) / (window.y - window.x), 0.0, 1.0);
  share = two_sided ? 0.5 + 0.5 * sign(share - 0.5) * transfer(abs(2.0 * share - 1.0)) : transfer(share);
  if (by_depth) {
    float hue = clamp((depth - depths.x) / (depths.y - depths.x), 0.0, 1.0);
    colour = vec4(texture(colours, vec2(hue * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb * share, 1.0);
  } else {
    colour = vec4(texture(colours, vec2(share * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb, 1.0);
  }
}`;

const MARGIN = 1.04;

/** Return the camera directions in the volume: right, up, and into the image.
 *
 * @param {number} azimuth    degrees; 0 is the view along −y with x to the right
 * @param {number} elevation  degrees; 90 is the view from the sensors into the depth
 * @returns {{right: Triple, up: Triple, along: Triple}}
 */
export function directions(azimuth, elevation) {
  const [ca, sa] = [Math.cos((azimuth * Math.PI) / 180), Math.sin((azimuth * Math.PI) / 180)];
  const [ce, se] = [Math.cos((elevation * Math.PI) / 180), Math.sin((elevation * Math.PI) / 180)];
  return { right: [ca, sa, 0], up: [sa * se, -ca * se, -ce], along: [sa * ce, -ca * ce, se] };
}

/** @param {Triple} a  @param {readonly number[]} b */
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Return extent (mm, between outer edges) and centre of a volume.
 *
 * @param {{shape: Triple, origin: Triple, spacing: Triple}} block
 */
export function extentOf({ shape, origin, spacing }) {
  const extent = /** @type {Triple} */ (shape.map((count, n) => count * spacing[n]));
  const middle = /** @type {Triple} */ (origin.map((first, n) => first + ((shape[n] - 1) / 2) * spacing[n]));
  return { extent, middle };
}

/** Return the projection of positions (mm) to pixels, and the scale in pixels per mm.
 *
 * @param {{shape: Triple, origin: Triple, spacing: Triple}} block
 * @param {Triple} camera
 * @param {{width: number, height: number}} size
 * @param {readonly number[]} fit  shares of the extent as a clip, whose box is in the middle and fills the image
 */
export function projection(block, camera, size, fit = [0, 1, 0, 1, 0, 1]) {
  const { extent, middle } = extentOf(block);
  const { right, up, along } = directions(camera[0], camera[1]);
  const diagonal = Math.hypot(...extent.map((one, n) => one * (fit[2 * n + 1] - fit[2 * n])));
  const offset = /** @type {Triple} */ (extent.map((one, n) => one * ((fit[2 * n] + fit[2 * n + 1]) / 2 - 0.5)));
  const scale = (Math.min(size.width, size.height) / (MARGIN * diagonal)) * camera[2];
  /** @param {readonly number[]} place */
  const project = (place) => {
    const from = place.map((value, n) => value - middle[n] - offset[n]);
    return {
      x: size.width / 2 + scale * dot(right, from),
      y: size.height / 2 - scale * dot(up, from),
      away: dot(along, from),
    };
  };
  return { scale, project, extent, middle, offset, right, up, along };
}

/** Ray caster on a canvas, created by {@link createRaycaster}. */
class Raycaster {
  /** @param {HTMLCanvasElement} canvas  @param {WebGL2RenderingContext} gl */
  constructor(canvas, gl) {
    this.canvas = canvas;
    this.gl = gl;
    /** @type {Block | null} */
    this.block = null;
    this.unit = 1;
    this.initialise();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.initialise();
      if (this.block) this.upload(this.block);
      canvas.dispatchEvent(new CustomEvent("restored"));
    });
  }

  /** Compile the shaders and create the textures. */
  initialise() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of /** @type {[number, string][]} */ ([
      [gl.VERTEX_SHADER, VERTEX],
      [gl.FRAGMENT_SHADER, FRAGMENT],
    ])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`WebGL cannot render the 3-D view: ${gl.getProgramInfoLog(program)}`);
    }
    this.program = program;
    this.volume = gl.createTexture();
    this.colours = gl.createTexture();
    gl.useProgram(program);
    gl.uniform1i(this.uniform("volume"), 0);
    gl.uniform1i(this.uniform("colours"), 1);
    gl.bindVertexArray(gl.createVertexArray());
  }

  /** @param {string} name */
  uniform(name) {
    return this.gl.getUniformLocation(/** @type {WebGLProgram} */ (this.program), name);
  }

  /** Upload a volume to the GPU: bytes unchanged, other values as half floats within ±1.
   *
   * @param {Block} block
   */
  upload(block) {
    const { gl } = this;
    this.block = block;
    const [nx, ny, nz] = block.shape;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_3D, this.volume ?? null);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    if (block.values instanceof Uint8Array) {
      this.unit = 255;
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8, nz, ny, nx, 0, gl.RED, gl.UNSIGNED_BYTE, block.values);
    } else {
      this.unit = maxMagnitude(block.values) || 1;
      const scaled = block.values.map((value) => value / this.unit);
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.R16F, nz, ny, nx, 0, gl.RED, gl.FLOAT, scaled);
    }
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
      [gl.TEXTURE_WRAP_R, gl.CLAMP_TO_EDGE],
    ]) gl.texParameteri(gl.TEXTURE_3D, name, value);
  }

  /** Draw the volume at the size of the canvas.
   *
   * @param {RenderSettings} shown  window in units of the volume's values
   */
  draw(shown) {
    const { gl, block, canvas } = this;
    if (!block || gl.isContextLost()) return;
    const { width, height } = canvas;
    const { scale, extent, middle, offset, right, up, along } = projection(block, shown.camera, canvas, shown.fit);
    gl.viewport(0, 0, width, height);
    gl.useProgram(this.program ?? null);
    this.uploadColours(shown.colours);
    gl.uniform3fv(this.uniform("right"), right);
    gl.uniform3fv(this.uniform("up"), up);
    gl.uniform3fv(this.uniform("along"), along);
    gl.uniform3fv(this.uniform("extent"), extent);
    gl.uniform3fv(this.uniform("offset"), offset);
    gl.uniform3fv(this.uniform("first"), [0, 2, 4].map((n) => shown.clip[n]));
    gl.uniform3fv(this.uniform("last"), [1, 3, 5].map((n) => shown.clip[n]));
    gl.uniform2f(this.uniform("half_size"), width / 2 / scale, height / 2 / scale);
    gl.uniform2fv(this.uniform("window"), shown.window.map((value) => value / this.unit));
    const top = middle[2] - extent[2] / 2;
    gl.uniform2fv(this.uniform("depths"), shown.depths.map((depth) => (depth - top) / extent[2]));
    gl.uniform1f(this.uniform("spacing"), Math.min(...block.spacing));
    gl.uniform1i(this.uniform("by_depth"), Number(shown.depth));
    gl.uniform1i(this.uniform("two_sided"), Number(shown.twoSided ?? false));
    gl.uniform1f(this.uniform("gamma"), shown.transfer?.gamma ?? 1);
    gl.uniform1f(this.uniform("decibels"), shown.transfer?.log ?? 0);
    const filter = shown.smooth ?? true ? gl.LINEAR : gl.NEAREST;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_3D, this.volume ?? null);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, name, filter);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** @param {Uint32Array} colours  table of 256 */
  uploadColours(colours) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.colours ?? null);
    const bytes = new Uint8Array(colours.buffer, colours.byteOffset, 1024);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  }

  /** Free the GPU memory. */
  dispose() {
    this.gl.deleteTexture(this.volume ?? null);
    this.gl.deleteTexture(this.colours ?? null);
    this.block = null;
  }
}

/** @param {Float32Array} values */
function maxMagnitude(values) {
  let maxValue = 0;
  for (const value of values) maxValue = Math.max(maxValue, Math.abs(value));
  return maxValue;
}

/** Create a ray caster on a canvas; null without WebGL 2.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {{keep?: boolean}} options  keep: preserve the image for later reads
 */
export function createRaycaster(canvas, { keep: preserve = false } = {}) {
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: preserve });
  return gl ? new Raycaster(canvas, gl) : null;
}

/** Return the edges of the clipping box with their axes.
 *
 * @param {{shape: Triple, origin: Triple, spacing: Triple}} block
 * @param {readonly number[]} clip
 */
export function boxEdges(block, clip) {
  const { extent, middle } = extentOf(block);
  const place = (/** @type {number[]} */ corner) =>
    corner.map((side, n) => middle[n] + (clip[2 * n + side] - 0.5) * extent[n]);
  const result = [];
  for (let n = 0; n < 8; n++) {
    const corner = [n & 1, (n >> 1) & 1, (n >> 2) & 1];
    for (const axis of [0, 1, 2]) {
      if (corner[axis]) continue;
      result.push({ axis, from: place(corner), to: place(corner.map((side, m) => (m === axis ? 1 : side))) });
    }
  }
  return result;
}
