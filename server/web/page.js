// The sessions and their newest estimates: one WebSocket a session, two messages of credit, painted once a display frame.
"use strict";

const summary = document.getElementById("summary");
const list = document.getElementById("sessions");
const entrance = document.getElementById("entrance");
const shown = new Map(); // name -> {article, socket, estimate, received}
let token = ""; // nowhere else: neither in the address nor in the browser's storage

function element(parent, tag, text) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}

function number(value) {
  const size = Math.abs(value);
  return value === 0 || (size >= 1e-3 && size < 1e6) ? value.toFixed(4) : value.toExponential(4);
}

function subscribe(name, entry) {
  const path = `/v1/sessions/${encodeURIComponent(name)}/estimates?mode=latest&credit=2`;
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  // A page can set no other header of a socket.
  const protocols = token ? ["isophote.v1", `isophote.token.${token}`] : ["isophote.v1"];
  const socket = new WebSocket(`${scheme}://${location.host}${path}`, protocols);
  entry.socket = socket;
  socket.onmessage = (message) => {
    entry.estimate = JSON.parse(message.data);
    requestAnimationFrame(() => {
      paint(entry);
      if (socket.readyState === WebSocket.OPEN) socket.send('{"credit":1}');
    });
  };
  socket.onclose = () => { entry.socket = null; };
}

function paint(entry) {
  const estimate = entry.estimate;
  entry.state.textContent = ` ${estimate.state} · ${estimate.model.slice(0, estimate.model.indexOf("@") + 16)} · frame ${estimate.frame}`;
  entry.values.replaceChildren();
  estimate.order.concat(Object.keys(estimate.parameters).filter((p) => !estimate.order.includes(p))).forEach((name) => {
    if (!(name in estimate.parameters)) return;
    const at = estimate.order.indexOf(name);
    const variance = at >= 0 && estimate.covariance ? estimate.covariance[at][at] : undefined;
    const row = element(entry.values, "tr");
    element(row, "td", name);
    element(row, "td", number(estimate.parameters[name]));
    element(row, "td", variance === undefined ? "held" : `± ${number(Math.sqrt(variance))}`);
  });
  const fit = estimate.timing_us ? `fit ${estimate.timing_us.fit} µs · ` : "";
  entry.facts.textContent =
    `${fit}iterations ${estimate.iterations.join(" + ")} · ${estimate.ending} · saturated ${(100 * estimate.saturated).toFixed(1)} %`;
}

function show(session) {
  let entry = shown.get(session.name);
  if (!entry) {
    const article = element(list, "article");
    const title = element(article, "h2", session.name);
    entry = { article, state: element(title, "small", ""), session: element(article, "p") };
    entry.session.className = "quiet";
    entry.values = element(article, "table");
    entry.facts = element(article, "p");
    entry.facts.className = "quiet";
    shown.set(session.name, entry);
  }
  const reason = session.reason ? ` (${session.reason})` : "";
  entry.session.textContent = `${session.state}${reason} · ${session.active_model} · ${session.rate_hz.toFixed(1)} Hz · ` +
    `${session.frames} frames fitted, ${session.dropped} dropped`;
  const live = session.state === "running" || session.state === "starting" || session.state === "stalled";
  if (!entry.socket && (live || !entry.estimate)) subscribe(session.name, entry);
}

async function refresh() {
  try {
    const answer = await fetch("/v1/sessions", { headers: token ? { authorization: `Bearer ${token}` } : {} });
    if (!answer.ok) {
      const { detail } = await answer.json();
      entrance.hidden = answer.status !== 401;
      summary.textContent = answer.status === 401 && !token ? "" : detail;
      if (answer.status !== 401) setTimeout(refresh, 1000);
      return;
    }
    entrance.hidden = true;
    const { items } = await answer.json();
    for (const [name, entry] of shown) {
      if (items.some((session) => session.name === name)) continue;
      if (entry.socket) entry.socket.close();
      entry.article.remove();
      shown.delete(name);
    }
    items.forEach(show);
    summary.textContent = items.length === 1 ? "1 session" : `${items.length} sessions`;
  } catch (error) {
    summary.textContent = "the service does not answer";
  }
  setTimeout(refresh, 1000);
}

entrance.addEventListener("submit", (event) => {
  event.preventDefault();
  token = document.getElementById("token").value.trim();
  refresh();
});

refresh();
