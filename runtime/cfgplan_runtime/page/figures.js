// Figures as people think; the same as cfgplan/amounts.py, which a test compares.
const short = (value) => (Math.abs(value) >= 9.95 ? value.toFixed(0) : String(Number(value.toPrecision(2))));
const two = (s, large, a, small, b) => {
  const rest = Math.floor((s % large) / small);
  return `${Math.floor(s / large)} ${a}${rest ? ` ${rest} ${b}` : ""}`;
};
export function span(s) {
  if (s < 0) return `-${span(-s)}`;
  if (s === 0) return "0 s";
  if (s < 0.9995) return `${short(s * 1e3)} ms`;
  if (s < 9.95) return `${short(s)} s`;
  if (s < 120) return `${s.toFixed(0)} s`;
  if (s < 7200) return `${(s / 60).toFixed(0)} min`;
  return s < 172800 ? two(s, 3600, "h", 60, "min") : two(s, 86400, "d", 3600, "h");
}
export const rate = (hz) => (hz <= 0 ? "never" : hz >= 0.95 ? `${short(hz)} Hz` : `every ${span(1 / hz)}`);
export const three = (value) => {
  if (!value) return "0";
  const text = value.toFixed(Math.max(0, 2 - Math.floor(Math.log10(Math.abs(value)))));
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
};
export const percent = (us) => `${three(us / 1e4)} %`;
export const coreShare = (us) => (us / 1e4 >= 199.95 ? `${three(us / 1e6)} cores` : `${three(us / 1e4)} % of a core`);
export const cost = (us) => `${three(us / 1e6)} s of CPU`;
export const bytes = (n) => (n < 2 ** 30 ? `${Math.round(n / 2 ** 20)} MB` : `${(n / 2 ** 30).toFixed(1)} GB`);
export const clock = (s) => new Date(s * 1000).toTimeString().slice(0, 8);
export const plain = (value) => (Number.isInteger(value) && Math.abs(value) < 1e9 ? String(value) : String(Number(value.toPrecision(5))));
export const counted = (n, one, many = `${one}s`) => `${n} ${n === 1 ? one : many}`;
