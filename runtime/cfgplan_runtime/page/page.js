// The page of a run: messages come in, and each part of the page shows its share.
import { ask, attribute, button, byId, made, put, token } from "./dom.js";
import { choose, detail, isNow, peek, peekedAt, source } from "./detail.js";
import { bytes, coreShare, cost, span } from "./figures.js";
import { sample } from "./history.js";
import { hosts, targets, units } from "./lists.js";
import { isPast, known, nowIs, starts, toNow } from "./moment.js";
import { picture, redraw } from "./picture.js";
import { event, only, reviews, shown } from "./timeline.js";
import { suppose } from "./what_if.js";
const MARKED_MS = 5000;
const SIGNS = { well: "✓", warning: "!", bad: "✗", waiting: "…" };
let state = null, present = null, frames = 0, lastReview = null;
let changes = new Map();  // the marks of the review that is looked back to
const marks = new Map(), ghosts = new Map();

function refresh() {
  const now = performance.now();
  for (const marked of [marks, ghosts]) for (const [id, one] of marked) if (now > one.until) marked.delete(id);
  health();
  tiles();
  sample(present);
  targets(state, choose);
  units(state, choose);
  hosts(state, token);
  declared();
  const there = new Set(state.units.map((unit) => unit.id));
  if (isPast()) picture(state, [], changes, choose);
  else picture(state, [...ghosts.values()].filter((one) => !there.has(one.unit.id)).map((one) => one.unit),
    new Map([...marks].map(([id, one]) => [id, one.kind])), choose);
  detail(state);
  document.body.dataset.frames = ++frames;
}
function health() {
  const { level, says } = state.health;
  attribute(byId("health"), "data-level", level);
  attribute(byId("health"), "title", says);
  put(byId("mark"), SIGNS[level]);
  put(byId("says"), says);
}
function tiles() {
  const met = state.targets.filter((target) => target.met).length, sum = (key) => state.units.reduce((total, unit) => total + (unit[key] || 0), 0);
  const shown = {
    targets: `${met} of ${state.targets.length}`, units: String(state.units.length), cpu: coreShare(sum("upkeep_us")),
    plan: state.horizon_s ? coreShare(state.cost_us / state.horizon_s) : "", memory: bytes(sum("memory_bytes")), phase: state.phase,
    horizon: state.horizon_left_s === null ? "none" : `in ${span(Math.round(state.horizon_left_s))}`,
  };
  for (const [name, text] of Object.entries(shown)) put(byId(`tile-${name}`), text);
  const notes = [
    ...(state.saving_us ? [`Replanning at the horizon could save ${cost(state.saving_us)}.`] : []),
    ...Object.entries(state.facts).map(([name, value]) => `${name} is ${value}`),
    ...Object.entries(state.left_out).map(([label, why]) => `Left out for now: ${label}, ${why}`),
    ...Object.entries(state.barred).flatMap(([label, hosts]) =>
      Object.entries(hosts).map(([host, why]) => `${label} may not run on ${host} for now: ${why}`)),
    ...Object.entries(state.qualities_now).map(([what, value]) => `${what} ${value}`),
    ...state.waiting.map((one) => `${one.names.join(", ")}: ${one.says}`)];
  const key = JSON.stringify(notes), list = byId("notes");
  if (list.dataset.key !== key) {
    list.dataset.key = key;
    list.hidden = !notes.length;
    list.replaceChildren(...notes.map((text) => made("li", text)));
  }
  source(byId("fault"), state.faults.map((fault) => ({ ...fault, message: `${fault.message}. The run keeps the last valid version.` })));
}
// Units that an update has started, rewired or stopped are marked for some seconds; stopped ones stay in the picture so long.
function changed(all) {
  const last = all.at(-1);
  if (last && lastReview !== null && last.number > lastReview) {
    const until = performance.now() + MARKED_MS;
    for (const review of all.filter((one) => one.number > lastReview && one.change_set)) {
      for (const kind of ["started", "rewired"]) for (const unit of review.change_set[kind]) marks.set(unit.id, { kind, until });
    }
  }
  lastReview = last ? last.number : 0;
  known(all);
  reviews(all);
}
function taken(told) {
  if (present) {
    const there = new Set(told.units.map((unit) => unit.id));
    for (const unit of present.units) if (!there.has(unit.id)) ghosts.set(unit.id, { unit, until: performance.now() + MARKED_MS });
  }
  present = told;
  nowIs(present.health);
  if (!isPast()) state = present;
  refresh();
}
starts((past, review) => {
  if (!present) return;
  changes = new Map(["started", "rewired"].flatMap((kind) => (review?.change_set?.[kind] || []).map((unit) => [unit.id, kind])));
  state = past || present;
  shown(review);
  refresh();
});
function declared() {
  const list = byId("declared"), key = JSON.stringify([state.declared, state.removed]);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  const row = (name, text, method) => {
    const element = made("li");
    element.append(made("span", name));
    if (token) element.append(button(text, () => ask(method, { name })));
    return element;
  };
  list.replaceChildren(...state.declared.map((name) => row(name, "Withdraw", "withdraw")), ...state.removed.map((name) => row(`${name} (removed)`, "Restore", "restore")));
}
const addition = () => {
  const text = byId("add-text").value, name = byId("add-name").value.trim();
  return name ? { name, text } : { text };
};
async function add() {
  if (await ask("add", addition())) byId("add-text").value = byId("add-name").value = "";
}

const messages = new EventSource(token ? `messages?token=${encodeURIComponent(token)}` : "messages");
const on = (kind, then) => messages.addEventListener(kind, (message) => then(JSON.parse(message.data)));
const lost = (says) => {
  attribute(byId("health"), "data-level", "waiting");
  put(byId("mark"), SIGNS.waiting);
  put(byId("says"), says);
};
on("run", (run) => {
  put(byId("title"), `${run.environment}, run ${run.name ? `${run.name} (${run.run})` : run.run}`);
  document.title = byId("title").textContent;
  isNow(run.viewer);
});
on("state", taken);
on("reviews", changed);
on("event", event);
on("peek", peekedAt);
on("ended", () => { messages.close(); lost("The run has ended."); });
messages.addEventListener("error", () => { if (messages.readyState !== 2) lost("The server does not answer; trying again."); });

for (const id of ["supposed", "adding", "acts"]) byId(id).hidden = !token;
byId("close").addEventListener("click", () => choose(null));
byId("close-peek").addEventListener("click", () => peek(""));
byId("add").addEventListener("click", add);
byId("add-what-if").addEventListener("click", () => suppose("add", addition(), `with ${addition().name || "this addition"}`));
byId("review").addEventListener("click", () => ask("review"));
byId("stop").addEventListener("click", () => confirm("Stop the run?") && ask("stop"));
byId("only-reviews").addEventListener("change", (change) => only(change.target.checked));
for (const id of ["find", "only-unmet"]) byId(id).addEventListener("input", () => state && refresh());
byId("fold-by").addEventListener("change", redraw);
document.addEventListener("keydown", (key) => { if (key.key === "Escape") { if (isPast()) toNow(); else choose(null); } });
new ResizeObserver(redraw).observe(byId("picture"));
