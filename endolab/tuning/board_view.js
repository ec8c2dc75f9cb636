// The page's part of board_view.py: a picture whose maps share a cursor, and whose titles open a list.
// Jupyter holds a change back while the kernel works on the last one, and then sends the latest only: neither a
// drag nor a cursor builds up a queue.
const KEYS = "abcdnpruxz";
const TYPING = "textarea, input:not([type=checkbox]), [contenteditable=true], .cm-editor";

function render({ model, el }) {
  const add = (tag, name, to) => {
    const node = to.appendChild(document.createElement(tag));
    node.className = name;
    return node;
  };
  const tell = (name, value) => { model.set(name, value); model.save_changes(); };
  const lost = add("div", "endolab-lost", el);
  lost.textContent = "The kernel that drew this is gone: run the cell again.";
  const stage = add("div", "endolab-stage", el), image = add("img", "endolab-picture", stage);
  const marks = add("div", "endolab-marks", stage);
  image.draggable = false;
  let url, cursor, held = false;

  const show = () => {
    const [width, height] = model.get("size"), ratio = model.get("ratio");
    if (!width) return;
    const old = url;
    url = URL.createObjectURL(new Blob([model.get("value")], { type: "image/jpeg" }));
    image.src = url;
    stage.style.width = `${width / ratio}px`;
    stage.style.height = `${height / ratio}px`;
    if (old) URL.revokeObjectURL(old);
  };
  const put = (node, left, top, right, bottom) => {
    const percent = (share) => `${100 * share}%`;
    Object.assign(node.style, {
      left: percent(left), top: percent(top), width: percent(right - left), height: percent(bottom - top),
    });
  };
  const point = () => {
    marks.replaceChildren();
    const said = model.get("said");
    model.get("cells").forEach(({ spot }, i) => {
      if (!spot || !cursor) return;
      const [left, top, right, bottom] = spot;
      const x = left + cursor[0] * (right - left), y = top + cursor[1] * (bottom - top);
      put(add("div", "endolab-cross", marks), left, y, right, y);
      put(add("div", "endolab-cross", marks), x, top, x, bottom);
      if (!said[i]) return;
      const label = add("div", "endolab-said", marks);
      label.textContent = said[i];
      Object.assign(label.style, { left: `${100 * left}%`, bottom: `${100 * (1 - bottom)}%` });
    });
  };
  const offer = () => {
    stage.querySelectorAll("select").forEach((one) => one.remove());
    stage.dataset.cells = JSON.stringify(model.get("cells"));
    model.get("cells").forEach(({ box, name }, i) => {
      if (!model.get("choices").length) return;
      const select = add("select", "endolab-choose", stage);
      select.title = "choose what this panel shows";
      select.ariaLabel = `panel ${i + 1}`;
      for (const choice of model.get("choices")) select.add(new Option(choice, choice));
      select.value = name;
      select.style.left = `${100 * box[0]}%`;
      select.style.top = `${100 * box[1]}%`;
      select.style.width = `${100 * (box[2] - box[0])}%`;
      select.onchange = () => tell("chosen", [i, select.value, performance.now()]);
    });
  };

  const place = ({ clientX, clientY }) => {
    const box = image.getBoundingClientRect();
    return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
  };
  const hover = (event) => {
    const [x, y] = place(event);
    const { spot } = model.get("cells").find(({ spot: one }) => one
      && one[0] <= x && x <= one[2] && one[1] <= y && y <= one[3]) ?? {};
    cursor = spot && [(x - spot[0]) / (spot[2] - spot[0]), (y - spot[1]) / (spot[3] - spot[1])];
    point();
    tell("hover", cursor ?? []);
    if (held) tell("point", [x, y, 0, event.timeStamp]);
  };
  image.onpointerdown = (event) => {
    held = event.button === 0;
    if (!held) return;
    image.setPointerCapture(event.pointerId);
    tell("point", [...place(event), 1, event.timeStamp]); // the time, so that a second click is a change too
  };
  image.onpointermove = hover;
  image.onpointerup = image.onpointercancel = () => { held = false; };
  image.onpointerleave = () => { cursor = undefined; point(); };

  // Keys work wherever the focus is but in a text field; in a notebook, as long as this cell is the active one.
  const press = (event) => {
    const cell = el.closest(".jp-Cell"), undo = event.key === "z" && (event.ctrlKey || event.metaKey);
    if (cell && !cell.classList.contains("jp-mod-active")) return;
    if (event.target.closest?.(TYPING) || !KEYS.includes(event.key) || !el.isConnected) return;
    if (!undo && (event.key === "z" || event.ctrlKey || event.metaKey || event.altKey)) return;
    event.preventDefault();
    event.stopPropagation();
    tell("key", [event.key, event.timeStamp]);
  };
  document.addEventListener("keydown", press, true);

  let known = "";
  const measure = () => {
    const page = el.closest(".jp-WindowedPanel-outer, .jp-Notebook");
    const top = (el.closest(".endolab-tuner") ?? el).getBoundingClientRect().top;
    const above = stage.getBoundingClientRect().top - top;
    const height = (page ? page.clientHeight - 24 : window.innerHeight - 16) - above;
    const room = [Math.floor(el.clientWidth), Math.floor(height), window.devicePixelRatio || 1];
    if (room[0] < 1 || known === room.join()) return;
    known = room.join();
    tell("room", [...room, performance.now()]);
  };
  const watch = new ResizeObserver(measure);
  watch.observe(el);
  const bar = requestAnimationFrame(() => {
    const tuner = el.closest(".endolab-tuner");
    if (tuner) watch.observe(tuner.querySelector(".endolab-bars"));
    measure();
  });
  window.addEventListener("resize", measure);
  const listen = [["change:value", show], ["change:cells", offer], ["change:choices", offer], ["change:said", point]];
  for (const [event, action] of listen) model.on(event, action);
  show();
  offer();
  return () => {
    for (const [event, action] of listen) model.off(event, action);
    cancelAnimationFrame(bar);
    watch.disconnect();
    window.removeEventListener("resize", measure);
    document.removeEventListener("keydown", press, true);
    URL.revokeObjectURL(url);
  };
}
export default { render };
