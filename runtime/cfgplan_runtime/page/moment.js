// A moment of the past: the state after a chosen review stands in the place of the present one, until that is wanted again.
import { attribute, byId, put, token } from "./dom.js";
import { clock } from "./figures.js";
let reviews = [], chosen = null, asked = 0, show = () => {};
const slider = byId("scrub");

export const isPast = () => chosen !== null;
export function starts(then) { show = then; }  // `then` gets a state and its review, or null for now
export function known(all) {
  const at = chosen && all.findIndex((one) => one.number === chosen.number);
  reviews = all;
  slider.max = String(all.length);
  slider.value = String(chosen && at >= 0 ? at : all.length);
  ends();
}
export async function look(review) {
  const number = (asked += 1);
  slider.value = String(Math.max(0, reviews.findIndex((one) => one.number === review.number)));
  ends();
  let state;
  try {
    const more = token ? `&token=${encodeURIComponent(token)}` : "";
    state = await (await fetch(`moment?review=${review.number}${more}`)).json();
  } catch {
    state = { refused: "The run does not answer." };
  }
  if (number !== asked) return;
  const wrong = state.refused || state.message;
  chosen = review;
  put(byId("scrubbed"), clock(review.time_s));
  put(byId("moment-says"), wrong || `As it was at ${clock(review.time_s)}. ${review.says}`);
  document.body.dataset.moment = "past";
  byId("moment").hidden = false;
  if (!wrong) show(state, review);
}
export function toNow() {
  asked += 1;
  chosen = null;
  slider.value = slider.max;
  put(byId("scrubbed"), "now");
  delete document.body.dataset.moment;
  byId("moment").hidden = true;
  ends();
  show(null, null);
}
export function nowIs(health) {  // whether the present is well, while the past is shown
  attribute(byId("to-now"), "data-level", health.level);
  attribute(byId("to-now"), "title", health.says);
}
function ends() {
  byId("earlier").disabled = slider.value === "0";
  byId("later").disabled = slider.value === slider.max;
}
const go = (at) => (at >= reviews.length ? toNow() : look(reviews[Math.max(0, at)]));
slider.addEventListener("input", () => go(Number(slider.value)));
byId("earlier").addEventListener("click", () => go(Number(slider.value) - 1));
byId("later").addEventListener("click", () => go(Number(slider.value) + 1));
byId("to-now").addEventListener("click", toNow);
