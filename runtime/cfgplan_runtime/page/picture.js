// The picture of running units, in layers; its text has one size, and a large picture scrolls.
import { HIGH, folded, placed } from "./folding.js";
import { byId, button, drawn, made, put } from "./dom.js";
import { counted, percent, rate } from "./figures.js";
const open = new Set();
const ruler = document.createElement("canvas").getContext("2d");
const cuts = new Map();
let shown = "", graph = null, last = null, wide = 0;

export function picture(state, ghosts, marks, choose) {
  last = { state, ghosts, marks, choose, units: new Map(state.units.map((unit) => [unit.id, unit])), targets: new Map(state.targets.map((target) => [target.label, target])) };
  const by = byId("fold-by").value, box = byId("picture");
  if (!box.clientWidth) return;
  const units = [...state.units, ...ghosts];
  const key = JSON.stringify([by, [...open], box.clientWidth, units.map((unit) => [unit.id, unit.host, unit.inputs]),
    state.targets.map((target) => [target.label, target.met, target.stream, target.unit])]);
  if (key !== shown) {
    shown = key;
    graph = folded(units, state.targets, open, by);
    layOut(box, choose);
  }
  refresh(marks, new Set(ghosts.map((unit) => unit.id)));
}
export const redraw = () => last && picture(last.state, last.ghosts, last.marks, last.choose);

function layOut(box, choose) {
  const size = placed(graph, box.clientWidth, box.clientHeight - 2);
  wide = size.wide;
  const svg = drawn("svg", { width: size.width, height: size.height, role: "group", "aria-label": "Units and streams" });
  svg.append(arrowHead());
  const known = new Map(graph.nodes.map((node) => [node.id, node]));
  for (const edge of graph.edges) svg.append(arrow(edge, known.get(edge.from), known.get(edge.to), size.isAcross, choose));
  for (const node of graph.nodes) svg.append(boxOf(node, choose));
  const focused = document.activeElement?.id;
  box.replaceChildren(svg);
  if (focused && box.contains(byId(focused))) byId(focused).focus();
  byId("unfolded").replaceChildren(...[...open].map((key) => button(`fold ${key.replace(/^\S+ /, "")}`, () => { open.delete(key); redraw(); })));
}
function arrowHead() {
  const defs = drawn("defs"), marker = drawn("marker", { id: "tip", viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 7, markerHeight: 7, orient: "auto", markerUnits: "userSpaceOnUse" });
  marker.append(drawn("path", { d: "M0,0 L8,4 L0,8 Z" }));
  defs.append(marker);
  return defs;
}
function arrow(edge, from, to, isAcross, choose) {
  const [x1, y1, x2, y2] = isAcross ? [from.x + wide, from.y + HIGH / 2, to.x - 1, to.y + HIGH / 2] : [from.x + wide / 2, from.y + HIGH, to.x + wide / 2, to.y - 1];
  const bend = Math.max(24, Math.abs(isAcross ? x2 - x1 : y2 - y1) / 2);
  const d = isAcross ? `M${x1},${y1} C${x1 + bend},${y1} ${x2 - bend},${y2} ${x2},${y2}` : `M${x1},${y1} C${x1},${y1 + bend} ${x2},${y2 - bend} ${x2},${y2}`;
  const group = drawn("g", { class: "edge" }), names = [...new Set(edge.streams)];
  group.append(drawn("title", {}, names.length > 6 ? `${names.slice(0, 6).join(", ")} and ${names.length - 6} more` : names.join(", ")));
  group.append(drawn("path", { d, class: "line", "marker-end": "url(#tip)" }), drawn("path", { d, class: "hit" }));
  group.addEventListener("click", () => choose(names.length === 1 ? { kind: "stream", id: names[0] } : { kind: "streams", id: `${edge.from} > ${edge.to}`, streams: names }));
  edge.element = group;
  return group;
}
function boxOf(node, choose) {
  const group = drawn("g", { id: node.id, class: "node", tabindex: 0, role: "button", transform: `translate(${node.x} ${node.y})` });
  const isGroup = isFolded(node);
  if (isGroup) group.append(drawn("rect", { x: 4, y: 4, width: wide, height: HIGH, rx: 7, class: "behind" }));
  group.append(drawn("rect", { width: wide, height: HIGH, rx: node.kind.startsWith("target") ? HIGH / 2 : 7 }));
  group.append(drawn("text", { x: 12, y: 18, class: "name" }), drawn("text", { x: 12, y: 35, class: "figure" }), drawn("title"));
  const act = () => {
    if (!isGroup) choose({ kind: node.kind, id: node.members[0].id ?? node.members[0].label });
    else if (node.key) {
      open.add(node.key);
      redraw();
    }
  };
  group.addEventListener("click", act);
  group.addEventListener("keydown", (key) => {
    if (key.key === "Enter" || key.key === " ") { key.preventDefault(); act(); }
  });
  node.element = group;
  return group;
}

