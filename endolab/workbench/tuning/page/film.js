// The way of the solver to its answer: a slider over its iterates, and what plays them once.
import { add } from "./drawing.js";

const PAUSE = 120; // ms from one iterate to the next

/** Adds it; returns what stops it. @type {(store: Store, to: Element) => () => void} */
export function add_film(store, to) {
  const film = add("span", "endolab-film", to, { hidden: true }), { now } = store;
  const title = "Play the way of the solver to this answer, once.";
  const play = add("button", "", film, { textContent: "▶", title, onclick: () => toggle() });
  const place = add("input", "", film, { type: "range", min: 1, step: 1, ariaLabel: "iterate" });
  const says = add("span", "", film);
  let playing = 0;
  const toggle = (on = !playing) => {
    clearInterval(playing);
    playing = on ? setInterval(go_on, PAUSE) : 0;
    play.textContent = on ? "||" : "▶";
  };
  // To the next iterate: from the last to the first, and at the last, the answer, no farther.
  const go_on = () => {
    place.value = Number(place.value) % place.max + 1;
    place.oninput();
    if (place.value === place.max) toggle(false);
  };
  const say_iterate = () => { // which of the last run is shown
    const falls = place.value < now.path.length ? ", still falls" : "";
    says.textContent = `iterate ${now.path[place.value - 1]} of ${now.path.at(-1)}${falls}`;
  };
  place.oninput = () => {
    say_iterate();
    store.send("iterate", Number(place.value), now.state);
  };
  store.on("leave", () => {
    toggle(false);
    play.disabled = place.disabled = true;
    says.textContent = "";
  });
  store.on("said", ({ path }) => {
    if (!path) return;
    toggle(false);
    film.hidden = path.length < 2;
    Object.assign(place, { max: path.length, value: path.length, disabled: false });
    play.disabled = false;
    if (!film.hidden) say_iterate();
  });
  return () => toggle(false);
}
