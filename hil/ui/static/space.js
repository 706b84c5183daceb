// The arms in space with their forces, and the gel from above: two small canvases, no outside code.

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const COLORS = ["--before", "--after"];
//: Length of an arrow by force [m/N].
const ARROW = 0.03;
//: Lines of a gel's surface along each side, and width of the dent under a tip [m].
const LINES = 12, DENT = 0.012;

function prepare(canvas) {
  canvas.dataset.high ||= canvas.getAttribute("height");
  const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = Number(canvas.dataset.high), g = canvas.getContext("2d");
  canvas.width = wide * ratio; canvas.height = high * ratio; canvas.style.height = `${high}px`;
  g.setTransform(ratio, 0, 0, ratio, 0, 0); g.clearRect(0, 0, wide, high);
  g.font = "12px system-ui, sans-serif"; g.lineCap = g.lineJoin = "round";
  return { g, wide, high };
}

function arrow(g, from, to, color) {
  const dx = to[0] - from[0], dy = to[1] - from[1], long = Math.hypot(dx, dy);
  if (long < 3) return;
  const a = Math.atan2(dy, dx), head = Math.min(9, long / 2);
  g.strokeStyle = g.fillStyle = color; g.lineWidth = 2.5;
  g.beginPath(); g.moveTo(...from); g.lineTo(...to); g.stroke();
  g.beginPath(); g.moveTo(...to);
  for (const s of [-1, 1]) g.lineTo(to[0] - head * Math.cos(a + 0.45 * s), to[1] - head * Math.sin(a + 0.45 * s));
  g.closePath(); g.fill();
}

// where an arm has been, as a box that only grows: the view follows what moves, and does not shake
function grown(view, name, points) {
  const box = ((view.boxes ||= {})[name] ||= { low: [...points[0]], high: [...points[0]] });
  for (const p of points) p.forEach((x, i) => { box.low[i] = Math.min(box.low[i], x); box.high[i] = Math.max(box.high[i], x); });
  return { ...box, middle: box.low.map((x, i) => (x + box.high[i]) / 2), radius: Math.hypot(...box.low.map((x, i) => box.high[i] - x)) / 2 };
}

const corners = ({ centre: [x, y, z], size: [a, b, c] }) =>
  [[1, 1], [1, -1], [-1, -1], [-1, 1]].flatMap(([i, k]) => [0, -c].map((down) => [x + (i * a) / 2, y + (k * b) / 2, z + down]));

// the block that an arm presses into: its sides, and its surface as a net that gives way under the tip
function block(g, at, gel, tip) {
  const [x, y, z] = gel.centre, [a, b, c] = gel.size, depth = Math.max(0, Math.min(z - tip[2], c));
  const inside = Math.abs(tip[0] - x) <= a / 2 && Math.abs(tip[1] - y) <= b / 2;
  const height = (u, v) => (inside ? z - depth * Math.exp(-((u - tip[0]) ** 2 + (v - tip[1]) ** 2) / (2 * DENT ** 2)) : z);
  const face = (points) => { g.beginPath(); points.forEach((p, i) => (i ? g.lineTo(...at(p)) : g.moveTo(...at(p)))); g.closePath(); g.fill(); g.stroke(); };
  const all = corners(gel);
  g.fillStyle = style("--gel"); g.strokeStyle = style("--data"); g.lineWidth = 1; g.globalAlpha = 0.55;
  for (let k = 0; k < 4; k++) { const n = (k + 1) % 4; face([all[2 * k], all[2 * n], all[2 * n + 1], all[2 * k + 1]]); }
  face([0, 2, 4, 6].map((k) => all[k]));
  g.globalAlpha = 0.8; g.beginPath();
  for (let i = 0; i <= LINES; i++) for (const along of [0, 1]) for (let k = 0; k <= 3 * LINES; k++) {
    const [s, t] = [i / LINES - 0.5, k / (3 * LINES) - 0.5], [u, v] = along ? [x + t * a, y + s * b] : [x + s * a, y + t * b];
    const p = at([u, v, height(u, v)]);
    if (k) g.lineTo(...p); else g.moveTo(...p);
  }
  g.stroke(); g.globalAlpha = 1;
  if (!inside || depth) return;
  // how far the tip still is above the surface
  g.setLineDash([3, 3]); g.beginPath(); g.moveTo(...at(tip)); g.lineTo(...at([tip[0], tip[1], z])); g.stroke(); g.setLineDash([]);
}

