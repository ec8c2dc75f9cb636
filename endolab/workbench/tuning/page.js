// Shows one widget of AnyWidgets, as Jupyter would: what they say comes over a WebSocket, a message as JSON and each
// of its buffers behind it, and what is done here goes back.
const first = "WIDGET";
const channel = new WebSocket(new URL("channel", location.href.replace(/^http/, "ws")));
channel.binaryType = "arraybuffer";
const models = new Map();

function made(id) {
  const state = {}, listeners = {};
  let changed = {}, busy = false;
  const tell = (data) => {
    if (channel.readyState === WebSocket.OPEN) channel.send(JSON.stringify({ id, data }));
  };
  const emit = (names) => names.forEach((name) => listeners[`change:${name}`]?.forEach((action) => action()));
  const model = {
    get: (name) => state[name],
    set(name, value) { state[name] = changed[name] = value; emit([name]); },
    send(content) { tell({ method: "custom", content }); },
    // While one change is worked on, the next ones wait, of which the latest goes.
    save_changes() {
      if (busy || !Object.keys(changed).length) return;
      busy = true;
      tell({ method: "update", state: changed });
      changed = {};
    },
    on(event, action) { (listeners[event] ??= new Set()).add(action); },
    off(event, action) { listeners[event]?.delete(action); },
    done() { busy = false; model.save_changes(); },
    take(values) { Object.assign(state, values); emit(Object.keys(values)); },
    widget_manager: { get_model: async (name) => models.get(name), create_view: shown },
  };
  return model;
}

async function shown(model) {
  const el = document.createElement("div"), style = document.head.appendChild(document.createElement("style"));
  style.textContent = model.get("_css") ?? "";
  const script = URL.createObjectURL(new Blob([model.get("_esm")], { type: "text/javascript" }));
  const { default: { render } } = await import(script);
  const place = document.getElementById("widget");
  if (model === models.get(first)) place.replaceChildren(el);
  render({ model, el });
  return { el };
}

let message, buffers;
channel.onmessage = ({ data }) => {
  if (typeof data === "string") [message, buffers] = [JSON.parse(data), []];
  else buffers.push(new DataView(data));
  const { id, done, state, buffer_paths } = message;
  if (done) { models.get(id).done(); return; }
  if (buffers.length < buffer_paths.length) return;
  buffer_paths.forEach(([name], i) => { state[name] = buffers[i]; });
  const isNew = !models.has(id);
  if (isNew) models.set(id, made(id));
  models.get(id).take(state);
  if (isNew && id === first) {
    shown(models.get(id)).catch((error) => {
      document.getElementById("widget").textContent = `The page cannot be shown: ${error.message}`;
      throw error;
    });
  }
};
// After the end; if it was but a pause, the page is loaded again.
channel.onclose = () => {
  document.body.className = "lost";
  setInterval(() => fetch(location.href).then(({ ok }) => { if (ok) location.reload(); }, () => {}), 5000);
};
// A tab that is left says so; one that the browser puts to sleep, or that dies, does not.
window.addEventListener("pagehide", () => channel.close(1000));
window.addEventListener("pageshow", ({ persisted }) => { if (persisted) location.reload(); });
