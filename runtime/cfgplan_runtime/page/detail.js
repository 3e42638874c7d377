// The chosen unit, target or stream, and the peek into a stream.
import { ask, byId, button, facts, made, post, put, token } from "./dom.js";
import { bytes, clock, coreShare, plain, rate, span } from "./figures.js";
import { line, spark } from "./history.js";
import { qualitiesOf } from "./lists.js";
import { suppose } from "./what_if.js";
const PEEKED = 120;
let chosen = null, state = null, viewer = "", peeked = "", numbers = new Map(), drawnKey = "";

export const isNow = (name) => { viewer = name; if (peeked) peek(peeked); };
export function choose(what) {
  if (!what || what.id !== chosen?.id) { peek(""); byId("why").replaceChildren(); }
  chosen = what;
  drawnKey = "";
  if (what?.kind === "stream") peek(what.id);
  detail(state);
  const { top, bottom } = byId("chosen").getBoundingClientRect();
  if (what && (top > innerHeight || bottom < 0)) byId("chosen").scrollIntoView({ block: "nearest" });
}
export function detail(now) {
  state = now;
  const unit = state.units.find((each) => chosen?.kind === "unit" && each.id === chosen.id);
  const target = state.targets.find((each) => chosen?.kind === "target" && each.label === chosen.id);
  const isStream = chosen && chosen.kind.startsWith("stream");
  byId("chosen").hidden = !(unit || target || isStream);
  if (unit) showUnit(unit);
  else if (target) showTarget(target);
  else if (isStream) showStreams(chosen.streams || [chosen.id]);
}
function shell(title, streams, acts) {
  const key = JSON.stringify([chosen, streams]);
  put(byId("chosen-name"), title);
  if (key === drawnKey) return;
  drawnKey = key;
  byId("members").replaceChildren(...streams.map((stream) => {
    const row = made("li");
    row.append(made("span", stream, "name"), button("Peek", () => peek(stream)));
    return row;
  }));
  byId("chosen-acts").replaceChildren(...(token ? acts() : []));
}
function showUnit(unit) {
  const streams = streamsOf(unit.id);
  shell(unit.id, streams, () => [
    button("Why this?", () => why(unit.id), "ask-why"),
    button("What if without it?", () => suppose("remove_transformation", { label: unit.transformation }, `without ${unit.transformation}`), "what-if"),
    button("Restart", () => ask("restart", { unit: unit.id })),
    button("Kill", () => ask("kill", { unit: unit.id }), "kill danger"),
  ]);
  source(byId("chosen-fault"), unit.last_error ? [{ ...unit.last_error, message: `${unit.errors} errors, the last: ${unit.last_error.message}` }] : []);
  facts(byId("chosen-facts"), {
    transformation: unit.transformation, host: unit.host,
    inputs: Object.entries(unit.inputs).map(([port, from]) => `${port} ← ${[from].flat().join(", ")}`).join("; "),
    "nothing feeds": (unit.unfed || []).join(", "), topics: Object.values(unit.topics).flat().join(", "),
    spare: unit.standby ? (unit.prepared ? "cold, prepared" : "cold") : "", process: unit.pid,
    CPU: unit.upkeep_us == null ? "" : coreShare(unit.upkeep_us), memory: unit.memory_bytes && bytes(unit.memory_bytes),
    steps: unit.steps_per_s === undefined ? "" : `${unit.steps} (${rate(unit.steps_per_s)})`, dropped: unit.dropped,
    quality: qualitiesOf(state, unit).map((one) => `${one.output.split("/").at(-1)} ${one.attribute} ${plain(one.estimate)} observed, ${plain(one.declared)} declared`).join("; "),
  });
}
function showTarget(target) {
  shell(target.label, target.topic ? [target.topic] : [], () => [
    button("What if without it?", () => suppose("remove_target", { label: target.label }, `without ${target.label}`), "what-if"),
  ]);
  source(byId("chosen-fault"), []);
  facts(byId("chosen-facts"), {
    "not met": target.met ? "" : target.reason, tag: target.tag, topic: target.topic, from: target.stream ?? target.unit, priority: target.priority,
    rate: target.rate_hz == null ? "" : rate(target.rate_hz), elements: target.elements, dropped: target.dropped,
    age: target.latency_ms == null ? "" : span(target.latency_ms / 1000), last: target.silent_s == null ? "" : `${span(target.silent_s)} ago`,
  });
}
function showStreams(streams) {
  shell(streams.length === 1 ? streams[0] : `${streams.length} streams`, streams, () => []);
  source(byId("chosen-fault"), []);
  facts(byId("chosen-facts"), { "taken by": streams.length === 1 ? takers(streams[0]) : "" });
}
function streamsOf(id) {
  const known = new Set();
  for (const unit of state.units) {
    if (unit.id === id) for (const port of unit.outputs || []) known.add(`${id}/${port}`);
    for (const stream of Object.values(unit.inputs).flat()) if (stream.slice(0, stream.lastIndexOf("/")) === id) known.add(stream);
  }
  return [...known].sort();
}
const takers = (stream) => [
  ...state.units.filter((unit) => Object.values(unit.inputs).flat().includes(stream)).map((unit) => unit.id),
  ...state.targets.filter((target) => target.stream === stream).map((target) => target.topic || target.label)].join(", ");

