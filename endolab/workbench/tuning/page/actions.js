// Buttons, and their keys: each says in tuner.html what it does, here or in the store.
import { add_film } from "./film.js";

const TYPING = "textarea, input:not([type=range]), [contenteditable=true], .cm-editor";

/**
 * Lets them do it, and adds what plays the solver's way; returns what stops it all.
 * @type {(store: Store, root: Element, panels: Panels) => () => void}
 */
export function add_actions(store, root, panels) {
  const { facts } = store, names = "live preset folder cover keep wipe advanced keys actions";
  const [live, preset, folder, cover, keep, wiped, advanced, help, actions] =
    names.split(" ").map((name) => root.querySelector(`.endolab-${name}`));
  const toggle = (part) => { part.hidden = !part.hidden; }, [, wipe] = wiped.childNodes;
  const does = {
    previous: () => store.step(-1),
    next: () => store.step(1),
    turn_around: () => panels.solid.turn_around(),
    help: () => toggle(help),
    hide: () => { help.hidden = true; },
    more: () => toggle(advanced),
    export() {
      store.tell("line", `exporting into ${folder.value} ...`);
      store.send("export", folder.value, panels.board());
    },
  };
  root.addEventListener("click", ({ target }) => {
    const name = target.closest("[data-do]")?.dataset.do;
    if (name) (name in does ? does : store)[name]();
  });
  for (const name of Object.keys(facts.presets)) preset.add(new Option(name));
  preset.onchange = () => {
    store.begin_with(facts.presets[preset.value]);
    preset.selectedIndex = 0;
  };
  wipe.oninput = () => {
    store.wipe = Number(wipe.value);
    store.tell("draw");
  };
  store.on("draw", (is_look) => {
    if (is_look) return;
    wiped.hidden = !store.kept;
    wipe.value = store.wipe;
    keep.textContent = store.kept ? "drop A" : "keep as A";
    cover.classList.toggle("endolab-on", Boolean(store.covers));
  });
  if (facts.alone) live.remove();
  const stop_film = add_film(store, actions);

  // Keys work wherever the focus is but in a text field; in a notebook, while this cell is active.
  const on_key = (event) => {
    const cell = root.closest(".jp-Cell"), { target, key, ctrlKey, metaKey, altKey } = event;
    const is_elsewhere = cell && !cell.classList.contains("jp-mod-active");
    if (is_elsewhere || target.closest?.(TYPING) || !root.isConnected) return;
    const is_plain = !(ctrlKey || metaKey || altKey), is_undo = (ctrlKey || metaKey) && key === "z";
    const name = is_undo ? "u" : is_plain && CSS.escape(key);
    const button = root.querySelector(`[data-key="${name}"]`);
    if (!button || (key === "Enter" && target.closest?.("button, select"))) return;
    event.preventDefault();
    event.stopPropagation(); // to a notebook V means: paste a cell
    button.click();
  };
  document.addEventListener("keydown", on_key, true);
  return () => {
    stop_film();
    document.removeEventListener("keydown", on_key, true);
  };
}
