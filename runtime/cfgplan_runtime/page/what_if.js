// Supposed changes: the plan and its price first; the second press carries it out.
import { ask, byId, button, facts, made, post } from "./dom.js";
import { cost } from "./figures.js";
let asked = 0;

export async function suppose(change, params, title) {
  const box = byId("supposition"), number = (asked += 1);
  box.replaceChildren(made("h3", `What if: ${title}`), made("p", "A plan is being made …", "hint"));
  byId("supposed").scrollIntoView({ block: "nearest" });
  let answer;
  try {
    answer = await post("do", { method: "what_if", params: { change, params } });
  } catch {
    answer = { wrong: "The run does not answer." };
  }
  if (number !== asked) return;
  const leave = button("Close", () => clear(number));
  if (answer.wrong) {
    box.replaceChildren(made("h3", `What if: ${title}`), made("p", answer.wrong, "wrong"), leave);
    return;
  }
  const list = made("dl"), changes = answer.change_set || { started: [], rewired: [], stopped: [] };
  const names = (units) => units.map((unit) => unit.id ?? unit).join(", ");
  const more = answer.cost_us === null ? 0 : answer.cost_us - answer.cost_now_us;
  facts(list, {
    "cost now": cost(answer.cost_now_us), "cost then": answer.cost_us === null ? "no plan" : cost(answer.cost_us),
    difference: answer.cost_us === null ? "" : `${more < 0 ? "−" : "+"}${cost(Math.abs(more))}`,
    proof: answer.is_proven ? "proven: no plan is cheaper" : `not proven; no plan costs less than ${cost(answer.bound_us)}`,
    start: names(changes.started), rewire: names(changes.rewired), stop: names(changes.stopped),
    "then not met": answer.unmet_says.join("; "),
  });
  const act = button("Do it", async () => {
    clear(number);
    await ask(change, params);
  }, answer.newly_unmet.length ? "danger" : "");
  const acts = made("p", "", "acts");
  acts.append(act, leave);
  box.replaceChildren(made("h3", `What if: ${title}`), list, acts);
}
function clear(number) {
  if (number === asked) byId("supposition").replaceChildren(made("p", "No what-if question is open.", "hint"));
}
