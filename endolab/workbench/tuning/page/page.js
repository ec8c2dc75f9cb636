// Shows one AnyWidget, as Jupyter would: what Python says comes over a WebSocket, a message as JSON
// and each of its buffers behind it, and what is done here goes back.
const channel = new WebSocket(new URL("channel", location.href.replace(/^http/, "ws")));
channel.binaryType = "arraybuffer";
const state = {}, listeners = { "msg:custom": new Set(), comm_live_update: new Set() };
const place = document.getElementById("widget");
const model = {
  get: (name) => state[name],
  send(content) {
    if (channel.readyState === WebSocket.OPEN) channel.send(JSON.stringify(content));
  },
  on: (event, action) => listeners[event].add(action),
  off: (event, action) => listeners[event].delete(action),
};

async function show() {
  const el = document.createElement("div");
  document.head.appendChild(document.createElement("style")).textContent = state._css;
  const script = new Blob([state._esm], { type: "text/javascript" });
  const { default: { render } } = await import(URL.createObjectURL(script));
  place.replaceChildren(el);
  render({ model, el });
}

let message, buffers;
channel.onmessage = ({ data }) => {
  if (typeof data === "string") [message, buffers] = [JSON.parse(data), []];
  else buffers.push(new DataView(data));
  if (buffers.length < message.buffers) return;
  if (message.content) {
    for (const hear of listeners["msg:custom"]) hear(message.content, buffers);
    return;
  }
  Object.assign(state, message.state);
  show().catch((error) => {
    place.textContent = `The page cannot be shown: ${error.message}`;
    throw error;
  });
};
// After the end; if it was but a pause, the page is loaded again.
channel.onclose = () => {
  const load_again = ({ ok }) => { if (ok) location.reload(); };
  for (const end of listeners.comm_live_update) end();
  setInterval(() => fetch(location.href).then(load_again, () => {}), 5000);
};
// A tab that is left says so; one that the browser puts to sleep, or that dies, does not.
window.addEventListener("pagehide", () => channel.close(1000));
window.addEventListener("pageshow", ({ persisted }) => { if (persisted) location.reload(); });
