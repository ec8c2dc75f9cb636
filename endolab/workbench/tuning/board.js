// What a page makes of numbers: maps with bars and lines of round distances, a section, charts, a surface in 3D.
const VERTEX = `#version 300 es
uniform mat4 seen; uniform ivec2 grid; in vec3 ray; in float far; out vec3 place; out vec2 at;
void main() {
  place = far * ray;
  at = (vec2(gl_VertexID % grid.x, gl_VertexID / grid.x) + 0.5) / vec2(grid);
  gl_Position = seen * vec4(place, 1.0);
}`;
// Relief by a lamp that the viewer holds. From outside, what the endoscope sees at more than 85° is left open: it joins
// the two sides of a fold.
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture; uniform vec3 eye; uniform vec4 ink; uniform float least; in vec3 place; in vec2 at; out vec4 colour;
void main() {
  colour = ink;
  if (ink.a > 0.0) return;
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  if (abs(dot(normal, normalize(place))) < least) discard;
  colour = vec4(pow(texture(picture, at).rgb, vec3(0.7)) * (0.45 + 0.55 * abs(dot(normal, normalize(eye - place)))), 1.0);
}`;
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1, (i >> 1) & 1, i >> 2]);
const EDGES = CORNERS.flatMap((_, i) => [1, 2, 4].filter((bit) => !(i & bit)).flatMap((bit) => [i, i | bit]));
const OUTSIDE = [35, 20, 1, 0, 0], CAMERA = [0, 0, 1, 0, 0]; // degrees to the left and up, zoom, shift (panels)
// To the right, down and away, as one sees who stands to the left of the endoscope's axis and above it.
function turned([yaw, pitch]) {
  const [y, p] = [yaw, pitch].map((angle) => angle * Math.PI / 180), [cy, sy, cp, sp] = [Math.cos(y), Math.sin(y), Math.cos(p), Math.sin(p)];
  return [[cy, 0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]];
}
const dot = (a, b) => a.reduce((sum, part, i) => sum + part * b[i], 0);
const short = (value, digits = 3) => String(Number(value.toPrecision(digits)));

const add = (tag, name, to, more = {}) => {
  const node = to.appendChild(document.createElement(tag));
  if (name) node.className = name;
  return Object.assign(node, more);
};

// Round numbers between two others, some `count` of them; 1, 2 and 5 of each decade if the axis is logarithmic and long.
function rounds(low, high, count, log) {
  const found = [];
  if (log && high / low > 8) {
    const some = high / low > 10 ** (count / 2) ? [1] : [1, 2, 5];
    for (let ten = 10 ** Math.floor(Math.log10(low)); ten <= high; ten *= 10) {
      found.push(...some.map((part) => part * ten).filter((one) => one >= low * 0.999 && one <= high * 1.001));
    }
    return found;
  }
  const least = (high - low) / count, power = 10 ** Math.floor(Math.log10(least));
  const step = [1, 2, 5, 10].map((part) => part * power).find((one) => one >= least * 0.999);
  for (let i = Math.ceil(low / step - 1e-6); i * step <= high + 1e-6 * step; i++) found.push(i * step);
  return found;
}

// Lines where a map crosses levels, as pairs of points, in pixels of the map; of every pixel, or of every second one.
function isolines(map, width, height, levels, step) {
  const lines = [];
  for (let i = 0; i < height - step; i += step) for (let j = 0; j < width - step; j += step) {
    const at = i * width + j, under = at + step * width, a = map[at], b = map[at + step], c = map[under], d = map[under + step];
    const low = Math.min(a, b, c, d), high = Math.max(a, b, c, d);
    if (!(high < 1.15 * low)) continue; // nan, or a fold
    for (let k = 0; levels[k] <= high; k++) {
      const level = levels[k];
      if (level <= low) continue;
      const cross = (p, q, x, y, right, down) => { // on the side from pixel p to pixel q
        if ((p < level) === (q < level)) return;
        const share = step * (level - p) / (q - p);
        lines.push(x + 0.5 + share * right, y + 0.5 + share * down);
      };
      cross(a, b, j, i, 1, 0);
      cross(a, c, j, i, 0, 1);
      cross(b, d, j + step, i, 0, 1);
      cross(c, d, j, i + step, 1, 0);
      lines.length -= lines.length % 4; // of a saddle only whole lines
    }
  }
  return lines;
}

// z and x of a row, or y of a column, with a gap where the surface is cut.
function section(map, { rays, cuts, width, height }, is_row, index) {
  const x = [], y = [];
  for (let i = 0; i < (is_row ? width : height); i++) {
    const pixel = is_row ? index * width + i : i * width + index;
    x.push(map[pixel] * rays[3 * pixel + 2]);
    y.push(map[pixel] * rays[3 * pixel + (is_row ? 0 : 1)]);
    if (cuts[pixel] & (is_row ? 1 : 2)) { x.push(NaN); y.push(NaN); }
  }
  return { x, y };
}

// The value below which a share of the known ones lie.
function percentile(values, share) {
  const known = Float32Array.from(values).filter((value) => value === value).sort();
  return known.length ? known[Math.floor(share * (known.length - 1))] : NaN;
}

// One canvas for all maps: each is drawn from it at once.
const SCRATCH = new OffscreenCanvas(1, 1);
function as_picture(rgba, width, height) {
  if (SCRATCH.width !== width || SCRATCH.height !== height) Object.assign(SCRATCH, { width, height });
  const bytes = new Uint8ClampedArray(rgba.buffer, rgba.byteOffset, rgba.byteLength);
  SCRATCH.getContext("2d", { willReadFrequently: true }).putImageData(new ImageData(bytes, width, height), 0, 0);
  return SCRATCH;
}

// Numbers to the colours of a palette.
function coloured(values, { palette, low, high, log }, width, height) {
  const to = new Uint32Array(values.length), from = log ? Math.log(low) : low, last = palette.length - 1;
  const scale = palette.length / ((log ? Math.log(high) : high) - from);
  for (let p = 0; p < values.length; p++) {
    const value = values[p], place = ((log ? Math.log(value) : value) - from) * scale | 0;
    if (value === value) to[p] = palette[Math.max(0, Math.min(last, place))];
  }
  return as_picture(to, width, height);
}

function path(pen, xs, ys, at) {
  pen.beginPath();
  let down = false;
  for (let i = 0; i < xs.length; i++) {
    const known = Number.isFinite(xs[i]) && Number.isFinite(ys[i]);
    if (known) pen[down ? "lineTo" : "moveTo"](...at(xs[i], ys[i]));
    down = known;
  }
  pen.stroke();
}

// The colours of a scale, with round numbers beside them.
function draw_bar(pen, box, { palette, low, high, log }, ink) {
  const [left, top, wide, tall] = box, place = (value) => (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));
  if (!palette.strip) {
    palette.strip = new OffscreenCanvas(1, palette.length);
    const colours = new Uint8ClampedArray(palette.slice().reverse().buffer);
    palette.strip.getContext("2d").putImageData(new ImageData(colours, 1, palette.length), 0, 0);
  }
  pen.drawImage(palette.strip, left, top, wide, tall);
  Object.assign(pen, { fillStyle: ink, strokeStyle: ink, textAlign: "left", textBaseline: "middle", lineWidth: 1 });
  pen.strokeRect(left, top, wide, tall);
  for (const value of rounds(low, high, Math.max(2, Math.floor(tall / 30)), log)) {
    pen.fillText(short(value), left + wide + 4, top + tall * (1 - place(value)));
  }
}

// Lines and dots on axes. An axis is {label, low, high, log, ticks: [[place, text]]}; the axis at the right is likewise.
function draw_chart(pen, wide, tall, { x, y, right, lines, dots = [], rules = [], equal, down }, { ink, faint }) {
  const pad = [60, 20, right ? 34 : 10, 32], [w, h] = [wide - pad[0] - pad[2], tall - pad[1] - pad[3]];
  if (equal) { // one length for a unit along both
    const scale = Math.max((x.high - x.low) / w, (y.high - y.low) / h);
    for (const [axis, size] of [[x, w], [y, h]]) {
      const middle = (axis.low + axis.high) / 2;
      Object.assign(axis, { low: middle - scale * size / 2, high: middle + scale * size / 2 });
    }
  }
  const share = ({ low, high, log }, value) => (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));
  const to_x = (value) => pad[0] + w * share(x, value);
  const to_y = (value, axis = y) => pad[1] + h * (down ? share(axis, value) : 1 - share(axis, value));
  const ticks = (axis, count) => axis.ticks ?? rounds(axis.low, axis.high, count, axis.log).map((value) => [value, short(value)]);
  Object.assign(pen, { strokeStyle: faint, fillStyle: ink, lineWidth: 1, textAlign: "center", textBaseline: "top" });
  let end = 0; // of the last label
  for (const [value, text] of ticks(x, Math.floor(w / 50))) {
    const half = pen.measureText(text).width / 2;
    pen.strokeRect(to_x(value), pad[1], 0, h);
    if (to_x(value) - half < end) continue;
    pen.fillText(text, to_x(value), pad[1] + h + 3);
    end = to_x(value) + half + 5;
  }
  pen.fillText(x.label, pad[0] + w / 2, tall - 14);
  for (const [axis, left, align] of [[y, pad[0] - 4, "right"], ...(right ? [[right, pad[0] + w + 4, "left"]] : [])]) {
    Object.assign(pen, { textAlign: align, textBaseline: "middle" });
    for (const [value, text] of ticks(axis, Math.floor(h / 28)).filter(([value]) => axis === y || value > axis.low)) {
      if (axis === y) pen.strokeRect(pad[0], to_y(value), w, 0);
      pen.fillText(text, left, to_y(value, axis));
    }
  }
  pen.save();
  pen.translate(7, pad[1] + h / 2);
  pen.rotate(-Math.PI / 2);
  Object.assign(pen, { textAlign: "center", textBaseline: "middle" });
  pen.fillText(y.label, 0, 0);
  pen.restore();
  pen.save();
  pen.beginPath();
  pen.rect(pad[0], pad[1], w, h);
  pen.clip();
  pen.lineWidth = 2;
  for (const { x: across, y: up, colour } of rules) {
    pen.strokeStyle = colour;
    if (across !== undefined) pen.strokeRect(to_x(across), pad[1] - 2, 0, h + 4);
    else pen.strokeRect(pad[0] - 2, to_y(up), w + 4, 0);
  }
  for (const line of lines) {
    pen.strokeStyle = line.colour;
    path(pen, line.x, line.y, (a, b) => [to_x(a), to_y(b, line.right ? right : y)]);
  }
  for (const { x: across, y: up, colour, text } of dots) {
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(to_x(across), to_y(up), 4.5, 0, 7);
    pen.fill();
    Object.assign(pen, { fillStyle: ink, textAlign: "center", textBaseline: "bottom" });
    if (text) pen.fillText(text, Math.min(Math.max(to_x(across), pad[0] + 12), pad[0] + w - 12), to_y(up) - 6);
  }
  pen.restore();
  pen.textAlign = "left";
  let place = 6;
  for (const { name, colour } of lines.filter((line) => line.name)) {
    Object.assign(pen, { fillStyle: colour, textBaseline: "top" });
    pen.fillText(name, place, 2);
    place += pen.measureText(name).width + 10;
  }
  return { to_x, to_y };
}

class Surface {
  constructor(host, on_turn) {
    this.pose = [...OUTSIDE];
    this.inside = false;
    this.canvas = add("canvas", "", host, { tabIndex: 0 });
    this.canvas.dataset.lmSuppressShortcuts = "true"; // arrows turn, they do not go to the next cell
    const gl = this.gl = this.canvas.getContext("webgl2", { antialias: false });
    if (!gl) { add("div", "endolab-empty", host, { textContent: "This browser has no WebGL 2, by which the surface is drawn." }); return; }
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    ["ray", "far"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
    gl.linkProgram(program);
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE); // nothing is seen from behind, so that a tube lies open
    this.at = Object.fromEntries(["seen", "grid", "eye", "ink", "least"].map((name) => [name, gl.getUniformLocation(program, name)]));
    [this.rays, this.far, this.joined, this.box_lines] = [0, 1, 2, 3].map(() => gl.createBuffer());
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    const turn = (change) => { change(this.pose); this.pose[1] = Math.max(-89, Math.min(89, this.pose[1])); on_turn(); };
    this.canvas.onpointerdown = (event) => this.canvas.setPointerCapture(event.pointerId);
    this.canvas.onpointermove = ({ pointerId, shiftKey, movementX, movementY }) => {
      if (!this.canvas.hasPointerCapture(pointerId)) return;
      const [first, scale] = shiftKey ? [3, 1 / this.canvas.clientHeight] : [0, 0.5];
      turn((pose) => { pose[first] += scale * movementX; pose[first + 1] += scale * movementY; });
    };
    this.canvas.ondblclick = () => this.look(this.inside);
    this.canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== this.canvas) return; // who only scrolls by is not held up
      event.preventDefault();
      turn((pose) => { pose[2] *= 1.002 ** -event.deltaY; });
    }, { passive: false });
    this.canvas.onkeydown = (event) => {
      const [way, by] = { ArrowLeft: [0, -5], ArrowRight: [0, 5], ArrowUp: [1, -5], ArrowDown: [1, 5] }[event.key] ?? [];
      if (by) { event.preventDefault(); turn((pose) => { pose[way] += by; }); }
    };
    this.turned = on_turn;
  }

  look(inside) {
    this.inside = inside;
    this.pose = [...(inside ? CAMERA : OUTSIDE)];
    this.turned();
  }

  // A grid of rays, every few pixels of it, joined but where the surface is cut.
  lay({ rays, cuts, width, height }, step) {
    const gl = this.gl, columns = Math.ceil(width / step), rows = Math.ceil(height / step);
    this.some = { step, width, columns, rows };
    const few = new Float32Array(3 * columns * rows), corners = new Uint32Array(6 * (columns - 1) * (rows - 1));
    let joined = 0, torn = corners.length; // where it is cut, at the end: for who looks from the camera
    for (let i = 0, p = 0; i < rows; i++) for (let j = 0; j < columns; j++, p++) {
      for (let axis = 0; axis < 3; axis++) few[3 * p + axis] = rays[3 * (i * step * width + j * step) + axis];
      if (i + 1 === rows || j + 1 === columns) continue;
      let is_cut = false;
      for (let a = 0; a <= step; a++) for (let b = 0; b <= step; b++) is_cut ||= cuts[(i * step + a) * width + j * step + b] > 0;
      const at = is_cut ? torn -= 6 : (joined += 6) - 6;
      [p, p + columns, p + 1, p + 1, p + columns, p + columns + 1].forEach((corner, k) => { corners[at + k] = corner; });
    }
    this.counts = [joined, corners.length];
    gl.bindBuffer(gl.ARRAY_BUFFER, this.rays);
    gl.bufferData(gl.ARRAY_BUFFER, few, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.joined);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  }

  dress(canvas) {
    this.gl.texImage2D(this.gl.TEXTURE_2D, 0, this.gl.RGBA, this.gl.RGBA, this.gl.UNSIGNED_BYTE, canvas);
  }

  // Distances, and the box [low, high] that holds them.
  show(map, box) {
    const { step, width, columns, rows } = this.some, far = new Float32Array(columns * rows), gl = this.gl;
    for (let i = 0, p = 0; i < rows; i++) for (let j = 0; j < columns; j++, p++) far[p] = map[i * step * width + j * step];
    gl.bindBuffer(gl.ARRAY_BUFFER, this.far);
    gl.bufferData(gl.ARRAY_BUFFER, far, gl.DYNAMIC_DRAW);
    const [low, high] = box, corners = CORNERS.map((ends) => ends.map((end, axis) => (end ? high : low)[axis]));
    gl.bindBuffer(gl.ARRAY_BUFFER, this.box_lines);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(EDGES.flatMap((i) => corners[i])), gl.DYNAMIC_DRAW);
    this.box = { middle: low.map((part, i) => (part + high[i]) / 2), size: Math.hypot(...low.map((part, i) => high[i] - part)) / 2, corners };
  }

  // By columns, from the camera's frame to clip space; as it is seen at first the box just fits in.
  view(wide) {
    const { middle, size, corners } = this.box, [,, zoom, shift, sink] = this.pose, [right, down, away] = turned(this.pose);
    const rims = corners.map((corner) => {
      const [x, y, z] = turned(OUTSIDE).map((axis) => dot(axis, corner.map((part, i) => part - middle[i])));
      return Math.max(Math.abs(x) / wide, Math.abs(y)) / (z + 2.6 * size);
    });
    const back = this.inside ? 0 : 2.6 * size / zoom, near = this.inside ? 1e-3 * size : 0.05 * back, end = back + 20 * size;
    const to = this.inside ? [0, 0, 0] : middle, lens = this.inside ? 0.8 * zoom : 0.9 / Math.max(...rims);
    const stretch = (end + near) / (end - near);
    const column = (place, w, more) => [lens / wide * dot(right, place) + 2 * shift * w, -lens * dot(down, place) - 2 * sink * w, stretch * w + more, w];
    const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => column(axis, dot(away, axis), 0));
    const off = to.map((part) => -part), last = column(off, dot(away, off) + back, -2 * end * near / (end - near));
    return { seen: [...axes.flat(), ...last], eye: to.map((part, i) => part - back * away[i]) };
  }

  draw(fineness = 1) {
    const gl = this.gl, ratio = fineness * Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.round(ratio * side));
    if (!gl || !width || !height || !this.box) return;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const { seen, eye } = this.view(width / height);
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.at.seen, false, seen);
    gl.uniform2i(this.at.grid, this.some.columns, this.some.rows);
    gl.uniform3fv(this.at.eye, eye);
    gl.uniform1f(this.at.least, this.inside ? 0 : 0.087);
    gl.uniform4f(this.at.ink, 0, 0, 0, 0);
    [[this.rays, 3], [this.far, 1]].forEach(([buffer, count], i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.vertexAttribPointer(i, count, gl.FLOAT, false, 0, 0);
      gl.enableVertexAttribArray(i);
    });
    gl.drawElements(gl.TRIANGLES, this.counts[this.inside ? 1 : 0], gl.UNSIGNED_INT, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.box_lines);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.disableVertexAttribArray(1);
    gl.vertexAttrib1f(1, 1);
    gl.uniform4f(this.at.ink, 0.5, 0.5, 0.5, 1);
    if (!this.inside) gl.drawArrays(gl.LINES, 0, EDGES.length);
  }

  // Where a point is in the panel, shares to the right and down.
  place(point) {
    const { seen } = this.view(this.canvas.clientWidth / this.canvas.clientHeight);
    const [x, y, , w] = [0, 1, 2, 3].map((row) => dot([...point, 1], [0, 4, 8, 12].map((k) => seen[k + row])));
    return w > 0 ? [(1 + x / w) / 2, (1 - y / w) / 2] : undefined;
  }

  free() { this.gl?.getExtension("WEBGL_lose_context")?.loseContext(); } // a page may have sixteen
}

// The box of the near 95 % of a surface: [low, high].
function box_of(map, rays) {
  const some = [];
  for (let pixel = 0; pixel < map.length; pixel += 7) if (map[pixel] > 0) some.push(pixel);
  const ends = [0, 1, 2].map((axis) => {
    const values = Float32Array.from(some, (pixel) => map[pixel] * rays[3 * pixel + axis]).sort();
    return [0.01, axis === 2 ? 0.95 : 0.99].map((share) => values[Math.floor(share * values.length)]);
  });
  return [ends.map(([low]) => low), ends.map(([, high]) => high)];
}

const said_of = (box, unit) => `${box[0].map((low, axis) => short(box[1][axis] - low, 2)).join(" × ")} ${unit}, the near 95 %`;
// Numbers or bytes that lie in a page.
function unpacked(kind, text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return kind === "f4" ? new Float32Array(bytes.buffer) : bytes;
}
