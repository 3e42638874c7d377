"use strict";
// What comes from the run is set as text, never as markup; the picture is the server's SVG.
const token = location.hash.slice(1);
const byId = (id) => document.getElementById(id);
const made = (name, text = "", kind = "") => Object.assign(document.createElement(name), { textContent: text, className: kind });
const clock = (at) => new Date(at * 1000).toTimeString().slice(0, 8);
const span = (s) => (s < 1 ? `${Math.round(s * 1000)} ms` : s < 120 ? `${s.toFixed(1)} s` : `${Math.round(s / 60)} min`);
const rate = (hz) => (hz >= 10 ? hz.toFixed(0) : hz.toFixed(1)) + " Hz";
let state = null, view = null, home = null, chosen = null, frames = 0;

// The picture: moved and zoomed by its viewBox alone.
function show(text) {
  const svg = document.importNode(new DOMParser().parseFromString(text, "image/svg+xml").documentElement, true);
  if (svg.nodeName !== "svg") return;
  const box = svg.viewBox.baseVal;
  const fresh = { x: box.x, y: box.y, width: box.width, height: box.height };
  const same = home && view && ["x", "y", "width", "height"].every((key) => view[key] === home[key]);
  if (!view || same) view = { ...fresh };
  home = fresh;
  for (const name of ["width", "height"]) svg.removeAttribute(name);
  for (const node of svg.querySelectorAll("g.node")) {
    node.setAttribute("tabindex", "0");
    node.setAttribute("role", "button");
    node.addEventListener("click", () => choose(node.id));
    node.addEventListener("keydown", (key) => key.key === "Enter" && choose(node.id));
  }
  for (const [kind, sign] of Object.entries({ started: "+ ", rewired: "~ ", stopped: "- " }))
    for (const text of svg.querySelectorAll(`g.node.${kind} > text:first-of-type`)) text.prepend(sign);
  byId("picture").replaceChildren(svg);
  look();
  if (state) refresh();
}
function look() {
  const svg = byId("picture").firstElementChild;
  if (svg) svg.setAttribute("viewBox", [view.x, view.y, view.width, view.height].join(" "));
}
function zoom(factor) {
  if (!view) return;
  view.x += view.width * (1 - factor) / 2;
  view.y += view.height * (1 - factor) / 2;
  view.width *= factor;
  view.height *= factor;
  look();
}
function move(x, y) {
  if (!view) return;
  view.x += x * view.width;
  view.y += y * view.height;
  look();
}
function fit() {
  view = home && { ...home };
  if (view) look();
}

