// A surface in 3D, to be turned.
import { add } from "./drawing.js";
import { lay_grid } from "./grid.js";
import { box_between, CAMERA, dot, EDGES, OUTSIDE, view_of } from "./projection.js";
import { FRAGMENT, VERTEX } from "./shaders.js";

const ARROWS = { ArrowLeft: [0, -5], ArrowRight: [0, 5], ArrowUp: [1, -5], ArrowDown: [1, 5] };

export class Surface {
  /** @type {(host: Element, on_turn: () => void) => void} */
  constructor(host, on_turn) {
    this.pose = [...OUTSIDE];
    this.inside = false;
    this.wipe = 0;
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
    gl.enable(gl.SCISSOR_TEST);
    this.box_lines = gl.createBuffer();
    this.layers = [0, 1].map(() => this.add_layer());
  }

  add_layer() {
    const { gl } = this, layer = { texture: gl.createTexture(), count: 0 };
    for (const name of ["rays", "far", "places", "corners"]) layer[name] = gl.createBuffer();
    gl.bindTexture(gl.TEXTURE_2D, layer.texture);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    }
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    return layer;
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
   * Lays a grid over every few pixels, torn where the surface is cut; of layer 0, or of A, 1.
   * @type {(frame: {rays: Float32Array, cuts: Uint8Array, width: number, height: number},
   *   step: number, which?: 0 | 1) => void}
   */
  lay(frame, step, which = 0) {
    const { gl } = this, { pixels, rays, at, corners } = lay_grid(frame, step);
    const layer = Object.assign(this.layers[which], { pixels, count: corners.length });
    this.fill(gl.ARRAY_BUFFER, layer.rays, rays, gl.STATIC_DRAW);
    this.fill(gl.ARRAY_BUFFER, layer.places, at, gl.STATIC_DRAW);
    this.fill(gl.ELEMENT_ARRAY_BUFFER, layer.corners, corners, gl.STATIC_DRAW);
  }

  /** Lays a picture on it. */
  dress(canvas, which = 0) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.layers[which].texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
  }

  /** Takes distances, and the box [low, high] that holds them. */
  show(map, box, which = 0) {
    const { gl } = this, { pixels, far } = this.layers[which];
    const distances = new Float32Array(pixels.length);
    for (let p = 0; p < pixels.length; p++) distances[p] = map[pixels[p]];
    this.box = box_between(box);
    this.fill(gl.ARRAY_BUFFER, far, distances);
    const lines = new Float32Array(EDGES.flatMap((i) => this.box.corners[i]));
    this.fill(gl.ARRAY_BUFFER, this.box_lines, lines);
  }

  view(wide) { return view_of(this.box, this.pose, this.inside, wide); }

  /** Draws it, and A up to a share of the width, the last one where none is given. */
  draw(fineness = 1, wipe = this.wipe) {
    this.wipe = wipe;
    const { gl, canvas, at } = this;
    const ratio = fineness * Math.min(window.devicePixelRatio || 1, 2);
    const sides = [canvas.clientWidth, canvas.clientHeight];
    const [width, height] = sides.map((side) => Math.round(ratio * side));
    if (!gl || !width || !height || !this.box) return;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const { seen, eye } = this.view(width / height);
    gl.viewport(0, 0, width, height);
    gl.scissor(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(at.seen, false, seen);
    gl.uniform3fv(at.eye, eye);
    gl.uniform1f(at.least, this.inside ? 0 : 0.087);
    gl.uniform4f(at.ink, 0, 0, 0, 0);
    const edge = Math.round(wipe * width), [layer, other] = this.layers;
    this.draw_layer(layer, edge, width - edge, height);
    this.draw_layer(other, 0, edge, height);
    gl.scissor(0, 0, width, height);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.box_lines);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.disableVertexAttribArray(1);
    gl.disableVertexAttribArray(2);
    gl.vertexAttrib1f(1, 1);
    gl.uniform4f(at.ink, 0.5, 0.5, 0.5, 1);
    if (!this.inside) gl.drawArrays(gl.LINES, 0, EDGES.length);
  }

  draw_layer({ texture, rays, far, places, corners, count }, left, width, height) {
    const { gl } = this;
    gl.scissor(left, 0, width, height);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    [[rays, 3], [far, 1], [places, 2]].forEach(([buffer, size], i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.vertexAttribPointer(i, size, gl.FLOAT, false, 0, 0);
      gl.enableVertexAttribArray(i);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
    if (width && count) gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
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
