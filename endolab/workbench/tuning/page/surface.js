// A surface in 3D, to be turned.
import { add } from "./drawing.js";
import { lay_grid } from "./grid.js";
import { box_between, CAMERA, dot, EDGES, OUTSIDE, view_of } from "./projection.js";

const VERTEX = `#version 300 es
uniform mat4 seen; in vec3 ray; in float far; in vec2 lies; out vec3 place; out vec2 at;
void main() {
  place = far * ray;
  at = lies;
  gl_Position = seen * vec4(place, 1.0);
}`;
// Relief by a lamp that the viewer holds. From outside, what the endoscope sees at more than 85° is
// left open: it joins the two sides of a fold.
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture; uniform vec3 eye; uniform vec4 ink; uniform float least;
in vec3 place; in vec2 at; out vec4 colour;
void main() {
  colour = ink;
  if (ink.a > 0.0) return;
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  if (abs(dot(normal, normalize(place))) < least) discard;
  float lit = 0.45 + 0.55 * abs(dot(normal, normalize(eye - place)));
  colour = vec4(pow(texture(picture, at).rgb, vec3(0.7)) * lit, 1.0);
}`;
const ARROWS = { ArrowLeft: [0, -5], ArrowRight: [0, 5], ArrowUp: [1, -5], ArrowDown: [1, 5] };

export class Surface {
  /** @type {(host: Element, on_turn: () => void) => void} */
  constructor(host, on_turn) {
    this.pose = [...OUTSIDE];
    this.inside = false;
    this.canvas = add("canvas", "", host, { tabIndex: 0 });
    this.canvas.dataset.lmSuppressShortcuts = "true"; // arrows turn, they do not go to another cell
    this.gl = this.canvas.getContext("webgl2", { antialias: false });
    if (!this.gl) {
      const textContent = "This browser has no WebGL 2, by which the surface is drawn.";
      add("div", "endolab-empty", host, { textContent });
      return;
    }
    this.turned = on_turn;
    this.prepare();
    this.follow(this.canvas);
  }

  prepare() {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    ["ray", "far", "lies"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
    gl.linkProgram(program);
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE); // nothing is seen from behind, so that a tube lies open
    const names = ["seen", "eye", "ink", "least"];
    this.at = Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(program, name)]));
    const buffers = ["rays", "far", "places", "corners", "box_lines"];
    for (const name of buffers) this[name] = gl.createBuffer();
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    }
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  }

  // The hand
  follow(canvas) {
    const turn = (first, right, down) => {
      const { pose } = this;
      pose[first] += right;
      pose[first + 1] += down;
      pose[1] = Math.max(-89, Math.min(89, pose[1]));
      this.turned();
    };
    canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = ({ pointerId, shiftKey, movementX, movementY }) => {
      if (!canvas.hasPointerCapture(pointerId)) return;
      const [first, scale] = shiftKey ? [3, 1 / canvas.clientHeight] : [0, 0.5];
      turn(first, scale * movementX, scale * movementY);
    };
    canvas.ondblclick = () => this.look(this.inside);
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas) return; // who only scrolls by is not held up
      event.preventDefault();
      this.pose[2] *= 1.002 ** -event.deltaY;
      this.turned();
    }, { passive: false });
    canvas.onkeydown = (event) => {
      const [way, by] = ARROWS[event.key] ?? [];
      if (!by) return;
      event.preventDefault();
      turn(0, way ? 0 : by, way ? by : 0);
    };
  }

  /** Goes back to the first view, from the camera or from outside. @param {boolean} inside */
  look(inside) {
    this.inside = inside;
    this.pose = [...(inside ? CAMERA : OUTSIDE)];
    this.turned();
  }

  fill(kind, buffer, content, usage = this.gl.DYNAMIC_DRAW) {
    this.gl.bindBuffer(kind, buffer);
    this.gl.bufferData(kind, content, usage);
  }

  /**
   * Lays a grid over every few pixels, torn where the surface is cut.
   * @type {(frame: {rays: Float32Array, cuts: Uint8Array, width: number, height: number},
   *   step: number) => void}
   */
  lay(frame, step) {
    const { gl } = this, { pixels, rays, at, corners } = lay_grid(frame, step);
    this.pixels = pixels;
    this.count = corners.length;
    this.fill(gl.ARRAY_BUFFER, this.rays, rays, gl.STATIC_DRAW);
    this.fill(gl.ARRAY_BUFFER, this.places, at, gl.STATIC_DRAW);
    this.fill(gl.ELEMENT_ARRAY_BUFFER, this.corners, corners, gl.STATIC_DRAW);
  }

  /** Lays a picture on it. */
  dress(canvas) {
    const { gl } = this;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
  }

  /** Takes distances, and the box [low, high] that holds them. */
  show(map, box) {
    const { gl } = this;
    this.box = box_between(box);
    this.fill(gl.ARRAY_BUFFER, this.far, Float32Array.from(this.pixels, (pixel) => map[pixel]));
    const lines = new Float32Array(EDGES.flatMap((i) => this.box.corners[i]));
    this.fill(gl.ARRAY_BUFFER, this.box_lines, lines);
  }

  view(wide) { return view_of(this.box, this.pose, this.inside, wide); }

  draw(fineness = 1) {
    const { gl, canvas, at } = this;
    const ratio = fineness * Math.min(window.devicePixelRatio || 1, 2);
    const sides = [canvas.clientWidth, canvas.clientHeight];
    const [width, height] = sides.map((side) => Math.round(ratio * side));
    if (!gl || !width || !height || !this.box) return;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const { seen, eye } = this.view(width / height);
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(at.seen, false, seen);
    gl.uniform3fv(at.eye, eye);
    gl.uniform1f(at.least, this.inside ? 0 : 0.087);
    gl.uniform4f(at.ink, 0, 0, 0, 0);
    [[this.rays, 3], [this.far, 1], [this.places, 2]].forEach(([buffer, count], i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.vertexAttribPointer(i, count, gl.FLOAT, false, 0, 0);
      gl.enableVertexAttribArray(i);
    });
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.box_lines);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.disableVertexAttribArray(1);
    gl.disableVertexAttribArray(2);
    gl.vertexAttrib1f(1, 1);
    gl.uniform4f(at.ink, 0.5, 0.5, 0.5, 1);
    if (!this.inside) gl.drawArrays(gl.LINES, 0, EDGES.length);
  }

  /** Where a point is in the panel, shares to the right and down. @param {number[]} point */
  place(point) {
    const { seen } = this.view(this.canvas.clientWidth / this.canvas.clientHeight);
    const rows = [0, 1, 2, 3].map((row) => [0, 4, 8, 12].map((k) => seen[k + row]));
    const [x, y, , w] = rows.map((row) => dot([...point, 1], row));
    return w > 0 ? [(1 + x / w) / 2, (1 - y / w) / 2] : undefined;
  }

  free() { this.gl?.getExtension("WEBGL_lose_context")?.loseContext(); } // a page may have sixteen
}
