// Reviews and events, the latest first, with what was planned, why, what changed, when, and how long it took.
import { attribute, button, byId, made } from "./dom.js";
import { clock, cost, span } from "./figures.js";
import { look } from "./moment.js";
const MOST = 300;
const list = byId("timeline");
const reviewRows = new Map(), eventRows = new Map();
let shownNumber = null;

export function reviews(all) {
  for (const review of all) {
    const key = JSON.stringify(review), known = reviewRows.get(review.number);
    if (known?.key === key) continue;
    const row = rowOf(review.time_s, `review ${review.decision}`, review.says, total(review));
    row.key = key;
    row.querySelector("details").append(button("Show this moment", () => look(review), "look"), more(review));
    row.classList.toggle("shown", review.number === shownNumber);
    if (known) {
      row.querySelector("details").open = known.querySelector("details").open;
      known.replaceWith(row);
    } else insert(row);
    reviewRows.set(review.number, row);
  }
}
export function shown(review) {  // marks the review that is looked back to; null: none
  reviewRows.get(shownNumber)?.classList.remove("shown");
  shownNumber = review?.number ?? null;
  const row = reviewRows.get(shownNumber);
  if (!row) return;
  row.classList.add("shown");
  row.parentElement.scrollTop = row.offsetTop - row.parentElement.offsetTop - 40;
}
export function event(one) {
  const key = one.number ?? `${one.time_s} ${one.says}`;
  if (eventRows.has(key)) return;
  const row = rowOf(one.time_s, one.level === "information" ? "event" : "event bad", one.says, "");
  eventRows.set(key, row);
  insert(row);
}
export function only(isOnly) {
  attribute(list, "class", isOnly ? "reviews" : "");
}
function insert(row) {
  let before = list.firstChild;
  while (before && before.time > row.time) before = before.nextSibling;
  const isAtTop = list.scrollTop < 4;
  list.insertBefore(row, before);
  if (isAtTop) list.scrollTop = 0;
  while (list.children.length > MOST) list.lastChild.remove();
}
function rowOf(time, kind, says, took) {
  const row = made("li", "", kind), time_ = made("time", clock(time)), what = made("span", says, "says");
  row.time = time;
  if (kind.startsWith("event")) row.append(time_, made("span", "", "took"), what);
  else {
    const details = made("details"), line = made("summary");
    line.append(time_, made("span", took, "took"), what);
    details.append(line);
    row.append(details);
  }
  return row;
}
function total(review) {
  const parts = Object.values(review.seconds || {});
  return parts.length ? span(parts.reduce((sum, s) => sum + s, 0)) : "";
}
function more(review) {
  const about = made("dl"), changes = review.change_set || { started: [], rewired: [], stopped: [] };
  const names = (units) => units.map((unit) => unit.id ?? unit).join(", ");
  const of = (map) => Object.entries(map || {}).map(([label, why]) => `${label}: ${why}`).join("; ");
  const rows = {
    decision: review.decision, "because of": review.perturbations.map(cause).join(", "),
    "cost before": review.cost_before_us == null ? "" : cost(review.cost_before_us),
    "cost of the plan": review.cost_us == null ? "" : cost(review.cost_us),
    proof: review.cost_us == null ? "" : review.is_proven ? "proven: no plan is cheaper" : `no plan costs less than ${cost(review.bound_us)}`,
    started: names(changes.started), rewired: names(changes.rewired), stopped: names(changes.stopped),
    took: Object.entries(review.seconds || {}).map(([phase, s]) => `${phase} ${span(s)}`).join(", "),
    failed: review.cause, "left out": of(review.avoided), "not met": review.unmet_says.join("; "),
  };
  for (const [name, value] of Object.entries(rows)) if (value) about.append(made("dt", name), made("dd", String(value)));
  return about;
}
const cause = (one) => (typeof one === "string" ? one : [one.kind, one.unit || one.label || one.host || one.reason || ""].join(" ").trim());
