// Controls: lists, numbers, and sliders with their numbers.
import { add } from "./drawing.js";
import { typed } from "./scales.js";

const NUMBER = "input:not([type=range])";
// Why a knob has nothing to turn, by what it needs.
const LACKS = {
  energy: "Off: this solver minimises no energy, which this is a part of.",
  mm: "Nothing says how many millimetres a distance is: give a length, behind more ....",
  gain: "Off: the gain of this endoscope is unknown, so that there is nothing to multiply.",
};

// Adds one knob; returns what shows a value in it. `turn` is called with another, `say` with words.
function add_knob({ label, options, range, log, hint = "", first }, box, turn, say) {
  add("label", "", box, { textContent: label });
  if (options) {
    const select = add("select", "", box, { ariaLabel: label });
    for (const [text, value] of options.map((one) => (Array.isArray(one) ? one : [one, one]))) {
      select.add(new Option(text, JSON.stringify(value)));
    }
    select.onchange = () => turn(JSON.parse(select.value));
    return (value) => { select.value = JSON.stringify(value); };
  }
  const line = add("input", "", box, { ariaLabel: label, placeholder: hint });
  const [min, max, step] = range ?? [], type = "range";
  const slider = range && add("input", "", box, { type, min, max, step, ariaLabel: label });
  const give = (value) => turn(range && value === first ? null : value);
  let present; // the value that is shown
  const show = (value) => {
    present = range ? value ?? first : value;
    line.value = range ? Number(present.toPrecision(6)) : present ?? "";
    if (range) slider.value = log ? Math.log10(Math.max(present, 10 ** min)) : present;
  };
  // JupyterLab keeps Enter's own effect.
  line.onkeydown = ({ key }) => { if (key === "Enter") line.blur(); };
  line.onchange = () => {
    const value = typed(line.value);
    if (range ? typeof value === "number" : value !== undefined) return give(value);
    say(`${label}: "${line.value}" is no number`, "endolab-wrong");
    return show(present);
  };
  if (range) slider.oninput = () => {
    line.value = log ? Number((10 ** slider.value).toPrecision(2)) : Number(slider.value);
    give(Number(line.value));
  };
  return show;
}

/**
 * Adds all knobs; they show what the store knows, but where something is being typed.
 * @type {(store: Store, sight: Element, advanced: Element) => void}
 */
export function add_knobs(store, sight, advanced) {
  const shown = store.facts.specs.map((spec) => {
    const { name, hidden } = spec, say = (...words) => store.tell("line", ...words);
    const box = add("div", `endolab-knob endolab-${name}`, hidden ? advanced : sight);
    const show = add_knob(spec, box, (value) => store.turn({ [name]: value }), say);
    return { ...spec, box, show };
  });
  store.on("knobs", () => {
    const { now: { knobs, still }, facts } = store, typing = document.activeElement;
    const has = { energy: facts.with_energy.includes(knobs.solver), mm: still?.metric,
      gain: still?.has_gain };
    for (const { name, tip, needs, show, box } of shown) {
      const is_typed = box.contains(typing) && typing.matches(NUMBER);
      if (name in knobs && !is_typed) show(knobs[name]);
      const why = needs && !has[needs] && LACKS[needs];
      box.title = why || tip;
      for (const part of box.querySelectorAll("input, select")) part.disabled = Boolean(why);
    }
  });
}
