"""The page's side of a board: a JPEG whose maps share a cursor, can be clicked, and chosen from a list."""

import threading
from typing import Any

import anywidget
import traitlets as t

# Lives in the page. Jupyter holds a change back while the kernel still works on the last one, and then
# sends the latest only: neither a drag nor a cursor builds up a queue. The page asks for what it lacks:
# `room` is told whenever it is drawn or changes its size, and answered by a picture.
SCRIPT = """
const SVG = "http://www.w3.org/2000/svg";
const NOTEBOOK = 140, PAGE = 16;  // px of a page's height that are neither the tuner's nor its board's
function render({ model, el }) {
  const add = (tag, name, parent = el) => {
    const made = parent.appendChild(document.createElement(tag));
    made.className = name;
    return made;
  };
  el.classList.add("endolab-board");
  const lost = add("div", "endolab-lost");
  lost.textContent = "The kernel that drew this is gone: run the cell again.";
  const caption = add("div", "endolab-caption"), stage = add("div", "endolab-stage");
  const image = add("img", "endolab-picture", stage);
  image.draggable = false;
  stage.tabIndex = 0;
  const overlay = stage.appendChild(document.createElementNS(SVG, "svg"));
  overlay.setAttribute("class", "endolab-overlay");
  overlay.setAttribute("viewBox", "0 0 1 1");
  overlay.setAttribute("preserveAspectRatio", "none");
  const labels = add("div", "endolab-labels", stage);
  let url, held, cursor;

  const show = () => {
    const value = model.get("value");
    if (!value.byteLength) return;
    const old = url;
    url = URL.createObjectURL(new Blob([value], { type: "image/jpeg" }));
    image.src = url;
    const [width, height] = model.get("size"), ratio = model.get("ratio");
    if (width) {
      stage.style.width = `${width / ratio}px`;
      stage.style.aspectRatio = `${width} / ${height}`;
    }
    if (old) URL.revokeObjectURL(old);
  };
  const name = () => { caption.textContent = model.get("caption"); image.alt = model.get("caption"); };
  const spots = () => model.get("spots").filter((spot) => spot);
  const line = (points, kind) => {
    const made = overlay.appendChild(document.createElementNS(SVG, "polyline"));
    made.setAttribute("points", points.map((point) => point.join(",")).join(" "));
    made.setAttribute("class", kind);
  };
  const draw = () => {
    stage.dataset.spots = JSON.stringify(model.get("spots"));
    overlay.replaceChildren();
    const marks = model.get("marks");
    for (const [left, top, right, bottom] of spots()) {
      const at = ([x, y]) => [left + x * (right - left), top + y * (bottom - top)];
      if (marks.length) line(marks.map(at), "endolab-marks");
      for (const mark of marks) line([at(mark), at(mark)], "endolab-mark");
      if (!cursor) continue;
      const [x, y] = at(cursor);
      for (const kind of ["endolab-cross under", "endolab-cross"]) {
        line([[left, y], [right, y]], kind);
        line([[x, top], [x, bottom]], kind);
      }
    }
  };
  const say = () => {
    const said = cursor ? model.get("said") : [];
    labels.replaceChildren();
    model.get("spots").forEach((spot, i) => {
      if (!spot || !said[i]) return;
      const label = add("div", "endolab-said", labels);
      label.textContent = said[i];
      label.style.left = `${100 * spot[0]}%`;
      label.style.bottom = `${100 * (1 - spot[3])}%`;
    });
  };
  const choosers = [];
  const offer = () => {
    choosers.splice(0).forEach((one) => one.remove());
    const choices = model.get("choices"), chosen = model.get("panels");
    if (!choices.length) return;
    model.get("boxes").forEach(([left, top, right], i) => {
      if (i >= chosen.length) return;
      const select = add("select", "endolab-choose", stage);
      select.title = "what this panel shows";
      select.ariaLabel = `panel ${i + 1}`;
      for (const choice of choices) select.add(new Option(choice, choice));
      select.value = chosen[i];
      select.style.right = `${100 * (1 - right)}%`;
      select.style.top = `${100 * top}%`;
      select.onchange = () => {
        const now = [...model.get("panels")];
        now[i] = select.value;
        model.set("panels", now);
        model.save_changes();
      };
      choosers.push(select);
    });
  };

  const clip = (share) => Math.min(Math.max(share, 0), 1);
  const place = ({ clientX, clientY }) => {
    const box = image.getBoundingClientRect();
    return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
  };
  const spotAt = ([x, y]) => model.get("spots").findIndex(
    (spot) => spot && spot[0] <= x && x <= spot[2] && spot[1] <= y && y <= spot[3]);
  const within = (event, index) => {
    const [x, y] = place(event), [left, top, right, bottom] = model.get("spots")[index];
    return [clip((x - left) / (right - left)), clip((y - top) / (bottom - top))];
  };
  const tell = (event, pressed) => {
    // The time, so that a second click at the same place is a change too.
    model.set("point", [...within(event, held), held, pressed ? 1 : 0, event.timeStamp]);
    model.save_changes();
  };
  const hover = (event) => {
    const index = spotAt(place(event));
    image.style.cursor = index < 0 ? "" : "crosshair";
    cursor = index < 0 ? undefined : within(event, index);
    draw();
    if (!cursor) say();
    model.set("hover", cursor ?? []);
    model.save_changes();
  };
  image.onpointerdown = (event) => {
    held = event.button === 0 ? spotAt(place(event)) : -1;
    if (held < 0) return;
    event.preventDefault();
    stage.focus({ preventScroll: true });
    image.setPointerCapture(event.pointerId);
    tell(event, true);
  };
  image.onpointermove = (event) => {
    if (held >= 0) tell(event, false);
    hover(event);
  };
  image.onpointerup = image.onpointercancel = () => { held = -1; };
  image.onpointerleave = () => { cursor = undefined; draw(); say(); };
  held = -1;

  let root;
  const keys = "abdx12345";
  const press = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !keys.includes(event.key)) return;
    if (event.target.closest("textarea, select, input, [contenteditable=true]")) return;
    event.preventDefault();
    event.stopPropagation();
    model.set("key", [event.key, event.timeStamp]);
    model.save_changes();
  };
  const settle = () => {
    root = el.closest(".endolab-tuner") ?? el;
    root.dataset.lmSuppressShortcuts = "true";  // the notebook's own commands
    root.addEventListener("keydown", press);
  };

  let known = "";
  const measure = () => {
    const top = (root ?? el).getBoundingClientRect().top, above = stage.getBoundingClientRect().top - top;
    const others = el.closest(".jp-Notebook") ? NOTEBOOK : PAGE;
    const width = Math.floor(el.clientWidth), height = Math.floor(window.innerHeight - above - others);
    const room = [width, Math.max(height, 1), window.devicePixelRatio || 1];
    if (width < 1 || known === room.join()) return;
    known = room.join();
    model.set("room", [...room, performance.now()]);
    model.save_changes();
  };
  const watch = new ResizeObserver(measure);
  watch.observe(el);
  window.addEventListener("resize", measure);
  const frame = requestAnimationFrame(() => { settle(); measure(); });

  const listen = [
    ["change:value", show], ["change:caption", name], ["change:spots", () => { draw(); say(); }],
    ["change:marks", draw], ["change:said", say], ["change:choices", offer], ["change:boxes", offer],
    ["change:panels", offer],
  ];
  for (const [event, action] of listen) model.on(event, action);
  show();
  name();
  draw();
  offer();
  return () => {
    for (const [event, action] of listen) model.off(event, action);
    cancelAnimationFrame(frame);
    watch.disconnect();
    window.removeEventListener("resize", measure);
    root?.removeEventListener("keydown", press);
    URL.revokeObjectURL(url);
  };
}
export default { render };
"""


