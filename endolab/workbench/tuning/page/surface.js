// A surface in 3D, to be turned.
import { add, size_to } from "./drawing.js";
import { lay_grid } from "./grid.js";
import { CAMERA, corners_of, EDGES, OUTSIDE, view_of } from "./projection.js";

const ARROWS = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, -5], ArrowDown: [0, 5] };
// What is known of each corner, and of how many numbers.
const KNOWN = { rays: 3, far: 1, at: 2 };
// Who looks is at the origin; z is away.
const VERTEX = `#version 300 es
uniform mat4 eye, lens;
layout(location = 0) in vec3 ray; layout(location = 1) in float far;
layout(location = 2) in vec2 lies; out vec3 place, away; out vec2 at;
void main() {
  away = mat3(eye) * ray;
  place = (eye * vec4(far * ray, 1.0)).xyz;
  at = lies;
  gl_Position = lens * vec4(place, 1.0);
}`;
// Relief by a lamp that the viewer holds. From outside, what the endoscope sees at more than 85° is
// left open: it joins the two sides of a fold.
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture; uniform vec4 ink; uniform float least;
in vec3 place, away; in vec2 at; out vec4 colour;
void main() {
  colour = ink;
  if (ink.a > 0.0) return;
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  if (abs(dot(normal, normalize(away))) < least) discard;
  float lit = 0.45 + 0.55 * abs(dot(normal, normalize(place)));
  colour = vec4(pow(texture(picture, at).rgb, vec3(0.7)) * lit, 1.0);
}`;

export class Surface {
  pose = [...OUTSIDE];
  inside = false;
  wipe = 0;

  /** @type {(host: Element, on_turn: () => void) => void} */
  constructor(host, on_turn) {
    this.turned = on_turn;
    this.canvas = add("canvas", "", host, { tabIndex: 0 });
    host.prepend(this.canvas);
    this.canvas.dataset.lmSuppressShortcuts = "true"; // arrows turn, they do not go to another cell
    this.gl = this.canvas.getContext("webgl2", { antialias: false });
    const textContent = "This browser has no WebGL 2, by which the surface is drawn.";
    if (!this.gl) return void add("div", "endolab-empty", host, { textContent });
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
    gl.linkProgram(program);
    gl.useProgram(program);
    // Nothing is seen from behind, so that a tube lies open.
    for (const what of [gl.DEPTH_TEST, gl.CULL_FACE, gl.SCISSOR_TEST]) gl.enable(what);
    this.uniform = (kind, name, ...value) =>
      gl[`uniform${kind}`](gl.getUniformLocation(program, name), ...value);
    this.layers = [0, 1, 2].map(() => this.add_layer()); // the surface, A, and the box
    this.fill_layer(2, { far: Array(8).fill(1), at: Array(16).fill(0), corners: EDGES });
  }

  add_layer() {
    const { gl } = this, corners = gl.createBuffer();
    const layer = { texture: gl.createTexture(), array: gl.createVertexArray(), corners, count: 0 };
    gl.bindVertexArray(layer.array);
    Object.entries(KNOWN).forEach(([name, size], i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, layer[name] = gl.createBuffer());
      gl.vertexAttribPointer(i, size, gl.FLOAT, false, 0, 0);
      gl.enableVertexAttribArray(i);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
    gl.bindTexture(gl.TEXTURE_2D, layer.texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    return layer;
  }

  fill_layer(which, { corners, ...known }) {
    const { gl } = this, layer = this.layers[which];
    for (const name in known) {
      gl.bindBuffer(gl.ARRAY_BUFFER, layer[name]);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(known[name]), gl.DYNAMIC_DRAW);
    }
    if (!corners) return;
    gl.bindVertexArray(layer.array);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(corners), gl.STATIC_DRAW);
    layer.count = corners.length;
  }

  // The hand
  follow(canvas) {
    const turn = (first, [right, down], scale = 1) => {
      const { pose } = this;
      pose[first] += scale * right;
      pose[first + 1] += scale * down;
      pose[1] = Math.max(-89, Math.min(89, pose[1]));
      this.turned();
    };
    canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = ({ pointerId, shiftKey, movementX, movementY }) => {
      if (!canvas.hasPointerCapture(pointerId)) return;
      const how = shiftKey ? 1 / canvas.clientHeight : 0.5;
      turn(shiftKey ? 3 : 0, [movementX, movementY], how);
    };
    canvas.ondblclick = () => this.look(this.inside);
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas) return; // who only scrolls by is not held up
      event.preventDefault();
      this.pose[2] *= 1.002 ** -event.deltaY;
      this.turned();
    }, { passive: false });
    canvas.onkeydown = (event) => {
      if (!(event.key in ARROWS)) return;
      event.preventDefault();
      turn(0, ARROWS[event.key]);
    };
  }

  /** Goes back to the first view, from the camera or from outside. @param {boolean} inside */
  look(inside) {
    this.inside = inside;
    this.pose = [...(inside ? CAMERA : OUTSIDE)];
    this.turned();
  }

  /** Lays a grid over every few pixels, torn where it is cut. @param {0 | 1} [which]  1 is A */
  lay(frame, step, which = 0) {
    const layer = this.layers[which], { cuts } = frame;
    if (layer.cuts === cuts && layer.step === step) return;
    const { pixels, behind, shares, ...known } = lay_grid(frame, step);
    Object.assign(layer, { pixels, behind, shares, cuts, step });
    this.fill_layer(which, known);
  }

  /** Lays a picture on it. */
  dress(canvas, which = 0) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.layers[which].texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
  }

  /** Takes distances, and the box [low, high] that holds them. */
  show(map, box, which = 0) {
    const { pixels, behind, shares } = this.layers[which], far = new Float32Array(pixels.length);
    for (let p = 0; p < far.length; p++) {
      const own = map[pixels[p]];
      far[p] = own + (shares[p] * (own - map[behind[p]]) || 0); // nan beyond the mask
    }
    this.box = box;
    this.fill_layer(which, { far });
    this.fill_layer(2, { rays: corners_of(box).flat() });
  }

  view(wide) { return view_of(this.box, this.pose, this.inside, wide); }

  /** Draws it, and A up to a share of the width, the last one where none is given. */
  draw(fineness = 1, wipe = this.wipe) {
    this.wipe = wipe;
    const { gl, canvas, uniform } = this, ratio = fineness * Math.min(devicePixelRatio, 2);
    const sides = [canvas.clientWidth, canvas.clientHeight];
    const [width, height] = sides.map((side) => Math.round(ratio * side));
    if (!gl || !width || !height || !this.box) return;
    size_to(canvas, width, height);
    const view = this.view(width / height);
    for (const name in view) uniform("Matrix4fv", name, false, view[name].toFloat32Array());
    uniform("1f", "least", this.inside ? 0 : 0.087);
    gl.viewport(0, 0, width, height);
    gl.scissor(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const draw_layer = ({ texture, array, count }, mode, left, right, ...ink) => {
      gl.scissor(left, 0, right - left, height);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.bindVertexArray(array);
      uniform("4f", "ink", ...ink);
      if (count && right > left) gl.drawElements(mode, count, gl.UNSIGNED_INT, 0);
    };
    const edge = Math.round(wipe * width), [surface, kept, box_lines] = this.layers;
    draw_layer(surface, gl.TRIANGLES, edge, width, 0, 0, 0, 0);
    draw_layer(kept, gl.TRIANGLES, 0, edge, 0, 0, 0, 0);
    if (!this.inside) draw_layer(box_lines, gl.LINES, 0, width, 0.5, 0.5, 0.5, 1);
  }

  /** Where a point is in the panel, px to the right and down. @param {number[]} point */
  place(point) {
    const { clientWidth, clientHeight } = this.canvas;
    const { eye, lens } = this.view(clientWidth / clientHeight);
    const { x, y, w } = lens.multiply(eye).transformPoint(new DOMPoint(...point));
    return w > 0 && [clientWidth * (1 + x / w) / 2, clientHeight * (1 - y / w) / 2];
  }

  free() { this.gl?.getExtension("WEBGL_lose_context")?.loseContext(); } // a page may have sixteen
}
