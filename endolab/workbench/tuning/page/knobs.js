// Controls: lists, numbers, and sliders with their numbers.
import { add } from "./drawing.js";
import { typed } from "./scales.js";

const NUMBER = "input:not([type=range])";

// Adds one knob; returns what shows a value in it. `turn` is called with another, `say` with words.
function knob({ label, options, range, log, hint, first }, box, turn, say) {
  add("label", "", box, { textContent: label });
  if (options) {
    const select = add("select", "", box, { ariaLabel: label });
    for (const [text, value] of options.map((one) => (Array.isArray(one) ? one : [one, one]))) {
      select.add(new Option(text, JSON.stringify(value)));
    }
    select.onchange = () => turn(JSON.parse(select.value));
    return (value) => { select.value = JSON.stringify(value); };
  }
  const line = add("input", "", box, { ariaLabel: label, placeholder: hint ?? "" });
  // JupyterLab keeps Enter's own effect.
  line.onkeydown = ({ key }) => { if (key === "Enter") line.blur(); };
  const [min, max, step] = range ?? [], type = "range";
  const slider = range && add("input", "", box, { type, min, max, step, ariaLabel: label });
  const give = (value) => turn(range && value === first ? null : value);
  let present; // the value that is shown
  const show = (value) => {
    present = range ? value ?? first : value;
    line.value = range ? Number(present.toPrecision(6)) : present ?? "";
    if (range) slider.value = log ? Math.log10(Math.max(present, 10 ** min)) : present;
  };
  line.onchange = () => {
    const value = typed(line.value), is_one = typeof value === "number";
    if (range ? is_one : value !== undefined) return give(value);
    say(`${label}: "${line.value}" is no number`, "endolab-wrong");
    return show(present);
  };
  if (range) slider.oninput = () => {
    const value = log ? 10 ** slider.value : Number(slider.value);
    line.value = Number(value.toPrecision(log ? 2 : 6));
    give(Number(line.value));
  };
  return show;
}

// Why a knob has nothing to turn, if so.
function lacks(needs, { now: { knobs, still }, facts }) {
  if (needs === "energy" && !facts.with_energy.includes(knobs.solver)) {
    return "Off: this solver minimises no energy, which this is a part of.";
  }
  if (needs === "mm" && !still?.metric) {
    return "Nothing says how many millimetres a distance is: give a length, behind more ....";
  }
  return needs === "gain" && !still?.has_gain &&
    "Off: the gain of this endoscope is unknown, so that there is nothing to multiply.";
}

/**
 * Adds all knobs; they show what the store knows, but where something is being typed.
 * @type {(store: Store, sight: Element, advanced: Element) => void}
 */
export function add_knobs(store, sight, advanced) {
  const shown = store.facts.specs.map((spec) => {
    const to = spec.hidden ? advanced : sight;
    const box = add("div", `endolab-knob endolab-${spec.name}`, to, { title: spec.tip });
    const say = (...words) => store.tell("line", ...words);
    const show = knob(spec, box, (value) => store.turn({ [spec.name]: value }), say);
    return { ...spec, box, show };
  });
  store.on("knobs", () => {
    const typing = document.activeElement;
    for (const { name, tip, needs, show, box } of shown) {
      const is_typed = box.contains(typing) && typing.matches(NUMBER);
      if (name in store.now.knobs && !is_typed) show(store.now.knobs[name]);
      const why = lacks(needs, store);
      box.title = why || tip;
      for (const part of box.querySelectorAll("input, select")) part.disabled = Boolean(why);
    }
  });
}