// a view from the front and above; the user turns it by dragging or with the arrow keys
export function space(canvas, arms, forces, view, gel) {
  const { g, wide, high } = prepare(canvas), names = Object.keys(arms);
  if (!names.length) { g.fillStyle = style("--quiet"); g.fillText("The arms appear when a session runs.", 12, 24); return; }
  const boxes = names.map((name) => grown(view, name, gel && gel.arm === name ? [...arms[name], ...corners(gel)] : arms[name]));
  const radius = Math.max(0.05, ...boxes.map((box) => box.radius)), room = (high - 24) / 2;
  const scale = Math.min(room, wide / (2 * names.length)) / (1.1 * radius);
  const [c, s, ce, se] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.lift), Math.sin(view.lift)];
  names.forEach((name, k) => {
    const { low, middle } = boxes[k], place = [(wide * (k + 0.5)) / names.length, room];
    const at = (p) => {
      const [x, y, z] = p.map((value, i) => value - middle[i]), u = -s * x + c * y, d = c * x + s * y;
      return [place[0] + scale * u, place[1] - scale * (ce * z - se * d)];
    };
    g.strokeStyle = style("--line"); g.lineWidth = 1;
    for (let i = -2; i <= 2; i++) for (const line of [[[i, -2], [i, 2]], [[-2, i], [2, i]]]) {
      const [a, b] = line.map(([x, y]) => at([middle[0] + 0.4 * x * radius, middle[1] + 0.4 * y * radius, low[2] - 0.05 * radius]));
      g.beginPath(); g.moveTo(...a); g.lineTo(...b); g.stroke();
    }
    if (gel && gel.arm === name) block(g, at, gel, arms[name][arms[name].length - 1]);
    g.strokeStyle = style(COLORS[k % 2]); g.lineWidth = 5; g.beginPath();
    arms[name].forEach((p, i) => (i ? g.lineTo(...at(p)) : g.moveTo(...at(p)))); g.stroke();
    g.fillStyle = style("--ink");
    for (const p of arms[name]) { g.beginPath(); g.arc(...at(p), 3.5, 0, 7); g.fill(); }
    const tip = arms[name][arms[name].length - 1], f = forces[name] || [0, 0, 0];
    arrow(g, at(tip), at(tip.map((x, i) => x + ARROW * (f[i] || 0))), style("--bad"));
    g.fillStyle = style("--ink"); g.textAlign = "center"; g.fillText(name, place[0], high - 8); g.textAlign = "left";
  });
}

// where the tip has been over the gel; darker where it pressed harder.  The gel is drawn where the rig has one
export function above(canvas, trail, hidden, gel) {
  const { g, wide, high } = prepare(canvas);
  if (!trail.length) { g.fillStyle = style("--quiet"); g.fillText("The tip appears when a session runs.", 12, 24); return; }
  const last = trail[trail.length - 1], middle = gel ? gel.centre : trail[0];
  let reach = gel ? Math.max(gel.size[0], gel.size[1]) / 2 : 0.03;
  for (const p of trail) reach = Math.max(reach, Math.abs(p[0] - middle[0]), Math.abs(p[1] - middle[1]));
  const scale = (0.44 * Math.min(wide, high)) / reach, sides = gel ? [gel.size[1], gel.size[0]] : [2 * reach, 2 * reach];
  const at = (p) => [wide / 2 - scale * (p[1] - middle[1]), high / 2 - scale * (p[0] - middle[0])];
  const [across, along] = sides.map((x) => x * scale), [left, top] = [(wide - across) / 2, (high - along) / 2];
  g.fillStyle = style(gel ? "--gel" : "--band"); g.fillRect(left, top, across, along);
  for (const p of trail) {
    g.fillStyle = style("--after"); g.globalAlpha = Math.min(0.9, 0.12 + 0.2 * p[2]);
    g.beginPath(); g.arc(...at(p), 3 + Math.min(6, p[2]), 0, 7); g.fill();
  }
  g.globalAlpha = 1;
  if (!hidden) {
    g.strokeStyle = style("--ink"); g.lineWidth = 2; g.beginPath(); g.arc(...at(last), 9, 0, 7); g.stroke();
    g.beginPath(); for (const [dx, dy] of [[-14, 0], [14, 0]]) { const [x, y] = at(last); g.moveTo(x + dx / 2, y + dy); g.lineTo(x + dx, y + dy); } g.stroke();
  }
  g.fillStyle = style("--quiet"); const told = sides.map((x) => (1000 * x).toFixed(0));
  g.fillText(gel ? `gel ${told[1]} x ${told[0]} mm` : `side ${told[0]} mm`, left + 8, top + along - 8);
}