// The source lines of faults, as the terminal shows them.
export function source(box, faults) {
  box.hidden = !faults.length;
  const key = JSON.stringify(faults);
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  box.replaceChildren(...faults.flatMap((fault) => [
    made("p", [fault.place, fault.message].filter(Boolean).join(": "), "wrong"),
    ...(fault.lines.length ? [made("pre", fault.lines.join("\n"), "source")] : []),
    ...(fault.mend ? [made("p", fault.mend, "hint")] : [])]));
}
async function why(unit) {
  byId("why").replaceChildren(made("li", "…"));
  const answer = await ask("why", { unit });
  if (chosen?.id === unit) byId("why").replaceChildren(...(answer?.says || []).map((says) => made("li", says)));
}

export function peek(stream) {
  if (!stream && !peeked) return;
  peeked = stream;
  numbers = new Map();
  byId("peek").hidden = !stream;
  put(byId("peek-name"), stream);
  put(byId("peek-facts"), stream ? "Waiting for an element …" : "");
  byId("peek-value").replaceChildren();
  post("peek", { viewer, stream: stream || null }).then((answer) => answer.wrong && put(byId("peek-facts"), answer.wrong), () => {});
}
export function peekedAt(told) {
  if (told.stream !== peeked) return;
  if (told.failed) {
    put(byId("peek-facts"), told.failed);
    return;
  }
  const often = told.rate_hz == null ? "" : `${rate(told.rate_hz)} · `;
  put(byId("peek-facts"), `${often}${span(told.age_s)} old · ${told.elements} seen · ${clock(Date.now() / 1000)}`);
  const box = byId("peek-value"), key = JSON.stringify([Object.keys(told.numbers), Object.keys(told.images)]);
  if (box.dataset.key !== key || !box.firstChild) {
    box.dataset.key = key;
    box.replaceChildren(
      ...Object.keys(told.images).map((name) => Object.assign(made("img"), { alt: `${peeked} ${name}`.trim() })),
      ...Object.keys(told.numbers).map((name) => { const row = made("p", "", "number"); row.append(made("span", name, "name"), made("span", "", "value"), spark()); return row; }),
      made("pre", ""));
  }
  Object.values(told.images).forEach((url, at) => { box.querySelectorAll("img")[at].src = url; });
  Object.entries(told.numbers).forEach(([name, value], at) => {
    const values = numbers.get(name) || [], row = box.querySelectorAll("p.number")[at];
    values.push(value);
    if (values.length > PEEKED) values.shift();
    numbers.set(name, values);
    put(row.children[1], plain(value));
    line(row.children[2], values, PEEKED);
  });
  put(box.lastChild, told.text);
  byId("peek").dataset.elements = told.elements;
}
