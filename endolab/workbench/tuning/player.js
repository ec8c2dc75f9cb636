
// A tuner without Python, on top of board.js and tuner.js: answers for each regulariser and λ lie packed in the page.
async function play({ facts, first, rows, still, packed, low, step, end }, el) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0)), size = first.still.width * first.still.height;
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer()), count = rows.length * size;
  for (let plane = 0; plane < 3; plane++) { // each map is what it differs by from the one before
    for (let p = plane * count + size; p < (plane + 1) * count; p++) planes[p] = (planes[p] + planes[p - size]) & 255;
  }
  const listeners = new Set(), tell = (message, buffers) => listeners.forEach((hear) => hear(message, buffers));
  const show = (knobs, more = {}, before = []) => {
    const some = rows.map((row, i) => ({ ...row, i })).filter((row) => row.regulariser === knobs.regulariser);
    const row = some.reduce((a, b) => (Math.abs(Math.log(b.lam / knobs.lam)) < Math.abs(Math.log(a.lam / knobs.lam)) ? b : a));
    const distance = new Float32Array(size), residual = new Float32Array(size), from = row.i * size;
    for (let p = 0; p < size; p++) {
      const code = planes[from + p] + 256 * planes[count + from + p], left = planes[2 * count + from + p];
      distance[p] = code ? Math.exp(low + step * code) : NaN;
      residual[p] = left ? (left - 128) * end / 127 : NaN;
    }
    const curve = { ...row.curve, lams: some.map(({ lam }) => lam), explained: some.map(({ explained }) => explained), errors: some.map(({ error }) => error), now: row.lam };
    const names = [...(more.names ?? []), ["distance", "f4"], ["model - frame", "f4"]], shown = { ...knobs, lam: row.lam };
    tell({ ...more, names, line: row.line, label: row.label, badge: "no Python", knobs: shown, curve, moving: false },
      [...before, distance, residual].map((array) => new DataView(array.buffer, array.byteOffset, array.byteLength)));
  };
  const arrays = still.map(([, kind, text]) => {
    const content = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return kind === "f4" ? new Float32Array(content.buffer) : content;
  });
  const model = {
    get: () => facts,
    on(event, action) { if (event === "msg:custom") listeners.add(action); },
    off(event, action) { listeners.delete(action); },
    send({ do: action, given }) {
      if (action === "ready") show(first.knobs, { ...first, names: still.map(([name, kind]) => [name, kind]) }, arrays);
      if (action === "turn") show(given[0]);
    },
  };
  render({ model, el });
}
