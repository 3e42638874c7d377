// The nodes of the picture, equal units folded into one, and their places in layers. It draws nothing.
const FEW = 24, MOST = 40, MOST_IN_LAYER = 8;
export const HIGH = 44;
const WIDEST = 200, NARROWEST = 150;
const BESIDE = 16, BELOW = 12, BETWEEN = 44, FARTHEST = 120;

const giver = (stream) => stream.slice(0, stream.lastIndexOf("/"));
const base = (label) => label.replace(/\(.*$/s, "").replace(/[\s._-]*\d+$/, "") || label;

// `open` has the keys of groups that are shown unfolded; `by` is kind, host or none.
export function folded(units, targets, open, by) {
  const home = new Map(), nodes = new Map();
  const isLarge = units.length + targets.length > FEW && by !== "none";
  const sizes = new Map();
  const keyOf = (unit) => (by === "host" ? unit.host || "no host" : base(unit.transformation));
  for (const unit of units) sizes.set(keyOf(unit), (sizes.get(keyOf(unit)) || 0) + 1);
  const join = (id, kind, title, member, key = null) => {
    if (!nodes.has(id)) nodes.set(id, { id, kind, title, key, members: [] });
    nodes.get(id).members.push(member);
    return id;
  };
  for (const unit of units) {
    const key = `${by} ${keyOf(unit)}`;
    const folds = isLarge && sizes.get(keyOf(unit)) > 1 && !open.has(key);
    home.set(unit.id, folds ? join(`group ${key}`, "group", keyOf(unit), unit, key)
      : join(`unit ${unit.id}`, "unit", unit.id, unit, isLarge && sizes.get(keyOf(unit)) > 1 ? key : null));
  }
  const ends = new Map();
  for (const target of targets) {
    const from = home.get(target.stream ? giver(target.stream) : target.unit);
    const isFolded = isLarge && nodes.get(from)?.kind === "group";
    const key = `targets ${target.met ? "" : "not met "}${from || base(target.label)}`;
    const alike = isFolded || (isLarge && !from);
    ends.set(target.label, [from, alike && !open.has(key) ? join(`targets ${key}`, "targets", target.met ? "targets" : "targets not met", target, key)
      : join(`target ${target.label}`, "target", target.label, target, alike ? key : null)]);
  }
  const edges = new Map();
  const tie = (from, to, stream) => {
    if (!from || !to || from === to) return;
    const key = `${from} > ${to}`;
    if (!edges.has(key)) edges.set(key, { from, to, streams: [] });
    edges.get(key).streams.push(stream);
  };
  for (const unit of units)
    for (const stream of Object.values(unit.inputs).flat()) tie(home.get(giver(stream)), home.get(unit.id), stream);
  for (const target of targets) {
    const [from, to] = ends.get(target.label);
    if (target.stream) tie(from, to, target.stream);
  }
  for (const node of nodes.values()) {
    if (node.key && node.members.length === 1) Object.assign(node, node.kind === "targets" ? { kind: "target", title: node.members[0].label } : { kind: "unit", title: node.members[0].id });
  }
  const graph = { nodes: [...nodes.values()], edges: [...edges.values()] };
  layer(graph);
  return graph.nodes.length > MOST && by !== "none" ? crowded(graph, open) : graph;
}

// Where too many nodes are left, each layer keeps some, and the others become one node.
function crowded(graph, open) {
  const into = new Map(), rests = new Map(), counts = new Map();
  for (const node of graph.nodes) {
    const key = `layer ${node.layer}`;
    const count = (counts.get(key) || 0) + (node.key ? 0 : 1);
    counts.set(key, count);
    const stays = node.key || open.has(key) || count < MOST_IN_LAYER;
    if (!stays && !rests.has(key)) rests.set(key, { id: `rest ${key}`, kind: "group", title: "others", key, layer: node.layer, members: [] });
    if (!stays) rests.get(key).members.push(...node.members);
    into.set(node.id, stays ? node.id : rests.get(key).id);
  }
  const edges = new Map();
  for (const edge of graph.edges) {
    const from = into.get(edge.from), to = into.get(edge.to), key = `${from} > ${to}`;
    if (from === to) continue;
    if (!edges.has(key)) edges.set(key, { from, to, streams: [] });
    edges.get(key).streams.push(...edge.streams);
  }
  return { nodes: [...graph.nodes.filter((node) => into.get(node.id) === node.id), ...rests.values()], edges: [...edges.values()] };
}

// A node's layer is one more than that of any node that feeds it; an edge that would close a circle does not count.
function layer({ nodes, edges }) {
  const feeders = new Map(nodes.map((node) => [node.id, []])), known = new Map(nodes.map((node) => [node.id, node]));
  for (const edge of edges) feeders.get(edge.to).push(edge.from);
  const visiting = new Set();
  const visit = (node) => {
    if (node.layer !== undefined || visiting.has(node.id)) return node.layer ?? -1;
    visiting.add(node.id);
    const before = Math.max(-1, ...feeders.get(node.id).map((id) => visit(known.get(id))));
    visiting.delete(node.id);
    return (node.layer = before + 1);
  };
  nodes.forEach(visit);
}

// Sets x and y of each node. Layers are columns if these fit into the width, else rows. Returns the size.
export function placed({ nodes, edges }, width, height) {
  const layers = [];
  for (const node of nodes) (layers[node.layer] ??= []).push(node);
  const used = layers.filter(Boolean);
  sorted(used, edges);
  const rows = Math.max(3, Math.floor((height + BELOW) / (HIGH + BELOW)));
  const columns = used.map((layer) => Math.ceil(layer.length / rows)), all = columns.reduce((sum, n) => sum + n, 0);
  const gaps = (all - used.length) * BESIDE + (used.length - 1) * BETWEEN + 8;
  const wide = Math.min(WIDEST, Math.floor((width - gaps) / all));
  if (wide >= NARROWEST) return { ...across(used, columns, width, height, all * wide + gaps, wide), wide };
  const inTwo = Math.min(WIDEST, Math.floor((width - 4 - BESIDE) / 2));
  return { ...down(used, width, height, inTwo), wide: inTwo };
}

function across(layers, columns, width, height, least, wide) {
  const gap = layers.length > 1 ? Math.min(FARTHEST, BETWEEN + (width - least) / (layers.length - 1)) : 0;
  let x = Math.max(2, (width - (least + (gap - BETWEEN) * (layers.length - 1))) / 2);
  layers.forEach((layer, at) => {
    const each = Math.ceil(layer.length / columns[at]);
    layer.forEach((node, n) => {
      const inColumn = Math.min(each, layer.length - Math.floor(n / each) * each);
      node.x = x + Math.floor(n / each) * (wide + BESIDE);
      node.y = (height - inColumn * (HIGH + BELOW) + BELOW) / 2 + (n % each) * (HIGH + BELOW);
    });
    x += columns[at] * (wide + BESIDE) - BESIDE + gap;
  });
  return { width, height, isAcross: true };
}

function down(layers, width, height, wide) {
  const each = Math.max(1, Math.floor((width - 4 + BESIDE) / (wide + BESIDE)));
  let y = 2;
  for (const layer of layers) {
    layer.forEach((node, n) => {
      const first = Math.floor(n / each) * each, inRow = Math.min(each, layer.length - first);
      node.x = (width - inRow * (wide + BESIDE) + BESIDE) / 2 + (n - first) * (wide + BESIDE);
      node.y = y + Math.floor(n / each) * (HIGH + BELOW);
    });
    y += Math.ceil(layer.length / each) * (HIGH + BELOW) - BELOW + BETWEEN;
  }
  return { width, height: Math.max(height, y - BETWEEN + 2), isAcross: false };
}

// Neighbours come beside one another: each node goes to the mean place of its neighbours, forth and back.
function sorted(layers, edges) {
  const near = new Map(), at = new Map();
  for (const { from, to } of edges) for (const [one, other] of [[from, to], [to, from]]) near.set(one, [...(near.get(one) || []), other]);
  const number = (layer) => layer.forEach((node, n) => at.set(node.id, (n + 0.5) / layer.length));
  layers.forEach(number);
  const mean = (node) => {
    const places = (near.get(node.id) || []).map((id) => at.get(id));
    return places.length ? places.reduce((sum, place) => sum + place, 0) / places.length : at.get(node.id);
  };
  for (const sweep of [layers, [...layers].reverse(), layers]) {
    for (const layer of sweep) {
      const means = new Map(layer.map((node) => [node, mean(node)]));
      layer.sort((a, b) => means.get(a) - means.get(b));
      number(layer);
    }
  }
}