// The state: only attributes and texts change.
function refresh() {
  const units = new Map(state.units.map((unit) => [unit.id, unit]));
  for (const unit of units.values()) {
    const node = byId(`node ${unit.id}`);
    if (node) node.classList.toggle("gap", Boolean(unit.unfed && unit.unfed.length));
  }
  for (const edge of document.querySelectorAll("#picture g.edge")) {
    const unit = units.get(edge.id.slice("arrow ".length).split("/", 1)[0]);
    const path = edge.querySelector("path"), text = edge.querySelector("text");
    if (!unit || unit.steps_per_s === undefined || !path) continue;
    path.setAttribute("stroke-width", (1 + Math.log10(1 + unit.steps_per_s)).toFixed(2));
    if (!text) continue;
    text.dataset.label ??= text.textContent;
    text.textContent = `${text.dataset.label}  ${rate(unit.steps_per_s)}`;
  }
  facts();
  targets();
  hosts();
  reviews();
  declared();
  if (chosen) choose(chosen);
  document.body.dataset.frames = ++frames;
}
function facts() {
  const met = state.targets.filter((target) => target.met).length;
  const said = [state.phase, `${met} of ${state.targets.length} targets met`, state.units.length === 1 ? "1 unit" : `${state.units.length} units`,
    `${(state.cost_us / 1e6).toPrecision(3)} s of CPU per ${span(state.horizon_s)}`];
  if (state.saving_us) said.push(`${(state.saving_us / 1e6).toPrecision(3)} s could be saved by replanning at the horizon`);
  if (state.horizon_left_s !== null) said.push(`horizon in ${span(state.horizon_left_s)}`);
  for (const [name, value] of Object.entries(state.facts)) said.push(`${name} is ${value}`);
  for (const [label, why] of Object.entries(state.left_out)) said.push(`left out for now: ${label}, ${why}`);
  for (const [what, value] of Object.entries(state.qualities_now)) said.push(`${what} ${value}`);
  byId("facts").textContent = said.join("  ·  ");
  const fault = state.faults[0];
  byId("fault").hidden = !fault;
  if (fault) byId("fault").textContent = `The file has an error; the run keeps the last valid version: ${fault.message}`;
}
function targets() {
  byId("targets").tBodies[0].replaceChildren(...state.targets.map((target) => {
    const row = made("tr"), there = target.stream !== null;
    const age = target.silent_s > 2 ? `silent for ${span(target.silent_s)}` : target.latency_ms == null ? "" : span(target.latency_ms / 1000);
    row.append(
      made("td", `${target.met ? "✓" : "✗"} ${target.label}`, target.met ? "" : "wrong"),
      made("td", there && target.rate_hz != null ? rate(target.rate_hz) : "", "number"),
      made("td", there ? age : "", "number"),
      made("td", target.met ? target.stream ?? target.unit : target.reason, target.met ? "" : "wrong"));
    return row;
  }));
}
function hosts() {
  const names = [...new Set([...state.units.map((unit) => unit.host), ...state.lost_hosts])].filter(Boolean).sort();
  byId("hosts").hidden = !names.length;
  const key = JSON.stringify([names, state.lost_hosts]), list = byId("hosts").querySelector("ul");
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...names.map((name) => {
    const lost = state.lost_hosts.includes(name), row = made("li", `${name}${lost ? " (gone)" : ""} `, lost ? "wrong" : "");
    if (token) {
      const button = made("button", lost ? "Use it again" : "Do without it");
      button.addEventListener("click", () => ask(lost ? "regain_host" : "lose_host", { host: name }));
      row.append(button);
    }
    return row;
  }));
}
function reviews() {
  const list = byId("reviews"), last = state.reviews.at(-1);
  if (!last || list.dataset.last === String(last.time_s)) return;
  list.dataset.last = last.time_s;
  list.replaceChildren(...[...state.reviews].reverse().map((review) => {
    const row = made("li"), more = made("details"), line = made("summary"), about = made("dl");
    line.append(made("time", clock(review.time_s)), review.says);
    const costs = (value) => (value == null ? null : `${(value / 1e6).toPrecision(4)} s of CPU`);
    const changes = review.change_set || { started: [], rewired: [], stopped: [] };
    const seconds = Object.entries(review.seconds || {}).map(([phase, s]) => `${phase} ${span(s)}`).join(", ");
    const rows = { decision: review.decision, "because of": review.perturbations.map(cause).join(", "),
      "kept as it was": costs(review.cost_before_us), "this plan": costs(review.cost_us),
      proven: review.cost_us == null ? "" : review.is_proven ? "no plan is cheaper" : `none costs less than ${costs(review.bound_us)}`,
      started: changes.started.map((unit) => unit.id).join(", "),
      rewired: changes.rewired.map((unit) => unit.id).join(", "), stopped: changes.stopped.join(", "),
      took: seconds, failed: review.cause,
      "left out": Object.entries(review.avoided || {}).map(([label, why]) => `${label} (${why})`).join(", "),
      "not met": Object.entries(review.unmet || {}).map(([label, why]) => `${label}: ${why}`).join("; ") };
    for (const [name, value] of Object.entries(rows)) if (value) about.append(made("dt", name), made("dd", String(value)));
    more.append(line, about);
    row.append(more);
    return row;
  }));
}
const cause = (one) => (typeof one === "string" ? one : [one.kind, one.unit || one.label || one.host || one.reason || ""].join(" ").trim());
function choose(id) {
  const unit = state && state.units.find((each) => `node ${each.id}` === id);
  chosen = unit ? id : null;
  byId("chosen").hidden = !unit;
  if (!unit) return;
  if (byId("chosen-name").textContent !== unit.id) byId("why").replaceChildren();
  byId("chosen-name").textContent = unit.id;
  byId("restart").hidden = byId("kill").hidden = byId("ask-why").hidden = !token;
  const fed = Object.entries(unit.inputs).map(([port, from]) => `${port} ← ${[from].flat().join(", ")}`);
  const rows = { transformation: unit.transformation, host: unit.host, inputs: fed.join("; "),
    "nothing feeds": (unit.unfed || []).join(", "),
    topics: Object.values(unit.topics).flat().join(", "), spare: unit.standby ? (unit.prepared ? "cold, prepared" : "cold") : "", pid: unit.pid,
    cpu: unit.upkeep_us == null ? "" : `${(unit.upkeep_us / 1e4).toFixed(1)} %`,
    memory: unit.memory_bytes && `${Math.round(unit.memory_bytes / 2 ** 20)} MB`,
    steps: unit.steps_per_s === undefined ? "" : `${unit.steps} (${rate(unit.steps_per_s)})`,
    dropped: unit.dropped, errors: unit.errors && `${unit.errors}: ${unit.last_error}` };
  byId("chosen-facts").replaceChildren(...Object.entries(rows)
    .filter(([, value]) => value || value === 0).flatMap(([name, value]) => [made("dt", name), made("dd", String(value))]));
}
async function why(unit) {
  byId("why").replaceChildren(made("li", "..."));
  const answer = await ask("why", { unit });
  if (byId("chosen-name").textContent !== unit) return;
  byId("why").replaceChildren(...(answer && answer.says ? answer.says.map((line) => made("li", line)) : []));
}
function declared() {
  const list = byId("declared"), key = JSON.stringify(state.declared);
  byId("adding").hidden = !token;
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...state.declared.map((name) => {
    const row = made("li", `${name} `);
    if (token) {
      const button = made("button", "Withdraw");
      button.addEventListener("click", () => ask("withdraw", { name }));
      row.append(button);
    }
    return row;
  }));
}
async function add() {
  const text = byId("add-text").value, name = byId("add-name").value.trim();
  const answer = await ask("add", name ? { name, text } : { text });
  if (answer) byId("add-text").value = byId("add-name").value = "";
}
async function ask(method, params = {}) {
  byId("answer").textContent = "...";
  const headers = { "Content-Type": "application/json", "X-Token": token };
  try {
    const reply = await fetch("do", { method: "POST", headers, body: JSON.stringify({ method, params }) });
    const answer = await reply.json();
    const wrong = reply.ok ? answer.refused : answer.message;
    byId("answer").textContent = wrong || (answer.review ? answer.review.says : answer.says ? "" : "Done.");
    return wrong ? null : answer;
  } catch {
    byId("answer").textContent = "The run does not answer.";
    return null;
  }
}
function happened(event) {
  const row = made("li"), list = byId("events");
  row.append(made("time", clock(event.at)), event.says);
  list.prepend(row);
  while (list.children.length > 100) list.lastChild.remove();
}