# Jupyter marks widgets that have lost their kernel with this class.
STYLE = """
.endolab-board { width: 100%; }
.endolab-stage { position: relative; max-width: 100%; outline-offset: 2px; }
.endolab-stage:focus { outline: none; }
.endolab-picture { display: block; width: 100%; touch-action: pan-y; }
.endolab-overlay { position: absolute; inset: 0; width: 100%; height: 100%; pointer-events: none; }
.endolab-overlay * { fill: none; vector-effect: non-scaling-stroke; }
.endolab-cross { stroke: white; stroke-width: 1px; }
.endolab-cross.under { stroke: rgb(0 0 0 / 50%); stroke-width: 2.5px; }
.endolab-marks { stroke: #D55E00; stroke-width: 2px; }
.endolab-mark { stroke: #D55E00; stroke-width: 7px; stroke-linecap: round; }
.endolab-said { position: absolute; padding: 0 5px; background: rgb(0 0 0 / 65%); color: white;
  font: 13px/1.6 sans-serif; pointer-events: none; white-space: nowrap; }
.endolab-choose { position: absolute; width: 20px; height: 20px; margin: 2px 2px 0 0; padding: 0;
  font-size: 13px; border: 1px solid #BBB; border-radius: 3px; background: white; cursor: pointer; }
.endolab-caption { min-height: 0; font-weight: bold; color: #222; }
.endolab-lost { display: none; color: #C0392B; }
.jupyter-widgets-disconnected .endolab-lost { display: block; }
"""


class BoardView(anywidget.AnyWidget):
    """A board in the page. Places in it are shares of it, places in a map shares of the map, in [0, 1].

    Who changes several things at once, in whatever thread, holds `lock` meanwhile: what the page says then is
    heard after.
    """

    _esm, _css = SCRIPT, STYLE
    value = t.Bytes().tag(sync=True)  # JPEG
    size: t.List[Any] = t.List([0, 0]).tag(sync=True)  # of it, px of the screen; 0: as wide as there is room
    ratio = t.Float(1.0).tag(sync=True)  # px of the screen for one of the page
    caption = t.Unicode().tag(sync=True)
    boxes: t.List[Any] = t.List().tag(sync=True)  # of panels: left, top, right, bottom
    spots: t.List[Any] = t.List().tag(sync=True)  # of their maps, or None
    panels: t.List[Any] = t.List().tag(sync=True)  # what they show, by name
    choices: t.List[Any] = t.List().tag(sync=True)  # what they can show
    said: t.List[Any] = t.List().tag(sync=True)  # of each panel, at the cursor
    marks: t.List[Any] = t.List().tag(sync=True)  # points to be marked in all maps
    # From the page: where the cursor is in its map, or nothing; where the pointer was pressed, then the
    # map's number, whether it was just pressed, and when; a key; width, height, and `ratio` of the page.
    hover: t.List[Any] = t.List().tag(sync=True)
    point: t.List[Any] = t.List().tag(sync=True)
    key: t.List[Any] = t.List().tag(sync=True)
    room: t.List[Any] = t.List().tag(sync=True)

    def __init__(self) -> None:
        self.lock = threading.RLock()
        super().__init__()

    def set_state(self, sync_data: dict[str, Any]) -> None:
        """Hear what the page says, not while a board is being sent: part of that would be lost."""
        with self.lock:
            super().set_state(sync_data)
