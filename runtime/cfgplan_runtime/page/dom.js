// What comes from the run is set as text, never as markup.
export const token = location.hash.slice(1);
export const byId = (id) => document.getElementById(id);
export const made = (name, text = "", kind = "") => Object.assign(document.createElement(name), { textContent: text, className: kind });
export const drawn = (name, attributes = {}, text = "") => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text) element.textContent = text;
  return element;
};
export function put(element, text) {  // writes only what differs: an equal text costs no layout
  if (element.textContent !== text) element.textContent = text;
}
export function attribute(element, name, value) {
  if (element.getAttribute(name) !== value) element.setAttribute(name, value);
}
export function button(text, then, kind = "") {
  const element = made("button", text, kind);
  element.type = "button";
  element.addEventListener("click", then);
  return element;
}
export function facts(list, rows) {
  const wanted = Object.entries(rows).filter(([, value]) => value || value === 0);
  const key = JSON.stringify(wanted.map(([name]) => name));
  if (list.dataset.key !== key) {
    list.dataset.key = key;
    list.replaceChildren(...wanted.flatMap(([name]) => [made("dt", name), made("dd")]));
  }
  wanted.forEach(([, value], at) => put(list.children[2 * at + 1], String(value)));
}
export async function post(path, body) {
  const headers = { "Content-Type": "application/json", "X-Token": token };
  const reply = await fetch(path, { method: "POST", headers, body: JSON.stringify(body) });
  const answer = await reply.json();
  const wrong = reply.ok ? answer.refused : answer.message;
  return wrong ? { wrong } : answer;
}
export async function ask(method, params = {}) {
  put(byId("answer"), "…");
  let answer;
  try {
    answer = await post("do", { method, params });
  } catch {
    answer = { wrong: "The run does not answer." };
  }
  put(byId("answer"), answer.wrong || (answer.review ? answer.review.says : answer.says ? "" : "Done."));
  return answer.wrong ? null : answer;
}