const source = new EventSource(token ? `messages?token=${encodeURIComponent(token)}` : "messages");
const on = (kind, then) => source.addEventListener(kind, (message) => then(JSON.parse(message.data)));
on("run", (run) => {
  byId("title").textContent = document.title = `${run.environment}, run ${run.run}`;
  byId("events").replaceChildren();
});
on("picture", show);
on("state", (told) => { state = told; refresh(); });
on("event", (event) => event.kind !== "Reviewed" && happened(event));
on("ended", () => { source.close(); byId("facts").textContent = "The run has ended."; });
source.addEventListener("error", () => { if (source.readyState !== 2) byId("facts").textContent = "The server does not answer; trying again."; });

byId("acts").hidden = !token;
byId("closer").addEventListener("click", () => zoom(0.8));
byId("wider").addEventListener("click", () => zoom(1.25));
byId("fit").addEventListener("click", fit);
byId("close").addEventListener("click", () => choose(null));
for (const act of ["kill", "restart"]) {
  byId(act).addEventListener("click", () => chosen && ask(act, { unit: chosen.slice("node ".length) }));
}
byId("ask-why").addEventListener("click", () => chosen && why(chosen.slice("node ".length)));
byId("add").addEventListener("click", add);
byId("review").addEventListener("click", () => ask("review"));
byId("stop").addEventListener("click", () => confirm("Stop the run?") && ask("stop"));
const picture = byId("picture");
const keys = { "+": () => zoom(0.8), "-": () => zoom(1.25), 0: fit, ArrowLeft: () => move(-0.1, 0), ArrowRight: () => move(0.1, 0),
  ArrowUp: () => move(0, -0.1), ArrowDown: () => move(0, 0.1), Escape: () => choose(null) };
picture.addEventListener("keydown", (key) => { if (keys[key.key]) { keys[key.key](); key.preventDefault(); } });
picture.addEventListener("wheel", (wheel) => { zoom(wheel.deltaY > 0 ? 1.1 : 0.9); wheel.preventDefault(); }, { passive: false });
picture.addEventListener("pointermove", (pointer) => {
  if (pointer.buttons === 1) move(-pointer.movementX / picture.clientWidth, -pointer.movementY / picture.clientHeight);
});
