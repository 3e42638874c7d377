// The last two minutes of each figure, since the page was opened, and the lines that show them.
import { attribute, drawn } from "./dom.js";
const SAMPLES = 120, WIDTH = 84, HEIGHT = 20;
const series = new Map();
let sampled = 0;

export function sample(state) {
  const now = performance.now();
  if (now - sampled < 950) return;
  sampled = now;
  const seen = new Set();
  const note = (key, value) => {
    seen.add(key);
    if (!series.has(key)) series.set(key, { values: [], points: null });
    const one = series.get(key);
    one.values.push(value ?? null);
    if (one.values.length > SAMPLES) one.values.shift();
    one.points = null;
  };
  for (const unit of state.units) {
    note(`cpu ${unit.id}`, unit.upkeep_us);
    note(`rate ${unit.id}`, unit.steps_per_s);
    note(`memory ${unit.id}`, unit.memory_bytes);
  }
  for (const target of state.targets) note(`target ${target.label}`, target.rate_hz);
  for (const one of state.qualities) note(qualityKey(one), one.estimate);
  for (const key of series.keys()) if (!seen.has(key)) series.delete(key);
}
export const qualityKey = (one) => `quality ${one.output} ${one.attribute} ${one.host ?? ""}`;
export const spark = () => {
  const svg = drawn("svg", { class: "spark", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" });
  svg.append(drawn("polyline", { points: "" }));
  return svg;
};
export function draw(svg, key) {  // the points are made once for each sample
  const one = series.get(key);
  if (one) attribute(svg.firstElementChild, "points", (one.points ??= points(one.values, SAMPLES)));
}
export const line = (svg, values, most) => attribute(svg.firstElementChild, "points", points(values, most));
function points(values, most) {
  const known = values.filter((value) => value !== null);
  const top = Math.max(...known, 0), bottom = Math.min(...known, 0), range = top - bottom || 1;
  return values.flatMap((value, at) => (value === null ? [] :
    [`${(WIDTH - 1 - (values.length - 1 - at) * (WIDTH - 2) / (most - 1)).toFixed(1)},${(HEIGHT - 2 - (value - bottom) / range * (HEIGHT - 4)).toFixed(1)}`])).join(" ");
}
