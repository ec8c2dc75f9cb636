// The page's part of surface_view.py: a textured grid of points in WebGL 2, without a library.

const VERTEX = `#version 300 es
uniform mat4 seen;
uniform ivec2 grid; // columns and rows of points
in vec3 ray;
in float far;
out vec3 place;
out vec2 at;
void main() {
  place = far * ray;
  at = (vec2(gl_VertexID % grid.x, gl_VertexID / grid.x) + 0.5) / vec2(grid);
  gl_Position = seen * vec4(place, 1.0);
}`;
// Relief by a lamp that the viewer holds. What the endoscope sees at more than 85° joins the two sides of a fold.
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
uniform vec3 eye;
uniform vec4 ink;
in vec3 place;
in vec2 at;
out vec4 colour;
void main() {
  colour = ink;
  if (ink.a > 0.0) return;
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  if (abs(dot(normal, normalize(place))) < 0.087) discard;
  float lit = abs(dot(normal, normalize(eye - place)));
  colour = vec4(texture(picture, at).rgb * (0.45 + 0.55 * lit), 1.0);
}`;
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1, (i >> 1) & 1, i >> 2]);
const EDGES = CORNERS.flatMap((_, i) => [1, 2, 4].filter((bit) => !(i & bit)).flatMap((bit) => [i, i | bit]));
const TIP = [[0, 0, 0], [-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]]; // of the endoscope, looking along z
const RIMS = [0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1];
// Pose at first: degrees to the left and up, zoom, shifted right and down (panels).
const START = [35, 20, 1, 0, 0];
const CAMERA = [0, 0, 1, 0, 0, true]; // the same, as the endoscope sees it
const HELP = "drag: turn · shift and drag: move · wheel, once clicked: zoom · double click: as at first";
const KEYS = {
  ArrowLeft: (pose) => { pose[0] -= 5; },
  ArrowRight: (pose) => { pose[0] += 5; },
  ArrowUp: (pose) => { pose[1] -= 5; },
  ArrowDown: (pose) => { pose[1] += 5; },
  "+": (pose) => { pose[2] *= 1.2; },
  "-": (pose) => { pose[2] /= 1.2; },
};
const dot = (a, b) => a.reduce((sum, part, i) => sum + part * b[i], 0);

function made(gl) {
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
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  const uniforms = ["seen", "grid", "eye", "ink"].map((name) => [name, gl.getUniformLocation(program, name)]);
  const buffers = ["rays", "far", "triangles", "lines"].map((name) => [name, gl.createBuffer()]);
  return { ...Object.fromEntries(uniforms), ...Object.fromEntries(buffers), sent: {} };
}

// To the right, down and away, as one sees who stands to the left of the endoscope's axis and above it.
function turned([yaw, pitch]) {
  const [y, p] = [yaw, pitch].map((angle) => angle * Math.PI / 180);
  const [cy, sy, cp, sp] = [Math.cos(y), Math.sin(y), Math.cos(p), Math.sin(p)];
  return [[cy, 0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]];
}

// From the camera's frame to clip space, by columns, and where the viewer stands. At the start the box just fits in.
function view(pose, { middle, size, corners }, wide) {
  const inside = pose[5], back = inside ? 0 : 2.2 * size / pose[2];
  const near = inside ? 1e-3 * size : 0.05 * back, far = back + 20 * size;
  const rims = corners.map((corner) => {
    const [right, down, away] = turned(START).map((axis) => dot(axis, corner.map((part, i) => part - middle[i])));
    return Math.max(Math.abs(right) / wide, Math.abs(down)) / (away + 2.2 * size);
  });
  const lens = inside ? 0.8 * pose[2] : 0.85 / Math.max(...rims), stretch = (far + near) / (far - near);
  const [to_right, to_below, away] = turned(pose);
  const column = (place, w, shift) => [
    lens / wide * dot(to_right, place) + 2 * pose[3] * w,
    -lens * dot(to_below, place) - 2 * pose[4] * w,
    stretch * w + shift,
    w,
  ];
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => column(axis, dot(away, axis), 0));
  const to = inside ? [0, 0, 0] : middle, off = to.map((part) => -part);
  const last = column(off, dot(away, off) + back, -2 * far * near / (far - near));
  return { seen: [...axes.flat(), ...last], eye: to.map((part, i) => part - back * away[i]) };
}

function render({ model, el }) {
  const add = (tag, name, to) => {
    const node = to.appendChild(document.createElement(tag));
    node.className = name;
    return node;
  };
  const root = add("div", "endolab-surface", el), canvas = add("canvas", "", root);
  const axes = ["x", "y", "z"].map(() => add("span", "endolab-axis", root));
  const size_of_box = add("div", "endolab-size", root), help = add("div", "endolab-help", root);
  const marker = add("span", "endolab-marker", root), button = add("button", "endolab-from", root);
  button.title = "Look from the camera, or from outside; key V in the tuner.";
  canvas.tabIndex = 0;
  canvas.dataset.lmSuppressShortcuts = "true"; // arrows turn, they do not go to the next cell
  // Smooth edges cost a processor that draws by itself three times as long; they are short beside the picture.
  const gl = canvas.getContext("webgl2", { antialias: false });
  if (!gl) {
    size_of_box.textContent = "This browser has no WebGL 2, by which the surface is drawn.";
    return undefined;
  }
  let parts = made(gl), frame = 0, decoded = 0, told = 0, gone = false;

  const pose = () => (model.get("pose").length ? model.get("pose") : START);
  const sizes = () => {
    const box = model.get("box"), low = box.slice(0, 3), high = box.slice(3);
    const size = Math.hypot(...high.map((part, i) => part - low[i]));
    const corners = CORNERS.map((ends) => ends.map((end, axis) => (end ? high : low)[axis]));
    return { low, high, size, corners, middle: high.map((part, i) => (part + low[i]) / 2) };
  };
  const put = (target, name, data) => {
    gl.bindBuffer(target, parts[name]);
    gl.bufferData(target, data, gl.DYNAMIC_DRAW);
  };
  const update = async () => {
    const number = model.get("number"), picture = model.get("picture");
    if (!number) return;
    const is_new = parts.sent.picture !== picture;
    const bitmap = is_new && await createImageBitmap(new Blob([picture], { type: "image/jpeg" }));
    if (!gone && number === model.get("number")) { // else a newer one is on its way
      if (bitmap) {
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
        gl.generateMipmap(gl.TEXTURE_2D);
        parts.sent.picture = picture;
      }
      for (const name of ["rays", "far", "triangles"]) {
        const data = model.get(name), target = name === "triangles" ? gl.ELEMENT_ARRAY_BUFFER : gl.ARRAY_BUFFER;
        if (parts.sent[name] !== data) put(target, name, data);
        parts.sent[name] = data;
      }
      const { size, corners } = sizes(), box = EDGES.map((i) => corners[i]);
      const tip = RIMS.map((i) => TIP[i].map((part) => 0.02 * size * part));
      put(gl.ARRAY_BUFFER, "lines", new Float32Array([...box, ...tip].flat()));
      decoded = number;
      soon();
    }
    if (bitmap) bitmap.close();
  };
  const label = (seen) => {
    const { low, high, middle } = sizes(), inside = pose()[5];
    const lay = (span, point) => {
      const [x, y, , w] = [0, 1, 2, 3].map((row) => dot([...point, 1], [0, 4, 8, 12].map((k) => seen[k + row])));
      span.hidden = w <= 0;
      Object.assign(span.style, { left: `${50 + 50 * x / w}%`, top: `${50 - 50 * y / w}%` });
    };
    button.textContent = inside ? "from outside" : "from the camera";
    if (model.get("marker").length) lay(marker, model.get("marker"));
    else marker.hidden = true;
    const lengths = high.map((part, i) => String(Number((part - low[i]).toPrecision(2))));
    axes.forEach((span, axis) => {
      const place = [axis === 1 ? high[0] : low[0], high[1], low[2]].map((part, i) => (i === axis ? middle[i] : part));
      span.textContent = `${"xyz"[axis]} ${lengths[axis]}`;
      lay(span, place);
      span.hidden ||= inside;
    });
    size_of_box.textContent = `${lengths.join(" × ")} ${model.get("unit")}`;
    help.textContent = HELP;
  };
  const draw = () => {
    frame = 0;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [root.clientWidth, root.clientHeight].map((length) => Math.round(ratio * length));
    if (!decoded || !width || !height || gl.isContextLost()) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const { seen, eye } = view(pose(), sizes(), width / height);
    const columns = model.get("columns"), rows = parts.sent.far.byteLength / 4 / columns;
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(parts.seen, false, seen);
    gl.uniform2i(parts.grid, columns, rows);
    gl.uniform3fv(parts.eye, eye);
    gl.uniform4f(parts.ink, 0, 0, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, parts.rays);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, parts.far);
    gl.vertexAttribPointer(1, 1, gl.FLOAT, false, 0, 0);
    [0, 1].forEach((i) => gl.enableVertexAttribArray(i));
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, parts.triangles);
    gl.enable(gl.CULL_FACE); // nothing is seen from behind, so that a tube lies open
    gl.drawElements(gl.TRIANGLES, parts.sent.triangles.byteLength / 4, gl.UNSIGNED_INT, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, parts.lines);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.disableVertexAttribArray(1);
    gl.vertexAttrib1f(1, 1);
    gl.uniform4f(parts.ink, 0.5, 0.5, 0.5, 1);
    gl.drawArrays(gl.LINES, 0, EDGES.length + RIMS.length);
    label(seen);
    if (told !== decoded) {
      told = decoded;
      model.set("drawn", told);
      model.save_changes();
    }
  };
  const soon = () => { frame ||= requestAnimationFrame(draw); };

  const turn = (change) => {
    const turned_to = [...pose()];
    change(turned_to);
    turned_to[1] = Math.min(Math.max(turned_to[1], -89), 89);
    turned_to[2] = Math.min(Math.max(turned_to[2], 0.3), 20);
    model.set("pose", turned_to);
  };
  const keep = () => model.save_changes();
  let held; // where the pointer was
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    held = [event.clientX, event.clientY];
  };
  canvas.onpointermove = (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    const [right, down] = [event.clientX - held[0], event.clientY - held[1]];
    held = [event.clientX, event.clientY];
    turn((pose) => {
      const first = event.shiftKey ? 3 : 0;
      pose[first] += right * (event.shiftKey ? 1 / root.clientWidth : 0.5);
      pose[first + 1] += down * (event.shiftKey ? 1 / root.clientHeight : 0.5);
    });
  };
  canvas.onpointerup = canvas.onpointercancel = keep;
  button.onclick = () => { model.set("pose", pose()[5] ? START : CAMERA); keep(); };
  canvas.ondblclick = () => { model.set("pose", START); keep(); };
  canvas.onkeydown = (event) => {
    if (!KEYS[event.key]) return;
    event.preventDefault();
    turn(KEYS[event.key]);
    keep();
  };
  const wheel = (event) => {
    if (document.activeElement !== canvas) return; // who only scrolls by is not held up
    event.preventDefault();
    turn((pose) => { pose[2] *= 1.002 ** -event.deltaY; });
    keep();
  };
  canvas.addEventListener("wheel", wheel, { passive: false });
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => { parts = made(gl); update(); });

  let inside = true;
  const tell = () => {
    model.set("visible", inside && !document.hidden);
    model.save_changes();
  };
  const watch = new IntersectionObserver((seen) => { inside = seen[seen.length - 1].isIntersecting; tell(); });
  const resized = new ResizeObserver(soon);
  watch.observe(root);
  resized.observe(root);
  document.addEventListener("visibilitychange", tell);
  model.on("change:number", update);
  for (const name of ["pose", "marker"]) model.on(`change:${name}`, soon);
  update();
  return () => {
    gone = true;
    parts.sent = {};
    watch.disconnect();
    resized.disconnect();
    document.removeEventListener("visibilitychange", tell);
    model.off("change:number", update);
    for (const name of ["pose", "marker"]) model.off(`change:${name}`, soon);
    gl.getExtension("WEBGL_lose_context")?.loseContext(); // a page may have sixteen
  };
}
export default { render };
