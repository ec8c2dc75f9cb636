// Buttons, and their keys.
import { add } from "./drawing.js";
import { add_film } from "./film.js";
import { fit } from "./sight.js";

const HELP = {
  Enter: "ask anew: light, contours, scales as the knobs are now", A: "keep as A, or drop it",
  F: "fit section, 3D box and colours", V: "3D from the camera, or from outside",
  "P, N": "frame before, frame after", U: "undo", R: "reset all knobs",
  "?": "these keys", "click on a map": "lay the section", "click on a dot": "take its λ",
  "wheel on a map": "zoom; with shift, drag it; double click for all",
  "a panel's title": "show something else there",
};
const TYPING = "textarea, input:not([type=range]), [contenteditable=true], .cm-editor";

/** Adds what the keys do, hidden. */
export function add_help(root) {
  const help = add("div", "endolab-keys", root, { hidden: true });
  for (const [key, does] of Object.entries(HELP)) {
    add("b", "", help, { textContent: key });
    add("span", "", help, { textContent: does });
  }
  help.onclick = () => { help.hidden = true; };
  return help;
}

/**
 * Adds buttons, what plays the solver's way, and a wipe; returns what stops it all.
 * @type {(store: Store, to: Element, page: {el: Element, help: Element, advanced: Element,
 *   panels: Panels, resize: () => void}) => () => void}
 */
export function add_actions(store, to, { el, help, advanced, panels, resize }) {
  const { facts } = store, toggle = (part) => { part.hidden = !part.hidden; };
  const button = (textContent, title, onclick, where = live) =>
    add("button", "", where, { textContent, title, onclick });
  const ask_anew = () => {
    store.tell("line", "asking anew ...");
    store.turn({}, true);
  };
  const live = add("span", "endolab-live", to, { hidden: facts.alone });
  button("ask anew", "Find light, contours and scales again, with the knobs as they are; Enter.",
    ask_anew).className = "endolab-anew";
  button("undo", "Back to the knobs before; U.", () => store.undo());
  button("reset", "All knobs as they were at first; R.", () => store.reset());
  const preset = add("select", "", live, { ariaLabel: "preset",
    title: "All options at once; frame, width and what is believed of the endoscope stay." });
  for (const name of ["preset ...", ...Object.keys(facts.presets)]) preset.add(new Option(name));
  preset.onchange = () => {
    store.begin_with(facts.presets[preset.value]);
    preset.selectedIndex = 0;
  };
  const keep = button("keep as A", "Keep what is shown, to compare it with what comes; A.",
    () => store.keep(), to);
  button("fit", "Section, 3D box and colours fit what is shown; F.", () => fit(store), to);
  button("find σ", "How far each distance can be trusted; the panel σ shows it.",
    () => store.find_sigma());
  const folder = add("input", "endolab-folder", live, { value: "tuned" });
  folder.ariaLabel = "folder to export into";
  const all = "board, result, settings, recording, code";
  button("export", `Write what is shown into that folder: ${all}.`, () => {
    store.tell("line", `exporting into ${folder.value} ...`);
    store.send("export", folder.value, panels.board());
  });
  const cover = button("leave out", "Then drag a rectangle on a map: what it covers is no wall, " +
    "and all is asked anew; undo takes it back.", () => store.cover(!store.covers));
  store.on("cover", () => cover.classList.toggle("endolab-on", store.covers));
  button("more ...", "All other options.", () => {
    toggle(advanced);
    resize();
  });
  button("?", "Keys.", () => toggle(help), to);
  // What comes and goes stands behind what stays.
  const wiped = add("label", "endolab-wipe", to, { hidden: true, textContent: "A | B" });
  const wipe = add("input", "", wiped, { type: "range", min: 0, max: 1, step: 0.01,
    ariaLabel: "wipe", title: "Left of this the maps show A, right of it B; drag it there, too." });
  wipe.oninput = () => {
    store.wipe = Number(wipe.value);
    store.tell("draw");
  };
  store.on("compare", () => {
    wiped.hidden = !store.kept;
    wipe.value = store.wipe;
    keep.textContent = store.kept ? "drop A" : "keep as A";
  });
  const stop_film = add_film(store, to);

  // Keys work wherever the focus is but in a text field; in a notebook, while this cell is active.
  const live_keys = { Enter: ask_anew, n: () => store.step(1), p: () => store.step(-1),
    u: () => store.undo(), r: () => store.reset() };
  const keys = { a: () => store.keep(), f: () => fit(store),
    v: () => panels.solid.turn_around(),
    "?": () => toggle(help), Escape: () => { help.hidden = true; },
    ...(facts.alone ? {} : live_keys) };
  const on_key = (event) => {
    const cell = el.closest(".jp-Cell"), { target, key } = event;
    const is_elsewhere = cell && !cell.classList.contains("jp-mod-active");
    if (is_elsewhere || target.closest?.(TYPING) || !el.isConnected) return;
    const is_undo = (event.ctrlKey || event.metaKey) && key === "z";
    const is_plain = !(event.ctrlKey || event.metaKey || event.altKey);
    const does = is_undo ? keys.u : is_plain && keys[key];
    if (!does || (key === "Enter" && target.closest?.("button, select"))) return;
    event.preventDefault();
    event.stopPropagation(); // to a notebook V means: paste a cell
    does();
  };
  document.addEventListener("keydown", on_key, true);
  return () => {
    stop_film();
    document.removeEventListener("keydown", on_key, true);
  };
}
