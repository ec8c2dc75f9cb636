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
  let present, show; // the value that is shown, and what shows one
  const refuse = () => {
    say(`${label}: "${line.value}" is no number`, "endolab-wrong");
    show(present);
  };
  if (!range) {
    show = (value) => { present = value; line.value = value ?? ""; };
    line.onchange = () => {
      const value = typed(line.value);
      if (value === undefined) refuse();
      else turn(value);
    };
    return show;
  }
  const [min, max, step] = range;
  const slider = add("input", "", box, { type: "range", min, max, step, ariaLabel: label });
  const give = (value) => turn(value === first ? null : value);
  slider.oninput = () => {
    const value = log ? 10 ** slider.value : Number(slider.value);
    line.value = Number(value.toPrecision(log ? 2 : 6));
    give(Number(line.value));
  };
  show = (value) => {
    present = value ?? first;
    line.value = Number(present.toPrecision(6));
    slider.value = log ? Math.log10(Math.max(present, 10 ** min)) : present;
  };
  line.onchange = () => {
    const value = typed(line.value);
    if (typeof value === "number") give(value);
    else refuse();
  };
  return show;
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
      const why = needs && store.lacks(needs);
      box.title = why || tip;
      for (const part of box.querySelectorAll("input, select")) part.disabled = Boolean(why);
    }
  });
}