function refresh(marks, ghosts) {
  for (const node of graph.nodes) {
    const current = node.members.map((member) => now(node, member));
    const [name, figure, title, state] = node.kind.startsWith("target") ? ofTargets(node, current) : ofUnits(node, current, marks, ghosts);
    const [label, line] = node.element.querySelectorAll("text");
    put(label, cut(name, "600 13px system-ui, sans-serif"));
    put(line, cut(figure, "12px system-ui, sans-serif"));
    put(node.element.querySelector("title"), title);
    const kind = `node ${node.kind} ${state}`;
    if (node.element.getAttribute("class") !== kind) node.element.setAttribute("class", kind);
  }
  const rates = new Map(last.state.units.map((unit) => [unit.id, unit.steps_per_s || 0]));
  for (const edge of graph.edges) {
    const hz = Math.max(...edge.streams.map((stream) => rates.get(stream.slice(0, stream.lastIndexOf("/"))) || 0));
    const width = (1 + Math.log10(1 + hz)).toFixed(1);
    if (edge.width !== width) edge.element.children[1].setAttribute("stroke-width", (edge.width = width));
  }
}
const now = (node, member) => (node.kind.startsWith("target") ? last.targets.get(member.label) : last.units.get(member.id)) || member;

const isFolded = (node) => node.kind === "group" || node.kind === "targets";

function ofUnits(node, units, marks, ghosts) {
  const sum = (key) => units.reduce((total, unit) => total + (unit[key] || 0), 0);
  const isSpare = units.every((unit) => unit.standby), isSeen = units.some((unit) => unit.upkeep_us !== undefined);
  const figures = isSpare ? "cold spare" : isSeen ? `${percent(sum("upkeep_us"))} · ${rate(sum("steps_per_s"))}` : "starting";
  const wrong = units.some((unit) => unit.unfed?.length) ? "gap" : units.some((unit) => unit.errors) ? "faulty" : "";
  const gone = units.filter((unit) => ghosts.has(unit.id)).length, isGroup = node.kind === "group";
  const changed = units.map((unit) => marks.get(unit.id)).find(Boolean);
  const mark = gone === units.length ? "stopped" : changed || (isSpare ? "spare" : "kept");
  const sign = { started: "+ ", rewired: "~ ", stopped: "− " }[mark] || (wrong ? "! " : "");
  const name = isGroup ? `${node.title} × ${units.length - gone}${gone ? ` − ${gone}` : ""}` : node.title;
  const hosts = [...new Set(units.map((unit) => unit.host).filter(Boolean))].join(", ");
  return [sign + name, ghosts.has(units[0].id) && !isGroup ? "stopped" : figures,
    `${name}${hosts ? ` on ${hosts}` : ""}: ${figures}${isGroup ? "; press to unfold" : ""}`, `${mark} ${gone && mark !== "stopped" ? "gap" : wrong}`];
}
function ofTargets(node, targets) {
  const unmet = targets.filter((target) => !target.met), isGroup = node.kind === "targets";
  const name = isGroup ? `${counted(targets.length, "target")}${unmet.length ? " not met" : ""}` : node.title;
  const hz = targets.reduce((most, target) => Math.max(most, target.rate_hz || 0), 0);
  const figure = unmet.length ? (isGroup ? "press to unfold" : unmet[0].told || "not met") : hz ? rate(hz) : "nothing yet";
  return [`${unmet.length ? "✗" : "✓"} ${name}`, figure, `${name}: ${unmet.length ? [...new Set(unmet.map((target) => target.told))].join("; ") : "met"}`, unmet.length ? "unmet" : "met"];
}
// Cuts the middle of a text, as ends of names tell them apart.
function cut(text, font) {
  const key = `${wide} ${font} ${text}`;
  if (cuts.has(key)) return cuts.get(key);
  ruler.font = font;
  let fits = text, left = text.length;
  while (ruler.measureText(fits).width > wide - 24 && left > 4) {
    left -= 1;
    fits = `${text.slice(0, Math.ceil(left * 0.6))}…${text.slice(text.length - Math.floor(left * 0.4))}`;
  }
  if (cuts.size > 5000) cuts.clear();
  cuts.set(key, fits);
  return fits;
}
