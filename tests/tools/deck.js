// Lays a notebook's pieces out on slides and steps through them. What does not fit goes to the next slide, and
// what fits on none is made smaller, so that nothing is ever cut off, whatever a notebook has become.
const LEAST_FIGURE = 360, LEAST_FORCED = 120, LEAST_ZOOM = 0.6; // px, px, share
const source = document.getElementById("source"), stage = document.getElementById("stage");
const sections = [...source.children].map((section) => [section.firstChild, [...section.children].slice(1)]);
let slides = [], now = 0, whole = false;

const overflows = (body) => body.scrollHeight > body.clientHeight;

function added(title, part) {
  const slide = stage.appendChild(document.createElement("section"));
  slide.className = "slide";
  const head = slide.appendChild(document.createElement(title.first && part === 1 ? "h1" : "h2"));
  head.innerHTML = part > 1 ? `${title.html} <small>${part}</small>` : title.html;
  slides.push(slide);
  return slide.appendChild(Object.assign(document.createElement("div"), { className: "body" }));
}

// Makes the figures on a slide smaller, as far as they can still be read.
function shrunk(body, least) {
  const figures = [...body.querySelectorAll("img")];
  figures.forEach((figure) => { figure.dataset.full ??= figure.offsetHeight; });
  const fullest = Math.max(0, ...figures.map((figure) => Number(figure.dataset.full)));
  const tallest = Math.max(0, ...figures.map((figure) => figure.offsetHeight));
  const height = tallest - (body.scrollHeight - body.clientHeight);
  if (!tallest || height < Math.min(least, 0.8 * fullest)) return false;
  const before = figures.map((figure) => figure.style.maxHeight);
  figures.forEach((figure) => { figure.style.maxHeight = `${height}px`; });
  if (!overflows(body)) return true;
  figures.forEach((figure, i) => { figure.style.maxHeight = before[i]; });
  return false;
}

// What is said of a figure stays below it: rather the code goes behind a fold.
function told(body, block) {
  const codes = [...body.querySelectorAll("details.short[open]")];
  if (!codes.length || !body.querySelector("img") || block.querySelector("img, canvas, details")) return false;
  codes.forEach((code) => { code.open = false; });
  if (!overflows(body) || shrunk(body, LEAST_FIGURE)) return true;
  codes.forEach((code) => { code.open = true; });
  return false;
}

// Has a block fit on a slide of its own: folds the code above a figure, makes small, and lets scroll at last.
function forced(body, block) {
  const codes = block.querySelector("img, canvas, table") ? body.querySelectorAll("details.code") : [];
  codes.forEach((code) => { code.open = false; });
  if (!overflows(body) || shrunk(body, LEAST_FORCED)) return;
  for (let zoom = 0.95 * (block.style.zoom || 1); zoom >= LEAST_ZOOM && overflows(body); zoom -= 0.05) block.style.zoom = zoom;
  if (!overflows(body)) return;
  block.classList.add("scrolls");
  for (let high = body.clientHeight; high > 100 && overflows(body); high -= 20) block.style.maxHeight = `${high}px`;
}

function restored(block) {
  block.style.zoom = block.style.maxHeight = "";
  block.classList.remove("scrolls");
  block.querySelectorAll("img").forEach((figure) => {
    figure.style.maxHeight = "";
    delete figure.dataset.full;
  });
  block.querySelectorAll("details.short").forEach((code) => { code.open = true; });
}

function layOut() {
  const at = slides[now]?.dataset.section;
  stage.replaceChildren();
  slides = [];
  document.body.classList.toggle("whole", whole);
  sections.forEach(([header, blocks], number) => {
    const title = { html: header.innerHTML, first: number === 0 };
    let part = 1, body = added(title, part), lead = []; // what goes with what follows: a heading, code, "… :"
    for (const block of blocks) {
      restored(block);
      const starts = block.dataset.starts && body.children.length > 0;
      if (!starts) body.append(block);
      if (body.scrollWidth > body.clientWidth) block.style.zoom = body.clientWidth / body.scrollWidth;
      if (starts || (overflows(body) && !shrunk(body, LEAST_FIGURE) && !told(body, block))) {
        if (body.children.length > lead.length + (starts ? 0 : 1)) {
          body = added(title, part += 1);
          body.append(...lead);
        }
        body.append(block);
        if (overflows(body) && !shrunk(body, LEAST_FIGURE)) forced(body, block);
      }
      lead = block.dataset.leads ? [...lead, block] : [];
    }
    slides.forEach((slide) => { slide.dataset.section ??= number; });
  });
  show(Math.max(0, slides.findIndex((slide) => slide.dataset.section === at)));
}

function show(number, kept) {
  now = Math.min(Math.max(number, 0), slides.length - 1);
  slides.forEach((slide, i) => slide.classList.toggle("now", i === now));
  document.getElementById("count").textContent = `${now + 1} / ${slides.length}`;
  if (!kept) history.replaceState(null, "", `#${now + 1}`);
}

function scaled() {
  const factor = Math.min(innerWidth / stage.offsetWidth, innerHeight / stage.offsetHeight);
  stage.style.transform = `translate(-50%, -50%) scale(${factor})`;
}

const overview = (on) => document.body.classList.toggle("overview", on);
const KEYS = {
  ArrowRight: () => show(now + 1), ArrowDown: () => show(now + 1), PageDown: () => show(now + 1),
  " ": () => show(now + 1), ArrowLeft: () => show(now - 1), ArrowUp: () => show(now - 1),
  PageUp: () => show(now - 1), Home: () => show(0), End: () => show(slides.length - 1),
  t: () => { whole = !whole; layOut(); },
  o: () => overview(), Escape: () => overview(),
  f: () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()),
};
window.onkeydown = (event) => {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
  if (event.target.matches("input, summary") && !event.key.startsWith("Page")) return;
  event.preventDefault();
  KEYS[event.key]();
};
window.onchange = (event) => event.target.blur(); // so that the arrows step on
window.onclick = (event) => {
  const slide = event.target.closest(".slide");
  if (!document.body.classList.contains("overview") || !slide) return;
  overview(false);
  show(slides.indexOf(slide));
};
let from;
window.ontouchstart = (event) => {
  from = event.target.closest("canvas, input, label, details") ? null : event.touches[0].clientX;
};
window.ontouchend = (event) => {
  const moved = from === null ? 0 : event.changedTouches[0].clientX - from;
  if (Math.abs(moved) > 60) show(now - Math.sign(moved));
};
document.getElementById("back").onclick = () => show(now - 1);
document.getElementById("on").onclick = () => show(now + 1);
window.onresize = scaled;
window.onhashchange = () => show(Number(location.hash.slice(1)) - 1, true);

await window.MathJax?.startup?.promise;
await Promise.all([...document.images].map((figure) => figure.decode().catch(() => {})));
await document.fonts.ready;
const first = Number(location.hash.slice(1)) || 1;
layOut();
show(first - 1);
scaled();
document.body.classList.add("ready");
