// Targets, units and hosts in rows that are made once: afterwards only their texts and lines change.
import { attribute, byId, button, made, put } from "./dom.js";
import { bytes, counted, percent, rate, span, three } from "./figures.js";
import { draw, qualityKey, spark } from "./history.js";
import { suppose } from "./what_if.js";

class Rows {
  constructor(id, cells) {
    this.box = byId(id);
    this.cells = cells;
    this.rows = new Map();
    this.seen = new IntersectionObserver((entries) => {
      for (const entry of entries) entry.target.inView = entry.isIntersecting;
    }, { root: this.box, rootMargin: "100px" });
  }
  // `items` are [key, item], in their order.
  show(items, choose) {
    const wanted = new Set(items.map(([key]) => key));
    for (const [key, row] of this.rows) if (!wanted.has(key)) { this.seen.unobserve(row); row.remove(); this.rows.delete(key); }
    let before = null;
    for (const [key, item] of items) {
      const row = this.rows.get(key) || this.add(key, () => choose(key, this.rows.get(key).item));
      row.item = item;
      const place = before ? before.nextSibling : this.box.firstChild;
      if (place !== row) this.box.insertBefore(row, place);
      before = row;
    }
  }
  add(key, act) {
    const row = made("div", "", "row");
    row.setAttribute("role", "listitem");
    row.parts = {};
    row.parts.name = button("", act, "name");
    row.append(row.parts.name);
    for (const [name, hasLine] of Object.entries(this.cells)) {
      const cell = made("span", "", `cell ${name}`);
      row.parts[name] = made("span", "", "value");
      cell.append(row.parts[name]);
      if (hasLine) cell.append((row.parts[`${name} line`] = spark()));
      row.append(cell);
    }
    this.rows.set(key, row);
    this.seen.observe(row);
    return row;
  }
  *visible() {
    for (const row of this.rows.values()) if (row.inView !== false) yield row;
  }
}
const targetRows = new Rows("targets", { rate: true, about: false, quality: true });
const unitRows = new Rows("units", { cpu: true, rate: true, memory: true, quality: true, wrong: false });
const found = (text) => text.toLowerCase().includes(byId("find").value.trim().toLowerCase());

export function targets(state, choose) {
  const isOnly = byId("only-unmet").checked;
  const shown = state.targets.filter((target) => !(isOnly && target.met) && found(target.label));
  const labels = new Set(shown.map((target) => target.label));
  targetRows.show(shown.map((target) => [target.label, target]), (label) => choose({ kind: "target", id: label }));
  for (const row of targetRows.visible()) {
    const target = row.item, parts = row.parts;
    attribute(row, "class", target.met ? "row" : "row unmet");
    name(parts.name, `${target.met ? "✓" : "✗"} ${target.label}`);
    put(parts.rate, target.rate_hz == null || target.stream === null ? "" : rate(target.rate_hz));
    draw(parts["rate line"], `target ${target.label}`);
    const last = target.silent_s == null ? "nothing came yet" : target.silent_s > 2 ? `last ${span(target.silent_s)} ago` : target.latency_ms == null ? "" : `${span(target.latency_ms / 1000)} old`;
    name(parts.about, target.met ? [target.stream ?? target.unit, target.stream ? last : ""].filter(Boolean).join(" · ") : reason(target, labels), target.met ? undefined : target.reason);
    quality(parts, ofStream(state, target.stream));
  }
}
export function units(state, choose) {
  const shown = state.units.filter((unit) => found(unit.id) || found(unit.host || ""));
  unitRows.show(shown.map((unit) => [unit.id, unit]), (id) => choose({ kind: "unit", id }));
  for (const row of unitRows.visible()) {
    const unit = row.item, parts = row.parts;
    name(parts.name, unit.host ? `${unit.id} · ${unit.host}` : unit.id);
    put(parts.cpu, unit.standby ? "spare" : unit.upkeep_us === undefined ? "starting" : percent(unit.upkeep_us));
    put(parts.rate, unit.steps_per_s === undefined ? "" : rate(unit.steps_per_s));
    put(parts.memory, unit.memory_bytes ? bytes(unit.memory_bytes) : "");
    for (const figure of ["cpu", "rate", "memory"]) draw(parts[`${figure} line`], `${figure} ${unit.id}`);
    quality(parts, qualitiesOf(state, unit)[0]);
    put(parts.wrong, unit.unfed?.length ? "unfed" : unit.errors ? `${unit.errors} errors` : unit.dropped ? `${unit.dropped} lost` : "");
  }
}
// A reason is told at the first target that has it, as the terminal does; where a search hides that one, at each.
function reason(target, shown) {
  return target.as !== target.label && shown.has(target.as) ? `as ${target.as}` : target.told || "not met";
}
function name(element, text, title = text) {
  put(element, text);
  attribute(element, "title", title);
}
export const qualitiesOf = (state, unit) => state.qualities.filter((one) => one.output.startsWith(`${unit.transformation}/`) && (one.host === undefined || one.host === unit.host));
function ofStream(state, stream) {
  const at = stream ? stream.lastIndexOf("/") : 0, unit = stream && state.units.find((each) => each.id === stream.slice(0, at));
  return unit && qualitiesOf(state, unit).find((one) => one.output === `${unit.transformation}${stream.slice(at)}`);
}
function quality(parts, one) {
  parts.quality.parentElement.hidden = !one;
  if (!one) return;
  name(parts.quality, `${one.attribute} ${three(one.estimate)}`);
  draw(parts["quality line"], qualityKey(one));
}
export function hosts(state, token) {
  const names = [...new Set([...state.hosts, ...state.units.map((unit) => unit.host), ...state.lost_hosts])].filter(Boolean).sort();
  byId("hosts").hidden = !names.length;
  const units = names.map((host) => state.units.filter((unit) => unit.host === host).length);
  const key = JSON.stringify([names, units, state.lost_hosts]), list = byId("hosts").querySelector("ul");
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...names.map((host, at) => {
    const isLost = state.lost_hosts.includes(host), row = made("li", "", isLost ? "wrong" : "");
    row.append(made("span", `${host} · ${isLost ? "gone" : counted(units[at], "unit")}`));
    if (token) row.append(button(isLost ? "What if it is used again?" : "What if it is lost?", () => suppose(isLost ? "regain_host" : "lose_host", { host }, isLost ? `with ${host} again` : `without ${host}`)));
    return row;
  }));
}
